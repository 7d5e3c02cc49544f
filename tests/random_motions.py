"""Motions of robots through folds, drawn by lot: the same number draws the same motion; each robot on segments as well.

Nothing on segments is the package's: ``tests/leg_energy.py``. Lengths there are over the mean leg's, energies over ``EI/L``.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from creeping_tubes import CreepingTubes, Curved
from leg_energy import Leg, LegEnergy
from meant import meant
from random_scenes import direction, log_uniform
from relaxation import rotation
from tube_leg_energy import TubeLeg, TubeOnNodes

import multirod as mr

KINDS = ("rods", "held", "tubes", "legs", "tube legs", "strong tubes", "heavy rods", "heavy tubes", "loaded held")
DURATION = 10.0  # [s]
SEGMENTS = 32
JOINTS = ("clamped", "spherical", "revolute")


@dataclass
class Section:
    """Of one rod or tube: straight for ``straight`` segments, then precurved, until it ends after ``reach``; ``density`` is its
    mass per length."""

    stiffness: np.ndarray
    precurvature: np.ndarray
    straight: int = 0
    reach: int = SEGMENTS
    axial: float | None = None
    density: float = 0.0

    def rod(self, length: float) -> mr.Rod:
        """Of a leg of this length."""
        part, sections = length / SEGMENTS, []
        for count, bend in ((self.straight, 0.0), (self.reach - self.straight, 1.0)):
            if count:
                axial = {} if self.axial is None else {"axial_stiffness": self.axial}
                section = {"length": count * part, "precurvature": tuple(bend * self.precurvature)}
                stiffness = {"bending_stiffness": tuple(self.stiffness[:2]), "torsional_stiffness": self.stiffness[2]}
                heavy = {"linear_density": self.density} if self.density else {}
                sections.append(mr.Section(**section, **stiffness, **axial, **heavy))
        return mr.Rod(sections=sections)

    def rest(self, times: int = 1) -> np.ndarray:
        """Precurvature of each segment, of so many times as many."""
        return np.where(np.arange(self.reach * times)[:, None] < self.straight * times, 0.0, self.precurvature)


@dataclass
class Motion:
    """A robot and what moves it.

    Attributes:
        robot: Of the package.
        lengths: Of the legs, or of the only rod.
        sections: Of each leg, the rod first that carries the others, if any.
        base: Poses of the bases, (leg, 4, 4).
        platform: Of the attachments.
        joints: Of each leg.
        axes: Of each leg's joint.
        waves: By the name of an input, amplitudes, rates and phases, each of the input's shape; inputs are 0 at first.
        end: Pose of a held end where its inputs are zero; None if nothing holds it.
        slide: Direction in which a held end slides, in its holder's frame; None if it does not.
    """

    robot: Any
    lengths: list[float]
    sections: list[list[Section]]
    base: np.ndarray
    platform: np.ndarray
    joints: list[str]
    axes: np.ndarray
    waves: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    end: np.ndarray | None = None
    slide: np.ndarray | None = None

    def at(self, time: np.ndarray) -> dict[str, np.ndarray]:
        """Inputs by name, (..., of the input)."""
        begun = np.minimum(np.asarray(time) / 1.0, 1.0)[..., None]
        return {
            name: amplitude * begun * np.sin(rate * np.asarray(time)[..., None] + phase)
            for name, (amplitude, rate, phase) in self.waves.items()
        }

    def on_segments(self, solution: Any, time: float, times: int = 1) -> LegEnergy:
        """The robot on segments where a solution has it, on so many times as many."""
        count = SEGMENTS * times
        length, EI = self.length, self.sections[0][0].stiffness[0]
        legs, number = [], 0
        for k, (first, *others) in enumerate(self.sections):
            found = solution.rod(number, nodes=count + 1)
            frames = np.array(found.rotation)
            stretch = np.zeros(count + 1) if first.axial is None else found.force[:, 2] / first.axial
            end = self.platform[k].copy()
            end[:3, 3] /= length
            axial = None if first.axial is None else first.axial * length**2 / EI
            rest = first.rest(times) * length
            own = (1.0, first.stiffness / EI, axial, rest, np.eye(4), end, self.joints[k], self.axes[k], frames, stretch)
            if others:
                angles = [np.zeros(0)]
                for place, sleeve in enumerate(others, number + 1):
                    turned = np.array(solution.rod(place, nodes=sleeve.reach * times + 1).rotation)
                    relative = np.swapaxes(frames[: sleeve.reach * times + 1], 1, 2) @ turned
                    angles.append(np.unwrap(np.arctan2(relative[:, 1, 0], relative[:, 0, 0])))
                tubes = [
                    TubeOnNodes(np.tile(tube.stiffness / EI, (tube.reach * times, 1)), tube.rest(times) * length, 0.0, 0.0, turns)
                    for tube, turns in zip(self.sections[k], angles, strict=True)
                ]
                legs.append(TubeLeg(*own, np.linspace(0, 1, count + 1), tubes))
            else:
                legs.append(Leg(*own))
            number += 1 + len(others)
        position, turn = np.array(solution.tip_position) / length, np.array(solution.tip_rotation)
        result = LegEnergy(legs, position, turn, np.zeros(3), held=self.end is not None)
        self.place(result, time)
        return result

    def unloaded_tubes(self, count: int) -> CreepingTubes | None:
        """Tubes on so many segments, whose bases are not turned yet; None of what is not tubes alone without loads."""
        sections, length = self.sections[0], self.length
        loaded = self.end is not None or len(self.sections) > 1 or self.waves["tip_force"][0].any() or "gravity" in self.waves
        if loaded or len(sections) == 1 or any(own.precurvature[1:].any() for own in sections):
            return None
        part = length / SEGMENTS
        return CreepingTubes(
            [
                Curved(own.reach * part, own.stiffness[0], own.stiffness[2], own.straight * part, own.precurvature[0])
                for own in sections
            ],
            count,
        )

    @property
    def length(self) -> float:
        """Mean of the legs."""
        return float(np.mean(self.lengths))

    def place(self, energy: LegEnergy, time: float) -> None:
        """Inputs of a robot on segments."""
        values, length, EI = self.at(np.array(time)), self.length, self.sections[0][0].stiffness[0]
        number = 0
        turned, pushed = values.get("rotation", np.zeros(99)), values.get("translation", np.zeros(99))
        for k, leg in enumerate(energy.legs):
            leg.base = self.base[k].copy()
            leg.base[:3, 3] /= length
            leg.base[:3, :3] = leg.base[:3, :3] @ rotation(np.array([0, 0, turned[number]]))
            leg.frames[0] = leg.base[:3, :3]
            leg.length = (self.lengths[k] + pushed[number]) / length
            if isinstance(leg, TubeLeg):  # its base turns with the first tube
                for place, tube in enumerate(leg.others, number + 1):
                    tube.turned = turned[place] - turned[number]
            leg.__post_init__()
            at = np.arange(leg.count) * SEGMENTS // leg.count
            density = sum(own.density * (at < own.reach) for own in self.sections[k])
            along = values.get("distributed_force", np.zeros(3)) + np.multiply.outer(density, values.get("gravity", np.zeros(3)))
            leg.carry(along * length**3 / EI)
            number += len(self.sections[k])
        energy.force = values.get("tip_force", np.zeros(3)) * length**2 / EI
        if self.end is not None:
            goal = (self.end[:3, 3] + values["end_position"]) / length
            energy.turn = rotation(values["end_rotation"]) @ self.end[:3, :3]
            if self.slide is not None:
                energy.slide = energy.turn @ self.slide
                goal = goal + energy.slide * (energy.slide @ (energy.position - goal))
            energy.position = goal
            if "tip_moment" in values:  # about the axis that the joint leaves: the work of the rest is none
                axis = energy.turn @ self.axes[0]
                energy.legs[0].moment = axis * (axis @ values["tip_moment"]) * length / EI


@meant()
def draw(kind: str, number: int, seed: int = 0) -> Motion:
    """One motion of a kind."""
    rng = np.random.default_rng([seed, KINDS.index(kind), number])
    length, EI = log_uniform(rng, 0.05, 0.8), log_uniform(rng, 1e-3, 1)
    return MADE[kind](rng, length, EI)


def _wave(rng, amplitude):
    """Of an input whose components reach ``amplitude``; the first comes in evenly."""
    amplitude = np.asarray(amplitude, float)
    rate = 2 * np.pi / DURATION * rng.uniform(0.5, 2, amplitude.shape) * rng.choice([-1, 1], amplitude.shape)
    return amplitude, rate, rng.uniform(0, 2 * np.pi, amplitude.shape)


def _plain(rng, EI, bend, length, axial=None):
    bending = EI * np.array([1.0, log_uniform(rng, 1, 3)])
    stiffness = np.append(bending, bending.mean() * log_uniform(rng, 0.3, 1.2))
    return Section(stiffness, bend / length * direction(rng) * (1, 1, 0.4), axial=axial)


def _alone(robot, length, sections, waves, end=None, joint="clamped", axis=(0.0, 0.0, 0.0), slide=None):
    ones = np.eye(4)[None]
    return Motion(robot, [length], [sections], ones, ones, [joint], np.array([axis]), waves, end, slide)


def _rods(rng, length, EI):
    """Precurved wires, turned at the base and pulled."""
    section = _plain(rng, EI, rng.uniform(0, 9), length)
    force = rng.uniform(1, 10) * EI / length**2 * rng.uniform(0.3, 1, 3)
    waves = {"rotation": _wave(rng, [rng.uniform(0, np.pi)]), "tip_force": _wave(rng, force)}
    return _alone(mr.SingleRod(section.rod(length)), length, [section], waves)


def _end_at_rest(section, length):
    """Pose of the end of a rod that nothing bends."""
    end, step = np.eye(4), rotation(section.precurvature * length / 4096)
    half = rotation(section.precurvature * length / 8192)
    for _ in range(4096):
        end[:3, 3] += (end[:3, :3] @ half)[:, 2] * length / 4096
        end[:3, :3] = end[:3, :3] @ step
    return end


def _held(rng, length, EI):
    """Rods whose end is moved by up to half of the length and turned by up to 2.5 rad."""
    section = _plain(rng, EI, rng.uniform(1, 4), length)
    end = _end_at_rest(section, length)
    time, chord = np.linspace(0, DURATION, 201), max(0.95 * length, float(np.linalg.norm(end[:3, 3])))
    while True:
        waves = {
            "end_position": _wave(rng, 0.5 * length * rng.uniform(0, 1) * direction(rng)),
            "end_rotation": _wave(rng, rng.uniform(0, 2.5) * direction(rng)),
        }
        motion = _alone(mr.HeldRod(section.rod(length), end=end), length, [section], waves, end)
        # a rod is not pulled straight
        if (np.linalg.norm(end[:3, 3] + motion.at(time)["end_position"], axis=1) <= chord).all():
            return motion


def _sleeved(rng, length, EI, bend):
    """A curved tube, and a shorter one on it."""
    stiffness = EI * np.array([1, 1, 0.77])
    inner = Section(stiffness, np.array([bend / length, 0, 0]), straight=int(rng.integers(0, 16)))
    reach = int(rng.integers(16, SEGMENTS + 1))
    outer = Section(stiffness * log_uniform(rng, 0.7, 2), np.array([rng.uniform(0.5, 1) * bend / length, 0, 0]), 0, reach)
    outer.straight = int(rng.integers(0, reach // 2))
    return [inner, outer]


def _tubes(rng, length, EI):
    """Pairs of curved tubes, turned in each other and pulled."""
    sections = _sleeved(rng, length, EI, rng.uniform(0.5, 3.5))
    robot = mr.ConcentricTubes([section.rod(length) for section in sections])
    waves = {
        "rotation": _wave(rng, [rng.uniform(1, 2 * np.pi), rng.uniform(0, 1)]),
        "tip_force": _wave(rng, rng.uniform(0, 4) * EI / length**2 * direction(rng)),
    }
    return _alone(robot, length, sections, waves)


def _strong_tubes(rng, length, EI):
    """Two to four tubes, straight for up to half of their length and strongly curved behind, so that they snap though their tips
    are held; turned in each other, half of them pulled."""
    count, straight = int(rng.integers(2, 5)), int(rng.integers(0, SEGMENTS // 2))
    reach = np.append(SEGMENTS, np.sort(rng.integers(3 * SEGMENTS // 4, SEGMENTS + 1, count - 1))[::-1])
    stiff, shape = EI * np.exp(rng.uniform(-0.5, 0.7, count)), rng.uniform(0.5, 1, count)
    torsion = stiff * rng.uniform(0.6, 0.9, count)
    driven = shape[0] * shape[1] * stiff[0] * stiff[1] / (stiff[0] + stiff[1]) * (1 / torsion[0] + 1 / torsion[1])
    bend = rng.uniform(1.5, 5) / np.sqrt(driven) / (length * (reach[1] - straight) / SEGMENTS)
    sections = [
        Section(np.array([EI_i, EI_i, GJ]), np.array([bend * part, 0, 0]), straight, int(end))
        for EI_i, GJ, part, end in zip(stiff, torsion, shape, reach, strict=True)
    ]
    force = rng.uniform(0, 3) * EI / length**2 * direction(rng) * (rng.random() < 0.5)
    waves = {"rotation": _wave(rng, rng.uniform(2, 9, count)), "tip_force": _wave(rng, force)}
    return _alone(mr.ConcentricTubes([section.rod(length) for section in sections]), length, sections, waves)


def _ring(rng, count, radius, tilt):
    poses = np.tile(np.eye(4), (count, 1, 1))
    for k in range(count):
        angle = 2 * np.pi * k / count + rng.uniform(-0.3, 0.3)
        poses[k, :3, :3] = rotation(rng.uniform(-tilt, tilt, 3))
        poses[k, :3, 3] = radius * np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.3, 0.3)])
    return poses


def _legs(rng, length, EI, with_tubes=False):
    """Two to five legs in joints of all kinds, pushed and turned, the platform pulled."""
    count = int(rng.integers(2, 6))
    base = _ring(rng, count, rng.uniform(0.1, 0.5) * length, 0.3)
    platform = _ring(rng, count, rng.uniform(0.05, 0.4) * length, 0.3)
    joints = ["clamped", *(str(rng.choice(JOINTS)) for _ in range(count - 1))]
    axes = np.array([direction(rng) for _ in range(count)])
    lengths, sections, turned, pushed = [], [], [], []
    for k in range(count):
        lengths.append(length * rng.uniform(0.9, 1.1))
        if with_tubes and (k == 0 or rng.random() < 0.5):
            sections.append(_sleeved(rng, lengths[k], EI, rng.uniform(0.3, 3)))
            turned += [rng.uniform(1, 6), rng.uniform(0, 1)]
            pushed += [0.0, 0.0]
        else:
            axial = EI * log_uniform(rng, 30, 150) ** 2 / length**2
            sections.append([_plain(rng, EI, rng.uniform(0, 2), lengths[k], axial)])
            turned.append(rng.uniform(0, 1.5))
            pushed.append(rng.uniform(0, 0.12) * length)
    legs = []
    for own, reach in zip(sections, lengths, strict=True):
        rods = [section.rod(reach) for section in own]
        legs.append(mr.ConcentricTubes(rods) if len(rods) > 1 else rods[0])
    turning = axes if "revolute" in joints else None
    robot = mr.ParallelRods(legs=legs, base=base, platform=platform, joints=joints, joint_axes=turning)
    waves = {
        "rotation": _wave(rng, turned),
        "tip_force": _wave(rng, log_uniform(rng, 1, 8) * count * EI / length**2 * direction(rng)),
    }
    if any(pushed):
        waves["translation"] = _wave(rng, pushed)
    return Motion(robot, lengths, sections, base, platform, joints, axes, waves)


def _tube_legs(rng, length, EI):
    """The same, one leg at least of two tubes."""
    return _legs(rng, length, EI, with_tubes=True)


def _heavy_rods(rng, length, EI):
    """Precurved wires that are turned at the base, pulled at the tip and loaded along their length."""
    section = _plain(rng, EI, rng.uniform(3, 12), length)
    waves = {
        "rotation": _wave(rng, [rng.uniform(0, np.pi)]),
        "tip_force": _wave(rng, rng.uniform(0, 12) * EI / length**2 * rng.uniform(0.3, 1, 3)),
        "distributed_force": _wave(rng, rng.uniform(10, 60) * EI / length**3 * rng.uniform(0.3, 1, 3)),
    }
    return _alone(mr.SingleRod(section.rod(length)), length, [section], waves)


def _heavy_tubes(rng, length, EI):
    """Pairs of curved tubes, turned in each other and pulled, each with its own weight in a field that turns."""
    sections = _sleeved(rng, length, EI, rng.uniform(0.5, 3.5))
    for section in sections:
        section.density = log_uniform(rng, 0.01, 0.1)
    pull = rng.uniform(2, 15) * EI / length**3 / sum(section.density for section in sections)
    waves = {
        "rotation": _wave(rng, [rng.uniform(1, 2 * np.pi), rng.uniform(0, 1)]),
        "tip_force": _wave(rng, rng.uniform(0, 4) * EI / length**2 * direction(rng)),
        "gravity": _wave(rng, pull * rng.uniform(0.3, 1, 3)),
    }
    return _alone(mr.ConcentricTubes([section.rod(length) for section in sections]), length, sections, waves)


def _loaded_held(rng, length, EI):
    """Held rods under loads along them, clamped or on a hinge with a moment about it, half of them on a slide with a force along
    it, whose ends are moved less far."""
    section = _plain(rng, EI, rng.uniform(1, 4), length)
    end = _end_at_rest(section, length)
    axis, slide = direction(rng), direction(rng) if rng.random() < 0.5 else None
    joint = str(rng.choice(("clamped", "revolute")))
    time, chord = np.linspace(0, DURATION, 201), max(0.95 * length, float(np.linalg.norm(end[:3, 3])))
    while True:
        waves = {
            "end_position": _wave(rng, 0.3 * length * rng.uniform(0, 1) * direction(rng)),
            "end_rotation": _wave(rng, rng.uniform(0, 2) * direction(rng)),
            "distributed_force": _wave(rng, rng.uniform(2, 60) * EI / length**3 * rng.uniform(0.3, 1, 3)),
        }
        if slide is not None:
            waves["tip_force"] = _wave(rng, rng.uniform(0, 20) * EI / length**2 * direction(rng))
        if joint == "revolute":
            waves["tip_moment"] = _wave(rng, rng.uniform(0, 6) * EI / length * direction(rng))
        hinge = {"joint": joint, **({} if joint == "clamped" else {"joint_axis": tuple(axis)})}
        guide = {} if slide is None else {"slide": tuple(slide)}
        robot = mr.HeldRod(section.rod(length), end=end, **hinge, **guide)
        motion = _alone(robot, length, [section], waves, end, joint, axis, slide)
        if (np.linalg.norm(end[:3, 3] + motion.at(time)["end_position"], axis=1) <= chord).all():
            return motion


_ALL = (_rods, _held, _tubes, _legs, _tube_legs, _strong_tubes, _heavy_rods, _heavy_tubes, _loaded_held)
MADE = dict(zip(KINDS, _ALL, strict=True))
