"""Dry friction: closed forms of a cart that slides, sticks and creeps; the same in both engines."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.horizon.horizon_model import crane_derivatives
from cranedyn.compiled.horizon.receding import receding
from cranedyn.compiled.load_filter_code import compile_load_estimate
from cranedyn.controllers import hold_controller
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.linearisation import linear
from cranedyn.estimation import with_load_estimate
from cranedyn.interfaces import DirectDrive, EngineName
from cranedyn.model.crane import Crane
from cranedyn.model.friction import STOPPING_TIME
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from tests.estimation.motions import at_rest
from tests.helpers import alike_in_both_engines

MASS = 100.0
"""Mass of the cart [kg]."""

FRICTION = 50.0
"""Dry friction of the cart [N]."""

CART = f"""<robot name="cart"><link name="rail"/>
<link name="cart"><inertial><mass value="{MASS}"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="rail"/><child link="cart"/><origin xyz="0 0 5"/>
<axis xyz="1 0 0"/><limit lower="-9" upper="9" effort="1000" velocity="9"/>
<dynamics damping="0" friction="{FRICTION}"/></joint></robot>"""

PENDULUM = """<link name="rod"/>
<link name="load"><inertial><mass value="80"/>
<inertia ixx="2" iyy="2" izz="2" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="revolute"><parent link="cart"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="0" velocity="9"/><dynamics damping="2" friction="3"/></joint>
<joint name="rope" type="prismatic"><parent link="rod"/><child link="load"/><axis xyz="0 0 -1"/>
<limit lower="1" upper="4" effort="3000" velocity="2"/><dynamics damping="0" friction="20"/></joint>
</robot>"""


@pytest.fixture
def cart(tmp_path: Path) -> Crane:
    """A cart on a rail whose drive rests."""
    path = tmp_path / "cart.urdf"
    path.write_text(CART, encoding="utf-8")
    return load_crane(path, driven=["x"])


@pytest.fixture
def crane(tmp_path: Path) -> Crane:
    """A load that swings on a rope below the cart, with friction in all three joints."""
    path = tmp_path / "crane.urdf"
    path.write_text(CART.replace("</robot>", PENDULUM), encoding="utf-8")
    return load_crane(path, driven=["x", "rope"])


def _push(force: float) -> object:
    """A drive that pushes the cart with a constant force [N]."""
    return lambda t, state, setpoint: np.array([force])


def _width(cart: Crane) -> float:
    assert cart.friction is not None
    return float(cart.friction.width[0])


def test_the_width_is_the_rate_that_friction_takes_off_in_the_stopping_time(cart: Crane) -> None:
    assert _width(cart) == pytest.approx(STOPPING_TIME * FRICTION / MASS, rel=1e-12)
    (note,) = [text for text in cart.assumptions if "friction" in text]
    assert "Dry friction of x: 50 N" in note
    assert "Slower than about 0.0025 m/s" in note


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
def test_a_sliding_cart_stops_where_its_kinetic_energy_is_spent(
    cart: Crane, engine: EngineName
) -> None:
    run = simulate(
        cart, _push(0.0), start=cart.state(x_dot=1.0), duration=4.0, dt=1e-3, engine=engine
    )
    distance = MASS * 1.0**2 / (2.0 * FRICTION)
    # The law is short of f by f w²/(2 v²): the last of the way, about w² m/f, takes longer.
    assert run.q[-1, 0] == pytest.approx(distance, abs=2e-3)
    sliding = run.t < 1.5
    deceleration = np.polyfit(run.t[sliding], run.v[sliding, 0], 1)[0]
    assert deceleration == pytest.approx(-FRICTION / MASS, rel=1e-3)
    assert abs(run.v[-1, 0]) < 1e-6


@pytest.mark.parametrize("force", [10.0, 25.0, 49.0])
def test_a_cart_under_less_than_its_friction_creeps_at_the_rate_of_the_law(
    cart: Crane, force: float
) -> None:
    run = simulate(cart, _push(force), duration=12.0, dt=1e-3)
    creep = _width(cart) * force / math.sqrt(FRICTION**2 - force**2)
    assert run.v[-1, 0] == pytest.approx(creep, rel=1e-6)


def test_a_cart_under_more_than_its_friction_accelerates_by_the_rest(cart: Crane) -> None:
    run = simulate(cart, _push(150.0), duration=2.0, dt=1e-3)
    assert run.v[-1, 0] / 2.0 == pytest.approx((150.0 - FRICTION) / MASS, rel=2e-3)


@pytest.mark.slow
def test_friction_dissipates_what_the_motion_loses(crane: Crane) -> None:
    start = crane.state(x_dot=1.0, swing=0.5)
    run = simulate(crane, hold_controller(crane), start=start, duration=6.0, dt=2e-4)
    # The error of semi-implicit Euler in steps of 0.2 ms.
    assert np.abs(run.unexplained).max() < 3e-3 * run.dissipated[-1]
    without = replace(crane, friction=None)
    less = simulate(without, hold_controller(without), start=start, duration=6.0, dt=2e-4)
    assert run.dissipated[-1] > 5.0 * less.dissipated[-1]


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_both_engines_move_with_friction_alike(crane: Crane, drive: str) -> None:
    start = crane.state(x_dot=0.4, swing=0.5, swing_dot=-0.2)
    rates = {"motion": np.array([0.3, -0.1]), "velocity": np.array([0.5, -0.2])}
    controller = hold_controller(crane)

    def command(t: float, state: object, setpoint: object) -> np.ndarray:
        return rates[drive] * math.cos(t)

    alike_in_both_engines(
        crane, controller if drive == "effort" else command, start=start, duration=2.0, drive=drive
    )


def test_a_batch_of_cranes_with_friction_moves_as_each_alone(crane: Crane) -> None:
    starts = [crane.state(swing=angle) for angle in (0.1, 0.4)]
    controller = hold_controller(crane)
    batch = simulate_batch(
        crane, controller, start=starts, duration=2.0, dt=1e-3, control_period=1e-2, record=1
    )
    for i, start in enumerate(starts):
        run = simulate(crane, controller, start=start, duration=2.0, dt=1e-3, control_period=1e-2)
        assert np.abs(batch.q[i] - run.q).max() < 1e-9


def test_the_classical_rule_is_stable_on_friction_over_a_control_period(crane: Crane) -> None:
    start = crane.state(x_dot=0.4, swing=0.5)
    fine, coarse = (
        simulate(
            crane,
            hold_controller(crane),
            start=start,
            duration=3.0,
            integrator=rk4,
            dt=dt,
            control_period=1e-2,
        )
        for dt in (1e-3, 1e-2)
    )
    assert np.abs(fine.q - coarse.q).max() < 1e-3


def test_a_linear_crane_leaves_dry_friction_out(crane: Crane) -> None:
    assert crane.friction is not None
    rest = crane.state()
    assert np.array_equal(linear(crane, rest).a, linear(replace(crane, friction=None), rest).a)


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_predictive_control_brings_a_crane_with_friction_to_its_goal(
    crane: Crane, drive: DirectDrive
) -> None:
    controller = receding(crane, Limits((0.8, 0.5), (0.5, 0.5)), drive=drive)
    goal = crane.state(x=2.0, rope=2.5)
    run = simulate(
        crane, controller, hold(crane, goal), duration=15.0, drive=drive, engine="compiled"
    )
    np.testing.assert_allclose(run.q[-1], goal.q, rtol=0.0, atol=1e-3)


def test_a_predicted_crane_is_linearised_without_dry_friction(crane: Crane) -> None:
    limits = Limits((0.8, 0.5), (0.5, 0.5))
    derivatives = []
    for each in (crane, replace(crane, friction=None)):
        plant = receding(each, limits, drive="motion").programme.plant
        rest = np.zeros(each.layout.n)
        found = crane_derivatives(plant, each.start.q, rest, np.zeros(each.layout.m))
        derivatives.append([found.acceleration_slopes, found.effort_slopes])
    for with_friction, without in zip(*derivatives, strict=True):
        np.testing.assert_array_equal(with_friction.astype(float), without.astype(float))


def test_compiled_and_plain_load_filters_take_the_same_step_under_friction(crane: Crane) -> None:
    crane = load_crane(from_record={"crane": {**crane.record, "joints": {"hoist": "rope"}}})
    motion = at_rest(crane, **dict(zip(crane.layout.symbols, crane.start.q, strict=True)))
    plain = with_load_estimate(hold_controller(crane), crane, motion)
    plain.filter.mean = plain.filter.mean + 0.05
    plain.filter.covariance = 1e-2 * np.eye(len(plain.filter.mean))
    filters = (plain.filter, compile_load_estimate(plain).filter)
    assert type(filters[1]) is not type(plain.filter)
    for each in filters:
        each._believe()
        each.step(np.array([100.0, -800.0]), crane.start)
    # round-off of the covariance
    np.testing.assert_allclose(filters[1].mean, filters[0].mean, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(filters[1].covariance, filters[0].covariance, rtol=0.0, atol=1e-13)


def test_friction_survives_the_record_of_a_run(crane: Crane) -> None:
    again = load_crane(from_record={"crane": dict(crane.record)})
    assert again.friction is not None
    assert crane.friction is not None
    assert again.friction.effort.tolist() == crane.friction.effort.tolist() == [50.0, 3.0, 20.0]
    assert again.friction.width.tolist() == crane.friction.width.tolist()
