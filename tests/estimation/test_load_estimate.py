"""Loads and cables that nobody told a controller: how well they are found, and what is left of the
swing.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

from cranedyn.controllers import hold_controller, lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import holding_effort, linearise, prescribed_acceleration
from cranedyn.errors import CraneError, MissingRole
from cranedyn.estimation import (
    with_load_estimate,
    with_longer_cable,
    with_observer,
    with_sensor_model,
)
from cranedyn.estimation.load_estimate import CableFamily, LoadEstimateController
from cranedyn.estimation.load_filter import MIN_LOAD_RATIO, LoadFilter, Sensors
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.references import Motion
from tests.estimation.motions import PERIOD, REST, STILL, at_rest, combined, residual, tracked
from tests.helpers import ROOT, crane, quickly

HOIST = crane().layout.index("l")


def shortened(controller: Controller, offset: float, share: float = 0.0) -> Controller:
    """A controller whose hoist reads less than the cable has: l = (1 + share) reading + offset."""

    def misled(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        q = state.q.copy()
        v = state.v.copy()
        q[HOIST] = (q[HOIST] - offset) / (1.0 + share)
        v[HOIST] = v[HOIST] / (1.0 + share)
        return controller(t, State(q, v), setpoint)

    return misled


def moved(
    load: float, offset: float, share: float = 0.0, *, sensors: Sensors = "drives"
) -> tuple[LoadEstimateController, Trajectory]:
    """The combined move up to its arrival with a load and a cable that differ from the plan."""
    motion = combined(crane())
    controller = with_load_estimate(tracked(), crane(), motion, sensors=sensors)
    start = crane().state(x=10.0, l=15.0 * (1.0 + share) + offset)
    heavy = crane(payload_mass=1000.0 * load)
    run = quickly(
        heavy, shortened(controller, offset, share), motion, start=start, duration=motion.arrival
    )
    return controller, run


# --- how well load and cable are found ------------------------------------------------------------


@pytest.mark.parametrize("load", [0.3, 0.5, 1.5, 5.0])
@pytest.mark.slow
def test_a_wrong_load_is_known_to_a_hundredth_after_a_twentieth_of_a_second(load: float) -> None:
    motion = at_rest(crane())
    controller = with_load_estimate(lqr(crane(), motion), crane(), motion)
    heavy = crane(payload_mass=1000.0 * load)
    start = crane().state(**REST)
    # a light one is thrown up by what held the load believed in: until the first reading the rope
    # of one below a half would go slack
    quickly(heavy, controller, motion, start=start, duration=10 * PERIOD, validity="mark")
    assert controller.filter.load == pytest.approx(load, rel=0.01)


def test_the_crane_believed_in_is_not_the_one_given() -> None:
    model = crane().model
    before = model.inertias[crane().payload.body + 1].mass
    controller = with_load_estimate(hold_controller(crane()), crane(), at_rest(crane()))
    controller.filter.mean[-3] = 0.5
    controller.filter._believe()
    assert controller.filter.crane.payload_mass == 2.0 * before == 2.0 * crane().payload_mass


@pytest.mark.slow
def test_the_cable_is_found_from_how_fast_the_load_swings_by_the_drives_alone() -> None:
    offset = 1.5
    motion = at_rest(crane())
    controller = with_load_estimate(hold_controller(crane()), crane(), motion)
    start = crane().state(x=10.0, l=15.0 + offset, phi=0.05)
    quickly(crane(), shortened(controller, offset), motion, start=start, duration=16.0)
    # two periods of a swing that the trolley, held, feels by its pull
    assert np.dot(controller.filter.cable, [1.0, 15.0]) == pytest.approx(offset, abs=0.1)


@pytest.mark.slow
def test_at_rest_the_load_can_be_seen_and_the_cable_cannot() -> None:
    motion = at_rest(crane())
    controller = with_load_estimate(hold_controller(crane()), crane(), motion)
    before = controller.filter.covariance.copy()
    quickly(crane(), controller, motion, start=crane().state(**REST), duration=5.0)
    after = controller.filter.covariance
    assert after[-3, -3] < 1e-4 * before[-3, -3]
    # Nothing swings: what is told of the cable is its reading, which is of no use.
    assert after[HOIST, HOIST] > 0.9 * before[HOIST, HOIST]


def filter_of(sensors: Sensors) -> LoadFilter:
    """A filter that is at no special place."""
    motion = at_rest(crane())
    found = with_load_estimate(hold_controller(crane()), crane(), motion, sensors=sensors).filter
    found.mean = np.array(
        [0.3, 12.0, 0.1, -0.05, 14.0, 0.02, 0.3, 0.1, 0.2, -0.4, 1.0 / 0.8, 0.7, -0.06]
    )
    found._believe()
    return found


@pytest.mark.parametrize("sensors", ["drives", "swing", "imu"])
def test_what_the_sensors_should_say_has_the_derivatives_that_differences_give(
    sensors: Sensors,
) -> None:
    found = filter_of(sensors)
    step = 1e-6
    _, by = found._expected(found.mean)
    for i, column in enumerate(by.T):
        beside = [found.mean + sign * step * (np.arange(13) == i) for sign in (1, -1)]
        difference = np.subtract(*(found._expected(w)[0] for w in beside)) / (2.0 * step)
        # rounding of numbers of 10 over the step
        np.testing.assert_allclose(column, difference, atol=1e-8)


def test_the_covariance_goes_on_by_the_derivatives_that_differences_give() -> None:
    effort = np.array([3000.0, 500.0, -8000.0])
    step = 1e-6

    def after(mean: np.ndarray) -> np.ndarray:
        found = filter_of("drives")
        found.mean = mean.copy()
        found._believe()
        found.predict(effort)
        return found.mean

    mean = filter_of("drives").mean
    rows = []
    for i in range(13):
        shift = step * (np.arange(13) == i)
        rows.append((after(mean + shift) - after(mean - shift)) / (2.0 * step))
    over = np.array(rows).T
    found = filter_of("drives")
    found.covariance = np.eye(13)
    found.predict(effort)
    # second order in the period: rates of 0.4/s over 5 ms change derivatives by 2e-3 of what they
    # do in it
    np.testing.assert_allclose(found.covariance - found._added, over @ over.T, atol=3e-4, rtol=3e-3)


@pytest.mark.parametrize("sensors", ["drives", "swing", "imu"])
def test_a_correction_adds_what_the_sensors_tell_to_what_is_known(sensors: Sensors) -> None:
    """Of information, the inverse of covariance, it is a sum: P⁻¹ + Hᵀ R⁻¹ H."""
    found = filter_of(sensors)
    rng = np.random.default_rng(3)
    spread = 0.1 * rng.normal(size=(13, 13))
    found.covariance = spread @ spread.T + 1e-3 * np.eye(13)
    _, by = found._expected(found.mean)
    told = np.linalg.inv(found.covariance) + by.T @ np.linalg.inv(found._noise) @ by
    found.correct(found.state)
    # the condition of both inverses times rounding
    np.testing.assert_allclose(found.covariance, np.linalg.inv(told), atol=1e-9)


def test_the_covariance_of_a_load_at_rest_goes_on_to_second_order_in_the_period() -> None:
    """Half the period leaves an eighth of the error; a quarter if it were the first order."""

    def wrong(period: float) -> float:
        q = crane().state(**REST).q
        still = np.zeros((1, 5))
        motion = Motion(period, q[None], still, still, crane().layout.drives)
        effort = holding_effort(crane(), q)

        def after(shift: np.ndarray) -> LoadFilter:
            found = with_load_estimate(hold_controller(crane()), crane(), motion).filter
            found.mean = found.mean + shift
            found.covariance = np.eye(13)
            found._believe()
            found.predict(effort)
            return found

        step = 1e-4 * np.eye(13)
        over = np.array([after(one).mean - after(-one).mean for one in step]).T / 2e-4
        found = after(np.zeros(13))
        return float(np.abs(found.covariance - found._added - over @ over.T).max())

    assert wrong(0.025) > 6.0 * wrong(0.0125)


# --- what is left of the swing --------------------------------------------------------------------

WORST = 0.5e-3
"""What may be left at the arrival [rad]."""


@pytest.mark.parametrize(
    ("load", "offset", "share", "sensors"),
    [
        # A light and a heavy load, both signs, each kind of sensors; all others are long.
        (0.5, 1.5, 0.0, "drives"),
        pytest.param(0.5, -1.5, 0.0, "drives", marks=pytest.mark.long),
        pytest.param(1.5, 0.0, 0.1, "drives", marks=pytest.mark.long),
        (1.5, 0.0, -0.1, "drives"),
        pytest.param(0.5, 1.5, 0.0, "swing", marks=pytest.mark.long),
        (1.5, -1.5, 0.0, "imu"),
    ],
)
@pytest.mark.slow
def test_half_and_one_and_a_half_of_the_load_on_cables_a_tenth_off_arrive_without_swing(
    load: float, offset: float, share: float, sensors: Sensors
) -> None:
    controller, run = moved(load, offset, share, sensors=sensors)
    assert residual(run) < WORST
    assert controller.filter.load == pytest.approx(load, rel=2e-3)
    assert np.abs(run.setpoint[-1] - run.q[-1, [0, 1, 4]])[:2].max() < 1e-3


@pytest.mark.slow
def test_an_observer_that_knows_nothing_of_the_load_leaves_more_than_tenfold() -> None:
    motion = combined(crane())
    controller = with_observer(tracked(), crane(), motion)
    start = crane().state(**REST)
    light = crane(payload_mass=500.0)
    run = quickly(light, controller, motion, start=start, duration=motion.arrival)
    assert residual(run) > 10.0 * WORST


@pytest.mark.slow
def test_noisy_and_late_sensors_of_the_drives_alone_end_below_a_milliradian() -> None:
    motion = combined(crane())
    delay = 2
    inner = with_load_estimate(tracked(), crane(), motion, delay=delay)
    noisy = with_sensor_model(crane(), inner, delay=delay, rng=np.random.default_rng(2))
    start = crane().state(x=10.0, l=16.5)
    run = quickly(
        crane(payload_mass=500.0),
        shortened(noisy, 1.5),
        motion,
        start=start,
        duration=motion.arrival,
    )
    assert residual(run) < 1e-3


@pytest.mark.slow
def test_both_engines_leave_the_same() -> None:
    motion = combined(crane())
    start = crane().state(**REST)
    runs = [
        quickly(
            crane(payload_mass=1500.0),
            with_load_estimate(tracked(), crane(), motion),
            motion,
            start=start,
            duration=1.0,
            engine=engine,
        )
        for engine in ("pinocchio", "compiled")
    ]
    # round-off in another order, through a loop that forgets
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-10)


@pytest.mark.parametrize(
    ("sensors", "unseen"), [("drives", [2, 3, 7, 8]), ("swing", [7, 8]), ("imu", [])]
)
def test_it_looks_at_what_is_measured_only(sensors: Sensors, unseen: list[int]) -> None:
    motion = at_rest(crane())
    one, other = (
        with_load_estimate(lqr(crane(), motion), crane(), motion, sensors=sensors) for _ in range(2)
    )
    rng = np.random.default_rng(4)
    start = np.concatenate(crane().state(**REST))
    for k in range(5):
        seen = start + 1e-3 * rng.normal(size=10)
        blind = seen.copy()
        blind[unseen] = math.nan
        commands = [
            controller(k * PERIOD, State(z[:5], z[5:]), STILL).tolist()
            for controller, z in ((one, seen), (other, blind))
        ]
        assert commands[0] == commands[1]


def test_a_load_that_cannot_be_is_held_within_what_is_thought_possible() -> None:
    motion = at_rest(crane())
    controller = with_load_estimate(hold_controller(crane()), crane(), motion)
    state = crane().state(**REST)
    for k in range(20):  # a hoist that rises at 30 m/s² with all it was told to hold
        state.v[HOIST] = -0.15 * k
        controller(k * PERIOD, state, STILL)
        assert MIN_LOAD_RATIO <= controller.filter.load
    assert math.isfinite(controller.filter.load)


@pytest.mark.parametrize(
    ("xacro", "values"),
    [
        ("tower_crane", {"hook_mass": 300.0, "sling_length": 5.0}),
        # Springs are springs, of a rope as of a jib.
        pytest.param("tower_crane", {"rope_stiffness": 3e6}, marks=pytest.mark.long),
        ("tower_crane", {"jib_bend_stiffness": 4e7}),
        ("overhead_crane", {}),
    ],
    ids=lambda given: next(iter(given), "bridge") if isinstance(given, dict) else given,
)
@pytest.mark.slow
def test_other_cranes_find_their_load_too(xacro: str, values: dict[str, Any]) -> None:
    path = ROOT / "urdf" / f"{xacro}.urdf.xacro"
    known = load_crane(path, payload_mass=1000.0, **values)
    other = load_crane(path, payload_mass=1400.0, **values)
    still = np.zeros((1, known.layout.n))
    motion = Motion(PERIOD, known.start.q[None], still, still, known.layout.drives)
    controller = with_load_estimate(lqr(known, motion), known, motion, sensors="imu")
    quickly(other, controller, motion, start=known.start, duration=1.0)
    assert controller.filter.load == pytest.approx(1.4, rel=1e-2)


# --- the motion on other cables -------------------------------------------------------------------


def test_a_move_on_a_longer_cable_is_the_flat_one_of_that_cable() -> None:
    point = crane(payload_inertia=0.0, dummy_inertia=0.0)
    found = with_longer_cable(point, combined(point), 1.5)
    planned = combined(point, 1.5)
    np.testing.assert_allclose(found.q, planned.q, atol=1e-9)


@pytest.mark.parametrize("by", [-1.5, 1.5])
def test_a_longer_motion_is_one_that_the_crane_can_make(by: float) -> None:
    point = crane(payload_inertia=0.0, dummy_inertia=0.0, damp_swing=0.0)
    motion = with_longer_cable(point, combined(point), by)
    for row in range(200, 3800, 400):  # the flat motion itself is right to 2e-8
        state = State(motion.q[row], motion.v[row])
        a, _ = prescribed_acceleration(point, state, motion.a[row, motion.drives])
        np.testing.assert_allclose(motion.a[row, 2:4], a[2:4], atol=1e-7)


SPREAD = 1.5


@cache
def family() -> CableFamily:
    """The combined move on cables a tenth shorter and longer."""
    motions = [with_longer_cable(crane(), combined(crane()), by) for by in (-SPREAD, 0.0, SPREAD)]
    return CableFamily(*motions, SPREAD, HOIST)


@pytest.mark.parametrize("offset", [-SPREAD, 0.0, SPREAD])
def test_a_family_of_motions_goes_through_those_it_was_made_of(offset: float) -> None:
    motion = with_longer_cable(crane(), combined(crane()), offset)
    for k in range(0, len(motion.q), 100):
        expected = np.array([motion.q[k], motion.v[k], motion.a[k]])
        np.testing.assert_allclose(family().row(k, offset, 0.0), expected, atol=1e-12)


def test_rates_and_accelerations_of_a_cable_twice_as_long_are_how_its_motion_changes() -> None:
    rows = np.array([family().row(k, 0.5, 1.0) for k in range(500, 1500)])
    q, v, a = np.moveaxis(rows, 1, 0)
    # central differences, within the square of 5 ms by fourth derivatives of a move of 20 s
    np.testing.assert_allclose(np.gradient(q, PERIOD, axis=0)[1:-1], v[1:-1], atol=1e-6)
    np.testing.assert_allclose(np.gradient(v, PERIOD, axis=0)[1:-1], a[1:-1], atol=1e-6)


# --- what is refused ------------------------------------------------------------------------------


def test_it_is_refused_in_a_second_run() -> None:
    motion = at_rest(crane())
    used = with_load_estimate(lqr(crane(), motion), crane(), motion)
    start = crane().state(**REST)
    quickly(crane(), used, motion, start=start, duration=0.1)
    with pytest.raises(CraneError, match="a new one for each run"):
        quickly(crane(), used, motion, start=start, duration=0.1)


def test_a_motion_on_another_cable_is_that_of_a_tower_crane() -> None:
    bridge = load_crane(ROOT / "urdf" / "overhead_crane.urdf.xacro")
    with pytest.raises(MissingRole, match="A motion on another cable"):
        with_longer_cable(bridge, at_rest(bridge, x=10.0), 1.0)


def test_the_estimated_load_hangs_on_two_falls_as_that_of_a_crane_does() -> None:
    light, heavy = (crane(fall_spacing=2.0, payload_mass=mass) for mass in (1000.0, 1500.0))
    q, _ = heavy.state(load_yaw=0.8, phi=0.1)
    n = heavy.layout.n
    effort = np.ones(3)
    state = State(q, np.full(n, 0.1))
    noise = np.eye(n + len(heavy.swings))

    def estimated(load: float) -> LoadFilter:
        mean = np.concatenate([*state, [1.0 / load, 0.0, 0.0]])
        return LoadFilter(light, 5e-3, "drives", mean, np.eye(2 * n + 3), np.ones(n), noise)

    def accelerations(load: float) -> np.ndarray:
        return (estimated(load).advanced(state, effort, 1e-6).v - state.v) / 1e-6

    by_state, by_load = estimated(1.5)._linearised(state, effort)
    exact_by_state, _ = linearise(heavy, state, effort)
    assert np.allclose(by_state, exact_by_state, rtol=0.0, atol=1e-9)
    slope = (accelerations(1.5 * (1.0 - 1e-3)) - accelerations(1.5 * (1.0 + 1e-3))) * 1.5 / 2e-3
    assert np.allclose(by_load, slope, rtol=0.0, atol=1e-4)  # O(1e-6) of second differences
