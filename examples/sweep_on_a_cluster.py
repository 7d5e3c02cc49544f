"""A study of a wire under forces from all sides, on a Dask cluster: that of a scheduler, or a small one on this machine.

Needs ``pip install "multirod[dask]"``. Stop it whenever you like, and start it again: it goes on.
"""

import argparse
from collections.abc import Sequence

import numpy as np
from distributed import Client, LocalCluster

import multirod as mr


def scene(count: int) -> tuple[mr.SingleRod, mr.Inputs]:
    """A wire, and forces of 20 sizes in so many directions."""
    robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
    directions = np.random.default_rng(1).normal(size=(count, 1, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    size = np.linspace(0.1, 2.0, 20)[:, None]  # [N]
    return robot, robot.inputs(tip_force=size * directions)


def main(arguments: Sequence[str] | None = None) -> mr.Study:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="wire_study", help="folder of the study")
    parser.add_argument("--scheduler", help="address such as tcp://10.0.0.1:8786; without one, workers are started here")
    parser.add_argument("--workers", type=int, default=2, help="how many are started here")
    parser.add_argument("--directions", type=int, default=2000, help="of the force")
    parser.add_argument("--chunk", type=int, default=1000)
    options = parser.parse_args(arguments)
    robot, inputs = scene(options.directions)
    if options.scheduler:
        with Client(options.scheduler) as client:
            study = run(client, robot, inputs, options)
    else:
        # one thread a worker: several workers, not threads within one, share the work
        with (
            LocalCluster(n_workers=options.workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            study = run(client, robot, inputs, options)
    print(study)
    deflection = np.linalg.norm(study["tip_position"] - mr.solve(robot).tip_position, axis=-1)
    print(f"the tip moves by up to {1e3 * np.nanmax(deflection):.0f} mm")
    return study


def run(client: Client, robot: mr.SingleRod, inputs: mr.Inputs, options: argparse.Namespace) -> mr.Study:
    workers = len(client.scheduler_info()["workers"])
    return mr.sweep(
        robot, inputs, out=options.out, chunk=options.chunk, executor=client.get_executor(), in_flight=2 * max(workers, 1)
    )


if __name__ == "__main__":
    main()
