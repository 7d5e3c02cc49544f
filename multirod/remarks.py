"""What a task says of a sample beside its equilibrium: recordings show it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from multirod.validation import FloatArray


@dataclass(frozen=True, kw_only=True)
class Remarks:
    """Of one sample without leading axes; all of a run have the same parts.

    Attributes:
        target: Where the end effector is to be in the world [m], shape (3,); None where no position is asked for.
        target_error: How far it is from there [m].
        limits: Where each limited number stands between its ends, 0 at the lower and 1 at the upper one, shape (c,).
        limit_names: Of these.
        covariances: Of forces that were estimated, by input, in the frame of that input [N^2], shape (3, 3).
    """

    target: FloatArray | None = None
    target_error: float | None = None
    limits: FloatArray | None = None
    limit_names: tuple[str, ...] = ()
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)

    def like(self, other: "Remarks") -> bool:
        """Whether the other has the same parts."""
        mine, others = ((r.target is None, r.target_error is None, r.limit_names, tuple(r.covariances)) for r in (self, other))
        return mine == others
