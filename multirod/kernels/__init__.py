"""What kernels of the contract, models and solvers share: linear algebra, why an integration failed, launches they repeat."""
