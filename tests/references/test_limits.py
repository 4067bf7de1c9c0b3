"""Limits of the drives: what a motion uses of them by statics, dynamics and closed forms of its
path, and which numbers are no limits.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Setpoint
from cranedyn.model.load import load_crane
from cranedyn.references import hanging_reference, hold, pulse, ramp, shortest, spline
from cranedyn.references.limits import Limits, fastest, use
from cranedyn.references.motion import Motion, motion_efforts
from cranedyn.references.simple import Spline
from cranedyn.references.tabulated import locate, locate_many, tabulated
from tests.helpers import G, crane

WIDE = Limits((10.0, 10.0, 10.0), (10.0, 10.0, 10.0))
"""More than any of these motions needs."""

# Masses of the crane of this project.
MASS = 1000.0
"""Mass of the load [kg]."""

TROLLEY = 500.0
"""Mass of the trolley [kg]."""

LINKS = 100.0
"""Mass of the links between the swing joints [kg]."""


def accelerated(gamma: float = 0.0, trolley: float = 0.0, hoist: float = 0.0) -> Motion:
    """One row: drives that accelerate from rest at 12 m, with the load plumb on 10 m of cable."""
    q = np.array([[0.3, 12.0, 0.0, 0.0, 10.0]])
    a = np.array([[gamma, trolley, 0.0, 0.0, hoist]])
    return Motion(5e-3, q, 0.0 * q, a, crane().layout.drives)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_efforts_are_mass_times_acceleration_and_weight_whichever_way_a_drive_goes(
    sign: float,
) -> None:
    of = crane()
    # A plumb load that does not swing goes with its trolley. Of slewing: 1e6 kg m² of the crane;
    # load, trolley and links at 12 m with their inertia about the vertical.
    inertia = 1e6 + (MASS + TROLLEY + LINKS) * 12.0**2 + 400.0 + 50.0 + 2.0 * 50.0
    for motion, name, effort, largest in (
        (accelerated(gamma=0.02 * sign), "slew", inertia * 0.02, 1e6),
        (accelerated(trolley=0.4 * sign), "trolley", (MASS + TROLLEY + LINKS) * 0.4, 1e6),
        (accelerated(hoist=0.5 * sign), "hoist", MASS * (G - 0.5 * sign), 1e5),
    ):
        shares = use(of, motion, WIDE)
        assert shares[f"effort of the {name}"] == pytest.approx(effort / largest, rel=1e-12)
        asked = {"slew": 0.02, "trolley": 0.4, "hoist": 0.5}[name] / 10.0
        assert shares[f"acceleration of the {name}"] == pytest.approx(asked, rel=1e-12)


def test_efforts_overcome_the_friction_of_the_drives() -> None:
    of = crane(damp_slew=2e4, damp_trolley=3e3, damp_hoist=1e3)
    q = np.array([[0.0, 12.0, 0.0, 0.0, 10.0]])
    for drive, rate, friction in ((0, 0.1, 2e3), (1, -0.5, -1.5e3), (4, 0.4, 400.0)):
        v = np.zeros_like(q)
        v[0, drive] = rate
        motion, still = (
            Motion(5e-3, q, speed, 0.0 * q, of.layout.drives) for speed in (v, 0.0 * v)
        )
        added = motion_efforts(of, motion)[0] - motion_efforts(crane(), motion)[0]
        expected = np.zeros(3)
        expected[[0, 1, 4].index(drive)] = friction
        np.testing.assert_allclose(added, expected, rtol=0.0, atol=1e-9 * 1e4)
        assert np.abs(motion_efforts(of, still)[0, :2]).max() < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("drive", [0, 1, 2])
def test_a_motion_uses_of_rate_and_acceleration_what_its_quintic_has(
    drive: int, sign: float
) -> None:
    """10 s³ - 15 s⁴ + 6 s⁵ is fastest in the middle, by 15/8, and accelerates most at s = ½ ± √3/6,
    by 10/√3.
    """
    of = crane()
    duration = 8.0
    way = (0.4, 3.0, 2.0)[drive]
    point = np.array([0.0, 10.0, 15.0])
    point[drive] += sign * way
    reference = spline(of, of.state(x=10.0, l=15.0), [point.tolist()], [duration])
    motion = hanging_reference(of, reference, duration, 5e-3)
    limits = Limits((0.5, 4.0, 3.0), (0.1, 0.7, 0.9))
    shares = use(of, motion, limits)
    name = ("slew", "trolley", "hoist")[drive]
    rate = 15.0 / 8.0 * way / duration
    acceleration = 10.0 / math.sqrt(3.0) * way / duration**2
    # Rows 5 ms apart miss a peak by less than the square of their share of the duration.
    assert shares[f"rate of the {name}"] == pytest.approx(rate / limits.rates[drive], rel=1e-5)
    assert shares[f"acceleration of the {name}"] == pytest.approx(
        acceleration / limits.accelerations[drive], rel=1e-5
    )


def test_the_shortest_section_is_that_of_the_drive_that_needs_most() -> None:
    of = crane()
    start = crane().state(x=10.0, l=15.0)
    rates = (1.0, 8.0, 4.0)
    accelerations = (0.02, 0.3, 0.2)
    # By accelerations: each drive needs √(10/√3 · way / limit).
    needs = {
        drive: math.sqrt(10.0 / math.sqrt(3.0) * way / limit)
        for drive, way, limit in ((0, 0.3, 0.02), (1, 2.0, 0.3), (2, 5.0, 0.2))
    }
    for moving in ((0,), (1,), (2,), (0, 1), (1, 2), (0, 1, 2)):
        point = np.array([0.0, 10.0, 15.0])
        for drive in moving:
            point[drive] -= (0.3, 2.0, 5.0)[drive]
        (found,) = shortest(of, start, [point.tolist()], rates=rates, accelerations=accelerations)
        assert found == pytest.approx(max(needs[drive] for drive in moving), rel=1e-12)
    # By the rates: 15/8 · way / limit.
    for slow, expected in (((0.01, 8, 4), 56.25), ((1, 0.05, 4), 75.0), ((1, 8, 0.1), 93.75)):
        (found,) = shortest(of, start, [(0.3, 12.0, 10.0)], rates=slow, accelerations=accelerations)
        assert found == pytest.approx(expected, rel=1e-12)


def test_the_fastest_duration_is_the_root_of_the_first_limit() -> None:
    of = crane()
    start = of.state(x=10.0, l=15.0)

    def plan(way: float, duration: float) -> Motion:
        reference = spline(of, start, [(0.0, 10.0 + way, 15.0)], [duration])
        return hanging_reference(of, reference, duration, duration / 200.0)

    limits = Limits((1.0, 0.8, 0.8), (0.1, 0.3, 0.3))
    for way in (8.0, 1.0, 0.05, -8.0):
        expected = max(
            brentq(lambda t, w=way: 15.0 / 8.0 * abs(w) / t - 0.8, 1e-3, 1e3),
            brentq(lambda t, w=way: 10.0 / math.sqrt(3.0) * abs(w) / t**2 - 0.3, 1e-3, 1e3),
        )
        # Found to a thousandth of a second, and a thousandth added.
        assert fastest(of, lambda t, w=way: plan(w, t), limits) == pytest.approx(expected, abs=2e-3)
    assert fastest(of, lambda t: plan(0.0, t), limits) == 0.25
    # The weight alone is more than this hoist can hold, however slow.
    weak = load_crane(hoist_effort=9000.0)
    rest = weak.state(x=10.0, l=15.0)
    with pytest.raises(OutOfRange, match="some duration up to 3600 s keeps them"):
        fastest(
            weak,
            lambda t: hanging_reference(
                weak, spline(weak, rest, [(0.0, 12.0, 15.0)], [t]), t, t / 20.0
            ),
            limits,
        )


def test_the_load_of_a_hanging_reference_stretches_its_rope_in_every_row() -> None:
    """By m g l/EA, as Hooke says."""
    of = load_crane(rope_stiffness=2e6, gravity=G)
    reference = spline(of, of.state(x=10.0, l=15.0), [(0.0, 12.0, 10.0)], [5.0])
    motion = hanging_reference(of, reference, 5.0)
    stretch = motion.q[:, of.layout.index("rope_stretch")]
    length = motion.q[:, of.layout.index("l")]
    np.testing.assert_allclose(stretch, 1000.0 * G * length / 2e6, rtol=1e-9)


@pytest.mark.parametrize("duration", [2.0, 2.5, 3.0])
def test_a_hanging_reference_covers_its_duration_and_ends_at_rest(duration: float) -> None:
    """Whatever the reference does there: a ramp, and a spline in the middle of its way."""
    of = crane()
    start = of.state(x=10.0, l=15.0)
    for reference in (
        ramp(of, hold(of, start), "x", 5.0, rate=0.5, at=1.0),
        spline(of, start, [(0.1, 12.0, 13.0)], [5.0]),
    ):
        motion = hanging_reference(of, reference, duration)
        assert motion.arrival == pytest.approx(duration, abs=1e-12)
        assert not motion.v[-1].any()
        assert not motion.a[-1].any()
        before = reference(duration - motion.period)
        np.testing.assert_allclose(motion.v[-2, motion.drives], before.velocity, atol=1e-12)
        np.testing.assert_allclose(motion.a[-2, motion.drives], before.acceleration, atol=1e-12)
        for answer in (motion(duration), motion(duration + 1.0)):
            np.testing.assert_allclose(answer.position, reference(duration).position, atol=1e-12)
            assert not answer.velocity.any()
            assert not answer.acceleration.any()


# --- rows ----------------------------------------------------------------------------------------


@given(st.floats(-2.0, 12.0), st.sampled_from([0.1, 0.25, 1.0]))
def test_between_rows_is_where_a_straight_line_says(t: float, period: float) -> None:
    table = np.array([3.0, -1.0, 4.0, 1.0, -5.0, 9.0])
    row, share = locate(t, period, len(table))
    rows, shares = locate_many(np.array([t]), period, len(table))
    expected = np.interp(t, period * np.arange(len(table)), table)
    for index, part in ((row, share), (int(rows[0]), float(shares[0]))):
        assert 0 <= index < len(table)
        assert 0.0 <= part < 1.0
        there = table[index] + (part * (table[index + 1] - table[index]) if part else 0.0)
        # A time within 1e-6 of a period of a row counts as that of the row; steps up to 14.
        assert there == pytest.approx(expected, abs=2e-5)


def test_a_motion_moves_from_its_first_row_to_its_last_and_stands_still_beyond() -> None:
    """Both ends are counted, though it moves there."""
    v = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    motion = Motion(0.5, 0.1 * v, v, -v, np.array([1, 0]))
    for t, row in ((0.0, 0), (0.5, 1), (1.0, 2)):
        for answer in (motion(t), Setpoint(*(part[0] for part in motion.at(np.array([t]))))):
            assert answer.velocity.tolist() == v[row, ::-1].tolist()
            assert answer.acceleration.tolist() == (-v[row, ::-1]).tolist()
    for t, row in ((-1e-3, 0), (1.001, 2)):
        for answer in (motion(t), Setpoint(*(part[0] for part in motion.at(np.array([t]))))):
            assert not answer.velocity.any()
            assert not answer.acceleration.any()
            assert answer.position == pytest.approx(0.1 * v[row, ::-1])
    assert motion.arrival == 1.0


def test_nobody_moves_a_reference_that_holds_by_writing_to_its_answer() -> None:
    reference = hold(crane(), crane().start)
    for part in reference(0.0):
        with pytest.raises(ValueError, match="read-only"):
            part[0] = 7.0


@pytest.mark.parametrize("drives", [[0, 1, 1], [0, 1, 5], [-1, 0, 1], [0.5, 1, 2], [], [np.nan]])
def test_drives_of_a_motion_are_different_columns_of_it(drives: list[float]) -> None:
    rows = np.zeros((2, 5))
    with pytest.raises(OutOfRange, match="drives of a motion"):
        Motion(0.1, rows, rows, rows, np.array(drives))


def test_a_motion_of_other_drives_is_refused() -> None:
    rows = np.zeros((2, 5))
    with pytest.raises(OutOfRange, match=r"the drives \[0, 1, 3\]"):
        use(crane(), Motion(0.1, rows, rows, rows, np.array([0, 1, 3])), WIDE)


# --- what is no number ---------------------------------------------------------------------------

IMPOSSIBLE = [math.nan, math.inf, -math.inf, -1.0, -0.0, 0.0, -1e308, -5e-324]
"""None of these is a limit: not finite, or not above zero."""


@pytest.mark.parametrize(("value", "drive"), [*product(IMPOSSIBLE, range(3))])
def test_a_limit_that_is_not_finite_and_above_zero_is_refused(value: float, drive: int) -> None:
    good = [0.1, 0.5, 0.4]
    bad = [*good[:drive], value, *good[drive + 1 :]]
    for rates, accelerations in ((bad, good), (good, bad)):
        with pytest.raises(OutOfRange, match="limit"):
            Limits(rates, accelerations)
        with pytest.raises(OutOfRange, match="limit"):
            shortest(
                crane(),
                crane().start,
                [(0.1, 12.0, 10.0)],
                rates=rates,
                accelerations=accelerations,
            )


@pytest.mark.parametrize(
    ("rates", "accelerations"),
    [((1.0, 1.0, 1.0), (1.0, 1.0)), ((1.0, 1.0), (1.0, 1.0)), (1.0, 1.0), (((1.0,),), ((1.0,),))],
)
def test_limits_are_one_number_for_each_drive(rates: object, accelerations: object) -> None:
    with pytest.raises(OutOfRange):
        use(crane(), accelerated(), Limits(rates, accelerations))  # type: ignore[arg-type]


def test_limits_of_one_length_for_rates_and_another_for_accelerations_are_refused_at_once() -> None:
    with pytest.raises(OutOfRange, match="acceleration limits"):
        Limits((1.0, 1.0, 1.0), (1.0, 1.0))


ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True) | st.sampled_from(
    [math.nan, math.inf, -math.inf, -0.0, 5e-324, -5e-324, 1e308, -1e308, 1.7976931348623157e308]
)
"""Any double, and often one of the worst."""


@given(st.lists(ANY, min_size=6, max_size=6), st.integers(0, 8), ANY)
def test_no_motion_is_within_limits_by_a_number_that_is_not_finite(
    limits: list[float], column: int, value: float
) -> None:
    """Rates and accelerations of 1, and one of them whatever it is: within the limits is only what
    is by exact comparison.
    """
    of = crane()
    q = np.array([[0.3, 12.0, 0.0, 0.0, 10.0]])
    table = np.array([[1.0, 1.0, 0.0, 0.0, 1.0]] * 3)
    table[column // 3, of.layout.drives[column % 3]] = value
    q[0] = table[2] if column >= 6 else q[0]
    with np.errstate(all="ignore"):
        try:
            shares = use(
                of,
                Motion(1.0, q, table[:1], table[1:2], of.layout.drives),
                Limits(limits[:3], limits[3:]),
            )
        except CraneError:
            return
    kept = Limits(limits[:3], limits[3:])
    for i, name in enumerate(("slew", "trolley", "hoist")):
        for kind, row, bound in (("rate", 0, kept.rates), ("acceleration", 1, kept.accelerations)):
            share = shares[f"{kind} of the {name}"]
            if share <= 1.0:
                assert abs(table[row, of.layout.drives[i]]) <= bound[i] * (1.0 + 1e-12)


@pytest.mark.parametrize("rate", [1e200, 1e308])
def test_efforts_that_overflow_are_no_efforts_within_limits(rate: float) -> None:
    """Of a load that swings so fast the drives stand still: only their efforts are no numbers."""
    of = crane()
    q = np.array([[0.3, 12.0, 0.1, 0.0, 10.0]])
    swinging = Motion(1.0, q, rate * np.eye(5)[[2]], 0.0 * q, of.layout.drives)
    with np.errstate(all="ignore"):
        with pytest.raises(OutOfRange, match="effort of the"):
            use(of, swinging, WIDE)
        with pytest.raises(OutOfRange, match="some duration up to 3600 s"):
            fastest(of, lambda t: swinging, WIDE)


@given(st.lists(ANY, min_size=6, max_size=6), st.lists(ANY, min_size=3, max_size=3))
def test_no_section_is_short_by_a_number_that_is_not_finite(
    limits: list[float], point: list[float]
) -> None:
    of = crane()
    with np.errstate(all="ignore"):
        try:
            (duration,) = shortest(
                of, of.start, [point], rates=limits[:3], accelerations=limits[3:]
            )
        except CraneError:
            return
    way = np.abs(np.subtract(point, of.start.q[of.layout.drives]))
    with np.errstate(all="ignore"):
        needed = 15.0 / 8.0 * way / np.minimum(limits[:3], of.rate_limit)
    assert not duration < needed.max() * (1.0 - 1e-12)


@given(ANY, ANY, ANY)
def test_no_reference_moves_by_a_number_that_is_not_finite(
    by: float, rate: float, at: float
) -> None:
    of = crane()
    start = hold(of, of.start)
    makers = (
        lambda: ramp(of, start, "x", by, rate=rate, at=at),
        lambda: pulse(of, start, "x", by, at=at, width=rate),
        lambda: Spline(np.array([at, rate]), np.array([[0.0, by, 1.0], [0.0, 1.0, by]])),
    )
    for make in makers:
        with np.errstate(all="ignore"):
            try:
                answer = tabulated(make(), np.array([0.0, 1.0, 1e3]), 3)
            except CraneError:
                continue
        assert all(np.isfinite(part).all() for part in answer)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_a_setpoint_that_is_not_finite_is_refused_at_once_and_in_tables(
    part: int, bad: float
) -> None:
    class Broken:
        """Answers one number that is none, from 1 s on."""

        def __call__(self, t: float) -> Setpoint:
            arrays = [np.array([0.0, 10.0, 15.0]), np.zeros(3), np.zeros(3)]
            if t >= 1.0:
                arrays[part][1] = bad
            return Setpoint(*arrays)

    class Tabled(Broken):
        """The same for many times at once."""

        def at(self, times: np.ndarray) -> Setpoint:
            rows = [self(t) for t in times.tolist()]
            return Setpoint(*(np.array(column) for column in zip(*rows, strict=True)))

    times = np.array([0.0, 1.0])
    for reference in (Broken(), Tabled()):
        with pytest.raises(OutOfRange, match="of the setpoint"):
            tabulated(reference, times, 3)
        with pytest.raises(OutOfRange, match="of the setpoint"):
            hanging_reference(crane(), reference, 2.0)
