"""Factors of the standards: their published numbers, and the mechanics behind them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cranedyn import theory
from cranedyn.errors import CraneError
from cranedyn.lifting import factors, wind

PUBLISHED: list[tuple[str, Callable[[], float], float]] = [
    ("φ1, least", lambda: factors.phi_1()[0], 0.9),
    ("φ1, most", lambda: factors.phi_1(0.05)[1], 1.05),
    ("φ2,min of HC1", lambda: factors.phi_2_least("HC1"), 1.05),
    ("φ2,min of HC4", lambda: factors.phi_2_least("HC4"), 1.20),
    ("φ2,min of HC4 with HD3", lambda: factors.phi_2_least("HC4", "HD3"), 1.05),
    ("φ2,min of HC3 with HD5", lambda: factors.phi_2_least("HC3", "HD5"), 1.05),
    ("φ2 of HC1 at 0.5 m/s", lambda: factors.phi_2("HC1", 0.5), 1.135),
    ("φ2 of HC2 at 0.5 m/s", lambda: factors.phi_2("HC2", 0.5), 1.27),
    ("φ2 of HC3 at 1 m/s", lambda: factors.phi_2("HC3", 1.0), 1.66),
    ("φ2 of HC4 at 1 m/s", lambda: factors.phi_2("HC4", 1.0), 1.88),
    ("v_h of HD1", lambda: factors.pick_up_speed("HD1", 1.0, 0.1), 1.0),
    ("v_h of HD2", lambda: factors.pick_up_speed("HD2", 1.0, 0.1), 0.1),
    ("v_h of HD3", lambda: factors.pick_up_speed("HD3", 1.0, 0.1), 0.1),
    ("v_h of HD4", lambda: factors.pick_up_speed("HD4", 1.0, 0.1), 0.5),
    ("v_h of HD5", lambda: factors.pick_up_speed("HD5", 1.0, 0.1), 0.0),
    ("φ3, rapid release of a third", lambda: factors.phi_3(1.0 / 3.0), 1.0 / 3.0),
    ("φ3, slow release of half", lambda: factors.phi_3(0.5, factors.SLOW_RELEASE), 0.25),
    ("φ6", lambda: factors.phi_6(1.3), 1.15),
    ("ψ_h at μ = 3", lambda: factors.psi_h(3.0), 2.309401),
    # A public table prints 2.082 here, which its own formula does not give.
    ("ψ_h at μ = 1.5", lambda: factors.psi_h(1.5), 2.041241),
    ("ψ_h at μ = 0.5", lambda: factors.psi_h(0.5), 2.0),
    ("ψ_h, regulated, β = 1/4", lambda: factors.psi_h_regulated(0.25), math.sqrt(2.0)),
    ("ψ_h, regulated, β = 1/6", lambda: factors.psi_h_regulated(1.0 / 6.0), 1.0),
    ("ψ_h, regulated, β = 3", lambda: factors.psi_h_regulated(3.0), 2.0),
    ("stopping of 0.8 rpm by 0.02 rad/s²", lambda: factors.stopping(0.8 * math.pi / 30, 0.02)[0],
     0.175460),
    ("its way at 40 m", lambda: 40.0 * factors.stopping(0.8 * math.pi / 30, 0.02)[0], 7.018),
    ("its time", lambda: factors.stopping(0.8 * math.pi / 30, 0.02)[1], 4.1888),
    ("stroke of a buffer at 2 m/s", lambda: factors.buffer_stroke(2.0), 0.196),
    ("and where that is frequent",
     lambda: factors.buffer_stroke(2.0, factors.BUFFER_FREQUENT), 0.392),
    ("pressure at 28.5 m/s", lambda: wind.wind_pressure(28.5), 507.65625),
    ("speed of 250 Pa", lambda: wind.speed_of_pressure(250.0), 20.0),
    ("height factor at 10 m", lambda: wind.height_factor(10.0), 1.4),
    ("height factor at 100 m", lambda: wind.height_factor(100.0), 10.0**0.14 + 0.4),
    ("storm of 50 years", lambda: wind.out_of_service_speed(10.0, 40.0), 56.0),
    ("its pressure", lambda: wind.wind_pressure(wind.out_of_service_speed(10.0, 40.0)), 1960.0),
    ("storm of 5 years", lambda: wind.out_of_service_speed(10.0, 40.0, 5), 45.64),
    ("force on 10 m²", lambda: wind.wind_force(250.0, 10.0), 2500.0),
    ("lean of 1 t in it", lambda: wind.wind_lean(2500.0, 1000.0, 10.0), math.atan(0.25)),
    ("lean in a gust", lambda: wind.gust_lean(2500.0, 1000.0, 10.0), 2.0 * math.atan(0.25)),
]  # fmt: skip
"""Printed in the sources, or worked out from the formula by hand."""


@pytest.mark.parametrize(("name", "call", "value"), PUBLISHED, ids=[one[0] for one in PUBLISHED])
def test_a_formula_gives_what_is_published(
    name: str, call: Callable[[], float], value: float
) -> None:
    # Digits as printed.
    assert call() == pytest.approx(value, rel=1e-4, abs=1e-12), name


def test_wind_in_service_has_the_pressures_of_its_classes() -> None:
    pressures = [wind.wind_pressure(speed) for speed in wind.IN_SERVICE.values()]
    # The standard rounds its pressures to 125, 250 and 500 Pa.
    np.testing.assert_allclose(pressures, [125.0, 250.0, 500.0], rtol=0.025)
    assert list(wind.RECURRENCE.values()) == [0.815, 0.873, 0.946, 1.0]
    assert sorted(wind.OPERATING.values()) == [12.0, 16.5, 20.0]


def test_hoisting_classes_are_hoists_of_these_frequencies() -> None:
    found = [factors.hoist_frequency(one.slope) for one in factors.HOISTING.values()]
    np.testing.assert_allclose(found, [0.265, 0.531, 0.796, 1.061], atol=5e-4)
    speed, omega = 0.4, 2.0 * math.pi * found[2]
    assert theory.pickup_factor(speed, omega, 9.80665) == pytest.approx(1.0 + 0.51 * speed)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 1.5, 3.0, 10.0])
def test_psi_h_is_the_worst_of_all_durations_of_a_carriage_braked_by_a_constant_force(
    ratio: float,
) -> None:
    """Carriage and linear pendulum of unit frequency, integrated; then the carriage stands."""
    times = np.linspace(0.0, 2.0 * math.pi, 4001)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        # Load and carriage, ahead of their free flight; the pull between them is their distance.
        pull = ratio * (y[0] - y[1])
        return np.array([y[2], y[3], -pull / ratio, pull - (1.0 + ratio)])

    y = solve_ivp(rates, (0.0, times[-1]), np.zeros(4), t_eval=times, rtol=1e-10, atol=1e-12).y
    swing, rate = y[0] - y[1], y[2] - y[3]
    # The mean deceleration is 1, the pull over the mass of the load is the swing.
    # Steps of 1.6e-3 in phase miss a maximum by less than their square.
    assert np.hypot(swing, rate).max() == pytest.approx(factors.psi_h(ratio), rel=1e-5)


@pytest.mark.parametrize("periods", [0.0, 0.25, 0.6034, 1.0, 1.7])
def test_a_part_let_go_slowly_leaves_less_of_a_bounce(periods: float) -> None:
    omega, last = 2.0 * math.pi, max(periods, 1e-6)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        return np.array([y[1], omega**2 * (min(t / last, 1.0) - y[0])])

    y = solve_ivp(rates, (0.0, last), np.zeros(2), rtol=1e-10, atol=1e-12, max_step=0.01).y[:, -1]
    left = math.hypot(y[0] - 1.0, y[1] / omega)
    assert left == pytest.approx(factors.release_beta(periods), abs=1e-6)
    assert factors.release_beta(0.6034) == pytest.approx(factors.SLOW_RELEASE, abs=1e-4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: factors.phi_1(0.2), "a is 0.2; allowed is 0 to 0.1"),
        (lambda: factors.phi_2("HC9", 1.0), "hoisting is HC9; allowed is HC1 or HC2"),  # type: ignore[arg-type]
        (lambda: factors.phi_2("HC1", -1.0), "hoisting speed is -1.0 m/s"),
        (lambda: factors.pick_up_speed("HD2", 0.5, 0.6), "creep speed is 0.6 m/s"),
        (lambda: factors.phi_3(1.5), "share is 1.5; allowed is 0 to 1"),
        (lambda: factors.psi_h(0.0), "mass_ratio is 0.0; allowed is > 0"),
        (lambda: factors.psi_h_regulated(math.nan), "periods is nan"),
        (lambda: factors.stopping(1.0, 0.0), "deceleration is 0.0"),
        (lambda: factors.buffer_stroke(1.0, 6.0), "deceleration is 6.0 m/s²"),
        (
            lambda: wind.out_of_service_speed(10.0, 40.0, 7),
            "years of recurrence is 7; allowed is 5",
        ),
        (lambda: wind.height_factor(0.0), "height is 0.0 m; allowed is > 0"),
        (lambda: wind.wind_lean(1.0, 0.0, 9.8), "mass is 0.0 kg"),
    ],
)
def test_what_no_formula_is_for_is_a_sentence(call: Callable[[], float], words: str) -> None:
    with pytest.raises(CraneError) as caught:
        call()
    assert words in str(caught.value)
