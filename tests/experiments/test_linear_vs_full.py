"""The paper's linear swing beside the plant: the comparison as the command makes it, and each of
its parts against closed forms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn import theory
from cranedyn.data.trajectory import Trajectory
from cranedyn.errors import DataError
from cranedyn.interfaces import Setpoint, State
from experiments import harness, linear_vs_full
from experiments.linear_vs_full import SLEWING_TERMS, TROLLEY_ALONE
from experiments.linear_vs_full.linear_equations import (
    Miss,
    all_rates,
    dropped,
    integrate,
    miss,
    paper,
)
from experiments.linear_vs_full.linear_moves import (
    SITES,
    HoistingPowers,
    LinearCase,
    MoveJob,
    SiteCrane,
    jobs,
    reaches,
    run_cases,
    short_slews,
    slow_slews,
)
from tests.document_numbers import missing
from tests.experiments.conftest import Ran
from tests.helpers import FAST, G, big_crane, crane, moved


@pytest.fixture(scope="module")
def result(ran: Callable[..., Ran]) -> Ran:
    return ran("linear_vs_full", "--engine", FAST)


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.long
def test_the_readme_tells_its_largest_errors(result: Ran) -> None:
    rows = [row for site in SITES for row in result.table(f"{site.name}: error")]
    alone = [row["both rms [%]"] for row in rows if row["move"] in TROLLEY_ALONE]
    slewing = [row["both rms [%]"] for row in rows if row["move"].startswith("slew")]
    told = f"at most {max(alone):.1f} %, jib turning {min(slewing):.0f} to {max(slewing):.0f} %"
    assert missing([told], "README.md") == []


@pytest.mark.long
def test_every_crane_makes_every_move_and_errors_of_both_angles_make_up_the_whole(
    result: Ran,
) -> None:
    for site in SITES:
        assert len(result.table(f"{site.name}: largest")) == 8
        rows = result.table(f"{site.name}: error")
        assert len(rows) == 8
        for row in rows:
            both = math.hypot(row["φ rms [%]"], row["θ rms [%]"])
            assert both == pytest.approx(row["both rms [%]"], rel=1e-12)
            assert row["both rms [%]"] <= row["peak [%]"]


@pytest.mark.long
def test_the_centrifugal_share_of_a_slew_is_twice_the_angle_of_its_ramp(result: Ran) -> None:
    # Ω² x over x Ω/t_r is Ω t_r; the load that swings out by 10° and more adds l φ to x
    for site, rate in (("71 EC-B 5", 0.8), ("L1-24", 0.5)):
        row = next(row for row in result.table(f"{site}: largest") if row["move"] == "slew")
        assert row["γ̇² (x - lφ) [%]"] == pytest.approx(100.0 * rate * math.pi / 30.0 * 5.0, rel=0.1)


@pytest.mark.long
def test_slow_hoisting_tells_the_equations_apart(result: Ran) -> None:
    # m l² φ̇ has the frequency √(g/l) and the action l^(3/2) A²; φ̇ alone, as in Eq. (8), l^(-1/2)
    # A²
    for row in result.table("Power of the cable"):
        assert row["plant"] == pytest.approx(-0.75, abs=5e-3)  # the claim's own
        assert row["Eq. (8)"] == pytest.approx(0.25, abs=5e-3)


def test_the_papers_equations_err_little_where_the_trolley_moves_alone_and_much_in_a_slew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two of the eight moves of one of the cranes, as the command makes and judges them all."""
    setup = replace(
        harness.Setup(engine=FAST),
        dt=linear_vs_full.DT,
        control_period=linear_vs_full.CONTROL_PERIOD,
    )
    site = SITES[1]
    large = site.crane(setup)
    two = [job for job in jobs(site, large) if job.name in ("trolley", "slew")]
    monkeypatch.setattr("experiments.linear_vs_full.linear_moves.jobs", lambda *_: two)
    cases = {case.job.name: case for case in run_cases(setup, site, large)}
    assert cases["trolley"].paper.rms < 1e-3 < 0.3 < cases["slew"].paper.rms
    # The equations with all rates are those of a small swing.
    assert cases["slew"].rates.rms < 0.05


# --- moves ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("site", SITES, ids=lambda site: site.name)
def test_moves_keep_the_ranges_and_rates_of_their_crane_and_end_at_rest(site: SiteCrane) -> None:
    large = crane(trolley_max=80.0, hoist_max=90.0, hoist_min=1.0)
    rounding = 1.0 + 1e-9
    short = short_slews(site, large)
    for job in (*jobs(site, large), *slow_slews(site, large), *short):
        setpoints = [job.reference(t) for t in np.linspace(0.0, job.arrival, 401)]
        position, velocity, acceleration = map(np.array, zip(*setpoints, strict=True))
        x, length = position[:, 1:].T
        rates = (site.slew, site.trolley, site.fast_hoist)
        assert 2.0 <= x.min() and x.max() <= site.jib * rounding
        assert 1.0 <= length.min() and length.max() <= site.height * rounding
        assert (np.abs(velocity) <= np.array(rates) * rounding).all()
        assert (np.abs(acceleration) <= np.array(site.accelerations) * rounding).all()
        assert_allclose(job.reference(job.arrival).velocity, 0.0, atol=1e-12)  # rounding
    turned = [math.degrees(job.reference(job.arrival).position[0]) for job in short]
    assert_allclose(turned, (1, 2, 5, 10, 20), rtol=1e-12)


# --- models ---------------------------------------------------------------------------------------


def test_the_papers_equations_leave_what_a_coasting_trolley_leaves() -> None:
    def pulses(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return np.array([0.0, 0.3 * ((t < 3.99) - float(t > 9.99)), 0.0])

    c = big_crane()
    run = moved(c, c.state(x=10.0, l=20.0), 14.0, 0.02, pulses)
    phi, theta, phi_rate, _ = integrate(run, paper, G)[-1]
    left = math.hypot(phi, phi_rate * math.sqrt(20.0 / G))
    # Runge-Kutta: (ω h)⁴ 10 = 4e-8.
    assert left == pytest.approx(theory.coast_residual(0.3, 4.0, 6.0, 20.0, G), rel=1e-7)
    assert theta == 0.0


@pytest.mark.slow
def test_the_equations_with_all_rates_meet_the_bessel_functions() -> None:
    c = big_crane()
    run = moved(c, c.state(l=10.0, l_dot=0.5, phi=0.05), 40.0, 0.02)
    expected = theory.constant_hoisting(run.t, 10.0, 0.5, G, 0.05, 0.0)
    found = integrate(run, all_rates, G)[:, 0]
    # cable lengths of the run are those of half a step later: 5 mm, a phase of ω dt/2 at most times
    # the rate of hoisting
    assert_allclose(found, expected, atol=0.05 * 0.01)


_TERMS = {
    "γ̇² (x - lφ)": {"gamma_dot": 0.1, "x": 20.0},
    "2γ̇ (lθ)˙": {"gamma_dot": 0.1, "theta_dot": 0.05},
    "2γ̇ (ẋ - (lφ)˙)": {"gamma_dot": 0.1, "x_dot": 0.3, "phi_dot": 0.05},
    "γ̈ lθ, γ̈ lφ": {"theta": 0.1, "slew": 0.02},
    "γ̇² lθ": {"gamma_dot": 0.1, "theta": 0.1},
    "2l̇φ̇, 2l̇θ̇": {"l_dot": 0.5, "phi_dot": 0.05},
}
"""States in which one term alone tells the paper's equations from those with all rates."""


def _two_rows(state: State, excitation: tuple[float, float, float]) -> Trajectory:
    """A state, and what drives that accelerate so make of its rates 20 ms later."""
    later = state.v.copy()
    h = 0.02
    later[crane().layout.drives] += h * np.array(excitation)
    run = moved(big_crane(), big_crane().start, h, h)
    return replace(run, q=np.stack([state.q, state.q]), v=np.stack([state.v, later]))


@pytest.mark.parametrize("name", _TERMS)
def test_what_is_dropped_is_what_the_equations_differ_by(name: str) -> None:
    values = dict(_TERMS[name])
    excitation = 0.4
    slew = values.pop("slew", 0.0)
    state = big_crane(trolley_min=0.0).state(**{"x": 0.0, "l": 15.0, **values})
    (_, x, phi, theta, length), (slew_rate, x_rate, phi_rate, theta_rate, length_rate) = state
    drives = {"x": x, "x_rate": x_rate, "x_acceleration": excitation, "slew_rate": slew_rate}
    drives |= {"slew_acceleration": slew, "length": length, "length_rate": length_rate}
    swing = np.array([phi, theta]), np.array([phi_rate, theta_rate])
    accelerations = [model(*swing, drives, G) for model in (all_rates, paper)]
    difference = length * np.abs(np.subtract(*accelerations)).max()
    kept, shares = dropped(_two_rows(state, (slew, excitation, 0.0)))
    assert kept == pytest.approx(excitation, rel=1e-12)
    assert shares[name] * kept == pytest.approx(difference, rel=1e-12)
    assert difference > 1e-3
    assert [other for other, share in shares.items() if share > 1e-12 and other != name] == []


def test_what_is_dropped_follows_the_cable_too() -> None:
    rates = {"gamma_dot": 0.1, "x_dot": 0.3, "phi_dot": 0.05, "theta_dot": 0.04, "l_dot": 0.5}
    state = big_crane().state(x=20.0, l=15.0, phi=0.1, theta=-0.2, **rates)
    kept, shares = dropped(_two_rows(state, (0.03, 0.4, 0.0)))

    def along(swing: float, swing_rate: float, s: float) -> float:
        return (15.0 + s * 0.5) * (swing + s * swing_rate)

    def rate(*swing: float, s: float = 1e-6) -> float:
        return (along(*swing, s) - along(*swing, -s)) / (2.0 * s)

    assert kept == pytest.approx(20.0 * 0.03, rel=1e-12)
    # central differences of a quadratic: rounding 1e-16/1e-6 of 3 m
    assert shares["2γ̇ (lθ)˙"] * kept == pytest.approx(abs(0.2 * rate(-0.2, 0.04)), rel=1e-8)
    relative = abs(0.2 * (0.3 - rate(0.1, 0.05)))
    assert shares["2γ̇ (ẋ - (lφ)˙)"] * kept == pytest.approx(relative, rel=1e-8)
    assert shares["γ̇² (x - lφ)"] * kept == pytest.approx(0.01 * (20.0 - 1.5), rel=1e-12)


def test_a_miss_is_a_share_of_the_largest_swing() -> None:
    c = big_crane()
    run = moved(c, c.state(l=10.0, phi=0.1), 2.0, 0.02)
    found = miss(run, run.q[:, 2:4] + np.array([0.003, -0.004]))
    assert (found.swing, found.phi, found.theta) == pytest.approx((0.1, 0.03, 0.04), rel=1e-12)
    assert (found.rms, found.peak) == pytest.approx((0.05, 0.05), rel=1e-12)


def test_where_an_error_reaches_a_bound_is_found_by_its_power_law() -> None:
    values = np.array([1.0, 0.5, 0.25, 0.125])
    bound = (0.05 / 0.3) ** (1 / 1.5)
    assert reaches(values, 0.3 * values**1.5, 0.05) == pytest.approx(bound, rel=1e-12)
    for good in (0.5, 1e-3):
        words = rf"The errors run from 0.0132583 to 0.3; {good:g} is not among them"
        with pytest.raises(DataError, match=words):
            reaches(values, 0.3 * values**1.5, good)


# --- claims ---------------------------------------------------------------------------------------


def _cases() -> list[LinearCase]:
    """What a comparison might find, by round numbers."""
    run = moved(big_crane(), big_crane().start, 0.02, 0.02)
    small = Miss(0.1, 0.001, 0.001, 0.01)
    large = Miss(0.1, 0.3, 0.4, 1.0)
    names = {
        "trolley, spline": small,
        "trolley": small,
        "slew": large,
        "trolley, slow hoist": large,
    }
    dropped = dict.fromkeys(SLEWING_TERMS, 0.4)
    return [
        LinearCase(
            site,
            MoveJob(name, run.state(0), lambda t: None, 1.0),
            run,
            of,
            small,
            None,
            0.3,
            dropped,
        )  # type: ignore[arg-type,return-value]
        for site in SITES
        for name, of in names.items()
    ]


_GOOD = {"rates": 0.004, "angles": 8.0, "powers": HoistingPowers(-0.75, 0.25)}


@pytest.mark.parametrize(
    ("changed", "failing"),
    [
        ({}, []),
        ({"trolley": Miss(0.1, 0.02, 0.0, 0.1)}, [0]),
        ({"trolley": Miss(0.1, 0.2, 0.0, 0.3)}, [0, 5]),
        ({"slew": Miss(0.1, 0.1, 0.1, 0.3)}, [2]),
        ({"slew": Miss(0.1, 0.01, 0.01, 0.3)}, [2, 5]),
        ({"dropped": 0.1}, [1]),
        ({"rates": 0.02}, [5]),
        ({"powers": HoistingPowers(-0.74, 0.25)}, [4]),
        ({"powers": HoistingPowers(-0.75, -0.75)}, [4]),
        ({"all rates": Miss(0.1, 0.06, 0.0, 0.1)}, [3]),
    ],
)
def test_each_claim_fails_where_it_should(changed: dict[str, Any], failing: list[int]) -> None:
    cases = [
        c._replace(
            paper=changed.get(c.job.name, c.paper),
            rates=changed.get("all rates", c.rates),
            dropped=dict.fromkeys(SLEWING_TERMS, changed.get("dropped", 0.4)),
        )
        for c in _cases()
    ]
    found = [{site.name: changed.get(name, good) for site in SITES} for name, good in _GOOD.items()]
    claims = linear_vs_full.claims(cases, *found)
    assert [k for k, claim in enumerate(claims) if not claim.holds] == failing
