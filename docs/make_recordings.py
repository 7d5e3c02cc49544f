"""The pictures of docs/recordings.md: recordings of the page's own examples, as the viewer shows them.

python docs/make_recordings.py [NAME ...] [--size 1280x800] [--out FOLDER]

Needs the package ``pillow``, and a Vulkan driver; ``apt-get install mesa-vulkan-drivers libvulkan1`` has one that draws without a
graphics card.
"""

import argparse
import io
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import multirod as mr
from multirod.studies import scenes

HERE = Path(__file__).parent / "images"
PATIENCE = 90.0  # seconds for a picture
ROD = {"length": 0.4, "bending_stiffness": 0.2233, "torsional_stiffness": 0.0638, "precurvature": (3, 1, 0)}
QUICK = mr.Shooting(integrator=mr.RK4(20))


def compared(path: Path) -> None:
    study = scenes.three_tubes(duration=3, rate=40)
    exact = mr.simulate(study.robot, study.inputs, time=study.time, progress=False)
    solver = mr.Observer(feed_forward=False)
    mr.simulate(study.robot, study.inputs, time=study.time, solver=solver, progress=False).save(
        path, reference=exact, reference_name="Newton's method"
    )


def legs(path: Path) -> None:
    study = scenes.six_legs(duration=3, rate=40)
    mr.simulate(study.robot, study.inputs, time=study.time, progress=False).save(path)


def batch(path: Path) -> None:
    robot = mr.SingleRod(mr.Rod(**ROD))
    time = np.linspace(0, 4, 60)
    force = np.zeros((60, 12, 3))
    force[..., 0] = np.linspace(0, 1.5, 12) * np.sin(time)[:, None]
    force[..., 1] = 0.5 * np.cos(time)[:, None]
    history = mr.simulate(robot, robot.inputs(tip_force=force), time=time, solver=QUICK, progress=False)
    history.save(path, instances=12, colour_by="energy")


def failed(path: Path) -> None:
    robot = mr.SingleRod(mr.Rod(**ROD))
    force = np.zeros((60, 3))
    force[:, 0] = np.linspace(0, 1, 60)
    force[20:30, 1] = 60.0
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=3, max_continuation_steps=2)
    mr.simulate(robot, robot.inputs(tip_force=force), time=0.1 * np.arange(60), solver=solver, progress=False).save(path)


def live(path: Path) -> None:
    wire = mr.Rod.tube(length=0.2, outer_diameter=1e-3, young_modulus=60e9, shear_modulus=23e9, name="wire")
    tracker = mr.Tracker(mr.SingleRod(wire), solver=mr.Shooting(integrator=mr.RK4(50)), dt=0.01)
    with mr.Recorder(path) as recorder:
        for k in range(300):
            force = (0.004 * k * np.sin(0.02 * k), 0.0, -0.1 * np.cos(0.02 * k) + 0.1)
            recorder.log(0.01 * k, tracker.step(tip_force=force, rotation=0.01 * k))


PICTURES: dict[str, tuple[Callable[[Path], None], float]] = {  # and the time that is shown [s]
    "compared": (compared, 2.2),
    "legs": (legs, 1.5),
    "batch": (batch, 1.2),
    "failed": (failed, 2.5),
    "live": (live, 2.6),
}


def shoot(recording: Path, picture: Path, seconds: float, size: str) -> None:
    """The viewer's window with a recording, its cursor at a time."""
    import rerun_cli
    from PIL import Image
    from rerun.experimental import ViewerClient

    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    viewer = [str(Path(rerun_cli.__file__).parent / "rerun"), str(recording), "--headless", "--port", str(port)]
    viewer += ["--bind", "127.0.0.1", "--window-size", size, "--hide-welcome-screen"]
    with tempfile.TemporaryDirectory() as folder:
        environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
        environment |= {"RUST_LOG": "error", "XDG_RUNTIME_DIR": folder}
        with subprocess.Popen(viewer, env=environment) as running:
            try:
                end = time.monotonic() + PATIENCE
                client = _connected(ViewerClient, f"rerun+http://127.0.0.1:{port}/proxy", end)
                client.set_time("time", play_state="paused", duration=seconds)
                last, same = b"", 0
                while same < 2 and time.monotonic() < end:
                    seen = client.take_screenshot()
                    same = same + 1 if seen == last else 0
                    last = seen
                    time.sleep(0.3)
            finally:
                running.terminate()
    Image.open(io.BytesIO(last)).convert("RGB").save(picture, optimize=True)


def _connected(client: type, address: str, end: float) -> object:
    while True:
        try:
            found = client.connect(address)
            state = found.get_state()
            if state.recordings and not state.loading:
                return found
        except Exception:  # it is still starting
            if time.monotonic() > end:
                raise
        time.sleep(0.2)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*PICTURES, []], help="all by default")
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--seconds", type=float, help="the time to show, another than in the page")
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names or PICTURES:
            make, seconds = PICTURES[name]
            recording, picture = Path(folder) / f"{name}.rrd", options.out / f"recording_{name}.png"
            make(recording)
            shoot(recording, picture, options.seconds or seconds, options.size)
            print(f"{picture}: {picture.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
