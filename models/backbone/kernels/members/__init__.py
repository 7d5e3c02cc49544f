"""The strain law of rods that carry members, such as lines, and the laws of the lines."""
