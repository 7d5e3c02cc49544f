"""Large studies: solved chunk by chunk, kept on disk, resumed where they stopped."""

from multirod.sweeps.driver import sweep
from multirod.sweeps.study import Study

__all__ = ["Study", "sweep"]
