"""Results: equilibria of all instances, over time too, and what is told of them."""
