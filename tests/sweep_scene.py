"""A small study that several processes of the sweep's tests solve; as a program, it sweeps into a folder until it is stopped."""

import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import multirod as mr

CHUNK = 4
QUANTITIES = ("condition",)


@dataclass(frozen=True, kw_only=True)
class Logged(mr.Shooting):
    """Newton's method that writes a line for each batch that it is given."""

    log: str

    def _solve(self, problem: mr.BoundaryProblem, guess: Any) -> mr.Outcome:
        with open(self.log, "a", encoding="utf-8") as file:
            file.write(f"{problem.instance_count} {os.getpid()}\n")
        return super()._solve(problem, guess)


@dataclass(frozen=True, kw_only=True)
class Refusing(mr.Shooting):
    """Newton's method that refuses a batch in which the first rod is turned by this much."""

    angle: float

    def _solve(self, problem: mr.BoundaryProblem, guess: Any) -> mr.Outcome:
        if (problem.read("inputs")[:, 0] == self.angle).any():
            raise ArithmeticError(f"{self.angle:g} rad is too much")
        return super()._solve(problem, guess)


@dataclass(frozen=True, kw_only=True)
class Dying(mr.Shooting):
    """Newton's method that kills its process, once, when the first rod is turned by this much."""

    angle: float
    died: str

    def _solve(self, problem: mr.BoundaryProblem, guess: Any) -> mr.Outcome:
        if (problem.read("inputs")[:, 0] == self.angle).any() and not Path(self.died).exists():
            Path(self.died).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return super()._solve(problem, guess)


def wire() -> mr.SingleRod:
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    return mr.SingleRod(rod)


def scene(count: int) -> tuple[mr.SingleRod, mr.Inputs]:
    robot = wire()
    force = np.random.default_rng(5).uniform(-1, 1, (count // 4, 1, 3))
    return robot, robot.inputs(tip_force=force, rotation=np.arange(4.0)[:, None])


def pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


def main(out: str, log: str, count: int, chunk: int, executor: str) -> None:
    robot, inputs = scene(count)

    def report(done: int) -> None:
        print(done, flush=True)

    try:
        mr.sweep(
            robot,
            inputs,
            out=out,
            chunk=chunk,
            solver=Logged(log=log),
            quantities=QUANTITIES,
            executor=pool if executor == "pool" else None,
            progress=report,
        )
    except KeyboardInterrupt:
        print("stopped", time.time(), sorted(p.name for p in Path(out).iterdir()), flush=True)
        raise SystemExit(3) from None


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), sys.argv[5])
