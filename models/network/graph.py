"""Rods, bodies and joints of a network, in numbers: who is joined to whom, and where."""

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from multirod.batch import IntArray, take
from multirod.models.backbone.assembly import BackboneAssembly
from multirod.models.backbone.kernels.layout.members import drive_slices
from multirod.models.backbone.kernels.layout.members import drives as drive_names
from multirod.models.backbone.segments.cutting import piece
from multirod.models.network.elements.elements import Layout
from multirod.models.network.elements.entries import Entries
from multirod.models.network.joining.bodies import Body, Ground, place_of
from multirod.models.network.joining.joints import MOST, Joint, JointTable
from multirod.models.network.joining.placing import Placing, placed
from multirod.models.network.joining.sliding import Slides
from multirod.models.network.joining.turning import hold_turning
from multirod.rod import RodArrays
from multirod.validation import FloatArray

GROUND = 0  # among frames: the bodies follow in their order
FREE = -1  # in the place of a frame: nothing holds this end
DRIVEN = ("angle", "slide")  # inputs that are coordinates of joints
PUSHED = ("joint_torque", "slide_force")  # what acts along those that are not driven
BY_COORDINATE = (*DRIVEN, *PUSHED)
ENDS: tuple[Literal["base", "tip"], ...] = ("base", "tip")


class Ends:
    """One end of every rod: what holds it, and how.

    Attributes:
        frame: What holds it, the number of a body from 1 on, ``GROUND`` of the ground and of bodies that are fixed, which do not
            give way either, or ``FREE``, shape (rod_count,).
        stand: The same, but bodies that are fixed have numbers after the others, shape (rod_count,).
        pose: Where on that, shape (..., rod_count, 4, 4).
        joint: Which of all joints it is, -1 of none, shape (rod_count,).
        table: The joints there.
    """

    def __init__(
        self,
        joints: "list[Joint | None]",
        lengths: Sequence[float],
        numbers: Sequence[int],
        moving: Sequence[str],
        fixed: Sequence[str],
    ) -> None:
        frames = {name: k for k, name in enumerate((Ground.name, *moving, *fixed))}
        self.stand: NDArray[np.intp] = np.array([FREE if joint is None else frames[joint.to.name] for joint in joints])
        self.frame: NDArray[np.intp] = np.where(self.stand > len(moving), GROUND, self.stand)
        self.joint: NDArray[np.intp] = np.array(numbers)
        poses = [np.eye(4) if joint is None else joint.pose for joint in joints]
        shape = np.broadcast_shapes(*(pose.shape[:-2] for pose in poses))
        self.pose: FloatArray = np.stack([np.broadcast_to(pose, (*shape, 4, 4)) for pose in poses], axis=-3)
        self.table = JointTable(joints, lengths)

    @property
    def held(self) -> NDArray[np.bool_]:
        """Whether something holds it, shape (rod_count,)."""
        return np.asarray(self.frame != FREE)


class Graph:
    """A network in numbers: its rods are pieces of those given, cut at the holes through which they slide, or into segments.

    Args:
        rods: Each as a robot of its own.
        names: Of the rods.
        bodies: The bodies.
        joints: What holds each end of a rod, by name and end.
        base: Pose of the ground in the world, shape (..., 4, 4).
        holes: Through which rods slide, by name, from the base to the tip.
        all_joints: All of them, in the order in which they are counted.
        segments: Of some rods, how many.

    Attributes:
        whole, whole_names: The rods as given.
        slides: How they are cut.
        rods, names: The pieces.
        arrays: The pieces as kernels read them.
        own: Unknowns of each, shape (rod_count,).
        along: Which of them is the force at its base along that, shape (rod_count,).
        first_tube: The first of the tubes of each rod as given, and their number, shape (whole_count + 1,).
        drives: What drives the lines of each, by the names of inputs.
        drive: Which of all numbers that drive lines that of each line is, in the order of ``drive_slices``, shape (rod_count, k).
        layout: Of their elements.
        ends: Their bases, then their tips.
        base, all_joints, segments: As given.
        bodies, fixed: Those that move, and those that are fixed.
        moving: The bodies, then what is between segments: all whose poses are unknown.
        mass, mass_centre: Of these, shapes (body_count,), (body_count, 3).
        free: Rods whose tips nothing holds, by their numbers.
        driven: Names of the joints whose angles are inputs, ``"arm base"``, and how many each has, rod by rod.
        driven_slides: Likewise of those for which it is an input how far they slide.
        driven_at: Which of all these coordinates, angles first, those of the joints at bases, then at tips are, -1 of those that
            are no inputs, each of shape (rod_count, 3).
        pushed, pushed_slides, pushed_at: Likewise of joints that are not driven, the coordinates by which torques and forces
            have a potential: all but those of balls, and of holes.
        turning: (46) Rods that turn about themselves, and are held by springs.
        batch_shape: Leading axes of all of it.
    """

    def __init__(
        self,
        rods: Sequence[BackboneAssembly],
        names: Sequence[str],
        bodies: Sequence[Body],
        joints: Mapping[tuple[str, str], Joint],
        base: FloatArray,
        holes: Mapping[str, Sequence[Joint]],
        all_joints: Sequence[Joint],
        segments: Mapping[str, int],
    ) -> None:
        self.whole, self.whole_names, self.segments = tuple(rods), tuple(names), dict(segments)
        self.slides = Slides(names, [float(np.min(rod.rods[0].length)) for rod in rods], holes, segments)
        counts = np.bincount(self.slides.owner)
        whole = [rods[owner] for owner in self.slides.owner]
        self.rods: tuple[BackboneAssembly, ...] = tuple(
            rod if counts[owner] == 1 else type(rod)(piece(rod.rods[0], int(counts[owner])))
            for rod, owner in zip(whole, self.slides.owner.tolist(), strict=True)
        )
        self.names = self.slides.names(names)
        self.bodies = tuple(body for body in bodies if not body.fixed)
        self.moving = (*self.bodies, *self.slides.between)
        self.fixed = tuple(body for body in bodies if body.fixed)
        self.joints, self.holes, self.all_joints, self.base = dict(joints), dict(holes), tuple(all_joints), base
        self.arrays: tuple[RodArrays, ...] = tuple(rod.arrays for rod in self.rods)
        conditions = [sum(kind.conditioned for kind in arrays.members) for arrays in self.arrays]
        self.own: NDArray[np.intp] = np.array([r.rod_count + 5 + c for r, c in zip(self.rods, conditions, strict=True)])
        self.along: NDArray[np.intp] = self.own - 1
        self.first_tube: NDArray[np.intp] = np.cumsum([0, *(rod.rod_count for rod in self.whole)])
        self.drives = [drive_names(arrays.members) for arrays in self.arrays]
        self.drive = _places_of(self.drives)
        self.layout = Layout(int(self.own.max()), self.slides.count > 0)
        moving, fixed = ([body.name for body in own] for own in (self.moving, self.fixed))
        lengths = [float(np.min(rod.rods[0].length)) for rod in self.rods]
        self.ends = tuple(
            Ends(
                [self._joint(k, end) for k in range(len(self.rods))],
                lengths,
                [self._number(k, end) for k in range(len(self.rods))],
                moving,
                fixed,
            )
            for end in ENDS
        )
        self.mass = np.array([body.mass for body in self.moving])
        self.mass_centre = np.array([body.mass_centre for body in self.moving]).reshape(-1, 3)
        self.free: NDArray[np.intp] = np.flatnonzero(~self.ends[1].held)
        self.driven, self.driven_slides, self.driven_at = self._coordinates([own.table.driven for own in self.ends])
        real = [self.slides.first, self.slides.last]  # ends of rods as given
        pushed = [at & ~own.table.driven & (own.table.count < MOST) for own, at in zip(self.ends, real, strict=True)]
        self.pushed, self.pushed_slides, self.pushed_at = self._coordinates(pushed)
        self.turning = hold_turning(self)
        shapes = [*(own.batch_shape for own in self.arrays), *(end.pose.shape[:-3] for end in self.ends)]
        self.batch_shape = np.broadcast_shapes(*shapes, base.shape[:-2])

    def _coordinates(
        self, chosen: Sequence[NDArray[np.bool_]]
    ) -> tuple[dict[str, int], dict[str, int], tuple[NDArray[np.intp], ...]]:
        """Names of the joints at the ``chosen`` ends, of bases, then of tips (rod_count,), and how many angles each has; of those
        that slide; and which of all these coordinates each is, as ``driven_at``."""
        angles: dict[str, int] = {}
        slides: dict[str, int] = {}
        places = tuple(np.full((len(self.rods), MOST), -1, dtype=np.intp) for _ in ENDS)
        for sliding, found in ((False, angles), (True, slides)):
            for rod in range(len(self.rods)):
                for end, own, at, these in zip(ENDS, self.ends, places, chosen, strict=True):
                    which = np.flatnonzero(own.table.slides[rod] == sliding)
                    which = which[which < own.table.count[rod]]
                    if these[rod] and len(which):
                        first = sum(angles.values()) + sum(slides.values())
                        at[rod, which] = first + np.arange(len(which))
                        found[f"{self.whole_names[self.slides.owner[rod]]} {end}"] = len(which)
        return angles, slides, places

    def _joint(self, rod: int, end: Literal["base", "tip"]) -> Joint | None:
        given = self.joints.get((self.whole_names[self.slides.owner[rod]], end))
        return self.slides.joint(rod, end, given)

    def _number(self, rod: int, end: str) -> int:
        """Which of all joints that is, -1 of none."""
        given = self.joints.get((self.whole_names[self.slides.owner[rod]], end))
        own = self.slides.source(rod, end, given)
        return next((k for k, joint in enumerate(self.all_joints) if joint is own), FREE)

    @property
    def load_places(self) -> tuple[str, ...]:
        """Names of what forces act on: the bodies, then the rods whose tips nothing holds, then frames of the bodies."""
        tips = (self.whole_names[self.slides.owner[k]] for k in self.free)
        return (*(body.name for body in self.bodies), *tips, *(place_of(*frame) for frame in self.frames))

    @property
    def frames(self) -> tuple[tuple[str, str], ...]:
        """Of each frame of a body that moves the names of body and frame, in the order of ``load_places``."""
        return tuple((body.name, frame) for body in self.bodies for frame in body.frames)

    @cached_property
    def framed(self) -> NDArray[np.intp]:
        """The number of the body of each of these, shape (frame_count,)."""
        return np.repeat(np.arange(len(self.bodies)), [len(body.frames) for body in self.bodies])

    @cached_property
    def frame_poses(self) -> FloatArray:
        """Their poses in the frames of the bodies, shape (frame_count, 4, 4)."""
        return np.array([pose for body in self.bodies for pose in body.frames.values()]).reshape(-1, 4, 4)

    @property
    def by_coordinate(self) -> dict[str, dict[str, int]]:
        """Of each input that has a number for each coordinate the joints, and how many coordinates each has."""
        own = (self.driven, self.driven_slides, self.pushed, self.pushed_slides)
        return dict(zip(BY_COORDINATE, own, strict=True))

    def effector_rod(self, number: int) -> int | None:
        """The piece whose tip is the end effector of that number, bodies first; None of a body."""
        rod = number - len(self.bodies)
        return None if rod < 0 else self.slides.of(rod)[-1]

    @property
    def is_driven(self) -> bool:
        """Whether any joint is."""
        return bool(self.driven or self.driven_slides)

    @property
    def turning_bases(self) -> NDArray[np.bool_]:
        """Which rods have bases that turn, on bodies that move or in joints, shape (rod_count,)."""
        base = self.ends[0]
        return np.asarray((base.frame != GROUND) | (base.table.count > 0))

    @property
    def embeddable(self) -> NDArray[np.bool_]:
        """Which rods may have a medium around them, or loads of their own, which go with the frame of their base: where that does
        not move, and they are in one piece, shape (rod_count,)."""
        return np.asarray(~self.turning_bases & ~self.slides.cut)

    @property
    def held_still(self) -> NDArray[np.bool_]:
        """Which rods stand between the ground or bodies that are fixed and the same, shape (rod_count,)."""
        return np.asarray((self.ends[0].frame == GROUND) & (self.ends[1].frame == GROUND))

    @property
    def on_fixed(self) -> NDArray[np.bool_]:
        """Which rods have bases on bodies that are fixed, and that inputs may turn, shape (rod_count,)."""
        return np.asarray(self.ends[0].stand > len(self.moving))

    @cached_property
    def alone(self) -> BackboneAssembly | None:
        """A rod that is clamped to the ground, its tip free, and the whole network, as a robot of its own; None of others."""
        base = self.ends[0]
        if len(self.rods) > 1 or self.bodies or self.fixed or not len(self.free) or base.table.count[0]:
            return None
        return self.whole[0].with_base(self.base @ base.pose[..., 0, :, :])

    @cached_property
    def standing(self) -> list[tuple[int, NDArray[np.intp]]]:
        """Bodies that move in an order in which each stands on those before it, with the rods that hold it by their tips; none
        where a rod is joined otherwise, or by a joint that beams do not know: these turn at tips, freely, about one axis or
        all."""
        (base, tip), known = self.ends, np.arange(len(self.moving) + 1) == GROUND
        table, held = tip.table, tip.held
        told = (table.free == table.count) & (table.count != 2) & ~table.slides.any(axis=1) & ~table.stiffness.any(axis=1)
        if self.slides.count or base.table.free.any() or not told.all() or (tip.frame == GROUND).any():
            return []
        found: list[tuple[int, NDArray[np.intp]]] = []
        while len(found) < len(self.moving):
            own = {k: np.flatnonzero(held & (tip.frame == k)) for k in np.flatnonzero(~known).tolist()}
            ready = [(k - 1, rods) for k, rods in own.items() if len(rods) and known[base.frame[rods]].all()]
            if not ready:
                return []
            found += ready
            known[[1 + k for k, _ in ready]] = True
        return found

    @cached_property
    def depth(self) -> int:
        """Rods on the way from the ground to what is furthest from it."""
        steps = np.full(len(self.moving) + 1, len(self.names) + 1)
        steps[GROUND] = 0
        base, tip = (end.frame for end in self.ends)
        joined = tip != FREE
        while True:
            before = steps.copy()
            for near, far in ((base[joined], tip[joined]), (tip[joined], base[joined])):
                np.minimum.at(steps, far, steps[near] + 1)
            if np.array_equal(before, steps):
                break
        return int(max(steps.max(), 1 + steps[base[~joined]].max(initial=0)))

    @cached_property
    def entries(self) -> Entries:
        """Where elements stand in residual and ``Gamma``."""
        return Entries(self)

    def take(self, batch_shape: tuple[int, ...], instances: IntArray) -> "Graph":
        """That of some instances of a batch to whose leading axes this broadcasts, along one axis."""
        if not self.batch_shape:
            return self
        result = copy(self)
        result.arrays = tuple(arrays.take(batch_shape, instances) for arrays in self.arrays)
        result.base = take(self.base, batch_shape, instances, tail=2) if self.base.ndim > 2 else self.base
        result.ends = tuple(copy(end) for end in self.ends)
        for end in result.ends:
            end.pose = take(end.pose, batch_shape, instances, tail=3) if end.pose.ndim > 3 else end.pose
        result.batch_shape = np.shape(instances)
        return result

    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Length and bending stiffness of each rod, then of each body: the mean and the sum of those of the rods that it holds;
        shapes (batch or 1, rod_count + body_count)."""
        arrays = [own.repeated(self.batch_shape) for own in self.arrays]
        length = np.stack([a.end[:, :, -1].max(axis=1) for a in arrays], axis=1)
        stiffness = np.stack([a.material[:, :, 0, :2].max(axis=2).sum(axis=1) for a in arrays], axis=1)
        by_body = [np.any([end.frame == k + 1 for end in self.ends], axis=0) for k in range(len(self.moving))]
        lengths = [length[:, own].mean(axis=1, keepdims=True) for own in by_body]
        stiffnesses = [stiffness[:, own].sum(axis=1, keepdims=True) for own in by_body]
        return np.concatenate([length, *lengths], axis=1), np.concatenate([stiffness, *stiffnesses], axis=1)

    def attachments(self, count: int, batch_shape: tuple[int, ...]) -> list[tuple[FloatArray, FloatArray]]:
        """Position (count, rod_count, 3) and rotation (count, rod_count, 3, 3) of the poses of both ends, in the frames of what
        holds them; on the ground, in the world."""
        base = np.broadcast_to(self.base, (*batch_shape, 4, 4)).reshape(count, 1, 4, 4)
        found = []
        for end in self.ends:
            poses = np.broadcast_to(end.pose, (*batch_shape, *end.pose.shape[-3:])).reshape(count, *end.pose.shape[-3:])
            poses = np.where((end.stand == GROUND)[:, None, None], base @ poses, poses)
            found.append((np.ascontiguousarray(poses[..., :3, 3]), np.ascontiguousarray(poses[..., :3, :3])))
        return found

    def fixed_poses(self, count: int, batch_shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Position (count, body, 3) and rotation (count, body, 3, 3) of the bodies that are fixed, before inputs move them."""
        base = np.broadcast_to(self.base, (*batch_shape, 4, 4)).reshape(count, 1, 4, 4)
        poses = base @ np.array([body.pose for body in self.fixed]).reshape(-1, 4, 4)
        return np.ascontiguousarray(poses[..., :3, 3]), np.ascontiguousarray(poses[..., :3, :3])

    def placing(
        self,
        count: int,
        batch_shape: tuple[int, ...],
        driven: FloatArray | None = None,
        fixed: tuple[FloatArray, FloatArray] | None = None,
    ) -> Placing:
        """What placing the bodies needs, at angles ``driven`` (count, k) of the joints that are driven, or all at rest, and with
        bodies that are fixed at poses ``fixed``, as of ``fixed_poses``, or not moved."""
        base = np.broadcast_to(self.base, (*batch_shape, 4, 4)).reshape(count, 4, 4)
        given = [None if body.pose is None else base @ body.pose for body in self.moving]
        position, rotation = self.fixed_poses(count, batch_shape) if fixed is None else fixed
        for k in range(len(self.fixed)):
            pose = np.tile(np.eye(4), (count, 1, 1))
            pose[:, :3, 3], pose[:, :3, :3] = position[:, k], rotation[:, k]
            given.append(pose)
        frames = [end.stand for end in self.ends]
        angles = [end.table.rest[None] for end in self.ends]
        if driven is not None:
            angles = [own + at for own, at in zip(angles, self.driven_angles(driven), strict=True)]
        between = np.isin(np.arange(len(given)), np.arange(len(self.bodies), len(self.moving)))
        return Placing(frames, self.attachments(count, batch_shape), [end.table for end in self.ends], angles, given, between)

    def driven_angles(self, driven: FloatArray) -> list[FloatArray]:
        """(24) Coordinates that are inputs (..., k) at bases, then at tips, zero elsewhere, shapes (..., rod_count, 3)."""
        return _at(driven, self.driven_at)

    def pushes(self, given: FloatArray) -> list[FloatArray]:
        """(40) Of torques and forces that are inputs (..., k) what acts along the coordinates, at bases, then at tips [N m], zero
        elsewhere, shapes (..., rod_count, 3)."""
        return [end.table.unit * own for end, own in zip(self.ends, _at(given, self.pushed_at), strict=True)]

    def reference(self, length: FloatArray, batch_shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
        """Position [m] and rotation of the bodies where their unknowns are zero, shapes (count, body_count, 3), (count,
        body_count, 3, 3): as given, or as rods would have it that are straight, of ``length`` (count, rod_count)."""
        count = len(length)
        tips = np.zeros((*length.shape, 3))
        tips[..., 2] = length
        position, rotation = placed(self.placing(count, batch_shape), tips, np.broadcast_to(np.eye(3), (*length.shape, 3, 3)))
        moving = slice(1, 1 + len(self.moving))
        return position[:, moving], rotation[:, moving]


def _at(values: FloatArray, places: Sequence[NDArray[np.intp]]) -> list[FloatArray]:
    """Numbers (..., k) where they belong, at bases, then at tips, zero elsewhere, shapes (..., rod_count, 3)."""
    padded = np.concatenate([values, np.zeros((*values.shape[:-1], 1))], axis=-1)
    return [padded[..., at] for at in places]


def _places_of(drives: Sequence[Sequence[str]]) -> NDArray[np.intp]:
    """Which of the numbers that drive lines, input by input, that of each line of each rod is, -1 where there is none."""
    whole = drive_slices([name for own in drives for name in own])
    taken = {name: at.start for name, at in whole.items()}
    places = np.full((len(drives), max(map(len, drives), default=0)), -1, dtype=np.intp)
    for rod, own in enumerate(drives):
        for name, at in drive_slices(own).items():
            count = at.stop - at.start
            places[rod, at] = range(taken[name], taken[name] + count)
            taken[name] += count
    return places
