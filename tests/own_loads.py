"""A load of a rod's own whose energy is convex in the position: springs that hold it to a line and stiffen."""

from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import warp as wp

import multirod as mr
from multirod.models.backbone.kernels.layout.slots import Slot
from multirod.models.backbone.kernels.numbers.lanes import add, div, mul, neg, sub  # noqa: F401  (operators: looked up by name)

FAR = 0.1  # from the line, where they are as stiff as steps heed [m]


class Well(mr.Load):
    """``f = -(k + c r^2) r``, ``r = p - (0, 0, s)``, of the energy ``k r^2/2 + c r^4/4`` per length."""

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
