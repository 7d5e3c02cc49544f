"""The insides of solvers that take one integration a sample."""
