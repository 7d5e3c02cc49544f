# mypy: ignore-errors
"""Why an integration failed, as a kernel says it."""

import warp as wp

from multirod.status import Fault


@wp.func
def failure_of(fault: int) -> int:
    """Status of an instance that a failed integration ends."""
    if fault == wp.static(int(Fault.STEP_LIMIT)):
        return wp.static(int(Fault.STEP_LIMIT.status))
    if fault == wp.static(int(Fault.STRAIN_LAW)):
        return wp.static(int(Fault.STRAIN_LAW.status))
    return wp.static(int(Fault.NONFINITE.status))
