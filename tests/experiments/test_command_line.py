"""Arguments of the command line that no experiment can run with end in one sentence, before
anything is planned or written.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from cranedyn.__main__ import main as front_main
from cranedyn.controllers.lqr import riccati, stationary
from cranedyn.data.trajectory import read
from cranedyn.errors import CraneError
from experiments import a1, demo, energy, harness, site
from experiments.compare import runs as compare_runs
from experiments.scenarios.moves import MOVES
from experiments.scenarios.strategies import FLAT, LQR, MPC
from tests.helpers import FAST

Main = Callable[[Sequence[str]], int]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("period", "reason"),
    [
        (
            2.0,  # longer than a dwell
            "number of control instants in a dwell is 1; allowed is 2 or more: a shorter control "
            "period, a longer dwell.",
        ),
        (1000.0, "step of the shaped reference is 1000.0 s; allowed is 0 to "),
    ],
)
def test_a_control_period_too_long_is_the_reason_in_the_table_of_the_tour(
    period: float, reason: str
) -> None:
    setup = harness.Setup(control_period=period, validity="mark", engine=FAST)
    assert str(compare_runs.tour_results(setup, "shaped")).startswith(reason)


@pytest.mark.slow
@pytest.mark.parametrize("strategy", [LQR, FLAT, MPC])
@pytest.mark.parametrize(
    "setup",
    [harness.Setup(1e9, engine=FAST), harness.Setup(values={"damp_slew": 1e12}, engine=FAST)],
)
def test_numbers_too_far_apart_for_a_regulator_are_the_reason_in_the_table_of_the_comparison(
    strategy: str, setup: harness.Setup
) -> None:
    if strategy == MPC:
        pytest.importorskip("daqp")
    found = compare_runs.strategy_results(setup, MOVES[-1:], strategy)["combined"]["as planned"]
    assert found.score is None
    assert found.why.startswith(
        "There is no linear-quadratic regulator for this crane: its masses, dampings, gravity or "
        "control period "
    )


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.full((1, 2, 2), np.inf), np.ones((1, 2, 1))),
        (np.full((1, 2, 2), 1e200), np.full((1, 2, 1), 1e200)),
        (2.0 * np.eye(2)[None], np.zeros((1, 2, 1))),
    ],
)
def test_a_system_that_cannot_be_regulated_is_a_sentence(a: np.ndarray, b: np.ndarray) -> None:
    q = np.eye(2)
    r = np.eye(1)
    with pytest.raises(CraneError, match="There is no linear-quadratic regulator"):
        stationary(a[0], b[0], q, r)
    reason = "There is no linear-quadratic regulator" if np.isfinite(a).all() else "a is inf"
    with pytest.raises(CraneError, match=reason):
        riccati(np.repeat(a, 400, axis=0), np.repeat(b, 400, axis=0), q * 1e300, r, q)


@pytest.mark.parametrize("pace", ["1e-300", "0", "nan", "inf", "1e7"])
def test_a_pace_is_one_that_a_clock_can_keep(
    pace: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert demo.main(["--pace", pace, "--cycles", "0.01", "--out", str(tmp_path / "demo")]) == 2
    assert capsys.readouterr().err == f"error: pace is {float(pace)}; allowed is 0.001 to 1e6.\n"
    assert not (tmp_path / "demo").exists()


@pytest.mark.parametrize(
    ("main", "words", "says"),
    [
        (front_main, ["describe", "-o"], "error: argument -o/--output: expected one argument"),
        (a1.main, ["a\nerror: forged"], r"error: unrecognized arguments: a\nerror: forged"),
    ],
)
def test_what_a_parser_quotes_stays_on_its_line(
    main: Callable[[list[str]], int],
    words: list[str],
    says: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    assert capsys.readouterr().err.endswith(f"{says}\n")


@pytest.mark.slow
@pytest.mark.parametrize("main", [a1.main, energy.main])
def test_another_stepping_rule_runs_and_leaves_the_claims_of_the_usual_one_unjudged(
    main: Main, tmp_path: Path
) -> None:
    words = ["--engine", FAST, *"--integrator rk4 --dt 5e-3 --gravity 9.8".split()]
    words += ["--out", str(tmp_path / "out")]
    assert main([*words, "--length", "15"] if main is a1.main else words) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert {claim["holds"] for claim in result["claims"]} == {None}
    assert result["parameters"]["integrator"] == "rk4"
    run = next(iter(result["runs"]))
    assert read(tmp_path / "out" / f"{run}.parquet").parameters["integrator"] == "RK4"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--seed -1", "seed is -1; allowed is a whole number >= 0"),
        ("--cycles 0", "cycles is 0; allowed is a whole number >= 1"),
        ("--jobs 0", "jobs is 0; allowed is a whole number >= 1"),
        ("--hours 0", "hours is 0.0 h; allowed is > 0"),
        ("--hours nan", "hours is nan h; allowed is > 0"),
    ],
)
def test_numbers_that_cannot_be_meant_are_refused_before_the_shifts(
    words: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert site.main([*words.split(), "--out", str(tmp_path / "out")]) == 2
    assert f"error: {sentence}" in capsys.readouterr().err
