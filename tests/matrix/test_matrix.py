"""Every crane does every job, or is refused for the reason that the matrix names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cranedyn as cd
from cranedyn.controllers import hold_controller
from cranedyn.dynamics.converters import converters
from cranedyn.errors import CraneError
from cranedyn.export.browser_crane import usual_limits
from cranedyn.lifts.planning.lift import plan_lift
from tests.matrix.cells import read_cells
from tests.matrix.cranes import CRANES, crane_named
from tests.matrix.jobs import JOBS, free_site
from tests.matrix.page import PAGE, page_text

pytest.importorskip("llvmlite", reason="the extra compiled is not installed")

pytestmark = pytest.mark.slow

EXPECTED = read_cells()

REPRESENTATIVE = "wall"
"""The crane that does every job in the default run of the tests."""


def _cells() -> list[Any]:
    """Return each crane and job; those of most cranes are marked long."""
    cells = []
    for crane in CRANES:
        marks = () if crane == REPRESENTATIVE else pytest.mark.long
        cells.extend(pytest.param(crane, job, marks=marks) for job in JOBS)
    return cells


@pytest.mark.parametrize(("crane", "job"), _cells())
def test_a_crane_does_a_job_or_is_refused_as_the_matrix_says(
    crane: str, job: str, tmp_path: Path
) -> None:
    refusal = EXPECTED.refusals.get((crane, job))
    if refusal is None:
        JOBS[job](crane_named(crane), tmp_path)
        return
    with pytest.raises(CraneError) as refused:
        JOBS[job](crane_named(crane), tmp_path)
    assert str(refused.value) == refusal.sentence


@pytest.mark.long
@pytest.mark.parametrize("name", ["hook", "elastic rope", "two falls"])
def test_a_crane_that_no_lift_is_planned_for_follows_the_lift_of_the_crane_without_its_extras(
    name: str,
) -> None:
    """As the page advises. The drives arrive where the lift ends, within what position loops leave
    of the load's pull.
    """
    pytest.importorskip("toppra", reason="the extra planning is not installed")
    planned_for = crane_named("tower")
    limits = usual_limits(converters(planned_for))
    motion = plan_lift(free_site(planned_for), limits, crane=planned_for).timed.motion
    crane = crane_named(name)
    hold = hold_controller(crane)
    run = cd.simulate(crane, hold, lambda t: motion(t), duration=motion.arrival + 5.0)
    goal = motion.q[-1, planned_for.layout.drives]
    # The ranges of both cranes are the same, and the goal is a twentieth of the first away.
    np.testing.assert_allclose(run.q[-1, crane.layout.drives], goal, atol=0.05)


def test_the_matrix_names_cranes_and_jobs_that_exist_and_uses_every_reason() -> None:
    for crane, job in EXPECTED.refusals:
        assert crane in CRANES
        assert job in JOBS
    used = {refusal.reason for refusal in EXPECTED.refusals.values()}
    assert used == set(EXPECTED.reasons)


def test_the_page_shows_the_matrix() -> None:
    assert PAGE.read_text("utf-8") == page_text()
