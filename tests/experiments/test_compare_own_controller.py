"""Controllers of one's own in the comparison."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import CraneError
from cranedyn.interop.controller_file import open_controller
from experiments import compare, harness
from experiments.compare.runs import StrategyResult, strategy_results
from experiments.scenarios.moves import IDEAL, MOVES
from experiments.scenarios.own_controller import RATES_ON_IDEAL_DRIVES, own_plan
from experiments.scenarios.perturbations import (
    NOMINAL,
    UNOBSERVED_ACCELERATIONS,
    Perturbation,
    make,
)
from experiments.scenarios.strategies import FLAT, PD, STRATEGIES, strategy_colours
from tests.experiments.conftest import Ran
from tests.helpers import FAST

pytestmark = pytest.mark.slow

TROLLEY = MOVES[0]

PROGRAM = """
from cranedyn.controllers import follow, hold_controller
from cranedyn.controllers.integral import HOIST_INTEGRAL, HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.velocity_command import as_velocity_command

def same_as_flat(crane, motion):
    return HoistIntegral(crane, lqr(crane, motion), HOIST_INTEGRAL, float(crane.effort_limit[2]))

def in_python(crane, motion):
    law = same_as_flat(crane, motion)
    return lambda t, state, setpoint: law(t, state, setpoint)

def exact(crane, motion):
    return follow(crane, motion, motion.period), "motion"

def rates(crane, motion):
    return as_velocity_command(crane, hold_controller(crane), drive="effort"), "velocity"

def operator(crane, motion):
    return hold_controller(crane)
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("own") / "mine.py"
    file.write_text(PROGRAM)
    return file


@pytest.fixture(scope="module")
def setup() -> harness.Setup:
    return harness.Setup(engine=FAST)


def on_trolley(
    setup: harness.Setup, name: str, program: Path | None = None, drive: str = IDEAL
) -> StrategyResult:
    """Result of the trolley's move as planned."""
    source = f"{program}:{name}" if program else ""
    return strategy_results(setup, [TROLLEY], name, drive, source)[TROLLEY.name][NOMINAL.name]


@pytest.mark.parametrize(
    "name", ["same_as_flat", pytest.param("in_python", marks=pytest.mark.long)]
)
def test_a_controller_of_ones_own_makes_the_move_of_the_strategy_that_it_repeats(
    setup: harness.Setup, program: Path, name: str
) -> None:
    own = on_trolley(setup, name, program).score
    usual = on_trolley(setup, FLAT).score
    assert own is not None and usual is not None
    for key, value in asdict(usual).items():
        # Compiled code adds in another order than Python.
        np.testing.assert_allclose(asdict(own)[key], value, rtol=1e-6, atol=1e-9, err_msg=key)


def test_a_controller_that_commands_rates_has_a_result_on_converters_alone(
    setup: harness.Setup, program: Path
) -> None:
    ideal = on_trolley(setup, "rates", program)
    assert ideal.score is None and ideal.why == RATES_ON_IDEAL_DRIVES
    on_converters = on_trolley(setup, "rates", program, "velocity").score
    usual = on_trolley(setup, PD, drive="velocity").score
    # PD by rates, about another reference.
    assert on_converters is not None and usual is not None
    assert on_converters.later < 0.1 * usual.later


def test_the_command_says_at_once_that_a_controller_of_another_period_has_no_result(
    setup: harness.Setup, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = {"A": [[0.9]], "B": [[1.0]], "C": [[20.0]], "D": [[-4000.0]], "dt": 0.02}
    file = tmp_path / "slow.json"
    file.write_text(json.dumps({**content, "inputs": ["x"], "outputs": ["F_x"]}))
    by_case = strategy_results(setup, [TROLLEY], "slow", IDEAL, str(file))[TROLLEY.name]
    compare.print_missing_results({move: {"slow": by_case} for move in ("one", "another")})
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("slow has no result: ")
    assert "control period of the run is 0.005 s; allowed is that of the controller, 0.02" in line


def test_no_observer_of_efforts_is_put_before_a_controller_that_commands_accelerations(
    setup: harness.Setup, program: Path
) -> None:
    own = open_controller(f"{program}:exact")
    plan = own_plan(setup, TROLLEY, own, IDEAL)
    assert plan.drive == "motion"
    with pytest.raises(CraneError, match=UNOBSERVED_ACCELERATIONS):
        make(setup, TROLLEY, plan, Perturbation("observed", observer="state"))


def test_a_function_that_is_called_like_a_strategy_is_refused_before_anything_runs(
    program: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--only", FLAT, "--controller"]
    assert compare.main([*words, f"{program}:operator"]) == 2
    assert "has the name of a strategy, operator; rename it" in capsys.readouterr().err
    assert compare.main([*words, f"{program}:absent"]) == 2
    assert "There is no function in" in capsys.readouterr().err


def test_controllers_of_ones_own_are_recorded_in_colours_of_their_own() -> None:
    names = ["operator", FLAT, "first", PD, "second"]
    recorded = compare.recorded_strategies(names)
    assert recorded == [PD, FLAT, "first", "second"]
    colours = strategy_colours(recorded)
    assert len(set(colours.values())) == 4
    assert strategy_colours([*STRATEGIES])[PD] == colours[PD]


@pytest.mark.long
def test_the_command_shows_ones_own_controller_in_every_table_and_figure(
    ran: Callable[..., Ran], program: Path
) -> None:
    source = f"{program}:same_as_flat"
    words = ["--only", FLAT, "--engine", FAST, "--jobs", "1"]
    done = ran("compare", *words, "--controller", source)
    assert done.code == 0
    titles = [kept["title"] for kept in done.result["tables"]]
    assert any(title.startswith("Settled within") for title in titles)
    for kept in done.result["tables"]:
        table = done.table(kept["title"])
        if "strategy" not in table[0]:
            continue
        usual, own = table
        assert own["strategy"] == "same_as_flat"
        for column, value in usual.items():
            if column != "strategy" and value is not None:
                assert own[column] == pytest.approx(value, rel=1e-3, abs=1e-6), column
    files = {path.name for path in done.folder.iterdir()}
    assert "compare_same_as_flat.parquet" in files
    assert b"same_as_flat" in (done.folder / "compare.rrd").read_bytes()
