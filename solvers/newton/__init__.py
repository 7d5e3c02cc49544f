"""Newton's iteration on many instances at once."""
