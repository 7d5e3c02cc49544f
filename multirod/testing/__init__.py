"""For those who write assemblies: a kit that checks what the package counts on (``docs/extending.md``)."""

from multirod.testing.conformance import check_assembly
from multirod.testing.study import Nonconformance

__all__ = ["Nonconformance", "check_assembly"]
