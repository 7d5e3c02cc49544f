"""Programs that tests start: none outlives its test, and none is waited for without a limit."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PYTHON = (sys.executable, "-X", "faulthandler")  # a crash says where
GUARD = 900.0  # [s] against what hangs, not against what is slow: half of the time limit of a test


def run(*arguments: str, **options: Any) -> "subprocess.CompletedProcess[str]":
    """What a Python program came to."""
    return subprocess.run([*PYTHON, *arguments], capture_output=True, text=True, timeout=GUARD, **options)


@contextmanager
def started(*arguments: str) -> Iterator["subprocess.Popen[str]"]:
    """A Python program that runs, and is killed in the end if it still does."""
    with subprocess.Popen([*PYTHON, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def processor_time(pid: int) -> float:
    """What a process has taken so far [s], as Linux says."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def answers(pid: int) -> bool:
    """Whether a process is neither stopped nor dead, as Linux says."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "TZX"
    except FileNotFoundError:
        return False
