"""What serves many journeys at once: what they ask for, and one launch for all that ask for the same."""
