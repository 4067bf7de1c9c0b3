"""The comparison on drives with frequency converters."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from experiments import compare, harness
from experiments.compare import claims, runs, tables
from experiments.compare.runs import Results, StrategyResult
from experiments.harness.document import read_document
from experiments.harness.outcome import ResultTable
from experiments.scenarios.moves import MOVES, SETTLED_DISTANCE, SWINGING, Score, on_converters
from experiments.scenarios.perturbations import NOMINAL, UNOBSERVED
from experiments.scenarios.strategies import (
    COMPILED_MPC,
    FASTEST,
    FLAT,
    LQR,
    MPC,
    PAPER,
    PD,
    STRATEGIES,
    TO_GOAL,
)
from tests.helpers import FAST, ROOT

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found() -> dict[str, Results]:
    """The moves by the LQR about a flat path, and some cases of the combined one."""
    setup = harness.Setup(engine=FAST)
    results = runs.strategy_results(setup, (*MOVES, SWINGING), FLAT, "velocity")
    return {move: {FLAT: cases} for move, cases in results.items()}


def test_a_planned_path_leaves_no_swing_on_converters_whatever_is_not_as_planned(
    found: dict[str, Results],
) -> None:
    (claim,) = claims.converter_claims(found)
    assert claim.holds
    cases = found[MOVES[-1].name][FLAT]
    assert cases["no swing sensor"].why == UNOBSERVED
    assert {name for name, result in cases.items() if result.score is None} == {"no swing sensor"}
    for results in found.values():
        score = results[FLAT][NOMINAL.name].score
        assert score is not None
        assert score.later * score.length < 0.1 * SETTLED_DISTANCE
        assert score.beyond == 0.0


def test_the_page_on_drives_shows_it_as_printed(found: dict[str, Results]) -> None:
    made = [tables.move_table(move, found[move.name], "velocity") for move in (*MOVES, SWINGING)]
    made += tables.case_tables(found[MOVES[-1].name], "velocity")
    made.append(tables.drives_table(SWINGING, found[SWINGING.name], beyond=True))
    document = read_document(ROOT / "docs/results/drives.md", "compare_velocity")
    assert document.stale(made, subset=True) == []


@pytest.mark.parametrize(
    "strategy",
    [
        # The compiled MPC about a motion is that to the goal otherwise.
        pytest.param(name, marks=[pytest.mark.long] * (name == COMPILED_MPC))
        for name in STRATEGIES
        if not name.startswith("least")
    ],
)
def test_every_strategy_runs_on_converters(strategy: str) -> None:
    if strategy == MPC:
        pytest.importorskip("daqp", reason="extra mpc (daqp) is not installed")
    if strategy in (COMPILED_MPC, TO_GOAL):
        pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    setup = harness.Setup(engine=FAST)
    plan = on_converters(setup, STRATEGIES[strategy](setup, MOVES[0]))
    assert plan.drive == "velocity"
    crane = setup.crane
    start = MOVES[0].ends(setup.crane)[0]
    means = {"start": start, "duration": 4.0, "label": "", "drive": plan.drive}
    run = setup.simulate(crane, plan.controller(), plan.reference, **means)
    assert run.valid.all()
    assert run["x_m"][-1] > 10.0  # it is on its way


def test_what_is_affine_runs_on_converters_in_a_batch() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    from cranedyn.compiled.batch import simulate_batch

    setup = harness.Setup(engine=FAST)
    start = MOVES[0].ends(setup.crane)[0]
    for strategy in (PD, PAPER, LQR, FLAT, FASTEST, "spline alone", "operator + ZV"):
        plan = on_converters(setup, STRATEGIES[strategy](setup, MOVES[0]))
        batch = simulate_batch(
            setup.crane,
            plan.controller(),
            plan.reference,
            start=[start] * 2,
            duration=2.0,
            drive="velocity",
        )
        means = {"start": start, "duration": 2.0, "label": "", "drive": "velocity"}
        run = setup.simulate(setup.crane, plan.controller(), plan.reference, **means)
        np.testing.assert_allclose(batch.end.q[1], run.q[-1], rtol=0.0, atol=1e-12)


def test_a_claim_about_converters_that_does_not_hold_is_one() -> None:
    def scored(later: float) -> StrategyResult:
        none = np.zeros(3)
        return StrategyResult(
            Score(10.0, 0.03, 1e-6, later, 0.0, 10.0, none, none, none, 1.0, 1.0, 0.0, 0.5)
        )

    good = {FLAT: {"as planned": scored(0.9e-3)}}
    bad = {FLAT: {"gust": scored(1.1e-3)}}
    assert [claim.holds for claim in claims.converter_claims({"one": good})] == [True]
    worst = {"one": good, "another": bad}
    assert [claim.holds for claim in claims.converter_claims(worst)] == [False]
    broken = {"one": {FLAT: {"gust": StrategyResult(None, "the rope goes slack")}}}
    assert [claim.holds for claim in claims.converter_claims(broken)] == [False]
    assert list(claims.converter_claims({"one": {PD: {"as planned": scored(1.0)}}})) == []
    table = tables.drives_table(MOVES[0], good)
    assert table.columns[-1][0] == "beyond [s]"
    assert table.rows[0][-1] == 0.5


def test_the_command_says_which_drives_it_took(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    told = ["--drive", "velocity", "--only", "operator", "--engine", FAST, "--jobs", "1"]
    assert compare.main([*told, "--out", str(folder)]) == 0
    result = json.loads((folder / "result.json").read_text())
    assert result["parameters"]["drive"] == "velocity"
    assert result["parameters"]["converters"]["delay_s"] == 0.02
    titles = [ResultTable.of(kept).title for kept in result["tables"]]
    assert not any("tour" in title for title in titles)
