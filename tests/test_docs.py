"""What the documents say of themselves: tables are whole, and documented defaults are the defaults."""

import re
import sys
from pathlib import Path

import pytest

import multirod as mr

PAGES = sorted((Path(__file__).parent.parent / "docs").glob("*.md"))


def cells(row: str) -> int:
    """Columns of a row; a bar in code is none."""
    return re.sub(r"`[^`]*`|\\\|", "", row).count("|")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_tables_are_whole(page: Path) -> None:
    lines = page.read_text(encoding="utf-8").splitlines()
    for k, line in enumerate(lines):
        if re.fullmatch(r"\|[-|: ]+\|", line):
            assert lines[k - 1].startswith("|"), f"line {k}: a table begins in the middle of a line"
            rows = [lines[k - 1], line]
            rows += [
                row for row in lines[k + 1 :][: next((j for j, r in enumerate(lines[k + 1 :]) if not r.startswith("|")), None)]
            ]
            assert all(row.rstrip().endswith("|") for row in rows), f"line {k}: a table ends in the middle of a line"
            assert len({cells(row) for row in rows}) == 1, f"line {k}: rows of unequal length"


def test_the_documented_default_of_critical_loads_is_its_default() -> None:
    said = re.search(r"solver: ``(.*?)`` by default", mr.critical_loads.__doc__)[1]
    public = {name: getattr(mr, name) for name in mr.__all__} | {"L": 0.4}
    module = sys.modules["multirod.studies.critical_loads"]
    integrator = mr.RK45(steps=module.STEPS)
    default = mr.Shooting(tolerance=module.PRECISE / 0.4, integrator=integrator, max_integrations=module.SEARCHED)
    assert eval(said, public) == default
    assert eval(said, public).integrator == default.integrator


def test_statuses_are_those_of_the_package() -> None:
    page = (PAGES[0].parent / "statuses.md").read_text(encoding="utf-8")
    rows = [tuple(part.strip() for part in row.split("|")[1:4]) for row in re.findall(r"^\| `.*", page, re.MULTILINE)]
    assert rows == [(f"`{s.name}`", "no" if s.failed else "yes", s.message) for s in mr.Status]
    (events,) = re.findall(r"^A status with a result is an event.*?:\n(.*?)\.", page, re.MULTILINE | re.DOTALL)
    assert set(re.findall(r"`(\w+)`", events)) == {s.name for s in mr.Status if s.event}
