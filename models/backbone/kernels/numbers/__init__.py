"""Numbers in lanes, and what is made of them; frames of one instance."""
