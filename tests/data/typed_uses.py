"""Right and wrong uses of the package, read by mypy and pyright and never run: each reports the marked lines, and no other.

A line that ends in ``# wrong`` is reported by both.
"""

from typing import TYPE_CHECKING, Literal, TypedDict, Unpack

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import multirod as mr
from multirod.models.assemblies.inputs import SingleRodInputs
from multirod.types import Numbers

wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
tube = mr.Rod.tube(length=0.4, outer_diameter=3e-3, inner_diameter=2e-3, young_modulus=60e9, shear_modulus=23e9)
robot = mr.SingleRod(wire)
tubes = mr.ConcentricTubes([wire, tube])
beside = mr.EccentricTubes([wire, tube], offsets=[(0.002, 0), (-0.003, 0)])
legs = mr.ParallelRods(legs=[wire] * 6, base=np.zeros((6, 4, 4)), platform=np.zeros((6, 4, 4)))
pose = legs.inverse(limits=(0, 0.1))

# ---- inputs by name ----

robot.inputs()
inputs = robot.inputs(rotation=0.1, tip_force=(1, 0, 0), gravity=[0, 0, -9.81], tip_curvature=None, tension=np.ones(2))
robot.inputs(rotation=np.float64(0.1), tip_force=np.zeros((1000, 3)), tip_moment=[np.zeros(3), np.ones(3)], translation=1)
robot.inputs(distributed_force=lambda s: (0, 0, -s), distributed_moment=(0, 0, 0))
robot.inputs(tip_forc=(1, 0, 0))  # wrong
robot.inputs(force_point=(0, 0, 0))  # wrong
robot.inputs((1, 0, 0))  # wrong
robot.inputs(tip_force="1 N")  # wrong
robot.inputs(gravity=lambda s: (0, 0, -s))  # wrong
tubes.inputs(rotation=(0.1, 0.2), translation=(-0.2, -0.1), gravity=(0, 0, -9.81))
tubes.inputs(tip_curvature=(0, 0, 0))  # wrong
tubes.inputs(pressure=1e5)
beside.inputs(pressure=1e5)  # wrong
beside.inputs(rotation=(0.1, 0.2), translation=(-0.2, -0.1))
beside.inputs(gravity=(0, 0, -9.81))  # wrong
legs.inputs(translation=(0.01,) * 6, tip_force=(0, 0, -8), force_point=(0.05, 0, 0), displacement=0.01)
legs.inputs(platform_position=(0, 0, 0.3))  # wrong
pose.inputs(platform_position=(0, 0, 0.3), platform_rotation=(0.1, 0, 0), force_point=(0, 0, 0))
pose.inputs(platform_rotatoin=(0.1, 0, 0))  # wrong
common: SingleRodInputs = {"rotation": 0.1, "tip_force": (1, 0, 0)}
robot.inputs(**common)
misspelt: SingleRodInputs = {"rotatoin": 0.1}  # wrong

# ---- one sample at a time ----

tracker = mr.Tracker(robot, solver=mr.Observer(R=120, Q=30), dt=0.005)
tracker.step()
tracker.step(inputs)
tracker.step(rotation=0.1, tip_curvature=(1, 2, 3))
tracker.step(rotatoin=0.1)  # wrong
tracker.step(force_point=(0, 0, 0))  # wrong
tracker.step(inputs, inputs)  # wrong
of_legs = mr.Tracker(legs, dt=0.01)
of_legs.step(force_point=(0, 0, 0))
of_legs.step(tip_curvature=(1, 2, 3))  # wrong
mr.Tracker(robot, dt=0.01, sover=mr.Shooting())  # wrong
mr.Tracker(wire, dt=0.01)  # wrong

# ---- a solution ----

solution = mr.solve(robot, inputs, solver=mr.Shooting(tolerance=1e-9, integrator=mr.RK4(steps=100)), guess=(14, 5, 0))
solution.jacobian("tip_curvature")
solution.jacobian("tip_force", of="line_length")
solution.jacobian("tip_force", "rotation")
solution.jacobian("tip_forc")  # wrong
solution.jacobian("rotation", "tip_forc")  # wrong
solution.jacobian("force_point")  # wrong
solution.jacobian("tip_force", of="length")  # wrong
mr.solve(legs).jacobian("force_point")
mr.solve(tubes).jacobian("tension")
mr.solve(beside).jacobian("tension")  # wrong
mr.solve(pose).jacobian("platform_position")
tracker.step(rotation=0.2).jacobian("tip_curvature")
of_legs.step().jacobian("tip_curvature")  # wrong
solution.raise_if_failed().jacobian("tip_forc")  # wrong
solution[0].jacobian("tip_forc")  # wrong
pose.translations(mr.solve(pose))
solution.assembly.rods[0].length.max()
mr.solve(legs).assembly.legs
solution.assembly.legs  # wrong
solution.tip_positon  # wrong
position: NDArray[np.float64] = solution.tip_position
text: str = solution.tip_position  # wrong
mr.solve(robot, inputs, solvr=mr.Shooting())  # wrong
mr.solve(wire)  # wrong
mr.solve(robot, guess="straight")  # wrong
mr.solve(robot, guess=solution, instances=[0, 5], progress=print)
shape = solution.rod("inner", nodes=11)
shape.curvature.max()
shape.curvatures  # wrong

solution.plot("curvature", colour_by="residual")
solution.plot("curvatur")  # wrong
solution.plot("tip")  # wrong
axes = solution.plot(nodes=51, ax=solution.plot())
axes.set_title("a wire")
axes.view_init(elev=30)
axes.figure.savefig("a.png")
axes.set_titel("a wire")  # wrong
solution.plot("moment", ax=plt.subplots(3)[1])[0].set_ylim(0, 1)
solution.plot(ax="3d")  # wrong
solution.save("shape.glb", nodes=101, corners=12)
solution.save("shape.glb", node=101)  # wrong
solution.save("run.rrd", colour_by="residual")  # wrong
inputs[0:5].without(["gravity"])
inputs["gravity"]  # wrong

# ---- one instance or a batch: no checker can tell ----

single: mr.Status = mr.Status(int(solution.status))
if solution.status is mr.Status.CONVERGED or solution.status == mr.Status.CONVERGED:
    print(solution.status.name, solution.status.message, solution.status.failed)
batch = mr.solve(robot, robot.inputs(tip_force=np.zeros((1000, 3))))
failed = np.flatnonzero(batch.status != mr.Status.CONVERGED)
print((batch.status == mr.Status.CONVERGED).all(), mr.Status(batch.status[failed[0]]).message)
solution.status.mesage  # wrong
mr.Status.CONVERGD  # wrong
if solution.stability == mr.Stability.STABLE and solution.stability.name and solution.index == 0:
    print(solution.iterations.sum(), solution.integrations.max(), batch.index.max())
solution.stability.stable  # wrong
solution.iterations.totl  # wrong

# ---- a motion, several equilibria, critical loads ----

t = np.arange(0, 2, 0.005)
history = mr.simulate(robot, robot.inputs(rotation=t), time=t, solver=mr.Observer(feed_forward=True))
history.jacobian("rotation")
history.jacobian("rotatoin")  # wrong
statuses: NDArray[np.int32] = history.status
history.status.message  # wrong
history.step_time.max()
history.plot("tip")
history.plot("tipp")  # wrong
history.plot("tip").set_xlim(0, 1)
history.plot("tip", color_by="energy")  # wrong
history.save("run.rrd", colour_by=np.zeros((400,)), reference=history)
history.save("shape.glb", corners=12)
history.save("run.rrd", color_by="energy")  # wrong
history.show(width=800, name="wire")
history.show(wide=800)  # wrong
mr.recording.save("run.rrd", history, colour_by="energy")
mr.recording.save("run.rrd", history, colour_by=3j)  # wrong
loaded: mr.Solution = mr.load("run.npz")
mr.load("inputs.toml", robot=robot).given.count("rotation")
mr.load("inputs.toml", robot=wire)  # wrong
history[3].status.message
found = mr.equilibria(robot, inputs)
found.jacobian("tip_force")
found.jacobian("tip_forc")  # wrong
print(found.stability.sum(), found.missing, found.continuum.any(), found.strain.max())
critical = mr.critical_loads(robot, inputs)[0]
print(critical.load_factor, critical.solution.status.name, critical.solution.jacobian("tip_force"))
critical.loadfactor  # wrong
table = mr.tradeoff(robot, robot.inputs(rotation=t), time=t)
print(table.rows)
table.bst()  # wrong
for term in mr.explain(robot, inputs).terms:
    print(term.name, term.error)
mr.explain(robot, inputs).term  # wrong
study = mr.Study("folder")
study["tip_position"].max()
study.done.all()
study.finishd  # wrong
solver: type[mr.Solver] = mr.registered_solvers()["shooting"]


# ---- rods ----

mr.Rod(length=0.3, bending_stiffness=(0.02, 0.03), torsional_stiffness=0.015, precurvature=lambda s: (s, 0, 0))
mr.Rod(length=np.linspace(0.1, 0.2, 5), bending_stiffness=0.02, torsional_stiffness=np.inf)
mr.Rod(length=0.4, bending_stiffness=0.02, torsional_stiffness=0.02, precurvature=[(0.3, (0, 0, 0)), (0.1, (14, 5, 0))])
mr.Rod(lenght=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638)  # wrong
mr.Rod(length="0.4 m", bending_stiffness=0.2233, torsional_stiffness=0.0638)  # wrong
mr.Rod(0.4, 0.2233, 0.0638)  # wrong
mr.Rod.tube(length=0.4, diameter=3e-3, young_modulus=60e9, shear_modulus=23e9)  # wrong
section = mr.Section(length=0.2, bending_stiffness=0.02, torsional_stiffness=0.015, precurvature=(3, 0, 0))
section.bending_stiffness[..., 0].max()
section.bendng_stiffness  # wrong
mr.Section(length=0.2, bending_stiffness=0.02, torsional_stifness=0.015)  # wrong
mr.Rod(sections=[section, section])
mr.Tendon((0.005, 0))
mr.Tendon(lambda s: (0.005, 0))  # wrong
mr.Tendon((0.005, 0), drivn="displacement")  # wrong
mr.Chamber((0.005, 0), area=1e-5)
mr.SingleRod(wire, base=np.eye(4))
mr.SingleRod(rod=wire, bse=np.eye(4))  # wrong
mr.SingleRod([wire])  # wrong
mr.ConcentricTubes(wire)  # wrong
mr.ParallelRods(legs=[wire] * 6, base=np.zeros((6, 4, 4)), platform=np.zeros((6, 4, 4)), joint="spherical")  # wrong
mr.Observer(gain=3)  # wrong
mr.Shooting(tolerence=1e-9)  # wrong
mr.no_such_name  # wrong
mr.recording.save("run.rrd", history)
mr.testing.check_assembly


# ---- an assembly of someone else's, who writes no types of inputs ----


class Sprung(mr.SingleRod):
    """Takes what a single rod takes."""


class Other(mr.Assembly):
    """Takes what its ``input_specs`` say."""


class OtherInputs(TypedDict, total=False):
    """What it takes, said."""

    spring: Numbers


class Typed(Other):
    """The same, for checkers too."""

    if TYPE_CHECKING:
        _input_name: Literal["spring"]

    def inputs(self, **values: Unpack[OtherInputs]) -> mr.Inputs:  # type: ignore[override]
        """As the package's robots do."""
        return super().inputs(**values)


def typed_robot(other: Typed) -> None:
    """Names that a checker knows."""
    other.inputs(spring=0.1)
    other.inputs(rotation=0.1)  # wrong
    mr.Tracker(other, dt=0.01).step(spring=0.2)
    mr.Tracker(other, dt=0.01).step(rotation=0.2)  # wrong
    mr.solve(other).jacobian("spring")
    mr.solve(other).jacobian("rotation")  # wrong


def any_robot(other: Other, some: mr.Assembly, tracker: mr.Tracker, result: mr.Solution) -> mr.Solution:
    """Names that no checker knows pass."""
    other.inputs(spring=0.1)
    mr.Tracker(other, dt=0.01).step(spring=0.2)
    mr.solve(other).jacobian("spring")
    mr.solve(some).jacobian("spring")
    tracker.step(spring=0.2)
    print(result.status.message, result.tip_position.max())
    result.jacobian("spring")
    Sprung(wire).inputs(tip_forc=(1, 0, 0))  # wrong
    return mr.solve(robot)


any_robot(Sprung(wire), robot, tracker, history)  # wrong
