"""Following branches of equilibria."""
