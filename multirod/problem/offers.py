"""What only some boundary problems offer, and what is assumed of those that do not."""

from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.capabilities import Clamps, Conjugates, Joints, Lines, Parts, Released, ResultTest, Shapes, Starts
from multirod.out_of_reach import Reach
from multirod.problem.buffers import Buffers
from multirod.segments import Segments
from multirod.stability import StabilityAnalysis
from multirod.stand_in import StandIn, StandIns
from multirod.status import IntArray, Status, failures
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.results.events import BranchEvent

BegunAgain = tuple[NDArray[np.bool_], FloatArray, NDArray[np.integer[Any]] | int]
NEUTRAL_VALUE = 1e-12  # of the largest singular value of Gamma: with less, straight rods answer a force along themselves
STILL = 1e-6  # of a change of unknowns (norm 1): those that change by less do not


def neutral_ways(gamma: FloatArray) -> FloatArray:
    """Changes of the unknowns that ``Gamma`` (n, n) answers by nothing, as orthogonal rows (m, n)."""
    _, sizes, ways = np.linalg.svd(gamma)
    return np.asarray(ways[sizes < NEUTRAL_VALUE * sizes[0]])


class Offers(Buffers):
    """What a ``BoundaryProblem`` offers beside residual and ``Gamma``: objects, or None, and answers to what solvers ask.

    Attributes:
        passed: By instance, what happened on the way to where ``guess`` begins, as it was last called.
        gives_way: Whether ends of rods give way until the load factor is 1, in proportion to what is missing: ``Gamma`` may
            change much in a step to the full load, however short, while that is more than what rods themselves give way by.
        held_torques: Unknowns, by their numbers, that are torques in rods whose tips are held.
        reach: Whether ends can be where they are to be, where that is known.
        stand_ins: What makes problems that stand for its instances, given by the assembly, if anything.
    """

    gives_way: bool = False
    held_torques: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
    reach: Reach | None = None
    stand_ins: StandIns | None = None
    passed: "Mapping[int, BranchEvent]" = MappingProxyType({})

    # ---- what only some offer ----

    @property
    def stability(self) -> StabilityAnalysis | None:
        """Whether equilibria are stable, and what that tells solvers."""
        return None

    @property
    def shapes(self) -> Shapes | None:
        """The rods on nodes along their arclength."""
        return None

    @property
    def lines(self) -> Lines | None:
        """What lines along the rods do."""
        return None

    @property
    def starts(self) -> Starts | None:
        """Guesses that cover where equilibria may lie."""
        return None

    @property
    def parts(self) -> Parts | None:
        """Problems of some of the instances."""
        return None

    @property
    def segments(self) -> Segments | None:
        """The problem cut into segments, for multiple shooting."""
        return None

    @property
    def segments_refused(self) -> str:
        """Why ``segments`` is None, where it is."""
        return "it is not a single rod"

    @property
    def joints(self) -> Joints | None:
        """Joints that may be taken apart."""
        return None

    @property
    def result_test(self) -> ResultTest | None:
        """What any solver's results have to pass."""
        return None

    @property
    def conjugates(self) -> Conjugates | None:
        """Which residuals are forces, and the displacements they do work on; it needs ``pose_sensitivities``."""
        return None

    @property
    def clamps(self) -> Clamps | None:
        """Clamps along the rods, of a problem that ``Parts.clamped`` made."""
        return None

    # ---- what is assumed where nothing is offered ----

    @property
    def may_jump(self) -> bool:
        """Whether a step may end on another branch, and its ends not tell: not unless ``stability`` says so."""
        return self.stability is not None and self.stability.may_jump

    def out_of_reach(self) -> NDArray[np.bool_]:
        """Whether an instance has no equilibrium because ends are farther apart than what is between them can be long, shape
        (instance_count,); False where that is not known."""
        return np.zeros(self.instance_count, dtype=bool) if self.reach is None else self.reach.exceeded()

    @property
    def may_be_taut(self) -> bool:
        """Whether ``taut`` may say so of an instance at some inputs."""
        return False

    def taut(self) -> NDArray[np.bool_]:
        """Whether a rod that does not stretch is held at its full length, shape (instance_count,): it can but be straight, with
        any force along itself, and no branch leads from there or to there."""
        return np.zeros(self.instance_count, dtype=bool)

    def free_turns(self) -> IntArray | None:
        """Which turns of each instance cost nothing at the inputs, told apart by numbers, shape (instance_count,); None where
        none ever does. Where they differ an equilibrium is one of many that are alike, and no branch leads on from it."""
        return None

    @property
    def led(self) -> NDArray[np.bool_]:
        """Which instances are held, on the path from where ``guess`` begins, against a turn that costs next to nothing, shape
        (instance_count,)."""
        return np.zeros(self.instance_count, dtype=bool)

    def led_on(self) -> AbstractContextManager[None]:
        """Within it, paths from where ``guess`` begins hold these where the load factor is 1, too; elsewhere they do not."""
        return nullcontext()

    def tells_nothing(self, unknowns: FloatArray) -> NDArray[np.bool_]:
        """Whether unknowns (instance_count, n) are those of a rod that is ``taut``: as a guess they lead nowhere. Shape
        (instance_count,)."""
        return np.zeros(self.instance_count, dtype=bool)

    def begin_again(self, status: NDArray[np.int32], reached: FloatArray, tried: int) -> BegunAgain | None:
        """Where the way to the full load may begin otherwise than by ``guess``, of instances that ended so, at these parts of it.
        It is asked twice, ``tried`` 0 and 1 times before.

        Returns:
            Which instances; unknowns (instance_count, n) that are an equilibrium of them at a ``load_factor`` of 0; how many
            integrations that took. None if there are none, as by default.
        """
        del status, reached, tried
        return None

    def standing(self, status: NDArray[np.int32]) -> tuple[NDArray[np.bool_], FloatArray] | None:
        """What may be an equilibrium at the full load though no way leads there, of instances that ended so.

        Returns:
            Which instances, and unknowns (instance_count, n); None if there are none, as by default.
        """
        del status
        return None

    def reasons(self, status: NDArray[np.int32]) -> NDArray[np.int32]:
        """Values of ``Status`` of instances without a result, those of others as they are, shape (instance_count,): what is known
        of why, where that says more than ``status`` does."""
        failed = failures(status) & (status != Status.UNDETERMINED)  # which says more
        beyond = failed & self.reach.used_up() if failed.any() and self.reach is not None else False
        return np.where(beyond, Status.OUT_OF_REACH, status).astype(np.int32)

    @property
    def periods(self) -> FloatArray | None:
        """By how much unknowns change as a joint turns around once, if nothing holds it, shape (instance_count, n): infinite of
        what is no such angle, 0 of what others tell; of what slides and nothing holds, minus what it changes by until it has slid
        away. None where nothing drives a joint on and on, as by default."""
        return None

    @property
    def held_forces(self) -> NDArray[np.intp]:
        """Unknowns, by their numbers, that are forces in rods whose tips are held."""
        return np.zeros(0, dtype=np.intp)

    def undetermined(self) -> NDArray[np.bool_]:
        """Whether forces and torques in rods could change, as far as the last integration says, and nothing else would, shape
        (instance_count,): straight rods that do not stretch, or twist, share what they carry in ways that nothing determines."""
        result = np.zeros(self.instance_count, dtype=bool)
        if not len(self.held_forces):
            return result
        gamma = self.read("gamma").reshape(self.instance_count, self.unknown_count, self.unknown_count)
        others = np.setdiff1d(np.arange(self.unknown_count), [*self.held_forces, *self.held_torques])
        for k in np.flatnonzero(np.isfinite(gamma).all(axis=(1, 2))).tolist():
            neutral = neutral_ways(gamma[k])
            result[k] = len(neutral) > 0 and np.linalg.svd(neutral[:, others], compute_uv=False).min() < STILL
        return result

    def too_long(self, instance: int) -> str:
        """Which rods of an instance that was not solved are too long, soft and loaded to be integrated in one, and what to do, as
        the end of a message; empty if none is known to be."""
        del instance
        return ""

    def least_growth(self) -> FloatArray:
        """By whose exponential errors grow along some rod at the full load, at least, shape (instance_count,); 0 where nothing
        is known of it."""
        return np.zeros(self.instance_count)

    def loose(self) -> list[str]:
        """Of each instance the body that moves most, by its name, where the assembly moves at rest and without loads though no
        rod is bent, a mechanism; ``""`` where it does not. It integrates nothing if ``guess`` was called."""
        return [""] * self.instance_count

    def unheld(self, instance: int) -> str:
        """What nothing holds where an instance turns or slides on and on, as the end of a message; empty if nothing is known."""
        del instance
        return ""

    def is_loose(self) -> NDArray[np.bool_]:
        """Whether it moves so, shape (instance_count,)."""
        return np.array([name != "" for name in self.loose()], dtype=bool)

    @property
    def kinks(self) -> NDArray[np.intp]:
        """Unknowns, by their numbers, at whose zero the residual has a kink at the full load, and none at less."""
        return np.zeros(0, dtype=np.intp)

    def released(self, instances: NDArray[np.intp], numbers: NDArray[np.intp] | None = None) -> Released | None:
        """The assemblies of some instances, (k,), without what their inputs hold; None where they hold nothing. ``numbers``
        (k,), from 1, are of the places that they are scattered to; 0, the default, is nearest to what inputs hold."""
        return None

    def stand_in(self, instance: int, unknowns: FloatArray) -> StandIn | None:
        """A problem that stands for an instance, by what the unknowns (n,) that it came to say; None where there is none, or none
        would help."""
        return None if self.stand_ins is None else self.stand_ins.made(self, instance, unknowns)  # type: ignore[arg-type]  # which it is

    @property
    def kink_inputs(self) -> NDArray[np.intp]:
        """Inputs, by their numbers, that let out what has ``kinks`` where they are lower."""
        return np.zeros(0, dtype=np.intp)

    def kinks_give(self) -> NDArray[np.bool_]:
        """Whether something that has ``kinks`` is known to stretch, shape (instance_count,)."""
        return np.zeros(self.instance_count, dtype=bool)
