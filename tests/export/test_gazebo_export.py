"""Export to Gazebo Classic: what it writes and refuses, and, where a Gazebo is at hand, that runs
there are those here.
"""

from __future__ import annotations

import os
import secrets
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import experiments.a1
import experiments.a2
import experiments.a3
import experiments.energy
import experiments.gazebo
from cranedyn.__main__ import main
from cranedyn.controllers import hold_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory, read_columns
from cranedyn.errors import CraneError, DataError
from cranedyn.export import gazebo, ros2
from cranedyn.export.gazebo import Program
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from experiments import harness
from experiments.scenarios import programs
from experiments.scenarios.crane_variants import OVERHEAD
from experiments.scenarios.moves import residual
from experiments.scenarios.strategies import FLAT, LQR, PAPER, PD
from tests.helpers import FAST, ROOT
from tests.linear_laws import CRANE, PERIOD, REST, filtered

SETUP = harness.Setup(engine=FAST)


@pytest.fixture(scope="module")
def a1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return gazebo.export(
        tmp_path_factory.mktemp("gazebo") / "a1",
        programs.program("a1", replace(SETUP, gravity=9.8)),
        every=10,
    )


def ran(program: Program) -> Trajectory:
    return simulate(
        program.crane,
        program.controller,
        program.reference,
        start=program.start,
        duration=program.duration,
        dt=program.dt,
        control_period=program.control_period,
        engine=FAST,
    )


# --- what is written ------------------------------------------------------------------------------


def test_a_folder_has_all_that_is_built_and_run_there(a1: Path) -> None:
    tables = {"feed_forward.csv", "gain.csv", "setpoint.csv", "target.csv", "integral.csv"}
    assert {path.name for path in a1.iterdir()} == {
        *tables,
        "CMakeLists.txt",
        "plugin.cc",
        "run.sh",
        "world.sdf",
        "models",
    }
    assert os.access(a1 / "run.sh", os.X_OK)
    assert subprocess.run(["bash", "-n", a1 / "run.sh"], check=False).returncode == 0
    assert "timeout" in (a1 / "run.sh").read_text()


def test_no_link_is_without_an_inertial_since_gazebo_would_make_an_empty_model_of_it(
    a1: Path,
) -> None:
    robot = ET.parse(a1 / "models" / "crane" / "model.urdf").getroot()
    assert [
        link.get("name") for link in robot.iterfind("link") if link.find("inertial") is None
    ] == ["world"]
    assert robot.find("ros2_control") is None
    assert "<!--" not in (a1 / "models" / "crane" / "model.urdf").read_text()


def test_the_plugin_puts_joints_where_they_start_and_limits_the_drives_only(a1: Path) -> None:
    plugin = ET.parse(a1 / "models" / "crane" / "model.urdf").find("gazebo/plugin")
    assert plugin is not None
    joints = {joint.findtext("name"): joint for joint in plugin.iterfind("joint")}
    starts = {name: float(joint.findtext("start") or "nan") for name, joint in joints.items()}
    swings = {"swing_radial_joint": 0, "swing_tangential_joint": 0}
    assert starts == {"yaw_joint": 0, "trolley_joint": 10, "hoist_joint": 15, **swings}
    assert plugin.findtext("rows_between_logs") == "10"
    assert plugin.findtext("overwrite_passive_velocities") == "false"
    limited = {name for name, joint in joints.items() if joint.find("effort_limit") is not None}
    assert limited == joints.keys() - swings.keys()


def test_the_plugin_is_told_rates_at_the_start_and_what_to_overwrite(tmp_path: Path) -> None:
    crane = SETUP.crane
    program = Program(crane, hold_controller(crane), None, crane.state(theta_dot=0.25), 1.0)
    folder = gazebo.export(tmp_path / "out", program, overwritten=True)
    plugin = ET.parse(folder / "models" / "crane" / "model.urdf").find("gazebo/plugin")
    assert plugin is not None and plugin.findtext("overwrite_passive_velocities") == "true"
    rates = [float(joint.findtext("start_rate") or "nan") for joint in plugin.iterfind("joint")]
    assert rates == [0.0, 0.0, 0.0, 0.25, 0.0]


def test_the_tables_are_the_controller_to_the_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    crane = SETUP.crane
    tracking = Tracking(
        5e-3, rng.normal(size=(7, 3)), rng.normal(size=(7, 3, 10)), rng.normal(size=(7, 10))
    )
    controller = HoistIntegral(crane, tracking, 1.0 / 3.0, 1e5, integral=0.1)
    reference = ramp(crane, hold(crane), "l", 1.0 / 3.0, rate=1.0 / 7.0, at=0.0)
    folder = gazebo.export(
        tmp_path / "out", Program(crane, controller, reference, crane.start, 0.05)
    )
    shapes = {"feed_forward": (7, 3), "gain": (7, 3, 10), "setpoint": (7, 10)}
    for name, shape in shapes.items():
        found = np.loadtxt(folder / f"{name}.csv", delimiter=",", ndmin=2).reshape(shape)
        assert found.tobytes() == getattr(tracking, name).tobytes()
    target = np.loadtxt(folder / "target.csv", delimiter=",")
    assert target.tolist() == [reference(k * 5e-3).position.tolist() for k in range(11)]
    gain, limit, value = np.loadtxt(folder / "integral.csv", delimiter=",").tolist()
    assert (gain, limit[2], value) == ([0.0, 0.0, 1.0 / 3.0], 1e5, [0.0, 0.0, 0.1])


def test_the_world_is_the_articles_unless_asked_otherwise(a1: Path, tmp_path: Path) -> None:
    world = ET.parse(a1 / "world.sdf").getroot()
    found = [world.findtext(f".//{tag}") for tag in ("gravity", "type", "erp", "max_step_size")]
    assert found == ["0 0 -9.8", "world", "0.8", "0.0005"]
    words = "--solver quick --erp 0.2 --length 12 --angle 0.05".split()
    assert main(["export", "gazebo", str(tmp_path / "q"), *words]) == 0
    model = ET.parse(tmp_path / "q" / "models" / "crane" / "model.urdf")
    starts = [float(start.text or "nan") for start in model.iterfind("gazebo/plugin/joint/start")]
    assert starts == [0.0, 10.0, 0.05, 0.0, 12.0]
    assert ET.parse(tmp_path / "q" / "world.sdf").getroot().findtext(".//solver/iters") == "50"


def test_the_runs_of_the_article_are_written_by_a_command(tmp_path: Path) -> None:
    folder = tmp_path / "a2"
    assert programs.main([str(folder), "--run", "a2", "--gravity", "9.8"]) == 0
    assert (folder / "run.sh").is_file()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("a2 --length 5", "--length has no effect on the run a2; leave it out."),
        ("a1 --strategy paper", "--strategy has no effect on the run a1; leave it out."),
        ("move --strategy none", "There is no strategy 'none'; there are spline alone,"),
        ("move --strategy operator", "drive of a run in Gazebo is motion; allowed is"),
    ],
)
def test_a_run_that_cannot_be_written_is_a_sentence_and_leaves_nothing(
    words: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert programs.main([str(tmp_path / "other"), "--run", *words.split()]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_what_is_handed_on_is_what_the_experiments_run() -> None:
    here = {
        "a1": experiments.a1.run(SETUP, 15.0).trajectory,
        "a2": experiments.a2.run(SETUP),
        "a3": experiments.a3.run(SETUP),
        "swing": experiments.energy.run(SETUP, SETUP.crane, 0.15, 15.0, 6.0),
    }
    for name, trajectory in here.items():
        assert ran(programs.program(name, SETUP)).q.tobytes() == trajectory.q.tobytes()


# --- what is refused ------------------------------------------------------------------------------


def test_an_export_that_breaks_off_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(gazebo, "xml_bytes", full)
    with pytest.raises(CraneError, match=r"Cannot write .*: No space left on device"):
        gazebo.export(tmp_path / "out", programs.program("a3", SETUP))
    assert list(tmp_path.iterdir()) == []


def test_a_controller_with_states_is_refused(tmp_path: Path) -> None:
    program = Program(CRANE, filtered(), None, REST, 1.0, dt=2e-3, control_period=PERIOD)
    with pytest.raises(DataError, match="LinearController has 5 states of its own"):
        gazebo.export(tmp_path / "out", program)
    assert not (tmp_path / "out").exists()


def test_a_controller_that_is_python_is_refused(tmp_path: Path) -> None:
    crane = SETUP.crane
    program = Program(crane, lambda t, state, setpoint: np.zeros(3), None, crane.start, 1.0)
    sentence = "or has run before; Gazebo runs tables, not Python"
    with pytest.raises(CraneError, match=sentence):
        gazebo.export(tmp_path / "out", program)


# --- Gazebo itself --------------------------------------------------------------------------------

_ROOT = os.environ.get("CRANEDYN_GAZEBO", "")
"""A folder with Debian bullseye and Gazebo in it, as .ci/gazebo makes it; empty where Gazebo is
installed on this machine."""

_HERE = shutil.which("gzserver") is not None and Path("/usr/share/gazebo/setup.sh").exists()

with_gazebo = pytest.mark.skipif(
    not (_HERE or (_ROOT and os.geteuid() == 0)),
    reason="no Gazebo Classic: make one by .ci/gazebo DIR and say CRANEDYN_GAZEBO=DIR, as root",
)

Runner = Callable[[Program, bool], Path]


@pytest.fixture(scope="module")
def in_gazebo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runner]:
    """Runs a program there and gives its log; the plugin is built once."""
    base = (
        tmp_path_factory.mktemp("gazebo")
        if _HERE
        else Path(_ROOT, "tmp", f"cranedyn-{secrets.token_hex(4)}")
    )
    base.mkdir(exist_ok=True)
    built: list[Path] = []

    def run(program: Program, overwritten: bool) -> Path:
        folder = gazebo.export(
            base / f"run{len(list(base.iterdir()))}", program, overwritten=overwritten
        )
        if built:
            shutil.copytree(built[0], folder / "build")
        inside = [] if _HERE else ["chroot", _ROOT]
        script = folder / "run.sh" if _HERE else Path("/", folder.relative_to(_ROOT), "run.sh")
        done = subprocess.run(
            [*inside, str(script), "300"], capture_output=True, text=True, timeout=600, check=False
        )
        assert done.returncode == 0, done.stderr + (folder / "build" / "gzserver.log").read_text()
        if not built:
            built.append(base / "built")
            built[0].mkdir()
            shutil.copy(folder / "build" / "libcrane_drives.so", built[0])
        return folder / "log.csv"

    yield run
    shutil.rmtree(base, ignore_errors=True)


@with_gazebo
@pytest.mark.parametrize("strategy", [PD, PAPER, LQR, FLAT])
def test_a_controller_moves_the_crane_in_gazebo_as_it_does_here(
    strategy: str, in_gazebo: Runner
) -> None:
    program = programs.program("move", SETUP, strategy=strategy)
    here = ran(programs.program("move", SETUP, strategy=strategy))
    columns = [name for name in gazebo_columns() if name != "t_s"]
    there = read_columns(in_gazebo(program, False), ["t_s", *columns])
    assert np.abs(there["t_s"] - here.t).max() < 1e-9
    for name in ("phi_rad", "theta_rad"):
        assert np.abs(there[name] - here[name]).max() < 2e-6  # h l ω²/2 in a step of 0.5 ms
    for name in ("gamma_rad", "x_m", "l_m"):
        assert np.abs(there[name] - here[name]).max() < 1e-4
    arrived = here.since(20.0)
    swung = np.hypot(
        *(np.ptp(there[name][-len(arrived) :]) / 2.0 for name in ("phi_rad", "theta_rad"))
    )
    assert swung == pytest.approx(residual(arrived), abs=5e-6)


@with_gazebo
def test_an_overhead_crane_moves_in_gazebo_as_it_does_here(in_gazebo: Runner) -> None:
    crane = load_crane(OVERHEAD)
    start = crane.state(phi=0.1, theta=-0.08)
    reference = ramp(crane, hold(crane, start), "x", 3.0, rate=0.5, at=1.0)
    program = Program(crane, hold_controller(crane), reference, start, 20.0)
    here = ran(program)
    swings = ("phi_rad", "theta_rad")
    allowed = experiments.gazebo.ALLOWED
    there = read_columns(in_gazebo(program, False), swings)
    # Gazebo's step, as there.
    assert max(np.abs(there[name] - here[name]).max() for name in swings) < allowed


def gazebo_columns() -> list[str]:
    return ["t_s", "gamma_rad", "x_m", "phi_rad", "theta_rad", "l_m"]


@with_gazebo
def test_a_run_in_gazebo_is_the_recording_that_is_shipped(in_gazebo: Runner) -> None:
    there = read_columns(
        in_gazebo(programs.program("a1", replace(SETUP, gravity=9.8)), False), ["t_s", "phi_rad"]
    )
    kept = read_columns(
        ROOT / "experiments" / "recordings" / "gazebo" / "a1_l15.parquet", ["t_s", "phi_rad"]
    )
    # Another order of the same sums.
    assert np.abs(there["phi_rad"][::10] - kept["phi_rad"]).max() < 1e-7


@with_gazebo
def test_in_gazebo_damping_does_not_reach_a_swing_whose_rates_are_overwritten(
    in_gazebo: Runner,
) -> None:
    world = replace(SETUP, gravity=9.8)
    logs = [
        in_gazebo(
            programs.program("swing", replace(world, values={"damp_swing": d})), True
        ).read_bytes()
        for d in (0, 1, 2e5)
    ]
    assert logs[0] == logs[1] == logs[2]


@with_gazebo
def test_gazebo_s_own_parser_takes_the_package_for_ros_whole(tmp_path: Path) -> None:
    spring = (
        "<gazebo reference='swing_radial_joint'>"
        "<springStiffness>70</springStiffness><springReference>0.25</springReference></gazebo>"
    )
    text = load_crane().urdf.replace("</robot>", f"{spring}</robot>")
    place = (
        tmp_path / "package" if _HERE else Path(_ROOT, "tmp", f"cranedyn-{secrets.token_hex(4)}")
    )
    package = ros2.export(place, replace(load_crane(), urdf_source=lambda: text))
    inside, place = (
        ([], package) if _HERE else (["chroot", _ROOT], Path("/", package.relative_to(_ROOT)))
    )
    try:
        for world in ("crane.sdf", "classic.sdf"):
            done = subprocess.run(
                [*inside, "gz", "sdf", "-k", place / "worlds" / world],
                capture_output=True,
                text=True,
                check=False,
            )
            assert (done.stdout.strip(), done.stderr) == ("Check complete", "")
        done = subprocess.run(
            [*inside, "gz", "sdf", "-p", place / "urdf" / "crane.urdf"],
            capture_output=True,
            text=True,
            check=False,
        )
        model = ET.fromstring(done.stdout)
        springs = [
            (one.findtext("spring_stiffness"), one.findtext("spring_reference"))
            for one in model.iterfind(".//dynamics")
        ]
        assert springs[2] == ("70", "0.25")
        masses = [float(mass.text or "nan") for mass in model.iterfind(".//link/inertial/mass")]
        # Foot and base stand still and have a kilogram each, which Gazebo takes together.
        assert masses == [2.0, 3000.0, 500.0, 50.0, 50.0, 1000.0]
        kinds = [joint.get("type") for joint in model.iterfind(".//joint")][1:]
        assert kinds == ["revolute", "prismatic", "revolute", "revolute", "prismatic"]
    finally:
        shutil.rmtree(package, ignore_errors=True)
