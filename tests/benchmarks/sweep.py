"""What a sweep costs beside the solving: a wire under random tip forces, by size of the chunk.

python tests/benchmarks/sweep.py [--instances N]
"""

import argparse
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

import multirod as mr
from multirod.studies.experiment import wire


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--instances", type=int, default=20_000)
    count = parser.parse_args().instances
    robot = mr.SingleRod(wire())
    inputs = robot.inputs(tip_force=np.random.default_rng(1).uniform(-1, 1, (count, 3)))
    mr.solve(robot, inputs[:10])
    begin = perf_counter()
    mr.solve(robot, inputs)
    print(f"{'chunk':>8}{'µs an instance':>17}{'ms a chunk':>13}{'bytes an instance':>20}")
    print(f"{'solve':>8}{1e6 * (perf_counter() - begin) / count:17.0f}")
    for chunk in (10, 100, 1000, 10_000):
        part = inputs[: min(count, 200 * chunk)]
        number = len(part.tip_force)
        with tempfile.TemporaryDirectory() as folder:
            begin = perf_counter()
            study = mr.sweep(robot, part, out=folder, chunk=chunk, progress=False)
            taken = perf_counter() - begin
            size = sum(path.stat().st_size for path in Path(folder).glob("chunks/*"))
        print(f"{chunk:8}{1e6 * taken / number:17.0f}{1e3 * taken / study.chunk_count:13.1f}{size / number:20.0f}")


if __name__ == "__main__":
    main()
