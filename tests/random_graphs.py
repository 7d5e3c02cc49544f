"""Networks drawn by lot of all that a ``Network`` may say, and the same in the numbers of ``graph_energy``.

Rods that are plain, strips, stretch and shear, have sections, tendons, or are tubes; joints of all kinds at random axes, with
springs, motors and drives; rods that slide through holes of bodies; bodies that are fixed and moved, frames that are pushed;
loads along all rods and along one. From number ``WITH_FIELDS`` on some rods are magnets in a field, stand in a medium, or have
chambers and push rods; from ``WITH_ENDS`` on lines end before the tip, and moments act along single rods; from ``WITH_LOADS`` on
rods have loads of their own, of classes that are not in the package. ``random_networks`` draws less, by other numbers.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from graph_energy import Graph, roll, turned
from network_energy import AXIS, exp, log
from own_loads import Drag, Spring, Well

import multirod as mr

EI, GJ, MASS = 60e9 * np.pi * 2e-3**4 / 64, 23e9 * np.pi * 2e-3**4 / 32, 6450 * np.pi * 1e-6
KINDS = ("clamped", "clamped", "clamped", "revolute", "universal", "spherical", "prismatic", "cylindrical")
ANGLES = {"clamped": 0, "revolute": 1, "universal": 2, "spherical": 3, "prismatic": 0, "cylindrical": 1}
HOLES = {"prismatic": 0, "cylindrical": 1, "spherical": 3}
MADE = ("plain", "plain", "plain", "strip", "stretches", "sections", "tendons", "tubes")
RADIUS = 0.005  # of tendons
WITH_FIELDS = 1000  # the first number of a network with magnets, media, chambers and push rods
WITH_ENDS = 2000  # the first number of a network with lines that end before the tip, and moments along rods
WITH_LOADS = 3000  # the first number of a network whose rods have loads of their own
AREA = 2e-5  # of a chamber [m^2]
BY_NAME = (
    *("rotation", "translation", "force", "moment", "follower_force", "follower_moment", "tension", "displacement"),
    *("pressure", "angle", "slide", "joint_torque", "slide_force", "rod_force", "rod_moment"),
)


@dataclass(frozen=True)
class Drawn:
    """A network and its inputs, the same in the numbers of ``graph_energy``, and where its bodies are, about."""

    robot: mr.Network
    inputs: mr.Inputs
    names: tuple[str, ...]
    bodies: tuple[str, ...]
    numbers: dict
    places: np.ndarray
    potential: bool

    def rods(self, segments):
        """The numbers as ``graph_energy`` takes them."""
        return Graph(segments=segments, **self.numbers)


def pose_of(R, p):
    """As (4, 4)."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = R, p
    return result


def frame_along(z, rng, off=0.15):
    """A frame whose z is nearly this, rolled a little."""
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1) @ exp(rng.normal(0, off, 3))


def draw(seed, most_rods=12, most_bodies=4, load=1.0):
    """A network; one in which something is free to move is drawn again."""
    rng, more, last, own_loads = (np.random.default_rng([seed, own]) for own in (17, 29, 31, 37))
    while True:
        try:
            more, last = more if seed >= WITH_FIELDS else None, last if seed >= WITH_ENDS else None
            return _Lot(rng, most_rods, most_bodies, load, more, last, own_loads if seed >= WITH_LOADS else None).drawn()
        except ValueError as error:
            if "free to move" not in str(error):
                raise


class _Lot:
    """One draw."""

    def __init__(self, rng, most_rods, most_bodies, load, more, last, own_loads):
        self.rng, self.load, self.more, self.last, self.own_loads = rng, load, more, last, own_loads
        count = int(rng.integers(1, most_bodies + 1))
        self.joined = [(int(rng.integers(-1, k)) if k else -1, k) for k in range(count)]
        for _ in range(int(rng.integers(0, most_rods - count + 1))):
            k = int(rng.integers(0, count))
            self.joined.append((int(rng.integers(-1, k)) if k else -1, k))
        level = np.zeros(count)
        for near, far in self.joined[:count]:
            level[far] = 1 + (level[near] if near >= 0 else 0)
        self.places = np.stack([rng.normal(0, 0.06, count), rng.normal(0, 0.06, count), 0.2 * level], axis=1)
        self.count = count
        self.inputs = {name: {} for name in BY_NAME}
        self.joints, self.rods, self.numbers, self.cut = [], {}, [], {}
        self.gravity = np.array([0, 0, -9.81]) if self.chance(0.5) else np.zeros(3)
        self.along = rng.normal(0, 0.3 * load * EI / 0.3**3, 3) if self.chance(0.2) else np.zeros(3)
        self.potential, self.turning = True, self.lastly(0.25)  # whether moments act along rods
        # [T], by which 1 A m takes about as much of a moment per length as EI/L^2
        self.field = 0.5 * load * EI / 0.3**2 * more.normal(0, 1, 3) if self.maybe(0.4) else np.zeros(3)

    def maybe(self, share):
        """Whether one more thing is there, as ``chance``."""
        return self.more is not None and bool(self.more.random() < share)

    def lastly(self, share):
        """The same of what came last."""
        return self.last is not None and bool(self.last.random() < share)

    def chance(self, share):
        return bool(self.rng.random() < share)

    def drawn(self):
        rng, count = self.rng, self.count
        self._bodies()
        through = self.chance(0.5)
        for number, (near, far) in enumerate(self.joined):
            if far >= 0 and near >= 0 and self.chance(0.3) and number >= count:
                near, far = far, near
            sliding = through and number >= count and self.chance(0.4)
            self._rod(f"r{number}", near, far, sliding)
        for k in range(count):
            if self.chance(0.15):
                self._rod(f"r{len(self.rods)}", k, None, False)
        if through and len(self.rods) < 12 and not any(own["holes"] for own in self.numbers):
            self._rod(f"r{len(self.rods)}", -1, int(rng.integers(0, count)), True)
        if self.hand is not None:
            self._rod(f"r{len(self.rods)}", -2, int(rng.integers(0, count)), False)
        robot = mr.Network(rods=self.rods, bodies=self.nodes, joints=self.joints, segments=self.cut)
        self._loads(robot)
        given = {name: value for name, value in self.inputs.items() if value}
        if self.hand is not None:
            given["fixed_position"], given["fixed_rotation"] = ({"hand": value} for value in self.hand[1:])
        if self.along.any():
            given["distributed_force"] = self.along
        if any(span["mass"] for own in self.numbers for span in own["spans"]) or any(mass for mass, _ in self.mass):
            given["gravity"] = self.gravity
        if any(span["magnet"].any() for own in self.numbers for span in own["spans"]):
            given["magnetic_field"] = self.field
        inputs = robot.inputs(**given)
        bodies = tuple(f"b{k}" for k in range(count))
        numbers = {"rods": self.numbers, "bodies": self.own}
        return Drawn(robot, inputs, tuple(self.rods), bodies, numbers, self.places, self.potential)

    def _bodies(self):
        rng = self.rng
        self.mass, self.nodes, self.tools = [], [], []
        for k in range(self.count):
            mass = float(rng.choice([0.0, 0.02]))
            centre = rng.normal(0, 0.01, 3) * (mass > 0)
            tool = pose_of(exp(rng.normal(0, 0.5, 3)), rng.normal(0, 0.03, 3)) if self.chance(0.15) else None
            self.mass.append((mass, centre))
            self.tools.append(tool)
            self.nodes.append(
                mr.Body(
                    f"b{k}",
                    mass=mass,
                    mass_centre=centre,
                    pose=pose_of(np.eye(3), self.places[k]) if self.chance(0.7) else None,
                    frames=None if tool is None else {"tool": tool},
                )
            )
        self.hand = None
        if self.chance(0.2):
            at = pose_of(exp(rng.normal(0, 0.3, 3)), rng.normal(0, 0.1, 3) * [1, 1, 0.2])
            self.hand = at, rng.normal(0, 0.01, 3), rng.normal(0, 0.1, 3)
            self.nodes.append(mr.Body("hand", pose=at, fixed=True))

    def _holder(self, b):
        """Of a body, the ground, -1, or the hand, -2: what joints take, and its pose where it is moved to."""
        if b == -1:
            return mr.ground, np.eye(3), np.zeros(3)
        if b == -2:
            at, moved, turned_by = self.hand
            return self.nodes[-1], exp(turned_by) @ at[:3, :3], at[:3, 3] + moved
        return self.nodes[b], np.eye(3), self.places[b]

    def _rod(self, name, near, far, sliding):
        rng = self.rng
        spots = [rng.normal(0, 0.04, 3) * [1, 1, 0.2] for _ in (0, 1)]
        holders = [self._holder(near), self._holder(far) if far is not None else None]
        start = holders[0][2] + holders[0][1] @ spots[0]
        stop = start + [0, 0, 0.15] if far is None else holders[1][2] + spots[1]
        chord = stop - start
        reach = float(np.linalg.norm(chord))
        chord = chord / reach
        made = "plain" if sliding else str(rng.choice(MADE))
        if sliding and self.chance(0.3):
            made = "stretches"
        beyond = rng.uniform(0.08, 0.15) if sliding else 0.0
        length = reach * rng.uniform(1.0, 1.1) + beyond
        own = {"holes": [], "lines": [], "angles": [0.0], "behind": [np.inf], "pull": np.zeros(3), "tip": None}
        make = self._made(name, made, length, own)
        own["base"] = self._joint(name, "base", near, spots[0], chord, length)
        if sliding:
            own["holes"].append(self._hole(name, far, spots[1], chord, reach, length))
        elif far is not None:
            own["tip"] = self._joint(name, "tip", far, spots[1], chord, length)
        if own["tip"] is None:
            own["pull"] = rng.normal(0, 0.5 * self.load * EI / length**2, 3)
            self.inputs["force"][name] = own["pull"]
        self._drives(name, made, own, length)
        self.rods[name] = make(**self._around(made, near, own, sliding))
        self.numbers.append(own)
        bare = own["medium"] is None and not own["loads"]
        if made in ("plain", "strip", "stretches") and not sliding and self.chance(0.1) and bare:
            self.cut[name] = int(rng.integers(2, 4))

    def _around(self, made, near, own, sliding):
        """Options of a rod that is a magnet or in a medium."""
        more, options, own["medium"], own["loads"] = self.more, {}, None, []
        for span in own["spans"]:
            span["magnet"], span["field"] = np.zeros(3), self.field
        if made not in ("plain", "strip", "stretches", "sections"):
            return options
        if self.field.any() and self.maybe(0.5):
            options["magnetisation"] = more.normal(0, 0.5, 3)
            for span in own["spans"]:
                span["magnet"] = options["magnetisation"]
        still = near < 0 and not len(own["base"]["axes"]) and own["base"]["slide"] is None and not own["base"]["driven"]
        if still and not sliding and self.maybe(0.3):
            length = sum(span["length"] for span in own["spans"])
            k = EI / length**4 * 10 ** more.uniform(0, 2.5)
            own["medium"] = options["foundation"] = np.array([k, k, k * more.integers(0, 2)])
        if still and not sliding and made != "sections" and self.own_loads is not None:
            options |= self._loads_of_its_own(own)
        return options

    def _loads_of_its_own(self, own):
        """One of three laws or none, and what the witness knows of it."""
        rng, length = self.own_loads, sum(span["length"] for span in own["spans"])
        law = str(rng.choice(["well", "drag", "springs", "none"]))
        k = EI / length**4 * 10 ** rng.uniform(0, 1.5)
        if law == "none":
            return {}
        if law == "well":
            numbers, made = (k, k / 0.05**2 * rng.uniform(0, 1)), Well
        elif law == "drag":
            numbers, made = tuple(self.load * EI / length**3 * rng.uniform(0.2, 1.5, 2)), Drag
        else:
            numbers, made = (k, rng.uniform(0.02, 0.05), rng.normal(0, 0.3 * self.load * EI / length**2)), Spring
        own["loads"].append((law, *numbers))
        return {"loads": [made(*numbers)]}

    def _made(self, name, made, length, own):
        rng = self.rng
        bent = rng.normal(0, 2.0, 3) * [1, 1, 0.3] if self.chance(0.5) else np.zeros(3)
        weighs = MASS if self.chance(0.7) else 0.0
        span = {"length": length, "stiffness": np.array([[EI, EI, GJ]]), "curvature": bent[None], "mass": weighs, "shear": None}
        own["spans"] = [span]
        options = {"linear_density": weighs} if weighs else {}
        if made == "strip":
            span["stiffness"] = EI * np.array([[1.0, rng.uniform(0.3, 3), rng.uniform(0.3, 1.5)]])
        if made == "stretches":
            GA, EA = 1e3 * EI / 0.3**2 * rng.uniform(0.3, 3, 2)
            span["shear"] = np.array([GA, GA, EA])
            options |= {"shear_stiffness": GA, "axial_stiffness": EA}
        if made == "sections":
            share = rng.uniform(0.3, 0.7)
            other = dict(span, length=(1 - share) * length, stiffness=rng.uniform(0.4, 2) * span["stiffness"])
            other["curvature"] = bent[None] + rng.normal(0, 2.0, (1, 3)) * [1, 1, 0]
            span["length"] = share * length
            own["spans"].append(other)
            drawn = [_numbers_of(s) for s in own["spans"]]  # before it is pushed out
            return lambda **more: mr.Rod(sections=[mr.Section(**numbers, **options, **more) for numbers in drawn])
        numbers = _numbers_of(span)
        if made == "tubes":
            tubes = self._tubes(length, own, bent)
            return lambda **_: tubes
        if made == "tendons":
            turn, count = rng.uniform(0, 2 * np.pi), int(rng.integers(1, 4))
            for k in range(count):
                a = turn + 2 * np.pi * k / count
                own["lines"].append({"offset": RADIUS * np.array([np.cos(a), np.sin(a)])})
            if self.chance(0.3):
                stretches = {} if self.chance(0.3) else {"axial_stiffness": 2e3}
                lines = [mr.Tendon(offset=own["lines"][0]["offset"], driven="displacement", **stretches)]
                own["lines"] = own["lines"][:1]
                own["lines"][0]["displaced"] = stretches.get("axial_stiffness", np.inf)
            else:
                lines = [mr.Tendon(offset=line["offset"]) for line in own["lines"]]
            if self.maybe(0.5):
                lines = self._chambers_or_rods(own)
            if self.lastly(0.9) and "displaced" not in own["lines"][0]:
                lines = self._ended(lines, length, own)
            return lambda **more: mr.Rod(**numbers, **options, lines=lines, **more)
        return lambda **more: mr.Rod(**numbers, **options, **more)

    @staticmethod
    def _chambers_or_rods(own):
        """In the place of tendons."""
        if "displaced" not in own["lines"][0]:
            for line in own["lines"]:
                line["area"] = AREA
            return [mr.Chamber(offset=line["offset"], area=AREA) for line in own["lines"]]
        own["lines"][0] |= {"displaced": 2e3, "pushes": True}
        return [mr.PushRod(offset=own["lines"][0]["offset"], axial_stiffness=2e3)]

    def _ended(self, lines, length, own):
        """The same lines, that end before the tip."""
        end, (span,) = length * self.last.uniform(0.4, 0.9), own["spans"]
        own["spans"] = [dict(span, length=end), dict(span, length=length - end, without_lines=True)]
        ended = []
        for line, given in zip(lines, own["lines"], strict=True):
            area = {"area": given["area"]} if "area" in given else {}
            ended.append(type(line)(offset=given["offset"], end=end, **area))
        return ended

    def _tubes(self, length, own, bent):
        """An inner tube, and one around it that ends before it, as stiff together as a rod, about."""
        rng, reach = self.rng, length * self.rng.uniform(0.4, 0.8)
        weighs = MASS / 2 if self.chance(0.7) else 0.0
        stiffness = [EI * rng.uniform(0.3, 0.7) * np.array([1, 1, 0.77]) for _ in (0, 1)]
        curvature = [0.7 * bent, np.append(rng.normal(0, 3.0, 2), 0)]
        behind = rng.uniform(0.02, 0.1, 2) if self.chance(0.5) else np.zeros(2)
        behind = np.sort(behind)[::-1]
        tubes = [
            mr.Rod(
                length=own_length + b,
                bending_stiffness=K[0],
                torsional_stiffness=K[2],
                precurvature=tuple(u),
                **({"linear_density": weighs} if weighs else {}),
            )
            for own_length, b, K, u in zip((length, reach), behind, stiffness, curvature, strict=True)
        ]
        own["tube_shift"] = -behind
        own["behind"] = [K[2] / b if b else np.inf for K, b in zip(stiffness, behind, strict=True)]
        own["angles"] = [0.0, 0.0]
        both = {
            "length": reach,
            "stiffness": np.array(stiffness),
            "curvature": np.array(curvature),
            "mass": 2 * weighs,
            "shear": None,
        }
        own["spans"] = [
            both,
            dict(both, length=length - reach, stiffness=both["stiffness"][:1], curvature=both["curvature"][:1], mass=weighs),
        ]
        return mr.ConcentricTubes(tubes)

    def _joint(self, name, end, b, spot, chord, length):
        """One end, as the network is told and as its energy is."""
        rng = self.rng
        holder, turn, place = self._holder(b)
        kind = str(rng.choice(KINDS))
        frame = turn.T @ frame_along(chord, rng)
        slides, angles = kind in ("prismatic", "cylindrical"), ANGLES[kind]
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] if self.chance(0.5) else np.eye(3)[rng.permutation(3)]
        axis = {"revolute": axes[0], "universal": axes[:2], "prismatic": axes[0], "cylindrical": axes[0]}.get(kind)
        own = {"axes": np.eye(3) if angles == 3 else axes[:angles], "slide": axes[0] if slides else None}
        size = angles + slides
        unit = np.array([EI / length] * angles + [EI / length**3 * 12] * slides)
        springs, rest, push, options = np.zeros(size), np.zeros(size), np.zeros(size), {}
        if size and kind != "clamped":
            driven = self.chance(0.15)
            if driven:
                options["driven"] = True
            # what slides freely seldom has a place to be
            elif self.chance(0.8 if slides else 0.35):
                springs = 0.3 * rng.uniform(0.5, 2) * unit
                rest = rng.normal(0, 0.2, size) * ([1] * angles + [0.05] * slides) * (kind != "spherical")
                options["stiffness"] = springs[0] if size == 1 or kind == "spherical" else springs
                options["rest"] = 0.0 if kind == "spherical" else rest[0] if size == 1 else rest
            if not driven and kind != "spherical" and self.chance(0.25):
                push = rng.normal(0, 0.1, size) * self.load * np.array([EI / length] * angles + [EI / length**2] * slides)
                if angles:
                    self.inputs["joint_torque"][f"{name} {end}"] = push[0] if angles == 1 else push[:angles]
                if slides:
                    self.inputs["slide_force"][f"{name} {end}"] = push[-1]
        if axis is not None:
            options["axis"] = axis
        self.joints.append(mr.Joint(name, end, to=holder, pose=pose_of(frame, spot), kind=kind, **options))
        # the hand is a part of the ground
        own |= {"body": b if b >= 0 else -1, "position": spot, "frame": frame, "springs": springs, "rest": rest, "push": push}
        own["driven"] = bool(options.get("driven"))
        if options.get("driven"):
            value = rng.normal(0, 0.3, angles)
            if angles:
                self.inputs["angle"][f"{name} {end}"] = value[0] if angles == 1 else value
            if slides:
                way = rng.normal(0, 0.01)
                self.inputs["slide"][f"{name} {end}"] = way
                own["position"] = spot + frame @ axes[0] * way
            own["frame"] = frame @ turned(own, value)[0]
            own |= {"axes": np.zeros((0, 3)), "slide": None, **dict.fromkeys(("springs", "rest", "push"), np.zeros(0))}
        if b == -2:
            own["position"] = place + turn @ own["position"]
            own["frame"] = turn @ own["frame"]
        return own

    def _hole(self, name, b, spot, chord, at, length):
        rng = self.rng
        kind = str(rng.choice(list(HOLES)))
        frame = frame_along(chord, rng, 0.1)
        stiffness = 3 * EI / length**3 * rng.uniform(0.5, 2) if self.chance(0.3) else 0.0
        rest = at * rng.uniform(0.95, 1.05) if stiffness else None
        options = {"stiffness": stiffness, "rest": rest} if stiffness else {}
        self.joints.append(mr.Joint(name, "along", at=at, to=self.nodes[b], pose=pose_of(frame, spot), kind=kind, **options))
        none = np.zeros(1 if kind == "cylindrical" else 0)
        return {
            "body": b,
            "position": spot,
            "frame": frame,
            "axes": {"prismatic": np.zeros((0, 3)), "cylindrical": AXIS[None], "spherical": np.eye(3)}[kind],
            "slide": None,
            **dict.fromkeys(("springs", "rest", "push"), none),
            "at": at,
            "spring": stiffness,
            "spot": rest if stiffness else 0.0,
        }

    def _drives(self, name, made, own, length):
        rng, weight = self.rng, np.zeros(3)
        displaced = any("displaced" in line for line in own["lines"])
        if made != "tubes" and not displaced and self.chance(0.3):
            way = length * rng.uniform(-0.02, 0.06)
            self.inputs["translation"][name] = way
            own["spans"][0]["length"] += way
            for hole in own["holes"]:
                hole["spot"] += way
        if made == "tubes":
            turn = rng.normal(0, 0.7, 2)
            self.inputs["rotation"][name] = tuple(turn)
            # what they are twisted at rest behind the plate
            own["angles"] = list(turn - own["tube_shift"] * own["spans"][0]["curvature"][:, 2])
            if own["tube_shift"].any():
                self.inputs["translation"][name] = tuple(own["tube_shift"])
        elif self.chance(0.5):
            own["angles"] = [float(rng.normal(0, 0.5))]
            self.inputs["rotation"][name] = own["angles"][0]
        if self.chance(0.15) and made != "tubes":
            weight = rng.normal(0, 0.5 * self.load * EI / length**3, 3)
            self.inputs["rod_force"][name] = weight
        turning = np.zeros(3)
        if self.turning and made != "tubes" and not own["holes"] and self.lastly(0.4):
            turning = self.last.normal(0, 0.3 * self.load * EI / length**2, 3)
            self.inputs["rod_moment"][name] = turning
        for span in own["spans"]:
            span["force"] = span["mass"] * self.gravity + self.along + weight
            span["moment"] = turning
        if not own["lines"]:
            return
        if "displaced" in own["lines"][0]:
            (line,) = own["lines"]
            EA = line.pop("displaced")
            before = length_at_rest(own["spans"][0], line["offset"])
            pulled = rng.uniform(1e-3, 3e-3)
            if line.get("pushes"):
                pulled *= float(self.more.choice([-1.0, 1.0]))
            line["length"] = before - pulled
            line["compliance"] = before / EA
            self.inputs["displacement"][name] = pulled
            return
        for line in own["lines"]:
            line["tension"] = float(rng.uniform(0, 0.5) * self.load * EI / length / RADIUS)
        filled = "area" in own["lines"][0]
        values = tuple(line["tension"] / line.get("area", 1.0) for line in own["lines"])
        for line in own["lines"] if filled else ():
            line["tension"] *= -1
        self.inputs["pressure" if filled else "tension"][name] = values if len(values) > 1 else values[0]

    def _loads(self, robot):
        rng = self.rng
        mean = np.mean([sum(span["length"] for span in own["spans"]) for own in self.numbers])
        unit = EI / mean**2
        moments, follows = self.chance(0.12), self.chance(0.08)
        drags = any(law == "drag" for own in self.numbers for law, *_ in own["loads"])
        self.potential = not (moments or follows or self.inputs["rod_moment"] or drags)
        self.own = []
        for k, (mass, centre) in enumerate(self.mass):
            force = rng.normal(0, self.load * unit, 3)
            self.inputs["force"][f"b{k}"] = force
            own = {"loads": [(force, np.zeros(3))], "moment": np.zeros(3), "follower": (np.zeros(3), np.zeros(3))}
            own["loads"].append((mass * self.gravity, centre))
            if self.tools[k] is not None:
                push = rng.normal(0, 0.5 * self.load * unit, 3)
                self.inputs["force"][f"tool of b{k}"] = push
                own["loads"].append((push, self.tools[k][:3, 3]))
            if moments:
                own["moment"] = rng.normal(0, 0.3 * self.load * unit * mean, 3)
                self.inputs["moment"][f"b{k}"] = own["moment"]
            if follows:
                own["follower"] = rng.normal(0, 0.5 * self.load * unit, 3), rng.normal(0, 0.2 * self.load * unit * mean, 3)
                self.inputs["follower_force"][f"b{k}"], self.inputs["follower_moment"][f"b{k}"] = own["follower"]
            self.own.append(own)


def _numbers_of(span):
    EIx, EIy, GJ_ = span["stiffness"][0]
    return {
        "length": span["length"],
        "bending_stiffness": (EIx, EIy),
        "torsional_stiffness": GJ_,
        "precurvature": tuple(span["curvature"][0]),
    }


def length_at_rest(span, offset):
    """Of a line along a rod as it is at rest."""
    return span["length"] * float(np.linalg.norm(AXIS + np.cross(span["curvature"][0], [*offset, 0.0])))


def state_of(drawn, solution, segments, aside=0.0, seed=0):
    """Where ``graph_energy`` begins: segments as a solution has them, all turned and moved ``aside`` by lot."""
    rng = np.random.default_rng(seed)
    graph = Graph(segments=segments, **_taut(drawn, solution))
    R, y = np.zeros((graph.turns, 3, 3)), np.zeros(len(graph.values))
    for k, name in enumerate(drawn.bodies):
        R[graph.body_turn[k]] = solution.body_rotation(name)
        y[graph.body_at[k]] = solution.body_position(name)
    for name, part in zip(drawn.names, graph.parts, strict=True):
        _rod_state(graph, part, name, solution, R, y)
    z = np.zeros(graph.size)
    z[: graph.free] = aside * graph.scale[: graph.free] * rng.standard_normal(graph.free)
    for part in graph.parts:  # a place in a hole is told by little
        z[graph.at(part.holes)] *= 0.1
    state = graph.moved((R, y), z)
    # the forces that leave least of the gradient
    g, H = graph.system(state)
    free = graph.scale[: graph.free]
    at = slice(graph.free, graph.size)
    own = graph.scale[at]
    forces = own * np.linalg.lstsq(free[:, None] * H[: graph.free, at] * own, -free * g[: graph.free], rcond=None)[0]
    z[:] = 0.0
    z[at] = forces
    return graph, graph.moved(state, z)


def _rod_state(graph, part, name, solution, R, y):
    rod, M = part.rod, graph.M
    tubes = len(rod["angles"])
    shapes = [solution.rod(name if tubes == 1 else f"{name} {k}", nodes=241) for k in range(tubes)]
    s = shapes[0].arclength
    total = sum(span["length"] for span in rod["spans"])
    doubled = np.flatnonzero(np.diff(s) < 1e-12 * total)
    if rod["holes"]:
        marks = [0.0, *s[doubled][: len(rod["holes"])], total]
    else:
        marks = [0.0, *np.cumsum([span["length"] for span in rod["spans"]])]
    y[part.holes] = marks[1:-1] if rod["holes"] else []
    middles = []
    for low, high in pairwise(marks):
        middles += list(low + (high - low) * (np.arange(M) + 0.5) / M)
    nodes = list(part.nodes)
    at, place = 0, []
    pieces = len(marks) - 1
    for k in range(pieces):
        place += middles[k * M : (k + 1) * M]
        at += M
        if at < len(nodes) and part._is_between(at):
            place.append(marks[k + 1])
            at += 1
    for (turn, stretch, twists), where in zip(nodes, place, strict=True):
        R[turn] = _frame_at(shapes[0], where)
        y[stretch] = AXIS[: len(stretch)]
        for k, twist in enumerate(twists, 1):
            shape = shapes[k]
            if where <= shape.arclength[-1] + 1e-12:
                y[twist] = log(R[turn].T @ _frame_at(shape, where))[2]
    for end, at, which in zip((rod["base"], rod["tip"]), part.coordinates[:2], ("base", "tip"), strict=True):
        if end is None or not len(at):
            continue
        angles = len(end["axes"])
        if angles:
            y[at[:angles]] = solution.joint_angle(f"{name} {which}")
        if end["slide"] is not None:
            y[at[-1]] = solution.joint_slide(f"{name} {which}")
    for hole, at, where in zip(rod["holes"], part.coordinates[2:], marks[1 : 1 + len(rod["holes"])], strict=True):
        if len(at):
            holder = R[graph.body_turn[hole["body"]]]
            y[at] = log((holder @ hole["frame"]).T @ _frame_at(shapes[0], where))[2]
    if len(part.bases):
        for k in range(tubes):
            holder = R[graph.body_turn[rod["base"]["body"]]] if rod["base"]["body"] >= 0 else np.eye(3)
            E = turned(rod["base"], y[part.coordinates[0][: len(rod["base"]["axes"])]])[0]
            y[part.bases[k]] = log((holder @ rod["base"]["frame"] @ E).T @ shapes[k].rotation[0])[2]
            y[part.bases[k]] += 2 * np.pi * np.round((rod["angles"][k] - y[part.bases[k]]) / (2 * np.pi))
    for at, tension in zip(part.tensions, _tension_of(rod, name, solution), strict=True):
        if at >= 0:
            y[at] = tension


def _taut(drawn, solution):
    """The numbers without tension in the lines that hang loose."""
    rods = []
    for name, rod in zip(drawn.names, drawn.numbers["rods"], strict=True):
        tensions = _tension_of(rod, name, solution)
        lines = [
            {"offset": line["offset"], "tension": 0.0} if slack(line, tension) else line
            for line, tension in zip(rod["lines"], tensions, strict=True)
        ]
        rods.append(rod | {"lines": lines})
    return drawn.numbers | {"rods": rods}


def slack(line, tension):
    """Whether a line hangs loose, which one that pushes does not."""
    return "length" in line and not line.get("pushes") and tension <= 0


def _tension_of(rod, name, solution):
    if not rod["lines"]:
        return []
    names = [own.name for own in solution.assembly.rods for _ in own.lines]
    return [float(value) for own, value in zip(names, solution.tension, strict=True) if own == name]


def _frame_at(shape, where):
    k = int(np.clip(np.searchsorted(shape.arclength, where) - 1, 0, len(shape.arclength) - 2))
    low, high = shape.arclength[k : k + 2]
    if high - low < 1e-12:
        return np.array(shape.rotation[k])
    turn = log(shape.rotation[k].T @ shape.rotation[k + 1])
    return shape.rotation[k] @ exp(turn * np.clip((where - low) / (high - low), 0, 1))


def violation(drawn, solution):
    """By how much what rods, bodies and joints say of each other disagrees: gaps over the length, forces and moments over
    ``EI/L^2`` and ``EI/L``; from poses, from how far joints are turned, and from wrenches at ends of rods and holes alone."""
    own = drawn.numbers["rods"]
    length = np.mean([sum(span["length"] for span in rod["spans"]) for rod in own])
    frames = [np.array(solution.body_rotation(name)) for name in drawn.bodies]
    positions = [np.array(solution.body_position(name)) for name in drawn.bodies]
    force, moment = [], []
    for body, R in zip(drawn.numbers["bodies"], frames, strict=True):
        follower = R @ body["follower"][0], R @ body["follower"][1]
        force.append(sum((f for f, _ in body["loads"]), follower[0]))
        moment.append(sum((np.cross(R @ lever, f) for f, lever in body["loads"]), body["moment"] + follower[1]))
    gaps, pulls, turns = [0.0], [0.0], [0.0]
    for name, rod in zip(drawn.names, own, strict=True):
        tubes = len(rod["angles"])
        shape = solution.rod(name if tubes == 1 else f"{name} 0", nodes=241)
        weight = sum(span["length"] * span["force"] for span in rod["spans"])
        given = np.zeros(3) if rod["tip"] is not None else rod["pull"]
        total = np.zeros(3)
        ends = [("base", rod["base"], 0), ("tip", rod["tip"], -1)]
        doubled = np.flatnonzero(np.diff(shape.arclength) < 1e-12 * length)
        ends += [(k, hole, int(at)) for k, (hole, at) in enumerate(zip(rod["holes"], doubled, strict=True))]
        for which, end, node in ends:
            if end is None:
                continue
            wrench = solution.wrench(name, which)
            total = total + wrench.force
            b = end["body"]
            holder, place = (frames[b], positions[b]) if b >= 0 else (np.eye(3), np.zeros(3))
            hole = not isinstance(which, str)
            angles = len(end["axes"])
            theta = np.zeros(angles)
            rotation = np.array(shape.rotation[node])
            if which == "base" and tubes == 1:
                rotation = rotation @ roll(-rod["angles"][0])
            at_rest = holder @ end["frame"]
            if hole or (which == "base" and tubes > 1):
                loose = log(at_rest.T @ rotation)
                theta = loose[2:] if angles == 1 and hole else loose if angles == 3 and hole else theta
            if not hole and angles:
                theta = np.atleast_1d(np.array(solution.joint_angle(f"{name} {which}"), float))
            E, G = turned(end, theta)
            if tubes > 1 and which == "base":
                # about its own z tubes are turned as they like
                off = log((at_rest @ E).T @ rotation)[:2]
                gaps.append(np.abs(off).max())
            else:
                gaps.append(np.abs(at_rest @ E - rotation).max())
            arm = np.array(end["position"], float)
            if end["slide"] is not None:
                slide = float(solution.joint_slide(f"{name} {which}"))
                arm = arm + end["frame"] @ end["slide"] * slide
                along = (at_rest @ end["slide"]) @ wrench.force
                # the rod pushes the end along, against its spring
                pulls.append(abs(along - end["springs"][-1] * (slide - end["rest"][-1]) + end["push"][-1]))
            gaps.append(np.abs(shape.position[node] - place - holder @ arm).max() / length)
            if angles:
                axes = (at_rest @ E @ G).T @ wrench.moment
                known = np.zeros(angles)
                if not hole:
                    known = end["springs"][:angles] * (theta - end["rest"][:angles]) - end["push"][:angles]
                turns.append(np.abs(axes - known).max())
            if b >= 0:
                force[b] = force[b] + wrench.force
                moment[b] = moment[b] + wrench.about(place).moment
        if rod["medium"] is None and not rod["loads"]:  # by which it is held too
            pulls.append(np.abs(total - weight - given).max())
    pulls += [np.abs(value).max() for value in force]
    turns += [np.abs(value).max() for value in moment]
    return float(max(*gaps, max(pulls) * length**2 / EI, max(turns) * length / EI))
