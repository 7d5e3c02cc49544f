"""The unloaded robot: its legs taken for beams, and a platform where they hold it. Numbers are those of ``docs/parallel.md``."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray, solved_each
from multirod.capabilities import Loading
from multirod.kernels.shared import Shared
from multirod.models.backbone.stability.conjugates import GIVE
from multirod.models.platform.starting.guess import (
    COMPLIANCES,
    SHORT,
    Attachments,
    BeamEquilibrium,
    Legs,
    beam_reach,
    fitted_platform,
    straight_legs,
    tip_answers,
)
from multirod.status import BoolArray
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.platform.problem import ParallelProblem


LEG_STEPS = 8  # by which a leg is led to its attachment
SETTLED = 0.3  # of its unknowns: after a step that is no longer it is there, near enough


@dataclass(frozen=True)
class Closed:
    """The unloaded robot at certain inputs.

    Attributes:
        unknowns: [1/m], shape (instance_count, n).
        residual: What is left of it there [1/m], shape (instance_count, n).
        gamma: ``Gamma`` there, shape (instance_count, n, n).
        tried: How many guesses were looked at, shape (instance_count,).
        near: Where Newton's step from there is short, shape (instance_count,).
    """

    unknowns: FloatArray
    residual: FloatArray
    gamma: FloatArray
    tried: IntArray
    near: BoolArray

    @cached_property
    def singular_value(self) -> FloatArray:
        """Smallest of ``gamma``, 1 at most, shape (instance_count,)."""
        sound = np.isfinite(self.gamma).all(axis=(1, 2))
        least = np.ones(len(self.gamma))
        least[sound] = np.minimum(1.0, np.linalg.svd(self.gamma[sound], compute_uv=False)[:, -1])
        return least


class Closing:
    """How a ``ParallelProblem`` is closed where no load acts yet."""

    def __init__(self, problem: "ParallelProblem") -> None:
        self.problem = problem
        self._found: Closed | None = None

    @property
    def integrations(self) -> NDArray[np.int_] | int:
        """That it takes, or took, to close each instance."""
        return 1 + (len(COMPLIANCES) if self._found is None else self._found.tried)

    def begin(self) -> FloatArray:
        """Unknowns where loads are zero; what the residual is there is remembered and closes as they are raised, (9)."""
        closed = self.closed()
        self.aside["opening"].write(closed.residual)
        self.aside["soft"].write(0.0)
        return np.array(closed.unknowns)

    def closed(self) -> "Closed":
        """The unloaded robot at the present inputs; found once for all who ask."""
        inputs = self.problem.read("inputs")[:, : self.problem.robots.loads]
        self._found = self.problem.found_for("closed", inputs, self._close)
        return self._found

    def _close(self) -> "Closed":
        with self.unloaded():
            x, legs, at = self.unloaded_legs()
            return Closed(*(self._leg_by_leg(x, legs, at) if self.problem.inverse else self._best(self._bent(x, legs, at))))

    @contextmanager
    def unloaded(self) -> Iterator[None]:
        """Within it, all instances may be evaluated without loads; everything is as it was afterwards."""
        records = self.problem.snapshot()
        aside = self.aside
        for shared in aside.values():
            shared.fetch()
        values = {name: shared.values.copy() for name, shared in aside.items()}
        aside["active"].write(1)
        aside["loading"].write(int(Loading.RISING))
        for name in ("load_factor", "opening", "soft"):
            aside[name].write(0.0)
        try:
            with self.problem.focused():
                yield
        finally:
            self.problem.restore(records)
            for name, before in values.items():
                aside[name].write(before)

    @cached_property
    def aside(self) -> dict[str, Shared]:
        """What is another within ``unloaded``: which are active, at which load, how far open, how loaded; then what launches
        write."""
        arrays = {name: getattr(self.problem.robots, name) for name in ("opening", "soft", "loading")}
        names = ("active", "load_factor", "fault", "step_count", "residual_directions", "pose_columns")
        return {
            name: Shared.of(array) for name, array in (arrays | {name: getattr(self.problem, name) for name in names}).items()
        }

    def unloaded_legs(self) -> tuple[FloatArray, Legs, Attachments]:
        """Unknowns of legs that nothing holds, and what they say of how the legs bend; the problem is unloaded."""
        x = np.zeros((self.problem.instance_count, self.problem.unknown_count))
        for group in self.problem.groups:
            unloaded = group.backbones.guess().reshape(self.problem.instance_count, len(group.members), -1)
            for place, leg in enumerate(group.members):
                x[:, self.problem.own[leg]] = unloaded[:, place]
        if self.problem.inverse:
            x[:, self.problem.platform] = straight_legs(self.problem)
        self.problem.write("unknowns", x)
        self.problem.integrate()
        return x, self._legs(), self.problem.attachments()

    def _best(self, candidates: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, BoolArray]:
        """Of several unknowns, for each instance those from which Newton's first step is shortest; residual and Gamma there, how
        many it looked at, none after one from which it is short, and where it is."""
        count, n = self.problem.instance_count, self.problem.unknown_count
        shortest, tried, open_ = np.full(count, np.inf), np.zeros(count, dtype=int), np.ones(count, dtype=bool)
        x, residual, best = np.array(candidates[0]), np.zeros((count, n)), np.zeros((count, n, n))
        for candidate in candidates:
            with self.problem.only(open_):
                found, gamma = self.problem.evaluate(candidate)
            sound = open_ & np.isfinite(found).all(axis=1) & np.isfinite(gamma).all(axis=(1, 2))
            length = np.full(count, np.nan)
            length[sound] = np.linalg.norm(solved_each(gamma[sound], found[sound][..., None])[..., 0], axis=1)
            length[np.isnan(length)] = 1e300  # a singular start is better than none
            better = open_ & (length < shortest)
            x[better], residual[better], best[better] = candidate[better], found[better], gamma[better]
            shortest[better] = length[better]
            tried += open_
            open_ &= length > SHORT * np.linalg.norm(candidate, axis=1)
            if not open_.any():
                break
        return x, residual, best, tried, ~open_

    def _leg_by_leg(
        self, unloaded: FloatArray, legs: Legs, at: Attachments
    ) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, BoolArray]:
        """(11b) As ``_best``, of the inverse problem: each leg is led to its attachment by itself, from where it would be if it
        were a beam; that where one does not come there."""
        problem, x = self.problem, unloaded.copy()
        # legs whose lengths are free need not give way: the least compliance
        reach, added = beam_reach(legs.softened(COMPLIANCES[:1]), at, *problem.pose())
        x[:, problem.platform] += reach / problem.length[:, :-1] ** 2
        for own, values in zip(problem.own, added, strict=True):
            x[:, own] += values
        rows = np.array([np.arange(own.start, own.stop) for own in problem.own])
        columns = np.column_stack([rows[:, :-1], problem.platform.start + np.arange(len(rows))])  # not the force along the base
        residual, gamma = problem.evaluate(x)
        begun = x.copy(), residual.copy(), gamma.copy()
        tried = np.ones(len(x), dtype=int)
        going, settled = np.ones(len(x), dtype=bool), np.zeros(len(x), dtype=bool)
        for _ in range(LEG_STEPS):
            blocks = gamma[:, rows[:, :, None], columns[:, None, :]]
            going &= np.isfinite(blocks).all(axis=(1, 2, 3)) & (np.linalg.slogdet(np.nan_to_num(blocks))[0] != 0).all(axis=1)
            if not going.any():
                break
            step = np.zeros((len(x), *rows.shape))
            step[going] = -np.linalg.solve(blocks[going], residual[going][:, rows, None])[..., 0]
            x[:, columns] += step
            with problem.only(going):
                found = problem.evaluate(x)
            residual[going], gamma[going] = found[0][going], found[1][going]
            tried += going
            done = going & (np.linalg.norm(step, axis=2) <= SETTLED * np.linalg.norm(x[:, columns], axis=2)).all(axis=1)
            settled |= done
            going &= ~done
        sound = settled & np.isfinite(gamma).all(axis=(1, 2))
        for values, before in zip((x, residual, gamma), begun, strict=True):
            values[~sound] = before[~sound]
        return x, residual, gamma, tried, sound

    def _bent(self, unloaded: FloatArray, legs: Legs, at: Attachments) -> Sequence[FloatArray]:
        """Unknowns of the unloaded legs, and what closes their joints if they are beams, for each of ``COMPLIANCES``."""
        ways = len(COMPLIANCES)
        x = np.concatenate([unloaded] * ways)
        start = fitted_platform(legs, at)
        legs, at = legs.softened(COMPLIANCES), at.repeated(ways)
        shape = (ways * self.problem.instance_count, len(self.problem.geometry.legs))
        beams = self.problem.tool(("BeamEquilibrium", *shape), lambda: BeamEquilibrium(*shape))
        position, rotation, added = beams.found(legs, at, *(np.concatenate([value] * ways) for value in start))
        x[:, self.problem.platform] = self.problem.pose_unknowns(position, rotation)
        for own, values in zip(self.problem.own, added, strict=True):
            x[:, own] += values
        return np.split(x, ways)

    def _legs(self) -> Legs:
        """What the last integration says of the legs."""
        count, legs = self.problem.instance_count, len(self.problem.geometry.legs)
        position, rotation = np.zeros((count, legs, 3)), np.zeros((count, legs, 3, 3))
        flexibility = np.zeros((count, legs, 6, 6))
        by_wrench: list[FloatArray] = [np.zeros(0)] * legs
        for group in self.problem.groups:
            own, members = group.backbones, list(group.members)
            shape = count, len(members)
            unknowns, flexibility[:, members] = tip_answers(own, shape)
            position[:, members] = own.read("position").reshape(*shape, 3)
            rotation[:, members] = own.read("rotation").reshape(*shape, 3, 3)
            for place, leg in enumerate(members):
                by_wrench[leg] = unknowns[:, place]
        length, stiffness = (
            np.broadcast_to(scale[:, :legs], (count, legs)) for scale in (self.problem.length, self.problem.stiffness)
        )
        for group in self.problem.groups:
            if group.backbones.sizes.rigid_in_torsion:  # a straight one would answer no torque at all
                for leg in group.members:
                    flexibility[:, leg, range(3, 6), range(3, 6)] += (GIVE * length / stiffness)[:, leg, None]
        return Legs(position, rotation, flexibility, by_wrench, length, stiffness)
