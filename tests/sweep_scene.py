"""A small study that several processes of the sweep's tests solve; as a program, it sweeps into a folder until it is stopped."""

import os
import signal
import struct
import sys
import time
from argparse import ArgumentParser
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

import multirod as mr

CHUNK = 4
PAUSE = 0.01  # s for each chunk, so that a machine however fast is not done before it is stopped
QUANTITIES = ("condition",)


@dataclass(frozen=True, kw_only=True)
class Logged(mr.Shooting):
    """Newton's method that writes a line for each batch that it is given, and pauses [s]."""

    log: str
    pause: float = 0.0

    def _solve(self, problem: mr.BoundaryProblem, guess: Any) -> mr.Outcome:
        with open(self.log, "a", encoding="utf-8") as file:
            file.write(f"{problem.instance_count} {os.getpid()}\n")
        time.sleep(self.pause)
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
    """Newton's method that sends its process a signal, once, when the first rod is turned by this much.

    With ``midway``, when half of a result is in the pipe of the pool whose worker it is.
    """

    angle: float
    died: str
    how: int = signal.SIGKILL
    midway: bool = False

    def _solve(self, problem: mr.BoundaryProblem, guess: Any) -> mr.Outcome:
        if (problem.read("inputs")[:, 0] == self.angle).any() and not Path(self.died).exists():
            Path(self.died).write_text(str(os.getpid()))
            if self.midway:
                write_half_a_result()
            os.kill(os.getpid(), self.how)
        return super()._solve(problem, guess)


def write_half_a_result() -> None:
    """Four bytes of a message of a thousand, where the worker of a process pool writes its results."""
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000) + b"half")


def wire() -> mr.SingleRod:
    rod = mr.Rod(length=0.4, bending_stiffness=0.223349, torsional_stiffness=0.063814, precurvature=(14, 5, 0))
    return mr.SingleRod(rod)


def scene(count: int) -> tuple[mr.SingleRod, mr.Inputs]:
    robot = wire()
    force = np.random.default_rng(5).uniform(-1, 1, (count // 4, 1, 3))
    return robot, robot.inputs(tip_force=force, rotation=np.arange(4.0)[:, None])


def pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


def main(out: str, log: str, count: int, chunk: int, executor: str, died: str, how: int, midway: bool) -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # who starts this may ignore it
    robot, inputs = scene(count)
    solver = Dying(angle=1.0, died=died, how=how, midway=midway) if died else Logged(log=log, pause=PAUSE)

    def report(done: int) -> None:
        print(done, flush=True)

    try:
        mr.sweep(
            robot,
            inputs,
            out=out,
            chunk=chunk,
            solver=solver,
            quantities=QUANTITIES,
            executor=pool if executor == "pool" else None,
            progress=report,
        )
    except KeyboardInterrupt:
        print("stopped", sorted(p.name for p in Path(out).iterdir()), flush=True)
        raise SystemExit(3) from None


if __name__ == "__main__":
    parser = ArgumentParser()
    parser.add_argument("out")
    parser.add_argument("log")
    parser.add_argument("count", type=int)
    parser.add_argument("chunk", type=int)
    parser.add_argument("--executor", default="here")
    parser.add_argument("--died", default="")
    parser.add_argument("--how", type=int, default=int(signal.SIGKILL))
    parser.add_argument("--midway", action="store_true")
    main(**vars(parser.parse_args()))
