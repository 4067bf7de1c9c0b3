"""The sweep over load, cable and timing: its cases are those of `simulate`, its command keeps,
resumes and shows them.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.interfaces import Setpoint, State
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import results
from experiments import report, sweep
from experiments.harness.setup import Setup
from experiments.report import page
from experiments.scenarios.robustness import AFTER, COMBINED, SWEPT, robustness
from experiments.scenarios.strategies import FLAT, PAPER, PD
from tests.helpers import ROOT
from tests.told import missing


def cases(**columns: object) -> dict[str, np.ndarray]:
    rows = max(np.size(column) for column in columns.values())
    clocks = {"gravity_m_s2": 9.80665, "dt_s": 1e-3, "control_period_s": 1e-2}
    return {
        name: np.resize(np.array(column), rows) for name, column in {**clocks, **columns}.items()
    }


@pytest.mark.parametrize("strategy", SWEPT)
def test_a_case_is_the_move_of_that_crane_alone_with_a_cable_misread(strategy: str) -> None:
    load, error, duration = 1.3, 0.7, 20.0
    found = robustness(
        cases(strategy=strategy, duration_s=duration, load=[1.0, load], cable_error_m=[0.0, error])
    )
    setup = Setup(dt=1e-3, control_period=1e-2)
    crane, move = (
        setup.variant(payload_mass=load * setup.crane.payload_mass),
        replace(COMBINED, duration=duration),
    )
    plan = SWEPT[strategy](setup, move)
    controller, (start, goal) = plan.controller(), move.ends(setup.crane)
    longer = np.array([0.0, 0.0, 0.0, 0.0, error])

    def misled(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        return controller(t, State(state.q - longer, state.v), setpoint)

    ends = 1e-2 * math.ceil((plan.arrives + AFTER) / 1e-2 - 1e-9)
    run = simulate(
        crane,
        misled,
        plan.reference,
        start=State(start.q + longer, start.v),
        duration=ends,
        dt=1e-3,
        control_period=1e-2,
        drive=plan.drive,
        validity="mark",
    )
    left = swing_amplitude(run.q[-1:, 2:4], run.v[-1:, 2:4], run.q[-1:, 4], setup.gravity)[0]
    away = np.linalg.norm(
        payload_position(crane, run.q[-1]) - payload_position(crane, goal.q + longer)
    )
    # Engines agree to 1e-12 a second; amplitudes of 1e-6 rad are roots of squares of 1e-12, so 1e-9
    # is round-off's
    assert found["residual_swing_rad"][1] == pytest.approx(left, abs=1e-9)
    assert found["peak_swing_rad"][1] == pytest.approx(
        np.linalg.norm(run.q[:, 2:4], axis=1).max(), abs=1e-9
    )
    assert found["off_goal_m"][1] == pytest.approx(away, abs=1e-8)
    assert run.valid.all() and found["valid_until_s"].count() == 0


def test_rows_come_back_in_the_order_of_the_cases_whatever_their_plans() -> None:
    mixed = cases(
        strategy=["spline + ZV", "spline alone", "spline + ZV"],
        duration_s=[20.0, 20.0, 30.0],
        load=1.0,
        cable_error_m=[0.0, 0.5, 0.5],
    )
    together = robustness(mixed)
    for row in range(3):
        alone = robustness({name: column[row : row + 1] for name, column in mixed.items()})
        # To the bit, whoever runs beside it.
        assert together["residual_swing_rad"][row] == alone["residual_swing_rad"][0]


def test_the_command_sweeps_shows_and_does_not_sweep_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "--points",
        "2",
        "--durations",
        "1",
        "--workers",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    assert sweep.main(arguments) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert [claim["holds"] for claim in result["claims"]] == [True] * 3
    assert all((tmp_path / "out" / name).stat().st_size > 10_000 for name in result["figures"])
    assert '<section id="sweep">' in page([tmp_path / "out"])
    kept = results(tmp_path / "out" / "cases")
    assert kept.num_rows == 4 * len(SWEPT) == sum(row[1] for row in result["tables"][0]["rows"])
    assert '<section id="sweep">' in report.page([tmp_path / "out"])  # formats of thousands, too
    parts = {
        part: part.stat().st_mtime_ns for part in (tmp_path / "out" / "cases").glob("*.parquet")
    }
    assert sweep.main(arguments) == 0
    assert {part: part.stat().st_mtime_ns for part in parts} == parts
    assert sweep.main([*arguments[:1], "3", *arguments[2:]]) == 2
    assert "another" in capsys.readouterr().err


def test_the_readme_tells_the_worst_of_the_whole_sweep_as_its_document_shows_it() -> None:
    table = ROOT / "docs" / "results" / "sweep_swing_left_by_moves.csv"
    rows = {row[0]: row for row in csv.reader(table.open(encoding="utf-8"))}
    worst = [format(float(rows[strategy][5]), ".2g") for strategy in (PD, PAPER, FLAT)]
    assert missing([f"PD; paper; flat + LQR | | | {'; '.join(worst)} mrad"], "README.md") == []


@pytest.mark.parametrize(
    "unused",
    [["--engine", "pinocchio"], ["--view"], ["--serve"], ["--save", "x.rrd"], ["--port", "1"]],
)
def test_arguments_that_a_sweep_has_no_use_for_are_refused(
    unused: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        sweep.main([*unused, "--points", "1"])
    assert ended.value.code == 2
    assert unused[0] in capsys.readouterr().err
