"""Launches of the kernels in lanes, and what they read and write."""
