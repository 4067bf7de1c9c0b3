"""The sweep: its cases are runs of `simulate`, on a grid of load and cable and drawn at random; its
command keeps, resumes and shows them, and counts what fails.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
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
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.errors import CraneError
from cranedyn.estimation.sensor_model import noise_of, with_sensor_model
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.simple import spline
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import Design, Progress, results
from cranedyn.sweep import sweep as swept
from experiments import sweep
from experiments.harness.setup import Setup
from experiments.report import page
from experiments.scenarios.moves import DRAG, MOVES, instant, on_converters
from experiments.scenarios.strategies import COMPILED_MPC, FLAT, LQR, PD, STRATEGIES
from experiments.sweep import sweep_results, sweep_study
from experiments.sweep.sweep_study import AFTER, COMBINED, RANGES, SWEPT, drawn, simulate_cases
from tests.document_numbers import missing
from tests.experiments.conftest import Ran, parse_strict
from tests.helpers import ROOT

COARSE: dict[str, Any] = {"dt": 1e-3, "control_period": 1e-2}
SETUP = Setup(**COARSE)

Columns = dict[str, np.ndarray]


def on_grid(**columns: object) -> Columns:
    """Columns of cases on the grid, each value repeated as often as there are rows."""
    rows = max(np.size(column) for column in columns.values())
    clocks = {"gravity_m_s2": 9.80665, "dt_s": 1e-3, "control_period_s": 1e-2}
    return {
        name: np.resize(np.array(column), rows) for name, column in {**clocks, **columns}.items()
    }


def at_random(name: str, drive: str = "ideal", count: int = 4) -> Columns:
    """Columns of drawn cases."""
    return dict(drawn(SETUP, [name], drive, count, seed=3).columns)


# --- cases ----------------------------------------------------------------------------------------


def _gust(crane: Crane, case: dict[str, Any]) -> Callable[[float, State], np.ndarray]:
    def gust(t: float, state: State) -> np.ndarray:
        force = np.zeros((len(crane.points), 3))
        since = (t - case["gust_at_s"]) / case["gust_lasts_s"]
        if 0.0 < since < 1.0:
            speed = case["gust_m_s"] * math.sin(math.pi * since) ** 2
            towards = math.cos(case["gust_to_rad"]), math.sin(case["gust_to_rad"]), 0.0
            force[crane.layout.points.index("payload")] = towards
            force *= 0.5 * AIR_DENSITY * DRAG * speed**2
        return force

    return gust


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [PD, "spline alone", FLAT])
def test_a_case_in_single_precision_says_what_was_rounded(strategy: str) -> None:
    columns = on_grid(
        strategy=strategy,
        duration_s=COMBINED.duration,
        load=np.linspace(0.5, 1.5, 10).tolist(),
        cable_error_m=[-0.5],
    )
    exact = simulate_cases(columns)
    assert "rounding_rad" not in exact
    single = np.full(len(columns["load"]), "single")
    found = simulate_cases(columns | {"precision": single})
    rounding = np.ma.filled(found["rounding_rad"], np.nan)
    compared = ~np.isnan(rounding)
    assert compared.sum() == sweep_study.COMPARED_CASES and compared[[0, -1]].all()
    off = np.abs(found["residual_swing_rad"] - exact["residual_swing_rad"])
    assert np.array_equal(rounding[compared], off[compared])
    assert 0.0 < off.min() and off.max() < 3e-6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "drive", "columns"),
    [
        *(
            (
                name,
                "ideal",
                on_grid(
                    strategy=name,
                    duration_s=COMBINED.duration,
                    load=[1.0, 1.3],
                    cable_error_m=[0.0, 0.7],
                ),
            )
            for name in SWEPT
        ),
        *(
            (name, drive, at_random(name, drive))
            for name, drive in ((FLAT, "ideal"), (PD, "velocity"))
        ),
        pytest.param(
            *(COMPILED_MPC, "velocity", at_random(COMPILED_MPC, "velocity")), marks=pytest.mark.long
        ),
    ],
)
def test_a_case_is_the_move_of_that_crane_alone(
    strategy: str, drive: str, columns: Columns
) -> None:
    found = simulate_cases(columns)
    row = len(columns["load"]) - 1
    random = "noise" in columns
    case = {name: column[row] for name, column in columns.items()}
    crane = SETUP.variant(payload_mass=case["load"] * SETUP.crane.payload_mass)
    plan = sweep_study.STRATEGIES[strategy](SETUP, COMBINED)
    if drive == "velocity":
        plan = on_converters(SETUP, plan)
    longer = case["cable_error_m"] * np.eye(crane.layout.n)[crane.layout.index("l")]
    controller = plan.controller()
    start, goal = COMBINED.ends(crane)
    seen = lambda t, state, setpoint: controller(t, State(state.q - longer, state.v), setpoint)  # noqa: E731
    options: dict[str, Any] = {"drive": plan.drive}
    if random:
        assert case["delay"] > 0.0 and case["noise"] > 0.2 and case["gust_m_s"] > 1.0  # all is felt
        seen = with_sensor_model(
            crane,
            seen,
            delay=int(case["delay"]),
            noise=case["noise"] * noise_of(crane),
            rng=np.random.Generator(np.random.SFC64([int(case["seed"]), int(case["number"])])),
        )
        options["disturbance"] = _gust(crane, case)
    if drive == "velocity":
        typical = converters(crane)
        options["drive"] = replace(typical, lags=case["lag"] * typical.lags)
    run = simulate(
        crane,
        seen,
        plan.reference,
        start=State(start.q + longer, start.v),
        duration=instant(plan.arrives + AFTER, SETUP.control_period),
        validity="mark",
        engine="compiled",
        **options,
        **COARSE,
    )
    swings = crane.swings
    hoist = crane.layout.index("l")
    amplitude = swing_amplitude(run.q[:, swings], run.v[:, swings], run.q[:, hoist], crane.gravity)
    away = payload_position(crane, run.q[-1]) - payload_position(crane, goal.q + longer)
    expected = {
        "residual_swing_rad": amplitude[-1],
        "peak_swing_rad": np.linalg.norm(run.q[:, swings], axis=1).max(),
        "off_goal_m": np.linalg.norm(away),
    }
    if random:
        arrived = round(math.ceil(plan.arrives / 0.05 - 1e-9) * 0.05 / 1e-2)
        expected |= {"arrival_swing_rad": amplitude[arrived], "broken": 0.0}
        quiet = simulate_cases(columns | {"noise": 0.0 * columns["noise"]})
        assert abs(quiet["residual_swing_rad"][row] - amplitude[-1]) > 1e-6
    else:
        assert run.valid.all() and found["valid_until_s"].count() == 0
    # engines agree to 1e-12 a second, and noise is fed back; amplitudes of 1e-6 rad are roots of
    # squares of 1e-12, so 1e-9 is round-off's
    for name, value in expected.items():
        allowed = (1e-8 if random else 1e-9) * (10.0 if name == "off_goal_m" else 1.0)
        assert found[name][row] == pytest.approx(value, abs=allowed), name


@pytest.mark.slow
def test_rows_come_back_in_the_order_of_the_cases_whatever_their_plans() -> None:
    mixed = on_grid(
        strategy=["spline + ZV", "spline alone", "spline + ZV"],
        duration_s=[20.0, 20.0, 30.0],
        load=1.0,
        cable_error_m=[0.0, 0.5, 0.5],
    )
    together = simulate_cases(mixed)["residual_swing_rad"]
    for row in range(3):
        alone = simulate_cases({name: column[row : row + 1] for name, column in mixed.items()})
        # To the bit, whoever runs beside it.
        assert together[row] == alone["residual_swing_rad"][0]


def test_fewer_cases_of_a_seed_are_the_first_of_more_and_all_are_within_their_ranges() -> None:
    few, many = (at_random(FLAT, count=count) for count in (10, 4000))
    assert all(np.array_equal(few[name], many[name][:10]) for name in few)
    for name, (low, high) in RANGES.items():
        values = many[name]
        assert low <= values.min() < low + 0.01 * (high - low)
        assert values.max() == 4.0 if name == "delay" else high - 0.01 * (high - low) < values.max()
        # the mean of 4000 even numbers is off by 0.0046 of their range, one standard deviation
        middle = 2.0 if name == "delay" else (low + high) / 2.0
        assert abs(values.mean() - middle) < 5.0 * 0.0046 * (high - low)
    assert len(np.unique(many["load"])) == sweep_study.LEVELS


def test_every_strategy_of_compare_is_drawn_for_or_it_is_said_why_not() -> None:
    assert {*sweep_study.DRAWN} | {*sweep_study.UNBATCHED} == {*STRATEGIES}


@pytest.mark.slow
def test_drives_that_follow_exactly_need_no_sensors() -> None:
    columns = at_random("spline alone")
    blind = columns | {name: 0.0 * columns[name] for name in ("noise", "delay", "lag")}
    found = simulate_cases(columns)["residual_swing_rad"]
    assert np.array_equal(found, simulate_cases(blind)["residual_swing_rad"])


@pytest.mark.slow
def test_a_trolley_out_of_its_range_is_broken_and_drives_that_cannot_follow_are_not() -> None:
    strong = SETUP.crane
    weak = Setup(values={"trolley_effort": 300.0}).crane
    start = MOVES[0].ends(strong)[0]

    def run(crane: Crane, radius: float) -> Batch:
        way = spline(crane, start, [(0.0, radius, 15.0)], [8.0])
        how: dict[str, Any] = {"start": start, "duration": 10.0, "drive": "motion", "record": 5}
        return simulate_batch(crane, follow(crane, way, 1e-2), way, **how, **COARSE)

    upper = strong.upper[strong.layout.index("x")]
    assert sweep_study._stays_valid(strong, run(strong, upper - 0.1)).all()
    assert not sweep_study._stays_valid(strong, run(strong, upper + 0.1)).any()
    overtaxed = run(weak, upper - 0.1)
    assert (
        np.isfinite(overtaxed.valid_until).all() and sweep_study._stays_valid(weak, overtaxed).all()
    )


# --- what is counted ------------------------------------------------------------------------------


def _found(left: list[float], broken: list[float]) -> Columns:
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
    most = sweep_results.MAX_RESIDUAL_SWING
    found = _found([most, 1.01 * most, 0.0, math.nan, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0])
    assert sweep_results.failures(found).tolist() == [False, True, True, True, False]
    swings, failed, _ = sweep_results.drawn_tables(found, "ideal")
    assert swings.rows[0][-1] is None  # the worst diverged
    broken, much, share, low, high, _ = failed.rows[0][1:]
    assert (broken, much, share) == pytest.approx((40.0, 40.0, 60.0))
    # Clopper and Pearson's own table of 3 of 5 at 95 %: 14.66 to 94.73 %
    assert (low, high) == pytest.approx((14.66, 94.73), abs=0.005)
    none = sweep_results.drawn_tables(_found([0.0] * 50, [0.0] * 50), "ideal")[1].rows[0]
    assert none[4:6] == pytest.approx((0.0, 100.0 * (1.0 - 0.025 ** (1 / 50))))
    claims = sweep_results.drawn_claims(found, "ideal", 0)
    assert [claim.holds for claim in claims] == [True, False]
    for failing, holds in ((2, True), (3, False)):
        rare = _found([1.0] * failing + [0.0] * (2000 - failing), [0.0] * 2000)
        assert sweep_results.drawn_claims(rare, "ideal", 0)[1].holds == holds


# --- the command ----------------------------------------------------------------------------------


def _again(words: list[str], folder: Path) -> tuple[int, bool]:
    """Exit code of a second sweep into a folder, and whether it left all chunks as they were."""
    chunks = {path: path.stat().st_mtime_ns for path in (folder / "cases").glob("*.parquet")}
    code = sweep.main([*words, "--out", str(folder)])
    return code, all(path.stat().st_mtime_ns == at for path, at in chunks.items())


def test_the_command_sweeps_shows_and_does_not_sweep_again(
    ran: Callable[..., Ran], capsys: pytest.CaptureFixture[str]
) -> None:
    words = "--points 2 --durations 1 --workers 1".split()
    made = ran("sweep", *words)
    assert (made.code, made.failed()) == (0, [])
    assert all((made.folder / name).stat().st_size > 10_000 for name in made.result["figures"])
    assert '<section id="sweep">' in page([made.folder])  # formats of thousands, too
    kept = results(made.folder / "cases").num_rows
    assert kept == 4 * len(SWEPT) == sum(row["cases"] for row in made.table("Swing left"))
    assert _again(words, made.folder) == (0, True)
    words[1] = "3"
    assert _again(words, made.folder) == (2, True)
    assert "another" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_draws_goes_on_and_refuses_what_has_no_effect(tmp_path: Path) -> None:
    words = ["--cases", "8", "--only", FLAT, PD, "--drive", "velocity", "--workers", "1"]
    assert sweep.main([*words, "--out", str(tmp_path)]) in (0, 1)
    result = parse_strict((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert result["parameters"]["seed"] == 1 and result["parameters"]["drive"] == "velocity"
    assert [row[0] for row in result["tables"][0]["rows"]] == [FLAT, PD]
    assert result["claims"][0]["holds"]
    assert (tmp_path / "sweep_map.png").stat().st_size > 10_000
    assert results(tmp_path / "cases").num_rows == 16
    words[3:5] = [FLAT, LQR, PD, "--without", LQR]  # the same
    code, untouched = _again(words, tmp_path)
    assert code in (0, 1) and untouched
    assert _again([*words, "--seed", "2"], tmp_path) == (2, True)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--cases", "8", "--points", "3"], "--points has no effect beside --cases"),
        (["--only", FLAT], "--only has no effect without --cases"),
        (["--without", FLAT], "--without has no effect without --cases"),
        (["--cases", "8", "--only", FLAT, "--without", FLAT], "No strategy is left"),
        (["--cases", "5", "--seed", "-1"], "seed is -1; allowed is a whole number >= 0"),
        (["--seed", "2"], "--seed has no effect without --cases"),
    ],
)
def test_what_has_no_effect_is_refused(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert sweep.main([*words, "--out", str(tmp_path)]) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    "unused",
    [["--engine", "pinocchio"], ["--view"], ["--serve"], ["--save", "x.rrd"], ["--port", "1"]],
)
def test_arguments_that_a_sweep_has_no_use_for_are_refused(
    unused: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        sweep.main([*unused, "--points", "1"])
    assert unused[0] in capsys.readouterr().err


@pytest.mark.slow
def test_a_sweep_of_which_every_case_is_bad_says_why(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("experiments.sweep.sweep", _all_bad)
    assert sweep.main(["--points", "2", "--durations", "1", "--out", str(tmp_path / "out")]) == 2
    assert "Each of 2 cases is bad; the first: no." in capsys.readouterr().err


def _all_bad(_study: object, _design: object, folder: Path, **_options: object) -> Progress:
    return swept(_bad, Design({"a": np.arange(2.0)}), folder, workers=1)


def _bad(cases: object) -> Columns:
    raise CraneError("no.")


def test_the_readme_tells_the_worst_of_the_whole_sweep_as_its_document_shows_it() -> None:
    table = ROOT / "docs" / "results" / "sweep_swing.csv"
    rows = {row[0]: row for row in csv.reader(table.open(encoding="utf-8"))}
    moves = int(rows[FLAT][1])
    worst = float(rows[FLAT][5])
    told = f"at most {worst:.2g} mrad left in {moves:,} moves of flat + LQR"
    assert missing([told], "README.md") == []
