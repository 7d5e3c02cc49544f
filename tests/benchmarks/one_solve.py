"""What one call takes when kernels are compiled: processor time, the least and the median, and in bare C loops of the same run.

A C loop is one integration of a rod with residual and Gamma, RK4(50). Calls take turns, some in a row, so that what else the
machine does meets all alike.

python tests/benchmarks/one_solve.py [--rounds N]
"""

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from single_rod import c_loop

import multirod as mr
from multirod.studies.scenes import six_legs, three_tubes

IN_A_ROW = 10
Timed = tuple[str, str, Callable[[], Any], Callable[[Any], Any]]


def scenes() -> dict[str, tuple[mr.Assembly, Callable[[float], dict[str, Any]]]]:
    """Robots, and inputs that change a little from call to call."""
    wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    place = (-0.30, -0.22, -0.0945)
    return {
        "rod": (mr.SingleRod(wire), lambda t: {"rotation": 0.1 + t, "tip_force": (1.0, 0.0, 0.0)}),
        "three tubes": (
            three_tubes().robot,
            lambda t: {"rotation": (0.3 + t, 0.1, 0.0), "translation": place, "tip_force": (0.1, 0.05, 0.0)},
        ),
        "six legs": (
            six_legs().robot,
            lambda t: {"translation": (1e-3 * t, 0.0, 0.0, 0.0, 0.0, 0.0), "tip_force": (1.0, 0.0, -8.0)},
        ),
    }


def calls() -> list[Timed]:
    """Name of the robot, name of the call, what is made ready for it, and the call."""
    result: list[Timed] = []
    for name, (robot, values) in scenes().items():
        count = [0]

        def present(values: Any = values, count: list[int] = count) -> dict[str, Any]:
            count[0] += 1
            return dict(values(1e-4 * count[0]))

        def solve(_: Any, robot: Any = robot, present: Any = present) -> Any:
            return mr.solve(robot, robot.inputs(**present()))

        def again(values: Any, robot: Any = robot) -> Any:
            return mr.solve(robot, robot.inputs(**values))

        def same(values: Any = values) -> Any:
            return values(0.0)

        def solution(solve: Any = solve) -> Any:
            return solve(None)

        result.append((name, "`mr.solve`", lambda: None, solve))
        result.append((name, "`mr.solve`, the base unmoved", same, again))
        result.append((name, "`solution.rod(0)`", solution, lambda s: s.rod(0)))
        result.append((name, '`solution.jacobian("tip_force")`', solution, lambda s: s.jacobian("tip_force")))
        result.append((name, "`solution.stability`", solution, lambda s: s.stability))
        tracker = mr.Tracker(robot, dt=0.005, inputs=robot.inputs(**values(0.0)))

        def step(given: Any, tracker: Any = tracker) -> Any:
            return tracker.step(**given)

        def sample(step: Any = step, present: Any = present) -> Any:
            return step(present())

        result.append((name, "`Tracker.step`, Newton", present, step))
        result.append((name, 'its `jacobian("tip_force")`', sample, lambda s: s.jacobian("tip_force")))
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    timed = calls()
    times: list[list[float]] = [[] for _ in timed]
    floors: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        floor = c_loop(Path(folder), repeats=400)
        for k in range(-2, options.rounds):
            if floor is not None:
                floors.append(floor())
            for (_, _, prepare, call), found in zip(timed, times, strict=True):
                for _ in range(IN_A_ROW):
                    given = prepare()
                    begin = process_time()
                    call(given)
                    if k >= 0:
                        found.append(process_time() - begin)
    least = min(floors) if floors else np.nan
    print(f"bare C loop: {least:.2f} µs at least\n" if floors else "no C compiler found: times without ratios\n")
    print("| robot | call | least [µs] | median [µs] | least, in C loops |\n|---|---|---|---|---|")
    for (robot, call, _, _), found in zip(timed, times, strict=True):
        values = 1e6 * np.array(found)
        print(f"| {robot} | {call} | {values.min():.0f} | {np.median(values):.0f} | {values.min() / least:.0f} |")


if __name__ == "__main__":
    main()
