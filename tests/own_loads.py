"""Loads of a rod's own that are not in the package, each a law and its numbers."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import warp as wp

import multirod as mr
from multirod.models.backbone.kernels.layout.slots import Slot
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (operators: looked up by name)

FAR = 0.1  # from the line, where they are as stiff as steps heed [m]


class Well(mr.Load):
    """``f = -(k + c r^2) r``, ``r = p - (0, 0, s)``: springs that hold a rod to a line and stiffen, of the energy ``k r^2/2 + c
    r^4/4`` per length, which is convex in the position."""

    force = by_place = conservative = convex = True
    parameters: ClassVar = {"stiffness": (1, -2), "stiffening": (1, -4)}
    raised = ("stiffness", "stiffening")

    def __init__(self, stiffness, stiffening):
        self.numbers = stiffness, stiffening

    def values(self, section):
        return np.asarray(self.numbers)

    @classmethod
    def at_place(cls, n):
        return [Slot("way", 3)]

    @classmethod
    def size(cls, sizes):
        return cls.spring_bound(sizes) * FAR * sizes.furthest_end() ** 3 / sizes.least_stiffness

    @classmethod
    def spring_bound(cls, sizes):
        return sizes.largest(cls, "stiffness") + 3 * FAR**2 * sizes.largest(cls, "stiffening")

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Frame, Column, memory_type = (
            numbers.Real,
            numbers.Vec3,
            numbers.Frame,
            numbers.Column,
            numbers.memory_type,
        )
        row, d, dot, scaled, ahead3, row3, put3 = (
            numbers.row,
            numbers.d,
            numbers.dot,
            numbers.scaled,
            numbers.ahead3,
            numbers.row3,
            numbers.put3,
        )
        K, C, WAY = numbers.on_stretch("stiffness"), numbers.on_stretch("stiffening"), numbers.at_place("way")

        @wp.func
        def force(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            r = Vec3(p.x, p.y, p.z - s)
            put3(memory, a + wp.static(WAY), r)
            return scaled(-(row(memory, z + wp.static(K)) + row(memory, z + wp.static(C)) * dot(r, r)), r)

        @wp.func
        def force_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            r, dr = row3(memory, a + wp.static(WAY)), Vec3(dp.x, dp.y, dp.z - ds)
            c = row(memory, z + wp.static(C))
            along = scaled(-(row(memory, z + wp.static(K)) + c * dot(r, r)), dr)
            return ahead3(along, d(-2.0) * c * dot(r, dr), r)

        @wp.func
        def spring(memory: memory_type, z: int) -> Real:
            return row(memory, z + wp.static(K)) + d(wp.static(3.0 * FAR * FAR)) * row(memory, z + wp.static(C))

        @wp.func
        def energy(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            r = Vec3(p.x, p.y, p.z - s)
            square = dot(r, r)
            c = row(memory, z + wp.static(C))
            return d(0.5) * row(memory, z + wp.static(K)) * square + d(0.25) * c * square * square

        return SimpleNamespace(force=force, force_variation=force_variation, spring=spring, energy=energy)


class Drag(mr.Load):
    """``f = (c - b) (t . w) t + b w``: a fluid flows past slender rods with the velocity ``w``. By resistive force theory they
    resist by c along their tangent ``t`` and by b across it. It has no energy."""

    force = True
    parameters: ClassVar = {"along": (1, -1), "across": (1, -1)}  # times a velocity, in units in which its speed is one
    raised = ("along", "across")
    flow = np.array([1.0, 0.5, -0.2])

    def __init__(self, along, across):
        self.numbers = along, across

    def values(self, section):
        return np.asarray(self.numbers)

    @classmethod
    def at_place(cls, n):
        return [Slot("tangent", 3)]

    @classmethod
    def size(cls, sizes):
        return sizes.largest(cls, "across") * sizes.furthest_end() ** 3 / sizes.least_stiffness

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Frame, Column, memory_type = (
            numbers.Real,
            numbers.Vec3,
            numbers.Frame,
            numbers.Column,
            numbers.memory_type,
        )
        row, fill, d, n = numbers.row, numbers.fill, numbers.d, numbers.layout.n
        dot, scaled, ahead3, row3, put3 = numbers.dot, numbers.scaled, numbers.ahead3, numbers.row3, numbers.put3
        tangent, rotate = numbers.tangent, numbers.rotate
        ALONG, ACROSS, TANGENT = numbers.on_stretch("along"), numbers.on_stretch("across"), numbers.at_place("tangent")
        X, Y, Z = Drag.flow.tolist()

        @wp.func
        def flow() -> Vec3:
            return Vec3(fill(d(wp.static(X))), fill(d(wp.static(Y))), fill(d(wp.static(Z))))

        @wp.func
        def total(memory: memory_type, at: int) -> Real:
            """Of all rods."""
            value = row(memory, at)
            for i in range(1, wp.static(n)):
                value = value + row(memory, at + i)
            return value

        @wp.func
        def force(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            b = total(memory, z + wp.static(ACROSS))
            t = tangent(frame)
            put3(memory, a + wp.static(TANGENT), t)
            return ahead3(scaled(b, flow()), (total(memory, z + wp.static(ALONG)) - b) * dot(t, flow()), t)

        @wp.func
        def force_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            t = row3(memory, a + wp.static(TANGENT))
            dt = rotate(frame, Vec3(dphi.y, -dphi.x, fill(d(0.0))))
            more = total(memory, z + wp.static(ALONG)) - total(memory, z + wp.static(ACROSS))
            return ahead3(scaled(more * dot(dt, flow()), t), more * dot(t, flow()), dt)

        return SimpleNamespace(force=force, force_variation=force_variation)


class Spring(mr.Load):
    """``f = -k r (1 - h/sqrt(r^2 + h^2))``, ``r = p - (0, 0, s)``, and ``l = m (R e_x) x e_y``: springs between the rod and the
    axis of its base, which hardly pull near it, and a keel that turns it; both have an energy, that of the springs is convex."""

    force = moment = by_place = conservative = convex = True
    parameters: ClassVar = {"stiffness": (1, -2), "rest": (0, 1), "keel": (1, 0)}
    raised = ("stiffness", "keel")

    def __init__(self, stiffness, rest, keel):
        self.numbers = stiffness, rest, keel

    def values(self, section):
        return np.asarray(self.numbers)

    @classmethod
    def at_place(cls, n):
        return [Slot("way", 3), Slot("arm", 3)]

    @classmethod
    def size(cls, sizes):
        by_springs = sizes.largest(cls, "stiffness") * sizes.largest(cls, "rest") * sizes.furthest_end() ** 3
        by_keel = sizes.largest(cls, "keel") * sizes.furthest_end() ** 2
        return (by_springs + by_keel) / sizes.least_stiffness

    @classmethod
    def moment_bound(cls, sizes):
        return sizes.largest(cls, "keel")

    @classmethod
    def spring_bound(cls, sizes):
        return sizes.largest(cls, "stiffness")

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Frame, Column, memory_type = (
            numbers.Real,
            numbers.Vec3,
            numbers.Frame,
            numbers.Column,
            numbers.memory_type,
        )
        row, fill, root, d = numbers.row, numbers.fill, numbers.root, numbers.d
        dot, scaled, ahead3, cross, row3, put3 = (
            numbers.dot,
            numbers.scaled,
            numbers.ahead3,
            numbers.cross,
            numbers.row3,
            numbers.put3,
        )
        rotate = numbers.rotate
        K, H, M = numbers.on_stretch("stiffness"), numbers.on_stretch("rest"), numbers.on_stretch("keel")
        WAY, ARM = numbers.at_place("way"), numbers.at_place("arm")

        @wp.func
        def softened(r: Vec3, h: Real) -> Real:
            """sqrt(r^2 + h^2), a length that is smooth on the axis."""
            return root(dot(r, r) + h * h)

        @wp.func
        def force(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            r = Vec3(p.x, p.y, p.z - s)
            put3(memory, a + wp.static(WAY), r)
            h = row(memory, z + wp.static(H))
            return scaled(row(memory, z + wp.static(K)) * (h / softened(r, h) - d(1.0)), r)

        @wp.func
        def force_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            r = row3(memory, a + wp.static(WAY))
            dr = Vec3(dp.x, dp.y, dp.z - ds)
            h = row(memory, z + wp.static(H))
            size = softened(r, h)
            k = row(memory, z + wp.static(K))
            return ahead3(scaled(k * (h / size - d(1.0)), dr), -k * h * dot(r, dr) / (size * size * size), r)

        @wp.func
        def moment(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            zero = fill(d(0.0))
            arm = rotate(frame, Vec3(fill(d(1.0)), zero, zero))
            put3(memory, a + wp.static(ARM), arm)
            return scaled(row(memory, z + wp.static(M)), cross(arm, Vec3(zero, fill(d(1.0)), zero)))

        @wp.func
        def moment_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            zero = fill(d(0.0))
            dar = rotate(frame, Vec3(zero, dphi.z, -dphi.y))
            return scaled(row(memory, z + wp.static(M)), cross(dar, Vec3(zero, fill(d(1.0)), zero)))

        @wp.func
        def energy(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            r = Vec3(p.x, p.y, p.z - s)
            h = row(memory, z + wp.static(H))
            arm = row3(memory, a + wp.static(ARM))
            stretched = d(0.5) * dot(r, r) - h * softened(r, h)
            return row(memory, z + wp.static(K)) * stretched - row(memory, z + wp.static(M)) * arm.y

        @wp.func
        def spring(memory: memory_type, z: int) -> Real:
            return row(memory, z + wp.static(K))

        return SimpleNamespace(
            force=force,
            force_variation=force_variation,
            moment=moment,
            moment_variation=moment_variation,
            spring=spring,
            energy=energy,
        )


class Push(mr.Load):
    """``f = k r``, ``r = p - (0, 0, s)``: what pushes a rod off the axis of its base, of the energy ``-k r^2/2`` per length."""

    force = by_place = conservative = True
    parameters: ClassVar = {"stiffness": (1, -2)}
    raised = ("stiffness",)

    def __init__(self, stiffness):
        self.numbers = (stiffness,)

    def values(self, section):
        return np.asarray(self.numbers)

    @classmethod
    def size(cls, sizes):
        return sizes.largest(cls, "stiffness") * FAR * sizes.furthest_end() ** 3 / sizes.least_stiffness

    @classmethod
    def push_bound(cls, sizes):
        return sizes.largest(cls, "stiffness")

    @staticmethod
    def law(numbers: SimpleNamespace) -> SimpleNamespace:
        Real, Vec3, Frame, Column, memory_type = (
            numbers.Real,
            numbers.Vec3,
            numbers.Frame,
            numbers.Column,
            numbers.memory_type,
        )
        row, d, dot, scaled = numbers.row, numbers.d, numbers.dot, numbers.scaled
        K = numbers.on_stretch("stiffness")

        @wp.func
        def force(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Vec3:
            return scaled(row(memory, z + wp.static(K)), Vec3(p.x, p.y, p.z - s))

        @wp.func
        def force_variation(
            memory: memory_type, z: int, a: int, g: int, ds: Real, frame: Frame, v: Column, dphi: Vec3, dp: Vec3
        ) -> Vec3:
            return scaled(row(memory, z + wp.static(K)), Vec3(dp.x, dp.y, dp.z - ds))

        @wp.func
        def energy(memory: memory_type, z: int, a: int, s: Real, frame: Frame, p: Vec3) -> Real:
            r = Vec3(p.x, p.y, p.z - s)
            return d(-0.5) * row(memory, z + wp.static(K)) * dot(r, r)

        return SimpleNamespace(force=force, force_variation=force_variation, energy=energy)
