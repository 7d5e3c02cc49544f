"""Measures what each test takes, and chooses what `make test` runs: `make quick-tests`.

As a plugin of pytest it writes a line for each test: seconds of processor time, its own and that of programs that it starts, and
the kernels that it asks for, with what they take to be made. As a program it reads these lines and writes the names of the tests
left to `make test-all`: those that take long, or whose kernels few others share. Each file keeps one, unless that takes as long
as ten of others with their kernels. Tests that were not measured stay where they are, so that `make quick-tests ARGS=--quick`
leaves out some more.
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

FOLDER = "MULTIROD_TEST_COSTS"
LEFT = Path(__file__).parent.parent / "left_to_test_all.txt"
# s of processor time to make and to compile a kernel, and for each byte of it: measured of eleven, 14 to 150 kB, within a third
A_KERNEL, A_BYTE = 1.5, 1 / 18_000
# never left out: the run that the package is named for, the page that others are written from, and what rotted unseen or would
KEPT = {
    "tests/test_observer.py::test_default_observer_is_the_paper_run",
    "tests/test_examples.py::test_new_assembly_agrees_with_the_clamped_rod",
    "tests/test_mistakes.py::test_the_page_lists_what_is_said",
    "tests/test_linear_algebra.py::test_a_gpu_can_run_what_is_written_in_its_compilers_words",
    "tests/test_layout.py::test_folders_side_by_side_do_not_need_each_other",
    "tests/test_layout.py::test_no_solvers_inside_is_used_by_the_contract",
    "tests/test_multiple_shooting.py::test_poses_left_out_on_the_way_are_not_put_in_place_of_those_of_segments",
}
ALONE = 30  # s with its kernels, from which on a file is left without a test
TOGETHER = 4  # how many tests at most are left out at once, for a kernel that they share

_asked: set[str] = set()


def pytest_configure() -> None:
    """Note each kernel that is asked for: by the package, or by a test itself, which has Warp load it."""
    import warp as wp

    from multirod import launch

    load = wp.Module.load

    class Noting(set[str]):
        def add(self, name: str) -> None:
            _asked.add(name)
            super().add(name)

    def loaded(module: Any, *arguments: Any, **options: Any) -> Any:
        _asked.add(module.name)
        return load(module, *arguments, **options)

    launch.COMPILER.kernels, wp.Module.load = Noting(launch.COMPILER.kernels), loaded


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
    cost = {"test": item.nodeid, "time": processor_time() - begin, "kernels": {name: to_make(name) for name in sorted(_asked)}}
    with open(Path(os.environ[FOLDER]) / f"{os.getpid()}.jsonl", "a", encoding="utf-8") as file:
        file.write(json.dumps(cost) + "\n")
    return result


@cache
def to_make(kernel: str) -> float:
    """Seconds that a kernel took to be made, by the size of what Warp's cache has of it."""
    import warp as wp

    sizes = [file.stat().st_size for file in Path(str(wp.config.kernel_cache_dir)).glob(f"wp_{kernel}_*/*.o")]
    return A_KERNEL + A_BYTE * max(sizes, default=0)


def read(folder: Path) -> tuple[dict[str, float], dict[str, set[str]], dict[str, float]]:
    """Times and kernels by test function, and what each kernel takes."""
    times: Counter[str] = Counter()
    kernels: dict[str, set[str]] = {}
    made: dict[str, float] = {}
    for file in sorted(folder.glob("*.jsonl")):
        for line in file.read_text(encoding="utf-8").splitlines():
            cost = json.loads(line)
            name = cost["test"].split("[")[0]
            times[name] += cost["time"]
            kernels.setdefault(name, set()).update(cost["kernels"])
            made |= cost["kernels"]
    return dict(times), kernels, made


def choose(
    times: dict[str, float], kernels: dict[str, set[str]], made: dict[str, float], budget: float
) -> tuple[set[str], set[str]]:
    """Test functions that fit into a budget [s], and their kernels, which are paid for once: without what saves most for each."""
    chosen = set(times)
    while True:
        users: dict[str, set[str]] = {}
        for name in chosen:
            for kernel in kernels[name]:
                users.setdefault(kernel, set()).add(name)
        if sum(times[name] for name in chosen) + sum(made[kernel] for kernel in users) <= budget:
            return chosen, set(users)
        of_file = Counter(_file(name) for name in chosen)

        def saved(left: frozenset[str], users: dict[str, set[str]] = users) -> float:
            unused = {kernel for name in left for kernel in kernels[name] if users[kernel] <= left}
            return (sum(times[name] for name in left) + sum(made[kernel] for kernel in unused)) / len(left)

        groups = {frozenset([name]) for name in chosen} | {frozenset(u) for u in users.values() if len(u) <= TOGETHER}
        groups = {
            left
            for left in groups
            if not left & KEPT and (saved(left) > ALONE or all(n < of_file[f] for f, n in Counter(map(_file, left)).items()))
        }
        if not groups:
            return chosen, set(users)
        chosen -= max(groups, key=lambda left: (saved(left), sorted(left)))


def _file(name: str) -> str:
    return name.split("::")[0]


def main() -> None:
    """Write the names of the tests that are left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with the lines of a run of all tests")
    parser.add_argument("--minutes", type=float, default=8.5, help="of processor time, from an empty cache of kernels")
    options = parser.parse_args()
    times, kernels, made = read(options.folder)
    chosen, have = choose(times, kernels, made, 60 * options.minutes)
    stay = {name for name in LEFT.read_text(encoding="utf-8").split("\n") if name and name not in times}
    LEFT.write_text("\n".join(sorted(stay | set(times) - chosen)) + "\n", encoding="utf-8")
    print(f"{len(chosen)} of {len(times)} test functions, {len(have)} of {len(made)} kernels")


if __name__ == "__main__":
    main()
