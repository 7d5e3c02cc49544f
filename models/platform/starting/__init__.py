"""Where the search begins: legs as beams, joints taken apart, places to put the platform at."""
