"""The workspace of a three-tube robot: where its tip gets in 50,000 configurations, and how well conditioned it is there.

All configurations are solved as one batch on all cores. The recording holds the tips as a cloud of points coloured by the
condition number of ``Gamma``: high where the robot is near to snapping.
"""

import argparse
from collections.abc import Sequence
from time import perf_counter

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

import multirod as mr

LENGTHS = np.array([0.431, 0.332, 0.174])  # [m], innermost first
CURVED = (0.103, 0.113, 0.134)
CURVATURE = (21.3, 13.108, 3.5)
BENDING = (3.868e-3, 1.7168e-2, 3.9768e-2)
TORSION = (3.011e-3, 1.4018e-2, 5.0224e-2)
COLOURS = {
    "violet": (68, 1, 84),
    "blue": (59, 82, 139),
    "teal": (33, 145, 140),
    "green": (94, 201, 98),
    "yellow": (253, 231, 37),
}  # dark is well conditioned


def robot() -> mr.ConcentricTubes:
    """The tubes of the public models after M. Khadem, L. Da Cruz, C. Bergeles, IROS 2018, 4920-4926."""
    return mr.ConcentricTubes(
        [
            mr.Rod(
                length=length,
                bending_stiffness=bending,
                torsional_stiffness=torsion,
                precurvature=[(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))],
                name=name,
            )
            for name, length, curved, curvature, bending, torsion in zip(
                ("inner", "middle", "outer"), LENGTHS, CURVED, CURVATURE, BENDING, TORSION, strict=True
            )
        ]
    )


def configurations(tubes: mr.ConcentricTubes, count: int) -> mr.Inputs:
    """Angles and insertions at random: each tube shows at least 5 mm beyond the one around it."""
    random = np.random.default_rng(0)
    shown = np.array([0.005, 0.005, 0.02]) + random.uniform(0, 1, (count, 3)) * np.array([0.055, 0.04, 0.04])
    out = np.cumsum(shown[:, ::-1], axis=1)[:, ::-1]
    return tubes.inputs(rotation=random.uniform(-np.pi, np.pi, (count, 3)), translation=out - LENGTHS)


def colours(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Colours (k, 3) of numbers, from the first of ``COLOURS`` at ``low`` to the last at ``high``."""
    place = np.clip((values - low) / (high - low), 0, 1) * (len(COLOURS) - 1)
    levels = np.arange(len(COLOURS))
    return np.stack([np.interp(place, levels, part) for part in zip(*COLOURS.values(), strict=True)], axis=1).astype(np.uint8)


def main(arguments: Sequence[str] | None = None) -> mr.Solution:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="workspace.rrd")
    parser.add_argument("--configurations", type=int, default=50_000)
    options = parser.parse_args(arguments)
    tubes = robot()
    inputs = configurations(tubes, options.configurations)
    begin = perf_counter()
    solution = mr.solve(tubes, inputs, solver=mr.Shooting(integrator=mr.RK4(50)))
    took = perf_counter() - begin
    print(f"{options.configurations} configurations in {took:.1f} s: {solution}")
    record(options.out, solution)
    print(f"recorded to {options.out}; open it with: rerun {options.out}")
    return solution


def record(path: str, solution: mr.Solution) -> None:
    """Points, a few of the shapes among them, and what the colours mean."""
    found = np.isfinite(solution.condition)
    condition = np.log10(solution.condition[found])
    low, high = np.percentile(condition, [1, 99])
    with rr.RecordingStream("multirod_workspace") as stream:
        views = rrb.Horizontal(
            rrb.Spatial3DView(origin="/world"), rrb.TextDocumentView(origin="/description"), column_shares=[3, 1]
        )
        stream.save(path, default_blueprint=rrb.Blueprint(views, collapse_panels=True))
        stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("/world/base", rr.Transform3D(), rr.TransformAxes3D(0.02), static=True)
        tips = rr.Points3D(solution.tip_position[found], colors=colours(condition, low, high), radii=4e-4)
        stream.set_time("step", sequence=0)
        stream.log("/world/tips", tips)
        shown = solution[np.flatnonzero(found)[:12]]
        for k, name in enumerate(rod.name for rod in solution.assembly.rods):
            lines = rr.LineStrips3D(shown.rod(k).position, colors=(120, 120, 120), radii=(3 + 2 * k) * 1e-4)
            stream.log(f"/world/robots/{name}", lines, static=True)
        levels = np.linspace(low, high, len(COLOURS))
        legend = "\n".join(f"| {name} | {10**level:.3g} |" for level, name in zip(levels, COLOURS, strict=True))
        snapped = int((solution.status == mr.Status.LOWEST_ENERGY).sum())
        text = (
            f"# Workspace\n\n{found.sum()} tips of a three-tube robot, coloured by the condition number of Gamma "
            f"(from the 1st to the 99th percentile).\n\n| colour | condition |\n|---|---|\n{legend}\n\n"
            f"{snapped} configurations lie past a snap: there the stable equilibrium of lowest energy is shown. "
            "Twelve of the shapes are drawn."
        )
        stream.log("/description", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


if __name__ == "__main__":
    main()
