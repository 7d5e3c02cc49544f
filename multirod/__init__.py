"""Static equilibria of robots made of slender elastic rods.

Compose an assembly of rods, give it actuation and loads, and get its equilibrium with a known error::

    import multirod as mr

    wire = mr.Rod(length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(14, 5, 0))
    robot = mr.SingleRod(wire)
    solution = mr.solve(robot, robot.inputs(rotation=0.1, tip_force=(1, 0, 0)))
    print(solution.tip_position)

SI units, radians; rotation matrices are body to world.
"""

import typing as _typing
from importlib import import_module as _import_module
from importlib.util import find_spec as _find_spec

from multirod.collecting import without_collections as _without_collections

if _find_spec("multirod.models") is None:
    raise ImportError(
        f"{__file__} is a bare checkout folder, and hides the package where that is installed: work in another folder, "
        "or run `pip install -e .` here; "
        "to test an installed wheel use `pytest`, not `python -m pytest`"
    )

if _typing.TYPE_CHECKING:
    from multirod import recording as recording
    from multirod import testing as testing
    from multirod.assembly import Assembly
    from multirod.files import load
    from multirod.inputs import Inputs, InputSpec
    from multirod.integrators import RK4, RK23, RK45, AdaptiveIntegrator, FixedStepIntegrator, Integrator, Tableau
    from multirod.kernels.compiling import CompileError
    from multirod.models.assemblies.concentric_tubes import ConcentricTubes
    from multirod.models.assemblies.eccentric_tubes import EccentricTubes
    from multirod.models.assemblies.held_rod import HeldRod
    from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
    from multirod.models.assemblies.multibackbone import multibackbone
    from multirod.models.assemblies.network import Network
    from multirod.models.assemblies.parallel_rods import ParallelRods
    from multirod.models.assemblies.single_rod import SingleRod
    from multirod.models.assemblies.stacked import stacked
    from multirod.models.backbone.kernels.loads.load import Load
    from multirod.models.backbone.members.line_kinds import Chamber, PushRod, Tendon
    from multirod.models.backbone.members.member import Member
    from multirod.models.network.joining.bodies import Body, ground
    from multirod.models.network.joining.joints import Joint
    from multirod.plausibility import PlausibilityWarning
    from multirod.problem import Block, BoundaryProblem, Shape
    from multirod.recording import Recorder
    from multirod.results.events import BranchEvent
    from multirod.results.history import History
    from multirod.results.solution import IncompleteWarning, Solution, SolveError
    from multirod.results.wrenches import Wrench
    from multirod.rod import Rod, Section
    from multirod.running.simulation import simulate, solve
    from multirod.running.tracker import Tracker
    from multirod.solver import Outcome, Solver, Track, registered_solvers
    from multirod.solvers.energy_descent import EnergyDescent
    from multirod.solvers.multiple_shooting import MultipleShooting
    from multirod.solvers.observer import Observer
    from multirod.solvers.scipy_shooting import ScipyShooting
    from multirod.solvers.shooting import Shooting
    from multirod.stability import Stability
    from multirod.status import Status
    from multirod.studies.critical_loads import CriticalLoad, CriticalLoads, critical_loads
    from multirod.studies.equilibria import Equilibria, equilibria
    from multirod.studies.sweeps import Study, sweep
    from multirod.studies.terms import Dropped, Explanation, Term, explain
    from multirod.studies.tradeoffs import Measured, Tradeoff, tradeoff, tune
    from multirod.tasks.controlling.command import Command
    from multirod.tasks.controlling.controller import Controller
    from multirod.tasks.estimating.calibrate import Calibration, calibrate
    from multirod.tasks.estimating.estimate import Estimate, estimate
    from multirod.tasks.estimating.estimator import Estimator
    from multirod.tasks.estimating.priors import Prior, Walk
    from multirod.tasks.limits import Limits
    from multirod.tasks.measuring.curvature import Curvature
    from multirod.tasks.measuring.force_torque import ForceTorque
    from multirod.tasks.measuring.tension import Tension
    from multirod.tasks.reaching.reach import reach
    from multirod.tasks.reaching.reached import Reached
    from multirod.tasks.rows import Pose

__version__ = "0.1.0"

__all__ = [
    "RK4",
    "RK23",
    "RK45",
    "AdaptiveIntegrator",
    "Assembly",
    "Block",
    "Body",
    "BoundaryProblem",
    "BranchEvent",
    "Calibration",
    "Chamber",
    "Command",
    "CompileError",
    "ConcentricTubes",
    "Controller",
    "CriticalLoad",
    "CriticalLoads",
    "Curvature",
    "Dropped",
    "EccentricTubes",
    "EnergyDescent",
    "Equilibria",
    "Estimate",
    "Estimator",
    "Explanation",
    "FixedStepIntegrator",
    "ForceTorque",
    "HeldRod",
    "History",
    "IncompleteWarning",
    "InputSpec",
    "Inputs",
    "Integrator",
    "InverseParallelRods",
    "Joint",
    "Limits",
    "Load",
    "Measured",
    "Member",
    "MultipleShooting",
    "Network",
    "Observer",
    "Outcome",
    "ParallelRods",
    "PlausibilityWarning",
    "Pose",
    "Prior",
    "PushRod",
    "Reached",
    "Recorder",
    "Rod",
    "ScipyShooting",
    "Section",
    "Shape",
    "Shooting",
    "SingleRod",
    "Solution",
    "SolveError",
    "Solver",
    "Stability",
    "Status",
    "Study",
    "Tableau",
    "Tendon",
    "Tension",
    "Term",
    "Track",
    "Tracker",
    "Tradeoff",
    "Walk",
    "Wrench",
    "calibrate",
    "critical_loads",
    "equilibria",
    "estimate",
    "explain",
    "ground",
    "load",
    "multibackbone",
    "reach",
    "registered_solvers",
    "simulate",
    "solve",
    "stacked",
    "sweep",
    "tradeoff",
    "tune",
]

# where each public name is, to be loaded when it is first used: Warp alone takes more than half a second
_PUBLIC = {
    "assembly": "Assembly",
    "kernels.compiling": "CompileError",
    "studies.critical_loads": "CriticalLoad CriticalLoads critical_loads",
    "studies.equilibria": "Equilibria equilibria",
    "results.events": "BranchEvent",
    "files": "load",
    "inputs": "Inputs InputSpec",
    "models.assemblies.concentric_tubes": "ConcentricTubes",
    "models.assemblies.eccentric_tubes": "EccentricTubes",
    "models.backbone.kernels.loads.load": "Load",
    "models.backbone.members.line_kinds": "Chamber PushRod Tendon",
    "models.backbone.members.member": "Member",
    "results.history": "History",
    "integrators": "RK4 RK23 RK45 AdaptiveIntegrator FixedStepIntegrator Integrator Tableau",
    "models.assemblies.held_rod": "HeldRod",
    "models.assemblies.multibackbone": "multibackbone",
    "models.assemblies.network": "Network",
    "models.network.joining.bodies": "Body ground",
    "models.network.joining.joints": "Joint",
    "models.assemblies.inverse_parallel_rods": "InverseParallelRods",
    "models.assemblies.parallel_rods": "ParallelRods",
    "models.assemblies.single_rod": "SingleRod",
    "models.assemblies.stacked": "stacked",
    "plausibility": "PlausibilityWarning",
    "problem": "Block BoundaryProblem Shape",
    "recording": "Recorder",
    "rod": "Rod Section",
    "running.simulation": "simulate solve",
    "results.solution": "IncompleteWarning Solution SolveError",
    "results.wrenches": "Wrench",
    "solver": "Outcome Solver Track registered_solvers",
    "solvers.energy_descent": "EnergyDescent",
    "solvers.multiple_shooting": "MultipleShooting",
    "solvers.observer": "Observer",
    "solvers.scipy_shooting": "ScipyShooting",
    "solvers.shooting": "Shooting",
    "stability": "Stability",
    "status": "Status",
    "studies.sweeps": "Study sweep",
    "studies.terms": "Dropped Explanation Term explain",
    "tasks.estimating.calibrate": "Calibration calibrate",
    "tasks.measuring.curvature": "Curvature",
    "tasks.measuring.force_torque": "ForceTorque",
    "tasks.measuring.tension": "Tension",
    "tasks.estimating.estimate": "Estimate estimate",
    "tasks.estimating.estimator": "Estimator",
    "tasks.estimating.priors": "Prior Walk",
    "tasks.controlling.command": "Command",
    "tasks.controlling.controller": "Controller",
    "tasks.limits": "Limits",
    "tasks.reaching.reach": "reach",
    "tasks.reaching.reached": "Reached",
    "tasks.rows": "Pose",
    "running.tracker": "Tracker",
    "studies.tradeoffs": "Measured Tradeoff tradeoff tune",
}
_HOME = {name: f"multirod.{module}" for module, names in _PUBLIC.items() for name in names.split()}


if not _typing.TYPE_CHECKING:  # which would take any name for one that there is

    def __getattr__(name: str) -> object:
        """A public name or a module of the package, when it is first asked for."""
        if name in _HOME:
            with _without_collections():
                found: object = getattr(_import_module(_HOME[name]), name)
            globals()[name] = found
            return found
        if not name.startswith("_") and _find_spec(f"multirod.{name}") is not None:
            return _import_module(f"multirod.{name}")
        from multirod.naming import OF_PACKAGE

        hint = f"; did you mean {OF_PACKAGE[name]}?" if name in OF_PACKAGE else ""
        raise AttributeError(f"module 'multirod' has no attribute {name!r}{hint}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
