"""Large studies: solved chunk by chunk, kept on disk, resumed where they stopped."""

from multirod.studies.sweeps.driver import sweep
from multirod.studies.sweeps.study import Study

__all__ = ["Study", "sweep"]
