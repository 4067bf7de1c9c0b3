"""Controllers of other papers: their published cases, and that they move a crane."""

from __future__ import annotations

import numpy as np
import pytest

from cranedyn.benchmark import papers
from cranedyn.benchmark.baselines import container_crane_lqr, kaepernick_mpc
from cranedyn.benchmark.entry import Declined, briefing_of
from cranedyn.benchmark.evaluate import run_instance
from cranedyn.benchmark.task import instances, select_tasks
from cranedyn.references.shaped import ei, zv, zvd
from tests.benchmark.toys import InThisProcess

casadi = pytest.importorskip("casadi", reason="extra optimal (casadi) is not installed")


@pytest.mark.slow
def test_the_container_crane_has_its_published_cost() -> None:
    """Six digits are published; with twice as many intervals ours changes in the seventh."""
    found = papers.minimum_swing(papers.ContainerCrane())
    assert found.cost == pytest.approx(papers.REFERENCE_COST, abs=1e-7)
    # The dynamics by another rule: RK4 along the same inputs ends where the paper asks for.
    crane = papers.ContainerCrane()
    x = np.array(crane.start)

    def rates(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        angle = -(u[0] + crane.c5 * x[2] + 2.0 * x[4] * x[5]) / x[1]
        return np.array([x[3], x[4], x[5], u[0] + crane.c4 * x[2], u[1], angle])

    for k in range(len(found.t) - 1):
        x = papers.integrated(rates, x, found.u[k], found.u[k + 1], found.t[1], substeps=10)
    # The error of collocation over 90 intervals of 0.1 s, whose fourth power is 1e-4 of a unit.
    assert x == pytest.approx(np.array(crane.goal), abs=2e-4)


@pytest.mark.slow
def test_the_first_plan_of_grampc_has_the_cost_that_its_own_program_finds() -> None:
    """It comes from above as its iterations grow: 27.0831, 27.0828, 27.0826."""
    control, start, goal = papers._grampc_example()
    states, inputs = control.plan(start, goal)
    assert control.cost <= papers.GRAMPC_COST
    assert control.cost == pytest.approx(papers.GRAMPC_COST, abs=5e-4)
    assert inputs[0, 0] == pytest.approx(papers.GRAMPC_ACCELERATION, abs=1e-4)
    assert np.abs(states[1:, 5]).max() < papers.GRAMPC_SWING_RATE + 1e-6


@pytest.mark.slow
def test_a_scaled_plan_is_the_same_motion_in_other_units() -> None:
    """On a rope four times as long distances are four times, and times twice, as long."""
    control, start, goal = papers._grampc_example()
    states, inputs = control.plan(start, goal)
    scaled = papers.CraneMpc(
        accelerations=[papers.GRAMPC_ACCELERATION] * 2,
        swing_rate=papers.GRAMPC_SWING_RATE / 2.0,
        scale=4.0,
        obstacle=papers.GRAMPC_OBSTACLE,
    )
    others, same = scaled.plan(4.0 * start, 4.0 * goal)
    assert scaled.step == pytest.approx(2.0 * control.step)
    assert others == pytest.approx(states * np.array([4.0, 2.0, 4.0, 2.0, 1.0, 0.5]), abs=1e-5)
    assert same == pytest.approx(inputs, abs=1e-5)


def test_shapers_are_as_insensitive_as_is_published() -> None:
    """By closed forms for an undamped swing: of zv |cos(π r/2)| is left, of zvd its square; Klipper
    prints rounded numbers for some damping.
    """
    for shaper, left, closed in (
        (zv(), 0.1, 2.0 / np.pi * np.arcsin(0.1)),
        (zvd(), 0.05, 2.0 / np.pi * np.arcsin(np.sqrt(0.05))),
    ):
        assert papers.insensitivity(shaper, left) == pytest.approx((closed, closed), abs=1e-9)
    assert papers.insensitivity(zvd(), 0.05) == pytest.approx((0.15, 0.15), abs=0.01)
    assert papers.insensitivity(ei(), 0.05) == pytest.approx((0.20, 0.20), abs=0.005)


def test_the_table_of_papers_has_published_numbers_beside_ours() -> None:
    table = papers.paper_table([papers.Reproduced("a case", "a number [m]", 1.5, 1.25)])
    assert table.splitlines()[1].split() == ["a", "case", "a", "number", "[m]", "1.5", "1.25"]


@pytest.mark.slow
@pytest.mark.parametrize("entry", [kaepernick_mpc, container_crane_lqr])
def test_a_controller_of_a_paper_moves_the_gantry(entry: object) -> None:
    (task,) = select_tasks(["gantry/move"])
    process = InThisProcess(entry)  # type: ignore[arg-type]
    result = run_instance(instances(task)[0], process)  # type: ignore[arg-type]
    assert result.status == "passed", result.reason
    assert task.least_time is not None
    assert result.metrics["settled_s"] > task.least_time


def test_controllers_of_papers_decline_what_they_are_not_made_for() -> None:
    for name in ("tower/move", "inteco/operator"):
        (task,) = select_tasks([name])
        for entry in (kaepernick_mpc, container_crane_lqr):
            with pytest.raises(Declined):
                entry(briefing_of(task))
    (task,) = select_tasks(["inteco/move"])
    with pytest.raises(Declined, match="the bridge moves as well"):
        container_crane_lqr(briefing_of(task))
