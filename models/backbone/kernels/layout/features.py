"""What a scene needs of its equations, and so what is compiled into its kernel."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.member import Member


@dataclass(frozen=True, kw_only=True)
class Features:
    """The terms of the equations that one backbone kernel contains (equation numbers: ``docs/model.md``).

    A kernel is generated for each distinct set of features, compiled once and cached on disk. What is not asked
    for is not compiled in: a scene with a tip force alone carries no frame, one without gravity no weight. How many columns are
    integrated is not told here: a launch says so.

    Attributes:
        rod_count: Concentric rods that carry the backbone, n >= 1.
        eccentric: The rods run side by side at offsets from a frame of their own, which does not twist, equation (7o).
        precurvature_degree: Degree of the polynomials in arclength that hold the precurvature; 0 is constant by section.
        force: An internal force acts.
        tip_moment: A dead tip moment acts, equation (11).
        distributed_force: A distributed force or gravity acts, equation (3).
        distributed_moment: A distributed moment acts, equation (4).
        profile_degree: Degree of the polynomials that hold loads given as functions of arclength; -1 if there are none.
        follower_force: The tip force has a part that follows the tip frame, so the base force is unknown, equation (13).
        follower_moment: The tip moment has a part that follows the tip frame, equation (11).
        held: Something else holds the tip: the base force is unknown, and the tip's wrench is written out, equation (22).
        loads: Loads along the rods that depend on their configuration, kinds of ``Load``: a magnetic field, equation (3d), an
            elastic medium, equation (3e), and others.
        measured: A measured tip curvature takes the place of the boundary condition, equation (12).
        members: What the rods carry along themselves, kinds of ``Member``, in the order of the rods, equation (5m).
        member_rods: Of several rods, the one that carries each.
        member_degree: Degree of the polynomials in arclength that hold what of them varies along it; 0 is constant by section.
        discs: Its lines run straight between discs, equation (L11) of ``docs/lines.md``.
        lengths: How long its lines are is integrated too: what drives of members work on.
        shear: Shear and extension, equation (5); without it ``v = e3``.
        anisotropic: Bending stiffness differs between the two axes; a distinct term for ``rod_count > 1`` only.
        torsion: One of several rods twists elastically; without it all torsional stiffnesses are infinite, equation (8c).
        transmission: The rods twist behind the base plate, equation (9).
        pose: The pose of the tip is integrated, equations (1) and (2).
        pose_sensitivities: The columns include the pose of the tip.
        directions: Some of the columns are derivatives along directions in input space, equation (20).
        nodes: States are written at nodes along the arclength, and the elastic energy is integrated.
        node_columns: So are columns, of a model with all its unknowns.
        design: Directions may change the numbers of the rods too, equations (D4) to (D7) of ``docs/derivatives.md``.
        along: States and columns are written at given arclengths, equation (D11) there.
        segment: A segment of the rods, from any state on, is integrated: the frame it begins with is an unknown too.
    """

    rod_count: int = 1
    eccentric: bool = False
    precurvature_degree: int = 0
    force: bool = False
    tip_moment: bool = False
    distributed_force: bool = False
    distributed_moment: bool = False
    profile_degree: int = -1
    follower_force: bool = False
    follower_moment: bool = False
    held: bool = False
    loads: tuple[type["Load"], ...] = ()
    measured: bool = False
    members: tuple[type["Member"], ...] = ()
    member_rods: tuple[int, ...] = ()
    member_degree: int = 0
    discs: bool = False
    lengths: bool = False
    shear: bool = False
    anisotropic: bool = False
    torsion: bool = False
    transmission: bool = False
    pose: bool = True
    pose_sensitivities: bool = False
    directions: bool = False
    nodes: bool = False
    node_columns: bool = False
    design: bool = False
    along: bool = False
    segment: bool = False

    @property
    def base_force_unknown(self) -> bool:
        """Whether what acts on the tip is not known beforehand in the world frame."""
        return self.follower_force or self.held or self.world_force_is_state

    @property
    def loads_need_frame(self) -> bool:
        """Whether a load other than a dead tip force acts, so that the frame enters the moment equations."""
        return (
            self.tip_moment
            or self.distributed_force
            or self.distributed_moment
            or bool(self.loads)
            or self.base_force_unknown
            or self.profile_degree >= 0
        )

    @property
    def fixed_moment(self) -> bool:
        """Whether a moment acts whose law is told in the world: then the state carries it along fixed axes, equation (4b)."""
        return self.tip_moment or self.distributed_moment or any(load.moment for load in self.loads)

    @property
    def twisted(self) -> bool:
        """Whether a moment along several rods twists the innermost that there is, equation (8l)."""
        spread = self.distributed_moment or any(load.moment and not load.by_rod for load in self.loads)
        return spread and self.torsion and self.turning_count > 0 and not self.eccentric

    @property
    def loaded(self) -> bool:
        """Whether anything acts on the rods but their own precurvature."""
        return self.force or self.loads_need_frame or self.follower_moment or self.measured

    @property
    def moment(self) -> bool:
        """Whether the rods together carry a moment: several unloaded ones carry none, equation (8b).

        Where they are rigid in torsion too, nothing would be left to solve for: then the moment is kept. So it is for columns at
        nodes, which say how any moment would bend the rods, and where friction asks how it changes.
        """
        alone = self.rod_count == 1 and not self.eccentric
        return alone or self.loaded or not self.torsion or self.node_columns or self.friction

    @property
    def torque_count(self) -> int:
        """Rods whose torque is a state of its own beside the moment of all: all but the first, equation (8), which has what they
        leave of it; all of them where the frame is their own."""
        return self.turning_count if self.torsion else 0

    @property
    def turning_count(self) -> int:
        """Rods that turn against the frame, which is that of the first of concentric rods."""
        return self.rod_count if self.eccentric else self.rod_count - 1

    @property
    def column_has_frame(self) -> bool:
        """Whether a column carries the variation of the frame."""
        return self.loads_need_frame or self.pose_sensitivities or self.node_columns

    @property
    def force_is_state(self) -> bool:
        """Whether the body force is integrated, equation (3b), rather than obtained from the frame, equation (3a)."""
        return self.force and not self.loads_need_frame and not self.column_has_frame

    @property
    def world_force_is_state(self) -> bool:
        """Whether the force is integrated along fixed axes, as a load's force depends on the configuration, equation (3e)."""
        return any(load.force for load in self.loads)

    @property
    def loads_by_place(self) -> bool:
        """Whether a load depends on the position of the rods."""
        return any(load.by_place for load in self.loads)

    @property
    def frame(self) -> bool:
        """Whether the frame is integrated."""
        return self.pose or self.nodes or self.loads_need_frame or self.column_has_frame

    @property
    def carriers(self) -> tuple[int, ...]:
        """Of several rods, those that carry members."""
        return tuple(sorted(set(self.member_rods)))

    @property
    def condition_count(self) -> int:
        """Members whose drive is unknown, equation (L7)."""
        return sum(kind.conditioned for kind in self.members)

    @property
    def friction(self) -> bool:
        """Whether a line rubs against what it runs through, equation (L12)."""
        return any(kind.rubs for kind in self.members)

    @property
    def grip_count(self) -> int:
        """Drives of which friction takes something along the rod."""
        return sum(kind.drive is not None for kind in self.members) * self.friction

    @property
    def unknown_count(self) -> int:
        """Unknowns of an instance; of a segment, variations where it begins."""
        count = 3 * (self.moment + self.base_force_unknown) + self.torque_count + self.condition_count
        more = 3 + self.turning_count + 3 * self.loads_by_place + self.condition_count + self.grip_count
        return count + more * self.segment
