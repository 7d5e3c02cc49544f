"""Inputs along a moving target, one integration a sample."""
