"""The entities of a scene: samples of each turned into columns."""

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from multirod.recording import columns
from multirod.recording.framing import Frame
from multirod.recording.loads import DrawnLoad
from multirod.recording.stage import TIP_AXES, Stage
from multirod.status import Status, failures, left_branch
from multirod.validation import FloatArray

if TYPE_CHECKING:
    from multirod.recording.columns import Index, Send


_BEYOND = 1.15  # length of a body's axes over how far it reaches


def _words(code: int) -> str:
    status = Status(code)
    return f"{status.name}\n" + "\n".join(wrap(status.message, 44))


class Entities:
    """What is sent of each entity of a scene, a row a sample.

    Args:
        send: Sends columns to an entity.
        node_count: Nodes of a rod.
    """

    def __init__(self, send: "Send", node_count: int) -> None:
        self._send, self._node_count = send, node_count
        self._last_tip: dict[str, FloatArray] = {}
        self._last_value: dict[str, Any] = {}
        self._last_sound: dict[int, list[FloatArray]] = {}

    def line(self, stage: Stage, k: int, line: int, index: "Index", nodes: FloatArray, tension: FloatArray) -> None:
        """A line, coloured by its tension; as thick as a chamber is."""
        path, shades, radius = (
            stage.line(k, line),
            columns.shades(tension, stage.strongest),
            stage.lines[line].radius,
        )
        if radius:
            self._send(path, index, columns.capsules(nodes, radius, shades))
        else:
            pieces = np.stack([nodes[:, :-1], nodes[:, 1:]], axis=2)
            self._send(path, index, columns.strips(pieces, shades))

    def tip(self, stage: Stage, k: int, index: "Index", position: FloatArray, rotation: FloatArray) -> None:
        """The frame of the end effector; none where it is not known."""
        import rerun as rr

        frames, sound = columns.poses(position, rotation)
        axes = rr.TransformAxes3D.columns(
            axis_length=np.where(sound, (TIP_AXES if stage.labelled else 0.3 * TIP_AXES) * stage.size, 0.0)
        )
        self._send(stage.world("tip", k), index, [*frames, *axes])

    def body(
        self,
        stage: Stage,
        k: int,
        body: int,
        steps: NDArray[np.int64],
        times: FloatArray,
        position: FloatArray,
        rotation: FloatArray,
    ) -> None:
        """A platform or a body, with its frame where it is not the end effector, whose frame is the tip's."""
        import rerun as rr

        drawn, index = stage.bodies[body], columns.index(steps, times)
        path = stage.body(k, drawn)
        frames, sound = columns.poses(position, rotation)
        axes: list[Any] = []
        if drawn.name and drawn.name != getattr(stage.assembly, "end_effector", ""):
            length = max(0.6 * TIP_AXES * stage.size, _BEYOND * drawn.reach)  # so that they end outside of it
            axes = [*rr.TransformAxes3D.columns(axis_length=np.where(sound, length, 0.0))]
        self._send(path, index, [*frames, *axes])
        if drawn.name:
            place = np.tile(drawn.corner(k), (int(sound.sum()), 1))
            self._send(f"{path}/name", index, rr.Points3D.columns(positions=place).partition(sound.astype(int)))
        changed = self._changed(path, sound)
        if changed.any():
            mesh = columns.plates(drawn.solids[k], sound[changed])
            self._send(path, columns.index(steps[changed], times[changed]), mesh)

    def path(self, path: str, index: "Index", positions: FloatArray) -> None:
        """The way from the sample before, which may be of an earlier call."""
        before = np.concatenate([self._last_tip.get(path, positions[:1]).reshape(1, 3), positions[:-1]])
        self._last_tip[path] = positions[-1]
        self._send(path, index, columns.strips(np.stack([before, positions], axis=1)))

    def arrows(self, stage: Stage, k: int, load: DrawnLoad, index: "Index", origins: FloatArray, force: FloatArray) -> None:
        """Arrows in newtons, each from the origin of a frame whose scale may yet change."""
        import rerun as rr

        path = stage.load(k, load)
        sound = np.isfinite(origins).all(axis=1) & np.isfinite(force).all(axis=1) & (np.abs(force).max(axis=1) > 0)
        labels = [f"{value:.3g} {load.unit}" for value in np.linalg.norm(force[sound], axis=1)]
        told = stage.labelled and (not load.rods or len(load.path) == 1)  # names of rods are where their middles are
        arrows = rr.Arrows3D.columns(vectors=force[sound], labels=labels if told else None)
        places = rr.Transform3D.columns(translation=origins[sound])
        self._send(path, index, [*arrows.partition(sound.astype(int)), *places.partition(sound.astype(int))])

    def points(self, path: str, index: "Index", positions: FloatArray) -> None:
        """A point a sample; none where it is not known."""
        import rerun as rr

        sound = np.isfinite(positions).all(axis=1)
        self._send(path, index, rr.Points3D.columns(positions=positions[sound]).partition(sound.astype(int)))

    def ellipsoid(self, path: str, index: "Index", force: FloatArray, covariances: FloatArray) -> None:
        """The ellipsoid about an arrow's end that has 95 % of the force, in newtons as the arrow."""
        import rerun as rr

        half, turns = columns.ellipsoids(covariances)
        sound = (np.isfinite(force).all(axis=1) & np.isfinite(half).all(axis=1)).astype(int)
        kept = sound == 1
        shapes = rr.Ellipsoids3D.columns(centers=force[kept], half_sizes=half[kept], quaternions=turns[kept])
        self._send(path, index, shapes.partition(sound))

    def name(self, stage: Stage, k: int, rod: int, index: "Index", shapes: Sequence[dict[str, FloatArray]], rows: slice) -> None:
        """A name where the rod can be seen: in the middle of what no tube of its leg covers."""
        import rerun as rr

        if not stage.label(k, rod):
            return
        own = shapes[rod]["arclength"][rows, k, -1]
        others = [shapes[i]["arclength"][rows, k, -1] for i, r in enumerate(stage.rods) if r.leg == stage.rods[rod].leg]
        covered = np.max([np.where(other < own, other, 0.0) for other in others], axis=0)
        part = 1.0 if stage.batched else 0.5 + 0.5 * covered / own
        node = np.nan_to_num(part * (self._node_count - 1)).astype(int)
        nodes = np.broadcast_to(node, own.shape)[:, None, None]
        places = np.take_along_axis(shapes[rod]["position"][rows, k], nodes, axis=1)[:, 0]
        sound = np.isfinite(places).all(axis=1)
        self._send(stage.rod("names", k, rod), index, rr.Points3D.columns(positions=places[sound]).partition(sound.astype(int)))

    def failed(
        self,
        stage: Stage,
        k: int,
        steps: NDArray[np.int64],
        times: FloatArray,
        codes: NDArray[Any],
        positions: Sequence[FloatArray],
    ) -> None:
        """Where samples begin to fail, or what is an event begins, the last shape before and what happened, in words; where they
        end, nothing."""
        import rerun as rr

        failed = failures(codes)
        told = failed | left_branch(codes)
        last = self._last_sound.setdefault(k, [np.zeros((0, 3)) for _ in positions])
        states = np.where(told, codes, -1)
        path = stage.world("failed/status", k)
        self._last_value.setdefault(path, -1)
        if told.any() or self._last_value[path] != -1:
            for row in np.flatnonzero(self._changed(path, states)):
                index = columns.index(steps[row : row + 1], times[row : row + 1])
                shown = [p[row - 1] for p in positions] if row and not failed[row - 1] else last
                for i, nodes in enumerate(shown):
                    strip = [nodes] if told[row] and len(nodes) else []
                    strips = rr.LineStrips3D.columns(strips=strip).partition([len(strip)])
                    self._send(stage.rod("failed/rods", k, i), index, strips)
                    last[i] = nodes
                text = [_words(int(codes[row]))] if told[row] else []
                place = [self._place_of_words(stage, nodes)] if told[row] else []
                points = [*rr.Points3D.columns(positions=place).partition([len(text)])]
                self._send(path, index, [*points, *rr.Points3D.columns(labels=text).partition([len(text)])])
        sound = np.flatnonzero(~failed)
        if sound.size:
            self._last_sound[k] = [p[sound[-1]] for p in positions]

    def _place_of_words(self, stage: Stage, nodes: FloatArray) -> FloatArray:
        """Where what happened can be read: high in the view; of several instances, at the tip of each."""
        if not stage.batched:
            return Frame.between(stage.centre, stage.eye).above
        return np.asarray(nodes[-1] if len(nodes) else next(iter(stage.bases.values()))[:3, 3])

    def status(self, path: str, steps: NDArray[np.int64], times: FloatArray, codes: NDArray[Any]) -> None:
        """The status where it changes."""
        import rerun as rr

        names = np.array([Status(int(code)).name for code in codes])
        changed = self._changed(path, names)
        if changed.any():
            states = rr.StateChange.columns(state=names[changed].tolist())
            self._send(path, columns.index(steps[changed], times[changed]), states)

    def _changed(self, path: str, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Rows that differ from the one before, which may be of an earlier call."""
        changed = np.concatenate([[values[0] != self._last_value.get(path)], values[1:] != values[:-1]])
        self._last_value[path] = values[-1]
        return changed

    def scalars(self, path: str, index: "Index", values: FloatArray) -> None:
        """Numbers over time."""
        import rerun as rr

        self._send(path, index, rr.Scalars.columns(scalars=np.ascontiguousarray(values)))
