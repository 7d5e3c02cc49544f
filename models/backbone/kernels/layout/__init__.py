"""What a scene needs, and how its numbers stand in memory."""
