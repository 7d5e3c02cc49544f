"""Where each coupling of the observer works: concentric tubes that turn against each other, from weakly to strongly curved.

Each row is a run of at most 10 s at 200 Hz up to where the equilibrium snaps, if it does: the mean boundary error
after 0.5 s in units of 1/m, the largest, and in how many samples the status warned.
"""

import argparse
from collections.abc import Sequence

import numpy as np

import multirod as mr

CURVES = {"6, 5 1/m, 0.2 N": ((6, 5), 0.2), "8, 7 1/m, 0.5 N": ((8, 7), 0.5), "14, 12 1/m, 0.2 N": ((14, 12), 0.2)}
CURVES["three tubes, 9, 6, 4 1/m, 0.1 N"] = ((9, 6, 4), 0.1)
# length, length of the curved end, outer and inner diameter, base: of each tube
PAIR = ((0.3, 0.2), (0.2, 0.1), (1.0e-3, 1.6e-3), (0.6e-3, 1.1e-3), (-0.1, -0.06))
TRIPLE = ((0.4, 0.3, 0.2), (0.15, 0.1, 0.08), (0.8e-3, 1.2e-3, 1.8e-3), (0.4e-3, 0.9e-3, 1.3e-3), (-0.1, -0.05, -0.02))
FORMS = {"full": {}, "per-rod": {"coupling": "per-rod"}, "plain": {"coupling": "per-rod-plain"}}
FORMS["full, ff"] = {"feed_forward": True}
FORMS["per-rod, ff"] = {"coupling": "per-rod", "feed_forward": True}
FORMS["per-rod, ff, newton"] = {"coupling": "per-rod", "feed_forward": True, "scaling": "newton"}


def robot(curvatures: Sequence[float]) -> mr.ConcentricTubes:
    tubes = []
    for u, length, curved, outer, inner, _ in zip(curvatures, *(PAIR if len(curvatures) == 2 else TRIPLE), strict=True):
        sections = [(length - curved, (0, 0, 0)), (curved, (u, 0, 0))]
        modulus = {"young_modulus": 60e9, "shear_modulus": 23e9}
        tubes.append(mr.Rod.tube(length=length, outer_diameter=outer, inner_diameter=inner, precurvature=sections, **modulus))
    return mr.ConcentricTubes(tubes)


def main(arguments: Sequence[str] | None = None) -> dict[str, dict[str, float]]:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--time", type=float, default=10.0, help="longest duration [s]")
    time = np.arange(0, parser.parse_args(arguments).time, 0.005)
    w, errors = 2 * np.pi / 10 * time[:, None], {}
    for case, (curvatures, force) in CURVES.items():
        tubes, n = robot(curvatures), len(curvatures)
        base = np.array((PAIR if n == 2 else TRIPLE)[4]) + 0.005 * np.sin(w + np.arange(n))
        load = force * np.concatenate([np.sin(w), np.cos(w), np.sin(w)], axis=1)
        inputs = tubes.inputs(rotation=w * np.array([1, -0.5, -1])[:n], translation=base, tip_force=load)
        newton = mr.simulate(tubes, inputs, time=time, solver=mr.Shooting(integrator=mr.RK4(50)))
        end = len(time) if (newton.status == mr.Status.CONVERGED).all() else int(np.argmax(newton.status != mr.Status.CONVERGED))
        print(f"{case}: {time[end - 1]:.2f} s, smallest singular value {np.nanmin(newton.smallest_singular_value[:end]):.2g}")
        errors[case] = {}
        for form, options in FORMS.items():
            solver = mr.Observer(integrator=mr.RK4(50), **options)
            history = mr.simulate(tubes, inputs[:end], time=time[:end], solver=solver)
            residual = np.linalg.norm(history.boundary_residual, axis=-1)[min(100, end // 2) :]
            warned = np.mean(history.status != mr.Status.TRACKING)
            errors[case][form] = float(np.mean(residual))
            print(f"  {form:20s} mean {np.mean(residual):8.2g}  max {np.max(residual):8.2g}  warned {warned:4.0%}")
    return errors


if __name__ == "__main__":
    main()
