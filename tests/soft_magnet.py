"""A magnetised rod in a medium as a function of both, of which one instance is lost; what JAX and PyTorch are tried by."""

import numpy as np

import multirod as mr

NODES, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60  # a derivative, error O(h^6)
STEPS = {"foundation": 0.3, "magnetisation": 1e-2}  # differences along these are off by their rounding, 1e-12
LOST = 2  # of the instances
SOLVER = mr.Shooting(integrator=mr.RK45(rtol=1e-11, atol=1e-13), tolerance=1e-12, max_integrations=40, fallback=False)
OWN = {"bending_stiffness": (0.01, 0.015), "torsional_stiffness": 0.008}
ROBOT = mr.SingleRod(
    mr.Rod(
        sections=[
            mr.Section(length=0.12, precurvature=(4, -2, 1), foundation=(60, 30, 10), magnetisation=(0.4, -0.2, 2), **OWN),
            mr.Section(length=0.08, precurvature=(1, 3, -1), foundation=(20, 40, 5), magnetisation=(-0.3, 0.2, 1), **OWN),
        ]
    )
)
SCENE = {"inputs": ROBOT.inputs(tip_force=(0.2, 0.1, -0.1), magnetic_field=(0.05, -0.03, 0.02)), "solver": SOLVER}


def batch():
    """Values of four instances by name, shape (4, 1, 2, 3); ``LOST`` asks for more integrations than there are."""
    own = {name: np.array([[getattr(s, name) for s in rod.sections] for rod in ROBOT.rods]) for name in STEPS}
    factors = {"foundation": (1.0, 1.2, 1.0, 0.5), "magnetisation": (1.0, 1.0, 3e4, 1.1)}
    return {name: np.multiply.outer(factors[name], value) for name, value in own.items()}


def along(values, name):
    """A way to change a name, and the values of one instance (1, 2, 3) by name at some steps along it."""
    way = np.random.default_rng(0).standard_normal(values[name].shape)
    return way, [values | {name: values[name] + STEPS[name] * step * way} for step in NODES]
