"""The page in which one drives: its crane moves as `simulate` moves it, in Node and in Chromium."""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest
import trimesh
from scipy.interpolate import RegularGridInterpolator

import cranedyn as cd
from cranedyn.__main__ import main
from cranedyn.compiled import webassembly
from cranedyn.controllers import LinearController, linear_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.data.trajectory import read as read_trajectory
from cranedyn.disturbances.wind import steady, wind
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import CraneError, DataError
from cranedyn.export import browser_crane, driving_page, exercises
from cranedyn.identification.checked_record import load_record
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.lifts.judging.chart import CHARTS, RatedLoads, read_chart
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.lifts.planning.solids import box, hull
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO, describe
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.references.simple import hold
from tests.helpers import HOSTILE_NAMES, ROOT
from tests.portal import portal_crane

NODE = shutil.which("node")
PERIOD = driving_page.PERIOD
pytestmark = pytest.mark.skipif(NODE is None, reason="Node is not installed")

ITINERARY = [
    (100, [0.5, 0.0, 0.0]),
    (700, [0.5, 0.6, 0.0]),
    (2000, [0.0, 0.6, -0.3]),
    (3000, [0.0, 0.0, -0.3]),
    (4000, [-0.4, -0.3, 0.2]),
    (6000, [0.0, 0.0, 0.0]),
]
"""Sticks from a control instant on: slew, trolley and hoist together and alone, then a rest."""

INPUTS = [[k, "sticks", sticks] for k, sticks in ITINERARY]


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_a_name_is_data_of_the_page_whatever_it_contains(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driving_page, "page_data", lambda *_: {"title": name})
    text = driving_page.page_html(load_crane())
    scripts = re.findall(r"<script([^>]*)>(.*?)</script>", text, re.DOTALL)
    (data,) = [body for head, body in scripts if 'id="data"' in head]
    assert json.loads(data) == {"title": name}
    monkeypatch.setattr(driving_page, "page_data", lambda *_: {"title": "a"})
    plain = re.findall(
        r"<script([^>]*)>(.*?)</script>", driving_page.page_html(load_crane()), re.DOTALL
    )
    assert [s for s in scripts if 'id="data"' not in s[0]] == [
        s for s in plain if 'id="data"' not in s[0]
    ]


def script() -> str:
    """The program of the page's worker, without the worker itself, and the test's own."""
    parts = ("kinematics", "kernel", "assist", "run")
    texts = [(driving_page._TEMPLATES / f"{name}.js").read_text("utf-8") for name in parts]
    return "\n".join([*texts, Path(__file__).with_name("drive_page.js").read_text("utf-8")])


@cache
def data_of(kind: str) -> dict[str, Any]:
    """The page's data of a crane, with the exercise that needs no plan."""
    with pytest.MonkeyPatch.context() as patch:
        first = exercises.exercises
        patch.setattr(driving_page, "exercises", lambda *of: itertools.islice(first(*of), 1))
        return driving_page.page_data(crane_of(kind))


@cache
def planned() -> dict[str, Any]:
    """The data of the tower crane with all exercises."""
    crane = crane_of("tower")
    tasks = driving_page._tasks(
        driving_page._exercises(crane, converters(crane), None), np.eye(3), np.zeros(3)
    )
    return data_of("tower") | {"tasks": list(tasks)}


@cache
def crane_of(kind: str) -> Crane:
    return {
        "tower": load_crane,
        "hook": lambda: load_crane(hook_mass=150.0),
        "elastic": lambda: load_crane(rope_stiffness=2e6, rope_damping=5e3),
        "overhead": lambda: load_crane("urdf/overhead_crane.urdf.xacro"),
        "luffing": lambda: load_crane("urdf/luffing_crane.urdf.xacro"),
    }[kind]()


def in_node(data: dict[str, Any], *requests: dict[str, Any]) -> list[dict[str, Any]]:
    """Drive in Node."""
    program = (
        f"{script()}\nconst [data, requests] = JSON.parse(require('fs').readFileSync(0));\n"
        "drive(data, requests).then(done => console.log(JSON.stringify(done)));"
    )
    done = subprocess.run(
        [NODE or "", "-e", program],
        input=json.dumps([data, requests]).replace("Infinity", "1e999"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


class Operator:
    """The sticks of `ITINERARY` with an assistance, by the numbers that the page has."""

    def __init__(self, crane: Crane, data: dict[str, Any], name: str) -> None:
        self.crane = crane
        self.assist = data["assist"]
        self.name = name
        self.drives = crane.layout.drives
        self.past = list[np.ndarray]()
        self.rate = np.zeros(len(self.drives))
        self.position = crane.start.q[self.drives]
        self.law = own_law(crane) if name == "own" else None
        self.calls = 0
        self.accelerations = np.array(self.assist["accelerations"])
        if table := self.assist.get("lqr"):
            rows = len(table["radii"]), len(table["lengths"]), len(self.drives), -1
            gains = np.array(table["gains"]).reshape(rows)
            radii = table["radii"] if rows[0] > 1 else [0.0, 1.0]
            gains = gains if rows[0] > 1 else np.repeat(gains, 2, axis=0)
            self.gains = RegularGridInterpolator((radii, table["lengths"]), gains)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Rates of the drives."""
        k = round(t / PERIOD)
        sticks = next((s for first, s in reversed(ITINERARY) if k >= first), [0.0] * 3)
        asked = self.stoppable(np.array(sticks) * self.assist["rates"], state.q)
        return getattr(self, self.name)(asked, state) if self.name != "none" else asked

    def stoppable(self, rates: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Rates from which a drive comes to rest within its range, by v² / (2 a) + v τ."""
        a = self.accelerations
        delay = np.array(self.assist["reaction"])
        low = self.crane.lower[self.drives]
        high = self.crane.upper[self.drives]
        at = q[self.drives]

        def within(way: np.ndarray) -> np.ndarray:
            way = np.clip(way, 0.0, None)
            return a * (np.sqrt(delay**2 + 2.0 * way / a) - delay)

        return np.clip(rates, -within(at - low), within(high - at))

    def ramp(self, asked: np.ndarray) -> None:
        """Let the rates follow within the accelerations."""
        step = self.accelerations * PERIOD
        self.rate = self.rate + np.clip(asked - self.rate, -step, step)

    def shaped(self, asked: np.ndarray, state: State) -> np.ndarray:
        """Half at once and half after half a period."""
        self.ramp(asked)
        self.past.append(self.rate)
        table = self.assist["swing"]
        hoist = self.assist["hoist"]
        period = np.interp(state.q[self.drives[hoist]], table["lengths"], table["periods"])
        late = len(self.past) - 1 - math.floor(0.5 * period / PERIOD + 0.5)
        half = 0.5 * (self.rate + (self.past[late] if late >= 0 else 0.0))
        half[hoist] = asked[hoist]
        return self.stoppable(half, state.q)

    def yielding(self, asked: np.ndarray, state: State) -> np.ndarray:
        """Slew and trolley give way."""
        _, x, phi, theta, length = state.q
        gain = 2.0 * browser_crane.YIELDING_DAMPING_RATIO * math.sqrt(self.crane.gravity * length)
        return self.stoppable(asked - gain * np.array([theta / x, phi, 0.0]), state.q)

    def own(self, asked: np.ndarray, state: State) -> np.ndarray:
        """The law of `own_law`."""
        self.ramp(asked)
        self.position = self.position + self.rate * PERIOD
        still = np.zeros(len(self.drives))
        self.calls += 1
        setpoint = Setpoint(self.position, still, still)
        return self.stoppable(self.law(self.calls * PERIOD, state, setpoint), state.q)

    def lqr(self, asked: np.ndarray, state: State) -> np.ndarray:
        """Feedback of the whole state."""
        self.ramp(asked)
        self.position = self.position + self.rate * PERIOD
        goal = np.concatenate([self.assist["lqr"]["rest"], np.zeros(len(state.q))])
        goal[self.drives] = self.position
        goal[len(state.q) + self.drives] = self.rate
        table = self.assist["lqr"]
        where = [0.0 if table[name] < 0 else state.q[table[name]] for name in ("x", "l")]
        gain = self.gains(where)[0]
        return self.stoppable(self.rate - gain @ (np.concatenate(state) - goal), state.q)


@cache
def in_python(kind: str, name: str, periods: int) -> Trajectory:
    """The same drive by `simulate`."""
    crane = crane_of(kind)
    data = data_of(kind)
    controller: Controller = Operator(crane, data, name)
    reference = None
    if name == "predictive":
        controller = browser_crane.goal_controller(crane, converters(crane))
        reference = hold(crane, crane.state(**GOAL))
    return cd.simulate(
        crane,
        controller,
        reference,
        start=crane.start,
        duration=periods * PERIOD,
        drive="velocity",
        engine="compiled",
        validity="mark",
    )


GOAL = {"gamma": 1.0, "x": 15.0, "l": 10.0}
ASSISTANCES = ["none", "shaped", "yielding", "lqr", "predictive"]


def request(name: str, instants: int, *, rows: bool = False) -> dict[str, Any]:
    inputs = [[0, "assist", name], *INPUTS]
    if name == "predictive":
        inputs = [[0, "assist", name], [0, "goal", list(GOAL.values())]]
    return {"inputs": inputs, "instants": instants, "rows": rows}


def check_same(done: dict[str, Any], run: Trajectory, tolerance: float, row: int = -1) -> None:
    """Check that a drive ends where a run is in a row."""
    assert done["event"] is None
    np.testing.assert_allclose(done["q"], run.q[row], rtol=0, atol=tolerance)
    np.testing.assert_allclose(done["v"], run.v[row], rtol=0, atol=tolerance)


def check_itinerary(drive: Callable[..., list[dict[str, Any]]], *instants: int) -> None:
    """Check the way under each assistance, as one drives it somewhere, against `simulate`, at
    control instants of which the first is early.
    """
    # Both engines run the same trace; what differs is how sums are rounded, some 1e-15 a second.
    data = data_of("tower")
    assert [entry["name"] for entry in data["assistances"]] == ASSISTANCES
    requests = [request(name, n) for name in ASSISTANCES for n in instants]
    done = iter(drive(data, *requests))
    for name in ASSISTANCES:
        run = in_python("tower", name, instants[-1])
        assert np.abs(run.v).max() > 0.1  # it was driven
        check_same(next(done), run, 1e-12, instants[0])
        for row in instants[1:]:
            check_same(next(done), run, 1e-9, row)


@pytest.mark.slow
def test_every_assistance_moves_the_crane_as_simulate_does() -> None:
    check_itinerary(in_node, 1000, 7000)


def own_law(crane: Crane, **how: Any) -> LinearController:
    """Proportional and integral control of the trolley, which follows the load behind a low-pass;
    slew and hoist are held. It begins with an integral beyond the rate of the trolley.
    """
    a = np.diag([1.0, 0.95])
    b = np.array([[-PERIOD, 0.0], [0.0, 0.05]])
    by_state = np.array([[0.2, -4.0]])
    direct = np.array([[-2.0, 0.0]])
    given: Any = {"drive": "velocity", "setpoint": "run", "period": PERIOD, "initial": [12.0, 0.0]}
    given |= how
    name = "F_x" if given["drive"] == "effort" else "x_dot_command"
    return linear_controller(
        crane, a, b, by_state, direct, about=crane.start, inputs=["x", "phi"], outputs=[name],
        **given,
    )  # fmt: skip


@pytest.mark.slow
def test_a_controller_of_ones_own_moves_the_crane_of_a_page_as_simulate_does() -> None:
    crane = crane_of("tower")
    own = browser_crane.own_data(crane, converters(crane), own_law(crane))
    data = data_of("tower")
    data = data | {
        "assist": data["assist"] | {"own": own},
        "assistances": browser_crane.assistances(crane, has_own=True),
    }
    (done,) = in_node(data, request("own", 3000))
    run = in_python("tower", "own", 3000)
    check_same(done, run, 1e-9)
    assert np.abs(run.v[:, 1]).max() > 0.3


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"setpoint": "rest"}, "so that the sticks have no effect"),
        ({"drive": "effort"}, "has other limits than the rates of the usual converters"),
        ({"period": 1e-2}, "allowed is that of the controller, 0.01"),
    ],
)
def test_a_controller_that_a_page_cannot_run_is_refused_before_anything_is_compiled(
    how: dict[str, Any], sentence: str, tmp_path: Path
) -> None:
    crane = crane_of("tower")
    with pytest.raises(CraneError, match=sentence):
        driving_page.export(tmp_path / "own.html", crane, controller=own_law(crane, **how))
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_every_assistance_moves_the_crane_as_simulate_does_for_a_minute() -> None:
    check_itinerary(in_node, 1000, 9500, 12000)


@pytest.mark.long
def test_simd_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    crane = crane_of("tower")
    data = data_of("tower")
    drives = converters(crane)
    code = partial(webassembly.webassembly, simd=False)
    monkeypatch.setattr(webassembly, "webassembly", code)
    scalar = browser_crane.kernel_data(crane, drives, browser_crane.variations(crane, drives))
    assert scalar["horizon"]["module"] != data["kernel"]["horizon"]["module"]
    requests = [request(name, 2000) for name in ASSISTANCES]
    ends = [
        [(end["q"], end["v"]) for end in in_node(data | {"kernel": kernel}, *requests)]
        for kernel in (data["kernel"], data["kernel"] | scalar)
    ]
    assert ends[0] == ends[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("elastic", ["none", "lqr"]),
        pytest.param("overhead", ["none", "shaped", "lqr"], marks=pytest.mark.long),
        pytest.param("hook", ["none", "shaped", "lqr", "predictive"], marks=pytest.mark.long),
    ],
)
def test_other_cranes_move_as_simulate_moves_them(kind: str, names: list[str]) -> None:
    done = in_node(data_of(kind), *(request(name, 1000) for name in names))
    for name, end in zip(names, done, strict=True):
        check_same(end, in_python(kind, name, 1000), 1e-12)


@pytest.mark.slow
def test_the_swing_of_a_luffing_crane_is_that_from_plumb_wherever_its_boom_stands() -> None:
    # The angle of its rope is measured from the boom, which stands at 69° at the start.
    crane = crane_of("luffing")
    still = {"inputs": [], "instants": 1}
    lowered = {"inputs": [[0, "sticks", [0.0, -1.0, 0.0]]], "instants": 3000}
    at_start, later = in_node(data_of("luffing"), still, lowered)
    assert at_start["swing"] == pytest.approx(0.0, abs=1e-12)
    plumb = np.linalg.norm(crane.swing_angles(np.array(later["q"])))
    assert later["swing"] == pytest.approx(plumb, abs=1e-12)
    assert 0.0 < plumb < math.radians(10.0) and later["event"] is None


@pytest.mark.slow
def test_feedback_of_the_state_moves_the_rest_of_the_swing_with_the_boom() -> None:
    crane = crane_of("luffing")
    pushed = [[0, "assist", "lqr"], [0, "sticks", [0.0, -1.0, 0.0]], [2000, "sticks", [0.0] * 3]]
    (done,) = in_node(data_of("luffing"), {"inputs": pushed, "instants": 8000})
    lowered = crane.start.q[1] - done["q"][1]
    assert lowered > 0.1
    # With the rest of the start the controller would hold the load aside with the hoist, by metres.
    assert done["q"][4] == pytest.approx(crane.start.q[4], abs=0.2)
    assert done["swing"] < math.radians(2.0)


@pytest.mark.slow
def test_a_shaped_push_leaves_little_swing() -> None:
    # A push and its end three seconds later, while the second half of the push begins.
    inputs = [[0, "sticks", [0.0, 1.0, 0.0]], [600, "sticks", [0.0, 0.0, 0.0]]]
    shaped, plain = in_node(
        data_of("tower"),
        *(
            {"inputs": [[0, "assist", name], *inputs], "instants": 4000, "rows": True}
            for name in ("shaped", "none")
        ),
    )
    swing = [np.abs(np.array(done["rows"])[3000:, 3]).max() for done in (shaped, plain)]
    assert swing[0] < 0.03 * swing[1]  # what the jerk limit and the delay in whole periods leave


@pytest.mark.slow
def test_sliders_change_the_crane_as_its_arguments_do() -> None:
    data = data_of("tower")
    crane = load_crane(payload_mass=2500.0, damp_swing=400.0)
    inputs = [
        [0, "slider", ["payload_mass", 2500.0]],
        [0, "slider", ["damping", 400.0]],
        [0, "slider", ["wind_speed", 15.0]],
        [0, "slider", ["wind_direction", 30.0]],
        *INPUTS,
    ]
    # The page scales the inertia of the load with its mass; the argument alone leaves it.
    inertia = {"payload_inertia": 2.5 * float(crane_of("tower").payload_inertia[0, 0])}
    crane = load_crane(payload_mass=2500.0, damp_swing=400.0, **inertia)
    wide, deep, tall = np.ptp(data["crane"]["load"], axis=0)
    area = driving_page.DRAG * 0.5 * (wide + deep) * tall
    done = in_node(data, {"inputs": inputs, "instants": 1000, "rows": True})[0]
    run = cd.simulate(
        crane,
        Operator(crane, data, "none"),
        duration=1000 * PERIOD,
        drive="velocity",
        engine="compiled",
        validity="mark",
        disturbance=wind(crane, steady(15.0), direction=math.radians(30.0), payload_area=area),
    )
    check_same(done, run, 1e-9)  # the numbers are those of the lighter crane plus a difference


@pytest.mark.slow
def test_what_was_driven_is_a_run_with_our_columns(tmp_path: Path) -> None:
    data = data_of("tower")
    done = in_node(data, request("none", 4000, rows=True))[0]
    columns = [name for names in data["crane"]["columns"].values() for name in names]
    run = in_python("tower", "none", 4000)
    rows = np.array(done["rows"])
    for column, values in zip(columns, rows.T, strict=True):
        if "setpoint" in column:  # nobody gave the run in Python one
            continue
        scale = max(1.0, float(np.abs(run[column]).max()))
        np.testing.assert_allclose(values, run[column][:4000], rtol=0, atol=1e-9 * scale)
    # The setpoint is what the ramps ask for: behind it a drive is by its lag.
    late = converters(crane_of("tower")).lags * rows[-1, 6 + crane_of("tower").layout.drives]
    at = columns.index("gamma_setpoint_rad")
    behind = rows[-1, at : at + 3] - rows[-1, 1 + crane_of("tower").layout.drives]
    np.testing.assert_allclose(behind, late, rtol=0, atol=1e-3)
    file = tmp_path / "drive.csv"
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in done["rows"])]
    file.write_text("\n".join(lines) + "\n")
    read = read_trajectory(file)
    np.testing.assert_array_equal(read.q, rows[:, 1:6])
    again = load_crane(from_record={"crane": data["crane"]["record"]})
    assert again.payload_mass == crane_of("tower").payload_mass
    record = load_record(file, again)
    assert len(record.t) > 100


IMPOSSIBLE: list[list[Any]] = [
    *(["sticks", [x, 0.0, 0.0]] for x in (math.inf, -math.inf, 1e308, 1.5, None, "1")),
    *(["sticks", value] for value in ([0.0, 0.0], None, "000", {"length": 3})),
    *(["goal", [0.0, x, 10.0]] for x in (math.inf, 1e308, None, [10.0])),
    *(["slider", [name, 1.0]] for name in ("mass", "__proto__", None)),
    *(["slider", ["payload_mass", x]] for x in (0.0, -1.0, math.inf, 1e308, None, "900")),
    *([["assist", "full"], ["assist", None], ["task", "none"], ["stop", 1], ["fly", True]]),
    *([["__proto__", True], ["constructor", True], [None, None]]),
]
"""Inputs of a file to show again that no operator can have given."""


@pytest.mark.slow
def test_an_impossible_input_ends_a_drive_before_it_reaches_the_crane() -> None:
    inputs = [[[0, "sticks", [0.0, 0.5, 0.0]], [50, *wrong]] for wrong in IMPOSSIBLE]
    plain, *done = in_node(
        data_of("tower"),
        {"inputs": inputs[0][:1], "instants": 50},
        *({"inputs": each, "instants": 100} for each in inputs),
    )
    for (kind, _), end in zip(IMPOSSIBLE, done, strict=True):
        name = "null" if kind is None else kind
        assert end["event"].startswith(f"The input {name} is impossible: "), end["event"]
        assert (end["k"], end["q"], end["v"]) == (50, plain["q"], plain["v"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", "shaped", "yielding", "lqr", "predictive"])
def test_no_state_makes_an_assistance_command_what_is_no_number(name: str) -> None:
    # The state is put into the kernel, past all checks: readings that no crane has.
    hostile = [math.inf, -math.inf, "NaN", 1e308, -1e308, 1e155, 5e-324, -0.0, -0.5, 0.0]
    program = (
        f"{script()}\nconst [data, hostile, name] = JSON.parse(require('fs').readFileSync(0));\n"
        "compile(data.kernel).then(code => console.log(JSON.stringify(hostile.flatMap(value => {\n"
        "  const n = data.crane.joints.length;\n"
        "  return [...Array(2 * n).keys()].map(i => {\n"
        "    const run = new Run(data, code);\n"
        "    run.input('assist', name);\n"
        "    run.advance();\n"
        "    (i < n ? run.kernel.q : run.kernel.v)[i % n] = Number(value);\n"
        "    run.advance();\n"
        "    return [...run.kernel.command].every(Number.isFinite);\n"
        "  });\n}))));"
    )
    done = subprocess.run(
        [NODE or "", "-e", program],
        input=json.dumps([data_of("tower"), hostile, name]).replace("Infinity", "1e999"),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    finite = json.loads(done.stdout)
    assert len(finite) == 100 and all(finite)


@pytest.mark.slow
def test_a_drive_replays_to_the_same_bits() -> None:
    data = data_of("tower")
    first, second = in_node(data, request("lqr", 5000), request("lqr", 5000))
    assert (first["q"], first["v"]) == (second["q"], second["v"])


REFUSED = [
    (None, "The file has no list of inputs."),
    ("text", "The file has no list of inputs."),
    ({"length": 1}, "The file has no list of inputs."),
    ([None], "Input 1 of the file is null; allowed is [instant, kind, value]."),
    ([5], "Input 1 of the file is 5; allowed is [instant, kind, value]."),
    ([[0, "stop", True], "stop"], 'Input 2 of the file is "stop"; allowed is'),
    ([[0, "stop"]], 'Input 1 of the file is [0,"stop"]; allowed is'),
    ([[-1, "stop", True]], 'The instant of input 1 of the file, [-1,"stop",true], is not a whole'),
    ([[0.5, "stop", True]], "The instant of input 1 of the file, [0.5,"),
    ([["0", "stop", True]], 'The instant of input 1 of the file, ["0",'),
    ([[9, "stop", True], [8, "stop", False]], "is not a whole number from 9 on."),
    ([[0, "constructor", 1]], "Input 1 of the file: The input constructor is impossible: 1."),
    ([[0, ["stop"], True]], "Input 1 of the file: The input stop is impossible: true."),
    ([[0, "sticks", [0, 1]]], "Input 1 of the file: The input sticks is impossible: [0,1]."),
    ([[0, "sticks", [0, 1, None]]], "The input sticks is impossible: [0,1,null]."),
    ([[0, "slider", ["wind_speed", 1e9]]], "The input slider is impossible"),
    ([[0, "assist", "nobody"]], 'The input assist is impossible: "nobody".'),
]
"""What files of a drive hold that are refused as a whole, and why."""


@pytest.mark.slow
def test_a_file_that_holds_no_inputs_of_a_drive_is_refused_as_a_whole() -> None:
    files = [{"file": content} for content, _ in REFUSED]
    fine = [[0, "assist", "lqr"], [0, "sticks", [0, 1, 0]], [7, "stop", True]]
    *refusals, accepted, empty = in_node(data_of("tower"), *files, {"file": fine}, {"file": []})
    assert accepted is None and empty is None
    for (content, words), refusal in zip(REFUSED, refusals, strict=True):
        assert words in refusal, content


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", "shaped", "yielding", "lqr"])
def test_a_drive_stops_before_the_end_of_its_range_by_any_ramp(name: str) -> None:
    full = [[0, "assist", name], [0, "sticks", [0, 1, 1]], [6000, "sticks", [0, -1, -1]]]
    ramps = [[0, "slider", ["ramp", percent]] for percent in (25.0, 100.0, 200.0)]
    crane = crane_of("tower")
    requests = [{"inputs": [ramp, *full], "instants": n} for ramp in ramps for n in (6000, 12000)]
    for done, at_end in zip(in_node(data_of("tower"), *requests), [True, False] * 3, strict=True):
        assert done["event"] is None
        way = crane.upper[1] - done["q"][1] if at_end else done["q"][1] - crane.lower[1]
        assert 0.0 < way < 0.2


@pytest.mark.slow
def test_predictive_control_keeps_to_the_ramps_and_to_the_ranges_of_the_drives() -> None:
    goals = [1.2, 2.0, 3.4], [-2.0, 2.0, 40.0], [1.0, 15.0, 10.0]  # two of them beyond an end
    start = [0, "assist", "predictive"]
    requests = [
        {"inputs": [start, [0, "slider", ["ramp", ramp]], [0, "goal", goal]], "instants": 12000}
        for ramp in (25.0, 200.0)
        for goal in goals
    ]
    crane = crane_of("tower")
    drives = crane.layout.drives
    margin = 0.02 * (crane.upper - crane.lower)
    inside = crane.lower + margin, crane.upper - margin
    for done, goal in zip(in_node(data_of("tower"), *requests), 2 * goals, strict=True):
        assert (done["event"], done["assist"]) == (None, "predictive")
        reached = np.clip(goal, *(bound[drives] for bound in inside))
        np.testing.assert_allclose(np.array(done["q"])[drives], reached, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ASSISTANCES)
def test_the_hoist_goes_to_a_length_until_its_stick_moves(name: str) -> None:
    inputs = [[0, "assist", name], [0, "slider", ["cable", 8.0]]]
    taken = [*inputs, [400, "sticks", [0, 0, 0.1]], [500, "sticks", [0, 0, 0]]]
    there, before = in_node(
        data_of("tower"), *({"inputs": these, "instants": 5000} for these in (inputs, taken))
    )
    assert there["q"][4] == pytest.approx(8.0, abs=0.01)  # LQR comes there slowly
    assert (before["q"][4] > 12.0) == (name != "predictive")  # which drives by its goal alone


@pytest.mark.slow
def test_the_share_of_the_chart_is_that_of_a_report() -> None:
    falls = read_chart(CHARTS / "laboratory.toml").on()
    chart = {"least": falls.least, "radii": falls.radii.tolist(), "rated": falls.rated.tolist()}
    requests = [{"inputs": INPUTS, "instants": n, "rows": True} for n in range(200, 4000, 600)]
    crane = crane_of("tower")
    for done in in_node(data_of("tower") | {"chart": chart}, *requests):
        _, x, *_ = row = done["rows"][-1][1:]
        pull = crane.damping[4] * row[9] - row[18]
        used = pull / crane.gravity / float(falls.at(x))
        assert done["utilisation"] == pytest.approx(used, rel=1e-9)


@pytest.mark.parametrize("heading", [-math.pi / 2.0, 0.0, 0.7, 2.5])
def test_a_site_is_turned_so_that_its_heading_is_where_the_jib_points(heading: float) -> None:
    foot = np.array([3.0, -4.0, 1.5])
    turn, shift = driving_page._site_to_crane(
        replace(read_site("tower"), heading=heading, foot=foot)
    )
    crane = crane_of("tower")
    load = payload_position(crane, crane.start.q)  # at slew 0, 10 m from the axis
    ahead = np.array([10.0 * math.cos(heading), 10.0 * math.sin(heading), load[2]])
    np.testing.assert_allclose(turn @ (foot + ahead) + shift, load, rtol=0, atol=1e-12)


def test_obstacles_of_a_site_are_written_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exercises, "_planned", lambda crane, limits, exercise, site: exercise)
    lift = exercises.lift_exercise(crane_of("tower"), Limits([], []), read_site("tower"))
    (task,) = driving_page._tasks([lift] if lift else [], np.eye(3), np.zeros(3))
    assert (task["parts"], task["solids"]) == (None, None)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("trolley", "event"), [(-1.0, "The load touched inner wall."), (0.0, None)]
)
def test_a_drive_ends_where_the_load_touches_something(trolley: float, event: str | None) -> None:
    inputs = [[0, "task", "gap"], [0, "sticks", [0, trolley, 0]], [1000, "sticks", [1, 0, 0]]]
    done = in_node(planned(), {"inputs": inputs, "instants": 4000})[0]
    assert done["event"] == event


@pytest.mark.slow
def test_an_exercise_is_done_when_the_load_is_still() -> None:
    inputs = [[0, "task", "stop"], [0, "assist", "predictive"]]
    done, swinging = in_node(
        data_of("tower"),
        {"inputs": inputs, "instants": 8000},
        {"inputs": inputs[:1], "instants": 8000},
    )
    assert done["task"]["done"] and done["task"]["time"] < 30.0
    assert not swinging["task"]["done"]
    best = {task["name"]: task["best"] for task in planned()["tasks"]}
    assert best["ring"]["time"] < best["blind"]["time"]


@pytest.mark.parametrize(
    ("roles", "hoist", "order"),
    [
        (["slew", "trolley", "hoist"], 2, [0, 1, 2, -1]),
        (["hoist", "", "trolley"], 0, [1, 2, 0, -1]),
        (["slew", "", "hoist"], 2, [0, 1, 2, -1]),  # a boom that luffs
        (["slew", "", "", "hoist"], 3, [0, 1, 3, 2]),  # and is a telescope
        (["", "", ""], 0, [1, 2, 0, -1]),  # joints with names of their own
        ([""], None, [0, -1, -1, -1]),
    ],
)
def test_each_of_four_drives_has_a_stick_and_the_rope_goes_along_the_right_one(
    roles: list[str], hoist: int | None, order: list[int]
) -> None:
    joints = [{"role": role} for role in roles]
    text = (driving_page._TEMPLATES / "input.js").read_text("utf-8")
    call = f"axesOf({json.dumps(joints)}, {json.dumps(hoist)} ?? undefined)"
    done = subprocess.run(
        [NODE or "", "-e", f"{text}\nconsole.log(JSON.stringify({call}));"],
        capture_output=True,
        check=True,
    )
    assert json.loads(done.stdout) == order


@pytest.mark.slow
def test_each_task_with_a_goal_has_the_score_of_a_plan() -> None:
    with_goal = [task for task in planned()["tasks"] if task["goal"]]
    assert [task["name"] for task in with_goal] == ["ring", "gap", "blind"]
    assert [task["no_best"] for task in with_goal if task["best"] is None] == []


def test_a_task_that_cannot_be_planned_names_the_missing_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "toppra", None)
    crane = crane_of("tower")
    limits = browser_crane.usual_limits(converters(crane))
    _, ring, *_ = exercises.exercises(crane, limits)
    assert ring.best is None and "pip install 'cranedyn[planning]'" in ring.no_best


def test_the_ring_of_a_crane_without_a_planner_is_where_its_drives_can_bring_the_load(
    tmp_path: Path,
) -> None:
    crane = portal_crane(tmp_path)
    stop, ring = exercises.simple_exercises(crane)
    assert stop.goal is None and np.abs(stop.start.q[crane.swings]).min() > 0.05
    # A quarter of the range of 18 m of the cart; 10 m of the bridge, whose range is long.
    height = payload_position(crane, crane.start.q)[2]
    np.testing.assert_allclose(ring.goal, [10.0, 4.5, height], atol=1e-9)


@pytest.mark.slow
def test_a_mesh_is_drawn_in_its_place_with_as_many_triangles_as_a_page_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trimesh.creation.icosphere(subdivisions=6, radius=0.5).export(tmp_path / "ball.stl")
    visual = (
        '<visual><origin xyz="0 0 -3"/><geometry><mesh filename="ball.stl" scale="2 2 2"/>'
        '</geometry></visual><visual><geometry><mesh filename="plate.stl"/></geometry></visual>'
    )
    trimesh.creation.box((1.0, 2.0, 0.5)).export(tmp_path / "plate.stl")
    urdf = tmp_path / "crane.urdf"
    plain = describe(visuals=False)
    urdf.write_text(plain.replace('<link name="hook_link">', f'<link name="hook_link">{visual}'))
    crane = load_crane(urdf)
    visuals = list(driving_page._visuals(crane, None, tmp_path))
    (_, ball_shape, _), (_, plate_shape, _) = visuals
    ball, plate = driving_page._shape_data(crane, visuals)
    assert "of 81932 triangles are drawn, exact to 64 mm" in capsys.readouterr().err
    assert (ball_shape.kind, plate_shape.kind) == ("mesh", "mesh")
    corners = np.reshape(ball["vertices"], (-1, 3))
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 1.0, atol=0.064)
    surface = trimesh.Trimesh(corners, np.reshape(ball["triangles"], (-1, 3)))
    assert surface.volume == pytest.approx(4.0 / 3.0 * math.pi, rel=0.02)
    np.testing.assert_allclose(np.array(ball["translation"]) - plate["translation"], [0, 0, -3])
    with pytest.raises(DataError, match=r"ball\.stl"):
        next(driving_page._visuals(crane, None, tmp_path / "elsewhere"))


@pytest.mark.slow
@pytest.mark.parametrize("upward", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_crane_without_visuals_and_roles_has_a_load_colours_tasks_and_the_force_of_its_rope(
    tmp_path: Path, upward: bool
) -> None:
    crane = portal_crane(tmp_path, upward=upward)
    data = driving_page.page_data(crane)
    (load,) = [shape for shape in data["crane"]["shapes"] if shape["payload"]]
    assert load["kind"] == "box" and load["size"] == [1.0, 1.0, 1.0]
    # Rail with two legs, bridge, cart and pivot; the rope itself is drawn from pivot to load.
    others = [shape["joint"] for shape in data["crane"]["shapes"] if not shape["payload"]]
    assert others == [-1, -1, -1, 0, 1, 2]
    assert len(set(data["colours"].values())) == len(crane.layout.symbols) + 1
    stop, ring = data["tasks"]
    assert (stop["name"], stop["goal"], ring["name"]) == ("stop", None, "ring")
    # Bridge and cart, which move along X and Y, are below the goal, and the rope is as it was.
    bridge, cart, _ = ring["goal"]
    rope = crane.start.q[4]
    still = {"inputs": [[0, "assist", "none"]], "instants": 10, "rows": False}
    driven = [[0, "task", "ring"], [0, "assist", "predictive"], [0, "goal", [bridge, cart, rope]]]
    hanging, landed = in_node(data, still, {"inputs": driven, "instants": 6000})
    assert hanging["tension"] == pytest.approx(2500.0 * crane.gravity, rel=1e-3)
    assert landed["task"]["done"] and landed["task"]["time"] > 5.0
    assert np.linalg.norm(np.array(ring["goal"])[:2] - crane.start.q[:2]) > 5.0


@pytest.mark.slow
def test_contact_is_that_of_coal() -> None:
    rng = np.random.default_rng(1)
    cases = []
    expected = []
    for _ in range(300):
        solid = box("box", rng.uniform(-2, 2, 2).tolist(), (2.0, 3.0, 2.5), -1.0, rng.uniform(0, 3))
        part = next(driving_page._parts(solid))
        load = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.5, 2.0, 3)
        signs = np.vstack([np.eye(3), np.zeros(3), 1.0 - np.vstack([np.eye(3), np.zeros(3)])])
        corners = signs @ load.T + rng.uniform(-3, 3, 3)
        result = coal.DistanceResult()
        bodies = hull(corners), hull(solid.parts[0])
        place = coal.Transform3s.Identity()
        distance = coal.distance(bodies[0], place, bodies[1], place, coal.DistanceRequest(), result)
        if abs(distance) > 1e-6:
            cases.append([corners.tolist(), part])
            expected.append(distance < 0.0)
    program = (
        f"{script()}\nconst cases = JSON.parse(require('fs').readFileSync(0));\n"
        "console.log(JSON.stringify(cases.map(([load, part]) => boxMeets(load, part))));"
    )
    done = subprocess.run(
        [NODE or "", "-e", program],
        input=json.dumps(cases).encode(),
        capture_output=True,
        check=True,
    )
    assert 50 < sum(expected) < 250
    assert json.loads(done.stdout) == expected


def test_the_file_is_small_and_loads_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    data = planned()  # before it is replaced, which would ask for itself
    monkeypatch.setattr(driving_page, "page_data", lambda *_: data)
    file = driving_page.export(tmp_path / "crane.html", crane_of("tower"))
    text = file.read_text("utf-8")
    assert len(text) < 1_000_000
    assert "default-src 'none'" in text
    assert "http://" not in text.replace("http://www.w3.org", "")
    assert "https://" not in text
    with pytest.raises(DataError, match=r"must be \.html"):
        driving_page.export(tmp_path / "crane.htm", crane_of("tower"))


def test_the_page_that_one_drives_stays_alone_below_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = planned()
    monkeypatch.setattr(driving_page, "page_data", lambda *_: data)
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["drive"]) == main(["drive"]) == 0
    assert [file for file in tmp_path.rglob("*") if file.is_file()] == [
        tmp_path / "out/drive/crane.html"
    ]


@pytest.mark.parametrize(
    ("site", "drives"),
    [
        (ROOT / "examples/cranes/gantry.toml", ["gantry", "crab", "rope"]),
        (ROOT / "examples/portal_crane.toml", ["slew", "luff", "l"]),
    ],
    ids=lambda value: value.stem if isinstance(value, Path) else "",
)
def test_the_crane_that_a_site_describes_is_the_one_that_is_driven(
    site: Path,
    drives: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With its file, its driven and its locked joints, and none other beside it."""
    cranes: list[Crane] = []

    def page_data(crane: Crane, *_: object) -> dict[str, Any]:
        cranes.append(crane)
        return {}

    monkeypatch.setattr(driving_page, "page_data", page_data)
    words = ["export", "page", str(tmp_path / "crane.html"), "--site", str(site)]
    assert main(words) == 0
    (driven,) = cranes
    assert [joint.symbol for joint in driven.layout.driven] == drives
    assert f"--urdf {site.with_suffix('.urdf')}" in capsys.readouterr().out
    words[2] = str(tmp_path / "other.html")
    assert main([*words, "--machine", "inteco_3dcrane"]) == 2
    assert "leave --machine out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("falls", "words", "chart"),
    [
        (4, [], "laboratory"),
        (2, ["--chart", "mct88"], "mct88"),
        (2, ["--urdf", str(XACRO)], None),
    ],
)
def test_a_site_is_driven_by_its_own_chart_unless_another_or_another_crane_is_given(
    falls: int, words: list[str], chart: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = f'[ground]\nheight = 0.0\n[crane]\nchart = "laboratory"\n[rigging]\nfalls = {falls}\n'
    (tmp_path / "site.toml").write_text(text, encoding="utf-8")
    charts: list[RatedLoads | None] = []

    def page_data(
        crane: Crane, site: Site | None, chart: RatedLoads | None, *_: object
    ) -> dict[str, Any]:
        charts.append(chart)
        return {}

    monkeypatch.setattr(driving_page, "page_data", page_data)
    page = str(tmp_path / "crane.html")
    assert main(["export", "page", page, "--site", str(tmp_path / "site.toml"), *words]) == 0
    (used,) = charts
    if chart is None:
        assert used is None
    else:
        assert used is not None
        assert used.radii.tolist() == read_chart(chart).on(falls).radii.tolist()
