"""Paths of the load: the way that was asked for, the rope along gravity and the acceleration of the
load, and what is refused.

The smoothstep is the regularised incomplete beta function I_s(5, 5), the distribution of the mean
of nine uniform numbers, which SciPy computes by other means than a polynomial.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import betainc

from cranedyn.dynamics.equations_of_motion import payload_position, pivot_position
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.references import flat
from cranedyn.references.flat import cruise, smoothstep
from tests.helpers import G, crane

DURATION = 12.0
"""Of the moves [s]: slew, trolley and hoist at once, fast enough for 0.1 rad of swing."""

PIVOT_HEIGHT = 28.0
"""Of the crane of this project [m]."""


def gone(s: float) -> float:
    """The share of the way that is behind the load at a share of the time."""
    return float(betainc(5.0, 5.0, np.clip(s, 0.0, 1.0)))


def point_load() -> Crane:
    return crane(payload_inertia=0.0, dummy_mass=0.0, dummy_inertia=0.0, damp_swing=0.0)


def oscillation_depth(inertia_over_mass: float, length: float) -> float:
    """Depth of the centre of oscillation below the pivot [m]."""
    return length + inertia_over_mass / length


def path(t: float, inertia_over_mass: float) -> np.ndarray:
    """The path from 10 m to 20 m on the jib over 1.2 rad, hoisted from 15 m to 10 m of cable, by
    the words of `flat`: straight in cylindrical coordinates about the slew axis [m].
    """
    share = gone(t / DURATION)
    gamma = 1.2 * share
    radius = 10.0 + 10.0 * share
    first, last = (oscillation_depth(inertia_over_mass, length) for length in (15.0, 10.0))
    depth = first + (last - first) * share
    # The jib of this crane points along -Y at zero slew.
    return np.array([radius * np.sin(gamma), -radius * np.cos(gamma), PIVOT_HEIGHT - depth])


@pytest.mark.parametrize(
    ("of", "inertia_over_mass"),
    # The default load, a tonne: 400 kg m² of its own; the links between the swing joints add 100
    # about one of them and 50 about the other.
    [(point_load(), 0.0), (crane(), 0.475)],
    ids=["point load", "load with inertia"],
)
def test_the_centre_of_oscillation_takes_the_path_and_the_rope_points_along_its_pull(
    of: Crane, inertia_over_mass: float
) -> None:
    motion = flat(of, of.state(x=10.0, l=15.0), of.state(gamma=1.2, x=20.0, l=10.0), DURATION)
    assert not motion.v[[0, -1]].any() and not motion.a[[0, -1]].any()
    step = 3e-3
    for k in range(100, 2400, 97):
        t = k * motion.period
        length = motion.q[k, 4]
        pivot = pivot_position(of, motion.q[k])
        load = payload_position(of, motion.q[k])
        along_rope = (pivot - load) / np.linalg.norm(pivot - load)
        found = pivot - along_rope * oscillation_depth(inertia_over_mass, length)
        # A spline of seventh degree through samples 5 ms apart rounds at 1e-15 of 30 m.
        np.testing.assert_allclose(found, path(t, inertia_over_mass), rtol=0.0, atol=1e-9)
        before, now, after = (path(t + h, inertia_over_mass) for h in (-step, 0.0, step))
        pull = (before - 2.0 * now + after) / step**2 + [0.0, 0.0, G]
        # Fourth derivatives of the path are below 2 m/s⁴, of which h²/12 counts: 1.5e-6
        # m/s²; the term of Coriolis is up to 0.4 m/s².
        aside = np.cross(along_rope, pull)
        np.testing.assert_allclose(aside, 0.0, rtol=0.0, atol=2e-6)


def test_drives_take_a_load_over_more_than_half_a_turn_without_a_jump() -> None:
    of = point_load()
    motion = flat(of, of.state(gamma=-1.0, x=12.0), of.state(gamma=4.0, x=12.0), 40.0)
    # Samples of the path: 5 rad with at most 630/256 times the mean speed, in 5 ms.
    assert np.abs(np.diff(motion.q[:, 0])).max() < 5.0 * (630.0 / 256.0) / 40.0 * 5.1e-3
    assert motion.q[[0, -1], 0] == pytest.approx([-1.0, 4.0], abs=1e-9)


def test_rates_are_the_smoothsteps_of_a_beta_function() -> None:
    s = np.linspace(-0.2, 1.2, 58)  # none at an end, where the fourth derivative has a kink
    np.testing.assert_allclose(smoothstep(s), [gone(share) for share in s], atol=1e-14)
    h = 1e-4
    for order in range(1, 5):
        slopes = (smoothstep(s + h, order - 1) - smoothstep(s - h, order - 1)) / (2.0 * h)
        # A central difference errs by h²/6 of the third derivative beyond, 1e5 for the last.
        np.testing.assert_allclose(smoothstep(s, order), slopes, rtol=1e-4, atol=2e-3)


@pytest.mark.parametrize(("duration", "ramp"), [(20.0, 3.0), (8.0, 4.0)])
def test_a_cruise_gains_its_speed_in_a_ramp_keeps_it_and_loses_it(
    duration: float, ramp: float
) -> None:
    speed = 1.0 / (duration - ramp)  # since a ramp covers half of what its time would at speed

    def rate(t: float) -> float:
        return speed * min(gone(t / ramp), gone((duration - t) / ramp))

    for t in np.linspace(-1.0, duration + 1.0, 45):
        ends = np.clip([0.0, ramp, duration - ramp, duration], 0.0, max(t, 0.0))
        way = sum(quad(rate, *piece, epsabs=1e-12)[0] for piece in pairwise(ends))
        assert cruise(np.array([t]), duration, ramp)[0] == pytest.approx(way, abs=1e-9)
        assert cruise(np.array([t]), duration, ramp, 1)[0] == pytest.approx(rate(t), abs=1e-12)
        ahead, behind = (cruise(np.array([t + h]), duration, ramp, 1)[0] for h in (1e-5, -1e-5))
        slope = (ahead - behind) / 2e-5
        assert cruise(np.array([t]), duration, ramp, 2)[0] == pytest.approx(slope, abs=1e-8)


def test_a_load_that_would_fall_faster_than_gravity_or_hangs_on_no_cable_is_refused() -> None:
    of = crane()
    low = of.state(l=25.0)
    # 20 m in 3 s: the smoothstep accelerates by 7.5 times the way over the square of the time,
    # 17 m/s², for a part of the time only.
    with pytest.raises(OutOfRange, match=r"duration is 3\.0 s; .* slacken the rope"):
        flat(of, of.state(l=5.0), low, 3.0)
    assert flat(of, of.state(l=5.0), low, 6.0).arrival == 6.0
    for length in (0.0, -5.0, np.nan, np.inf):
        nowhere = of.state(l=5.0)
        nowhere.q[of.layout.index("l")] = length
        for ends in ((nowhere, low), (low, nowhere)):
            with pytest.raises(OutOfRange):
                flat(of, *ends, 6.0)


@pytest.mark.parametrize("ramp", [0.0, 4.01, 8.0, np.nan, np.inf])
def test_a_ramp_longer_than_half_of_the_time_is_refused(ramp: float) -> None:
    of = crane()
    with pytest.raises(OutOfRange, match="ramp is"):
        flat(of, of.state(), of.state(x=12.0), 8.0, ramp=ramp)
