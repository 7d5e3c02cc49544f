"""README and docs as a reader uses them: each block of code runs as it stands, page by page, and prints what the page says."""

import argparse
import ast
import contextlib
import io
import re
import shlex
from pathlib import Path

import pages
import pytest

import multirod as mr
from multirod import cli
from multirod.models.backbone import passes

WITH_PROGRAMS = [page for page in pages.PAGES if any(block.language == "python" for block in pages.blocks(page))]


def name(page: Path) -> str:
    return page.relative_to(pages.ROOT).as_posix()


@pytest.mark.parametrize("page", WITH_PROGRAMS, ids=name)
def test_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(passes.WIDTH, "float64", passes.WIDTH["float64"])  # a page may set it
    namespace: dict[str, object] = {"__name__": "page"}
    shown = pages.shown(page)
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
    targets = re.findall(r"^([a-z]+):", (pages.ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
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
