"""Kernels that an earlier process compiled are found by what they are made of, and called without being made again."""

import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np
import programs
import pytest
import warp as wp

import multirod as mr
from multirod.integrators import RK4, RK45
from multirod.kernels import index
from multirod.kernels.index import INDEX, Untold, kinds_of, made_of, packed
from multirod.kernels.own_module import own_module
from multirod.launch import Direct, Pending, record
from multirod.models.backbone.kernels.integration.integrate import make_kernel
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.loads.load import Load
from multirod.models.backbone.stability.conjugate_kernels import Pairs, find_displacements
from multirod.studies.scenes import load

# not optimised, kernels are compiled in half of the time
SOLVE = """
import warp as wp
wp.config.optimization_level = 0
import multirod as mr, multirod.launch as launch
from multirod.kernels.compiling import COMPILER
made, hasher = [], wp._src.context.ModuleHasher
begin = hasher.__init__
def counted(self, kernels, options):
    made.extend(kernel for kernel in kernels if "<locals>" in kernel.func.__qualname__)  # others are made as they are imported
    begin(self, kernels, options)
hasher.__init__ = counted
kinds, record = set(), launch._record
def recorded(*arguments):
    found = record(*arguments)
    kinds.add(type(found).__name__)
    return found
launch._record = recorded
robot = mr.SingleRod(mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0)))
solution = mr.solve(robot, robot.inputs(rotation=0.1, tip_force=(1, 0, 0)), progress=False)
shape = solution.rod(0).position
print(len(made), COMPILER.compiled, *sorted(kinds))
print(*sorted(COMPILER.kernels))
print(solution.tip_position.tobytes().hex(), shape.tobytes().hex())
"""


def run(folder: Path) -> tuple[list[str], str, str]:
    """What the program above says: its counts, the kernels it asked for, its numbers."""
    done = programs.run("-c", SOLVE, env={**os.environ, "WARP_CACHE_PATH": str(folder)})
    assert done.returncode == 0, done.stderr
    counts, kernels, numbers = done.stdout.splitlines()
    return counts.split(), kernels, numbers


def test_a_later_process_makes_nothing_again(tmp_path: Path) -> None:
    (made, compiled, *kinds), kernels, numbers = run(tmp_path)
    assert int(made) >= int(compiled) > 2
    assert kinds == ["Direct"]
    assert run(tmp_path) == (["0", "0"], kernels, numbers)
    # what is not there as it was is made again, and kept again
    (folder,) = tmp_path.rglob("*_index")
    files = sorted(folder.iterdir())
    assert len(files) == int(compiled)
    files[0].write_text("{")
    files[1].write_text(files[1].read_text().replace('"size": ', '"size": 1'))
    files[2].unlink()
    (made, compiled, *kinds), same, again = run(tmp_path)
    assert (made, compiled, kinds) == ("3", "0", ["Direct"])
    assert (same, again) == (kernels, numbers)
    assert run(tmp_path) == (["0", "0"], kernels, numbers)


def test_what_was_kept_is_loaded_and_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    displacements()
    key, _ = INDEX.find(find_displacements)
    assert key is not None
    for _ in range(3000):  # where it was compiled just now, the compiler's thread keeps it after others go on
        if index._file(key).exists():
            break
        sleep(0.1)
    monkeypatch.setattr(INDEX, "_known", {})
    monkeypatch.setattr("multirod.launch._requested", None)
    assert isinstance(displacements(), Direct)


def test_where_nothing_can_be_kept_all_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    monkeypatch.setattr(index, "_file", lambda key: nowhere / key)
    monkeypatch.setattr(INDEX, "_known", {})
    assert isinstance(displacements(), Direct)
    assert isinstance(displacements(), Direct)


def displacements() -> Any:
    """A recorded launch of a small kernel of the package."""
    launch = record(find_displacements, 1, [Pairs()], "cpu")
    return launch.recorded() if isinstance(launch, Pending) else launch


# ---- what a kernel is made of ----


class Foreign(Load):
    """A load that is not of the package."""


def foreign() -> wp.Kernel:
    """No more is what makes this."""
    raise AssertionError


def test_what_is_made_of_other_things_has_another_key(monkeypatch: pytest.MonkeyPatch) -> None:
    features, tableau = Features(force=True), RK4(50).tableau
    own = partial(make_kernel, features, tableau, "float64", 8)
    others = [
        partial(make_kernel, replace(features, pose=False), tableau, "float64", 8),
        partial(make_kernel, features, RK45().tableau, "float64", 8),
        partial(make_kernel, features, tableau, "float32", 8),
        partial(make_kernel, features, tableau, "float64", 4),
        partial(make_kernel, features, tableau, "float64", W=8),
        find_displacements,
    ]
    keys = {INDEX._key(maker) for maker in (own, *others)}
    assert len(keys) == 1 + len(others)
    assert None not in keys
    assert INDEX._key(partial(make_kernel, Features(force=True), RK4(20).tableau, "float64", 8)) == INDEX._key(own)
    monkeypatch.setattr(wp.config, "verify_fp", not wp.config.verify_fp)
    assert INDEX._key(own) not in keys
    monkeypatch.undo()
    assert INDEX._key(own) in keys
    monkeypatch.setattr(INDEX, "_keys", {})
    monkeypatch.setattr(index, "_texts", lambda: "another package")
    assert INDEX._key(own) not in keys


def test_a_text_that_changes_is_another_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Spec:
        submodule_search_locations = (str(tmp_path),)

    (tmp_path / "inner").mkdir()
    file = tmp_path / "inner" / "equations.py"
    monkeypatch.setattr(index, "find_spec", lambda name: Spec)
    read = index._texts.__wrapped__
    monkeypatch.setattr(index, "__file__", str(file))
    found = []
    for text in ("a", "b", "a"):
        file.write_text(text)
        monkeypatch.setattr(index, "_FILES", index._files())
        found.append(read())
    assert found[0] == found[2] != found[1]
    # nothing is known of a package without its texts
    monkeypatch.setattr(index, "__file__", str(tmp_path / "other.py"))
    with pytest.raises(Untold, match="this is not imported from texts"):
        read()
    monkeypatch.setattr(index, "__file__", str(file))
    # what was imported before may be either
    file.write_text("longer")
    with pytest.raises(Untold, match="the package has changed"):
        read()


def test_nothing_is_kept_where_the_package_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index, "_file", lambda key: tmp_path / "index" / key)
    binary = Path(wp.config.kernel_cache_dir) / "of_a_test"
    binary.write_bytes(b"")
    monkeypatch.setattr(INDEX, "_tried", set())
    INDEX.keep("key", find_displacements, binary)
    kept = tmp_path / "index" / "key"
    assert kept.exists()
    kept.unlink()
    INDEX._tried.clear()
    monkeypatch.setattr(index, "_FILES", [])
    INDEX.keep("key", find_displacements, binary)
    binary.unlink()
    assert not kept.exists()


@pytest.mark.parametrize(
    "maker",
    [
        foreign,
        lambda: foreign(),
        partial(foreign),
        partial(make_kernel, Features(loads=(Foreign,)), RK4(50).tableau),
        partial(make_kernel, np.ones(3), RK4(50).tableau),
        partial(make_kernel, [3], RK4(50).tableau),
    ],
    ids=["function", "lambda", "partial", "load", "array", "list"],
)
def test_what_cannot_be_told_is_made_as_ever(maker) -> None:
    with pytest.raises(Untold):
        made_of(maker)
    assert INDEX.find(maker) == (None, None)


def test_a_kernel_made_within_a_function_cannot_be_told() -> None:
    @own_module()
    def nothing() -> None:
        pass

    with pytest.raises(Untold):
        made_of(nothing)


# ---- what is compiled meanwhile ----


@pytest.mark.parametrize("kind", ["tubes", "legs", "held rod", "network"])
def test_what_stability_expects_is_what_it_launches(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    leg = mr.Rod(length=0.3, bending_stiffness=0.5, torsional_stiffness=0.4)
    if kind == "tubes":
        motion = load("three-tubes")
        robot, inputs = motion.robot, motion.inputs[0]
    elif kind == "legs":
        motion = load("six-legs")
        robot, inputs = motion.robot, motion.inputs[0]
    elif kind == "held rod":
        end = np.eye(4)
        end[:3, 3] = (0, 0.05, 0.27)
        robot = mr.HeldRod(leg, end=end)
        inputs = robot.inputs()
    else:
        plate = mr.Body("plate")
        joints = [mr.Joint("rod", "base", to=mr.ground), mr.Joint("rod", "tip", to=plate)]
        robot = mr.Network(rods={"rod": leg}, bodies=[plate], joints=joints, end_effector=plate)
        inputs = robot.inputs(force={"plate": (0.1, 0, 0)})
    problem = robot.problem(inputs, integrator=RK45())
    problem.write("unknowns", problem.guess())
    problem.integrate()
    asked: list[str] = []
    find = INDEX.find

    def heard(maker: Any) -> Any:
        asked.append(made_of(maker))
        return find(maker)

    monkeypatch.setattr(INDEX, "find", heard)
    problem.stability.expect()
    expected = set(asked)
    assert any("make_kernel" in each for each in expected)
    asked.clear()
    problem.stability.modes()
    assert expected <= set(asked)


# ---- its arguments ----


def test_a_kernel_over_two_axes_is_launched_by_warp() -> None:
    @own_module()
    def fill(values: wp.array2d(dtype=wp.float64)) -> None:
        i, j = wp.tid()
        values[i, j] = wp.float64(10 * i + j)

    values = wp.zeros((2, 3), dtype=wp.float64, device="cpu")
    launch = record(lambda: fill, (2, 3), [values], "cpu")
    launch.launch()
    np.testing.assert_array_equal(values.numpy(), [[0, 1, 2], [10, 11, 12]])
    with pytest.raises(TypeError, match="the bounds of a launch have one axis"):
        kinds_of(fill)


def test_an_argument_of_another_kind_is_refused() -> None:
    launch = displacements()
    numbers = wp.zeros((1, 1), dtype=wp.float64, device="cpu")
    with pytest.raises(TypeError, match=r"an argument of a kernel is array of 2, 8, and must be .* of"):
        launch.set_param_at_index(0, numbers)
    with pytest.raises(TypeError, match="an argument of a kernel is 'three', and must be c_int"):
        packed("c_int", "three")
    assert packed("c_int", np.int64(3)).value == 3
    assert kinds_of(find_displacements)[0].startswith("Pairs")


def test_kinds_of_arguments_are_those_of_the_kernel() -> None:
    @own_module()
    def several(a: wp.array[wp.float64], b: wp.array2d(dtype=wp.vec3d), pairs: Pairs, n: int, x: wp.float64) -> None:
        pass

    array, vectors = wp.zeros(2, dtype=wp.float64, device="cpu"), wp.zeros((2, 3), dtype=wp.vec3d, device="cpu")
    kinds = kinds_of(several)
    assert kinds[:2] == ("array of 1, 8", "array of 2, 24")
    assert kinds[3:] == ("c_int", "c_double")
    given = [array, vectors, Pairs(), 3, 0.5]
    for kind, value in zip(kinds, given, strict=True):
        packed(kind, value)
    for kind, value in zip(kinds, [vectors, array, array, np.ones(3), Pairs()], strict=True):
        with pytest.raises(TypeError, match="an argument of a kernel is"):
            packed(kind, value)
