"""What a wind limit takes from simulated lifts, by hand; and lifts that failed, which keep no
limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.dynamics.equations_of_motion import payload_position, pivot_position
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.judging import wind_limit as wind_limit_module
from cranedyn.lifts.judging.chart import Chart, RatedLoads
from cranedyn.lifts.judging.wind_limit import (
    _FAILED,
    WindLimit,
    _enter_values,
    _limits,
    _with_weaker,
    wind_limit,
)
from cranedyn.model.crane import Crane
from tests.helpers import crane
from tests.lifts.judging.test_loads import pinocchio_wrench

CHART = Chart(
    "by hand",
    "",
    (
        RatedLoads(2, np.array([10.0, 20.0]), np.array([4000.0, 2000.0]), 2.0),
        RatedLoads(4, np.array([10.0, 20.0]), np.array([6000.0, 3000.0]), 2.0),
    ),
)
"""At 16 m 2500 kg on two falls, and 3750 kg on four."""

NAMES = ("utilisation", "swing", "clearance")


def lifts(of: Crane, *states: list[State], **changes: Any) -> Any:
    """Lifts that hang at rest under a hoist that holds them, as those that were simulated."""
    q, v = (np.array([[getattr(state, name) for state in run] for run in states]) for name in "qv")
    effort = np.zeros((*q.shape[:2], 3))
    effort[:, :, 2] = -of.payload_mass * of.gravity
    made = {
        "rows": np.arange(len(states)),
        "valid_until": np.full(len(states), np.inf),
        "least": np.linspace(3.0, 1.0, len(states)),
        "force": np.zeros((*q.shape[:2], 3 * len(of.points))),
        **changes,
    }
    batch = SimpleNamespace(q=q, v=v, effort=effort, valid_until=made.pop("valid_until"))
    return SimpleNamespace(crane=of, batch=batch, **made)


def noted(perturbed: Any, count: int, falls: int | None = None) -> dict[str, np.ndarray]:
    """The values of so many lifts, of which those of `perturbed` are entered."""
    values = {name: np.full(count, -1.0) for name in NAMES}
    _enter_values(values, perturbed, CHART, falls)
    return values


POINT = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}


@pytest.mark.parametrize(("falls", "used"), [(None, 0.8), (2, 0.8), (4, 2000.0 / 3750.0)])
def test_a_lift_takes_of_the_chart_and_swings_as_in_its_worst_row(
    falls: int | None, used: float
) -> None:
    of = crane(payload_mass=2000.0, **POINT)
    hanging = of.state(x=16.0, l=10.0)
    out = of.state(x=12.0, l=10.0)
    leaning = of.state(x=12.0, l=10.0, phi=0.2, theta=-0.3)
    found = noted(lifts(of, [out, hanging, out], [out, out, leaning]), 2, falls)
    assert found["utilisation"][0] == pytest.approx(used, rel=1e-9)
    # At 12 m the chart has a third more, and a load that leans pulls down by less than its weight.
    assert found["utilisation"][1] < 0.76 * used
    rope = payload_position(of, leaning.q) - pivot_position(of, leaning.q)
    angle = math.acos(-rope[2] / np.linalg.norm(rope))
    assert found["swing"] == pytest.approx([0.0, angle], abs=1e-9)
    assert found["clearance"].tolist() == [3.0, 1.0]


def test_what_the_wind_does_to_the_pull_of_a_load_with_inertia_counts_against_the_chart() -> None:
    """It turns a load that leans, by a force across the rope, as Pinocchio has it."""
    of = crane(payload_mass=2000.0, payload_inertia=8000.0)
    leaning = of.state(x=16.0, l=10.0, phi=0.3)
    force = np.zeros((1, 1, 6))
    force[0, 0, 0:2] = 3e3, 6e3
    made = lifts(of, [leaning], force=force)
    hoist = of.layout.index("l")
    pulls = [
        -pinocchio_wrench(of, leaning, made.batch.effort[0, 0], wind, hoist)[0][2]
        for wind in (force[0, 0], 0.0 * force[0, 0])
    ]
    assert abs(pulls[0] / pulls[1] - 1.0) > 2e-3
    used = noted(made, 1)["utilisation"][0]
    # The chart has a moment of 40 t m at the radius of the hook.
    rated = 40e3 / np.hypot(*payload_position(of, leaning.q)[:2])
    assert used == pytest.approx(pulls[0] / (of.gravity * rated), rel=1e-9)
    made.batch.effort[0, 0, 2] *= 1.1
    assert noted(made, 1)["utilisation"][0] > 1.05 * used


def test_a_lift_that_left_the_chart_uses_a_million_times_of_it() -> None:
    of = crane(payload_mass=2000.0, **POINT)
    inside = of.state(x=16.0, l=10.0)
    outside = of.state(x=20.5, l=10.0)
    within = of.state(x=2.0, l=10.0)
    within.q[of.layout.index("x")] = 1.9
    found = noted(lifts(of, [inside, outside], [within, inside]), 2)
    assert found["utilisation"].tolist() == [_FAILED, _FAILED]
    assert found["swing"] == pytest.approx([0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize(
    "failure", ["a row that is no number", "a model that ended", "no least distance"]
)
def test_a_lift_that_failed_stays_as_it_was_and_the_others_are_counted(failure: str) -> None:
    of = crane(payload_mass=2000.0, **POINT)
    hanging = of.state(x=16.0, l=10.0)
    made = lifts(of, *[[hanging, hanging]] * 3, rows=np.array([4, 2, 0]))
    if failure == "a row that is no number":
        made.batch.q[1, 1, 3] = np.nan
    elif failure == "a model that ended":
        made.batch.valid_until[1] = 12.0
    else:
        made.least[1] = np.nan
    found = noted(made, 5)
    for name in NAMES:
        assert found[name][[1, 2, 3]].tolist() == [-1.0] * 3, name
        assert (found[name][[0, 4]] >= 0.0).all(), name
    assert found["clearance"][[4, 0]].tolist() == [3.0, 1.0]


def test_at_each_speed_the_worst_of_all_lifts_counts() -> None:
    rng = np.random.default_rng(0)
    speeds = np.repeat([4.0, 12.0, 8.0], 5)
    rows = np.column_stack([speeds, rng.random((15, 3)), rng.random((15, 3))])
    allowed = dict.fromkeys(NAMES, 0.5)
    found = _limits(rows, allowed)
    assert found.speeds.tolist() == [4.0, 8.0, 12.0] and found.lifts == 15
    for column, name in enumerate(NAMES, 4):
        extreme = min if name == "clearance" else max
        expected = [extreme(rows[speeds == speed, column]) for speed in found.speeds]
        assert found.worst[name].tolist() == expected
    rows[7, 5] = np.nan
    broken = _limits(rows, {**allowed, "swing": 2.0})  # more than any other
    assert not broken.kept("swing")[broken.speeds == speeds[7]].any()


def test_a_gust_that_breaks_a_limit_is_among_all_stronger_ones() -> None:
    """Few gusts are tried beyond the speed at which a limit breaks, so that they may seem to keep
    it.
    """
    worst = {
        "utilisation": np.array([0.2, 0.6, 0.4]),
        "swing": np.array([0.1, 0.2, np.nan]),
        "clearance": np.array([1.0, 0.1, 0.5]),
    }
    found = _with_weaker(WindLimit(np.array([4.0, 8.0, 12.0]), worst, dict.fromkeys(NAMES, 0.5), 9))
    assert found.worst["utilisation"].tolist() == [0.2, 0.6, 0.6]
    assert found.worst["clearance"].tolist() == [1.0, 0.1, 0.1]
    assert found.kept("swing").tolist() == [True, True, False]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, _FAILED, -_FAILED])
def test_no_limit_is_kept_by_a_lift_that_failed_or_a_number_that_is_none(bad: float) -> None:
    for name in NAMES:
        # Each on its side of infinity: a clearance, and a utilisation, that look like good ones.
        looks_good = bad > 0.0 if name == "clearance" else bad < 0.0
        values = {one: np.array([0.5, 0.5]) for one in NAMES}
        values[name] = np.array([0.5, bad])
        found = WindLimit(np.array([4.0, 8.0]), values, dict.fromkeys(NAMES, 0.5), 2)
        assert found.limit(name) == (8.0 if looks_good else 4.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"swing": math.nan}, "swing is nan"),
        ({"swing": -0.1}, "swing is -0.1 rad"),
        ({"swing": 5.0}, "swing is 5.0 rad"),
        ({"share": 1.2}, "share of the rated load is 1.2; allowed is 0 to 1"),
        ({"count": 0}, "number of lifts is 0"),
        ({"count": 2.5}, "number of lifts is 2.5"),
        ({"seed": -1}, "seed is -1"),
        ({"falls": 3}, "There is no number of falls '3'"),
    ],
)
def test_what_is_no_limit_is_refused_before_any_lift(change: dict[str, Any], words: str) -> None:
    motion = SimpleNamespace(arrival=30.0)
    site = SimpleNamespace(distance=0.5)
    planned = SimpleNamespace(
        clearance=SimpleNamespace(site=site), timed=SimpleNamespace(motion=motion)
    )
    certificate: Any = SimpleNamespace(lift=planned)
    with pytest.raises(CraneError, match=words):
        wind_limit(certificate, CHART, **change)


def stand_in_certificate(distance: float = 0.65, arrival: float = 40.0) -> Any:
    """Return what the search for the worst gust asks of a certificate: a lift on 20 m of rope."""
    planned = SimpleNamespace(
        clearance=SimpleNamespace(
            site=SimpleNamespace(distance=distance), cable=lambda q: np.full(len(q), 20.0)
        ),
        timed=SimpleNamespace(motion=SimpleNamespace(arrival=arrival)),
        crane=SimpleNamespace(gravity=9.81),
    )
    return SimpleNamespace(lift=planned, run=SimpleNamespace(q=np.zeros((2, 5))))


def by_hand(
    monkeypatch: pytest.MonkeyPatch, clearance: Callable[[dict[str, np.ndarray]], Any]
) -> list[dict[str, np.ndarray]]:
    """Put a function of the gusts in the place of simulated lifts; return the list of all gusts
    that are tried, which grows.
    """
    tried: list[dict[str, np.ndarray]] = []

    def simulated(_: object, gusts: dict[str, np.ndarray], **__: object) -> list[Any]:
        tried.append(gusts)
        return [gusts]

    def note(values: dict[str, np.ndarray], gusts: dict[str, np.ndarray], *_: object) -> None:
        values["clearance"][:] = clearance(gusts)
        values["utilisation"][:] = 0.5
        values["swing"][:] = 0.01

    monkeypatch.setattr(wind_limit_module, "simulate_perturbed", simulated)
    monkeypatch.setattr(wind_limit_module, "controller_of", lambda *_, **__: None)
    monkeypatch.setattr(wind_limit_module, "_enter_values", note)
    monkeypatch.setattr(wind_limit_module._Trial, "nearest", lambda *_: None)
    return tried


def test_gusts_are_tried_over_the_whole_lift_from_every_side_and_limits_are_the_sites(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = by_hand(monkeypatch, lambda _: 0.7)
    found = wind_limit(stand_in_certificate(), CHART, 4, swing=0.07, count=400)
    assert found.allowed == {"utilisation": 1.0, "swing": 0.07, "clearance": 0.65}
    assert found.limit() == 28.0 and found.drawn == 400
    # A period of the swing is 9.0 s: four starts in each, and both ends.
    starts = np.unique(tried[0]["gust_at_s"])
    assert starts[0] == 0.0 and starts[-1] == 40.0 and np.diff(starts).max() <= 9.0 / 4.0
    assert np.unique(tried[0]["gust_lasts_s"]).tolist() == [3.0, 6.0, 9.0, 12.0]
    turns = np.unique(tried[0]["direction_rad"])
    np.testing.assert_allclose(np.diff(turns), math.pi / 4.0)
    assert len(tried[0]["gust_at_s"]) == len(starts) * 4 * 8
    # The whole grid at the limit, and 400 that are drawn: 0.9^400 is the chance to miss a tenth.
    at_limit = [gusts for gusts in tried if (gusts["wind_m_s"] + gusts["gust_m_s"] == 28.0).all()]
    assert found.at_limit >= sum(len(gusts["gust_at_s"]) for gusts in at_limit)
    drawn = at_limit[-1]
    assert len(drawn["gust_at_s"]) == 400
    for name, low, high in (
        ("gust_at_s", 0.0, 40.0),
        ("gust_lasts_s", 3.0, 12.0),
        ("direction_rad", -math.pi, math.pi),
    ):
        tenth = (high - low) / 10.0
        assert low <= drawn[name].min() < low + tenth and high - tenth < drawn[name].max() <= high
    for gusts in tried:
        assert (gusts["load"] == 1.0).all()
        assert not gusts["cable_m"].any() and not gusts["late_s"].any()
        assert gusts["gust_at_s"].min() >= 0.0 and gusts["gust_at_s"].max() <= 40.0
        assert gusts["gust_lasts_s"].min() >= 3.0 and gusts["gust_lasts_s"].max() <= 12.0


def test_more_gusts_never_raise_the_limit_and_lower_it_where_the_grid_misses_the_worst(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A gust that is bad in a corner of the ranges alone, which no gust of the grid is near."""

    def clearance(gusts: dict[str, np.ndarray]) -> np.ndarray:
        in_corner = np.abs(gusts["gust_at_s"] - 1.0) < 0.6
        in_corner &= np.abs(gusts["gust_lasts_s"] - 4.5) < 1.2
        speed = gusts["wind_m_s"] + gusts["gust_m_s"]
        return np.where(in_corner & (speed > 6.5), 0.1, 12.65 - speed)

    by_hand(monkeypatch, clearance)
    limits = []
    shares = []
    for count in (1, 2, 8, 32, 128, 512):
        found = wind_limit(stand_in_certificate(), CHART, count=count)
        limits.append(found.limit())
        shares.append(found.largest_share)
    assert limits == sorted(limits, reverse=True)
    assert limits[0] == 12.0 and limits[-1] == 6.0
    # None of n: 1 - 0.05^(1/n).
    np.testing.assert_allclose(shares[:3], [0.95, 1.0 - 0.05**0.5, 1.0 - 0.05**0.125])


def test_the_search_finds_the_worst_gust_between_those_of_the_grid(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A smooth worst case between the gusts of the grid: these alone have 15.5 m/s as a limit."""
    tried = by_hand(monkeypatch, _smooth)
    found = wind_limit(stand_in_certificate(), CHART, count=1)
    assert found.interval() == (14.0, 15.0)
    # No gust is tried twice at a speed, so that each one that is counted is another one.
    names = ("wind_m_s", "gust_at_s", "gust_lasts_s", "direction_rad")
    columns = [np.concatenate([gusts[name] for gusts in tried]) for name in names]
    assert len(np.unique(np.column_stack(columns), axis=0)) == found.lifts
    # One number is drawn, so that it is not chance that found it.
    assert len(tried[-1]["gust_at_s"]) == 1


def _smooth(gusts: dict[str, np.ndarray]) -> np.ndarray:
    """Return a clearance that is least for a gust at 21.2 s of 7.5 s from 22.5°."""
    speed = gusts["wind_m_s"] + gusts["gust_m_s"]
    worst = np.cos(2.0 * math.pi * (gusts["gust_at_s"] - 21.2) / 9.0)
    worst *= np.exp(-(((gusts["gust_lasts_s"] - 7.5) / 4.0) ** 2))
    worst *= np.cos(gusts["direction_rad"] - math.pi / 8.0)
    return 15.15 - speed * worst


def test_a_lift_of_which_nothing_is_told_keeps_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of its simulations failed."""
    monkeypatch.setattr(wind_limit_module, "simulate_perturbed", lambda *_, **__: [])
    monkeypatch.setattr(wind_limit_module, "controller_of", lambda *_, **__: None)
    found = wind_limit(stand_in_certificate(), CHART, count=4)
    assert found.drawn == 0 and found.largest_share == 1.0
    assert found.limit() == 0.0 and found.interval()[0] == 0.0
    for name in NAMES:
        assert found.limit(name) == 0.0
    with pytest.raises(OutOfRange):
        CHART.on().at(found.worst["utilisation"])
