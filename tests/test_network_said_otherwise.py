"""One network said in other ways: in another order, under other names, in a mirror, and larger of another material."""

import numpy as np
import pytest
from test_network import EXACT, GIVEN, mixed, pose

import multirod as mr

BASE = pose((0.3, -0.5, 0.8), (0.1, 0.2, -0.1))
MIRROR = np.diag([-1.0, 1.0, 1.0])  # of positions and forces; rotation vectors, moments and curvatures go the other way
AXIAL = ("moment", "rod_moment", "distributed_moment")
PLACES = ("plate", "top"), ("left", "right", "upper", "feeler")


def reflected(pose):
    result = np.array(pose)
    result[:3, :3], result[:3, 3] = MIRROR @ result[:3, :3] @ MIRROR, MIRROR @ result[:3, 3]
    return result


def again(robot, *, rod, body, joint, given, base):
    """The network with each part made anew: by functions of a rod, of a body, of a joint and the bodies, and of an input."""
    bodies = {own.name: body(own) for own in robot.bodies}
    joints = [joint(own, bodies.get(own.to.name, mr.ground)) for own in robot.joints]
    rods = {own.name: rod(own.sections[0]) for own in robot.rods}
    other = mr.Network(rods=rods, bodies=list(bodies.values()), joints=joints, end_effector="top", base=base)
    inputs = {
        name: {key: given(name, value) for key, value in own.items()} if isinstance(own, dict) else given(name, own)
        for name, own in GIVEN.items()
    }
    return mr.solve(other, other.inputs(**inputs), solver=EXACT).raise_if_failed()


@pytest.fixture(scope="module")
def found():
    robot = mixed(base=BASE)
    return mr.solve(robot, robot.inputs(**GIVEN), solver=EXACT).raise_if_failed()


def hold(found, other, *, moved, turned=lambda R: R, pulled=lambda N: N, bent=lambda M: M, name=lambda own: own):
    """Poses, forces and moments are those of the other, by what becomes of each; to rounding, and the tolerance of both."""
    bodies, rods = PLACES
    for own in bodies:
        np.testing.assert_allclose(other.body_position(name(own)), moved(found.body_position(own)), atol=1e-9)
        np.testing.assert_allclose(other.body_rotation(name(own)), turned(found.body_rotation(own)), atol=1e-9)
    for own in rods:
        here, there = found.rod(own), other.rod(name(own))
        np.testing.assert_allclose(there.position, [moved(p) for p in here.position], atol=1e-9)
        for value, wrench in ((pulled, "force"), (bent, "moment")):
            by_world = [(shape.rotation @ getattr(shape, wrench)[..., None])[..., 0] for shape in (here, there)]
            np.testing.assert_allclose(by_world[1], [value(one) for one in by_world[0]], rtol=1e-8, atol=1e-9)
    assert (other.status, other.stability) == (found.status, found.stability)


def test_order_and_names_say_nothing(found):
    robot = mixed(base=BASE)
    names = {own: f"{9 - k} of them" for k, own in enumerate(np.concatenate(PLACES).tolist())}
    bodies = {own.name: mr.Body(names[own.name], mass=own.mass, mass_centre=own.mass_centre) for own in robot.bodies}
    joints = [
        mr.Joint(
            *(names[own.rod], own.end),
            to=bodies.get(own.to.name, mr.ground),
            pose=own.pose,
            kind=own.kind,
            axis=axis_of(own),
            stiffness=springs_of(own),
            rest=own.rest if own.rest.any() else None,
        )
        for own in reversed(robot.joints)
    ]
    rods = {names[own.name]: own for own in reversed(robot.rods)}
    bodies = list(reversed(bodies.values()))
    other = mr.Network(rods=rods, bodies=bodies, joints=joints, end_effector=names["top"], base=BASE)
    given = {key: {names[k]: v for k, v in own.items()} if isinstance(own, dict) else own for key, own in GIVEN.items()}
    same = mr.solve(other, other.inputs(**given), solver=EXACT).raise_if_failed()
    hold(found, same, moved=lambda p: p, name=names.get)
    np.testing.assert_allclose(same.energy, found.energy, rtol=1e-9)


def axis_of(joint):
    return {"revolute": joint.axes[:1].reshape(-1), "universal": joint.axes}.get(joint.kind)


def springs_of(joint):
    return joint.stiffness[0] if joint.kind == "spherical" else joint.stiffness


def test_a_network_in_a_mirror(found):
    """Turns of joints, rolls of bases and torsion the other way, springs at rest where they were."""

    def joint(own, to):
        axis = axis_of(own)
        axis = None if axis is None else -axis @ MIRROR
        rest = own.rest if own.rest.any() else None
        where = reflected(own.pose)
        return mr.Joint(own.rod, own.end, to=to, pose=where, kind=own.kind, axis=axis, stiffness=springs_of(own), rest=rest)

    def given(name, value):
        if name in ("rotation", "translation"):
            return -value if name == "rotation" else value
        return (-1 if name in AXIAL else 1) * (MIRROR @ value)

    other = again(
        mixed(base=BASE),
        rod=lambda own: mr.Rod(
            length=own.length,
            bending_stiffness=own.bending_stiffness,
            torsional_stiffness=own.torsional_stiffness,
            precurvature=-MIRROR @ own.precurvature,
            linear_density=own.linear_density,
        ),
        body=lambda own: mr.Body(own.name, mass=own.mass, mass_centre=MIRROR @ own.mass_centre),
        joint=joint,
        given=given,
        base=reflected(BASE),
    )
    mirror = MIRROR.__matmul__
    hold(found, other, moved=mirror, turned=lambda R: MIRROR @ R @ MIRROR, pulled=mirror, bent=lambda M: -MIRROR @ M)
    np.testing.assert_allclose(other.energy, found.energy, rtol=1e-9)


def test_a_larger_network_of_another_material(found):
    """Three times as long and seven times as stiff: forces by 7/9, moments by 7/3, what acts along by 7/27."""
    long, stiff = 3.0, 7.0
    force, moment, along = stiff / long**2, stiff / long, stiff / long**3
    units = {"rotation": 1.0, "translation": long, "force": force, "moment": moment, "gravity": 1.0}

    def longer(where):
        return np.block([[where[:3, :3], long * where[:3, 3:]], [where[3:]]])

    def joint(own, to):
        springs = moment * springs_of(own)
        rest = own.rest if own.rest.any() else None
        where = longer(own.pose)
        return mr.Joint(own.rod, own.end, to=to, pose=where, kind=own.kind, axis=axis_of(own), stiffness=springs, rest=rest)

    other = again(
        mixed(base=BASE),
        rod=lambda own: mr.Rod(
            length=long * own.length,
            bending_stiffness=stiff * own.bending_stiffness,
            torsional_stiffness=stiff * own.torsional_stiffness,
            precurvature=own.precurvature / long,
            linear_density=along * own.linear_density,
        ),
        body=lambda own: mr.Body(own.name, mass=force * own.mass, mass_centre=long * own.mass_centre),
        joint=joint,
        given=lambda name, value: units.get(name, along) * np.asarray(value),
        base=longer(BASE),
    )
    hold(found, other, moved=lambda p: long * p, pulled=lambda N: force * N, bent=lambda M: moment * M)
    np.testing.assert_allclose(other.energy, moment * found.energy, rtol=1e-8)
