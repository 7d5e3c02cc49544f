"""Markdown pages as programs: their blocks of code, and what they show of the output."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "reference").glob("*.md")))
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?(?![\w.]*\w)")
DIGITS = 5e-3  # of a number: three digits, as pages print them
NOTHING = 1e-9  # what stands for zero and differs from machine to machine


@dataclass(frozen=True)
class Block:
    """A block of a page: its language (``indented`` if not fenced; ``python no-run`` is not run), its text, its line."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    """All blocks of a page in their order."""
    lines = page.read_text(encoding="utf-8").splitlines()
    k = 0
    while k < len(lines):
        fence = re.match(r"```+(\w*(?: no-run)?)", lines[k])
        start = k + 1
        if fence:
            k = next(j for j in range(start, len(lines)) if lines[j].startswith("```"))
            yield Block(fence[1], "\n".join(lines[start:k]) + "\n", start + 1)
        elif lines[k].startswith("    ") and (k == 0 or not lines[k - 1].strip()):
            end = k
            while end < len(lines) and (lines[end].startswith("    ") or not lines[end].strip()):
                end += 1
            yield Block("indented", "\n".join(line[4:] for line in lines[k:end]).rstrip() + "\n", start)
            k = end - 1
        k += 1


def shown(page: Path) -> dict[int, str]:
    """What a page says that a block prints: the ``text`` block right after it, by the line of the program."""
    found = list(blocks(page))
    lines = page.read_text(encoding="utf-8").splitlines()
    result = {}
    for program, output in pairwise(found):
        between = lines[program.line - 1 + program.text.count("\n") + 1 : output.line - 2]
        if program.language == "python" and output.language == "text" and not any(map(str.strip, between)):
            result[program.line] = output.text
    return result


def same_output(said: str, printed: str) -> bool:
    """Whether two outputs have the same words, and the same numbers to three digits."""
    if NUMBER.sub("#", said).split() != NUMBER.sub("#", printed).split():
        return False
    pairs = zip(map(float, NUMBER.findall(said)), map(float, NUMBER.findall(printed)), strict=True)
    return all(abs(a - b) <= max(DIGITS * abs(a), NOTHING) for a, b in pairs)


def shell_lines(page: Path) -> Iterator[str]:
    """Commands that a page gives for a shell, without comments."""
    for block in blocks(page):
        if block.language in ("sh", "indented"):
            for line in block.text.replace("\\\n", " ").splitlines():
                command = re.sub(r"\s+#.*", "", line.removeprefix("$ ")).strip()
                if re.match(r"(\w+=\S+ )*(multirod|make|python\d?|pytest|pip|rerun) ", command):
                    yield command
