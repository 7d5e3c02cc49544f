"""For those who write assemblies: a kit that checks what the package counts on (``docs/extending.md``)."""

from multirod.testing.conformance import Nonconformance, check_assembly

__all__ = ["Nonconformance", "check_assembly"]
