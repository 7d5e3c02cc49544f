"""Bad values for what tasks and networks are made of, as in ``test_fuzz.py``: sensors, priors, lines, bodies, joints."""

from collections.abc import Iterator

import numpy as np
import pytest
from test_fuzz import BATCH, PROPERTIES, Target, cases, circle, fuzzed, wire

import multirod as mr

pytestmark = pytest.mark.usefixtures("written_here")
PLATE, TOP = mr.Body("plate"), mr.Body("top")
POSE = np.eye(4)


def joints() -> list[mr.Joint]:
    low = [mr.Joint("a", "base", to=mr.ground), mr.Joint("a", "tip", to=PLATE), mr.Joint("b", "base", to=PLATE)]
    return [*low, mr.Joint("b", "tip", to=TOP, kind="revolute", axis=(1, 0, 0), pose=POSE, driven=True)]


def sensors() -> Iterator[Target]:
    yield Target(
        "Pose", mr.Pose, {"position": (0, 0, 0.4)}, "position", "rotation", "axis", "sigma", "across", "covariance", "at"
    )
    yield Target("Pose of an angle", mr.Pose, {"rotation": np.eye(3)}, "sigma", "covariance")
    yield Target("Curvature", mr.Curvature, {"at": 0.1, "value": (1, 0, 0), "sigma": 0.1}, "value", "sigma")
    yield Target("ForceTorque", mr.ForceTorque, {"force": (0, 0, 0), "sigma": 0.1}, "force", "moment", "sigma", "at")
    yield Target("Tension", mr.Tension, {"value": (1.0,), "sigma": 0.1}, "value", "sigma", "line")
    yield Target("Prior", mr.Prior, {"sigma": 1.0}, "mean", "sigma", "covariance")
    yield Target("Walk", mr.Walk, {"sigma": 1.0}, "sigma", "start")
    yield Target("Limits", mr.Limits, {}, "gap", "curvature", "stability_margin", "translation")


def parts() -> Iterator[Target]:
    ends = ("start", "end", "name")
    yield Target("Tendon", mr.Tendon, {"offset": (0.01, 0)}, "offset", "route", "driven", "axial_stiffness", "friction", *ends)
    yield Target("PushRod", mr.PushRod, {"offset": (0.01, 0)}, "axial_stiffness", "bending_stiffness", "rest_length", *ends)
    yield Target("Chamber", mr.Chamber, {"offset": (0.01, 0), "area": 1e-5}, "area", "area_fixed", *ends)
    yield Target("Rod", mr.Rod, PROPERTIES, "magnetisation", "foundation", "members", "lines", "discs", "loads")
    tubes = {"tubes": [wire(), wire()], "offsets": [(0.001, 0), (-0.001, 0)]}
    yield Target("EccentricTubes", mr.EccentricTubes, tubes, *tubes, "base")
    yield Target("Body", mr.Body, {"name": "a"}, "name", "mass", "mass_centre", "pose", "fixed", "frames")
    hinge = {"rod": "a", "end": "tip", "to": PLATE, "kind": "revolute", "axis": (1, 0, 0), "pose": POSE}
    yield Target("Joint", mr.Joint, hinge, "rod", "end", "to", "kind", "axis", "stiffness", "rest", "driven", "at")
    hole = {"rod": "a", "end": "along", "to": PLATE, "at": 0.1, "kind": "spherical"}
    yield Target("hole", mr.Joint, hole, "kind", "axis", "stiffness", "rest", "at")
    network = {"rods": {"a": wire(), "b": wire()}, "bodies": [PLATE, TOP], "joints": joints()}
    yield Target("Network", mr.Network, network, *network, "driven")
    thin = wire(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.01, axial_stiffness=1e4)
    around = [(0.01, 0), (0, 0.01), (-0.01, 0)]
    discs = {"backbone": wire(length=0.2), "rods": [thin] * 3, "offsets": around, "discs": 1}
    yield Target("multibackbone", mr.multibackbone, discs, *discs, "hole", "disc_mass")
    pair = mr.ParallelRods(legs=[wire()] * 2, base=circle(2, 0.1), platform=circle(2, 0.05))
    yield Target("stacked", lambda **given: mr.stacked(pair, pair, **given), {}, "to", "base")
    robot = mr.Network(**network)
    yield Target("Network.inputs", robot.inputs, {}, *(spec.name for spec in robot.input_specs))


def results() -> Iterator[Target]:
    yield Target("Solution.along", BATCH.along, {"at": 0.1}, "at", "of", "rod")
    yield Target("Solution.wrench", BATCH.wrench, {}, "rod", "end")
    yield Target("Wrench.about", BATCH.wrench().about, {"point": (0, 0, 0)}, "point")
    yield Target("Solution.vjp", BATCH.vjp, {"cotangent": np.ones(6), "wrt": "tip_force"}, "cotangent", "of", "wrt")


EVERY = [*sensors(), *parts(), *results()]


@pytest.mark.parametrize("target", EVERY, ids=lambda target: target.label)
def test_what_bad_values_are_put_into_is_plausible(target: Target) -> None:
    target.call(**target.good)


@pytest.mark.parametrize(("target", "name"), cases(iter(EVERY)))
def test_parts(target: Target, name: str) -> None:
    wrong = fuzzed(target, name)
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("sigma", [1e-300, 1e-60, 1e60, 1e300])
def test_a_deviation_whose_square_is_no_number_is_refused(sigma: float) -> None:
    """It was taken, and ended in an error of LAPACK's, or an overflow, once something was estimated."""
    for make in (mr.Walk, lambda sigma: mr.Prior(0, sigma=sigma), lambda sigma: mr.Pose(position=(0, 0, 0), sigma=sigma)):
        with pytest.raises(ValueError, match="sigma = .* must be from 1e-50 to 1e\\+50"):
            make(sigma)
