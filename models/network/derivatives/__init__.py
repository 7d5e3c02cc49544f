"""How a network varies with its inputs and with the numbers of its rods, joints and ground."""
