"""Robots solved, moved and followed sample by sample."""
