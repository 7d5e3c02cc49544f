"""How a backbone changes along itself, and by the numbers of its rods."""
