"""What notebooks show: tables, recordings and progress bars; and the two that are examples."""

import json
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

import multirod as mr
from multirod.running import progress

NOTEBOOKS = Path(__file__).parent.parent / "examples" / "notebooks"
SOLVER = mr.Shooting(integrator=mr.RK4(20))


class Page(HTMLParser):
    """Rows of a table, and what is written beside it; tags that are not closed in turn fail."""

    def __init__(self, text):
        super().__init__()
        self.rows, self.text, self._open = [], [], []
        self.feed(text)
        self.close()
        assert not self._open

    def handle_starttag(self, tag, attributes):
        assert tag in ("div", "b", "small", "table", "thead", "tbody", "tr", "td", "th")
        assert all(name == "style" for name, _ in attributes)  # nothing is fetched, nothing runs
        self._open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if self._open[-1] in ("td", "th"):
            self.rows[-1].append(data)
        else:
            self.text.append(data)


def page(item):
    return Page(item._repr_html_())


@pytest.fixture(scope="module")
def robot():
    rod = mr.Rod(
        length=0.4, bending_stiffness=0.2233, torsional_stiffness=0.0638, precurvature=(3, 1, 0), outer_diameter=3e-3, name="<b>&"
    )
    return mr.SingleRod(rod)


def test_rods(robot):
    shown = page(robot.rods[0])
    assert shown.rows == [["length [m]", "EI [N m²]", "GJ [N m²]", "u* [1/m]"], ["0.4", "0.2233", "0.0638", "(3, 1, 0)"]]
    assert shown.text == ["Rod '<b>&', length 0.4 m", "outer diameter 3 mm"]
    line = mr.Tendon(offset=(0.01, 0), name="left")
    soft = mr.Rod(
        length=np.array([0.2, 0.3]),
        bending_stiffness=(0.02, 0.03),
        torsional_stiffness=np.inf,
        precurvature=(0, 0, 2.5),
        axial_stiffness=390.0,
        linear_density=0.01,
        lines=[line],
        discs=0.01,
    )
    shown = page(soft)
    assert shown.rows[0][4:] == ["EA [N]", "mass [kg/m]"]
    assert shown.rows[1] == ["0.2 to 0.3", "(0.02, 0.03)", "inf", "(0, 0, 2.5)", "390", "0.01"]
    assert shown.text[0] == "Rod, length 0.2 to 0.3 m, batch (2,)"
    assert "discs every 10 mm" in shown.text
    sections = [mr.Section(length=0.1, bending_stiffness=0.01 * k, torsional_stiffness=0.01) for k in range(1, 12)]
    many = page(mr.Rod(sections=sections))
    assert len(many.rows) == 1 + 8
    assert "the first 8 of 11 sections" in many.text
    smooth = mr.Rod(length=0.1, bending_stiffness=0.01, torsional_stiffness=0.01, precurvature=lambda s: (10 * s, 0, 0))
    assert page(smooth).rows[1][3] == "a function of arclength"


def test_robots_and_inputs(robot):
    shown = page(robot)
    assert shown.rows[1] == ["<b>&", "0.4", "3", "0.2233", "0.0638", "1", "0"]
    assert "tip_force [N]" in shown.text[-1]
    given = robot.inputs(tip_force=[(0, 0, 1), (0, 0.5, 1)], distributed_force=lambda s: (s, 0, 0))
    rows = {row[0]: row[1:] for row in page(given).rows[1:]}
    assert rows["tip_force"][:2] == ["(0, 0, 1) to (0, 0.5, 1)", "N"]
    assert rows["distributed_force"][:2] == ["a function of arclength", "N/m"]
    assert page(robot.inputs()).text == ["Inputs", "all are zero"]


def test_a_network_says_what_its_rods_are_joined_to(robot):
    plate = mr.Body("plate", mass=0.05)
    rods = dict.fromkeys(("leg", "mast", "thread"), robot.rods[0])
    ends = [
        mr.Joint("leg", "base", to=mr.ground),
        mr.Joint("leg", "tip", to=plate, kind="revolute", axis=(1, 0, 0), stiffness=1.0),
    ]
    joints = [*ends, mr.Joint("mast", "base", to=plate), mr.Joint("thread", "base", to=mr.ground)]
    joints.append(mr.Joint("thread", "along", to=plate, kind="spherical", at=0.2))
    network = mr.Network(rods=rods, bodies=[plate], joints=joints, end_effector="mast")
    shown = page(network)
    assert [row[0] for row in shown.rows[1:]] == ["leg", "mast", "thread"]
    tips = ["plate, revolute", "free", "free; through plate, spherical"]
    bases = [f"{where}, clamped" for where in ("ground", "plate", "ground")]
    assert [row[-2:] for row in shown.rows[1:]] == [list(pair) for pair in zip(bases, tips, strict=True)]
    assert "bodies: plate (0.05 kg); end effector: mast" in shown.text


def test_solutions_batches_and_histories(robot):
    one = mr.solve(robot, robot.inputs(tip_force=(0.3, 0.1, 0)), solver=SOLVER)
    rows = {row[0]: row[1] for row in page(one).rows}
    assert rows["status"] == "CONVERGED"
    np.testing.assert_allclose([float(x) for x in rows["tip position [m]"].split(",")], one.tip_position, rtol=1e-3)
    many = mr.solve(robot, robot.inputs(tip_force=np.linspace(-0.5, 0.5, 30).reshape(6, 5, 1) * [1, 0, 0]), solver=SOLVER)
    shown = page(many)
    assert len(shown.rows) == 1 + 8
    assert shown.rows[-1][:2] == ["5, 4", "CONVERGED"]
    np.testing.assert_allclose([float(x) for x in shown.rows[-1][2:5]], many.tip_position[5, 4], rtol=1e-3)
    assert "30 CONVERGED" in shown.text
    assert "8 of 30 instances are shown" in shown.text
    assert page(many[:0]).text[0] == "Solution of SingleRod, batch (0, 5)"


def test_what_failed_says_why(robot):
    tip_force = np.zeros((4, 3))
    tip_force[2:, 1] = 60.0
    solver = mr.Shooting(integrator=mr.RK4(20), max_iterations=3, max_continuation_steps=2)
    history = mr.simulate(robot, robot.inputs(tip_force=tip_force), time=0.02 * np.arange(4), solver=solver)
    shown = page(history)
    assert [row[:3] for row in shown.rows[1:]][2] == ["0.04", "MAX_ITERATIONS", "–"]
    assert "2 CONVERGED, 2 MAX_ITERATIONS" in shown.text
    assert shown.text[0] == "History of SingleRod, 4 samples, 0 to 0.06 s"
    one = page(history[3])
    assert one.rows[0] == ["status", "MAX_ITERATIONS"]
    assert mr.Status.MAX_ITERATIONS.message in one.text


def test_explanations_have_the_rows_that_are_printed(robot):
    explanation = mr.explain(robot, robot.inputs(tip_force=(0.3, 0.1, 0)))
    shown = page(explanation)
    printed = str(explanation).splitlines()
    assert len(shown.rows) == 1 + len(explanation.terms)
    for row, line in zip(shown.rows, printed[2:], strict=False):
        assert all(cell in line for cell in row)
    assert shown.text == [printed[0], printed[-1]]


def test_equilibria_and_critical_loads():
    """An Euler column in the plane of its weaker axis."""
    rod = mr.Rod(length=0.4, bending_stiffness=(0.2, 0.8), torsional_stiffness=0.1)
    robot = mr.SingleRod(rod)
    found = mr.critical_loads(robot, robot.inputs(tip_force=(0, 0, -1.0)), up_to=5.0)
    shown = page(found)
    np.testing.assert_allclose(float(shown.rows[1][0]), np.pi**2 * 0.2 / 4 / 0.4**2, rtol=1e-3)
    assert shown.rows[1][1:4] == ["bifurcation: it buckles", "0", "1"]
    assert page(found[0]).rows == shown.rows
    every = mr.equilibria(robot, robot.inputs(tip_force=(0, 0, -5.0)), starts=64)
    rows = page(every).rows
    assert [row[1] for row in rows[1:]] == ["STABLE", "STABLE", "UNSTABLE"]
    assert [row[2] for row in rows[1:]] == ["0", "0", "1"]
    np.testing.assert_allclose([float(row[3]) for row in rows[1:]], every.potential, rtol=1e-3)


def test_a_recording_without_the_widget_says_what_to_install(robot, monkeypatch):
    history = mr.simulate(robot, robot.inputs(tip_force=np.zeros((2, 3))), time=[0.0, 0.1], solver=SOLVER)
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    with pytest.raises(ImportError, match=r'pip install "multirod\[notebook\]"'):
        history.show()


def test_a_recording_is_given_to_the_widget(robot, monkeypatch, tmp_path):
    pytest.importorskip("rerun_notebook")
    import rerun.notebook

    sent, shown = [], []
    monkeypatch.setattr(rerun.notebook.Viewer, "display", lambda self: shown.append(self))
    monkeypatch.setattr(rerun.notebook._Viewer, "send_rrd", lambda self, data: sent.append(data))
    history = mr.simulate(robot, robot.inputs(tip_force=np.zeros((2, 3))), time=[0.0, 0.1], solver=SOLVER)
    history.show(width=800, name="mine")
    (viewer,), (recording,) = shown, sent
    assert viewer._viewer._width == 800
    (tmp_path / "sent.rrd").write_bytes(recording)
    reader = RrdReader(str(tmp_path / "sent.rrd"))
    assert len(reader.blueprints()) == 1
    assert "/world/rods/<b>&" in {str(chunk.entity_path).replace("\\", "") for chunk in reader.stream().collect().stream()}
    for size in ("wide", 0, 2.5):
        with pytest.raises(ValueError, match=r"show\.height = .* is not allowed"):
            history.show(height=size)
    with pytest.raises(TypeError, match="save takes a History"):
        mr.recording.notebook.show(history[0])


def test_a_terminal_is_no_notebook():
    assert not progress.in_notebook()


CELLS = [
    "history.show()",
    """
import multirod.running.progress as progress
progress.PATIENCE = progress.REFRESH = 0.0
seen = []
update = progress._NotebookBar._text
progress._NotebookBar._text = lambda bar: seen.append(update(bar)) or seen[-1]
with progress.Watch("things <b>", 5, True) as watch:
    for _ in range(5):
        watch.advance()
print(seen[-1])
""",
]


@pytest.mark.filterwarnings("default::DeprecationWarning")  # those of the programs that run notebooks
def test_the_first_notebook_runs_and_shows_what_it_says(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    notebook = nbformat.read(NOTEBOOKS / "first_robot.ipynb", as_version=4)
    notebook.cells += [nbformat.v4.new_code_cell(code) for code in CELLS]
    folder = {"metadata": {"path": str(tmp_path)}}  # not the repository's, where the package is a bare folder
    client.NotebookClient(notebook, timeout=600, kernel_name="python3", resources=folder).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    kinds = [kind for output in outputs for kind in output.get("data", {})]
    assert kinds.count("image/png") == 5
    tables = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert [Page(text).text[0].split()[0] for text in tables if text] == ["SingleRod", "Solution", "Solution", "History"]
    assert "application/vnd.jupyter.widget-view+json" in kinds
    assert tables[-1] == ""  # a bar that has gone
    printed = [(output["name"], output["text"]) for output in outputs if output["output_type"] == "stream"]
    assert ("stdout", '<small>things &lt;b&gt; <progress value="5" max="5"></progress> 5/5</small>\n') in printed
    assert not [text for name, text in printed if name == "stderr" and "compiling kernels" not in text]


def test_the_second_notebook_runs(capsys):
    """In this process, where a kernel would have to begin anew."""
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.close("all")  # what other tests left
    scope = {}
    for cell in json.loads((NOTEBOOKS / "three_tubes.ipynb").read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), scope)
    assert (scope["family"].status == mr.Status.CONVERGED).all()
    assert len(plt.get_fignums()) == 4
    plt.close("all")
    assert "least margin 0." in capsys.readouterr().out


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_kept_without_outputs(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
