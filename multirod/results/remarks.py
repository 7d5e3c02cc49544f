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
        measured: Where the end effector was seen [m], shape (3,), NaN where that is missing; None where it is not measured.
        covariances: Of forces that were estimated, by input, in the frame of that input [N^2], shape (3, 3).
    """

    target: FloatArray | None = None
    target_error: float | None = None
    limits: FloatArray | None = None
    limit_names: tuple[str, ...] = ()
    measured: FloatArray | None = None
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)

    def like(self, other: "Remarks") -> bool:
        """Whether the other has the same parts."""

        def parts(said: Remarks) -> tuple[object, ...]:
            told = (said.target, said.target_error, said.measured)
            return *(value is None for value in told), said.limit_names, tuple(said.covariances)

        return parts(self) == parts(other)
