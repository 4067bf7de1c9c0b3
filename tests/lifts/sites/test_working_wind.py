"""The wind up to which cranes work: how far gusts swing loads, and that nothing meets below it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from cranedyn.disturbances.wind import steady
from cranedyn.errors import DataError, OutOfRange
from cranedyn.lifts.sites.crane_site import CraneSite, SiteWind
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from cranedyn.lifts.sites.guard import gentle, working_swing
from cranedyn.lifts.sites.plan import plan_site
from cranedyn.lifts.sites.site_simulation import SiteRun, simulate_site
from cranedyn.lifts.sites.working_wind import CALM, WorkingWind
from tests.lifts.sites.cases import BAD, site_of
from tests.lifts.sites.test_sites import Wild

slow = pytest.mark.slow

GUST = WorkingWind(gust=9.0, area=4.0)


def static_lean() -> float:
    """Return the lean of 1000 kg in 9 m/s: 0.5 · 1.25 kg/m³ · 4 m² · 81 m²/s² over its weight."""
    return 202.5 / (1000.0 * site_of().stations[0].crane.gravity)


def test_a_gust_swings_a_load_to_twice_its_static_lean() -> None:
    assert GUST.swing(site_of().stations[0].crane) == pytest.approx(2.0 * static_lean(), rel=1e-12)
    assert CALM.swing(site_of().stations[0].crane) == 0.0


@pytest.mark.parametrize("value", BAD[:3])
def test_a_wind_that_is_no_number_is_refused(value: float) -> None:
    for numbers in ((value, 4.0), (9.0, value), (-1.0, 4.0), (9.0, -4.0)):
        with pytest.raises(OutOfRange):
            WorkingWind(*numbers)


def largest_response(times: list[float], levels: list[float]) -> float:
    """Return the largest deflection of θ'' + θ = s(t) from rest, for s in straight lines."""
    run = solve_ivp(
        lambda t, y: [y[1], np.interp(t, times, levels) - y[0]],
        (0.0, times[-1] + 2.0 * math.pi),
        [0.0, 0.0],
        max_step=0.05,
        rtol=1e-8,
    )
    return float(np.abs(run.y[0]).max())


@slow
@given(
    spans=st.lists(st.floats(1e-3, 8.0), min_size=4, max_size=4),
    first=st.floats(0.0, 1.0),
    last=st.floats(0.0, 1.0),
)
def test_no_gust_that_rises_and_falls_once_swings_farther_than_twice_the_lean(
    spans: list[float], first: float, last: float
) -> None:
    times = np.concatenate([[0.0], np.cumsum(spans)]).tolist()
    assert largest_response(times, [0.0, first, 1.0, last, 0.0]) <= 2.0 + 1e-6


@slow
def test_a_wind_that_rises_at_once_and_stays_swings_to_twice_the_lean() -> None:
    assert largest_response([0.0, 1e-3, 9.0, 9.1], [0.0, 1.0, 1.0, 1.0]) == pytest.approx(
        2, abs=1e-3
    )


def operators_at_rest(count: int = 2) -> list:
    return [lambda t, states: np.zeros(3)] * count


@slow
def test_a_simulated_load_swings_to_twice_the_lean_in_a_sudden_wind() -> None:
    # 1.25 kg/m³ and a load of 1000 kg: drag of the moving load damps it by some percent.
    site = site_of()
    for speed, share in ((9.0, 1.0), (4.5, 0.25)):
        wind = SiteWind(steady(speed), direction=0.4, area=4.0)
        run = simulate_site(site, operators_at_rest(), duration=6.0, supervised=False, wind=wind)
        expected = 2.0 * share * static_lean()
        assert 0.93 * expected < run.swing.max() <= 1.001 * expected


@slow
def test_wind_blows_loads_in_its_direction_on_a_site_whose_cranes_are_turned() -> None:
    # Turns of 180° and 0° look alike from either side; those of this site are 270° and 90°.
    site = site_of("luffing_between")
    wind = SiteWind(steady(12.0), direction=0.7)
    run = simulate_site(site, operators_at_rest(3), duration=2.0, supervised=False, wind=wind)
    for i, station in enumerate(site.stations):
        _, rope, _ = station.rope(run.trajectories[i].q)
        moved = (rope[-1] - rope[0])[:2]
        assert math.atan2(moved[1], moved[0]) == pytest.approx(0.7, abs=0.02)


def gusty(t: float) -> float:
    """Return a wind that rises at once and falls at once, and stays for 20 s each time."""
    return 9.0 if t % 40.0 > 20.0 else 0.0


@slow
def test_wild_operators_in_gusts_up_to_the_entered_wind_keep_ropes_in_their_envelope() -> None:
    site = replace(site_of(), working_wind=GUST, swing=0.12)
    operators = [Wild(station, 7 + i) for i, station in enumerate(site.stations)]
    run = simulate_site(site, operators, duration=120.0, wind=SiteWind(gusty, 0.9, 4.0))
    assert not run.broken_assumptions and not run.contacts
    assert run.swing.max() <= site.swing and run.outside.max() <= 0.0
    assert run.least_distance >= site.distance
    assert run.swing.max() > 0.5 * site.swing
    assert min(np.ptp(path.q[:, 0]) for path in run.trajectories) > 0.1


@slow
def test_guards_stop_the_work_above_the_entered_wind_and_go_on_below() -> None:
    site = replace(site_of(), working_wind=GUST, swing=0.12)
    operators = [lambda t, states: np.array([0.0, 0.0, 0.3])] * 2
    run = simulate_site(
        site,
        operators,
        duration=20.0,
        anemometer=lambda t: math.nan if t < 2.0 else 9.5 if 8.0 <= t < 14.0 else 8.5,
    )
    rates = run.passed[0][:, 2]
    assert (rates[run.t < 2.0] == 0.0).all()
    assert rates[70] == pytest.approx(0.3)
    assert (rates[(run.t > 8.6) & (run.t < 13.9)] == 0.0).all()  # 0.3 m/s at 0.6 m/s²
    assert (run.boxes[0][82:139] == run.boxes[0][82]).all()
    assert rates[-1] == pytest.approx(0.3)


@slow
def test_wind_above_the_entered_stops_guards_that_read_it() -> None:
    site = replace(site_of(), working_wind=GUST, swing=0.12)
    operators = [lambda t, states: np.array([0.0, 0.0, 0.3])] * 2
    wind = SiteWind(lambda t: 9.1 if t >= 2.0 else 8.9)
    run = simulate_site(site, operators, duration=4.0, wind=wind)
    assert run.passed[0][15, 2] == pytest.approx(0.3) and (run.passed[0][30:, 2] == 0.0).all()


def test_an_anemometer_that_no_guard_reads_is_refused() -> None:
    with pytest.raises(OutOfRange, match="anemometer is given; allowed is none"):
        simulate_site(
            site_of(), operators_at_rest(), duration=1.0, supervised=False, anemometer=steady(1.0)
        )


@slow
@pytest.mark.parametrize(
    ("limit", "wind", "words"),
    [
        (CALM, None, ""),
        (CALM, SiteWind(steady(0.5)), "wind of up to 0.5 m/s, from 0.0 s on; the site states no"),
        (GUST, SiteWind(steady(9.0)), ""),
        (GUST, SiteWind(steady(-9.0)), ""),
        (GUST, SiteWind(lambda t: 9.0 + 0.1 * (t > 0.45)),
         "wind of up to 9.1 m/s, from 0.5 s on; the site states 9 m/s"),
        (GUST, SiteWind(steady(-9.1)), "of up to 9.1 m/s, from 0.0 s on; the site states 9 m/s"),
        (GUST, SiteWind(steady(3.0), area=5.0), "a drag area of 5 m²; the site states 4 m²"),
    ],
)  # fmt: skip
def test_a_run_says_that_its_wind_is_outside_of_what_the_site_assumes(
    limit: WorkingWind, wind: SiteWind | None, words: str
) -> None:
    site = replace(site_of(), working_wind=limit)
    run = simulate_site(site, operators_at_rest(), duration=1.0, wind=wind)
    assert len(run.broken_assumptions) == bool(words)
    assert words in "".join(run.broken_assumptions)
    assert ("outside of what the site assumes" in repr(run)) == bool(words)


@pytest.mark.slow
def test_a_run_says_all_in_which_its_wind_is_outside_of_what_the_site_assumes() -> None:
    site = replace(site_of(), working_wind=GUST)
    wind = SiteWind(steady(9.1), area=5.0)
    run = simulate_site(site, operators_at_rest(), duration=0.5, wind=wind)
    speed, area = run.broken_assumptions
    assert "wind of up to 9.1 m/s" in speed and "a drag area of 5 m²" in area


def tight(tmp_path: Path, extra: str) -> CraneSite:
    """Return a site on which a load can hang beside the tower of another crane."""
    text = (SITES / "two_towers.toml").read_text("utf-8")
    file = tmp_path / "site.toml"
    file.write_text(text.replace("swing = 6.0\n", f"{extra}\n"), "utf-8")
    return read_crane_site(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extra", "words"),
    [
        ("swing = 6.0\nwind = {gust = 22.0, area = 4.0}",
         r"line 5, \[site\] wind: swing of the load of north in gusts of 22 m/s is 14\.1 degrees"),
        ("swing = 6.0\nwind = 9.0", r"line 5, \[site\] wind: it must be a table"),
        ("wind = {gust = 9.0}", r"line 4, \[wind\] area: it is missing"),
        ("wind = {gust = -9.0, area = 4.0}", r"line 4, \[wind\] gust: .*allowed is >= 0"),
        ("wind = {gust = nan, area = 4.0}", r"line 4, \[wind\] gust"),
        ("wind = {gust = 9.0, area = 0.0}", r"line 4, \[wind\] area: .*allowed is > 0"),
        ("wind = {gust = 9.0, area = 4.0, mean = 3.0}", r"line 4, \[wind\] mean"),
    ],
)  # fmt: skip
def test_a_bad_wind_of_a_site_file_is_refused_with_line_and_field(
    tmp_path: Path, extra: str, words: str
) -> None:
    with pytest.raises(DataError, match=words):
        tight(tmp_path, extra)


@slow
def test_the_wind_of_a_site_file_is_that_of_its_guards_and_plans(tmp_path: Path) -> None:
    site = tight(tmp_path, "swing = 6.0\nwind = {gust = 9.0, area = 4.0}")
    assert site.working_wind == GUST and "wind" in site.entered
    station = site.stations[0]
    left = math.radians(6.0) - 2.0 * static_lean() / 0.95
    assert working_swing(station, site.swing, site.working_wind) == pytest.approx(left)
    # At 50 m, 0.95/(4 √2) of what is left of gravity.
    slew = gentle(station, site.swing, site.working_wind).decelerations[0]
    assert slew == pytest.approx(0.95 / (4.0 * math.sqrt(2.0)) * left * 9.80665 / 50.0, rel=1e-3)
    windy, calm = (
        plan_site(x, [("north", [-8.9, -6.7, 15.9])])
        for x in (site, replace(site, working_wind=CALM))
    )
    assert windy.duration > 1.05 * calm.duration


@slow
def test_a_planned_load_travels_no_faster_than_gusts_against_it_allow() -> None:
    # 13 m/s leave the drives little: twice the lean of a load at rest is 82 % of the swing.
    site = replace(
        site_of(), stations=site_of().stations[:1], working_wind=replace(GUST, gust=13.0)
    )
    plan = plan_site(site, [("north", [-5.0, -45.0, 16.0])])
    motion = plan.lifts[-1].motion
    station = site.stations[0]
    pivot, _, _ = station.rope(motion.q)
    velocity = np.gradient(pivot[:, :2], motion.period, axis=0)
    acceleration = np.gradient(velocity, motion.period, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    lean = np.linalg.norm(acceleration, axis=1) / station.crane.gravity
    by_gust = 2.0 * 0.5 * 1.25 * 4.0 * (13.0 + speed) ** 2 / (1000.0 * station.crane.gravity)
    assert speed.max() > 0.5
    assert 0.9 * site.swing < (lean + by_gust).max() <= site.swing


# --- a load that an operator parks beside the tower of another crane, and a gust


def gust_at_the_tower(limit: WorkingWind, speed: float, swing: float) -> SiteRun:
    site = replace(beside_the_tower(), working_wind=limit, swing=swing)
    first, second = (np.asarray(station.foot) for station in site.stations)
    towards = math.atan2(*(first - second)[1::-1])

    def approach(t: float, states: object) -> np.ndarray:
        return np.array([0.0, 0.3, 0.0])

    operators = [lambda t, states: np.zeros(3), approach]
    wind = SiteWind(lambda t: speed if t > 100.0 else 0.0, towards, area=4.0)
    return simulate_site(site, operators, duration=112.0, wind=wind)


def beside_the_tower() -> CraneSite:
    """Return two towers, the jib of the higher of which points at the mast of the lower."""
    site = site_of()
    lower, higher = site.stations
    # The jib of the higher crane points along -y at the start; half a turn is towards the lower.
    turned = replace(higher, heading=higher.heading + math.pi)
    return replace(site, stations=(replace(lower, heading=lower.heading + 0.9), turned))


@slow
def test_a_load_parked_beside_a_tower_is_not_blown_against_it_by_the_entered_wind() -> None:
    run = gust_at_the_tower(GUST, 9.0, 0.1)
    assert not run.contacts and not run.broken_assumptions
    assert run.least_distance >= run.site.distance and run.swing.max() <= run.site.swing
    # The gust swings it well beyond where it would lean in a steady wind.
    assert run.swing[1] > 1.2 * static_lean()


@slow
def test_where_no_wind_is_entered_a_gust_that_brings_cranes_together_breaks_the_assumption() -> (
    None
):
    run = gust_at_the_tower(CALM, 28.0, 0.1)
    assert run.least_distance < run.site.distance
    assert run.broken_assumptions == [
        "wind of up to 28.0 m/s, from 100.1 s on; the site states no wind"
    ]
