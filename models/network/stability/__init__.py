"""The second variation of a network's energy."""
