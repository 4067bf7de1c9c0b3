"""One loop, two engines: compiled code records what Pinocchio's algorithms record, and fails in the
same words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.compiled.plant import rigid_body
from cranedyn.controllers import follow, hold_controller, lqr
from cranedyn.controllers.hold import Hold
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import QUANTITIES, Trajectory, join
from cranedyn.disturbances import wind
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.dynamics.integrators import (
    Acceleration,
    Add,
    Integrator,
    Rule,
    rk4,
    semi_implicit_euler,
)
from cranedyn.dynamics.scalars import array
from cranedyn.errors import CraneError, ModelError, OutOfRange, RunError, UnknownName
from cranedyn.interfaces import Controller, Disturbance, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import G, constant, crane, locked, python
from tests.system.test_properties import CALM, VARIANTS, Case, cases, kinds, run

DAMPED = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e2, "damp_hoist": 700.0}

EPS = float(np.finfo(float).eps)
ENGINES: tuple[Any, ...] = ("pinocchio", "compiled")


def _inertia(c: Crane) -> np.ndarray:
    return np.diag(pin.crba(c.model, c.data, c.start.q))[c.layout.drives]


def allowed_between(c: Crane, run: Trajectory, per_second: float) -> dict[str, np.ndarray]:
    """How far two engines may be apart, for each column.

    A share of the column's largest value for each second; and rounding where a number is made from
    differences of others: where motion is prescribed, accelerations are differences of rates over
    the period, and work is a force times differences of positions.
    """
    seconds = max(float(np.ptp(run.t)), run.parameters["control_period_s"])
    allowed = {
        name: per_second * seconds * np.abs(getattr(run, name)).max(axis=0, initial=0.0)
        for name in QUANTITIES
    }
    fastest, farthest, most = (
        np.abs(values[:, c.layout.drives]).max(axis=0) for values in (run.v, run.q, run.v)
    )
    if run.parameters["drive"] == "motion":
        jumps = 8.0 * EPS * fastest / run.parameters["control_period_s"] * _inertia(c)
        allowed["command"] = allowed["command"] + jumps
        allowed["effort"] = allowed["effort"] + jumps
        allowed["work"] = allowed["work"] + jumps * most * seconds
    allowed["work"] = allowed["work"] + len(run) * EPS * farthest * np.abs(run.effort).max(axis=0)
    # where nothing moves, rounding of the weight that is held
    weight = 1e-3 * per_second * seconds * run.parameters["gravity_m_s2"]
    allowed["v"] = allowed["v"] + weight
    allowed["q"] = allowed["q"] + weight * seconds
    allowed["dissipated"] = allowed["dissipated"] + seconds * weight * (
        c.damping @ (2.0 * np.abs(run.v).max(axis=0, initial=0.0) + weight)
    )
    reach = np.abs(run.force).max() * 100.0 + np.abs(run.effort).max()
    allowed["outside"] = allowed["outside"] + len(run) * EPS * reach
    return allowed | {"t": EPS * np.abs(run.t).max(initial=0.0), "valid": np.zeros(())}


def agree(c: Crane, plain: Trajectory, compiled: Trajectory, per_second: float = 1e-12) -> None:
    """Every column of two runs."""
    assert len(plain) == len(compiled)
    assert (plain.parameters["engine"], compiled.parameters["engine"]) == ("pinocchio", "compiled")
    assert {**plain.parameters, "engine": "compiled"} == compiled.parameters
    for name, allowed in allowed_between(c, plain, per_second).items():
        off = np.abs(getattr(plain, name) - getattr(compiled, name)).max(axis=0, initial=0.0)
        assert (off <= allowed).all(), f"{name}: {off} where {allowed} is allowed"


def both(
    c: Crane, controller: Callable[[], Controller], reference: Reference, **how: Any
) -> tuple[Trajectory, Trajectory]:
    """Runs that agree, one in each engine, each with a controller of its own."""
    how = {"start": _start(), "validity": "mark", **how}
    plain, compiled = (
        simulate(c, controller(), reference, **how, engine=engine) for engine in ENGINES
    )
    agree(c, plain, compiled)
    return plain, compiled


# --- whole runs -----------------------------------------------------------------------------------

PERIOD = 1e-2
LASTS = 0.6
CLOCK: dict[str, Any] = {"duration": LASTS, "dt": 1e-3, "control_period": PERIOD}


@cache
def _crane(validity: str) -> Crane:
    """One whose trolley meets the end of its path, but where that would end the run; its drives are
    strong enough for a ramp that is followed exactly from its first instant.
    """
    if validity == "stop":
        return crane(**DAMPED, slew_effort=1e8, trolley_effort=1e8, hoist_effort=1e8)
    return crane(**DAMPED, trolley_max=10.05)


def _start() -> State:
    return crane().state(
        phi=0.15, theta=-0.1, gamma_dot=0.02, x_dot=0.3, l_dot=-0.04, phi_dot=0.05, theta_dot=0.1
    )


def _reference() -> Reference:
    c = crane()
    reference = ramp(
        c, ramp(c, hold(c, _start()), "x", 0.5, rate=0.3, at=0.0), "gamma", 0.01, rate=0.05, at=0.05
    )
    return ramp(c, reference, "l", -0.02, rate=0.05, at=0.05)


@cache
def _lqr() -> Tracking:
    return lqr(_crane("stop"), hanging_reference(crane(), _reference(), LASTS, PERIOD), dt=1e-3)


def _plain_function() -> Controller:
    brake = hold_controller(crane(), gravity=G)
    return lambda t, state, setpoint: brake(t, state, setpoint)


CONTROLLERS: dict[str, tuple[str, Callable[[], Controller]]] = {
    "hold": ("effort", lambda: hold_controller(crane(), gravity=9.7)),
    "lqr": ("effort", _lqr),
    "integral": ("effort", lambda: HoistIntegral(crane(), _lqr(), 2e3, 1.2e4)),
    "python": ("effort", _plain_function),
    "follow": ("motion", lambda: follow(crane(), _reference(), PERIOD)),
    "python motion": (
        "motion",
        lambda: lambda t, state, setpoint: np.array([0.05, 0.5, -0.3]) * math.cos(3.0 * t),
    ),
}

FORCES: dict[str, Callable[[Crane], Disturbance | None]] = {
    "no wind": lambda c: None,
    "push": lambda c: wind.constant_force(
        c, payload=(500.0, -300.0, 100.0), trolley=(40.0, 60.0, 0.0), at=0.2
    ),
    "wind": lambda c: wind.wind(
        c, lambda t: 12.0 - 6.0 * t, direction=2.0, payload_area=4.0, trolley_area=1.0
    ),
}


@pytest.mark.parametrize("controller", ["hold", "integral", "python", "follow"])
@pytest.mark.slow
def test_a_run_of_many_blocks_is_the_same(controller: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cranedyn.compiled.blocks._MAX_BLOCK_LENGTH", 2000)
    drive, made = CONTROLLERS[controller]
    c = crane(**DAMPED)
    told = list[float]()
    tracking = lqr(c, hanging_reference(c, _reference(), 4.2, 2e-3), dt=1e-3)
    if controller == "integral":
        made = lambda: HoistIntegral(c, tracking, 2e3, 2e4)  # noqa: E731
    elif controller == "follow":
        made = lambda: follow(c, _reference(), 2e-3)  # noqa: E731
    clock = {"duration": 8.4, "dt": 1e-3, "control_period": 2e-3}
    plain, _ = both(
        c, made, _reference(), **clock, drive=drive, monitors=[lambda k, t, state: told.append(t)]
    )
    assert len(plain) == 4201
    assert told[:4201] == plain.t.tolist()
    after_blocks = plain.t.tolist() if controller == "python" else [3.998, 7.998, 8.4]
    assert told[4201:] == pytest.approx(after_blocks, abs=1e-12)


@pytest.mark.slow
def test_a_monitor_gets_the_state_of_its_row_after_each_block(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cranedyn.compiled.blocks._MAX_BLOCK_LENGTH", 50)
    c = crane()
    seen: list[tuple[int, State]] = []
    run = simulate(
        c,
        hold_controller(c),
        _reference(),
        start=_start(),
        duration=1.0,
        engine="compiled",
        monitors=[lambda row, t, state: seen.append((row, state))],
    )
    assert [row for row, _ in seen] == [49, 99, 149, 199, 200]
    for row, state in seen:
        assert np.array_equal(state.q, run.q[row])
        assert np.array_equal(state.v, run.v[row])


def test_at_the_limits_of_the_drives_the_engines_cut_alike() -> None:
    c = crane(**DAMPED, trolley_effort=2e3, slew_effort=1e4, hoist_effort=9.9e3)
    for made in (lambda: hold_controller(c, gravity=G), _plain_function):
        for found in both(c, made, _reference(), duration=2.0):
            assert (np.abs(found.effort).max(axis=0) == c.effort_limit).all()


@pytest.mark.slow
def test_a_run_that_begins_late_is_the_same() -> None:
    c = crane()
    late = 5e4
    reference = ramp(c, hold(c, _start()), "x", 0.3, rate=1.0, at=late + 0.1)
    both(c, lambda: HoistIntegral(c, _lqr(), 2e3, 1.2e4), reference, t_start=late, **CLOCK)


def test_drives_without_limits_are_compiled_too() -> None:
    c = replace(crane(), effort_limit=np.full(3, np.inf))
    both(c, lambda: hold_controller(c, gravity=G), _reference(), duration=0.2)


# --- what is refused ------------------------------------------------------------------------------


def test_an_engine_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UnknownName, match="no engine 'steam'; there are compiled, pinocchio"):
        simulate(crane(), locked, duration=0.1, engine="steam")


@pytest.mark.parametrize(
    "rule",
    [
        lambda *given: _raise(AssertionError()),
        lambda *given: given,
        lambda acceleration, faster, move, q, v, steps: (q[:1], v),
        lambda acceleration, faster, move, q, v, steps: (move(q, v), v if v[0] > 0.0 else q),
        lambda acceleration, faster, move, q, v, steps: (move(q, v), np.sqrt(v)),
    ],
    ids=["raises", "answers something else", "one coordinate", "looks at numbers", "takes roots"],
)
def test_a_stepping_rule_without_code_is_refused_before_anything_is_asked_whatever_its_name(
    rule: Rule,
) -> None:
    words = r"integrator of compiled code is RK4; allowed is one whose rule adds and multiplies"
    integrator = Integrator("RK4", rule, lead=0.0)
    for controller in (hold_controller(crane()), lambda *given: _raise(AssertionError())):
        with pytest.raises(OutOfRange, match=words):
            simulate(crane(), controller, duration=0.1, integrator=integrator, engine="compiled")


def _midpoint(
    acceleration: Acceleration, faster: Add, move: Add, q: np.ndarray, v: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """The explicit rule of order 2."""
    for _ in range(steps):
        q_halfway = move(q, 0.5 * v)
        v_halfway = faster(v, 0.5 * acceleration(q, v))
        q = move(q, v_halfway)
        v = faster(v, acceleration(q_halfway, v_halfway))
    return q, v


@pytest.mark.slow
def test_a_stepping_rule_of_ones_own_runs_in_both_engines() -> None:
    c = crane(**DAMPED)
    rule = Integrator("midpoint", _midpoint, lead=0.0)
    how: dict[str, Any] = {"duration": LASTS, "control_period": PERIOD}
    for made in (CONTROLLERS["hold"][1], _plain_function):
        both(c, made, _reference(), **how, dt=PERIOD / 2, integrator=rule)

    def end(dt: float, integrator: Integrator) -> np.ndarray:
        mine = {**how, "start": _start(), "validity": "mark", "dt": dt, "integrator": integrator}
        return simulate(c, _plain_function(), _reference(), **mine, engine="compiled").q

    exact = end(PERIOD, rk4)
    coarse, fine = (np.abs(end(dt, rule) - exact).max() for dt in (5e-3, 2.5e-3))
    # order 2; the next order is the stiffest rate of 50/s times 5 ms
    assert coarse / fine == pytest.approx(4.0, rel=0.25)


def _wrong_cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] + a[1] * b[0]])


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "name"), [("effort", "hold"), ("motion", "follow")])
def test_code_that_moves_otherwise_is_refused(
    drive: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cranedyn.compiled.plant.rigid_body.cross_product", _wrong_cross)
    c = load_crane(payload_mass=1234.5)
    controller = CONTROLLERS[name][1]()
    words = "The compiled crane moves otherwise than Pinocchio's: accelerations differ by "
    with pytest.raises(ModelError, match=words):
        simulate(c, controller, duration=0.1, drive=drive, engine="compiled")


def test_a_heavy_load_under_a_light_trolley_is_not_refused_for_rounding_in_the_world_frame() -> (
    None
):
    # pin.aba in the world's frame, as the loop calls it, is off by 1.5e-11 of the acceleration at
    # one of the states that are compared
    c = load_crane(gravity=11.2, **VARIANTS[-2])
    start = c.state(phi=0.1)
    how: dict[str, Any] = {"duration": 0.1, "validity": "mark", "engine": "compiled"}
    assert len(simulate(c, soft_hold(c, start.q), start=start, **how)) == 21


@pytest.mark.parametrize("share", [1e-9, -1e-9])
def test_a_crane_that_is_a_billionth_heavier_than_its_model_is_refused(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    from cranedyn.compiled import verify

    c = load_crane(payload_mass=1234.5, hoist_effort=1e12)
    honest = verify.plant_numbers

    def numbers(one: Crane) -> np.ndarray:
        heavier = replace(one, model=one.model.copy())
        heavier.model.inertias[5].mass *= 1.0 + share
        return honest(heavier)

    monkeypatch.setattr("cranedyn.compiled.verify.plant_numbers", numbers)
    with pytest.raises(ModelError, match="moves otherwise"):
        simulate(c, hold_controller(c), duration=0.1, engine="compiled")


@pytest.mark.slow
def test_llvmlite_is_imported_where_it_is_used_and_missed_in_a_sentence() -> None:
    script = """
import sys
from cranedyn.controllers import hold_controller
from cranedyn.model.load import load_crane
from cranedyn.errors import CraneError
from cranedyn.simulation.simulate import simulate
crane = load_crane()
simulate(crane, hold_controller(crane), duration=0.01)
print([name for name in sys.modules if "llvm" in name or "compiled" in name])
sys.modules["llvmlite"] = None
try:
    simulate(crane, hold_controller(crane), duration=0.01, engine="compiled")
except CraneError as error:
    print(error)
try:
    import cranedyn.compiled.batch
except CraneError as error:
    print(error)
"""
    sentence = (
        "The compiled engine needs llvmlite, which is not installed: pip install "
        "'cranedyn[compiled]'.\n"
    )
    found = python(script)
    assert found.stdout == "[]\n" + 2 * sentence, found.stderr


# --- controllers that remember --------------------------------------------------------------------


@pytest.mark.slow
def test_what_an_integrator_remembers_is_what_the_plain_loop_leaves_it() -> None:
    c = crane(payload_mass=1100.0)
    made = list[HoistIntegral]()

    def controller() -> HoistIntegral:
        made.append(HoistIntegral(crane(), _lqr(), 2e3, 1.12e4))
        return made[-1]

    both(c, controller, _reference(), **{**CLOCK, "duration": 0.8})
    plain, compiled = made
    assert abs(plain.integral) > 1e-3
    assert compiled.integral == pytest.approx(plain.integral, rel=1e-12)
    assert compiled._t == plain._t == 0.8


@pytest.mark.slow
def test_at_its_limit_the_integrator_stops_alike_and_comes_back() -> None:
    c = crane(payload_mass=1300.0, trolley_max=30.0)
    quiet = hold(crane(), _start())
    tracking = lqr(crane(), hanging_reference(c, quiet, 3.0, PERIOD), dt=1e-3)
    how = {**CLOCK, "duration": 3.0}
    plain, _ = both(c, lambda: HoistIntegral(c, tracking, 2e4, 1.25e4), quiet, **how)
    assert np.abs(plain.command[:, 2]).max() > 1.2e4
    free = simulate(c, HoistIntegral(c, tracking, 2e4, 1e9), quiet, start=_start(), **how)
    assert np.abs(free.q - plain.q).max() > 1e-3  # the limit matters


@pytest.mark.parametrize("name", ["hold", "integral", "python", "follow"])
def test_pieces_of_a_run_joined_are_the_whole(name: str) -> None:
    drive, made = CONTROLLERS[name]
    c = crane()
    controller = made()
    how = {**CLOCK, "drive": drive, "validity": "mark", "engine": "compiled"}
    whole = simulate(c, made(), _reference(), start=_start(), **how)
    pieces = list[Trajectory]()
    how["duration"] = 0.2
    for begin in (0.0, 0.2, 0.4):
        start = pieces[-1].state(-1) if pieces else _start()
        pieces.append(simulate(c, controller, _reference(), start=start, t_start=begin, **how))
    agree(c, replace(whole, parameters={**whole.parameters, "engine": "pinocchio"}), join(pieces))


def test_a_variant_that_answers_otherwise_is_asked() -> None:
    class Louder(Hold):
        def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
            return 1.1 * super().__call__(t, state, setpoint)

    c = crane()
    brake = hold_controller(crane(), gravity=G)
    louder = Louder(c, brake.stiffness, brake.damping, brake.feed_forward)
    plain, _ = both(c, lambda: louder, _reference(), duration=0.2)
    assert plain.effort[0].tolist() == (1.1 * brake(0.0, _start(), _reference()(0.0))).tolist()


# --- what goes wrong ------------------------------------------------------------------------------


def _rounded(error: Exception) -> str:
    """Its sentence with six digits of each number."""
    return re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.6g}", str(error))


def _same_failure(
    c: Crane,
    controller: Callable[[], Controller],
    *given: Any,
    per_second: float | None = 1e-12,
    **how: Any,
) -> RunError:
    """End a run in each engine in the same words, with the same records; return the error."""
    found = []
    for engine in ENGINES:
        with pytest.raises(RunError) as caught:
            simulate(c, controller(), *given, **how, engine=engine)
        found.append(caught.value)
    plain, compiled = found
    assert _rounded(plain) == _rounded(compiled)
    assert (plain.t, plain.joint) == (compiled.t, compiled.joint)
    assert plain.trajectory is not None
    assert compiled.trajectory is not None
    assert len(plain.trajectory) == len(compiled.trajectory)
    if per_second is not None:
        agree(c, plain.trajectory, compiled.trajectory, per_second)
    return compiled


@pytest.mark.parametrize("name", ["hold", "python"])
def test_a_joint_that_leaves_its_range_ends_both_runs_at_the_same_row(name: str) -> None:
    # rows of 1 ms: the end of the path comes in the second block of those that run ahead
    c = crane()
    reference = ramp(c, hold(c, c.state(x=20.0)), "x", 4.0, rate=1.0, at=0.2)
    clock = {"duration": 5.0, "dt": 1e-3, "control_period": 1e-3}
    failure = _same_failure(c, CONTROLLERS[name][1], reference, start=c.state(x=20.0), **clock)
    assert failure.joint == "trolley_joint"
    assert "trolley_joint is at 22.0" in str(failure)
    assert 2.0 < failure.t < 3.0


def test_a_hoist_that_pushes_the_rope_ends_both_runs() -> None:
    reference = ramp(crane(), hold(crane()), "l", 5.0, rate=20.0, at=0.05)
    failure = _same_failure(crane(), CONTROLLERS["hold"][1], reference, duration=2.0)
    assert "the rope would have to push" in str(failure)


@pytest.mark.slow
def test_a_run_that_diverges_ends_alike() -> None:
    c = crane(hoist_effort=1e12)
    wild = hold_controller(c, damping=(1e6, 5e4, 1e6))
    how: dict[str, Any] = {"start": c.state(l_dot=0.1), "duration": 60.0, "validity": "mark"}
    # the error grows as the motion does, by which both are scaled; which digits of a speed of 1e50
    # are said is up to rounding
    failure = _same_failure(c, lambda: wild, None, per_second=1e-9, **how)
    assert re.match(r"The run diverged at t = .* s: hoist_joint moves at", str(failure))
    assert failure.trajectory is not None
    assert len(failure.trajectory) == round(failure.t / 5e-3)
    assert all(np.isfinite(getattr(failure.trajectory, name)).all() for name in QUANTITIES)


def test_a_run_that_diverges_late_is_repeated_only_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    c = crane(hoist_effort=1e12)
    calls = list[int]()
    slowly = hold_controller(c, damping=(1e6, 5e4, 4.1e5))
    command = Hold.__call__
    monkeypatch.setattr(Hold, "__call__", lambda *a: calls.append(1) or command(*a))
    with pytest.raises(RunError, match="diverged") as caught:
        simulate(
            c, slowly, start=c.state(l_dot=0.1), duration=5.0, validity="mark", engine="compiled"
        )
    assert caught.value.trajectory is not None
    assert len(caught.value.trajectory) > 300
    assert len(calls) < 3


def _after(t0: float, action: Callable[[], np.ndarray]) -> Callable[[], Controller]:
    brake = hold_controller(crane(), gravity=G)
    return lambda: lambda t, state, setpoint: brake(t, state, setpoint) if t < t0 else action()


def _raise(error: BaseException) -> Any:
    raise error


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (
            lambda: np.array([0.0, math.nan, 0.0]),
            "The controller commanded .* at t = 0.0500 s; trolley_joint needs a finite number",
        ),
        (
            lambda: np.zeros(2),
            r"At t = 0.05 s: command of the controller is an array of shape \(2,\)",
        ),
        (lambda: _raise(CraneError("No answer.")), "At t = 0.05 s: No answer."),
        (lambda: _raise(KeyboardInterrupt()), r"Interrupted at t = 0.050 s\."),
    ],
    ids=["not a number", "two numbers", "an error", "Ctrl-C"],
)
@pytest.mark.parametrize("integrator", [semi_implicit_euler, rk4], ids=["Euler", "RK4"])
@pytest.mark.slow
def test_a_controller_that_cannot_answer_ends_both_runs_in_the_same_words(
    action: Callable[[], np.ndarray], words: str, integrator: Integrator
) -> None:
    how = {"start": _start(), "duration": 0.2, "integrator": integrator}
    failure = _same_failure(crane(), _after(0.05, action), _reference(), **how)
    assert pytest.approx(0.05) == failure.t
    assert failure.trajectory is not None
    assert len(failure.trajectory) == 10
    with pytest.raises(RunError, match=words):
        raise failure


def test_a_table_with_a_number_missing_ends_both_runs_where_it_is_reached() -> None:
    feed_forward = _lqr().feed_forward.copy()
    feed_forward[30, 2] = math.nan
    wrong = replace(_lqr(), feed_forward=feed_forward)
    how = {**CLOCK, "start": _start()}
    failure = _same_failure(crane(), lambda: wrong, _reference(), per_second=None, **how)
    assert failure.joint == "hoist_joint"
    assert failure.trajectory is not None
    assert len(failure.trajectory) == 30


@pytest.mark.parametrize(
    ("late", "words"),
    [
        (lambda t: _raise(CraneError("There is no plan.")), r"At t = 0\.3 s: There is no plan\."),
        (
            lambda t: hold(crane())(t / 0.0),
            r"At t = 0\.3 s: ZeroDivisionError in .*, line \d+ of test_compiled\.py: float "
            r"division by zero\.",
        ),
    ],
    ids=["an error of ours", "another"],
)
def test_a_reference_that_cannot_answer_ends_both_runs_in_the_same_words(
    late: Callable[[float], Setpoint], words: str
) -> None:
    def reference(t: float) -> Setpoint:
        return hold(crane())(t) if t < 0.3 else late(t)

    failure = _same_failure(crane(), CONTROLLERS["hold"][1], reference, duration=1.0)
    assert re.fullmatch(words, str(failure))
    assert isinstance(failure.__cause__, ZeroDivisionError | CraneError)
    assert failure.trajectory is not None
    assert len(failure.trajectory) == 60


def test_ctrl_c_in_a_loop_that_runs_ahead_keeps_the_blocks_that_are_done(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cranedyn.compiled.blocks._MAX_BLOCK_LENGTH", 2000)
    c = crane()
    how = {"start": _start(), "dt": 1e-3, "control_period": 1e-3, "validity": "mark"}
    stop = {"monitors": [lambda row, t, state: _raise(KeyboardInterrupt())], "engine": "compiled"}
    with pytest.raises(RunError, match=r"Interrupted at t = 1\.999 s\.") as caught:
        simulate(c, hold_controller(c), _reference(), duration=5.0, **how, **stop)
    assert caught.value.trajectory is not None
    plain = simulate(c, hold_controller(c), _reference(), duration=1.999, **how)
    agree(c, plain, caught.value.trajectory)


@pytest.mark.slow
def test_a_loop_of_very_small_steps_is_looked_at_before_long() -> None:
    told: list[float] = []
    look = {"monitors": [lambda row, t, state: told.append(t)], "engine": "compiled"}
    how: dict[str, Any] = {"start": _start(), "duration": 0.3, "control_period": 1e-2, **look}
    found = simulate(crane(), hold_controller(crane(), gravity=G), dt=1e-7, **how)
    # A million steps of 0.1 µs are ten control periods.
    assert told == pytest.approx([0.09, 0.19, 0.29, 0.3])
    coarse = simulate(crane(), hold_controller(crane(), gravity=G), dt=1e-5, **how)
    assert np.abs(found.q - coarse.q).max() < 1e-5  # order dt


def test_disturbances_that_are_no_forces_end_both_runs_in_the_same_words() -> None:
    force = lambda t, state: np.zeros((2, 3)) if t < 0.1 else np.full((2, 3), math.nan)  # noqa: E731
    how: dict[str, Any] = {"start": _start(), "duration": 0.2, "disturbance": force}
    failure = _same_failure(crane(), _plain_function, _reference(), per_second=None, **how)
    assert "force of the disturbance" in str(failure)


# --- every combination ----------------------------------------------------------------------------


STEPS = {"Euler": (semi_implicit_euler, 1e-3), "RK4": (rk4, PERIOD)}
"""Stepping rules, and the step that each is given [s]."""


def _combinations() -> list[Any]:
    """Return what both engines run: rule, force, controller and validity.

    Of each two of them every pair of values is in the default run, in half of the combinations.
    """
    controlled = []
    for controller, (drive, _) in CONTROLLERS.items():
        controlled += [(controller, "stop"), (controller, "mark")]
        if drive == "effort":
            controlled += [(controller, "buffers")]
    found = []
    for i, rule in enumerate(STEPS):
        for j, force in enumerate(FORCES):
            for k, (controller, validity) in enumerate(controlled):
                marks = [pytest.mark.long] if (i + j + k) % 2 else []
                found.append(pytest.param(rule, force, controller, validity, marks=marks))
    return found


@pytest.mark.parametrize(("rule", "blows", "controller", "validity"), _combinations())
@pytest.mark.slow
def test_both_engines_record_the_same(
    rule: str, blows: str, controller: str, validity: Any
) -> None:
    integrator, dt = STEPS[rule]
    drive, made = CONTROLLERS[controller]
    how: dict[str, Any] = {**CLOCK, "dt": dt, "drive": drive, "validity": validity}
    c = _crane(validity)
    force = FORCES[blows](c)
    plain, _ = both(c, made, _reference(), **how, integrator=integrator, disturbance=force)
    assert (np.ptp(plain.q, axis=0) > 1e-3).all()  # everything moves
    if validity != "stop" and controller not in ("lqr", "integral"):
        assert plain.q[:, 1].max() > 10.05
    if validity == "buffers" and controller not in ("lqr", "integral"):
        assert plain.outside[-1, 1] != 0.0


# --- the rule of Runge and Kutta ------------------------------------------------------------------

IN_BOTH = pytest.mark.parametrize("engine", ENGINES)


@IN_BOTH
def test_the_error_of_rk4_falls_with_the_fourth_power_of_the_step(engine: Any) -> None:
    c = crane(**DAMPED)
    start = c.state(phi=0.3, theta=-0.2, gamma_dot=0.05, x_dot=0.3)
    effort = np.array([2e4, 500.0, -9700.0])

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[5:], dynamics.acceleration(c, State(y[:5], y[5:]), effort)])

    how: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    exact = solve_ivp(rates, (0.0, 4.0), np.concatenate(start), **how).y[:, -1]

    def miss(dt: float) -> float:
        how = {"dt": dt, "control_period": 0.2, "integrator": rk4, "engine": engine}
        run = simulate(c, constant(*effort), start=start, duration=4.0, **how)
        return float(np.abs(np.concatenate(run.state(-1)) - exact).max())

    coarse = miss(0.1)
    fine = miss(0.05)
    assert 1e-8 < fine < 1e-4  # far above rounding and the reference
    # Order 4; the next order is 0.05 s times rates of 2/s.
    assert coarse / fine == pytest.approx(16.0, rel=0.15)


@pytest.mark.slow
@IN_BOTH
def test_rk4_keeps_the_energy_of_a_swing(engine: Any) -> None:
    c = crane(damp_swing=0.0)
    how: dict[str, Any] = {"dt": 5e-3, "drive": "motion", "integrator": rk4, "engine": engine}
    found = simulate(c, locked, start=c.state(phi=0.5, theta=0.3), duration=20.0, **how)
    whole = 1000.0 * G * 15.0 * (1.0 - math.cos(0.5))
    # (ω dt)⁵/144 a step with ω = 0.8/s, thousands of steps; the semi-implicit rule would ripple by
    # ω dt = 4e-3
    assert np.ptp(found.energy) < 1e-9 * whole


@IN_BOTH
@pytest.mark.slow
def test_where_buffers_act_rk4_gives_way_to_small_steps(engine: Any) -> None:
    c = crane(trolley_max=11.0, **DAMPED)
    push = constant(0.0, 500.0, -1000.0 * G)
    how: dict[str, Any] = {
        "start": c.state(x=10.8, x_dot=1.0),
        "duration": 1.5,
        "control_period": 5e-2,
        "validity": "buffers",
        "engine": engine,
    }
    found = simulate(c, push, **how, dt=5e-2, integrator=rk4)
    small = simulate(c, push, **how, dt=5e-4)
    assert small.q[:, 1].max() > 11.01
    assert small.outside[-1, 1] < -100.0
    # small steps of order 20/s · 0.5 ms = 1 % of the depth; a step of 50 ms through the buffer, ω
    # dt = 1, is off by as much as the depth
    depth = small.q[:, 1].max() - 11.0
    assert np.abs(found.q[:, 1] - small.q[:, 1]).max() < 0.1 * depth
    assert found.outside[-1, 1] == pytest.approx(small.outside[-1, 1], rel=0.03)
    coarse = simulate(c, push, **how, dt=5e-2)
    assert np.abs(coarse.q[:, 1] - small.q[:, 1]).max() > 0.1 * depth


# --- cranes of all sizes --------------------------------------------------------------------------


def per_second(c: Crane, q: np.ndarray) -> float:
    """The share by which two engines may drift apart in a second: 1e-12, or what a mass matrix of
    this condition makes of rounding, and as much again for the postures that follow the first.
    """
    return max(1e-12, 2.0 * rigid_body.lost_digits(pin.crba(c.model, c.data, q)))


def soft_hold(c: Crane, q: np.ndarray) -> Hold:
    """A brake of 1 rad/s for what each drive feels where nothing else is held."""
    upper = np.triu(pin.crba(c.model, c.data, q))
    felt = 1.0 / np.diag(np.linalg.inv(upper + np.triu(upper, 1).T))[c.layout.drives]
    return Hold(c, felt, 2.0 * felt, dynamics.holding_effort(c, q))


@settings(max_examples=12)
@given(cases(CALM), kinds)
@pytest.mark.slow
def test_cranes_of_all_sizes_agree_step_by_step(case: Case, drive: str) -> None:
    plain, compiled = (
        run(case, drive, duration=0.2, engine=engine) for engine in ("pinocchio", "compiled")
    )
    agree(case.crane, plain, compiled, per_second(case.crane, case.start_q))


@settings(max_examples=12)
@given(
    cases(CALM), st.sampled_from(["mark", "buffers"]), st.sampled_from([semi_implicit_euler, rk4])
)
@pytest.mark.slow
def test_cranes_of_all_sizes_agree_where_loops_run_ahead(
    case: Case, validity: Any, integrator: Integrator
) -> None:
    c = case.crane
    # a load that is too heavy for its hoist falls, and rounding grows as it flies past the trolley
    assume((np.abs(dynamics.holding_effort(c, case.start_q)) < c.effort_limit).all())
    brake = soft_hold(c, case.start_q)
    reference = hold(
        c, State(case.start_q + 0.1 * np.array([1.0, 1.0, 0.0, 0.0, 1.0]), np.zeros(5))
    )
    how: dict[str, Any] = {**CLOCK, "start": case.start, "duration": 0.3, "validity": validity}
    try:
        plain = simulate(c, brake, reference, **how, integrator=integrator)
    except RunError as error:
        with pytest.raises(RunError) as caught:
            simulate(c, brake, reference, **how, integrator=integrator, engine="compiled")
        # Which of joints that move at 1e50 is the fastest is up to rounding.
        if "diverged" not in str(error):
            assert caught.value.joint == error.joint
            assert caught.value.t == error.t
    else:
        agree(
            c,
            plain,
            simulate(c, brake, reference, **how, integrator=integrator, engine="compiled"),
            per_second(c, case.start_q),
        )
