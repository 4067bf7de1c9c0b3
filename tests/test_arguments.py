"""Whatever a user of the Python API hands over by mistake is a sentence that says what was given
and what is allowed.
"""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import cranedyn.controllers
import cranedyn.references
from cranedyn import theory
from cranedyn.analysis import prediction
from cranedyn.analysis import swing as analysis
from cranedyn.arguments import checked, described, taken
from cranedyn.arrays import finite
from cranedyn.clocks import clocks, intervals
from cranedyn.compiled.batch import simulate_batch
from cranedyn.controllers import follow, hold_controller, lqr, observed, paper_controller, sensed
from cranedyn.controllers.damped import damped
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.riccati import riccati
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import QUANTITIES, join, read
from cranedyn.disturbances import wind
from cranedyn.dynamics import linearisation as linear
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.validity import events, valid
from cranedyn.errors import CraneError, OutOfRange, RunError, number, whole
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.planning.optimal import optimal
from cranedyn.recording import record
from cranedyn.recording.snapshot import snapshot
from cranedyn.references import (
    JoystickPulse,
    Leg,
    Motion,
    flat,
    hold,
    itinerary,
    operator,
    plumb,
    pulse,
    ramp,
    shaped,
    shortest,
    spline,
    zv,
)
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.shaped import Shaper, shaped_hoisting
from cranedyn.references.spline import Spline
from cranedyn.references.tour import tour
from cranedyn.simulation.simulate import simulate
from cranedyn.simulation.stepper import Stepper
from tests.helpers import crane

C, REST = crane(), crane().start
BRAKE, STILL = hold_controller(C), hold(C, REST)
MOTION = plumb(C, STILL, 0.1)
RUN = simulate(C, BRAKE, duration=0.01)
LIMITS = Limits((0.1, 1.0, 1.0), (0.05, 0.5, 0.5))
T = np.linspace(0.0, 30.0, 600)


# --- each by name ---------------------------------------------------------------------------------


def _short(t: float, state: State) -> np.ndarray:
    return np.zeros(3)


MISTAKES: list[tuple[Callable[[], Any], str]] = [
    (
        lambda: simulate("tower.urdf", BRAKE, duration=0.1),
        "crane is 'tower.urdf'; allowed is a cranedyn.model.crane.Crane.",
    ),
    (
        lambda: simulate(C, BRAKE, duration=0.1, integrator="rk4"),
        "integrator is 'rk4'; allowed is a cranedyn.dynamics.integrators.Integrator.",
    ),
    (
        lambda: simulate(C, BRAKE, np.zeros(3), duration=0.1),
        "reference is an array of shape (3,); allowed is a callable of 1: float or None.",
    ),
    (lambda: simulate(C, BRAKE, duration="0.05"), "duration is '0.05'; allowed is a number."),
    (lambda: simulate(C, BRAKE, duration=0.1, dt=10**5000), "dt is an int; allowed is a number."),
    (
        lambda: simulate(C, _short, duration=0.1),
        "controller is the function _short; allowed is a callable of 3: float, State, Setpoint.",
    ),
    (
        lambda: simulate(C, None, duration=0.1),
        "controller is None; allowed is a callable of 3: float, State, Setpoint.",
    ),
    (
        lambda: simulate(C, BRAKE, duration=0.1, start=[0, 10, 15]),
        "start is [0, 10, 15]; allowed is coordinates and rates",
    ),
    (
        lambda: simulate(C, BRAKE, duration=0.1, drive=2),
        "drive is 2; allowed is effort or motion or velocity.",
    ),
    (
        lambda: simulate(C, BRAKE, duration=0.1, disturbance=lambda t: 1),
        "disturbance is the function <lambda>; allowed is a callable of 2",
    ),
    (
        lambda: spline(C, [0, 10, 15], [[0, 12, 15]], [5.0]),
        "start is [0, 10, 15]; allowed is coordinates and rates, all numbers.",
    ),
    (
        lambda: spline(C, REST, [[0, 12]], [5.0]),
        "waypoint is (0.0, 12.0); allowed is three numbers: slew, trolley, hoist.",
    ),
    (
        lambda: lqr(C, STILL),
        "motion is a Still; allowed is a Motion of all joints, as cranedyn.references.plumb makes "
        "it of a reference.",
    ),
    (
        lambda: flat(C, REST, C.state(x=12), 1e15),
        "duration is 1000000000000000.0 s; allowed is 20000 or less: 4000000 rows",
    ),
    (lambda: plumb(C, STILL, 1e15), "duration is 1000000000000000.0 s; allowed is 20000"),
    (
        lambda: optimal(C, REST, C.state(x=12), LIMITS, duration=1e9),
        "duration is 1000000000.0 s; allowed is 20000 or less",
    ),
    (
        lambda: wind.turbulence(wind.steady(1), 0.1, np.random.default_rng(0), duration=1e15),
        "duration of the turbulence is 1000000",
    ),
    (
        lambda: tour(
            C, [Leg("out", x=12), Leg("in", x=10)], lambda a, b: flat(C, a, b, 9.0), dwell=1e12
        ),
        "dwell is 1000000000000.0 s",
    ),
    (lambda: follow(C, None), "reference is None; allowed is a callable of 1: float."),
    (
        lambda: pulse(C, None, "x", 0.1, at=0.0, width=1.0),
        "base is None; allowed is a callable of 1: float.",
    ),
    (
        lambda: hold_controller(C, stiffness=(1, 2)),
        "stiffness is (1.0, 2.0); allowed is three numbers: slew, trolley, hoist.",
    ),
    (
        lambda: hold_controller(C, gravity=math.nan),
        "gravity is nan m/s²; allowed is a finite number.",
    ),
    (
        lambda: sensed(C, BRAKE, rng=1),
        "rng is 1; allowed is a np.random.Generator, such as np.random.default_rng(1).",
    ),
    (
        lambda: sensed(C, BRAKE, rng=np.random.default_rng(1), delay=10**5000),
        "delay of the sensors is int that cannot be written out",
    ),
    (
        lambda: Motion(
            0.005, np.zeros((2, 5)), np.zeros((3, 5)), np.zeros((2, 5)), C.layout.drives
        ),
        "v of a motion is an array of shape (3, 5); allowed is",
    ),
    (
        lambda: Tracking(0.005, np.zeros((2, 3)), np.zeros((2, 3, 9)), np.zeros((2, 10))),
        "setpoint is an array of shape (2, 10); allowed is one of shape (2, 9).",
    ),
    (
        lambda: Limits((1, 1), (1, 1, 1)),
        "acceleration limits is (1.0, 1.0, 1.0) per s²; allowed is one number for each drive.",
    ),
    (
        lambda: linear.swing_mode(np.eye(3), 0.005, 2),
        "loop is an array of shape (3, 3); allowed is one of shape (2 n, 2 n).",
    ),
    (
        lambda: linear.sampled(C, REST, dt=1e-3, control_period=1.5e-3),
        "control_period is 0.0015 s; allowed is a multiple of dt",
    ),
    (
        lambda: analysis.fit_swing(T, T[:9]),
        "swing is an array of shape (9,); allowed is one of shape (600,).",
    ),
    (lambda: analysis.agreement(T, np.full(600, math.nan)), "modelled is nan; allowed is finite."),
    (
        lambda: riccati(np.ones((1, 1, 1)) * 2.0, np.zeros((1, 1, 1)), np.eye(1), np.eye(1)),
        "There is no linear-quadratic regulator for this crane",
    ),
    (
        lambda: simulate_batch([C, None], BRAKE, start=REST, duration=0.1),
        "crane is a list; allowed is a cranedyn.model.crane.Crane or a",
    ),
    (
        lambda: join([RUN, None]),
        "pieces is a list; allowed is a sequence, each a cranedyn.data.trajectory.Trajectory.",
    ),
    (
        lambda: valid(C, RUN.q, RUN.v[:1], RUN.effort[:, 2]),
        "v is an array of shape (1, 5); allowed is one of shape (3, 5).",
    ),
    (lambda: RUN.state(3), "row is 3; allowed is a whole number from -3 to 2."),
    (lambda: RUN.state(0.5), "row is 0.5; allowed is a whole number from -3 to 2."),
    (lambda: RUN.since("0.05"), "t is '0.05'; allowed is a number."),
    (lambda: RUN.between(0.0, []), "last is []; allowed is a number."),
    (lambda: RUN.write(3), "path is 3; allowed is a text or a pathlib.Path."),
    (lambda: read(b"a.csv"), "path is b'a.csv'; allowed is a text or a pathlib.Path."),
    (lambda: describe(3), "path is 3; allowed is a text or a pathlib.Path."),
    (lambda: describe(values=[1]), "values is [1]; allowed is a mapping, such as a dict or None."),
    (
        lambda: analysis.fit_swing(0.0 * T, T),
        "The times of a record must increase from row to row where a swing is to be fitted.",
    ),
    (lambda: snapshot("a.rrd", "0.05", "a"), "times is '0.05'; allowed is a sequence of numbers."),
    (
        lambda: snapshot("a.rrd", [0.0], "a", size=(200, 200, 200)),
        "size is (200, 200, 200); allowed is 2 of a whole number.",
    ),
    (
        lambda: record("a.rrd", [RUN], title="t"),
        "runs is a list; allowed is a sequence, each a cranedyn.recording.run.Run.",
    ),
    (
        lambda: theory.point_period("a", 9.81),
        "length is 'a'; allowed is a number or an array of numbers.",
    ),
    (
        lambda: theory.rigid_period(10.0, -9.81, 1000.0, 1.0),
        "the answer of rigid_period(10.0, -9.81, 1000.0, 1.0) is not finite; allowed is what has a "
        "finite one.",
    ),
    (
        lambda: hold(C, State(np.zeros(4), np.zeros(4))),
        "state is a state of 4 coordinates; allowed is one of 5: gamma, x, phi, theta, l.",
    ),
    (
        lambda: lqr(
            C, Motion(0.005, np.zeros((2, 4)), np.zeros((2, 4)), np.zeros((2, 4)), np.array([0, 1]))
        ),
        "motion is a motion of 4 coordinates, the drives [0, 1]; allowed is one of 5, the drives "
        "[0, 1, 4].",
    ),
    (lambda: events(C, None), "run is None; allowed is a cranedyn.data.trajectory.Trajectory."),
    (
        lambda: C.state(x=10**5000),
        "x at the start is int that cannot be written out m; allowed is a number.",
    ),
    (lambda: C.state(**{"x\0": 1.0}), "There is no coordinate 'x\\x00'"),
    (lambda: load_crane(3.0), "urdf is 3.0; allowed is a text or a pathlib."),
    (lambda: load_crane("a\0b.urdf"), "Cannot read a b.urdf: "),
    (lambda: load_crane(**{"payload\0mass": 1.0}), "There is no argument 'payload\\x00mass'"),
]


@pytest.mark.parametrize(
    ("mistake", "sentence"), MISTAKES, ids=[sentence[:50] for _, sentence in MISTAKES]
)
def test_a_mistake_is_a_sentence_that_says_what_was_given_and_what_is_allowed(
    mistake: Callable[[], Any], sentence: str
) -> None:
    with pytest.raises(CraneError, match=f"^{re.escape(sentence)}") as caught:
        mistake()
    assert str(caught.value).isprintable() and str(caught.value).endswith(".")


# --- each argument of everything ------------------------------------------------------------------

RIGHT: dict[Callable[..., Any], dict[str, Any]] = {
    simulate: {
        "crane": C,
        "controller": BRAKE,
        "reference": STILL,
        "start": REST,
        "since": 0.0,
        "duration": 0.01,
        "dt": 1e-3,
        "control_period": 5e-3,
        "disturbance": lambda t, state: np.zeros((2, 3)),
        "validity": "stop",
        "integrator": rk4,
        "engine": "pinocchio",
        "progress": lambda t: None,
    },
    wind.constant_force: {"crane": C, "payload": (0, 0, 0), "trolley": (0, 0, 0), "at": 0.0},
    wind.steady: {"speed": 1.0},
    wind.step_gust: {"base": wind.steady(1.0), "rise": 1.0, "at": 0.0},
    wind.cosine_gust: {"base": wind.steady(1.0), "rise": 1.0, "at": 0.0, "lasts": 1.0},
    wind.turbulence: {
        "base": wind.steady(1.0),
        "intensity": 0.1,
        "rng": np.random.default_rng(0),
        "duration": 1.0,
        "step": 0.1,
    },
    wind.wind: {
        "crane": C,
        "speed": wind.steady(1.0),
        "direction": 0.0,
        "payload_area": 1.0,
        "trolley_area": 1.0,
    },
    flat: {
        "crane": C,
        "start": REST,
        "goal": C.state(x=12.0),
        "duration": 10.0,
        "ramp": 2.0,
        "period": 0.1,
    },
    hold: {"crane": C, "state": REST},
    itinerary: {
        "crane": C,
        "start": REST,
        "legs": [Leg("out", x=12.0), Leg("in", x=10.0)],
        "rates": (0.1, 1, 1),
        "dwell": 1.0,
    },
    Limits: {"rates": (1, 1, 1), "accelerations": (1, 1, 1)},
    use: {"crane": C, "motion": MOTION, "limits": LIMITS},
    fastest: {"crane": C, "plan": lambda duration: MOTION, "limits": LIMITS},
    Motion: {"period": 5e-3, "q": MOTION.q, "v": MOTION.v, "a": MOTION.a, "drives": MOTION.drives},
    plumb: {"crane": C, "reference": STILL, "duration": 0.1, "period": 0.005},
    operator: {
        "crane": C,
        "start": REST,
        "pulses": [JoystickPulse("x", 0.5, 0.0, 1.0)],
        "accelerations": (1, 1, 1),
    },
    pulse: {"crane": C, "base": STILL, "drive": "x", "amplitude": 0.1, "at": 0.0, "width": 1.0},
    ramp: {"crane": C, "base": STILL, "drive": "x", "by": 0.1, "rate": 1.0, "at": 1.0},
    zv: {"damping_ratio": 0.0},
    shaped: {"base": STILL, "shaper": zv(), "period": 7.0},
    shaped_hoisting: {"crane": C, "base": STILL, "shaper": zv(), "duration": 1.0, "step": 0.1},
    Shaper: {"fractions": np.array([0, 0.5]), "amplitudes": np.array([0.5, 0.5])},
    spline: {"crane": C, "start": REST, "waypoints": [[0, 12, 15]], "durations": [5.0], "at": 0.0},
    shortest: {
        "crane": C,
        "start": REST,
        "waypoints": [[0, 12, 15]],
        "rates": (1, 1, 1),
        "accelerations": (1, 1, 1),
    },
    Spline: {"times": np.array([0.0, 1.0]), "points": np.zeros((2, 3))},
    tour: {
        "crane": C,
        "legs": [Leg("stay", x=10.0)],
        "plan": lambda start, goal: MOTION,
        "dwell": 1.0,
    },
    damped: {
        "crane": C,
        "reference": STILL,
        "ratio": 0.2,
        "recovery": 0.0,
        "limits": LIMITS,
        "control_period": 5e-3,
    },
    follow: {"crane": C, "reference": STILL, "control_period": 5e-3},
    hold_controller: {"crane": C, "stiffness": (1, 1, 1), "damping": (1, 1, 1), "gravity": 9.8},
    Hold: {"crane": C, "stiffness": np.ones(3), "damping": np.ones(3), "feed_forward": np.zeros(3)},
    Tracking: {
        "period": 5e-3,
        "feed_forward": np.zeros((2, 3)),
        "gain": np.zeros((2, 3, 10)),
        "setpoint": np.zeros((2, 10)),
    },
    lqr: {
        "crane": C,
        "motion": MOTION,
        "dt": 5e-4,
        "state_weight": np.eye(10),
        "effort_weight": np.eye(3),
        "every": 10,
    },
    observed: {
        "controller": BRAKE,
        "crane": C,
        "motion": MOTION,
        "disturbance": np.ones(5),
        "noise": np.ones(6),
        "delay": 0,
        "start": REST,
    },
    paper_controller: {
        "crane": C,
        "motion": MOTION,
        "gravity": 9.81,
        "hoist": (1, 1, 1),
        "every": 10,
    },
    riccati: {
        "a": np.stack([np.eye(2) / 2] * 3),
        "b": np.ones((3, 2, 1)),
        "state_weight": np.eye(2),
        "effort_weight": np.eye(1),
    },
    sensed: {
        "crane": C,
        "controller": BRAKE,
        "delay": 1,
        "noise": np.ones(10),
        "rng": np.random.default_rng(0),
    },
    linear.sampled: {
        "crane": C,
        "state": REST,
        "effort": np.zeros(3),
        "dt": 5e-4,
        "control_period": 5e-3,
    },
    linear.feedback_gain: {"crane": C, "stiffness": np.ones(3), "damping": np.ones(3)},
    linear.swing_mode: {"loop": linear.sampled(C, REST).a, "period": 5e-3, "coordinate": 2},
    prediction.free_swing: {
        "crane": C,
        "hold": BRAKE,
        "reference": STILL,
        "start": REST,
        "since": 1.0,
        "until": 5.0,
    },
    analysis.fit_swing: {"t": T, "swing": np.cos(T)},
    analysis.zero_crossings: {"t": T, "y": np.cos(T)},
    analysis.peaks: {"t": T, "y": np.cos(T)},
    analysis.fit_power_law: {"x": np.arange(1.0, 5.0), "y": np.arange(1.0, 5.0)},
    analysis.agreement: {"measured": np.cos(T), "modelled": np.cos(T)},
    analysis.swing_amplitude: {
        "swing": np.zeros((5, 2)),
        "rates": np.zeros((5, 2)),
        "length": 10.0,
        "gravity": 9.8,
    },
    analysis.settling_time: {"t": T, "distance": np.abs(T), "within": 0.1},
    events: {"crane": C, "run": RUN},
    join: {"pieces": [RUN]},
    C.state: {"x": 10.0, "phi": 0.1, "x_dot": 0.0},
}


class _Stranger:
    def __repr__(self) -> str:
        raise RuntimeError

    __float__ = __str__ = __repr__  # type: ignore[assignment]


WRONG: list[Any] = [
    *(
        None,
        "0.05",
        b"x",
        True,
        -1,
        10**5000,
        1e300,
        5e-324,
        math.nan,
        1j,
        [],
        [1, 2],
        [[1, 2], [3]],
        {},
        object(),
        _Stranger(),
        Hold,
    ),
    *(
        np.zeros(0),
        np.full(3, np.nan),
        np.zeros((2, 5)),
        np.array(["a", "b", "c"]),
        np.array([1j, 2, 3]),
        np.array([None, 1, 2]),
    ),
    *(
        np.array(0.5),
        Decimal("0.5"),
        Fraction(1, 2),
        np.datetime64("2020"),
        range(3),
        "\0",
        "\udcff",
        [None],
        [REST],
        [JoystickPulse("x", None, 0, 0)],
    ),  # type: ignore[arg-type]
    *(
        lambda: 1,
        lambda t: None,
        lambda t: Setpoint(*np.full((3, 3), np.nan)),
        State([1], [2]),
        C,
        REST,
        MOTION,
        STILL,
        RUN,
        [Leg("a", x="b")],
    ),  # type: ignore[arg-type,list-item]
]


@pytest.mark.parametrize("function", RIGHT, ids=lambda function: function.__qualname__)
def test_any_argument_replaced_by_any_thing_is_taken_or_refused_in_a_sentence(
    function: Callable[..., Any],
) -> None:
    function(**RIGHT[function])
    for name in RIGHT[function]:
        for wrong in WRONG:
            try:
                function(**{**RIGHT[function], name: wrong})
            except CraneError as error:
                assert (
                    str(error).isprintable() and str(error).endswith(".") and len(str(error)) < 2100
                )


FACES = [cranedyn.controllers, cranedyn.references, wind, linear, prediction, analysis]
PLAIN = {
    *(
        "tabulated",
        "checked_setpoint",
        "smoothstep",
        "cruise",
        "recover",
        "form",
        "without_integral",
        "at_drives",
        "over_period",
        "kalman_gain",
        "load_lapack",
    ),
    *(
        "stationary",
        "check_finite",
        "trolley_plane",
        "slew_plane",
        "leg_target",
        "place",
        "places",
        "at_place",
        "at_places",
    ),
}
"""What only other functions of the house call, with what they have checked."""


def _public() -> Iterator[tuple[str, Callable[..., Any]]]:
    for face in FACES:
        inside = [
            f"{face.__name__}.{one.name}"
            for one in pkgutil.iter_modules(getattr(face, "__path__", []))
        ]
        for module in map(importlib.import_module, [face.__name__, *inside]):
            for name, value in vars(module).items():
                if (
                    inspect.isfunction(value)
                    and value.__module__ == module.__name__
                    and not name.startswith("_")
                ):
                    yield name, value


def test_every_public_function_holds_its_arguments_against_its_annotations() -> None:
    public = dict(_public())
    assert {
        name for name, function in public.items() if not hasattr(function, "__wrapped__")
    } == PLAIN
    assert len(public) > 40 and all(
        hasattr(function, "__wrapped__") for function in (simulate, simulate_batch, events, join)
    )


def test_what_is_right_arrives_as_what_the_annotation_says() -> None:
    @checked
    def seen(
        number: float, array: np.ndarray, numbers: tuple[float, ...] | None = None, **more: object
    ) -> tuple[object, ...]:
        """What came."""
        return number, array, numbers, more

    number_, array, none, more = seen(np.float32(0.5), [1, 2], b=3)
    assert (number_, array.tolist(), array.dtype, none, more) == (
        0.5,
        [1.0, 2.0],
        float,
        None,
        {"b": 3},
    )  # type: ignore[attr-defined]
    assert type(number_) is float
    whole_ = np.arange(3.0)
    assert seen(1, whole_)[1] is whole_
    assert seen.__doc__ == "What came."
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'array'"):
        seen(1.0)  # type: ignore[call-arg]


def test_values_are_described_shortly() -> None:
    shown = [
        described(one)
        for one in ("x" * 999, np.zeros((2, 3)), [1, 2], len, State, C, None, 10**5000, _Stranger())
    ]
    assert shown == [
        "a str",
        "an array of shape (2, 3)",
        "[1, 2]",
        "the function len",
        "the class State",
        "a Crane",
        "None",
        "an int",
        "a _Stranger",
    ]


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (
            lambda: finite("a", [[1, 2]], ("n", 3), unit="m"),
            r"^a is an array of shape \(1, 2\); allowed is one of shape \(n, 3\)\.$",
        ),
        (lambda: finite("a", [1, math.inf], (2,)), r"^a is inf; allowed is finite\.$"),
        (
            lambda: C.layout.for_drives("rate", [1, 2, 0], "/s", "> 0"),
            r"^rate of l is 0 m/s; allowed is > 0\.$",
        ),
        (lambda: taken("a", 1j, float | None), r"^a is 1j; allowed is a number or None\.$"),
        (
            lambda: number("a", _Stranger()),
            r"^a is _Stranger that cannot be written out; allowed is a number\.$",
        ),
        (
            lambda: whole("a", 2**64, 0),
            r"^a is 18446744073709551616; allowed is a whole number up to 9\.22337e\+18\.$",
        ),
        (lambda: intervals("a", 1.0, 0.0), r"^step is 0\.0 s; allowed is > 0\.$"),
        (
            lambda: clocks(1.0, 10**5000, 1.0),
            r"^dt is int that cannot be written out s; allowed is a number > 0\.$",
        ),
    ],
)
def test_the_doors_say_name_value_unit_and_what_is_allowed(
    make: Callable[[], Any], sentence: str
) -> None:
    with pytest.raises(OutOfRange, match=sentence):
        make()


# --- what goes wrong in a run ---------------------------------------------------------------------


def _from(t0: float, then: Callable[[], Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """A callable of a run that does something else from a time on; it is the first of what it is
    given.
    """
    return lambda t, *more: usual(t, *more) if t < t0 else then()


BAD_SETPOINTS: dict[str, tuple[Any, str]] = {
    "none": (
        None,
        "answer of the reference is None; allowed is a cranedyn.Setpoint: position, velocity, "
        "acceleration",
    ),
    "an array": (np.zeros(3), r"answer of the reference is an array"),
    "two numbers": (
        Setpoint(*np.zeros((3, 2))),
        r"position of the setpoint is an array of shape \(2,\)",
    ),
    "nan": (
        Setpoint(np.array([0.0, math.nan, 15.0]), np.zeros(3), np.zeros(3)),
        "position of the setpoint is nan; allowed is finite",
    ),
    "an endless rate": (
        Setpoint(np.zeros(3), np.full(3, math.inf), np.zeros(3)),
        "velocity of the setpoint is inf; allowed is finite",
    ),
    "words": (Setpoint("a", "b", "c"), "position of the setpoint is no array of numbers but str"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize(("answer", "sentence"), BAD_SETPOINTS.values(), ids=BAD_SETPOINTS)
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


@pytest.mark.parametrize("who", ["controller", "reference", "disturbance", "progress"])
def test_an_error_of_whoever_a_run_calls_is_its_cause_and_its_rows_are_kept(who: str) -> None:
    usual = {
        "controller": BRAKE,
        "reference": STILL,
        "disturbance": lambda t, state: np.zeros((2, 3)),
        "progress": lambda t: None,
    }
    for first, rows in ((0.0, 0), (0.05, 10)):
        given = {**usual, who: _from(first, lambda: {}["x"], usual[who])}
        with pytest.raises(
            RunError,
            match=rf"^At t = {first:g} s: KeyError in <lambda>, line \d+ of test_arguments\.py: "
            r"'x'\.$",
        ) as caught:
            simulate(C, **given, duration=0.1)  # type: ignore[arg-type]
        assert isinstance(caught.value.__cause__, KeyError)
        kept = caught.value.trajectory
        # Which is told after the row is logged.
        assert kept is not None and len(kept) == rows + (who == "progress")
        assert all(np.isfinite(getattr(kept, name)).all() for name in QUANTITIES)


def test_a_command_of_complex_numbers_is_refused() -> None:
    with pytest.raises(
        OutOfRange,
        match=r"command of the controller is an array of shape \(3,\); allowed is three numbers",
    ):
        simulate(C, lambda t, state, setpoint: np.array([1j, 0, 0]), duration=0.1)


def test_masked_numbers_are_no_numbers(recwarn: pytest.WarningsRecorder) -> None:
    """NumPy makes plain arrays of masked ones by forgetting the mask."""
    hidden = np.ma.masked_array([0.0, 1.0, 2.0], mask=[False, True, False])
    for take in (
        lambda: finite("command", hidden, (3,)),
        lambda: taken("command", hidden, np.ndarray),
        lambda: taken("rates", hidden, Sequence[float]),
        lambda: taken("rate", np.ma.masked, float),
        lambda: Limits(hidden, (1.0, 1.0, 1.0)),
        lambda: Stepper(crane()).step(hidden),
        lambda: simulate(crane(), lambda *_: hidden, duration=0.01),
    ):
        with pytest.raises(OutOfRange):
            take()
    assert not recwarn.list
    bare = np.ma.masked_array([0.0, 1.0, 2.0], mask=False)
    assert finite("command", bare, (3,)).tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(OutOfRange, match=r"^a is an array of shape \(3,\) with masked numbers;"):
        taken("a", hidden, np.ndarray)


def test_every_row_of_a_table_of_setpoints_must_be_there_and_finite() -> None:
    class Table:
        def __init__(self, rows: int, columns: int, value: float = 0.0) -> None:
            self.answer = Setpoint(*np.full((3, rows, columns), value))

        def __call__(self, t: float) -> Setpoint:
            return Setpoint(*(part[0] for part in self.answer))

        def at(self, times: np.ndarray) -> Setpoint:
            return self.answer

    assert len(plumb(C, Table(21, 3), 0.1).q) == 21
    for table in (Table(20, 3), Table(22, 3), Table(21, 2), Table(21, 3, math.nan)):
        with pytest.raises(
            OutOfRange, match=r"position of the setpoint is (an array of shape|nan)"
        ):
            plumb(C, table, 0.1)


def test_the_fields_of_a_crane_are_those_that_make_it() -> None:
    assert [one.name for one in fields(C) if one.init] == [
        "layout",
        "written",
        "model",
        "damping",
        "springs",
        "lower",
        "upper",
        "effort_limit",
        "start",
        "points",
        "record",
    ]
