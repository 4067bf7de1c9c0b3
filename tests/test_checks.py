"""Values of a wrong range, shape or size are refused where the API takes them, in one sentence."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest

from cranedyn.analysis import swing as analysis
from cranedyn.checks import finite, number, short_repr, whole
from cranedyn.clocks import clocks, intervals
from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.lqr import riccati
from cranedyn.data.trajectory import QUANTITIES, read
from cranedyn.errors import CraneError, OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.references import Motion, hanging_reference, hold
from cranedyn.references.limits import Limits
from cranedyn.references.shaped import Shaper
from cranedyn.references.simple import Spline
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stepper import Stepper
from tests.helpers import crane
from tests.system.fuzz.api import namespace

C, REST = crane(), crane().start
BRAKE, STILL = hold_controller(C), hold(C, REST)
MOTION = hanging_reference(C, STILL, 0.1)
RUN = simulate(C, BRAKE, duration=0.01)
LIMITS = Limits((0.1, 1.0, 1.0), (0.05, 0.5, 0.5))
T = np.linspace(0.0, 30.0, 600)
FOUR = State(np.zeros(4), np.zeros(4))
OTHER = Motion(0.005, *np.zeros((3, 2, 4)), np.array([0, 1]))

MISTAKES = r"""
run(duration=nan) => duration is nan s; allowed is > 0.
constant_force(crane, payload=(1, 2)) => force on the payload is an array of shape (2,); allowed is
constant_force(crane, payload=1.0) => force on the payload is an array of shape ()
constant_force(crane, trolley=(nan, 0, 0)) => force on the trolley is nan
constant_force(crane, hook=(0, 0, 1)) => There is no point 'hook'; there are payload, trolley
steady(inf) => wind speed is inf
cosine_gust(steady(1), 1.0, at=0.0, lasts=0.0) => duration of the gust is 0
turbulence(steady(1), -0.1, rng, duration=1.0) => turbulence intensity is -0.1
wind(crane, steady(1), direction=0.0, payload_area=-1.0) => drag area of the payload is -1
wind(crane, steady(1), direction=0.0, hook_area=1.0) => There is no drag area 'hook_area'; there are
pulse(crane, still, 'phi', 1.0, at=1.0, width=1.0) => There is no drive 'phi'; there are
ramp(crane, still, 'phi', 1.0, rate=1.0, at=1.0) => There is no drive 'phi'; there are
pulse(crane, still, 'theta', 1.0, at=1.0, width=1.0) => There is no drive 'theta'; there are
ramp(crane, still, 'theta', 1.0, rate=1.0, at=1.0) => There is no drive 'theta'; there are
pulse(crane, still, 'y', 1.0, at=1.0, width=1.0) => There is no drive 'y'; there are
ramp(crane, still, 'y', 1.0, rate=1.0, at=1.0) => There is no drive 'y'; there are
pulse(crane, still, 'x', nan, at=1.0, width=1.0) => pulse amplitude is nan; allowed is a finite
pulse(crane, still, 'x', 1.0, at=inf, width=1.0) => pulse start is inf s; allowed is a finite number
pulse(crane, still, 'x', 1.0, at=1.0, width=0.0) => pulse width is 0.0 s; allowed is > 0
ramp(crane, still, 'x', nan, rate=1.0, at=1.0) => ramp distance is nan; allowed is a finite number
ramp(crane, still, 'x', 1.0, rate=1.0, at=nan) => ramp start is nan s; allowed is a finite number
ramp(crane, still, 'x', 1.0, rate=0.0, at=1.0) => ramp rate is 0.0 rad/s or m/s; allowed is > 0
ramp(crane, still, 'x', 1.0, rate=-1.0, at=1.0) => ramp rate is -1.0 rad/s or m/s; allowed is > 0
run(dt=0.0) => dt is 0.0 s; allowed is > 0
run(dt=-1e-3) => dt is -0.001 s; allowed is > 0
run(dt=nan) => dt is nan s; allowed is > 0
run(dt=3e-4) => control_period is 0.005 s; allowed is a multiple of dt = 0.0003 s
run(dt=1e-2) => control_period is 0.005 s; allowed is a multiple of dt = 0.01 s
run(control_period=0.0) => control_period is 0.0 s; allowed is > 0
run(control_period=inf) => control_period is inf s; allowed is > 0
run(drive='speed') => drive is speed; allowed is effort or motion or velocity
run(validity='ignore') => validity is ignore
run(validity='buffers', drive='motion') => validity is buffers
run(start=(five, nan * five)) => gamma_dot at the start is nan rad/s; allowed is a finite
run(start=(np.zeros(4), five)) => start is a state of 4 coordinates and 5 rates
run(t_start=nan) => time at the start is nan
run(dt=1e-14) => dt is 1e-14 s; allowed is 1e-09 to 1000
run(t_start=1e17) => time at the start is 1e+17 s; allowed is -1e9 to 1e9
run(disturbance=lambda t, state: three) => force of the disturbance is an array of shape (3,)
run(disturbance=lambda t, state: nan * points) => force of the disturbance is
run(duration=0.0) => duration is 0.0 s; allowed is > 0
run(duration=0.1234) => duration is 0.1234 s; allowed is a multiple of control_peri
run(duration=1e-3) => duration is 0.001 s; allowed is a multiple of control_period
run(duration=1e5) => duration is 100000 s; allowed is 3.68e+04 s at most: its 20000001 rows would
run(dt=1e-9, control_period=1e-9, duration=100.0) => dt is 1e-09 s; allowed is 1e-08 or more for a
simulate(crane, lambda *_: 'up', duration=1.0) => command of the controller is no array
run(dt=10**5000) => dt is int that cannot be written out
run(drive=2) => drive is 2; allowed is effort or motion
simulate(crane, law, other, duration=0.1) => reference is a motion of 4 coordinates, the drives [0,
run(start=four) => start is a state of 4 coordinates and 4 rates;
run(integrator='rk4') => integrator is 'rk4'; allowed is an Integrator, such as rk4 of
lqr(crane, still) => motion is Still(...); allowed is a Motion, such as hanging_reference
load_crane(payload=2000) => payload is 2000; allowed is the name of a joint; its mass is
read_site('open_yart') => There is no site 'open_yart'; there are open_yard, city_block
read_crane_site('two_tower') => There is no site 'two_tower'; there are two_towers, four_towers
run(start=endless) => gamma_dot at the start is inf rad/s; allowed
Stepper(crane, start=four) => start is a state of 4 coordinates and 4 rates
simulate_batch(crane, law, start=four, duration=0.1) => coordinates at the start is an array of
optimal(crane, four, start, limits) => start is a state of 4 coordinates and 4 rates; allowed is 5
optimal(crane, start, goal, limits, duration=9.0, begin=other) => begin is a motion of 4 coordinates
optimal(crane, start, goal, limits, duration=1e9) => duration is 1000000000.0 s; allowed is 20000 or
flat(crane, start, four, 9.0) => goal is a state of 4 coordinates
flat(crane, start, goal, 1e15) => duration is 1000000000000000.0 s; allowed is 20000 or less:
use(crane, other, limits) => motion is a motion of 4 coordinates
spline(crane, start, [[0, 12]], [5.0]) => waypoint is [0, 12]; allowed is three numbers: slew,
hanging_reference(crane, still, 1e15) => duration is 1000000000000000.0 s; allowed is 20000
turbulence(steady(1), 0.1, rng, duration=1e15) => duration of the turbulence is 1000000
tour(crane, legs, lambda a, b: flat(crane, a, b, 9.0), dwell=1e12) => dwell is 1000000000000.0 s
tour(crane, legs, lambda a, b: other, dwell=1.0) => motion that was planned is a motion of 4
hold_controller(crane, stiffness=(1, 2)) => stiffness is (1, 2); allowed is three numbers: slew,
hold_controller(crane, gravity=nan) => gravity is nan m/s²; allowed is a finite number.
with_sensor_model(crane, law, rng=rng, delay=10**5000) => delay of the sensors is int that cannot be
Motion(5e-3, rows, rows[1:], rows, drives) => v of a motion is an array of shape (1, 5); allowed is
Tracking(5e-3, rows[:, 2:], np.zeros((2, 3, 9)), rows) => setpoint is an array of shape (2, 5);
Limits((1, 1), (1, 1, 1)) => acceleration limits is (1, 1, 1) per s²; allowed is one number for each
swing_mode(np.eye(3), 5e-3, 2) => loop is an array of shape (3, 3); allowed is one of shape (2 n, 2
sampled(crane, start, dt=1e-3, control_period=1.5e-3) => control_period is 0.0015 s; allowed is a
fit_swing(t, t[:9]) => swing is an array of shape (9,); allowed is one of shape (1200,).
agreement(t, nan * t) => modelled is nan; allowed is finite.
fit_swing(0.0 * t, t) => The times of a record must increase from row to row where a swing is to be
riccati(2.0 * one, 0.0 * one, one[0], one[0]) => There is no linear-quadratic regulator for this
conditions(crane, rows, rows[:1], rows[:, 2]) => v is an array of shape (1, 5); allowed is
trajectory.state(21) => row is 21; allowed is a whole number from -21 to 20.
trajectory.state(0.5) => row is 0.5; allowed is a whole number from -21 to 20.
grid(x=[1.0, 2.0]).rows(0, 3) => last is 3; allowed is 0 to 2.
rigid_period(10.0, -9.81, 1000.0, 1.0) => the answer of rigid_period(10.0, -9.81, 1000.0, 1.0) is
small_swing(t, t, length=9.0, gravity=9.8, **quiet) => swing is an array of shape (1200,); allowed
hold(crane, four) => state is a state of 4 coordinates and 4 rates
lqr(crane, other) => motion is a motion of 4 coordinates, the drives [0, 1]; allowed is one of 5,
crane.state(x=10**5000) => x at the start is int that cannot be written out m; allowed is a number.
crane.state(**{"x\0": 1.0}) => There is no coordinate 'x\x00'
load_crane("a\0b.urdf") => Cannot read a b.urdf:
load_crane(**{"payload\0mass": 1.0}) => There is no argument 'payload\x00mass'
finite("a", [[1, 2]], ("n", 3), unit="m") => a is an array of shape (1, 2); allowed is one of shape
finite("a", [[1, 2], [3]], ("n",)) => a is no array of numbers but list;
finite("a", [1j, 2], ("n",)) => a is no array of numbers but one of complex128;
finite("a", [1, inf], (2,)) => a is inf; allowed is finite.
crane.layout.for_drives("rate", [1, 2, 0], "/s", "> 0") => rate of l is 0 m/s; allowed is > 0.
number("a", [1]) => a is [1]; allowed is a number.
whole("a", 2**64, 0) => a is 18446744073709551616; allowed is a whole number up to 9
whole("a", 2.0, 0) => a is 2.0; allowed is a whole number >= 0.
intervals("a", 1.0, 0.0) => step is 0.0 s; allowed is > 0.
clocks(1.0, 10**5000, 1.0) => dt is int that cannot be written out s
"""
"""Calls, and how the sentence begins with which they are refused."""


@cache
def names() -> dict[str, Any]:
    """Return the names of calls."""
    rest, crane, law = (namespace()[name] for name in ("start", "crane", "law"))
    return namespace() | {
        **dict(finite=finite, number=number, whole=whole, intervals=intervals, clocks=clocks),
        **dict(riccati=riccati, rng=np.random.default_rng(1), one=np.ones((1, 1, 1))),
        "run": partial(simulate, crane, law, **{"duration": 0.1}),
        "four": State(np.zeros(4), np.zeros(4)),
        "endless": State(rest.q, np.full(5, math.inf)),
        "other": Motion(5e-3, *np.zeros((3, 2, 4)), np.array([0, 1])),
        "rows": np.zeros((2, 5)),
        "drives": C.layout.drives,
        "quiet": dict.fromkeys(
            ["length_rate", "x", "x_rate", "x_acceleration", "slew_rate", "slew_acceleration"], 0.0
        ),
    }


@pytest.mark.parametrize("row", MISTAKES.strip().splitlines())
def test_a_value_out_of_range_is_a_sentence_that_says_what_was_given_and_what_is_allowed(
    row: str,
) -> None:
    call, sentence = row.split(" => ")
    with pytest.raises(CraneError, match=f"^{re.escape(sentence)}") as caught:
        eval(call, dict(names()))
    assert str(caught.value).isprintable() and str(caught.value).endswith(".")


def test_lists_and_whole_numbers_are_arrays_of_doubles() -> None:
    lists = Hold(C, [1, 2, 3], [1, 2, 3], [0, 0, 0])  # type: ignore[arg-type]
    assert lists.stiffness.dtype == float
    q, v, a = MOTION.q.tolist(), MOTION.v.astype(int).tolist(), MOTION.a.tolist()
    assert Motion(5e-3, q, v, a, [0, 1, 4]).v.dtype == float  # type: ignore[arg-type]
    assert Shaper([0, 1], [1, 0]).fractions.dtype == float  # type: ignore[arg-type]
    assert Spline([0, 1], [[1, 2], [3, 4]])(0.5).position.tolist() == [2.0, 3.0]  # type: ignore[arg-type]
    rows = 600
    assert analysis.peaks(T.tolist(), np.cos(T).tolist())[0].size > 3  # type: ignore[arg-type]
    assert finite("a", range(rows), ("n",)).dtype == float


def test_values_are_shown_shortly() -> None:
    values = (np.zeros((2, 6)), np.arange(2.0), [1, 2], REST.q.tolist() * 9, "x" * 999)
    assert [len(short_repr(value)) < 60 for value in values] == [True] * 5
    assert short_repr(values[0]) == "array of shape (2, 6)"
    assert repr(BRAKE).startswith("Hold(crane=Crane with") and "\n" not in repr(MOTION)


# --- what goes wrong in a run ---------------------------------------------------------------------


def _from(t0: float, then: Callable[[], Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """A callable of a run that does something else from a time on; it is the first of what it is
    given.
    """
    return lambda t, *more: usual(t, *more) if t < t0 else then()


def _as_monitor(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda row, t, state: function(t, state)


NAN, INF = np.array([0.0, math.nan, 15.0]), np.full(3, math.inf)
BAD_SETPOINTS: list[tuple[Any, str]] = [
    (None, "answer of the reference is None; allowed is a cranedyn.Setpoint: position, velocity"),
    (np.zeros(3), r"answer of the reference is \[0\.0, 0\.0, 0\.0\]"),
    (Setpoint(*np.zeros((3, 2))), r"position of the setpoint is an array of shape \(2,\)"),
    (Setpoint(NAN, np.zeros(3), np.zeros(3)), "position of the setpoint is nan; allowed is finite"),
    (Setpoint(np.zeros(3), INF, np.zeros(3)), "velocity of the setpoint is inf; allowed is finite"),
    (Setpoint("a", "b", "c"), "position of the setpoint is no array of numbers but str"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("answer", "sentence"), BAD_SETPOINTS)
def test_a_setpoint_that_is_none_ends_a_run_that_keeps_its_rows(
    answer: Any, sentence: str, tmp_path: Any
) -> None:
    with pytest.raises(OutOfRange, match=sentence):
        simulate(C, BRAKE, lambda t: answer, duration=0.1)
    with pytest.raises(RunError, match=rf"^At t = 0\.05 s: {sentence}") as caught:
        simulate(C, BRAKE, _from(0.05, lambda: answer, STILL), duration=0.1)
    kept = caught.value.trajectory
    assert kept is not None and len(kept) == 10
    assert len(read(kept.write(tmp_path / "a.parquet"))) == 10


def test_a_setpoint_of_lists_is_three_numbers_as_well() -> None:
    found = simulate(C, BRAKE, lambda t: Setpoint([0, 10, 15], [0] * 3, [0] * 3), duration=0.05)  # type: ignore[arg-type]
    assert np.array_equal(found.q, simulate(C, BRAKE, STILL, duration=0.05).q)


@pytest.mark.parametrize("who", ["controller", "reference", "disturbance", "monitor"])
def test_an_error_of_whoever_a_run_calls_is_its_cause_and_its_rows_are_kept(who: str) -> None:
    usual = {
        "controller": BRAKE,
        "reference": STILL,
        "disturbance": lambda t, state: np.zeros((2, 3)),
        "monitor": lambda t, state: None,
    }
    for first, rows in ((0.0, 0), (0.05, 10)):
        given: dict[str, Any] = {**usual, who: _from(first, lambda: {}["x"], usual[who])}
        given["monitors"] = [_as_monitor(given.pop("monitor"))]
        with pytest.raises(
            RunError,
            match=rf"^At t = {first:g} s: KeyError in <lambda>, line \d+ of test_checks\.py: "
            r"'x'\.$",
        ) as caught:
            simulate(C, **given, duration=0.1)
        assert isinstance(caught.value.__cause__, KeyError)
        kept = caught.value.trajectory
        # A monitor is called after the row is logged.
        assert kept is not None and len(kept) == rows + (who == "monitor")
        assert all(np.isfinite(getattr(kept, name)).all() for name in QUANTITIES)


def test_a_command_of_complex_numbers_is_refused() -> None:
    with pytest.raises(
        OutOfRange, match=r"command of the controller is no array of numbers but one of complex128"
    ):
        simulate(C, lambda t, state, setpoint: np.array([1j, 0, 0]), duration=0.1)


def test_masked_numbers_are_no_numbers(recwarn: pytest.WarningsRecorder) -> None:
    """NumPy makes plain arrays of masked ones by forgetting the mask."""
    hidden = np.ma.masked_array([0.0, 1.0, 2.0], mask=[False, True, False])
    for take in (
        lambda: finite("command", hidden, (3,)),
        lambda: Stepper(crane()).step(hidden),
        lambda: simulate(crane(), lambda *_: hidden, duration=0.01),
    ):
        with pytest.raises(OutOfRange):
            take()
    assert not recwarn.list
    bare = np.ma.masked_array([0.0, 1.0, 2.0], mask=False)
    assert finite("command", bare, (3,)).tolist() == [0.0, 1.0, 2.0]


def test_every_row_of_a_table_of_setpoints_must_be_there_and_finite() -> None:
    class Table:
        def __init__(self, rows: int, columns: int, value: float = 0.0) -> None:
            self.answer = Setpoint(*np.full((3, rows, columns), value))

        def __call__(self, t: float) -> Setpoint:
            return Setpoint(*(part[0] for part in self.answer))

        def at(self, times: np.ndarray) -> Setpoint:
            return self.answer

    assert len(hanging_reference(C, Table(21, 3), 0.1).q) == 21
    for table in (Table(20, 3), Table(22, 3), Table(21, 2), Table(21, 3, math.nan)):
        with pytest.raises(
            OutOfRange, match=r"position of the setpoint is (an array of shape|nan)"
        ):
            hanging_reference(C, table, 0.1)
