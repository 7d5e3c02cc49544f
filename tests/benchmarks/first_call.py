"""The first solve of a scene from an empty kernel cache, and what is asked of it then, each in a process of its own: processor
time and wall.

With ``--optimization 0`` kernels are generated and compiled, and not optimised: what is left is what no choice of optimisations
can take less than. A kernel that does nothing is the floor below everything: Warp imported, its headers read and precompiled.

python tests/benchmarks/first_call.py [--rounds N] [--optimization LEVEL]
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np

README = """
wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
robot = mr.SingleRod(wire)
inputs = robot.inputs(rotation=0.1, tip_force=(1, 0, 0))
"""
SCENE = """
from multirod.studies.scenes import load
motion = load("{name}")
robot, inputs = motion.robot, motion.inputs[0]
"""
SOLVE = "solution = mr.solve(robot, inputs, progress=False)\nsolution.raise_if_failed()\n"
ASKED = 'solution.rod(0), solution.stability, solution.jacobian("rotation")\n'
NOTHING = """
import warp as wp
from multirod.launch import record


@wp.kernel
def nothing():
    pass


record(lambda: nothing, 1, [], "cpu").launch()
"""
CASES = {
    "a kernel that does nothing": (NOTHING, "", ""),
    "README's rod": (README + SOLVE, "7.9 s", "3 s"),
    "three tubes, loaded": (SCENE.format(name="three-tubes") + SOLVE, "9.9 s", "3.5 s"),
    "six legs": (SCENE.format(name="six-legs") + SOLVE, "18.9 s", "6 s"),
    "three tubes, then shape, stability, jacobian": (SCENE.format(name="three-tubes") + SOLVE + ASKED, "30 s", "5.5 s"),
    "import multirod": ("", "2.1 s", "0.6 s"),
}


def run(code: str, cache: str, optimization: int | None) -> tuple[float, float]:
    """Processor time and wall time of a Python program [s]."""
    code = f"import warp\nwarp.config.optimization_level = {optimization}\n{code}" if optimization is not None else code
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), perf_counter()
    environment = os.environ | {"WARP_CACHE_PATH": cache}
    program = Path(cache) / "program.py"  # Warp reads the text of kernels from a file
    program.write_text(f"import multirod as mr\n{code}")
    subprocess.run([sys.executable, program], env=environment, check=True, capture_output=True)
    wall, after = perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--optimization", type=int, choices=range(4), help="Clang's level; Warp's own by default, 2")
    options = parser.parse_args(arguments)
    print(f"{'':48}{'processor time':>24}{'wall':>18}{'again':>8}{'stood before':>14}{'goal':>8}")
    for name, (code, before, goal) in CASES.items():
        times, again = [], []
        for _ in range(options.rounds):
            with tempfile.TemporaryDirectory() as cache:
                times.append(run(code, cache, options.optimization))
                again.append(run(code, cache, options.optimization)[0])
        cpu, wall = np.array(times).T
        spread = f"{np.median(cpu):.2f} s ({cpu.min():.2f} to {cpu.max():.2f})"
        print(f"{name:48}{spread:>24}{np.median(wall):>16.2f} s{np.median(again):>6.2f} s{before:>14}{goal:>8}")


if __name__ == "__main__":
    main()
