"""Controllers of one's own from files: what they command, and what is wrong with a file."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from cranedyn.__main__ import main
from cranedyn.controllers.linear import LinearController, linear_controller
from cranedyn.controllers.tracking import Tracking
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName
from cranedyn.export.controller_options import controller_from_options
from cranedyn.export.matlab import controller_to_matlab
from cranedyn.export.st import export
from cranedyn.export.usual_controllers import rest_at_start, usual_controller
from cranedyn.interfaces import Drive, Setpoint, State
from cranedyn.interop.controller_file import (
    controllers_by_name,
    is_controller_file,
    open_controller,
    read_state_space,
)
from cranedyn.model.load import load_crane
from cranedyn.model.signals import input_names, state_names
from cranedyn.references import hold
from cranedyn.references.flat import flat
from cranedyn.simulation.simulate import simulate
from tests.helpers import ROOT, crane
from tests.system.test_pages import scripts

PERIOD = 5e-3
CRANE = crane()
EFFORTS = input_names(CRANE, "effort")

NOTCH: dict[str, Any] = {
    "A": [[0.9, 0.1], [-0.1, 0.8]],
    "B": [[1.0, 0.0, 0.5], [0.0, 2.0, 0.0]],
    "C": [[10.0, -5.0], [0.0, 3.0], [1.0, 0.0]],
    "D": [[-100.0, 0.0, 0.0], [0.0, -50.0, 20.0], [0.0, 0.0, -30.0]],
    "dt": PERIOD,
    "inputs": ["x", "phi", "l_dot"],
    # Not in the order of the drives.
    "outputs": ["F_x", "F_l", "T_gamma"],
}


def written(folder: Path, content: dict[str, Any], name: str = "notch.json") -> str:
    file = folder / name
    file.write_text(json.dumps(content), encoding="utf-8")
    return str(file)


def cells(names: list[str]) -> np.ndarray:
    """A cell array of MATLAB, a column as `ss` has it."""
    array = np.empty((len(names), 1), dtype=object)
    array[:, 0] = names
    return array


def test_a_state_space_file_commands_what_its_matrices_say(tmp_path: Path) -> None:
    start = CRANE.state(x=12.0, l=12.0)
    motion = rest_at_start(CRANE, PERIOD)
    rest = State(motion.q[0], motion.v[0])
    made = open_controller(written(tmp_path, NOTCH)).make(CRANE, motion)
    assert made.drive == "effort"
    # So that a memory of another run would show.
    for _ in range(2):
        run = simulate(
            CRANE,
            made.controller,
            hold(CRANE, rest),
            start=start,
            duration=0.2,
            control_period=PERIOD,
            validity="mark",
        )
        deviations = np.hstack([run.q, run.v]) - np.concatenate(rest)
        names = state_names(CRANE)
        y = deviations[:, [names.index(name) for name in NOTCH["inputs"]]]
        x = np.zeros(2)
        a, b, c, d = (np.array(NOTCH[key]) for key in "ABCD")
        holding = holding_effort(CRANE, motion.q[0])
        for k in range(len(run)):
            u = c @ x + d @ y[k]
            expected = holding + u[[NOTCH["outputs"].index(name) for name in EFFORTS]]
            # The sums are taken in another order.
            np.testing.assert_allclose(run.effort[k], expected, rtol=1e-12)
            x = a @ x + b @ y[k]


def test_a_gain_about_a_rest_goes_where_the_setpoint_of_the_loop_is(tmp_path: Path) -> None:
    gain = {"D": [[-1e3, 2e3], [0.0, 0.0], [0.0, 0.0]], "inputs": ["x", "phi"]}
    file = written(tmp_path, {**gain, "outputs": ["F_x", "F_l", "T_gamma"]})
    made = open_controller(file).make(CRANE, rest_at_start(CRANE, PERIOD))
    position = CRANE.start.q[CRANE.layout.drives] + np.array([0.3, 2.0, -1.0])
    state = CRANE.state(phi=0.1)
    command = made.controller(0.0, state, Setpoint(position, np.zeros(3), np.zeros(3)))
    holding = holding_effort(CRANE, CRANE.start.q)
    np.testing.assert_allclose(command - holding, [0.0, 1e3 * 2.0 + 2e3 * 0.1, 0.0], atol=1e-9)


def test_a_gain_along_a_motion_acts_on_the_deviation_from_it(tmp_path: Path) -> None:
    motion = flat(CRANE, CRANE.state(), CRANE.state(x=14.0), 15.0, period=PERIOD)
    names = ["F_x", "F_l", "T_gamma"]
    content = {"D": [[-1e3], [0.0], [0.0]], "inputs": ["x"], "outputs": names}
    own = open_controller(written(tmp_path, content))
    controller, _ = own.make(CRANE, motion)
    row = 1000
    setpoint = motion(row * PERIOD)
    planned = State(motion.q[row], motion.v[row])
    behind = State(motion.q[row] - 0.1 * (np.array(state_names(CRANE)[:5]) == "x"), planned.v)
    difference = controller(row * PERIOD, behind, setpoint) - controller(
        row * PERIOD, planned, setpoint
    )
    np.testing.assert_allclose(difference, [0.0, 100.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("form", ["own names", "fields of ss"])
def test_a_file_of_matlab_says_the_same_as_one_in_json(form: str, tmp_path: Path) -> None:
    variables = {key: np.array(NOTCH[key]) for key in "ABCD"} | {"Ts": np.array([[PERIOD]])}
    if form == "own names":
        variables["inputs"] = cells(NOTCH["inputs"]).T
        variables["outputs"] = cells(NOTCH["outputs"]).T
    else:
        # As `save('notch.mat', '-struct', 's')` after `s = get(K)` writes an ss object.
        variables |= {"E": np.zeros((0, 0)), "InputDelay": np.zeros((3, 1)), "Name": ""}
        variables["InputName"] = cells(NOTCH["inputs"])
        variables["OutputName"] = cells(NOTCH["outputs"])
    file = tmp_path / "notch.mat"
    savemat(file, variables)
    from_matlab = vars(read_state_space(file))
    from_json = vars(read_state_space(written(tmp_path, NOTCH)))
    assert from_matlab.keys() == from_json.keys()
    for key, value in from_json.items():
        assert np.array_equal(from_matlab[key], value), key


def heavier_law() -> LinearController:
    """States, limits, anti-windup and holding commands that are not those of CRANE at its start."""
    heavy = crane(payload_mass=1700.0)
    law = linear_controller(
        heavy,
        about=heavy.state(x=12.0, l=15.0),
        a=[[0.9, 0.1], [0.0, 1.0]],
        b=[[0.1, 0.0], [PERIOD, 0.2]],
        c=[[-3e4, -5e3], [2e3, 0.0]],
        d=[[-5e6, -1e6], [3e4, 2e4]],
        inputs=["x", "phi_dot"],
        outputs=["F_x", "F_l"],
        period=PERIOD,
        initial=[0.3, -0.2],
        anti_windup=[[1e-5, 0.0], [2e-5, 3e-5]],
        setpoint="run",
    )
    return replace(law, states=replace(law.states, limit=0.5 * law.states.limit))


WRITTEN: dict[str, tuple[Callable[[], Any], Drive]] = {
    "follows": (heavier_law, "effort"),
    "at rest": (lambda: replace(heavier_law(), setpoint="rest"), "effort"),
    "gain": (lambda: usual_controller("lqr", CRANE, PERIOD)[0], "effort"),
    "accelerations": (
        lambda: linear_controller(
            CRANE,
            a=[[1.0]],
            b=[[PERIOD]],
            c=[[-1.0]],
            d=[[-2.0]],
            about=CRANE.state(x=13.0),
            inputs=["x"],
            outputs=["x_ddot"],
            period=PERIOD,
            anti_windup=None,
            drive="motion",
        ),
        "motion",
    ),
    "rates": (
        lambda: linear_controller(
            CRANE,
            a=np.zeros((0, 0)),
            b=np.zeros((0, 2)),
            c=np.zeros((1, 0)),
            d=[[-0.5, 0.2]],
            about=CRANE.state(x=13.0),
            inputs=["x", "x_dot_command_4"],
            outputs=["x_dot_command"],
            period=PERIOD,
            setpoint="run",
            drive="velocity",
        ),
        "velocity",
    ),
}
"""Controllers that `controller_to_matlab` writes, and what they command."""


@pytest.mark.parametrize("name", WRITTEN)
def test_a_controller_that_is_written_for_matlab_is_read_back_and_commands_the_same(
    name: str, tmp_path: Path
) -> None:
    make, drive = WRITTEN[name]
    law = make()
    file = controller_to_matlab(tmp_path / "law.mat", CRANE, law, drive=drive, duration=0.1)
    # Read about another rest than the one that it was designed for: the file has its own.
    made = open_controller(str(file)).make(CRANE, rest_at_start(CRANE, PERIOD))
    assert made.drive == drive
    rng = np.random.default_rng(0)
    for k in range(40):
        q = CRANE.start.q + rng.normal(size=5)
        v = rng.normal(size=5)
        positions = CRANE.start.q[CRANE.layout.drives] + rng.normal(size=3)
        setpoint = Setpoint(positions, np.zeros(3), np.zeros(3))
        expected = law(k * PERIOD, State(q, v), setpoint)
        found = made.controller(k * PERIOD, State(q, v), setpoint)
        # Sums in another order, of terms up to 1e7 N.
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_a_controller_of_a_luffing_crane_is_read_back_with_its_rest_at_each_setpoint(
    tmp_path: Path,
) -> None:
    luffing = load_crane(urdf=ROOT / "urdf" / "luffing_crane.urdf.xacro")
    names = input_names(luffing, "effort")
    # The swing hangs at another angle of the jib where the jib is luffed.
    law = linear_controller(
        luffing,
        a=[[0.9]],
        b=[[0.1, 0.2]],
        c=[[-1e3]] * len(names),
        d=[[-2e3, 3e3]] * len(names),
        about=luffing.start,
        inputs=["luff", "swing_radial"],
        period=PERIOD,
        setpoint="run",
    )
    file = controller_to_matlab(tmp_path / "law.mat", luffing, law, duration=0.1)
    made = open_controller(str(file)).make(luffing, rest_at_start(luffing, PERIOD))
    start = luffing.start.q[luffing.layout.drives]
    state = State(luffing.start.q + 0.02, luffing.start.v + 0.1)
    zero = np.zeros(len(names))
    for k in range(5):
        setpoint = Setpoint(start + 0.01 * k, zero, zero)
        expected = law(k * PERIOD, state, setpoint)
        found = made.controller(k * PERIOD, state, setpoint)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)


@pytest.mark.slow
def test_the_stretch_of_a_taut_rope_in_a_file_is_no_input(tmp_path: Path) -> None:
    roped = load_crane(rope_stiffness=np.inf)
    law, _ = usual_controller("lqr", roped, PERIOD)
    file = controller_to_matlab(tmp_path / "law.mat", roped, law, duration=0.1)
    assert "rope_stretch" in read_state_space(file).inputs
    made = open_controller(str(file)).make(roped, rest_at_start(roped, PERIOD))
    state = State(roped.start.q + 0.01, roped.start.v)
    setpoint = Setpoint(roped.start.q[roped.layout.drives] + 0.1, np.zeros(3), np.zeros(3))
    found = made.controller(0.0, state, setpoint)
    np.testing.assert_allclose(found, law(0.0, state, setpoint), rtol=1e-9)


def test_a_controller_for_matlab_follows_a_motion_by_its_deviations(tmp_path: Path) -> None:
    file = controller_to_matlab(tmp_path / "law.mat", CRANE, heavier_law(), duration=0.1)
    motion = flat(CRANE, CRANE.state(), CRANE.state(x=14.0), 15.0, period=PERIOD)
    controller, _ = open_controller(str(file)).make(CRANE, motion)
    planned = State(motion.q[0], motion.v[0])
    first = controller(0.0, planned, motion(0.0))
    holding = holding_effort(CRANE, CRANE.start.q)
    # Its states begin at 0.3 and -0.2.
    expected = holding + np.array([0.0, -3e4 * 0.3 + 5e3 * 0.2, 2e3 * 0.3])
    np.testing.assert_allclose(first, expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"D": np.ones((3, 13))}, "neither zero nor those of the deviation"),
        ({"z0": np.zeros((4, 1))}, "z0 of the controller .* shape"),
        ({"u0": np.full((3, 1), np.nan)}, "u0 of the controller"),
        ({"u_limits": np.zeros((3, 1))}, "u_limits of the controller"),
        ({"anti_windup": np.zeros((1, 1))}, "anti_windup .* shape"),
    ],
)
def test_a_file_of_matlab_whose_setpoints_make_no_controller_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    file = controller_to_matlab(tmp_path / "law.mat", CRANE, heavier_law(), duration=0.1)
    content = {key: value for key, value in loadmat(file).items() if not key.startswith("__")}
    savemat(file, content | changes)
    own = open_controller(str(file))
    with pytest.raises(CraneError, match=message):
        own.make(CRANE, rest_at_start(CRANE, PERIOD))


def test_other_variables_of_a_workspace_do_not_belong_to_a_gain(tmp_path: Path) -> None:
    gain = {"D": [[-1e3, 2e3]], "inputs": ["x", "phi"], "outputs": ["F_x"]}
    variables = {"D": np.array(gain["D"])}
    variables |= {key: cells(gain[key]) for key in ("inputs", "outputs")}
    # Names that `controller_to_matlab` writes, and that a workspace may have for something else.
    of_the_workspace = {"x0": "a text", "z0": np.ones((2, 2)), "u0": 7.0, "u_limits": -1.0}
    file = tmp_path / "workspace.mat"
    savemat(file, variables | of_the_workspace)
    motion = rest_at_start(CRANE, PERIOD)
    from_matlab = open_controller(str(file)).make(CRANE, motion).controller
    from_json = open_controller(written(tmp_path, gain)).make(CRANE, motion).controller
    state = CRANE.state(phi=0.1)
    setpoint = Setpoint(CRANE.start.q[CRANE.layout.drives] + 0.2, np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(
        from_matlab(0.0, state, setpoint), from_json(0.0, state, setpoint)
    )


def test_a_setpoint_of_no_drive_is_refused(tmp_path: Path) -> None:
    content = {"D": [[1.0]], "inputs": ["phi_set"], "outputs": ["F_x"]}
    own = open_controller(written(tmp_path, content))
    with pytest.raises(UnknownName, match="no setpoint 'phi_set'; there are gamma_set, x_set"):
        own.make(CRANE, rest_at_start(CRANE, PERIOD))


def changed(**values: Any) -> dict[str, Any]:
    """NOTCH with some values changed, and without those that are None."""
    return {key: value for key, value in {**NOTCH, **values}.items() if value is not None}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(D=None), "has no matrix D"),
        (changed(B=None), "has no B, but others"),
        (changed(A=[[1.0, 2.0]]), "A in .* shape"),
        (changed(B=[[1.0], [2.0]]), "B in .* shape"),
        (changed(D=[["1", "2", "x"]] * 3), "D in "),
        (changed(dt=None), "without a period; make it one"),
        (changed(dt=0), "in continuous time"),
        (changed(A=None, B=None, C=None), "has dt beside a gain"),
        (changed(dt="fast"), "period in .* fast"),
        (changed(dt=-0.01), "period in .* -0.01"),
        (changed(inputs=None), "does not name its inputs"),
        (changed(outputs=["F_x", "F_x", "F_l"]), "has F_x twice among its outputs"),
        (changed(gain=1.0), "has the key gain; allowed are A, B"),
    ],
)
def test_a_wrong_file_is_told_in_one_sentence(
    content: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError, match=message):
        open_controller(written(tmp_path, content))


def test_a_gain_in_a_file_of_matlab_may_have_the_period_of_its_ss_object(tmp_path: Path) -> None:
    file = tmp_path / "gain.mat"
    names = {"InputName": cells(["x"]), "OutputName": cells(EFFORTS)}
    savemat(file, {"D": np.array([[0.0], [-1e3], [0.0]]), "Ts": -1.0, **names})
    gain = read_state_space(file)
    assert gain.period is None and len(gain.a) == 0


def test_a_gain_may_feed_back_commands_on_their_way_to_the_converters(tmp_path: Path) -> None:
    rates = input_names(CRANE, "velocity")
    gain = np.zeros((3, 2))
    gain[1] = -0.5, 0.2
    content = {"D": gain.tolist(), "inputs": ["x", "x_dot_command_2"], "outputs": rates}
    own = open_controller(written(tmp_path, content))
    controller, drive = own.make(CRANE, rest_at_start(CRANE, PERIOD))
    assert drive == "velocity"
    start = CRANE.state(x=CRANE.start.q[1] + 0.1)
    setpoint = Setpoint(CRANE.start.q[CRANE.layout.drives], np.zeros(3), np.zeros(3))
    commands = [controller(k * PERIOD, start, setpoint)[1] for k in range(4)]
    np.testing.assert_allclose(commands, [-0.05, -0.05, -0.06, -0.06], rtol=1e-12)
    absurd = {**content, "inputs": ["x", "x_dot_command_999999999"]}
    with pytest.raises(CraneError):
        open_controller(written(tmp_path, absurd)).make(CRANE, rest_at_start(CRANE, PERIOD))


def test_what_is_no_file_of_its_kind_is_refused(tmp_path: Path) -> None:
    for name in ("broken.json", "broken.mat"):
        file = tmp_path / name
        file.write_text("no matrices")
        with pytest.raises(DataError, match="it is no"):
            open_controller(str(file))
    with pytest.raises(DataError, match="absent"):
        open_controller(str(tmp_path / "absent.mat"))
    delayed = tmp_path / "delayed.mat"
    savemat(delayed, {"D": np.eye(3), "InputDelay": np.ones((3, 1))})
    with pytest.raises(DataError, match="has InputDelay, which is not read"):
        open_controller(str(delayed))
    implicit = tmp_path / "implicit.mat"
    savemat(implicit, {"D": np.eye(3), "E": np.eye(3)})
    with pytest.raises(DataError, match="has a matrix E"):
        open_controller(str(implicit))
    with pytest.raises(DataError, match=r"names no controller; allowed is FILE\.py:FUNCTION"):
        open_controller(str(tmp_path / "mine.py"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (changed(inputs=["x", "phi", "speed"]), "no input 'speed'; there are gamma, x"),
        (changed(outputs=["F_x", "F_l", "F_z"]), "no command 'F_z'; there are T_gamma"),
        (changed(outputs=["F_x", "F_l", "x_ddot"]), "commands of different kinds"),
    ],
)
def test_names_that_the_crane_does_not_have_are_refused(
    content: dict[str, Any], message: str, tmp_path: Path
) -> None:
    own = open_controller(written(tmp_path, content))
    with pytest.raises(CraneError, match=message):
        own.make(CRANE, rest_at_start(CRANE, PERIOD))


PROGRAM = """
from dataclasses import dataclass, field
import beside
from cranedyn.controllers import hold_controller

@dataclass
class Counting:
    crane: object
    motion: object
    calls: list = field(default_factory=list)

    def __call__(self, t, state, setpoint):
        self.calls.append(t)
        return hold_controller(self.crane)(t, state, setpoint)

def rates(crane, motion):
    return (lambda t, state, setpoint: 0.0 * setpoint.position), "velocity"

def speeds(crane, motion):
    return (lambda t, state, setpoint: 0.0 * setpoint.position), "speed"

def failing(crane, motion):
    raise ValueError("no solution")

def nothing(crane, motion):
    return None

def alone(crane):
    return None
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    (tmp_path / "beside.py").write_text("")
    file = tmp_path / "mine.py"
    file.write_text(PROGRAM)
    return file


def test_a_function_makes_a_controller_anew_for_each_run(program: Path) -> None:
    own = open_controller(f"{program}:Counting")
    assert own.name == "Counting"
    motion = rest_at_start(CRANE, PERIOD)
    made = [own.make(CRANE, motion) for _ in range(2)]
    assert [one.drive for one in made] == ["effort", "effort"]
    first, second = (one.controller for one in made)
    assert first.crane is CRANE and first.motion is motion  # type: ignore[attr-defined]
    simulate(CRANE, first, duration=0.05)
    assert len(first.calls) == 11 and not second.calls  # type: ignore[attr-defined]
    assert open_controller(f"{program}:rates").make(CRANE, motion).drive == "velocity"


def test_a_function_that_makes_no_controller_says_so(program: Path) -> None:
    motion = rest_at_start(CRANE, PERIOD)
    with pytest.raises(
        UnknownName, match=r"no function in .* 'missing'; there are Counting, rates"
    ):
        open_controller(f"{program}:missing")
    with pytest.raises(DataError, match=r"alone in .* cannot be called with \(crane, motion\)"):
        open_controller(f"{program}:alone")
    with pytest.raises(CraneError, match=r"failing failed: ValueError .*: no solution"):
        open_controller(f"{program}:failing").make(CRANE, motion)
    with pytest.raises(OutOfRange, match="nothing is NoneType; allowed is a controller, or a pair"):
        open_controller(f"{program}:nothing").make(CRANE, motion)
    with pytest.raises(
        OutOfRange, match="speeds is 'speed'; allowed is one of effort, motion, vel"
    ):
        open_controller(f"{program}:speeds").make(CRANE, motion)
    program.write_text("raise SystemExit(3)")
    with pytest.raises(DataError, match="cannot be run: SystemExit: 3"):
        open_controller(f"{program}:rates")


def test_names_tell_files_from_the_controllers_of_exporters() -> None:
    assert all(map(is_controller_file, ["a/b.py:f", "a.py", "k.json", "k.mat"]))
    assert not any(map(is_controller_file, ["lqr", "hold", "k.csv", "module:f"]))


def test_two_controllers_of_one_name_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    first = written(tmp_path, NOTCH)
    second = written(tmp_path / "other", NOTCH)
    assert [*controllers_by_name([first])] == ["notch"]
    with pytest.raises(DataError, match="are both called notch; rename one"):
        controllers_by_name([first, second])


@pytest.mark.slow
def test_an_exporter_writes_a_gain_from_a_file_as_the_same_block(tmp_path: Path) -> None:
    regulator, _ = usual_controller("lqr", CRANE, PERIOD)
    content = {"D": (-regulator.gain[0]).tolist(), "inputs": state_names(CRANE)}
    file = written(tmp_path, {**content, "outputs": EFFORTS}, "gain.json")
    by_name = export(CRANE, tmp_path / "by_name.st", regulator).read_text().splitlines()
    target = tmp_path / "own.st"
    words = ["--controller", file, "--gravity", str(CRANE.gravity)]
    assert main(["export", "st", str(target), *words]) == 0
    # The first line names the class of the controller.
    assert target.read_text().splitlines()[1:] == by_name[1:]


@pytest.mark.slow
def test_an_exporter_writes_a_system_with_states_from_a_file(tmp_path: Path) -> None:
    target = tmp_path / "notch.st"
    words = ["--controller", written(tmp_path, NOTCH), "--gravity", str(CRANE.gravity)]
    assert main(["export", "st", str(target), *words]) == 0
    text = target.read_text()
    assert "x_set : LREAL" in text and "F_l_command : LREAL" in text


def test_an_exporter_refuses_a_controller_of_other_drives_than_asked_for(tmp_path: Path) -> None:
    own = open_controller(written(tmp_path, NOTCH))
    options = argparse.Namespace(controller=own, drive="velocity")
    with pytest.raises(DataError, match="commands drives of the mode effort, and --drive asks"):
        controller_from_options(options, CRANE, PERIOD)


def test_the_files_of_the_how_to_are_controllers(tmp_path: Path) -> None:
    file = ROOT / "docs/howto/compare_controllers.md"
    page = file.read_text(encoding="utf-8")
    (matrices,) = re.findall(r"^```json\n(.*?)^```", page, re.S | re.M)
    (tmp_path / "filtered.json").write_text(matrices, encoding="utf-8")
    own = open_controller(str(tmp_path / "filtered.json"))
    controller, drive = own.make(CRANE, rest_at_start(CRANE, PERIOD))
    assert drive == "effort"
    setpoint = Setpoint(CRANE.start.q[CRANE.layout.drives], np.zeros(3), np.zeros(3))
    command = controller(0.0, CRANE.state(x=CRANE.start.q[1] + 0.1), setpoint)
    holding = holding_effort(CRANE, CRANE.start.q)
    np.testing.assert_allclose(command - holding, [0.0, -400.0, 0.0], atol=1e-9)

    function = next(script for script in scripts(file) if "def softly" in script)
    (tmp_path / "mine.py").write_text(function, encoding="utf-8")
    made = open_controller(f"{tmp_path}/mine.py:softly").make(CRANE, rest_at_start(CRANE, PERIOD))
    assert isinstance(made.controller, Tracking)
