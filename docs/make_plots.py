"""The plots on pages: runs the code of the pages that have some, and examples; writes each picture to docs/images.

python docs/make_plots.py [--out FOLDER]
"""

import argparse
import os
import re
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from runpy import run_path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PICTURES = {
    "README.md": {"readme": "solution.plot()"},
    "docs/plotting.md": {
        "plot_shape": "solution.plot()",
        "plot_curvature": 'solution.plot("curvature")',
        "plot_hexapod": "loaded.plot()",
        "plot_hexapod_moment": 'loaded.plot("moment")',
        "plot_family": 'batch.plot(colour_by=force, colour_label="tip force along x [N]")',
        "plot_tips": 'reached.plot("tips", colour_by=pushed[:, 0], colour_label="inner tube [m]")',
        "plot_history": "history.plot()",
        "plot_tip": 'history.plot("tip")',
    },
    "docs/branches.md": {"plot_snap": 'history.plot("tip")'},
}  # of each page, and each a line of it
EXAMPLES = (
    "paper_rod",
    "surgical_tubes",
    "six_legs",
    "fluidic_segment",
    "silicone_segment",
    "parallel_tubes",
    "stacked_platforms",
    "braced_tower",
    "design_tubes_by_gradient",
)
DPI = 80


def run_page(page: Path) -> dict[str, Any]:
    """Run all blocks of a page, and return their names."""
    scope: dict[str, Any] = {}
    for code in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        exec(code, scope)
    return scope


def draw(page: Path, pictures: Mapping[str, str], folder: Path) -> None:
    """Run a page and write its pictures."""
    from matplotlib import pyplot

    scope = run_page(page)
    for name, line in pictures.items():
        pyplot.close("all")
        axes = eval(line, scope)
        figure = axes.flat[0].figure if hasattr(axes, "flat") else axes.figure
        figure.savefig(folder / f"{name}.png", dpi=DPI, bbox_inches="tight", metadata={"Software": None})


def main(arguments: Sequence[str] | None = None) -> None:
    """Write all pictures."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images")
    folder = parser.parse_args(arguments).out.resolve()
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as scratch:
        os.chdir(scratch)  # where pages write their files
        try:
            for page, pictures in PICTURES.items():
                draw(ROOT / page, pictures, folder)
            sys.path.insert(0, str(ROOT / "examples"))  # some are about the robots of others
            for name in EXAMPLES:
                run_path(str(ROOT / "examples" / f"{name}.py"))["main"](["--out", str(folder / f"{name}.png")])
        finally:
            os.chdir(before)
            pyplot.close("all")


if __name__ == "__main__":
    main()
