"""``multirod prepare``: kernels compiled before they are needed."""

import argparse
from time import perf_counter

from rich.console import Console
from rich.markup import escape

from multirod.kernels.compiling import CompileError, cache
from multirod.studies.scenes import SCENES, Motion, load

_DESCRIPTION = f"""\
Compile the kernels of scenes, several at a time, so that no first call waits for them: those of a solve and of a motion by the
default solver, of shapes, of stability, and of the Jacobian by each input that is not zero.

SCENE is {", ".join(SCENES)}, or module:function of your own: a function without arguments that returns a robot, its inputs and
times. Modules are looked for in the working directory too. Without one, all that have a name.

Exit status: 0; 1 if a kernel cannot be compiled; 2 for a wrong argument; 130 after Ctrl-C."""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "prepare",
        help="compile the kernels of scenes, so that no first call waits for them",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scene", metavar="SCENE", nargs="*", help=f"{', '.join(SCENES)}, or module:function (default: all names)")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, console: Console) -> int:
    """Compile the kernels of scenes; returns the exit status."""
    motions: dict[str, Motion] = {}
    for name in options.scene or SCENES:
        try:
            motions[name] = load(name)
        except (TypeError, ValueError) as error:
            console.print(f"[red]{escape(str(error))}[/red]")
            return 2
    for name, motion in motions.items():
        begin = perf_counter()
        first = motion.inputs[0] if motion.inputs.batch_shape else motion.inputs
        try:
            count = motion.robot.compile(motion.inputs, jacobian=first.active, stability=True, motion=True)
        except CompileError as error:
            console.print(f"[red]{escape(str(error))}[/red]")
            return 1
        took = f"{count} kernels compiled in {perf_counter() - begin:.0f} s" if count else "nothing to compile"
        console.print(f"{escape(name)}: {took}")
    console.print(f"Kept in {escape(cache())}", style="dim", soft_wrap=True)
    return 0
