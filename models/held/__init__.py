"""A rod that is held at both ends."""
