"""A robot in space: its rods, what runs along them, its platform, frames and loads."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multirod.models.assemblies.inverse_parallel_rods import InverseParallelRods
from multirod.models.assemblies.network import Network
from multirod.models.assemblies.parallel_rods import ParallelRods
from multirod.models.backbone.members.line_kinds import Chamber
from multirod.models.joint_kernels import JOINTS
from multirod.models.network.joining.bodies import Body
from multirod.plotting.canvas import COMPONENTS, STYLES, colors_of, in_space, legend, matplotlib
from multirod.plotting.family import Family
from multirod.problem import Shape
from multirod.recording.bodies import body_through, least_around
from multirod.recording.columns import circles
from multirod.recording.figure import DrawnRod, Plate, bases, discs, drawn_lines, drawn_rods, plate_through
from multirod.recording.loads import given, place_of, pushes
from multirod.results.solution import Solution
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

_FLATTEST = 0.45  # least extent of the box over its largest, or ticks lie on each other
_ZOOM = 0.88  # leaves room for labels
_THINNEST, _THICKEST = 1.0, 14.0  # [pt]
_BODY = 0.25  # opacity of a rod with chambers, which are within it
_ARROW = 0.25  # of the robot's size: the longest arrow of a kind
TRIAD = 0.09  # of the same: axes of a frame
_ALONG = 9  # arrows of what acts along a rod
_MARKERS = {"clamped": "s", "revolute": "D", "spherical": "o", "universal": "P", "prismatic": "^", "cylindrical": "v"}
_LINES = ("#5C5C5C", "#8C564B", "#7F7FFF", "#2E7D6B", "#B0902F", "#9A4FA0")
_FORCE, _MOMENT, _FIELD = "#C1121F", "#6A3D9A", "#444444"
_GREY = "#8A929C"


@dataclass(frozen=True)
class Arrow:
    """A load of one instance.

    Attributes:
        name: In the legend, with its size and unit.
        color: As matplotlib takes it.
        origins: Where it acts [m], shape (k, 3).
        vectors: In the world, shape (k, 3).
        kind: Those of one kind have one scale.
        turns: Of a moment: it has two heads.
    """

    name: str
    color: str
    origins: FloatArray
    vectors: FloatArray
    kind: str
    turns: bool = False


def draw(
    ax: "Axes3D", family: Family, rods: list[int], *, nodes: int, frames: bool, loads: bool, path: FloatArray | None = None
) -> None:
    """Draw the rods of all instances; of a single one also frames, loads, lines, discs and joints. ``path`` is of the tip."""
    solution, drawn = family.solution, drawn_rods(family.solution.assembly, family.solution)
    shapes = {k: solution.rod(k, nodes=nodes) for k in rods}
    plates = _plates(solution) if len(family) else []
    origins = [pose[:3, 3] for pose in bases(solution.assembly).values()]
    points = [np.array(origins), *(shape.position for shape in shapes.values()), *(face for plate in plates for face in plate)]
    if path is not None:
        points.append(path)
    robot = finite(points)
    if len(robot) == len(origins):
        robot = np.concatenate([robot, robot + [0.0, 0.0, max(float(np.max(rod.length)) for rod in solution.assembly.rods)]])
    size = float(np.linalg.norm(np.ptp(robot, axis=0))) or 1.0
    one = family.single and len(family) == 1
    arrows = _arrows(solution, shapes) if one and loads else []
    scales = {kind: _scale([a for a in arrows if a.kind == kind], size) for kind in {a.kind for a in arrows}}
    ends = [a.origins + scales[a.kind] * a.vectors for a in arrows]
    long = TRIAD * size
    frame_view(ax, np.concatenate([robot, *ends]) if ends else robot)
    scale = _points_per_metre(ax)
    if path is not None:
        ax.plot(*path.T, color="0.1", lw=1.3, ls=":", zorder=4.5, label="path of the tip")
    _rods(ax, family, drawn, shapes, scale)
    _platforms(ax, family, plates)
    if frames:
        for pose in bases(solution.assembly).values():
            triad(ax, pose[:3, 3], pose[:3, :3], long if len(origins) == 1 else 0.6 * long, letters=len(origins) == 1)
    if one:
        _discs(ax, solution, shapes)
        _lines(ax, solution, drawn, rods, nodes, scale)
        _joints(ax, solution)
        if frames:
            triad(ax, solution.tip_position, solution.tip_rotation, long, letters=True)
        for arrow in arrows:
            _draw_arrow(ax, arrow, scales[arrow.kind])
    legend(ax, loc="upper left", bbox_to_anchor=(-0.08, 1.07))


def finite(points: list[FloatArray]) -> FloatArray:
    """Those that are numbers, shape (k, 3)."""
    every = np.concatenate([np.reshape(some, (-1, 3)) for some in points])
    return np.asarray(every[np.isfinite(every).all(axis=1)])


def _scale(arrows: list[Arrow], size: float) -> float:
    """Length of arrows [m] for a unit of what they show."""
    longest = max((float(np.linalg.norm(arrow.vectors, axis=1).max()) for arrow in arrows), default=0.0)
    return _ARROW * size / longest if longest > 0 else 0.0


def frame_view(ax: "Axes3D", points: FloatArray) -> None:
    """Limits that hold these points and what was drawn before, with one scale for all axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    if ax.has_data():
        before = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
        low, high = np.minimum(low, before[:, 0]), np.maximum(high, before[:, 1])
    extent = high - low
    extent = np.maximum(1.06 * extent, _FLATTEST * (extent.max() or 1.0))
    middle = 0.5 * (low + high)
    for k, name in enumerate("xyz"):
        getattr(ax, f"set_{name}lim")(middle[k] - 0.5 * extent[k], middle[k] + 0.5 * extent[k])
        getattr(ax, f"set_{name}label")(f"{name} [m]", labelpad=14 if name == "z" else 8)
        axis = getattr(ax, f"{name}axis")
        count = 4 if extent[k] > 0.7 * extent.max() else 3
        axis.set_major_locator(matplotlib("ticker").MaxNLocator(nbins=count))
    ax.set_box_aspect(extent, zoom=_ZOOM)
    ax.tick_params(labelsize="small")


def _points_per_metre(ax: "Axes3D") -> float:
    """How long a metre across the view is on paper [pt], in the middle of the box."""
    middle = np.array([np.mean(getattr(ax, f"get_{name}lim")()) for name in "xyz"])
    turn = np.radians(ax.azim)
    step = 0.01 * np.ptp(ax.get_xlim())
    aside = middle + step * np.array([-np.sin(turn), np.cos(turn), 0.0])
    ax.apply_aspect()
    projection = ax.get_proj()
    places = [ax.transData.transform(in_space("proj3d").proj_transform(*place, projection)[:2]) for place in (middle, aside)]
    return float(np.linalg.norm(places[1] - places[0]) / step * 72.0 / ax.figure.dpi)


def _width(radius: float, scale: float, thickest: float = _THICKEST) -> float:
    return float(np.clip(2 * radius * scale, _THINNEST, thickest))


def _rods(ax: "Axes3D", family: Family, drawn: list[DrawnRod], shapes: dict[int, Shape], scale: float) -> None:
    """Tubes are drawn innermost first, so that each lies on those that it is around."""
    colors = None if family.single else family.colors()
    own = colors_of(drawn)
    widths = {k: _width(drawn[k].radius, scale) for k in shapes}
    for order, (k, shape) in enumerate(shapes.items()):
        rod = drawn[k]
        named = len(drawn) > 1 or bool(family.solution.assembly.rods[k].name)
        style = {"solid_capstyle": "butt", "zorder": 3 + 0.001 * order}
        if colors is None:
            look = {"lw": widths[k]}
            if any(isinstance(line, Chamber) for line in family.solution.assembly.rods[k].lines):
                look = {"lw": _width(rod.radius, scale, np.inf), "alpha": _BODY}
            for nodes in shape.position[None] if len(family) else []:
                ax.plot(*nodes.T, color=own[k], label=rod.name if named else None, **look, **style)
            continue
        for nodes, color in zip(shape.position, colors, strict=True):
            ax.plot(*nodes.T, color=color, lw=min(widths[k], 2.5), **style)


def _plates(solution: Solution) -> list[list[FloatArray]]:
    """Polygons (vertex_count, 3) of the platforms in the world, one an instance, or of one body after another; none where there
    is no platform."""
    assembly = solution.assembly
    if isinstance(assembly, Network):
        return [plate for body in assembly.bodies for plate in _body_plates(solution, assembly, body)]
    if not isinstance(assembly, (ParallelRods, InverseParallelRods)):
        return []
    positions, rotations = solution.tip_position.reshape(-1, 3), solution.tip_rotation.reshape(-1, 3, 3)
    attachments = solution._parameter(assembly.geometry.platform, 3)
    least = 2 * max(rod.radius for rod in drawn_rods(assembly, solution))
    if attachments.ndim == 3:
        solids = [plate_through(attachments, least)] * len(positions)
    else:
        solids = [plate_through(poses, least) for poses in attachments.reshape(-1, *attachments.shape[-3:])]
    return _placed(solids, positions, rotations)


def _placed(solids: list[Plate], positions: FloatArray, rotations: FloatArray) -> list[list[FloatArray]]:
    return [[corners @ R.T + p for corners in solid.faces] for solid, p, R in zip(solids, positions, rotations, strict=True)]


def _body_plates(solution: Solution, robot: Network, body: Body) -> list[list[FloatArray]]:
    """Polygons of a body, one list an instance: of what spans the places where it holds rods."""
    held = [solution._parameter(joint.pose, 2) for joint in robot.joints if joint.to is body]
    positions = solution.body_position(body.name).reshape(-1, 3)
    rotations = solution.body_rotation(body.name).reshape(-1, 3, 3)
    poses = np.stack([np.broadcast_to(pose, (len(positions), 4, 4)) for pose in held], axis=1)
    least = least_around(robot, len(held))
    same = all(pose.ndim == 2 for pose in held) and len(positions)
    solids = [body_through(poses[0], least)] * len(positions) if same else [body_through(own, least) for own in poses]
    return _placed(solids, positions, rotations)


def _platforms(ax: "Axes3D", family: Family, plates: list[list[FloatArray]]) -> None:
    if not plates:
        return
    colors = [_GREY] * len(plates) if family.single else [*family.colors()] * (len(plates) // len(family))
    for plate, color in zip(plates, colors, strict=True):
        alpha = 0.35 if family.single else 0.12
        lw = 1.0 if len(plate) == 1 else 0.0  # of a solid the edges of triangles
        ax.add_collection3d(in_space("art3d").Poly3DCollection(plate, facecolor=color, edgecolor=color, alpha=alpha, lw=lw))


def triad(ax: "Axes3D", place: FloatArray, rotation: FloatArray, length: float, *, letters: bool) -> None:
    """The axes of a frame."""
    if not np.isfinite(place).all():
        return
    for axis, color, letter in zip(rotation.T, COMPONENTS, "xyz", strict=True):
        ax.plot(*np.stack([place, place + length * axis]).T, color=color, lw=1.4, zorder=4)
        if letters:
            ax.text(*(place + 1.25 * length * axis), letter, color=color, fontsize="x-small", ha="center", va="center")


def _joints(ax: "Axes3D", solution: Solution) -> None:
    assembly = solution.assembly
    places: dict[str, FloatArray] = {}
    if isinstance(assembly, (ParallelRods, InverseParallelRods)):
        attachments = solution._parameter(assembly.geometry.platform, 3)[:, :3, 3]
        every = attachments @ solution.tip_rotation.T + solution.tip_position
        places = {name: every[assembly.geometry.joints == code] for name, code in JOINTS.items()}
    elif isinstance(assembly, Network):
        places = _joints_of_bodies(solution, assembly)
    for name, own in places.items():
        if len(own):
            label = name if name == "clamped" else f"{name} joint"
            ax.plot(*own.T, _MARKERS[name], color="k", mfc="w", ms=4.5, lw=0, label=label, zorder=4)


def _joints_of_bodies(solution: Solution, robot: Network) -> dict[str, FloatArray]:
    """Where joints of each kind are on bodies, and on the ground where they give way, shapes (count, 3)."""
    found: dict[str, list[FloatArray]] = {}
    for joint in robot.joints:
        place = solution._parameter(joint.pose, 2)[:3, 3]
        if isinstance(joint.to, Body):
            place = solution.body_position(joint.to.name) + solution.body_rotation(joint.to.name) @ place
        elif joint.kind == "clamped":
            continue
        else:
            base = solution._parameter(robot.base, 2)
            place = base[:3, 3] + base[:3, :3] @ place
        found.setdefault(joint.kind, []).append(place)
    return {kind: np.array(places) for kind, places in found.items()}


def _discs(ax: "Axes3D", solution: Solution, shapes: dict[int, Shape]) -> None:
    for k, shape in shapes.items():
        places, radius = discs(solution.assembly.rods[k])
        s = places + float(np.broadcast_to(solution.inputs.translation[..., k], ()))
        s = s[(s >= 0) & (s <= shape.arclength[-1] * (1 + 1e-9))]
        if not s.size:
            continue
        frames = shape.rotation.reshape(-1, 9)
        centre = np.stack([np.interp(s, shape.arclength, values) for values in shape.position.T], axis=-1)
        turned = np.stack([np.interp(s, shape.arclength, values) for values in frames.T], axis=-1).reshape(-1, 3, 3)
        for rim in circles(centre, turned, radius):
            ax.plot(*rim.T, color=_GREY, lw=0.8)


def _lines(ax: "Axes3D", solution: Solution, drawn: list[DrawnRod], rods: list[int], nodes: int, scale: float) -> None:
    own = solution.assembly.lines
    if not any(rod in rods for rod, _ in own):
        return
    tension = solution.tension
    for k, (line, (rod, _)) in enumerate(zip(drawn_lines(solution.assembly, drawn), own, strict=True)):
        if rod not in rods:
            continue
        width = _width(line.radius, scale, np.inf) if line.radius else 1.2
        said = f"{line.name}, {tension[k]:.3g} N"
        if line.radius:
            said = f"{line.name}, {-1e-3 * tension[k] / (np.pi * line.radius**2) + 0.0:.3g} kPa"
        style: dict[str, Any] = {"color": _LINES[k % len(_LINES)], "linestyle": STYLES[k // len(_LINES) % len(STYLES)]}
        ax.plot(
            *solution.line(k, nodes=nodes).position.T, lw=width, alpha=0.8, label=said, zorder=3.5, solid_capstyle="butt", **style
        )


def _arrows(solution: Solution, shapes: dict[int, Shape]) -> list[Arrow]:
    """What acts on a robot: where, how much, and by which name."""
    inputs, tip, turn = solution.inputs, solution.tip_position, solution.tip_rotation
    found: list[Arrow] = []
    point = tip + turn @ (inputs.force_point if "force_point" in inputs.given else np.zeros(3))
    if isinstance(solution.assembly, Network):
        robot = solution.assembly
        found += _on_places(solution, robot) + _on_joints(solution, robot) + _on_rods(solution, robot)
    for spec in solution.assembly.input_specs:
        if spec.count is not None or spec.per_rod or spec.acts not in ("tip", "along") or spec.load is None:
            continue
        if not inputs.is_active(spec.name):
            continue
        turns, unit = spec.load == "moment", spec.unit.replace("^2", "²")
        words = spec.name.replace("_", " ")
        color = _MOMENT if turns else _FORCE
        profile = inputs.profile(spec.name)
        if spec.acts == "tip":
            value = getattr(inputs, spec.name)
            vector = turn @ value if spec.follows else value
            origin = tip if turns else point
            size = np.linalg.norm(vector)
            found.append(Arrow(f"{words} {size:.3g} {unit}", color, origin[None], vector[None], f"tip {spec.load}", turns))
        elif spec.name in ("gravity", "magnetic_field"):
            value = getattr(inputs, spec.name)
            middle = np.mean([shape.position[len(shape.position) // 2] for shape in shapes.values()], axis=0)
            said = f"{words} {np.linalg.norm(value):.3g} {unit}"
            found.append(Arrow(said, _FIELD, middle[None], np.asarray(value)[None], spec.name))
        else:
            for shape in shapes.values():
                every = np.unique(np.round(np.linspace(0, len(shape.arclength) - 1, _ALONG)).astype(int))
                s = shape.arclength[every]
                value = np.array([profile(x) for x in s]) if profile else np.tile(getattr(inputs, spec.name), (len(s), 1))
                largest = np.linalg.norm(value, axis=1).max()
                said = f"{words} {'up to ' if profile else ''}{largest:.3g} {unit}"
                found.append(Arrow(said, color, shape.position[every], value, spec.name, turns))
    return found


def _on_places(solution: Solution, robot: Network) -> list[Arrow]:
    """What acts on bodies and free tips, each by its name."""
    found = []
    for spec in robot.input_specs:
        if spec.acts != "tip" or spec.load is None:
            continue
        turns, words = spec.load == "moment", spec.name.replace("_", " ")
        for k, vector in enumerate(getattr(solution.inputs, spec.name).reshape(-1, 3)):
            if vector.any():
                place, (origin, frame) = robot.load_places[k], place_of(solution, robot, k)
                vector = frame @ vector if spec.follows else vector
                said = f"{words} on {place} {np.linalg.norm(vector):.3g} {spec.unit}"
                color = _MOMENT if turns else _FORCE
                found.append(Arrow(said, color, origin[None], vector[None], f"tip {spec.load}", turns))
    return found


def _on_joints(solution: Solution, robot: Network) -> list[Arrow]:
    """What acts along coordinates of joints, each by its name."""
    found = []
    for load in pushes(robot):
        value = given(solution.inputs, load).reshape(1)
        if value.any():
            origin, axis = (values[load.coordinate] for values in solution._pushed_axes)
            said = f"{load.name.replace('_', ' ')} on {load.path[-1]} {abs(value[0]):.3g} {load.unit}"
            color, turns = (_MOMENT, True) if load.kind == "moment" else (_FORCE, False)
            found.append(Arrow(said, color, origin[None], (value * axis)[None], f"tip {load.kind}", turns))
    return found


def _on_rods(solution: Solution, robot: Network) -> list[Arrow]:
    """What acts along single rods, each by its name."""
    found = []
    for spec in robot.input_specs:
        if spec.acts != "along" or spec.count is None or spec.load is None:
            continue
        turns, words = spec.load == "moment", spec.name.replace("_", " ")
        rows = getattr(solution.inputs, spec.name).reshape(-1, 3)
        for name, first, vector in zip(robot.graph.whole_names, robot.graph.first_tube.tolist(), rows, strict=False):
            if vector.any():
                places = solution.rod(first, nodes=_ALONG).position
                said = f"{words} on {name} {np.linalg.norm(vector):.3g} {spec.unit}"
                found.append(
                    Arrow(said, _MOMENT if turns else _FORCE, places, np.tile(vector, (len(places), 1)), spec.name, turns)
                )
    return found


def _draw_arrow(ax: "Axes3D", arrow: Arrow, scale: float) -> None:
    """With two heads for what turns; of arrows with one name the first is in the legend."""
    said = ax.get_legend_handles_labels()[1]
    vectors = scale * arrow.vectors
    thin = len(vectors) > 1
    options = {"color": arrow.color, "lw": 1.1 if thin else 2.0, "arrow_length_ratio": 0.18, "zorder": 5}
    label = None if arrow.name in said else arrow.name
    ax.quiver(*arrow.origins.T, *vectors.T, label=label, **options)
    if arrow.turns:
        ax.quiver(*arrow.origins.T, *(0.85 * vectors).T, **options)
