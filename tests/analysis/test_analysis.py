"""Known swings go in with noise, and come out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from cranedyn.analysis.swing import (
    SwingFit,
    agreement,
    fit_power_law,
    fit_swing,
    peaks,
    zero_crossings,
)

T = np.arange(0.0, 60.0, 0.005)


@pytest.mark.slow
@given(
    st.floats(1.5, 12),
    st.floats(-0.005, 0.02),
    st.floats(1e-3, 1),
    st.floats(0, 6.28),
    st.floats(-0.2, 0.2),
    st.floats(-20, 100),
)
def test_a_swing_without_noise_is_recovered(
    period: float, ratio: float, size: float, phase: float, offset: float, since: float
) -> None:
    true = SwingFit(period, ratio, size, phase, size * offset, 0.0)
    t = T + since
    y = true(t)
    fit = fit_swing(t, y)
    assert fit.period == pytest.approx(period, rel=1e-7)  # the tolerance of the least squares, 1e-8
    assert fit.damping_ratio == pytest.approx(ratio, abs=1e-7)
    assert_allclose(fit(t), y, atol=1e-6 * np.abs(y).max())
    assert fit.offset == pytest.approx(size * offset, abs=1e-6 * np.abs(y).max())
    assert fit.rms < 1e-6 * np.abs(y).max()


def test_a_noisy_swing_is_recovered_within_the_cramer_rao_bound() -> None:
    true = SwingFit(7.796, 0.00021, 0.0986, 1.0, 0.002, 0.0)
    sigma = 0.003
    rng = np.random.default_rng(7)
    fit = fit_swing(T, true(T) + sigma * rng.normal(size=len(T)))
    bound = sigma / true.amplitude / math.sqrt(len(T))  # of a phase, up to a factor
    omega = 2.0 * math.pi / true.period
    # five times the standard deviations √24, √24, √2 (at mid record), 1 of frequency, decay,
    # amplitude, offset
    assert abs(fit.period / true.period - 1) < 5 * math.sqrt(24) * bound / (omega * 60.0)
    assert abs(fit.damping_ratio - true.damping_ratio) < 5 * math.sqrt(24) * bound / (omega * 60.0)
    assert abs(fit.amplitude_at(30.0) / true.amplitude_at(30.0) - 1) < 5 * math.sqrt(2) * bound
    assert abs(fit.offset - true.offset) < 5 * sigma / math.sqrt(len(T))
    assert fit.rms == pytest.approx(sigma, rel=5 / math.sqrt(2 * len(T)))


@given(st.floats(0.5, 5), st.floats(0.1, 3))
def test_zero_crossings_are_found_between_samples(period: float, phase: float) -> None:
    t = np.arange(0.0, 10.0, 0.01)
    omega = 2.0 * math.pi / period
    n = np.arange(-5, 50)
    expected = ((n + 0.5) * math.pi - phase) / omega
    expected = expected[(expected > 0.02) & (expected < 9.97)]
    found = zero_crossings(t, np.cos(omega * t + phase))
    found = found[(found > 0.02) & (found < 9.97)]
    assume(len(found) == len(expected))
    # Linear interpolation where the curvature is zero: (ω dt)² dt / 16.
    assert_allclose(found, expected, atol=omega**2 * 0.01**3)


def test_a_sample_on_zero_is_one_crossing() -> None:
    assert zero_crossings(np.arange(5.0), np.array([2.0, 1.0, 0.0, -1.0, -2.0])).tolist() == [2.0]
    assert zero_crossings(np.arange(3.0), np.array([1.0, 2.0, 3.0])).tolist() == []


def test_peaks_are_found_between_samples_with_their_heights() -> None:
    t = np.arange(0.0, 30.0, 0.01)
    omega = 2.0 * math.pi / 3.3
    phase = 0.4
    when, height = peaks(t, 0.2 * np.exp(-0.01 * t) * np.cos(omega * t + phase))
    # derivative zero: tan(ωt + phase) = -0.01/ω
    n = np.arange(1, 1 + len(when))
    expected = (n * math.pi - phase - math.atan(0.01 / omega)) / omega
    # Parabola through three samples: order (ω dt)² dt.
    assert_allclose(when, expected, atol=omega**2 * 0.01**3)
    assert_allclose(
        height,
        0.2 * np.exp(-0.01 * expected) * math.cos(math.atan(0.01 / omega)),
        rtol=(omega * 0.01) ** 4,
    )


@given(st.floats(-3, 3), st.floats(0.01, 100))
def test_a_power_law_is_recovered(exponent: float, factor: float) -> None:
    x = np.linspace(3.0, 25.0, 9)
    law = fit_power_law(x, factor * x**exponent)
    assert law.exponent == pytest.approx(exponent, abs=1e-12)  # rounding
    assert law.factor == pytest.approx(factor, rel=1e-11)
    assert law.points == 9
    assert_allclose(law(x), factor * x**exponent, rtol=1e-11)


def test_a_noisy_power_law_has_the_coefficient_of_determination_of_its_scatter() -> None:
    rng = np.random.default_rng(3)
    x = np.linspace(8.0, 20.0, 400)
    law = fit_power_law(x, 0.3 * x**-0.75 * np.exp(0.1 * rng.normal(size=400)))
    spread = np.std(np.log(x))
    assert abs(law.exponent + 0.75) < 5 * 0.1 / (spread * 20.0)  # five standard deviations
    signal = (0.75 * spread) ** 2
    # Five standard deviations of some 1e-2.
    assert law.r2 == pytest.approx(signal / (signal + 0.01), abs=0.06)


def test_agreement_is_amplitudes_correlation_and_rms() -> None:
    t = np.arange(0.0, 2.0 * math.pi, 1e-3)
    same = agreement(0.05 * np.sin(t), 0.04 * np.sin(t + 0.1))
    # closed forms over a whole period; the last sample misses it by 1e-3
    assert same.measured == pytest.approx(0.05, rel=1e-6)
    assert same.modelled == pytest.approx(0.04, rel=1e-6)
    assert same.correlation == pytest.approx(math.cos(0.1), abs=1e-3)
    assert same.rms == pytest.approx(
        math.sqrt((0.05**2 + 0.04**2 - 2 * 0.05 * 0.04 * math.cos(0.1)) / 2), rel=1e-3
    )
    assert same.relative == pytest.approx(same.rms / 0.05, rel=1e-6)
    assert agreement(np.sin(t), -np.sin(t)).correlation == pytest.approx(-1.0, abs=1e-12)
