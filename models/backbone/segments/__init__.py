"""Segments of a backbone of one rod, end to end, for multiple shooting."""
