"""The insides of multiple shooting."""
