"""Parameters: where the search begins, and within which bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn.identification import Prior, Record
from cranedyn.identification.parameters import (
    MAX_DELAY,
    MIN_DELAY,
    bound_lateness,
    default_names,
    initial_parameters,
    parameter,
)

PRIOR = Prior()
T = np.arange(0.0, 40.0, 0.02)
SIZE = 0.1
PHASE = 0.7


def swinging(**columns: np.ndarray) -> Record:
    """Return a record of a swing at the frequency of the crane, by its angle or its rate."""
    return Record.of(PRIOR.crane, {"t_s": T, **columns})


@pytest.fixture(scope="module")
def omega() -> float:
    """Frequency of the swing at the start of the crane [rad/s], by the pendulum's closed form."""
    record = swinging(phi_rad=SIZE * np.sin(T))
    cable = float(PRIOR.crane.start.q[PRIOR.crane.layout.index("l")])
    closed = 2.0 * math.pi * math.sqrt(cable / 9.80665)
    assert record.swing_period == pytest.approx(closed, rel=0.01)
    return 2.0 * math.pi / record.swing_period


def test_a_swing_begins_where_its_angle_or_its_rate_says(omega: float) -> None:
    """A gyroscope tells no angle; of an oscillation it is -1/ω² times the slope of the rate. A
    parabola through 0.8 s errs by some (0.4 ω)³ / 6 of the size, less than one per cent.
    """
    angle = SIZE * np.sin(omega * T + PHASE)
    rate = omega * SIZE * np.cos(omega * T + PHASE)
    by_angle = initial_parameters(swinging(phi_rad=angle), 0, "motion")
    by_rate = initial_parameters(swinging(phi_dot_rad_s=rate), 3, "motion")
    for parameters in (by_angle, by_rate):
        start, start_rate = parameters[:2]
        assert (start.name, start_rate.name) == ("phi_start", "phi_dot_start")
        assert start.start == pytest.approx(angle[0], abs=0.05 * SIZE)
        assert start_rate.start == pytest.approx(rate[0], abs=0.05 * omega * SIZE)
        assert (start.low, start.high) == (-1.5, 1.5)
    assert len(by_angle) == 2
    # A gyroscope has a bias that drifts.
    assert [p.name for p in by_rate[2:]] == ["phi rate bias", "phi rate drift"]
    assert [p.record for p in by_rate] == [3] * 4
    assert by_angle[0].record == 0


def test_drives_that_are_held_begin_where_they_were_recorded_and_at_their_mean_setpoint() -> None:
    x = 10.0 + 0.02 * T + 1e-3 * np.cos(T)
    record = swinging(phi_rad=SIZE * np.sin(T), x_m=x)
    names = [p.name for p in initial_parameters(record, 0, "hold")]
    assert names == ["phi_start", "phi_dot_start", "x_start", "x_dot_start", "x_setpoint"]
    _, _, start, rate, setpoint = initial_parameters(record, 0, "hold")
    assert start.start == pytest.approx(x[0], abs=1e-4)
    assert rate.start == pytest.approx(0.02, abs=1e-3)
    assert setpoint.start == pytest.approx(np.mean(x))
    assert [p.name for p in initial_parameters(record, 0, "motion")] == names[:2]
    aimed = swinging(phi_rad=SIZE * np.sin(T), x_m=x, x_setpoint_m=x)
    assert [p.name for p in initial_parameters(aimed, 0, "hold")] == names[:4]


def test_a_delay_and_half_a_window_are_less_than_a_quarter_of_the_fastest_swing() -> None:
    record = swinging(phi_rad=SIZE * np.sin(T))
    quarter = 0.25 * record.swing_period
    assert MIN_DELAY < 0.0 < MAX_DELAY < quarter  # of this long cable
    delay, window = (parameter(PRIOR, name) for name in ("delay", "window"))
    assert bound_lateness(delay, [record]) == delay
    short = Record.of(
        Prior(values={"hoist_init": 3.5}).crane, {"t_s": T, "phi_rad": SIZE * np.sin(T)}
    )
    quarter = 0.25 * short.swing_period
    assert quarter < MAX_DELAY
    bounded = bound_lateness(delay, [record, short])
    assert (bounded.low, bounded.high) == (max(MIN_DELAY, -quarter), quarter)
    assert bound_lateness(window, [record, short]).high == 2.0 * quarter
    bias = parameter(PRIOR, "phi_bias")
    assert bound_lateness(bias, [short]) is bias


def test_columns_tell_which_parameters_can_be_found() -> None:
    moving = {"x_m": 10.0 + np.tanh(T - 5.0)}
    both = {"phi_rad": SIZE * np.sin(T), "theta_rad": SIZE * np.cos(T)}
    damped = ["l_offset", "damp_swing"]
    biases = ["delay", "phi_bias", "theta_bias"]
    assert default_names(PRIOR, [swinging(**both, **moving)], "motion") == [*damped, *biases]
    # A free swing does not tell when it began, and so not how late its sensor is.
    still = swinging(**both, x_m=np.full_like(T, 10.0))
    assert default_names(PRIOR, [still], "motion") == [*damped, "phi_bias", "theta_bias"]
    rate = swinging(phi_dot_rad_s=SIZE * np.sin(T), **moving)
    assert default_names(PRIOR, [rate], "motion") == [*damped, "delay"]
    forces = {"F_l_N": -1e4 + 100.0 * np.sin(T), "F_x_N": 300.0 * np.sin(T)}
    weighed = swinging(**both, **moving, **forces)
    assert default_names(PRIOR, [weighed], "motion") == [
        *damped, *biases, "x_friction", "payload_mass",
    ]  # fmt: skip
    aimed = swinging(**both, **moving, x_setpoint_m=moving["x_m"])
    assert default_names(PRIOR, [aimed], "motion") == [*damped, *biases, "x_lag"]
    held = default_names(PRIOR, [aimed], "hold")
    assert held == [*damped, "phi_bias", "theta_bias", "x_stiffness", "x_damping"]


def test_devices_are_bounded_by_what_drives_can_do() -> None:
    crane = PRIOR.crane
    hoist = crane.layout.index("l")
    offset = parameter(PRIOR, "l_offset")
    reach = 0.25 * (crane.upper[hoist] - crane.lower[hoist])
    assert (offset.low, offset.start, offset.high) == pytest.approx((-reach, 0.0, reach))
    friction = parameter(PRIOR, "x_friction")
    limit = float(crane.effort_limit[1])
    assert (friction.low, friction.high, friction.unit) == (0.0, limit, "N")
    mass = parameter(PRIOR, "payload_mass")
    assert (mass.start, mass.low, mass.high) == pytest.approx((1000.0, 1.0, math.inf))
