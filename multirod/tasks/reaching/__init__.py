"""Inputs for a target: the search, from its compiled steps to what is tried where it stops."""
