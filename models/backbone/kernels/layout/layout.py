# mypy: ignore-errors
"""How the numbers of a backbone stand: its state and columns, a stretch, a place.

Numbers in parentheses are those of ``docs/model.md``.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.slots import Record, Slot

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.member import Member


def unknowns_of(features: Features, *, moment: bool | None = None, force: bool | None = None) -> Record:
    """The unknowns of a backbone, (10), and so its columns.

    Or those of a problem of the same rods with or without the ``moment`` and the base ``force``.
    """
    moment = features.moment if moment is None else moment
    force = features.base_force_unknown if force is None else force
    segment, conditions, grips = features.segment, features.condition_count, features.grip_count
    # what holds the tip says, in its joint, what its moment and its force lack
    lacking = ("joint", "joint") if features.held else ("moment", "force")
    return Record(
        [
            Slot("moment", 3 * moment, "1/length", residual=lacking[0]),
            Slot("torques", features.torque_count, "1/length", residual="torques"),  # of rods that turn against the frame
            Slot("rotation", 3 * segment, "1/length"),
            Slot("angles", features.turning_count * segment, "1/length"),  # of rods against the frame
            Slot("place", 3 * segment * features.loads_by_place, "1/length"),  # of a segment, where loads depend on it
            Slot("lengths", conditions * segment, "1/length"),  # of members whose drive is unknown, up to a segment
            Slot("grips", grips * segment, "1/length"),  # what friction leaves of drives there
            Slot("drives", conditions, "1/length", residual="conditions"),  # of members whose drive is unknown
            Slot("force", 3 * force, "1/length", residual=lacking[1]),
        ]
    )


def residuals_of(unknowns: Record) -> Record:
    """The residuals that stand for unknowns, (11) to (13), (L7), in their order."""
    sizes: dict[str, int] = {}
    for slot in unknowns.named.values():
        if slot.residual is not None:
            sizes[slot.residual] = sizes.get(slot.residual, 0) + slot.size
    return Record(Slot(name, size, "1/length") for name, size in sizes.items())


def of_whole(unknowns: Record) -> NDArray[np.intp]:
    """Places of the unknowns of the rod among those of its segments: of those for which residuals stand."""
    every, named = np.arange(unknowns.size), unknowns.named.values()
    return np.concatenate([every[unknowns.places[slot.name]] for slot in named if slot.residual is not None])


def breakpoint_state(features: Features) -> Record:
    """The state where a segment begins, in the body frame and the frame of the base; its seeds are what varies there."""
    return Record(
        [
            Slot("moment", 3 * features.moment, "moment", seed="moment"),
            Slot("frame", 4, seed="rotation"),
            Slot("position", 3, "length", seed="place"),
            Slot("angles", features.turning_count, seed="angles"),
            Slot("torques", features.torque_count, "moment", seed="torques"),
            Slot("lengths", features.condition_count, "length", seed="lengths"),  # of members whose drive is unknown
            Slot("grips", features.grip_count, seed="grips"),  # what friction has left of drives
            Slot("world_force", 3 * features.world_force_is_state, "force", seed="force"),  # n, along the axes of the base
        ]
    )


def _member_slots(k: int, kind: type["Member"]) -> list[Slot]:
    """Member k on a stretch: its parameters, then the input that drives it."""
    return [Slot(f"{k} {name}", 1) for name in (*kind.parameters, *(["drive"] if kind.drive is not None else []))]


def _load_prefix(features: Features, load: type["Load"]) -> str:
    return f"load {features.loads.index(load)} "


def _load_slots(features: Features, slots_of: Callable[[type["Load"]], list[Slot]]) -> list[Slot]:
    """Those of all loads that depend on the configuration, by names of their own."""
    return [replace(slot, name=_load_prefix(features, load) + slot.name) for load in features.loads for slot in slots_of(load)]


class Layout:
    """The records of a backbone with certain features. How many columns there are is known to a launch only.

    Attributes:
        unknowns: What is solved for, one column each.
        residuals: What is to vanish, row by row.
        state: What is integrated of the backbone itself.
        column: What is integrated of one column, the derivative of the state by an unknown or along a direction of inputs.
        given: What stands beside a column: what its direction varies of the loads and of the stretch.
        stretch: What is constant between two nodes.
        FIRST: The first rod that turns against the frame: the second of concentric rods, as the frame is the first one's.
        place: What columns need to know of the backbone at one place.
        steps: Where a lane stands on its stretch.
    """

    def __init__(self, features: Features) -> None:
        f = self.features = features
        self.n = n = f.rod_count
        self.unknowns = unknowns_of(f)
        self.residuals = residuals_of(self.unknowns)
        self.UNKNOWNS = self.unknowns.size
        self.FIRST, self.TUBES, self.ECCENTRIC = n - f.turning_count, f.turning_count > 0, f.eccentric
        self.MOMENT, self.TORQUES = f.moment, f.torque_count
        self.FRAME, self.COLUMN_FRAME = f.frame, f.column_has_frame
        self.FORCE, self.FORCE_STATE = f.force, f.force_is_state
        self.PROFILE = f.profile_degree >= 0
        self.FORCE_PER_LENGTH = f.distributed_force or self.PROFILE
        self.MOMENT_PER_LENGTH = f.distributed_moment
        self.TWISTED = f.twisted
        self.PROFILE_TERMS = max(f.profile_degree, 0) + 1
        self.CURVATURE_TERMS = f.precurvature_degree + 1
        self.VARIED = self.CURVATURE_TERMS > 1
        self.WORLD_STATE = f.world_force_is_state
        self.POSE = f.pose or f.nodes or f.pose_sensitivities or f.loads_by_place
        self.POSE_COLUMNS = f.pose_sensitivities or f.loads_by_place
        self.NODES = f.nodes
        self.FIXED = f.fixed_moment
        self.DIRECTIONS = f.directions
        self.DESIGN = f.design
        # strains that members depend on: u, and v - e3 where the rod shears
        self.STRAINS = 6 if f.shear else 3
        # what is solved for at a place: of several rods that carry members, their bending and the twist of each that does
        self.CARRIERS, carriers = f.carriers, len(f.carriers)
        self.SOLVED = 2 + carriers if carriers else self.STRAINS
        alone = bool(f.members) and not carriers
        self.member_slots = [slot for k, kind in enumerate(f.members) for slot in _member_slots(k, kind)]
        self.DRIVES = sum(kind.drive is not None for kind in f.members)
        self.CONDITIONS = f.condition_count
        self.DRIVES_VARY = self.DRIVES > 0 and (f.directions or self.CONDITIONS > 0)  # with columns
        self.LENGTHS = self.DRIVES * (f.lengths or self.CONDITIONS > 0)
        self.PULLED = f.directions or self.LENGTHS > 0 or f.friction
        self.FRICTION = f.friction
        self.FUNCTIONS, self.FUNCTION_TERMS = sum(len(kind.functions) for kind in f.members), f.member_degree + 1
        self.ROUTED = self.FUNCTIONS > 0 and (f.member_degree > 0 or f.friction)
        # an unknown base force, or a direction, makes n depend on it
        self.GIVEN_FORCE = f.force and not f.force_is_state and not self.WORLD_STATE and (f.directions or f.base_force_unknown)
        force = self.unknowns.named["force"].residual
        statics = [
            Slot("moment", 3 * self.MOMENT, "moment", True, seed="moment", residual=self.unknowns.named["moment"].residual),
            Slot("force", 3 * self.FORCE_STATE, "force", True, seed="force", residual=force),
            Slot("world_force", 3 * self.WORLD_STATE, "force", True, seed="force", residual=force),  # n, by the configuration
            Slot("angles", f.turning_count, controlled=True),
            Slot("torques", self.TORQUES, "moment", True, seed="torques", residual="torques"),
            Slot("lengths", self.LENGTHS, "length", seed="lengths", residual="conditions"),  # what drives of members work on
            Slot("grips", f.grip_count, seed="grips"),  # what friction leaves of each drive
        ]
        self.state = Record(
            [
                *statics,
                Slot("frame", 4 * self.FRAME, controlled=True, seed="rotation"),
                Slot("position", 3 * self.POSE, "length", controlled=True),
                Slot("energy", 1 * f.nodes, "moment"),
                Slot("work", 1 * f.nodes, "moment"),
            ]
        )
        self.column = Record([*statics, Slot("frame", 4 * self.COLUMN_FRAME), Slot("position", 3 * self.POSE_COLUMNS, "length")])
        directed = 1 * self.DIRECTIONS
        self.given = Record(
            [
                Slot("unit", 1),
                Slot("force", 3 * self.GIVEN_FORCE, "force"),  # dn at the start of the stretch, base frame
                Slot("drives", self.DRIVES * self.DRIVES_VARY),
                Slot("distributed_force", 3 * directed, "force per length"),
                Slot("distributed_moment", 3 * directed * self.MOMENT_PER_LENGTH, "force"),
                Slot("profile", directed),  # relative
                Slot("start", directed, "length"),  # of the arclength of the start
                Slot("growth", directed),  # (20) of the stretch, relative
                *_load_slots(f, lambda load: load.of_direction(n) if directed else []),
                Slot("shift", n * directed, "length"),  # of the rods, along themselves
                Slot("curving", 3 * self.CURVATURE_TERMS * n * f.design, "1/length"),  # (D4) of the precurvature
                Slot("softening", 3 * n * f.design),  # (D4) of stiffnesses
            ]
        )
        several = self.TUBES
        last_strains = [
            Slot("strains", self.STRAINS * alone),
            Slot("free_strains", self.STRAINS * alone),
            Slot("last_system", self.STRAINS**2 * alone),
            Slot("place", 1 * alone),
            Slot("drift", self.STRAINS * alone),
        ]
        self.LAST_STRAINS = sum(slot.size for slot in last_strains)
        self.stretch = Record(
            [
                Slot("present", n * several),  # 1 if the rod reaches this far, else 0
                Slot("bending", n * several, "stiffness"),  # EI_x, zero where it has ended
                Slot("bending_y", n * f.anisotropic, "stiffness"),
                Slot("softness", 1 * several, "1/stiffness"),  # 1 / sum of bending
                Slot("torsion", n * several, "1/stiffness"),  # 1/GJ, zero where it has ended
                Slot("offset", 2 * n * f.eccentric, "length"),
                Slot("sheath", 1 * f.eccentric, "1/stiffness"),  # what the line gives way to torsion by
                Slot("compliance", 3 * (not several), "1/stiffness"),
                Slot("shear", 3 * f.shear, "1/force"),
                Slot("precurvature", 3 * self.CURVATURE_TERMS * n, "1/length"),
                Slot("centre", n * (self.VARIED or self.ROUTED), "length"),
                Slot("slope", n * (self.VARIED or self.ROUTED), "1/length"),
                Slot("force", 3 * (f.force and not f.force_is_state and not self.WORLD_STATE), "force"),  # n at the start
                Slot("distributed_force", 3 * self.FORCE_PER_LENGTH, "force per length"),
                Slot("distributed_moment", 3 * self.MOMENT_PER_LENGTH, "force"),
                Slot("profile_force", 3 * self.PROFILE_TERMS * self.PROFILE, "force per length"),
                Slot("profile_moment", 3 * self.PROFILE_TERMS * (self.PROFILE and self.MOMENT_PER_LENGTH), "force"),
                Slot("profile_centre", 1 * self.PROFILE, "length"),
                Slot("profile_slope", 1 * self.PROFILE, "1/length"),
                Slot("from_base", 1 * bool(f.loads), "length"),  # arclength of the start
                *_load_slots(f, lambda load: load.on_stretch(n)),
                *self.member_slots,
                Slot("functions", self.FUNCTIONS * self.FUNCTION_TERMS),  # of members, the constant terms first
                Slot("unanswered", 1 * bool(f.members)),  # 1 where members left no strains for what the rod carried
                # (L20) the last strains on the stretch, what they would be without members, and their matrix, factored; where
                # they are, and what the last way to them left out
                *last_strains,
                Slot("unit_moment", 1, "moment"),  # what counts as one in the errors of a step
                Slot("unit_force", 1, "force"),
                Slot("unit_length", 1, "length"),
            ]
        )
        tube = n if several else 0
        self.place = Record(
            [
                Slot("x", 1),
                Slot("frame", 5 * self.FRAME),  # and 2 / |q|^2
                Slot("moment", 3),
                Slot("force", 3),
                Slot("curvature", 3),
                Slot("extension", 3 * f.shear),  # v - e3
                Slot("world_force", 3 * self.FIXED),  # n
                Slot("tangent", 3 * self.FIXED),  # p'
                Slot("moment_rate", 3 * self.TWISTED),  # m'
                # (7), (8): b_i - K_i u, its derivative by theta at constant u, K_i as xx, xy, yy, and cos, sin of theta_i
                Slot("tube_x", tube),
                Slot("tube_y", tube),
                Slot("slope_x", tube),
                Slot("slope_y", tube),
                Slot("stiffness", 3 * n * f.anisotropic),
                Slot("flexibility", 3 * (f.anisotropic or f.eccentric)),
                # (7o), (8o): lam of each tube, and its twist per length of itself
                Slot("stretching", n * f.eccentric),
                Slot("twisting", n * f.eccentric, "1/length"),
                Slot("torque", n * f.eccentric, "moment"),
                Slot("cosine", tube),
                Slot("sine", tube),
                *_load_slots(f, lambda load: load.at_place(n)),
                # I + C D, factored; of several rods without their twists, inverted
                Slot("system", 4 if carriers else self.STRAINS**2 * bool(f.members)),
                # of each rod that carries members, in its own frame; of one alone only where it is asked for
                Slot("member_moment", 3 * (carriers or 1 * bool(f.members and f.nodes)), "moment"),
                Slot("member_force", 3 * (carriers or 1) * bool(f.members and f.nodes), "force"),
                Slot("functions", 3 * self.FUNCTIONS * self.ROUTED),  # of members: values, then first and second derivatives
                Slot("pulls", self.STRAINS * self.DRIVES * self.PULLED),  # dw/d(u, e) of each
                Slot("drives", self.DRIVES * f.friction),
                Slot("grips", self.DRIVES * f.friction),
                Slot("strain_rates", self.SOLVED * f.friction),  # what is solved for by arclength, (L13), (L21)
                # (L14), factored; of tubes inverted without twists, and nine numbers of each that carries members, (L22)
                Slot("rate_system", (4 + 9 * carriers if carriers else self.STRAINS**2) * f.friction),
                Slot("pull_rates", (self.STRAINS) * f.friction, "force"),  # M, N by arclength, in the frame
                Slot("turn_rates", tube * f.friction, "1/length"),  # theta_i'
                Slot("rate_moment", 3 * carriers * f.friction, "force"),  # of lines of a tube by arclength, along axes of tube 1
                # by arclength: of g, then of w
                Slot("slides", (self.STRAINS * (carriers or 1) + self.LENGTHS) * (self.ROUTED and f.directions)),
                # (L16), (L18) of each of several rods that carries members: its strains in its own frame, and how much its twist
                # exceeds what its torque alone would make; D of bending and twist along the axes of rod 1, and what is left of a
                # twist; of a column, how twist and excess change
                Slot("own_strains", 3 * carriers, "1/length"),
                Slot("excess", carriers, "1/length"),
                Slot("member_stiffness", 6 * carriers),
                Slot("twist_changes", 2 * carriers),
                # at nodes, along the axes of the frame: of each rod its curvature, its moment with that of its members and
                # without; the force of all rods without that of members
                Slot("own_curvature", 3 * n * f.nodes, "1/length"),
                Slot("total_moment", 3 * n * f.nodes, "moment"),
                Slot("own_moment", 3 * n * bool(f.members and f.nodes), "moment"),
                Slot("own_force", 3 * bool(f.members and f.nodes), "force"),
                Slot("rate", self.column.size * directed),  # of what of the state stands in a column
            ]
        )
        self.steps = Record(
            [
                Slot("x", 1),  # from the start of the stretch
                Slot("length", 1),
                Slot("size", 1),  # of the next step
                Slot("left", 1),  # equal steps left of the stretch; below 1/2 it is done
                Slot("active", 1),
                Slot("count", 1),
                Slot("rejected", 1),
                Slot("longest", 1),  # first step
                Slot("controlled", 1),  # 1 if errors choose the steps, 0 if they are equal
            ]
        )

    def seed(self, name: str) -> int:
        """Where the unknowns stand with which an entry of the state begins, or would."""
        seed = self.state.named[name].seed
        assert seed is not None, name  # or it has none
        return self.unknowns.places[seed].start

    def row(self, name: str) -> int:
        """Where the residuals stand that an entry of the state answers to at the tip, or would."""
        residual = self.state.named[name].residual
        assert residual is not None, name  # or it has none
        return self.residuals.places[residual].start

    def of_member(self, k: int) -> tuple[int, int]:
        """Where the parameters of member k begin in a stretch, and its functions among those of all."""
        first = next(slot.name for slot in self.member_slots if slot.name.startswith(f"{k} "))
        return self.stretch[first], sum(len(kind.functions) for kind in self.features.members[:k])

    def slots_of(self, load: type["Load"]) -> dict[str, Callable[[str], int]]:
        """Where the numbers of a load stand: functions that find them by their names on a stretch, at a place, in a direction."""
        records = {"on_stretch": self.stretch, "at_place": self.place, "of_direction": self.given}
        prefix = _load_prefix(self.features, load)
        return {name: lambda own, record=record: record[prefix + own] for name, record in records.items()}

    def memory(self, stages: int) -> "Memory":
        """Where the records of a thread stand in its memory."""
        return Memory(self, stages)


class Memory:
    """Offsets of the records of one thread, in rows of lanes; the columns come last."""

    def __init__(self, layout: Layout, stages: int) -> None:
        self.STEPS = 0
        self.STRETCH = layout.steps.size
        self.STATE = self.STRETCH + layout.stretch.size
        self.PLACES = self.STATE + layout.state.size
        self.COLUMNS = self.PLACES + stages * layout.place.size
        self.COLUMN_SIZE = layout.column.size + layout.given.size

    def rows(self, columns: int) -> int:
        """Of a thread whose lanes carry so many columns each."""
        return self.COLUMNS + columns * self.COLUMN_SIZE
