"""The plain loop: what it calls, what it logs, what it refuses, and what it keeps when something
goes wrong.
"""

from __future__ import annotations

import math
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from cranedyn.analysis.swing import fit_swing
from cranedyn.controllers import follow, hold_controller
from cranedyn.data.trajectory import QUANTITIES, Trajectory
from cranedyn.disturbances.wind import constant_force
from cranedyn.dynamics import equations_of_motion as dynamics
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import OutOfRange, RunError
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from tests.helpers import (
    EXPLICIT_EULER,
    ROOT,
    G,
    big_crane,
    constant,
    crane,
    extrapolated,
    flow,
    locked,
    moved,
)

DAMPED = {"damp_slew": 3e4, "damp_trolley": 200.0, "damp_swing": 5e3, "damp_hoist": 700.0}


def _held(c: Crane, **arguments: Any) -> Trajectory:
    return simulate(c, hold_controller(c, gravity=G), **arguments)


# --- the loop -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_crane_of_one_joint_swings_or_slides_as_its_equation_says(
    kind: str, engine: Any, tmp_path: Path
) -> None:
    (tmp_path / "one.urdf").write_text(
        '<robot name="one"><link name="w"/><link name="b"><inertial><origin xyz="0 0 -1"/>'
        '<mass value="10"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'</link><joint name="j" type="{kind}"><origin xyz="0 0 5"/><parent link="w"/>'
        '<child link="b"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="1e4" velocity="10"/></joint></robot>'
    )
    c = load_crane(tmp_path / "one.urdf", driven=["j"])
    run = simulate(
        c,
        constant(0.0),
        start=c.state(j=0.1),
        duration=1.0,
        disturbance=constant_force(c, payload=(20.0, 30.0, 0.0)),
        integrator=rk4,
        engine=engine,
    )
    swings = kind == "revolute"

    def rate(t: float, y: np.ndarray) -> list[float]:
        torque = -10.0 * c.gravity * np.sin(y[0]) - 20.0 * np.cos(y[0])
        return [y[1], torque / 11.0 if swings else 3.0]

    expected = solve_ivp(rate, (0.0, 1.0), [0.1, 0.0], rtol=1e-12, atol=1e-12).y[0, -1]
    # O(dt⁴) of both, where dt is 0.5 ms, and the tolerance of solve_ivp.
    assert run.q[-1, 0] == pytest.approx(expected, abs=1e-10)


def test_the_controller_is_asked_once_per_period_at_the_instant_that_is_logged() -> None:
    c = crane()
    seen: list[tuple[float, np.ndarray, np.ndarray]] = []

    def controller(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        seen.append((t, np.concatenate(state), setpoint.position))
        return hold_controller(c)(t, state, setpoint)

    ticks: list[float] = []
    start = c.state(phi=0.1)
    reference = ramp(c, hold(c, start), "x", 1.0, rate=1.0, at=0.0)
    found = simulate(
        c,
        controller,
        reference,
        start=start,
        duration=0.1,
        dt=5e-4,
        control_period=1e-2,
        monitors=[lambda row, t, state: ticks.append(t)],
    )
    assert [t for t, *_ in seen] == ticks == found.t.tolist() == [k * 1e-2 for k in range(11)]
    assert np.array([z for _, z, _ in seen]).tolist() == np.hstack([found.q, found.v]).tolist()
    assert np.array([w for *_, w in seen]).tolist() == found.setpoint.tolist()
    assert found.setpoint[:, 1] == pytest.approx(10.0 + found.t)


def test_a_run_says_what_it_was_made_with() -> None:
    found = _held(crane(), duration=0.1, dt=1e-3, control_period=2e-3)
    assert found.parameters == {
        "dt_s": 1e-3,
        "control_period_s": 2e-3,
        "drive": "effort",
        "engine": "pinocchio",
        "integrator": "semi-implicit Euler",
    } | {"gravity_m_s2": G, "validity": "stop"}
    assert len(found) == 51


def test_a_controller_may_answer_with_a_buffer_of_its_own() -> None:
    c = crane()
    buffer = np.zeros(3)

    def controller(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        buffer[:] = 0.0, t, -1000.0 * G
        return buffer

    found = simulate(c, controller, duration=0.05)
    assert_allclose(found.command[:, 1], found.t)
    assert_allclose(found.effort[:, 1], found.t)


@pytest.mark.slow
def test_another_integrator_takes_its_place() -> None:
    c = big_crane()
    dt = 5e-3
    found = simulate(
        c,
        locked,
        start=c.state(l=20, phi=0.01),
        duration=100.0,
        dt=dt,
        control_period=0.1,
        drive="motion",
        integrator=EXPLICIT_EULER,
    )
    whole = 1000.0 * G * 20.0 * (1.0 - math.cos(0.01))
    gain = 1.0 + (found.energy - found.energy[0]) / whole
    # per step 1 + (ω dt)²: 28 % in these 100 s; finite amplitude 1e-4
    assert gain[-1] == pytest.approx((1.0 + G / 20.0 * dt**2) ** 20000, rel=1e-3)
    assert found.parameters["integrator"] == "explicit Euler"


# --- the start ------------------------------------------------------------------------------------


def test_in_a_world_of_other_gravity_the_load_gives_less_than_a_millimetre() -> None:
    found = simulate(crane(), hold_controller(crane(), gravity=9.80665), duration=5.0)
    sag = 1000.0 * (G - 9.80665) / 3.0e4
    # What is left of the transient of exp(-k_p/k_d t).
    assert found.q[-1, 4] - 15.0 == pytest.approx(sag, rel=1e-3)
    assert np.abs(found.q[:, 4] - 15.0).max() < 1e-3


def test_without_reference_the_drives_hold_where_they_are_first_seen() -> None:
    start = crane().state(gamma=1.0, x=20.0, l=8.0)
    found = _held(crane(), start=start, duration=2.0)
    assert found.setpoint.tolist() == [[1.0, 20.0, 8.0]] * len(found)
    # rounding; captured elsewhere it would be metres.
    assert_allclose(found.q, start.q * np.ones((len(found), 1)), atol=1e-12)


# --- physics through the loop ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "command", "dt", "remainder"),
    [("effort", (2e4, 500.0, -9700.0), 2e-3, 2e-7), ("motion", (0.02, 0.1, -0.05), 4e-3, 1e-6)],
)
def test_a_run_converges_to_the_equations_of_motion_with_the_order_of_its_step(
    drive: Any, command: tuple[float, ...], dt: float, remainder: float
) -> None:
    c = crane(**DAMPED)
    push = np.array(command)
    start = c.state(phi=0.3, theta=-0.2, gamma_dot=0.05, x_dot=0.3, l_dot=0.5 * (drive == "motion"))

    def by_effort(state: State) -> np.ndarray:
        return dynamics.acceleration(c, state, push)

    by = by_effort if drive == "effort" else None
    q, v = flow(c, start, np.array([0.0, 4.0]), lambda t: push, by)
    exact = np.concatenate([q[-1], v[-1]])

    def last(dt: float) -> np.ndarray:
        clock = dict(duration=4.0, dt=dt, control_period=0.1)
        found = simulate(c, constant(*command), start=start, drive=drive, **clock)
        return np.concatenate([found.q[-1], found.v[-1]])

    # Order dt³ of (rates of 5/s · dt), about 1e-7 at 2 ms.
    assert_allclose(extrapolated(last, dt), exact, atol=remainder)
    coarse, fine = (np.abs(last(step) - exact).max() for step in (dt, dt / 2.0))
    assert coarse / fine == pytest.approx(2.0, abs=0.03)  # order 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "coordinate", "inertia"), [("phi", 2, 500.0), ("theta", 3, 450.0)]
)
@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_joint_damping_of_the_urdf_damps_the_swing_as_the_closed_form_says(
    drive: Any, joint: str, coordinate: int, inertia: float
) -> None:
    # slew and trolley too heavy to be moved by the load
    c = crane(damp_swing=2e3, trolley_mass=1e7, slewing_inertia=1e11, hoist_init=10)
    controller = locked if drive == "motion" else constant(0.0, 0.0, -1000.0 * G)
    brake = hold_controller(c, gravity=G)
    found = simulate(
        c,
        controller if drive == "motion" else brake,
        start=c.state(**{joint: 0.01}),
        duration=40.0,
        dt=1e-3,
        drive=drive,
    )
    fit = fit_swing(found.t, found.q[:, coordinate])
    total = 1000.0 * 10.0**2 + inertia
    expected = 2e3 / (2.0 * total * math.sqrt(1000.0 * G * 10.0 / total))
    # the load's mass over the trolley's, 1e-4, and over the slew's; finite amplitude and the
    # compliance of the hoist 1e-4
    assert fit.damping_ratio == pytest.approx(expected, rel=1e-3)
    assert expected == pytest.approx(0.01, rel=0.02)


@pytest.mark.slow
def test_efforts_returned_by_prescribed_motion_reproduce_the_motion_through_effort_drives() -> None:
    c = crane(**DAMPED)
    period = 1e-3
    run = {
        "start": c.state(phi=0.05, theta=-0.03),
        "duration": 4.0,
        "dt": period,
        "control_period": period,
    }
    given = simulate(
        c,
        lambda t, state, setpoint: np.array([0.05, 0.5, -0.3]) * math.cos(2.0 * t),
        drive="motion",
        **run,
    )
    played = simulate(c, lambda t, state, setpoint: given.effort[round(t / period)], **run)
    assert (np.ptp(given.q, axis=0)[c.layout.drives] > [0.02, 0.2, 0.1]).all()
    # rounding of 1e-16 · 1e6 N m in the efforts, integrated twice by drives that nothing holds,
    # over 4000 steps
    assert_allclose(played.q, given.q, atol=1e-9)
    assert_allclose(played.v, given.v, atol=1e-9)


# --- limits ---------------------------------------------------------------------------------------


def test_efforts_beyond_the_limits_are_cut_and_the_log_shows_it() -> None:
    c = crane(hoist_effort=2e4)
    found = simulate(c, constant(-3e6, 2e6, -5e4), duration=5e-3)
    assert found.command[0].tolist() == [-3e6, 2e6, -5e4]
    assert found.effort[0].tolist() == [-1e6, 1e6, -2e4]
    # what acts is what was cut to
    expected = simulate(c, constant(-1e6, 1e6, -2e4), duration=5e-3)
    assert found.q[1].tolist() == expected.q[1].tolist()
    assert found.work[1].tolist() == expected.work[1].tolist()


# --- energy ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_under_a_constant_force_the_ledger_closes_to_rounding() -> None:
    # a trolley with next to no load: a constant acceleration, for which effort times displacement
    # is exact once the lead is taken off
    c = crane(payload_mass=1e-9, payload_inertia=0)
    found = simulate(
        c,
        constant(0.0, 600.0, 0.0),
        start=c.state(x=2.0),
        duration=2.0,
        dt=1e-3,
        control_period=1e-2,
        validity="mark",
    )
    # 600 kg at 2 m/s, the load 1e-9.
    assert found.energy[-1] - found.energy[0] == pytest.approx(0.5 * 600.0 * 2.0**2, rel=1e-6)
    # The load; with the lead left in it would be 600 N · 2 m/s · dt/2 = 0.6 J.
    assert_allclose(found.unexplained, 0.0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_what_the_ledger_leaves_open_halves_with_the_step(drive: Any) -> None:
    c = crane(**DAMPED)
    start = c.state(phi=0.15, theta=0.05)
    reference = ramp(
        c, ramp(c, hold(c, start), "x", 2.0, rate=0.8, at=0.5), "gamma", 0.1, rate=0.05, at=1.0
    )

    def run(dt: float) -> Trajectory:
        controller = (
            hold_controller(c, gravity=G) if drive == "effort" else follow(c, reference, dt)
        )
        return simulate(
            c,
            controller,
            reference,
            start=start,
            duration=4.0,
            dt=dt,
            control_period=dt,
            drive=drive,
            validity="mark",  # a ramp that is followed exactly begins with more than drives have
        )

    coarse, fine = (run(dt) for dt in (2e-3, 1e-3))
    assert np.abs(coarse.work).max() > 200.0  # J: the drives do work
    assert coarse.dissipated[-1] > 200.0
    assert np.abs(fine.unexplained).max() < 3.0
    ratio = np.abs(coarse.unexplained).max() / np.abs(fine.unexplained).max()
    # Order 1; steps of the reference and stiff drives put a few percent of order 2 on top.
    assert ratio == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_a_wide_conical_swing_gains_energy_slowly_and_in_proportion_to_the_step() -> None:
    c = big_crane()
    start = c.state(l=20.0, phi=0.5, theta_dot=0.2)
    whole = 1000.0 * (G * 20.0 * (1.0 - math.cos(0.5)) + 0.5 * (20.0 * 0.2) ** 2)

    def gain(dt: float) -> float:
        thirds = np.array_split(moved(c, start, 96.0, dt, period=0.16).energy, 3)
        return float(thirds[2].mean() - thirds[0].mean()) / whole / 64.0

    coarse = gain(8e-3)
    fine = gain(4e-3)
    # Per second: the price of the rule where inertia depends on the angles; a limit we set, twice
    # what it is.
    assert 0.0 < fine < 2e-4
    assert coarse / fine == pytest.approx(2.0, abs=0.1)  # order 1; thirds do not hold whole swings


def test_efforts_that_change_within_a_control_period_are_counted_at_both_ends() -> None:
    c = crane()
    push = constant(0.02, 0.5, -0.1)
    start = c.state(phi=0.2, theta=0.1)
    options = {"dt": 1e-3, "control_period": 0.1}
    found = simulate(c, push, start=start, duration=4.0, drive="motion", **options)
    assert np.abs(found.work).max(axis=0).min() > 1000.0  # J
    # trapezoidal rule: (ω T)²/12 = 5e-4 of some kJ, and the ledger's own order dt; by the first end
    # alone it would be some hundred
    assert np.abs(found.unexplained).max() < 10.0


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [np.zeros(5), np.zeros(2), 0.0, np.zeros((3, 1)), None],
    ids=["five", "two", "one", "column", "none"],
)
@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_only_the_three_drives_can_be_addressed(command: Any, drive: Any) -> None:
    with pytest.raises(
        OutOfRange,
        match=r"command of the controller is (an array of shape|no array of numbers but) .*; "
        r"allowed is three numbers: slew, trolley, hoist",
    ):
        simulate(crane(), lambda t, state, setpoint: command, duration=0.1, drive=drive)


@pytest.mark.parametrize(
    ("dt", "control_period", "duration"),
    [(1e-3, 1e-3, 0.1), (1 / 3000, 1 / 200, 0.3), (7e-4, 2.1e-3, 0.21)],
)
def test_times_that_fit_but_for_rounding_are_taken(
    dt: float, control_period: float, duration: float
) -> None:
    found = _held(crane(), dt=dt, control_period=control_period, duration=duration)
    assert found.t[-1] == pytest.approx(duration, rel=1e-12)


# --- what goes wrong half way ---------------------------------------------------------------------


def _after(
    t0: float, action: Callable[[], np.ndarray]
) -> Callable[[float, State, Setpoint], np.ndarray]:
    brake = hold_controller(crane(), gravity=G)
    return lambda t, state, setpoint: brake(t, state, setpoint) if t < t0 else action()


@pytest.mark.parametrize(
    ("i", "joint"), [(0, "yaw_joint"), (1, "trolley_joint"), (2, "hoist_joint")]
)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_no_number_ends_the_run_and_keeps_it(
    i: int, joint: str, bad: float
) -> None:
    command = np.zeros(3)
    command[i] = bad
    with pytest.raises(
        RunError,
        match=rf"The controller commanded .* at t = 0.0500 s; {joint} needs a finite number",
    ) as caught:
        simulate(crane(), _after(0.05, lambda: command), duration=0.1)
    assert (caught.value.t, caught.value.joint) == (0.05, joint)
    kept = caught.value.trajectory
    assert kept is not None
    assert kept.t.tolist() == [k * 5e-3 for k in range(10)]
    assert np.isfinite(kept.effort).all()


def test_a_run_that_diverges_says_when_and_where_and_keeps_what_it_has() -> None:
    c = crane(hoist_effort=1e12)
    # k_d times the control period over the mass is 5, where 2 is too much.
    wild = hold_controller(c, damping=(1e6, 5e4, 1e6))
    with pytest.raises(
        RunError,
        match=r"The run diverged at t = .* s: hoist_joint moves at .* per second; a smaller dt",
    ) as caught:
        simulate(c, wild, start=c.state(l_dot=0.1), duration=60.0, validity="mark")
    error = caught.value
    assert error.joint == "hoist_joint"
    assert not abs(error.value) < 1e6
    assert error.trajectory is not None
    assert 0 < len(error.trajectory) == round(error.t / 5e-3)
    assert all(np.isfinite(getattr(error.trajectory, name)).all() for name in QUANTITIES)


def _interrupt(*_: object) -> Any:
    raise KeyboardInterrupt


@pytest.mark.parametrize("where", ["controller", "reference", "monitor"])
def test_ctrl_c_keeps_what_was_recorded(where: str) -> None:
    c = crane()
    start = c.start
    row = 10
    controller = hold_controller(c, gravity=G)
    reference = hold(c, start)
    calls = {name: iter(range(100)) for name in ("controller", "reference", "monitor")}

    def interrupted(name: str, function: Any) -> Any:
        def call(*arguments: Any) -> Any:
            return function(*arguments) if next(calls[name]) < row else _interrupt()

        return call if name == where else function

    with pytest.raises(RunError, match=r"Interrupted at t = 0.050 s") as caught:
        simulate(
            c,
            interrupted("controller", controller),
            interrupted("reference", reference),
            monitors=[interrupted("monitor", lambda row, t, state: None)],
            duration=1.0,
        )
    kept = caught.value.trajectory
    assert kept is not None
    # A monitor is called after the row is logged.
    assert len(kept) == (11 if where == "monitor" else 10)
    assert_allclose(kept.q, start.q * np.ones((len(kept), 1)), atol=1e-12)  # it was at rest


def test_ctrl_c_at_once_keeps_an_empty_record() -> None:
    with pytest.raises(RunError, match=r"Interrupted at t = 0.000 s") as caught:
        simulate(crane(), _interrupt, duration=1.0)
    kept = caught.value.trajectory
    assert kept is not None
    columns = crane().layout.columns()
    assert kept.columns == columns
    assert [getattr(kept, name).shape for name in QUANTITIES] == [
        (0,) if len(columns[name]) == 1 else (0, len(columns[name])) for name in QUANTITIES
    ]


@pytest.mark.slow
def test_the_plain_loop_of_the_example_does_the_same_to_round_off() -> None:
    example = runpy.run_path(str(ROOT / "examples" / "plain_loop.py"))
    run = simulate(
        example["crane"],
        example["controller"],
        example["reference"],
        start=example["start"],
        duration=5.0,
    )
    assert np.abs(example["plain_loop"](5.0) - run.q).max() < 1e-14


def test_a_class_in_place_of_a_controller_is_refused_by_name() -> None:
    class Damper:
        def __call__(self, *arguments: object) -> np.ndarray:
            return np.zeros(3)

    with pytest.raises(
        OutOfRange, match=r"controller is the class Damper; .* such as Damper\(...\)"
    ):
        simulate(crane(), Damper, duration=0.1)
