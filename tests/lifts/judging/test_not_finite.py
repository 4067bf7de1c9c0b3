"""No load, factor or utilisation is small by a number that is not finite, or by an overflow."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.lifts.judging import factors, wind_standards
from cranedyn.lifts.judging.chart import (
    CHARTS,
    Chart,
    RatedLoads,
    Reeving,
    cut_outs,
    read_chart,
    utilisation,
)
from cranedyn.lifts.judging.loads import Loads, corner_forces, loads_of_rows
from cranedyn.lifts.judging.wrench import Wrench
from cranedyn.lifts.planning.site import Arm, Base
from tests.helpers import crane

WORST = [
    math.nan,
    math.inf,
    -math.inf,
    -0.0,
    5e-324,
    -5e-324,
    2.2e-308,
    1e308,
    -1e308,
    1.7976931348623157e308,
]
"""Not finite, of both zeros, denormal, and as large as a double can be."""

ANY = st.sampled_from(WORST) | st.floats(allow_nan=True, allow_infinity=True) | st.floats(-1e4, 1e4)
"""Any double, often one of the worst, and often one that is meant."""

CHART = Chart("test", "", (RatedLoads(2, np.array([10.0, 20.0]), np.array([4000.0, 2000.0]), 2.0),))


def rated(radius: float) -> float:
    """By hand: 4000 kg up to 10 m, then a moment of 40 000 kg m."""
    return 4000.0 if radius <= 10.0 else 40_000.0 / radius


@given(ANY)
def test_a_chart_answers_within_its_radii_and_nowhere_else(radius: float) -> None:
    if 2.0 <= radius <= 20.0:
        assert CHART.on().at(radius) == pytest.approx(rated(radius), rel=1e-12)
        return
    for one in (radius, np.array([radius]), np.array([12.0, radius, 15.0])):
        with pytest.raises(OutOfRange, match="radius on 2 falls"):
            CHART.on().at(one)


@given(
    st.lists(ANY, min_size=1, max_size=3),
    st.lists(ANY, min_size=1, max_size=3),
    ANY,
    ANY,
)
def test_no_chart_is_made_of_numbers_that_are_none(
    radii: list[float], loads: list[float], least: float, radius: float
) -> None:
    try:
        made = RatedLoads(2, np.array(radii), np.array(loads), least)
        found = made.at(radius)
    except CraneError:
        return
    assert 0.0 <= least <= radius <= radii[-1] <= 1e4
    assert min(loads) * (1.0 - 1e-12) <= found <= max(loads)
    assert 1e-3 <= min(loads)


@given(ANY, ANY)
@example(math.nan, 15.0)
@example(math.inf, 15.0)
@example(2000.0, math.nan)
def test_a_load_below_the_chart_is_one_by_exact_comparison(pull: float, radius: float) -> None:
    columns = {"pull_N": np.array([pull]), "radius_m": np.array([radius])}
    with np.errstate(all="ignore"):
        try:
            (used,) = utilisation(Loads(np.zeros(1), columns), CHART)
        except CraneError:
            return
    if used <= 1.0:
        assert 2.0 <= radius <= 20.0
        assert pull <= 9.80665 * rated(radius) * (1.0 + 1e-12)


@given(st.lists(ANY, min_size=1, max_size=4))
def test_a_limiter_acts_or_refuses_whatever_the_numbers_are(used: list[float]) -> None:
    try:
        found = cut_outs(np.arange(float(len(used))), np.array(used))
    except CraneError:
        assert not np.isfinite(used).all()
        return
    assert any(one.kind == "cut-out" for one in found) == any(u >= 1.0 for u in used)


@given(ANY, ANY)
def test_the_pull_of_a_line_is_never_less_than_a_share_of_the_tension(
    tension: float, rate: float
) -> None:
    try:
        (pull,) = Reeving(4, 0.9).line_pull(np.array([tension]), np.array([rate]))
    except CraneError:
        assert not (math.isfinite(tension) and math.isfinite(rate))
        return
    sheaves = [0.9**k for k in range(4)], [1.0] * 4, [0.9**-k for k in range(4)]
    of_all = sum(sheaves[0 if rate < 0.0 else 2 if rate > 0.0 else 1])
    assert pull == pytest.approx(tension / of_all, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("base", [None, Base(4.5, 6e4)], ids=["foot", "corners"])
@pytest.mark.parametrize(("value", "place"), [*product(WORST, range(11))])
def test_loads_of_impossible_rows_are_refused_or_finite(
    value: float, place: int, base: Base | None
) -> None:
    of = crane()
    q, v = of.state(x=12.0)
    rows = np.concatenate([q, v, [0.0, 0.0, -9810.0], np.zeros(6)])
    # slew, trolley, swing and cable; rates of slew, swing and cable; efforts; two forces
    rows[[0, 1, 2, 4, 5, 7, 9, 10, 12, 13, 18][place]] = value
    with np.errstate(all="ignore"):
        try:
            found = loads_of_rows(of, *np.split(rows[None], [5, 10, 13], axis=1), base=base)
        except CraneError:
            return
    assert math.isfinite(value)
    assert all(np.isfinite(column).all() for column in found.values())


@given(st.lists(ANY, min_size=6, max_size=6), ANY, ANY, ANY)
def test_no_corner_stands_by_a_number_that_is_not_finite(
    wrench: list[float], spacing: float, mass: float, gravity: float
) -> None:
    foot = Wrench(np.array([wrench[:3]]), np.array([wrench[3:]]), np.zeros((1, 3)))
    with np.errstate(all="ignore"):
        try:
            corners = corner_forces(Base(spacing, mass), foot, gravity)
        except CraneError:
            return
    assert np.isfinite([*wrench, spacing, mass, gravity]).all()
    assert np.isfinite(corners).all()
    assert spacing > 0.0
    assert mass >= 0.0
    assert gravity > 0.0


@pytest.mark.parametrize("value", WORST)
def test_what_a_site_weighs_is_finite_and_not_negative(value: float) -> None:
    allowed = math.isfinite(value) and value >= 0.0
    for make in (
        lambda: Base(4.5, value),
        lambda: Arm(value, 3.0),
        lambda: Base(value or 1.0, 6e4),
        lambda: Base(4.5, 6e4, value or 1.0),
    ):
        if allowed:
            make()
        else:
            with pytest.raises(OutOfRange):
                make()
    with nullcontext() if math.isfinite(value) else pytest.raises(OutOfRange):
        Arm(1.0, value)


@pytest.mark.parametrize("name", ["wind", "swing", "risk", "lifts", "gusts"])
@pytest.mark.parametrize("value", WORST)
def test_no_lift_is_required_to_bear_what_is_no_number(name: str, value: float) -> None:
    pytest.importorskip("coal", reason="extra planning (coal) is not installed")
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    from cranedyn.lifts.judging.analysis import Requirements

    try:
        made = Requirements(**{name: value})  # type: ignore[arg-type]
    except CraneError:
        return
    assert name in ("wind", "swing", "risk")  # a number of lifts is a whole one
    assert math.isfinite(getattr(made, name))
    assert getattr(made, name) >= 0.0


Function = Callable[..., Any]

SAFE: dict[str, tuple[Function, int, float]] = {
    # Function, number of its arguments, and the least that it may answer.
    "phi_2": (lambda v: factors.phi_2("HC1", v), 1, 1.05),
    "phi_6": (factors.phi_6, 1, 0.5),
    "psi_h": (factors.psi_h, 1, 2.0),
    "psi_h_regulated": (factors.psi_h_regulated, 1, 0.0),
    "stopping": (lambda v, a: min(factors.stopping(v, a)), 2, 0.0),
    "buffer_stroke": (factors.buffer_stroke, 2, 0.0),
    "wind_pressure": (wind_standards.wind_pressure, 1, 0.0),
    "speed_of_pressure": (wind_standards.speed_of_pressure, 1, 0.0),
    "height_factor": (wind_standards.height_factor, 1, 0.4),
    "recurrence_factor": (wind_standards.recurrence_factor, 1, 0.5),
    "out_of_service_speed": (wind_standards.out_of_service_speed, 3, 0.0),
    "wind_force": (wind_standards.wind_force, 2, 0.0),
    "wind_lean": (lambda f, m, g: abs(wind_standards.wind_lean(f, m, g)), 3, 0.0),
    "gust_lean": (lambda f, m, g: abs(wind_standards.gust_lean(f, m, g)), 3, 0.0),
    "pick_up_speed": (lambda a, b: factors.pick_up_speed("HD2", a, b), 2, 0.0),
}


@given(st.sampled_from(sorted(SAFE)), st.lists(ANY, min_size=3, max_size=3))
def test_no_factor_is_made_of_a_number_that_is_not_finite(name: str, drawn: list[float]) -> None:
    function, count, least = SAFE[name]
    arguments = drawn[:count]
    with np.errstate(all="ignore"):
        try:
            found = function(*arguments)
        except CraneError:
            return
    assert np.isfinite(arguments).all()
    assert found >= least  # so it is a number; infinite it may be: nothing is below it


@pytest.mark.parametrize("name", SAFE)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_every_argument_of_a_factor_must_be_finite(name: str, bad: float) -> None:
    function, count, _ = SAFE[name]
    for place in range(count):
        arguments = [2.0] * count
        arguments[place] = bad
        with pytest.raises(OutOfRange):
            function(*arguments)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -1e-9, 1.0 + 1e-9])
def test_shares_of_a_load_are_from_none_to_all(bad: float) -> None:
    for function in (factors.phi_1, factors.phi_3, lambda beta: factors.phi_3(0.5, beta)):
        with pytest.raises(OutOfRange):
            function(bad)


def test_a_weight_that_overflows_leans_in_no_wind() -> None:
    with pytest.raises(OutOfRange, match="weight is inf"):
        wind_standards.wind_lean(1e3, 1e200, 1e200)
    with pytest.raises(OutOfRange, match="weight is 0"):
        wind_standards.wind_lean(1e3, 1e-200, 1e-200)


@pytest.mark.parametrize("name", ["laboratory", "mct88"])
def test_the_charts_that_come_with_it_hold_finite_numbers(name: str) -> None:
    for falls in read_chart(CHARTS / f"{name}.toml").reevings:
        assert np.isfinite(falls.at(falls.radii)).all()
