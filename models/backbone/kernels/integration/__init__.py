"""Steps of an integration, where they end, and the kernels that take them."""
