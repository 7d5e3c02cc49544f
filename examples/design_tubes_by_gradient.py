"""Which tubes reach a given workspace? Precurvatures and lengths of a surgical robot's tubes, found by gradient.

The robot is that of ``surgical_tubes.py`` (github SIRGLab/CTR_Python_Model, the program beside M. Khadem, L. Da Cruz,
C. Bergeles, IROS 2018, 4920-4926). It is to bring its tip to the corners of a box, held at each by drives of its own. The
curvatures of its tubes and how long the curved parts are, are chosen together with all the drives: 54 numbers, one loss, and its
exact gradient at every step, through JAX, or through ``Solution.vjp`` where JAX is not installed.
"""

import argparse
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.optimize import minimize
from surgical_tubes import ROBOT

import multirod as mr

CENTRE, SIDE = (0.025, 0.0, 0.100), 0.030  # of the box [m]
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * SIDE + CENTRE
PUBLISHED = {"curvature": (21.3, 13.108, 3.5), "curved": (0.103, 0.113, 0.134)}
LENGTHS = np.array([rod.length for rod in ROBOT.rods])
GAP, ROOM = 0.005, (0.09, 0.15)  # between the ends of tubes, at least; at most, for their drives not to meet [m]
UNITS = {"curvature": 10.0, "curved": 0.05, "rotation": 1.0, "inner": 0.02, "middle": 0.02, "outer": 0.02}  # 1/m, m, rad, m, m, m
LOW = {"curvature": 3.0, "curved": 0.02, "rotation": -np.inf, "inner": GAP, "middle": GAP, "outer": GAP}
HIGH = {"curvature": 35.0, "curved": 0.15, "rotation": np.inf, "inner": ROOM[0], "middle": ROOM[1], "outer": 0.12}
SHAPES = {"curvature": (3,), "curved": (3,), "rotation": (len(CORNERS), 3)}
SHAPES |= {name: (len(CORNERS),) for name in ("inner", "middle", "outer")}  # how far each stands out of the one around it


def unpacked(z: Any, numpy: Any = np) -> dict[str, Any]:
    """Values of the robot by name, of numbers in ``UNITS``; linear but for a constant."""
    at: dict[str, Any] = {}
    first = 0
    for name, shape in SHAPES.items():
        size = int(np.prod(shape))
        at[name] = UNITS[name] * z[first : first + size].reshape(shape)
        first += size
    zero = numpy.zeros(3)
    curved = numpy.stack([at["curvature"], zero, zero], axis=-1)
    ends = [at["outer"] + at["middle"] + at["inner"], at["outer"] + at["middle"], at["outer"]]
    return {
        "precurvature": numpy.stack([0 * curved, curved], axis=-2),  # tube, section, component
        "length": numpy.stack([LENGTHS - at["curved"], at["curved"]], axis=-1),
        "rotation": at["rotation"],
        "translation": numpy.stack(ends, axis=-1) - LENGTHS,
    }


def packed(values: dict[str, Any]) -> np.ndarray:
    """Numbers in ``UNITS``."""
    return np.concatenate([np.ravel(np.broadcast_to(values[name], shape)) / UNITS[name] for name, shape in SHAPES.items()])


def designed(z: np.ndarray) -> mr.ConcentricTubes:
    """The tubes of these numbers."""
    values = unpacked(z)
    sections = [
        [
            mr.Section(
                length=length,
                precurvature=curvature,
                bending_stiffness=rod.sections[0].bending_stiffness,
                torsional_stiffness=rod.sections[0].torsional_stiffness,
            )
            for length, curvature in zip(values["length"][k], values["precurvature"][k], strict=True)
        ]
        for k, rod in enumerate(ROBOT.rods)
    ]
    diameters = [{"outer_diameter": rod.outer_diameter, "inner_diameter": rod.inner_diameter} for rod in ROBOT.rods]
    return mr.ConcentricTubes(
        [mr.Rod(name=rod.name, sections=s, **d) for rod, s, d in zip(ROBOT.rods, sections, diameters, strict=True)]
    )


Loss = Callable[[np.ndarray], tuple[float, np.ndarray]]


def loss_by_jax() -> Loss:
    """Mean square of what the tips miss their corners by [mm^2], and its gradient."""
    import jax

    tip = mr.jax.function(ROBOT)

    def loss(z: Any) -> Any:
        return 1e6 * ((tip(**unpacked(z, jax.numpy)) - CORNERS) ** 2).sum(axis=-1).mean()

    both = jax.jit(jax.value_and_grad(loss))

    def evaluate(z: np.ndarray) -> tuple[float, np.ndarray]:
        with jax.enable_x64(True):
            value, gradient = both(z)
        return float(value), np.asarray(gradient)

    return evaluate


def loss_by_vjp() -> Loss:
    """The same: cotangents of the tips, carried back to the values of each name, and from there to ``z``."""
    names = ("precurvature", "length", "rotation", "translation")
    size = sum(int(np.prod(shape)) for shape in SHAPES.values())
    zero = unpacked(np.zeros(size))
    units = [unpacked(unit) for unit in np.eye(size)]
    slopes = {name: np.array([unit[name] - zero[name] for unit in units]) for name in names}

    def evaluate(z: np.ndarray) -> tuple[float, np.ndarray]:
        values = unpacked(z)
        robot = designed(z)
        solution = mr.solve(robot, robot.inputs(rotation=values["rotation"], translation=values["translation"]))
        missed = solution.tip_position - CORNERS
        found = solution.vjp(2e6 / len(missed) * missed, of="tip_position", wrt=names)
        gradient = np.zeros(size)
        for name in names:
            by_values = found[name] if name in ("rotation", "translation") else found[name].sum(axis=0)
            gradient += np.tensordot(slopes[name], by_values.reshape(values[name].shape), values[name].ndim)
        return 1e6 * float((missed**2).sum(axis=-1).mean()), gradient

    return evaluate


def drawn(solution: mr.Solution) -> Any:
    """The robot at all corners of the box."""
    axes = solution.plot(colour_by=np.arange(len(CORNERS)), colour_label="corner")
    edges = [(a, b) for a in CORNERS for b in CORNERS if np.isclose(np.linalg.norm(a - b), SIDE)]
    for edge in edges:
        axes.plot(*np.transpose(edge), color="0.4", linewidth=1)
    axes.scatter(*CORNERS.T, color="black", s=12)
    return axes.figure


def main(arguments: Sequence[str] | None = None) -> tuple[float, float]:
    """The farthest that a corner is missed by, of the published tubes and of the designed ones [mm]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vjp", action="store_true", help="without JAX")
    parser.add_argument("--out", help="picture to write")
    options = parser.parse_args(arguments)
    by_jax = find_spec("jax") is not None and not options.vjp
    loss = loss_by_jax() if by_jax else loss_by_vjp()
    towards = np.arctan2(CORNERS[:, 1], CORNERS[:, 0]) + np.pi / 2  # a tube bent about its x axis leans to its -y
    start = packed(PUBLISHED | {"rotation": towards[:, None], "inner": 0.03, "middle": 0.03, "outer": 0.05})
    low, high = packed(LOW), packed(HIGH)
    tubes = slice(0, 6)
    worst = []
    for name in ("published", "designed"):
        bounds = np.stack([low, high], axis=1)
        if name == "published":  # drives alone
            bounds[tubes] = start[tubes, None]
        found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B", options={"maxiter": 300})
        values, robot = unpacked(found.x), designed(found.x)
        inputs = robot.inputs(rotation=values["rotation"], translation=values["translation"])
        solution = mr.solve(robot, inputs).raise_if_failed()
        worst.append(1e3 * float(np.linalg.norm(solution.tip_position - CORNERS, axis=1).max()))
        curvature, curved = values["precurvature"][:, 1, 0], 1e3 * values["length"][:, 1]
        print(f"{name} tubes: {np.round(curvature, 1)} 1/m along the last {np.round(curved).astype(int)} mm")
        print(f"  miss a corner by {worst[-1]:.2g} mm at most, after {found.nfev} values and gradients")
    assert (solution.stability == mr.Stability.STABLE).all()
    assert worst[1] < 0.01 < worst[0]
    if options.out:
        drawn(solution).savefig(options.out, dpi=80, bbox_inches="tight", metadata={"Software": None})
    return worst[0], worst[1]


if __name__ == "__main__":
    main()
