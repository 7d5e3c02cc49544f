"""Which terms a scene needs: from its rods and inputs to the ``Features`` of its kernels."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

from multirod.inputs import InputSpec
from multirod.integrators import Integrator
from multirod.models.backbone.inputs import BACKBONE_INPUTS, CALLED, NOT_TAKEN, TIP_CURVATURE
from multirod.models.backbone.kernels.layout.features import Features
from multirod.models.backbone.kernels.layout.members import drives
from multirod.models.backbone.kernels.loads.foundation import Foundation
from multirod.models.backbone.kernels.loads.load import Load
from multirod.models.backbone.kernels.loads.magnetic import Magnetic
from multirod.profile import DEGREE
from multirod.rod import RodArrays

BY_INPUT: tuple[type[Load], ...] = (Magnetic,)  # loads that depend on the configuration, and act where an input does
BY_NUMBER: tuple[type[Load], ...] = (Foundation,)  # that act by what the rods are, and whose columns are asked for where none do


def terms_of(spec: InputSpec) -> tuple[str, ...]:
    """The features without which an input would not act; of one that is of a load of ``BY_INPUT`` none."""
    if spec.measured:
        return ("measured",)
    if spec.load is None or spec.name in {load.input for load in BY_INPUT} or spec.acts not in ("tip", "along"):
        return ()
    if spec.load == "moment":
        return ("follower_moment" if spec.follows else "tip_moment" if spec.acts == "tip" else "distributed_moment",)
    return ("force", *(["follower_force"] if spec.follows else []), *(["distributed_force"] if spec.acts == "along" else []))


TERMS = {spec.name: terms_of(spec) for spec in (*BACKBONE_INPUTS, TIP_CURVATURE)}
TERMS |= {name: TERMS[own] for name, own in CALLED.items()}


def scene_features(
    arrays: RodArrays,
    active: Iterable[str],
    profiles: Collection[str],
    *,
    rod_count: int,
    transmission: bool,
    held: bool = False,
    design: Sequence[str] = (),
) -> Features:
    """The terms that rods ask for, inputs by the names of those that act and of those that are functions of arclength, and
    numbers of sections by which columns are asked for."""
    acting = set(active)
    varied = [load for load in BY_NUMBER if load.of_section in design and not any(issubclass(own, load) for own in arrays.loads)]
    loads = (*(load for load in BY_INPUT if load.input in acting), *varied, *arrays.loads)
    needs = {term: True for name in acting for term in TERMS.get(name, ())}
    needs["force"] = "force" in needs or held or any(load.force for load in loads) or "distributed_force" in profiles
    return Features(
        rod_count=rod_count,
        eccentric=arrays.eccentric,
        precurvature_degree=arrays.degree,
        profile_degree=DEGREE if profiles else -1,
        shear=arrays.shear,
        members=arrays.members,
        member_rods=arrays.member_rods,
        member_degree=arrays.member_degree,
        discs=arrays.discs,
        loads=loads,
        transmission=transmission,
        anisotropic=arrays.anisotropic and rod_count > 1,
        torsion=arrays.eccentric or (rod_count > 1 and (held or arrays.torsion)),
        held=held,
        **needs,
    )


def telling(features: Features) -> Features:
    """The terms of the kernel that tells of solutions: states at nodes, the tip, how long lines are, and their derivatives."""
    carried = bool(drives(features.members))
    return replace(features, nodes=True, pose=True, lengths=carried, pose_sensitivities=True, directions=True)


def judging(features: Features) -> Features:
    """The same with columns at nodes, which tell stability."""
    return replace(telling(features), node_columns=True)


def teller(features: Features, integrator: Integrator) -> Features | None:
    """The terms of the kernel that tells of what one of these terms has solved: that which judges it too, where it may be.

    A kernel must have the same unknowns. At equal steps it must carry the force in the same way too: what they leave of a shape
    would else not be what they leave of the solution.
    """
    for terms in (judging(features), telling(features)):
        alike = integrator.adaptive or terms.force_is_state == features.force_is_state
        if alike and terms.unknown_count == features.unknown_count:
            return terms
    return None


def problem_features(
    arrays: RodArrays,
    active: Iterable[str],
    profiles: Collection[str],
    integrator: Integrator,
    *,
    transmission: bool,
    held: bool,
    design: Sequence[str],
    pose: bool,
    lengths: bool,
    pose_sensitivities: bool,
    directions: bool,
) -> Features:
    """The same with what is asked of a problem."""
    rod_count = arrays.end.shape[1]
    needed = scene_features(arrays, active, profiles, rod_count=rod_count, transmission=transmission, held=held, design=design)
    lengths = lengths and bool(drives(needed.members))
    features = replace(
        needed, design=bool(design), pose=pose, lengths=lengths, pose_sensitivities=pose_sensitivities, directions=directions
    )
    asked = pose_sensitivities and directions and not design and integrator.precision == "float64"
    # who asks for a derivative of the pose soon asks for the shape or the stability: one kernel says all
    return (teller(features, integrator) if asked else None) or features


def takes(features: Features, name: str) -> bool:
    """Whether an input may act: whether the terms that it needs are there."""
    own = [load for load in BY_INPUT if load.input == name]
    if name in NOT_TAKEN:
        return False
    return all(load in features.loads for load in own) and all(getattr(features, term) for term in TERMS.get(name, ()))
