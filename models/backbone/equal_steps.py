"""Equal steps along rods where branches end: step control takes a straight rod in a few long ones."""

from dataclasses import replace

import numpy as np

from multirod.integrators import AdaptiveIntegrator, Integrator
from multirod.validation import FloatArray

STEPS = 96  # of a rod
PER_RADIAN = 20  # by which it is bent at rest
MOST_STEPS = 1024


def equal_steps(integrator: Integrator, bent: FloatArray) -> Integrator | None:
    """The same method at equal steps, as many as rods need that are ``bent`` by so much at rest [rad], shape (...,); None where
    steps are equal already.

    The error of long steps in ``Gamma`` moves where its modes vanish, by some thousandths between whole rods and their pieces.
    """
    own = integrator.in_double()
    if not (isinstance(own, AdaptiveIntegrator) and own.adaptive):
        return None
    steps = int(np.clip(np.ceil(PER_RADIAN * np.max(bent)), STEPS, MOST_STEPS))
    return replace(own, steps=steps)
