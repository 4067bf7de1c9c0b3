"""Controllers that exporters offer by name: those with rates as commands move a crane behind
frequency converters.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.converters import converters
from cranedyn.errors import DataError, UnknownName
from cranedyn.export.usual_controllers import (
    CONTROLLERS,
    RATE_CONTROLLERS,
    WITHOUT_RATES,
    usual_controller,
)
from cranedyn.interfaces import Setpoint, State
from cranedyn.references.shaped import Shaped
from cranedyn.simulation.simulate import simulate
from tests.document_numbers import missing
from tests.helpers import FAST, ROOT, crane
from tests.system.test_pages import scripts

CRANE = crane()
DRIVES = CRANE.layout.drives
PERIOD = 5e-3
RAMP_TIME = 10.0
"""Time in which a setpoint of the tests goes from the start to its goal [s]."""


def to_goal(goal: np.ndarray, ramp_time: float) -> Any:
    """The setpoint of the drives on a straight line from the start to a goal."""
    start = CRANE.start.q[DRIVES]
    rates = (goal - start) / ramp_time if ramp_time else np.zeros(3)

    def reference(t: float) -> Setpoint:
        share = min(max(t / ramp_time, 0.0), 1.0) if ramp_time else 1.0
        rate = rates if 0.0 <= t < ramp_time else np.zeros(3)
        return Setpoint(start + share * (goal - start), rate, np.zeros(3))

    return reference


def moved(name: str, goal: np.ndarray, ramp_time: float, start: State | None = None) -> Trajectory:
    """A run of 40 s on frequency converters."""
    controller, drive = usual_controller(name, CRANE, PERIOD, "velocity")
    assert drive == "velocity"
    return simulate(
        CRANE,
        controller,
        to_goal(goal, ramp_time),
        start=start,
        duration=40.0,
        drive="velocity",
        validity="mark",
        engine=FAST,
    )


def swing_after(run: Trajectory, t: float) -> float:
    """The largest swing from a time on [rad]."""
    after = run.since(t)
    return float(np.hypot(after["phi_rad"], after["theta_rad"]).max())


@pytest.mark.slow
@pytest.mark.parametrize("ramp_time", [0.0, RAMP_TIME], ids=["step", "ramp"])
@pytest.mark.parametrize("name", RATE_CONTROLLERS)
def test_drives_that_take_rates_come_to_rest_at_the_setpoint_of_the_loop(
    name: str, ramp_time: float
) -> None:
    goal = CRANE.start.q[DRIVES] + np.array([0.1, 3.0, -1.0])
    run = moved(name, goal, ramp_time)
    # Rates come in 1/16384 of the largest: a slower command does not move a drive. What yields
    # is at rest where the load hangs, and follows what is left of the swing.
    assert np.abs(run.q[-1, DRIVES] - goal).max() < 2e-3
    assert np.abs(run.v[-1, DRIVES]).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lqr", "yielding", "predictive"])
def test_feedback_of_the_swing_by_rates_takes_it_away(name: str) -> None:
    start = CRANE.state(phi=0.1, theta=0.05)
    run = moved(name, CRANE.start.q[DRIVES], 0.0, start)
    # A hundredth of 0.11 rad, and less; without feedback all of it stays.
    assert swing_after(run, 35.0) < 1e-3


@pytest.mark.slow
def test_a_position_loop_never_asks_a_drive_to_brake_harder_than_its_ramp() -> None:
    goal = CRANE.start.q[DRIVES] + np.array([0.5, 10.0, -5.0])
    run = moved("hold", goal, 0.0)
    # From its largest rate on, a drive nears its goal without running past it.
    passed = (run.q[:, DRIVES] - goal) * np.sign(goal - CRANE.start.q[DRIVES])
    assert passed.max() < 1e-2


@pytest.mark.slow
def test_shaped_rates_leave_less_swing_than_the_same_rates_without_a_shaper() -> None:
    goal = CRANE.start.q[DRIVES] + np.array([0.0, 4.0, 0.0])
    left = {name: swing_after(moved(name, goal, RAMP_TIME), 30.0) for name in ("hold", "shaper")}
    assert left["shaper"] < 0.2 * left["hold"]


def test_shaped_rates_are_those_of_the_shaped_reference() -> None:
    controller, _ = usual_controller("shaper", CRANE, PERIOD, "velocity")
    base = to_goal(CRANE.start.q[DRIVES] + np.array([0.1, 2.0, -1.0]), 1.0)
    controller.begin_run(0.0, PERIOD)
    reference = Shaped(base, controller.delays, controller.amplitudes)
    recovery = converters(CRANE).accelerations / converters(CRANE).rates
    for k in range(1200):
        t = k * PERIOD
        found = controller(t, CRANE.start, base(t))
        shaped = reference(t)
        distance = shaped.position - CRANE.start.q[DRIVES]
        # The delay of the second part, 3.88 s, lies between two calls, and so does the end of its
        # ramp: rates are those on the line between the calls before and after.
        is_between = abs(t - 1.0 - controller.delays[1]) < PERIOD
        is_between |= abs(t - controller.delays[1]) < PERIOD
        tolerance = 2.0 if is_between else 1e-9
        assert np.abs(found - shaped.velocity - recovery * distance).max() < tolerance


def test_a_controller_without_rates_says_why() -> None:
    assert {*RATE_CONTROLLERS} | {*WITHOUT_RATES} == {*CONTROLLERS}
    for name, reason in WITHOUT_RATES.items():
        with pytest.raises(DataError, match=f"no {name} with rates as commands: {reason}"):
            usual_controller(name, CRANE, PERIOD, "velocity")
    with pytest.raises(DataError, match="allowed are motion and velocity"):
        usual_controller("yielding", CRANE, PERIOD, "effort")
    with pytest.raises(UnknownName, match="there are hold, lqr"):
        usual_controller("pid", CRANE, PERIOD)


@pytest.mark.long
def test_the_page_says_what_constant_gains_of_the_observer_cost(
    capsys: pytest.CaptureFixture[str],
) -> None:
    page = "docs/howto/controller_code.md"
    (script,) = [script for script in scripts(ROOT / page) if "kalman" in script]
    exec(compile(script, page, "exec", dont_inherit=True), {"__name__": "page"})
    printed = capsys.readouterr().out

    def number(pattern: str) -> float:
        (found,) = re.findall(pattern, printed)
        return float(found)

    rows = []
    for text, t in (("after 1 s", 1.0), ("after 2 s", 2.0), ("after 3 s", 3.0)):
        errors = []
        for name in ("kalman", "observer"):
            error = number(rf"{name} wrong by up to ([\d.]+) mrad after {t} s")
            errors.append(f"{error} mrad")
        rows.append(f"| {text} | {' | '.join(errors)} |")
    left = [number(rf"{name} leaves ([\d.]+) mrad") for name in ("kalman", "observer")]
    rows.append(f"| swing left after 10 s | {left[0]} mrad | {left[1]} mrad |")
    assert missing(rows, page) == []
    # What the page concludes: worse at first, as good from three seconds on.
    assert number(r"observer wrong by up to ([\d.]+) mrad after 1.0 s") > 5.0
    assert number(r"observer wrong by up to ([\d.]+) mrad after 3.0 s") < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("exporter", ["st", "c"])
def test_the_command_line_writes_a_block_whose_outputs_are_rates(
    exporter: str, tmp_path: Any
) -> None:
    target = tmp_path / ("lqr.st" if exporter == "st" else "lqr")
    words = ["--controller", "lqr", "--drive", "velocity"]
    assert main(["export", exporter, str(target), *words]) == 0
    text = (target if exporter == "st" else target / "controller.h").read_text()
    assert "gamma_dot_command" in text and "T_gamma" not in text
