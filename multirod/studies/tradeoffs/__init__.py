"""Speed against accuracy, measured: settings of a grid on one motion, against a reference that is checked.

``driver`` is where to begin. ``settings`` says what is tried, ``reference`` what errors are measured against, ``measurement``
runs one setting after the other, ``table`` holds the result; ``plot`` draws it, ``promise`` chooses from it.
"""

from multirod.studies.tradeoffs.driver import tradeoff, tune
from multirod.studies.tradeoffs.measurement import Measurement
from multirod.studies.tradeoffs.settings import grid, integrators
from multirod.studies.tradeoffs.table import Measured, Rows, Tradeoff

__all__ = ["Measured", "Measurement", "Rows", "Tradeoff", "grid", "integrators", "tradeoff", "tune"]
