"""Rods as elements of a network: what their ends say of the bodies that hold them, and where that stands in ``Gamma``."""
