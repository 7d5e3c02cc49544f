"""Short forms against networks that say the same: how far apart their results are, and what each takes.

Of the stored rods and parallel robots of ``tests/data`` that are not marked as hard, and of a rod between the ground and a hand,
the largest distance of end effectors or of the first rod over its length, at the same steps of RK4 and at steps whose errors are
1e-12. Then processor time of a cold ``solve`` and of a sample of a ``Tracker``, in turns, the least of each.

OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python tests/benchmarks/short_forms.py [--rounds N]
"""

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from conftest import load_cases
from test_cases import BUCKLED, robot_and_inputs
from test_parallel_rods import stored_robot

import multirod as mr

IN_A_ROW = 10
SOLVERS = {
    "RK4(50)": mr.Shooting(tolerance=1e-11, integrator=mr.RK4(50)),
    "1e-12": mr.Shooting(tolerance=1e-11, integrator=mr.RK45(rtol=1e-12, atol=1e-14)),
}
NAMES = {"tip_force": "force", "tip_moment": "moment", "end_position": "fixed_position", "end_rotation": "fixed_rotation"}
Said = tuple[mr.Assembly, dict[str, Any], mr.Network, np.ndarray]  # short form, inputs, network, what is compared, in its body


def make_pose(R: Any, p: Any) -> np.ndarray:
    """A pose (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = R, p
    return pose


def network_of(robot: mr.SingleRod | mr.HeldRod | mr.ParallelRods) -> mr.Network:
    """The same as rods, bodies and joints."""
    if isinstance(robot, mr.ParallelRods):
        return mr.stacked(robot)
    rods, base = {"rod": robot.rods[0]}, mr.Joint("rod", "base", to=mr.ground)
    if isinstance(robot, mr.SingleRod):
        return mr.Network(rods=rods, joints=[base], base=robot.base)
    hand = mr.Body("hand", pose=robot.end, fixed=True)
    return mr.Network(rods=rods, bodies=[hand], joints=[base, mr.Joint("rod", "tip", to=hand)])


def renamed(given: dict[str, Any]) -> dict[str, Any]:
    """Inputs by the names that networks have for them."""
    return {NAMES.get(name, name): value for name, value in given.items()}


def values_of(inputs: mr.Inputs) -> dict[str, Any]:
    """What was given."""
    return {name: getattr(inputs, name) for name in inputs.given}


def stored() -> Iterator[tuple[str, Said]]:
    """Kind of each case, and how it is said."""
    nowhere = np.zeros(3)
    for case in load_cases("single_rod"):
        if case["difficulty"] == "standard" and not case["id"].startswith(BUCKLED):
            robot, inputs = robot_and_inputs(case, make_pose)
            yield "rods", (robot, values_of(inputs), network_of(robot), nowhere)
    for case in load_cases("parallel_continuum_robot"):
        if case["difficulty"] == "standard":
            robot, inputs = stored_robot(case, make_pose)
            given = values_of(inputs)
            point, platform = given["force_point"], robot.geometry.platform.copy()
            platform[:, :3, 3] -= point  # forces act on the origin of a body: it stands there
            kinds = ["revolute" if rod["twist_free"] else "clamped" for rod in case["inputs"]["rods"]]
            moved = mr.ParallelRods(legs=robot.legs, base=robot.geometry.base, platform=platform, joints=kinds)
            yield "parallel robots", (robot, given, network_of(moved), -point)
    held, given = in_a_hand()
    yield "a rod in a hand", (held, given, network_of(held), nowhere)


def in_a_hand() -> tuple[mr.HeldRod, dict[str, Any]]:
    """A rod, and where its end is held."""
    rod = mr.Rod(length=0.3, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(1, 0.5, 0), linear_density=0.02)
    given = {"end_position": (0.01, 0.02, -0.01), "end_rotation": (0.2, 0.1, 0.3), "gravity": (0, 0, -9.81)}
    return mr.HeldRod(rod, end=make_pose(np.eye(3), (0.05, 0, 0.25))), given


def compared() -> None:
    """Print distances."""
    largest: dict[str, dict[str, float]] = {}
    counts: dict[str, int] = {}
    for kind, (short, given, network, point) in stored():
        counts[kind] = counts.get(kind, 0) + 1
        own = {name: value for name, value in given.items() if name != "force_point"}
        for steps, solver in SOLVERS.items():
            one = mr.solve(short, short.inputs(**given), solver=solver).raise_if_failed()
            two = mr.solve(network, network.inputs(**renamed(own)), solver=solver).raise_if_failed()
            shape_one, shape_two = one.rod(0).position, two.rod(0).position
            off = max(
                float(np.abs(two.tip_position + two.tip_rotation @ point - one.tip_position).max()),
                float(np.abs(shape_two - shape_one).max()),
            )
            before = largest.setdefault(kind, {}).get(steps, 0.0)
            largest[kind][steps] = max(before, off / float(short.rods[0].length))
    print("| stored | cases | " + " | ".join(f"steps {name}" for name in SOLVERS) + " |\n|---|---|---|---|")
    for kind, found in largest.items():
        print(f"| {kind} | {counts[kind]} | " + " | ".join(f"{found[steps]:.1e}" for steps in SOLVERS) + " |")


def timed() -> dict[str, tuple[mr.Assembly, Callable[[float], dict[str, Any]]]]:
    """Robots, and inputs that change a little from call to call."""
    from multirod.studies.scenes import six_legs

    wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0), linear_density=0.05)
    held, at_hand = in_a_hand()
    place = np.array(at_hand["end_position"])
    return {
        "a rod, a force on its tip": (mr.SingleRod(wire), lambda t: {"rotation": 0.1 + t, "tip_force": (1.0, 0.0, 0.0)}),
        "a rod under its weight": (mr.SingleRod(wire), lambda t: {"rotation": 0.1 + t, "gravity": (0, 0, -9.81)}),
        "a rod in a hand": (held, lambda t: at_hand | {"end_position": place + (0, t, 0)}),
        "six legs": (
            six_legs().robot,
            lambda t: {"translation": (1e-1 * t, 0.0, 0.0, 0.0, 0.0, 0.0), "tip_force": (1.0, 0.0, -8.0)},
        ),
    }


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=20)
    options = parser.parse_args()
    compared()
    calls: dict[tuple[str, str, str], Callable[[], Any]] = {}
    for name, (short, values) in timed().items():
        for form, robot in (("short", short), ("network", network_of(short))):
            count = [0]

            def present(values: Any = values, count: list[int] = count, form: str = form) -> dict[str, Any]:
                count[0] += 1
                given = values(1e-4 * count[0])
                return renamed(given) if form == "network" else dict(given)

            tracker = mr.Tracker(robot, dt=0.005, inputs=robot.inputs(**present()))
            calls[name, "`mr.solve`", form] = lambda robot=robot, present=present: mr.solve(robot, robot.inputs(**present()))
            calls[name, "`Tracker.step`", form] = lambda tracker=tracker, present=present: tracker.step(**present())
    least = dict.fromkeys(calls, np.inf)
    for turn in range(-1, options.rounds):
        for key, call in calls.items():
            for _ in range(IN_A_ROW):
                begin = process_time()
                call()
                least[key] = min(least[key], process_time() - begin) if turn >= 0 else np.inf
    print("\n| robot | call | short form [µs] | network [µs] | ratio |\n|---|---|---|---|---|")
    for name, call, form in calls:
        if form == "short":
            one, two = (1e6 * least[name, call, which] for which in ("short", "network"))
            print(f"| {name} | {call} | {one:.0f} | {two:.0f} | {two / one:.2f} |")


if __name__ == "__main__":
    main()
