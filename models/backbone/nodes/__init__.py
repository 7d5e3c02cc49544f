"""Passes over nodes: what is known of a solution between base and tip."""
