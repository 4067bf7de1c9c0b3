"""Moves that are drawn at random: each is that of its crane alone, and what fails is counted."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.controllers.follow import follow
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.spline import spline
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import Design, Progress, results
from cranedyn.sweep import sweep as swept
from experiments import sweep
from experiments.harness.setup import Setup
from experiments.scenarios import robustness as study
from experiments.scenarios.moves import MOVES, instant, on_converters
from experiments.scenarios.robustness import (
    AFTER,
    COMBINED,
    DRAG,
    DRAWN,
    LEVELS,
    RANGES,
    UNBATCHED,
    drawn,
    robustness,
)
from experiments.scenarios.strategies import COMPILED_MPC, FLAT, LQR, PD, STRATEGIES
from experiments.sweep_results import MOST_LEFT, drawn_claims, drawn_tables, failures

COARSE: dict[str, Any] = {"dt": 1e-3, "control_period": 1e-2}


def cases(setup: Setup, name: str, drive: str, count: int) -> dict[str, np.ndarray]:
    return dict(drawn(setup, [name], drive, count, seed=3).columns)


@pytest.mark.parametrize(
    ("strategy", "drive"), [(FLAT, "ideal"), (PD, "velocity"), (COMPILED_MPC, "velocity")]
)
def test_a_drawn_case_is_the_move_of_that_crane_alone(strategy: str, drive: str) -> None:
    setup, row = Setup(**COARSE), 3
    columns = cases(setup, strategy, drive, 4)
    one = {name: column[row] for name, column in columns.items()}
    assert one["delay"] > 0.0 and one["noise"] > 0.2 and one["gust_m_s"] > 1.0  # all of it is felt
    found = robustness(columns)
    crane = setup.variant(payload_mass=one["load"] * setup.crane.payload_mass)
    plan = STRATEGIES[strategy](setup, COMBINED)
    plan = plan if drive == "ideal" else on_converters(setup, plan)
    longer = np.zeros(crane.layout.n)
    longer[crane.layout.index("l")] = one["cable_error_m"]
    controller, start = plan.controller(), COMBINED.ends(crane)[0]
    seen = with_sensor_model(
        crane,
        lambda t, state, setpoint: controller(t, State(state.q - longer, state.v), setpoint),
        delay=int(one["delay"]),
        noise=one["noise"] * noise_of(crane),
        rng=np.random.Generator(np.random.SFC64([int(one["seed"]), int(one["number"])])),
    )

    def gust(t: float, state: State) -> np.ndarray:
        force = np.zeros((len(crane.points), 3))
        since = (t - one["gust_at_s"]) / one["gust_lasts_s"]
        if 0.0 < since < 1.0:
            speed = one["gust_m_s"] * math.sin(math.pi * since) ** 2
            towards = math.cos(one["gust_to_rad"]), math.sin(one["gust_to_rad"]), 0.0
            force[crane.layout.points.index("payload")] = towards
            force *= 0.5 * AIR_DENSITY * DRAG * speed**2
        return force

    typical = converters(crane)
    run = simulate(
        crane,
        seen,
        plan.reference,
        start=State(start.q + longer, start.v),
        duration=instant(plan.arrives + AFTER, setup.control_period),
        disturbance=gust,
        drive=plan.drive if drive == "ideal" else replace(typical, lags=one["lag"] * typical.lags),
        validity="mark",
        engine="compiled",
        **COARSE,
    )
    swings, hoist = crane.swings, crane.layout.index("l")
    amplitude = swing_amplitude(run.q[:, swings], run.v[:, swings], run.q[:, hoist], crane.gravity)
    arrived = round(math.ceil(plan.arrives / 0.05 - 1e-9) * 0.05 / 1e-2)
    # the engines agree to 1e-12 a second, and noise is fed back
    assert found["arrival_swing_rad"][row] == pytest.approx(amplitude[arrived], abs=1e-8)
    assert found["residual_swing_rad"][row] == pytest.approx(amplitude[-1], abs=1e-8)
    assert found["broken"][row] == 0.0
    quiet = robustness(columns | {"noise": 0.0 * columns["noise"]})
    assert abs(quiet["residual_swing_rad"][row] - amplitude[-1]) > 1e-6


def test_fewer_cases_of_a_seed_are_the_first_of_more_and_all_are_within_their_ranges() -> None:
    few, many = (cases(Setup(), FLAT, "ideal", count) for count in (10, 4000))
    assert all(np.array_equal(few[name], many[name][:10]) for name in few)
    for name, (low, high) in RANGES.items():
        values = many[name]
        assert low <= values.min() < low + 0.01 * (high - low)
        assert values.max() == 4.0 if name == "delay" else high - 0.01 * (high - low) < values.max()
        # the mean of 4000 even numbers is off by 0.0046 of their range, one standard deviation
        middle = 2.0 if name == "delay" else (low + high) / 2.0
        assert abs(values.mean() - middle) < 5.0 * 0.0046 * (high - low)
    assert len(np.unique(many["load"])) == LEVELS


def test_every_strategy_of_compare_is_drawn_for_or_it_is_said_why_not() -> None:
    assert {*DRAWN} | {*UNBATCHED} == {*STRATEGIES}


def test_drives_that_follow_exactly_need_no_sensors() -> None:
    setup = Setup(**COARSE)
    columns = cases(setup, "spline alone", "ideal", 4)
    blind = columns | {name: 0.0 * columns[name] for name in ("noise", "delay", "lag")}
    found = robustness(columns)["residual_swing_rad"]
    assert np.array_equal(found, robustness(blind)["residual_swing_rad"])


def test_a_trolley_out_of_its_range_is_broken_and_drives_that_cannot_follow_are_not() -> None:
    strong, weak = Setup(**COARSE).crane, Setup(values={"trolley_effort": 300.0}).crane
    start = MOVES[0].ends(strong)[0]

    def run(crane: Crane, radius: float) -> Batch:
        way = spline(crane, start, [(0.0, radius, 15.0)], [8.0])
        return simulate_batch(
            crane,
            follow(crane, way, 1e-2),
            way,
            start=start,
            duration=10.0,
            drive="motion",
            record=5,
            **COARSE,
        )

    upper = strong.upper[strong.layout.index("x")]
    assert study._whole(strong, run(strong, upper - 0.1)) == 1.0
    assert study._whole(strong, run(strong, upper + 0.1)) == 0.0
    overtaxed = run(weak, upper - 0.1)
    assert np.isfinite(overtaxed.valid_until).all() and study._whole(weak, overtaxed) == 1.0


def _found(left: list[float], broken: list[float]) -> dict[str, np.ndarray]:
    count = len(left)
    columns = {name: np.full(count, 0.01) for name in ("arrival_swing_rad", "spent_s")}
    return columns | {
        "case": np.arange(count),
        "strategy": np.full(count, FLAT),
        "residual_swing_rad": np.array(left),
        "broken": np.array(broken),
        "valid_until_s": np.full(count, math.nan),
    }


def test_what_breaks_diverges_or_leaves_too_much_fails_and_its_share_has_an_interval() -> None:
    left = [MOST_LEFT, 1.01 * MOST_LEFT, 0.0, math.nan, 0.0]
    found = _found(left, [0.0, 0.0, 1.0, 1.0, 0.0])
    assert failures(found).tolist() == [False, True, True, True, False]
    swings, failed, _ = drawn_tables(found, "ideal")
    assert swings.rows[0][-1] is None  # the worst diverged
    broken, much, share, low, high, _ = failed.rows[0][1:]
    assert (broken, much, share) == pytest.approx((40.0, 40.0, 60.0))
    # Clopper and Pearson's own table of 3 of 5 at 95 %: 14.66 to 94.73 %
    assert (low, high) == pytest.approx((14.66, 94.73), abs=0.005)
    none = drawn_tables(_found([0.0] * 50, [0.0] * 50), "ideal")[1].rows[0]
    assert none[4:6] == pytest.approx((0.0, 100.0 * (1.0 - 0.025 ** (1 / 50))))
    assert [claim.holds for claim in drawn_claims(found, "ideal", 0)] == [True, False]
    for failing, holds in ((2, True), (3, False)):
        rare = _found([1.0] * failing + [0.0] * (2000 - failing), [0.0] * 2000)
        assert drawn_claims(rare, "ideal", 0)[1].holds == holds


def test_the_command_draws_goes_on_and_refuses_what_has_no_effect(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["--cases", "8", "--only", FLAT, PD, "--drive", "velocity", "--workers", "1"]
    out = ["--out", str(tmp_path / "out")]
    assert sweep.main([*asked, *out]) in (0, 1)
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert result["parameters"]["seed"] == 1 and result["parameters"]["drive"] == "velocity"
    assert [row[0] for row in result["tables"][0]["rows"]] == [FLAT, PD]
    assert result["claims"][0]["holds"]
    assert (tmp_path / "out" / "sweep_map.png").stat().st_size > 10_000
    cases = tmp_path / "out" / "cases"
    assert results(cases).num_rows == 16
    parts = {part: part.stat().st_mtime_ns for part in cases.glob("*.parquet")}
    asked[3:5] = [FLAT, LQR, PD, "--without", LQR]  # the same
    assert sweep.main([*asked, *out]) in (0, 1)
    assert {part: part.stat().st_mtime_ns for part in parts} == parts
    assert sweep.main([*asked, *out, "--seed", "2"]) == 2
    for wrong, word in (
        (["--cases", "8", "--points", "3"], "--points has no effect beside --cases"),
        (["--only", FLAT], "--only has no effect without --cases"),
        (["--without", FLAT], "--without has no effect without --cases"),
        (["--cases", "8", "--only", FLAT, "--without", FLAT], "No strategy is left"),
        (["--seed", "2"], "--seed has no effect without --cases"),
    ):
        assert sweep.main([*wrong, *out]) == 2
        assert word in capsys.readouterr().err


def test_a_sweep_of_which_every_case_is_bad_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiments.sweep.sweep", _all_bad)
    assert sweep.main(["--points", "2", "--durations", "1", "--out", str(tmp_path / "out")]) == 2
    assert "Each of 2 cases is bad; the first: no." in capsys.readouterr().err


def _all_bad(_study: object, _design: object, folder: Path, **_options: object) -> Progress:
    return swept(_bad, Design({"a": np.arange(2.0)}), folder, workers=1)


def _bad(cases: object) -> dict[str, np.ndarray]:
    raise CraneError("no.")
