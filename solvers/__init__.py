"""Methods that find the unknowns of a boundary problem."""

if __name__ != "multirod.solvers":
    raise ImportError(f"import 'multirod.solvers', not {__name__!r}")
