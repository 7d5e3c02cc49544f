"""Command line: ``multirod demo``, ``multirod tradeoff``, ``multirod prepare``; a module a command."""

import argparse
import sys
from collections.abc import Sequence
from io import TextIOWrapper

from rich.console import Console

from multirod import __version__
from multirod.cli import demo, prepare, tradeoff
from multirod.cli.terminal import FULL_WIDTH

INTERRUPTED = 130  # as a shell has it


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="multirod", description="Static equilibria of robots made of slender elastic rods.")
    parser.add_argument("--version", action="version", version=f"multirod {__version__}")
    commands = parser.add_subparsers(dest="command", required=True)
    for command in (demo, tradeoff, prepare):
        command.add_parser(commands)
    options = parser.parse_args(arguments)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a file, or an old terminal, may have no sign for micro
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = FULL_WIDTH
    try:
        status: int = options.run(options, console)
    except BrokenPipeError:
        return 1
    except KeyboardInterrupt:
        console.print("[yellow]stopped[/yellow]")
        return INTERRUPTED
    return status
