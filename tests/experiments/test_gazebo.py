"""The article's own simulator: recordings made in Gazebo Classic 11.1, beside the same runs
here.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cranedyn import theory
from cranedyn.errors import CraneError
from experiments import a1, a2, a3, gazebo, harness
from experiments.energy import overwritten as energy_overwritten
from tests.document_numbers import missing
from tests.experiments.conftest import Ran
from tests.helpers import FAST

WORLD = harness.Setup(gazebo.GRAVITY, engine=FAST)


@pytest.fixture(scope="module")
def found() -> dict[str, gazebo.RecordedPair]:
    return gazebo.pairs(WORLD)


RUNS = ("a1_l5", "a1_l10", "a1_l15", "a1_l20", "a1_soft", "a2", "a3")


@pytest.mark.parametrize("name", RUNS)
def test_a_whole_run_stays_within_1e_4_rad_of_the_articles_own_simulator(
    name: str, found: dict[str, gazebo.RecordedPair]
) -> None:
    pair = found[name]
    assert pair.recorded["t_s"][-1] == pair.run.t[-1]
    assert pair.largest("phi_rad") < gazebo.ALLOWED
    assert pair.largest("theta_rad") < gazebo.ALLOWED
    # The step, h l ω²/2 along the cable, moves the pivot through its spring.
    assert pair.largest("x_m") < 1e-5
    assert pair.largest("l_m") < 1e-4  # a chord instead of an arc: h l ω²/2 on a hoist of 3e4 N/m


def test_every_recording_is_compared(found: dict[str, gazebo.RecordedPair]) -> None:
    recorded = {path.stem for path in gazebo.RECORDINGS.glob("*.parquet")}
    assert recorded == {*RUNS, "swing_overwritten"} == {*found, "swing_overwritten"}


@pytest.mark.slow
def test_a_world_of_another_gravity_or_inertia_would_not_pass() -> None:
    """0.07 % of gravity, or half of the dummy links' inertia, is many times what is allowed: the
    comparison can fail.
    """
    for other in (replace(WORLD, gravity=9.80665), replace(WORLD, values={"dummy_inertia": 25.0})):
        here = a1.run(other, 15.0).trajectory
        there = gazebo.read_columns(gazebo.RECORDINGS / "a1_l15.parquet", gazebo.COLUMNS)
        assert gazebo.RecordedPair("a1_l15", there, here).largest("phi_rad") > 5.0 * gazebo.ALLOWED


@pytest.fixture(scope="module")
def result(ran: Callable[..., Ran]) -> Any:
    return ran("gazebo", "--engine", FAST).result


def test_the_claims_and_the_readme_tell_the_largest_difference_of_either_swing_angle(
    result: Any, found: dict[str, gazebo.RecordedPair]
) -> None:
    worst = dict.fromkeys(("A1", "A2", "A3"), 0.0)
    for name, pair in found.items():
        run = name[:2].upper()
        worst[run] = max(worst[run], pair.largest("phi_rad"), pair.largest("theta_rad"))
    short = {run: f"{value:.1e}".replace("e-0", "e-") for run, value in worst.items()}
    told = ", ".join(f"{run} {value}" for run, value in short.items())
    assert missing([f"| {told} rad |"], "docs/results/article.md") == []
    largest = short[max(worst, key=worst.__getitem__)]
    assert missing([f"differ by {largest} rad at most"], "README.md") == []
    for claim, value in zip(result["claims"], worst.values(), strict=True):
        assert f"({value:.1e} rad at most)" in claim["sentence"]


def test_the_page_on_the_article_tells_its_numbers(result: Any) -> None:
    swings, hoisting, slewing = (table["rows"] for table in result["tables"])
    errors = ", ".join(f"{row[3]:+.3f}" for row in swings[:4])
    ratios = ", ".join(f"{row[6]:.6f}" for row in swings[:4])
    told = [f"| {errors} % |", f"| {ratios} |", f"| {hoisting[0][4]:.4f} |"]
    told.append(f"| {slewing[0][1]:.4f}, {slewing[0][2]:+.4f}, {slewing[0][3]:.5f} |")
    assert missing(told, "docs/results/article.md") == []


@pytest.mark.parametrize(("main", "name"), [(a1.main, "a1_l5"), (a2.main, "a2"), (a3.main, "a3")])
def test_a_recording_is_analysed_by_the_experiments_like_any_file(
    main: Any, name: str, tmp_path: Path
) -> None:
    words = ["--from", str(gazebo.RECORDINGS / f"{name}.parquet"), "--out", str(tmp_path / "out")]
    assert main(words) == 0
    rows = json.loads((tmp_path / "out" / "result.json").read_text())["tables"][0]["rows"]
    assert rows[0][0].endswith(f"{name}.parquet")


# --- the article's broken crane -------------------------------------------------------------------


@pytest.fixture(scope="module")
def broken(ran: Callable[..., Ran]) -> Any:
    made = ran("energy", "--overwritten", "--gravity", "9.8", "--engine", FAST)
    assert made.code == 0
    return made.result


def test_a_plugin_that_overwrites_the_passive_rates_is_a_damper_and_takes_what_the_article_lost(
    broken: Any,
) -> None:
    assert [claim["holds"] for claim in broken["claims"]] == [True, True, True]
    ratios, dampings = ({row[0]: row[1:] for row in table["rows"]} for table in broken["tables"])
    ours = ratios["here, damper ΣI/dt"]
    theirs = ratios["Gazebo 11.1, rates overwritten"]
    closed = 100.0 / 5e-4 / (2.0 * math.sqrt(225500.0 * 9800.0 * 15.0))
    assert ours[0] == pytest.approx(closed, rel=0.0225 / 8)  # A²/8
    assert ours[2] == pytest.approx(theirs[2], abs=0.01)
    rows = [
        f"| {name} | {row[0]:.4f} | {row[1]:.4f} | {row[2]:.2f} |"
        for name, row in ratios.items()
        if name[:4] in ("here", "Gaze")
    ]
    assert missing([*rows, f"{dampings[1.0][0]:.2f} J are"], "docs/results/article.md") == []


@pytest.mark.slow
def test_what_it_took_cannot_be_judged_in_another_world() -> None:
    outcome = energy_overwritten.experiment(replace(WORLD, gravity=9.81), 0.15, 15.0)
    assert [claim.holds for claim in outcome.claims] == [True, None, None]


def test_a_finer_step_makes_the_plugin_a_stronger_damper_until_nothing_swings() -> None:
    crane = WORLD.crane
    ratios = [energy_overwritten.closed_form(crane, 15.0, dt).ratio for dt in (1e-3, 5e-4)]
    assert ratios[1] == 2.0 * ratios[0]
    with pytest.raises(
        CraneError, match=r"damping ratio under the plugin is 1\.1; allowed is below 1"
    ):
        energy_overwritten.experiment(replace(WORLD, dt=2.5e-4), 0.15, 15.0)


def test_the_period_of_pure_gazebo_is_inertia_amplitude_and_gravity() -> None:
    """Measured there with the drives fixed: 7.793010 s; a swing that decays from 0.15 rad, its step
    and chords leave 6e-6 s.
    """
    period = theory.rigid_period(15.0, 9.8, 1000.0, 400.0 + 2 * 50.0) * float(
        theory.amplitude_factor(0.15)
    )
    assert period == pytest.approx(7.793010, abs=7e-6)
    error = 100.0 * (period / float(theory.point_period(15.0, 9.80665)) - 1.0)
    assert missing([f"{period:.6f} s", f"{error:+.3f} %"], "docs/results/article.md") == []
