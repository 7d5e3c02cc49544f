"""Why each instance of a solve ended."""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multirod.codes import Code, Codes

IntArray = NDArray[np.integer[Any]]
BoolArray = NDArray[np.bool_]


class Status(Code):
    """Why an instance ended. Written by kernels and recordings: never renumbered.

    ``failed`` says whether the instance's arrays hold NaN; ``message`` says what happened and what to try. Its ``name`` is a
    string; to be compared with one by ``==`` raises ``TypeError``, where Python would say that they differ. So does
    ``if solution.status:``, as failures would be true.
    """

    NOT_RUN = 0
    CONVERGED = 1
    MAX_ITERATIONS = 2
    SINGULAR_JACOBIAN = 3
    NONFINITE = 4
    STEP_LIMIT = 5
    STALLED = 6
    BRANCH_END = 7
    TRACKING = 8
    EULER_LIMIT = 9
    NEAR_FOLD = 10
    EULER_DIVERGED = 11
    LOWEST_ENERGY = 12
    SINGULAR_PIVOT = 13
    UNSTABLE_COUPLING = 14
    UNSTABLE = 15
    MULTIPLE_SHOOTING = 16
    INTEGRATION_LIMIT = 17
    OUT_OF_LIMITS = 18
    LINE_LIMIT = 19
    BIFURCATED = 20
    SNAPPED = 21
    DAMPED = 22
    REACHED = 23
    AT_LIMIT = 24
    UNREACHABLE = 25
    SINGULAR_TASK = 26
    OUT_OF_REACH = 27
    OUT_OF_HOLE = 28
    UNDETERMINED = 29
    LINES_TOO_SHORT = 30
    LOOSE = 31
    UNOBSERVABLE = 32
    OFF_TARGET = 33

    @property
    def failed(self) -> bool:
        """Whether there is no result: the instance's arrays hold NaN."""
        return self not in _WITH_RESULT

    @property
    def event(self) -> bool:
        """Whether there is a result, and the way there left the branch of equilibria that was followed: neither a failure nor
        plain convergence."""
        return self in _EVENTS

    @property
    def message(self) -> str:
        """What happened, and what to try."""
        return _MESSAGES[self]


class Statuses(Codes):
    """An array of the values of ``Status``: ``statuses[k].name``."""

    kind = Status


_WITH_RESULT = frozenset(
    {
        Status.CONVERGED,
        Status.LOWEST_ENERGY,
        Status.TRACKING,
        Status.EULER_LIMIT,
        Status.NEAR_FOLD,
        Status.SINGULAR_PIVOT,
        Status.UNSTABLE_COUPLING,
        Status.MULTIPLE_SHOOTING,
        Status.BIFURCATED,
        Status.SNAPPED,
        Status.DAMPED,
        Status.REACHED,
        Status.AT_LIMIT,
        Status.OFF_TARGET,
    }
)

# NumPy compares with a number at once, and takes its time with a member of ``Status``
NOT_RUN, CONVERGED = int(Status.NOT_RUN), int(Status.CONVERGED)
_EVENTS = frozenset({Status.LOWEST_ENERGY, Status.BIFURCATED, Status.SNAPPED, Status.DAMPED})


_CODES = np.arange(max(Status) + 1)
_FAILED = np.isin(_CODES, [int(status) for status in Status if status.failed])
_EVENT = np.isin(_CODES, [int(status) for status in _EVENTS])
_SETTLED = np.isin(_CODES, [*_EVENTS, Status.CONVERGED, Status.MULTIPLE_SHOOTING, Status.REACHED, Status.AT_LIMIT])


def failures(values: IntArray) -> BoolArray:
    """``Status.failed`` of an array of statuses."""
    return np.asarray(_FAILED.take(values, mode="clip"))


def left_branch(values: IntArray) -> BoolArray:
    """``Status.event`` of an array of statuses."""
    return np.asarray(_EVENT.take(values, mode="clip"))


def settled(values: IntArray) -> BoolArray:
    """Which of an array of statuses are of an equilibrium, neither failures nor estimates."""
    return np.asarray(_SETTLED.take(values, mode="clip"))


_MESSAGES = {
    Status.NOT_RUN: "not run",
    Status.CONVERGED: "the residual is within the tolerance",
    Status.MAX_ITERATIONS: "the iteration limit was reached: raise max_iterations, which Shooting has for each continuation step "
    "(or, without a guess, max_continuation_steps), start nearer, or loosen the tolerance",
    Status.INTEGRATION_LIMIT: "the integrations allowed for one solve, fallbacks included, were used up, or would be, before it "
    "was decided: raise max_integrations, start nearer by a guess, or follow a motion (simulate) from where a solution is known",
    Status.SINGULAR_JACOBIAN: "the Jacobian is singular here (a fold or a bifurcation): start elsewhere or change the load",
    Status.NONFINITE: "the integration overflowed: start nearer, or apply the load in smaller steps",
    Status.STEP_LIMIT: "the integrator reached its step limit: loosen rtol, or the rod is far longer than its curvature allows",
    Status.STALLED: "no step reduces the residual further: it is at rounding level of an ill-conditioned problem, or at a local "
    "minimum; loosen the tolerance, tighten the integrator, or start nearer",
    Status.BRANCH_END: "the equilibrium reached by raising the loads in proportion ends before the full load (a fold or a "
    "bifurcation: the rod snaps or buckles, critical_loads() says at which load); add a small load to the side to which it is to "
    "buckle, or give a guess, such as one of equilibria(); of an inverse problem, ask for another pose",
    Status.UNSTABLE: "the equilibrium that was found is unstable: the robot would leave it; lead it there from where it is "
    "stable (simulate), or give another guess; of an inverse problem, ask for another pose",
    Status.OUT_OF_LIMITS: "of inverse(): the translations that lead to this pose are beyond its limits=, or leave nothing of a "
    "leg in use; ask for another platform_position or platform_rotation, or give wider limits. Of reach(), where it starts, or "
    "a Controller's last command: the shape is beyond the curvature or the stability_margin of its Limits(), or that margin is "
    "not known, as of loads without a potential; begin elsewhere, or give others",
    Status.LINE_LIMIT: "a line is where its law ends, pulled or bent to less than a tenth of its rod's length at some place; or, "
    "with discs, so tight that lines together buckle the rod between two; or, with members of other packages, what the rod "
    "carries has no strains: lower tensions or loads, move discs closer, or, of lines that are held by displacement and do not "
    "stretch, let opposite ones out by negative displacements (docs/lines.md)",
    Status.LINES_TOO_SHORT: "lines that do not stretch cannot all be as short as their displacements say, or not without a "
    "tension that rises without bound: let opposite lines out by negative displacements, and all by a hundred-thousandth of the "
    "rod's length more, or give lines an axial_stiffness (docs/lines.md)",
    Status.LOWEST_ENERGY: "the residual is within the tolerance; raising loads (of tubes also precurvature and the angles "
    "between them) in proportion ends before the full load, so this is the stable equilibrium of lowest potential energy that "
    "was found from many starts (for a parallel robot whose loads have no potential, where raising these leads from "
    "there): equilibria() lists all",
    Status.BIFURCATED: "the residual is within the tolerance; on the way the robot buckled: its equilibrium lost stability where "
    "another branch crosses, and went on along that, to the side that docs/branches.md says (its twin: side='negative' of "
    "Shooting()); solution.events says where",
    Status.SNAPPED: "the residual is within the tolerance; on the way the robot snapped: its equilibrium ended, and went down in "
    "energy to another one that is stable, then on; solution.events says where, and how much energy was lost",
    Status.TRACKING: "an estimate by one integration; residual says how far it is",
    Status.EULER_LIMIT: "the observer's explicit Euler update left its stability limit: use update='exact', a shorter time "
    "step, or lower gains",
    Status.EULER_DIVERGED: "the observer's explicit Euler update left its stability limit before the residual was within the "
    "tolerance: use update='exact', a shorter dt, or lower gains",
    Status.NEAR_FOLD: "an estimate near a fold or on its way through a snap: a mode of Gamma is near zero, so the shape may be "
    "far off although the residual is not",
    Status.SINGULAR_PIVOT: "an estimate of the observer whose elimination meets a nearly singular pivot while Gamma is regular: "
    "use coupling='full', or another order of the blocks",
    Status.UNSTABLE_COUPLING: "an estimate of the observer whose closed loop is unstable, as the gains of each rod leave out "
    "what couples them: use coupling='per-rod' or 'full'",
    Status.DAMPED: "the residual is within the tolerance; loads without a potential (moments, what follows the tip, friction) "
    "drove it there through states that are no equilibria, and it came to rest as damped dynamics of the tip and of what it "
    "carries would: a robot whose inertia or damping differs may come to rest elsewhere (docs/energy_descent.md)",
    Status.REACHED: "the end effector is at its target, in an equilibrium that is stable as far as its loads let that be said",
    Status.AT_LIMIT: "the limits of the freed inputs, or of the shape, hold the end effector back from its target: it is as near "
    "as it comes on this way, target_error says how near; give wider limits, free more inputs, or let starts be tried",
    Status.UNREACHABLE: "no way to the target was found: it may be out of reach, target_error says how near the search came; ask "
    "for fewer rows (a position alone), free more inputs, begin nearer, or where it has not buckled, or let starts be tried",
    Status.SINGULAR_TASK: "the freed inputs cannot move the end effector in a direction that the target asks for, where the "
    "search ended: ask for fewer rows, free other inputs, or begin elsewhere (a straight robot's tip cannot be pushed sideways, "
    "and a line moves nothing by its displacement where it is slack, or just so)",
    Status.OUT_OF_REACH: "rods that do not stretch are held at places farther apart than they are long, or just as far, where "
    "they hold nothing across: move these nearer, take longer rods or push them out by translation, or give them an "
    "axial_stiffness",
    Status.OUT_OF_HOLE: "a rod is pulled out of a hole of a body: nothing of it is left on one side; let it out by its "
    "translation, place the hole elsewhere on it, or lower what pulls",
    Status.UNDETERMINED: "straight rods that do not stretch, or do not twist, share what they carry in ways that nothing "
    "determines: give them an axial_stiffness, or a torsional_stiffness, or hold what they carry by fewer of them (forces of "
    "those that do not stretch by three, where they stand side by side)",
    Status.LOOSE: "the network is loose, a mechanism: where it stands, bodies move though no rod is bent, and what acts does not "
    "hold them; or what acts turns a joint on and on, or slides it away, as nothing stops it: clamp a joint, turn an axis so "
    "that not all are parallel, give joints a stiffness, or lower what pushes",
    Status.UNOBSERVABLE: "fewer numbers were measured of this instance than are unknown without a prior: give these a Prior, or "
    "measure more",
    Status.OFF_TARGET: "of a Controller's sample: its command does not bring the end effector to the target, and no limit holds "
    "it: the target is farther away than a step may be, or beyond reach, or the freed inputs do not move the end effector there "
    "(as the displacement of a line that is slack: begin where all are taut); target_error says how far it is off",
    Status.MULTIPLE_SHOOTING: "the residual is within the tolerance, by multiple shooting: the rod is so long, soft or "
    "strongly loaded that its unknowns at the base alone do not determine the tip, and gamma is NaN",
}


class Fault(IntEnum):
    """Why one integration failed: what ``BoundaryProblem.fault`` holds."""

    NONE = 0
    NONFINITE = 1
    STEP_LIMIT = 2
    STRAIN_LAW = 3  # a section with members has no strains that answer to what it carries

    @property
    def status(self) -> Status:
        """Of an instance that this ends; NONE, too, where what came after the integration overflows."""
        return _OF_FAULTS.get(self, Status.NONFINITE)


_OF_FAULTS = {Fault.STEP_LIMIT: Status.STEP_LIMIT, Fault.STRAIN_LAW: Status.LINE_LIMIT}
