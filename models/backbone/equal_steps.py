"""Equal steps along rods where branches end: step control takes a straight rod in a few long ones."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.integrators import AdaptiveIntegrator, Integrator

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

STEPS = 96  # of a rod
PER_RADIAN = 20  # by which it is bent at rest
MOST_STEPS = 1024


def equal_steps(integrator: Integrator, backbones: "Iterable[BackboneProblem]") -> Integrator | None:
    """The same method at equal steps, as many as the rod needs that is bent the most at rest; None where they are equal already.

    The error of long steps in ``Gamma`` moves where its modes vanish, by some thousandths between whole rods and their pieces.
    """
    own = integrator.in_double()
    if not (isinstance(own, AdaptiveIntegrator) and own.adaptive):
        return None
    bent = max((own.curvature_scale() * own.each(own.arrays.end[:, 0, -1])).max() for own in backbones)
    steps = int(np.clip(np.ceil(PER_RADIAN * bent), STEPS, MOST_STEPS))
    return replace(own, steps=steps)
