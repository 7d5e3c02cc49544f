"""Problems kept between calls: making one takes longer than one rod's integrations."""

import os
from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Any, TypeVar
from weakref import ref

import warp as wp

from multirod.assembly import Assembly
from multirod.batch import IntArray
from multirod.inputs import Inputs
from multirod.problem import SMALL, BoundaryProblem

MOST = 32  # problems kept in all; the one that was not asked for longest goes first
ROOM = 2 * SMALL  # numbers in the records of all of them: some ten times as many are kept with them

Maker = TypeVar("Maker", bound=Callable[..., Any])


def reusable(make: Maker) -> Maker:
    """Mark a method ``problem`` whose problems depend on nothing but the robot and its arguments: they may serve again."""
    make.reusable = True  # type: ignore[attr-defined]
    return make


class Kept:
    """Problems that no one works on, by robot and what is compiled in; any thread may take one, which is then its own."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin anew, as a process must that was forked: another thread of its parent may have held the lock."""
        self._lock = Lock()
        self._problems: OrderedDict[int, tuple[Any, BoundaryProblem, Any]] = OrderedDict()
        self._by_key: dict[Any, list[int]] = {}
        self._next = 0
        self._size = 0
        self._orphaned = False  # whether a robot of one that is kept is no more

    def take(self, robot: Assembly, key: "Key") -> BoundaryProblem | None:
        """A problem of this robot, out of what is kept; None if there is none."""
        with self._lock:
            for number in reversed(self._by_key.get(key, ())):
                owner, problem, _ = self._problems[number]
                if owner() is robot:
                    self._remove(number)
                    return problem
        return None

    def put(self, robot: Assembly, key: "Key", problem: BoundaryProblem) -> None:
        """Keep a problem that no one works on."""
        with self._lock:
            self._problems[self._next] = ref(robot, self._orphan), problem, key
            self._by_key.setdefault(key, []).append(self._next)
            self._next += 1
            self._size += problem.records.size
            if self._orphaned:
                self._orphaned = False
                for number in [number for number, (owner, _, _) in self._problems.items() if owner() is None]:
                    self._remove(number)
            while len(self._problems) > MOST or self._size > ROOM:
                self._remove(next(iter(self._problems)))

    def _orphan(self, _: object) -> None:
        """Noted alone: a robot may go while the lock is held."""
        self._orphaned = True

    def _remove(self, number: int) -> None:
        _, problem, key = self._problems.pop(number)
        self._size -= problem.records.size
        numbers = self._by_key[key]
        numbers.remove(number)
        if not numbers:
            del self._by_key[key]


KEPT = Kept()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=KEPT.forget)


class Key:
    """What a problem must have in common with one that is to serve in its place, whose hash is found once: an integrator's takes
    as long as the rest of a look.

    Args:
        parts: What is compared.
    """

    __slots__ = ("_hash", "_parts")

    def __init__(self, parts: Hashable) -> None:
        self._parts, self._hash = parts, hash(parts)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Key) and self._parts == other._parts


class Loan:
    """A problem for as long as it is needed: within it, it is the borrower's; after an error it is not used again."""

    __slots__ = ("_key", "_robot", "problem")

    def __init__(self, robot: Assembly, key: Key | None, problem: BoundaryProblem) -> None:
        self._robot, self._key, self.problem = robot, key, problem

    def __enter__(self) -> BoundaryProblem:
        return self.problem

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is None and self._key is not None and self.problem.may_be_kept:
            KEPT.put(self._robot, self._key, self.problem)


def borrowed(
    robot: Assembly,
    inputs: Inputs,
    *,
    instances: IntArray | None = None,
    device: str = "cpu",
    **options: Any,  # noqa: ANN401  (of the robot's own ``problem``)
) -> Loan:
    """``robot.problem(inputs, ...)`` for as long as it is needed: on the CPU it may be one that was made before, as new.

    It is made, or taken from what is kept, by this call; the context that comes back gives it back. What is read from it must be
    copied.
    """
    key = None
    if instances is not None and len(instances) and not robot.batch_shape and _is_reusable(robot, inputs):
        inputs, instances = inputs.take(inputs.batch_shape, instances), None
    if instances is None and wp.get_device(device).is_cpu and _is_reusable(robot, inputs):
        key = _key(robot, inputs, options)
    problem = None if key is None else KEPT.take(robot, key)
    if problem is None or not problem.renew(inputs):
        problem = robot.problem(inputs, instances=instances, device=device, **options)
    return Loan(robot, key, problem)


def _is_reusable(robot: Assembly, inputs: Inputs) -> bool:
    return not inputs.profiles and getattr(robot.problem, "reusable", False)


def _key(robot: Assembly, inputs: Inputs, options: dict[str, Any]) -> Key | None:
    """Of a problem; None where none can serve in its place."""
    try:
        return Key((id(robot), inputs.batch_shape, inputs.active, tuple(options.items())))
    except TypeError:  # an integrator of one's own
        return None
