"""What a rod carries along itself: members, and the lines among them with what drives them."""
