"""Measures what each test takes, and chooses what `make test` runs: `make quick-tests`.

As a plugin of pytest it writes a line for each test: seconds of processor time, its own and that of programs that it starts, and
the kernels that it asks for. As a program it reads these lines and writes the names of the tests left to `make test-all`:
those whose kernels few others share, or that take long for what they are. Each file keeps some.
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

FOLDER = "MULTIROD_TEST_COSTS"
LEFT = Path(__file__).parent.parent / "left_to_test_all.txt"
A_KERNEL = 5.0  # [s] of processor time, to make and to compile one
FIRST, FEW, FEW_WEIGHT = 100.0, 3, 3.0  # how much more the first test of a file counts, and the next ones

_asked: set[str] = set()


def pytest_configure() -> None:
    """Note each kernel that is asked for: by the package, or by a test itself, which has Warp load it."""
    import warp as wp

    from multirod import launch

    requested, load = launch._requested, wp.Module.load

    def noted(make: Callable[[], Any], device: str) -> Any:
        kernel, future = requested(make, device)
        _asked.add(kernel.module.name)
        return kernel, future

    def loaded(module: Any, *arguments: Any, **options: Any) -> Any:
        _asked.add(module.name)
        return load(module, *arguments, **options)

    launch._requested, wp.Module.load = noted, loaded


def processor_time() -> float:
    """Of this process and of those it has waited for, in s."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Note what a test takes, its fixtures included."""
    _asked.clear()
    begin = processor_time()
    result = yield
    cost = {"test": item.nodeid, "time": processor_time() - begin, "kernels": sorted(_asked)}
    with open(Path(os.environ[FOLDER]) / f"{os.getpid()}.jsonl", "a", encoding="utf-8") as file:
        file.write(json.dumps(cost) + "\n")
    return result


def read(folder: Path) -> tuple[dict[str, float], dict[str, set[str]]]:
    """Times and kernels by test function."""
    times: Counter[str] = Counter()
    kernels: dict[str, set[str]] = {}
    for file in sorted(folder.glob("*.jsonl")):
        for line in file.read_text(encoding="utf-8").splitlines():
            cost = json.loads(line)
            name = cost["test"].split("[")[0]
            times[name] += cost["time"]
            kernels.setdefault(name, set()).update(cost["kernels"])
    return dict(times), kernels


def choose(times: dict[str, float], kernels: dict[str, set[str]], budget: float) -> tuple[set[str], set[str]]:
    """Test functions that fit into a budget [s], the cheapest first, and their kernels, which are paid for once."""
    chosen: set[str] = set()
    have: set[str] = set()
    of_file: Counter[str] = Counter()
    rest = set(times)

    def cost(name: str) -> float:
        return times[name] + A_KERNEL * len(kernels[name] - have)

    def rank(name: str) -> tuple[float, str]:
        count = of_file[name.split("::")[0]]
        return cost(name) / (FIRST if count == 0 else FEW_WEIGHT if count < FEW else 1.0), name

    while rest:
        name = min(rest, key=rank)
        rest.discard(name)
        if cost(name) <= budget:
            budget -= cost(name)
            have |= kernels[name]
            chosen.add(name)
            of_file[name.split("::")[0]] += 1
    return chosen, have


def main() -> None:
    """Write the names of the tests that are left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with the lines of a run of all tests")
    parser.add_argument("--minutes", type=float, default=6.5, help="of processor time, from an empty cache of kernels")
    options = parser.parse_args()
    times, kernels = read(options.folder)
    chosen, have = choose(times, kernels, 60 * options.minutes)
    LEFT.write_text("\n".join(sorted(set(times) - chosen)) + "\n", encoding="utf-8")
    every = set().union(*kernels.values())
    print(f"{len(chosen)} of {len(times)} test functions, {len(have)} of {len(every)} kernels")
    print("files with fewer than three:")
    counts, kept = (Counter(name.split("::")[0] for name in names) for names in (times, chosen))
    for file, count in sorted(counts.items()):
        if kept[file] < min(FEW, count):
            print(f"  {file}: {kept[file]} of {count}")


if __name__ == "__main__":
    main()
