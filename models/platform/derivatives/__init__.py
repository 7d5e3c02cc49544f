"""How legs and platform vary with inputs, with the legs' numbers and places, and along the legs."""
