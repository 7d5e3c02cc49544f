"""Measurements: what sensors say, and what of it is missing."""
