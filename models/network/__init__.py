"""Rods and bodies in a graph."""
