"""Robots with a motion, by name: those that the command line knows, and ``module:function`` of one's own."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multirod.assembly import Assembly
from multirod.inputs import Inputs
from multirod.models.assemblies.concentric_tubes import ConcentricTubes
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.rod import Rod
from multirod.validation import FloatArray, array, refuse


@dataclass(frozen=True)
class Motion:
    """A robot and what is done to it over time.

    Attributes:
        robot: The assembly.
        inputs: Time as the first axis.
        time: Of the samples [s], shape (sample_count,).
    """

    robot: Assembly
    inputs: Inputs
    time: FloatArray

    def first(self, count: int) -> "Motion":
        """The first ``count`` samples."""
        return Motion(self.robot, self.inputs[:count], self.time[:count])


def paper() -> Motion:
    """The wire of the paper's experiment, turned, pushed and loaded by a turning tip force; 10 s at 200 Hz."""
    from multirod.studies.experiment import motion

    return motion()


def three_tubes(duration: float = 10.0, rate: float = 100.0) -> Motion:
    """Three concentric tubes, turned against each other, pushed and pulled, unloaded.

    The tubes are those of the public models after M. Khadem, L. Da Cruz, C. Bergeles, IROS 2018, 4920-4926.

    Args:
        duration: [s]; the tubes come back after 10.
        rate: Samples a second.
    """

    def tube(name: str, length: float, curved: float, curvature: float, bending: float, torsion: float) -> Rod:
        precurvature = [(length - curved, (0, 0, 0)), (curved, (curvature, 0, 0))]
        return Rod(length=length, bending_stiffness=bending, torsional_stiffness=torsion, precurvature=precurvature, name=name)

    robot = ConcentricTubes(
        [
            tube("inner", 0.431, 0.103, 21.3, 3.868e-3, 3.011e-3),
            tube("middle", 0.332, 0.113, 13.108, 1.7168e-2, 1.4018e-2),
            tube("outer", 0.174, 0.134, 3.5, 3.9768e-2, 5.0224e-2),
        ]
    )
    time = np.arange(round(duration * rate) + 1) / rate
    phase = 2 * np.pi * time / 10
    rotation = np.stack([phase + 0.4 * np.sin(2 * phase), phase, phase - 0.5 * np.sin(phase)], axis=-1)
    out = 0.5 - 0.5 * np.cos(2 * phase)  # from 0 to 1 and back, twice
    translation = np.stack([-0.3358 + 0.05 * out, -0.2425 + 0.03 * out, -0.0945 + 0 * out], axis=-1)
    return Motion(robot, robot.inputs(rotation=rotation, translation=translation), time)


def six_legs(duration: float = 10.0, rate: float = 100.0) -> Motion:
    """A platform on six steel rods under a load of 8 N that moves across it on a figure of eight.

    Geometry and material are those of github JohnDTill/ContinuumRobotExamples, 01_Statics/02_CSG_Inverse_Kinematics, a robot
    of the class of C. B. Black, J. Till, D. C. Rucker, IEEE T-RO 34(1), 29-47, 2018.

    Args:
        duration: [s]; the load comes back after 10.
        rate: Samples a second.
    """

    def circle(degrees: list[int], radius: float = 0.087) -> FloatArray:
        poses = np.tile(np.eye(4), (len(degrees), 1, 1))
        poses[:, 0, 3] = radius * np.cos(np.radians(degrees))
        poses[:, 1, 3] = radius * np.sin(np.radians(degrees))
        return poses

    lengths = (0.397, 0.397, 0.400, 0.422, 0.422, 0.400)
    robot = ParallelRods(
        legs=[Rod.tube(length=l, outer_diameter=2e-3, young_modulus=200e9, shear_modulus=80e9) for l in lengths],
        base=circle([-10, 10, 110, 130, 230, 250]),
        platform=circle([-50, 50, 70, 170, 190, 290]),
    )
    time = np.arange(round(duration * rate) + 1) / rate
    phase = 2 * np.pi * time / 10
    point = 0.07 * np.stack([np.sin(phase), np.sin(2 * phase), 0 * time], axis=-1)
    return Motion(robot, robot.inputs(tip_force=(0, 0, -8.0), force_point=point), time)


SCENES: dict[str, Callable[[], Motion]] = {"paper": paper, "three-tubes": three_tubes, "six-legs": six_legs}


def load(name: str) -> Motion:
    """A scene by its name, or what ``module:function`` returns: an object with ``robot``, ``inputs``, ``time``, or these.

    Modules are looked for in the working directory too.

    Raises:
        ValueError: If there is no such scene, module or function, or it does not return a motion; what the function
            itself raises goes through.
    """
    if name in SCENES:
        return SCENES[name]()
    module, colon, function = name.partition(":")
    if not (colon and module and function):
        refuse("scene", name, f"must be one of {', '.join(SCENES)}, or module:function")
    make = _function(name, module, function)
    made = make()
    parts: tuple[Any, ...] = (
        made if isinstance(made, tuple) else tuple(getattr(made, n, None) for n in ("robot", "inputs", "time"))
    )
    if len(parts) != 3:
        refuse("scene", name, f"{function}() must return robot, inputs and time, not {len(parts)} values")
    robot, inputs, time = parts
    if not isinstance(robot, Assembly):
        refuse("scene", name, f"{function}() must return a robot such as SingleRod(rod) first, not {type(robot).__name__}")
    if not isinstance(inputs, Inputs):
        refuse("scene", name, f"{function}() must return inputs made by robot.inputs(...) second, not {type(inputs).__name__}")
    return Motion(robot, robot.accept(inputs), array("time", time))


def _function(name: str, module: str, function: str) -> Callable[[], Any]:
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        found = importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not (module == error.name or module.startswith(error.name + ".")):
            raise  # what the module itself imports is not there
        refuse("scene", name, f"there is no module {module!r} in {here} or installed")
    make = getattr(found, function, None)
    if not callable(make):
        refuse("scene", name, f"module {module!r} has no function {function!r}")
    made: Callable[[], Any] = make
    return made
