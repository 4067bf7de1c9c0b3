"""Input shapers against the linear oscillator that they are made for, damped and with several
frequencies.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.references import ei, hold, pulse, ramp, shaped, shaped_hoisting, zv, zvd
from cranedyn.references.shaped import Shaper
from cranedyn.references.tabulated import tabulated
from tests.helpers import G, big_crane, crane


def vibration(shaper: Shaper, damping: float, ratio: float = 1.0) -> float:
    """What impulses leave of an oscillator, over what one of them all leaves at their last: of its
    damped period a fraction apart, and of a true frequency that is a ratio of it.
    """
    damped = 2.0 * math.pi * ratio
    decay = damping / math.sqrt(1.0 - damping**2) * damped
    last = shaper.fractions[-1]
    left = shaper.amplitudes * np.exp((-decay + 1j * damped) * (last - shaper.fractions))
    return float(abs(left.sum()))


@pytest.mark.parametrize("damping", [0.0, 0.05, 0.3, 0.8])
def test_a_shaper_leaves_nothing_of_a_damped_swing_and_the_whole_of_the_way(damping: float) -> None:
    for shaper, fractions in ((zv(damping), [0.0, 0.5]), (zvd(damping), [0.0, 0.5, 1.0])):
        assert shaper.fractions.tolist() == fractions
        assert shaper.amplitudes.sum() == pytest.approx(1.0)
        assert (shaper.amplitudes > 0.0).all()
        assert vibration(shaper, damping) == pytest.approx(0.0, abs=1e-12)
    # ZV's grows in proportion to an error of the frequency, that of ZVD by its square.
    one, two = (vibration(zv(damping), damping, 1.0 + e) for e in (1e-4, 2e-4))
    assert two / one == pytest.approx(2.0, rel=1e-2)
    one, two = (vibration(zvd(damping), damping, 1.0 + e) for e in (1e-4, 2e-4))
    assert two / one == pytest.approx(4.0, rel=1e-2)


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.2])
def test_an_insensitive_shaper_leaves_its_tolerance_in_the_middle_and_less_beside_it(
    tolerance: float,
) -> None:
    shaper = ei(tolerance)
    assert vibration(shaper, 0.0) == pytest.approx(tolerance, abs=1e-12)
    assert float(shaper.residual(1.0)) == pytest.approx(tolerance, abs=1e-12)
    beside = [vibration(shaper, 0.0, 1.0 + e) for e in np.linspace(-0.12, 0.12, 49)]
    assert max(beside) <= max(tolerance, 0.04) + 1e-12


@pytest.mark.parametrize("periods", [[2.0], [1.0, 3.0], [1.0, 3.0, 5.0]])
def test_a_step_comes_in_the_parts_of_one_shaper_after_the_other(periods: list[float]) -> None:
    of = crane()
    shaper = zv(0.3)
    start = hold(of, of.state(x=10.0, l=15.0))
    step = pulse(of, start, "x", 1.0, at=1.0, width=1e3)
    found = shaped(step, shaper, periods if len(periods) > 1 else periods[0])
    early, late = shaper.amplitudes
    parts: dict[float, float] = {}
    for choices in product((0, 1), repeat=len(periods)):
        delay = sum(0.5 * period for chosen, period in zip(choices, periods, strict=True) if chosen)
        share = math.prod(late if chosen else early for chosen in choices)
        parts[delay] = parts.get(delay, 0.0) + share
    for t in np.linspace(0.0, 7.0, 71) + 0.013:
        there = 10.0 + sum(share for delay, share in parts.items() if t >= 1.0 + delay)
        assert found(float(t)).position[1] == pytest.approx(there, abs=1e-12)


@pytest.mark.parametrize("period", [7, np.int64(7), np.float32(7.0), np.array(7.0), [7.0]])
def test_a_period_is_a_number_of_any_kind(period: float) -> None:
    delays = shaped(hold(crane()), zv(), period).delays  # type: ignore[attr-defined]
    assert delays.tolist() == [0.0, 3.5]


def test_on_a_cable_that_keeps_its_length_both_shapers_are_one() -> None:
    """The one for a moving cable counts angles of a swing with g/l, and l is constant here."""
    of = big_crane()
    start = of.state(x=10.0, l=15.0)
    base = ramp(of, hold(of, start), "x", 2.0, rate=0.5, at=1.0)
    period = 2.0 * math.pi * math.sqrt(15.0 / G)
    times = np.linspace(0.0, 16.0, 97)
    for shaper in (zv(), zvd(0.1), ei()):
        fixed = shaped(base, shaper, period)
        moving = shaped_hoisting(of, base, shaper, 6.0)
        # A spline through samples 5 ms apart rounds the corners of a ramp of 0.5 m/s.
        places = [tabulated(one, times).position for one in (moving, fixed)]
        np.testing.assert_allclose(*places, rtol=0.0, atol=1.5e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -0.1, 1.0])
def test_a_damping_ratio_that_is_none_is_refused(bad: float) -> None:
    for make in (zv, zvd):
        with pytest.raises(OutOfRange, match="damping ratio is"):
            make(bad)


@given(st.floats(allow_nan=True, allow_infinity=True) | st.sampled_from([-0.0, 5e-324, 1e308]))
def test_no_command_is_shaped_by_a_period_that_is_no_time(period: float) -> None:
    of = crane()
    base = ramp(of, hold(of, of.start), "x", 1.0, rate=0.5, at=1.0)
    for periods in (period, [2.0, period]):
        try:
            found = shaped(base, zv(), periods)(3.0)
        except CraneError:
            assert not (math.isfinite(period) and period > 0.0)
            continue
        assert all(np.isfinite(part).all() for part in found)
        assert math.isfinite(period)
        assert period > 0.0


@pytest.mark.parametrize("length", [0.0, -3.0, math.nan])
def test_a_cable_of_no_length_shapes_nothing(length: float) -> None:
    of = crane()
    start = of.state(x=10.0, l=5.0)
    start.q[of.layout.index("l")] = 5.0
    away = length - 5.0
    with pytest.raises(CraneError):
        shaped_hoisting(of, pulse(of, hold(of, start), "l", away, at=1.0, width=1.0), zv(), 5.0)
