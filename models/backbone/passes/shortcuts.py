"""Launches that take less: of instances that are alike, without poses until the end, and by few steps on the way."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from multirod.kernels.warp_types import Struct
from multirod.models.backbone.passes.lane_pass import LanePass
from multirod.problem import FEW
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.models.backbone.problem import BackboneProblem

COARSER = 5  # times fewer steps of what is on its way: of RK4, an error 600 times as large
WORTH = 25  # steps from which that saves time: an integration takes as long as twenty beside them
COARSE_ORDER = 4  # of the method, at least
LOOSE, WORTH_LOOSE = 1e-5, 1e-7  # tolerance of such steps that their errors choose; that of all from which that saves time
POSES_APART = 64  # instances from which leaving poses out saves more than two kernels cost


def integrate_alike(problem: "BackboneProblem") -> bool:
    """Integrate one instance for all, where no load acts yet and nothing else tells them apart; False if that is not so."""
    shared = not (problem.arrays.batch_shape or problem.base.ndim > 2)
    if not problem.on_host or problem.instance_count <= FEW or not shared or problem.derivatives.followed:
        return False
    loads = np.concatenate([np.arange(own.start, own.stop) for _, own in problem.sizes.loads])
    inputs = np.delete(problem.read("inputs"), loads, axis=1)
    unknowns, active = problem.read("unknowns"), problem.buffer("active")
    if not active.all() or problem.buffer("load_factor").any() or any((own != own[0]).any() for own in (inputs, unknowns)):
        return False
    with problem.only(np.arange(problem.instance_count) == 0):
        problem.integrate()
    for name in ("residual", "gamma"):
        problem.write(name, problem.read(name)[0])
    for array in (problem.fault, problem.step_count):
        array.fill_(int(array.numpy()[0]))
    return True


@contextmanager
def without_poses(problem: "BackboneProblem", call: Struct) -> Iterator[None]:
    """Within it, launches leave the pose out, of many single rods at fixed steps, whose kernels round alike with it and without.

    What finds the poses in the end carries no columns and costs half an integration, which is not counted. ``call`` are the
    arguments of the problem's own launches.
    """
    f, alike = problem.features, len(problem.rods) == 1 and problem.integrator.steps is not None
    if not alike or not f.pose or f.pose_sensitivities or problem.instance_count < POSES_APART:
        yield
        return
    whole = problem.launch
    problem.launch = problem.tool("without poses", lambda: problem.lane_pass(replace(f, pose=False), call))
    problem.launch.set_dim(problem.listed)
    try:
        yield
    finally:
        problem.launch = whole
    with problem.everyone():
        problem.tool("poses", lambda: problem.lane_pass(replace(f, directions=False), call, columns=(0, 0))).launch()


def coarse(problem: "BackboneProblem") -> LanePass | None:
    """The problem's own launch by fewer steps, of the same kernel; None where that saves little, or tells little."""
    integrator, steps = problem.integrator, problem.integrator.steps
    worth = integrator.rtol <= WORTH_LOOSE if steps is None else steps >= WORTH
    if not worth or integrator.tableau.order < COARSE_ORDER or not problem.on_host or not isinstance(problem.launch, LanePass):
        return None
    call = problem.buffers.call()
    if steps is None:
        call.rtol, call.atol = LOOSE, max(integrator.atol, LOOSE * integrator.atol / integrator.rtol)
    else:
        call.steps, call.step_multiple = float(-(-steps // COARSER)), 1.0
    return problem.lane_pass(problem.launch.features, call, columns=problem.launch.columns)


def coarse_turning(problem: "BackboneProblem") -> FloatArray:
    """By how much rods turn in one of its steps: as they are at rest, as a load curls an end over ``L/sqrt(F L^2/EI)``,
    as they are twisted, or as waves in a medium do [rad]; 0 where their errors choose them."""
    if problem.integrator.adaptive:
        return np.zeros(problem.instance_count)
    sizes, steps = problem.sizes, -(-(problem.integrator.steps or 1) // COARSER)
    along = sizes.furthest_end() * sizes.curvature
    return np.asarray(np.max([along, np.sqrt(problem.load_scale()), along * 0 + sizes.twist, sizes.waves()], axis=0) / steps)
