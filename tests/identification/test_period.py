"""A record is judged by its own period, and a crane that cannot swing so is refused by name."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cranedyn.errors import DataError
from cranedyn.identification import Prior, Record
from cranedyn.identification.period import possible_periods, recorded_period
from cranedyn.theory import point_period

PRIOR = Prior()
T = np.arange(0.0, 60.0, 0.02)


@pytest.mark.parametrize("period", [1.1, 3.7, 7.8, 20.0])
def test_the_period_of_a_swing_or_its_rate_is_that_of_its_spectrum(period: float) -> None:
    omega = 2.0 * math.pi / period
    swing = 0.1 * np.exp(-0.01 * T) * np.cos(omega * T + 0.4)
    noise = 2e-3 * np.random.default_rng(1).standard_normal(len(T))
    # three periods under Hann's window: the parabola is off by a few per cent of a bin
    assert recorded_period(T, swing + noise, is_rate=False) == pytest.approx(period, rel=0.01)
    # A gyroscope drifts, and feels a vibration that hardly moves the load.
    vibration = 0.1 * omega * np.cos(2.0 * math.pi * 5.0 * T)
    rate = np.gradient(swing, T) + noise + 1e-3 * T + vibration
    assert recorded_period(T, rate, is_rate=True) == pytest.approx(period, rel=0.01)


def test_no_period_is_told_where_none_dominates_or_too_little_was_recorded() -> None:
    noise = np.random.default_rng(2).standard_normal(len(T))
    assert recorded_period(T, noise, is_rate=False) is None
    slow = np.cos(2.0 * math.pi / 40.0 * T)
    assert recorded_period(T, slow, is_rate=False) is None
    assert recorded_period(T, np.ones(len(T)), is_rate=False) is None


def test_periods_of_a_crane_range_over_its_cable() -> None:
    """A rigid pendulum of inertia I is fastest on sqrt(I / m), where it takes that of twice it."""
    crane = PRIOR.crane
    found = possible_periods(crane, crane.start.q, 5.75)
    inertia = 400.0 + 50.0  # of the load and of the link of the tangential swing
    fastest = point_period(2.0 * math.sqrt(inertia / 1000.0), crane.gravity)
    # the grid of lengths has steps of 17 %
    assert found.shortest == pytest.approx(fastest, rel=0.03)
    longest = float(point_period(26.4 + 5.75, crane.gravity))
    assert found.longest == pytest.approx(longest, rel=0.01)


def laboratory(duration: float = 30.0) -> dict[str, np.ndarray]:
    """A laboratory pendulum of 0.3 m."""
    t = np.arange(0.0, duration, 0.01)
    swing = 0.1 * np.exp(-0.01 * t) * np.cos(2.0 * math.pi / 1.099 * t)
    return {"t_s": t, "phi_rad": swing, "l_m": np.full(len(t), 0.3)}


@pytest.mark.parametrize("values", [{}, {"payload_mass": 0.2}])
def test_a_crane_that_cannot_swing_in_the_period_of_a_record_is_refused_with_its_inertias(
    values: dict[str, object],
) -> None:
    mass = values.get("payload_mass", 1000)
    with pytest.raises(DataError) as caught:
        Record.of(Prior(values=values).crane, laboratory(), name="lab.csv")
    message = str(caught.value)
    assert "lab.csv: phi_rad swings in 1.1 s, but the crane with a load of" in message
    assert f"a load of {mass} kg and 400 kg m² and links of 50, 50 kg m²" in message
    assert "--set payload_mass:=… payload_inertia:=… dummy_mass:=… dummy_inertia:=…" in message


def test_a_record_is_long_enough_by_its_own_period() -> None:
    """13 periods of its swing, of which a load on 20 m would not make two."""
    values = {"payload_mass": 0.2, "payload_inertia": 1e-5, "dummy_mass": 1e-4}
    prior = Prior(values={**values, "dummy_inertia": 1e-6, "hoist_init": 20.0})
    record = Record.of(prior.crane, laboratory())
    assert record.judged_period == pytest.approx(1.099, rel=0.01)
    assert not any("swings in" in note for note in record.notes)
    without_cable = {name: column for name, column in laboratory(14.0).items() if name != "l_m"}
    record = Record.of(prior.crane, without_cable)
    assert record.duration < 2.0 * record.swing_period
    (note,) = (note for note in record.notes if "swings in" in note)
    assert "phi_rad swings in 1.1 s, but the crane with a load of 0.2 kg and 1e-05 kg m²" in note


def test_a_slow_swing_of_moving_drives_is_not_held_against_the_crane() -> None:
    t = np.arange(0.0, 200.0, 0.1)
    slow = {"t_s": t, "phi_rad": 0.05 * np.sin(2.0 * math.pi / 40.0 * t)}
    with pytest.raises(DataError, match=r"swings in 40 s, .* only in 11\.\d s or less"):
        Record.of(PRIOR.crane, slow)
    driven = {**slow, "x_m": 12.0 + np.sin(2.0 * math.pi / 40.0 * t)}
    assert Record.of(PRIOR.crane, driven).recorded_period == pytest.approx(40.0, rel=0.01)
