"""README and docs as a reader uses them: each block of code runs as it stands, page by page, and prints what the page says."""

import argparse
import ast
import contextlib
import io
import re
import runpy
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pages
import pytest
import yaml

import multirod as mr
from multirod import cli
from multirod.models.backbone.passes import lane_pass

WITH_PROGRAMS = [page for page in pages.PAGES if any(block.language == "python" for block in pages.blocks(page))]


def name(page: Path) -> str:
    return page.relative_to(pages.ROOT).as_posix()


@pytest.fixture
def nothing_drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    yield
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


@pytest.mark.usefixtures("nothing_drawn")
@pytest.mark.parametrize("page", WITH_PROGRAMS, ids=name)
def test_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(lane_pass.WIDTH, "float64", lane_pass.WIDTH["float64"])  # a page may set it
    namespace: dict[str, object] = {"__name__": "page"}
    shown = pages.shown(page)
    with np.printoptions():  # a page may set them
        for block in pages.blocks(page):
            if block.language == "python":
                tree = ast.parse("\n" * (block.line - 1) + block.text)
                with contextlib.redirect_stdout(io.StringIO()) as printed:
                    exec(compile(tree, str(page), "exec"), namespace)
                said = shown.get(block.line)
                if said is not None:
                    assert pages.same_output(said, printed.getvalue()), f"line {block.line} prints:\n{printed.getvalue()}"


@pytest.mark.parametrize("page", pages.PAGES, ids=name)
def test_programs_are_marked_as_such(page: Path) -> None:
    for block in pages.blocks(page):
        if block.language in ("", "indented", "text"):
            assert not re.search(r"^(import |from \w+ import |\w+ = mr\.|mr\.\w+\()", block.text, re.MULTILINE), block


@pytest.mark.parametrize("page", pages.PAGES, ids=name)
def test_commands_can_be_given(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Parsed(Exception): ...

    parse = argparse.ArgumentParser.parse_args

    def parsed(self: argparse.ArgumentParser, *arguments: object) -> None:
        parse(self, *arguments)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parsed)
    targets = re.findall(r"^([a-z-]+):", (pages.ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for command in pages.shell_lines(page):
        words = [word for word in shlex.split(command) if not re.fullmatch(r"\w+=\S+", word)]
        if words[0] == "multirod":
            with pytest.raises(Parsed):
                cli.main(words[1:])
        elif words[0] == "make":
            assert words[1] in targets, command
        elif words[0] == "python" and words[1].startswith(("tests", "examples")):
            assert (pages.ROOT / words[1]).is_file(), command


@pytest.mark.parametrize("page", pages.PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not re.match(r"\w+:", target):
            assert (page.parent / target).exists(), target


SHAPES = {
    "(..., rods)": lambda spec: spec.per_rod,
    "(..., lines)": lambda spec: spec.count,
    "(..., 3)": lambda spec: not spec.per_rod,
}


def robots_of_the_page() -> dict[str, mr.Assembly]:
    rod = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06)
    lines = [mr.Tendon(offset=(0.008, 0)), mr.PushRod(offset=(0, 0.008)), mr.Chamber(offset=(0, -0.008), area=2e-5)]
    driven = mr.Rod(length=0.4, bending_stiffness=0.2, torsional_stiffness=0.06, lines=lines)
    poses = np.tile(np.eye(4), (6, 1, 1))
    legs = mr.ParallelRods(legs=[rod] * 6, base=poses, platform=poses)
    robots = mr.SingleRod(driven), mr.ConcentricTubes([rod]), mr.EccentricTubes([rod], [(0, 0)]), legs, legs.inverse()
    return {type(robot).__name__: robot for robot in robots}


@pytest.mark.parametrize("robot", robots_of_the_page().values(), ids=lambda robot: type(robot).__name__)
def test_robots_md_lists_the_inputs_of_each_robot(robot: mr.Assembly) -> None:
    text = (pages.ROOT / "docs" / "robots.md").read_text(encoding="utf-8")
    parts = re.split(r"^#+ (.*)$", text, flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    listed = {}
    for title in (type(robot).__name__, "Loads"):
        for row in re.findall(r"^\| `\w+` \| \(.*\|$", sections[title], re.MULTILINE):
            called, shape, unit, frame, _ = (cell.strip() for cell in row.strip("|").split("|"))
            listed[called.strip("`")] = shape, unit, frame
    if "take no `gravity` and no `magnetic_field`" in sections[type(robot).__name__]:
        del listed["gravity"], listed["magnetic_field"]
    specs = {spec.name: spec for spec in robot.input_specs}
    assert listed.keys() == specs.keys()
    for called, (shape, unit, frame) in listed.items():
        assert unit == specs[called].unit, called
        assert SHAPES[shape](specs[called]), called
        if frame in ("world", "tip", "platform"):
            assert f"{frame} frame" in specs[called].description, called


def test_the_site_is_of_all_pages(tmp_path: Path) -> None:
    """The contents tree names every page once, in the order of the index; what the index leaves out stands last."""
    conf = runpy.run_path(str(pages.ROOT / "docs" / "conf.py"))
    index = (pages.ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    trees = re.findall(r"```\{toctree\}\n(?::.*\n)*\n((?:.+\n)*?)```", conf["contents"]("README", index))
    names = [name for tree in trees for name in tree.split()]
    assert names[0] == "quickstart"
    assert sorted(names) == sorted({page.stem for page in (pages.ROOT / "docs").glob("*.md")} - {"README"} | {"reference/README"})


@pytest.mark.parametrize("page", pages.PAGES, ids=name)
def test_equations_are_numbered_once_and_stand_alone(page: Path) -> None:
    equations = [block.text for block in pages.blocks(page) if block.language == "math"]
    numbers = [number for text in equations for number in re.findall(r"\\tag\{(.*?)\}", text)]
    assert len(set(numbers)) == len(numbers)
    assert not any(r"\\" in text or "\n\n" in text for text in equations), "GitHub and the site break lines differently"


def test_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((pages.ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == mr.__version__
    assert cited["license"] == "MIT"
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()


def test_outputs_are_compared_to_three_digits() -> None:
    assert pages.same_output("tip [0.1001 0. -2e-15] m", "tip  [0.1002 0.    1e-16]  m")
    assert not pages.same_output("tip 0.1001", "tip 0.1012")
    assert not pages.same_output("tip 0.1001", "top 0.1001")


def test_the_reference_has_every_public_name_once() -> None:
    listed = [
        found
        for page in (pages.ROOT / "docs" / "reference").glob("*.md")
        for found in re.findall(r"^\| `(\w+)`", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert sorted(listed) == sorted(mr.__all__)
