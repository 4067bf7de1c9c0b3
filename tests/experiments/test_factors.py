"""Experiment factors: formulas as printed, the same by simulation, and what control needs."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from experiments.factors.derived import AGREES
from experiments.factors.formulas import FORMULAS, Compared
from tests.experiments.conftest import Ran
from tests.helpers import FAST


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda one: one.name)
def test_a_formula_gives_what_its_source_prints(formula: Compared) -> None:
    assert formula.holds, formula.formula


def test_a_factor_that_is_not_mechanics_is_seen() -> None:
    public = Compared("ψ_h", "braking", 2.082, 2.041196, AGREES)
    assert not public.holds
    assert public._replace(formula=2.041241).holds


def test_a_shaped_drive_needs_no_more_than_a_load_that_leans(ran: Callable[..., Ran]) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    rows = ran("factors", "--engine", FAST).table("What a move needs")
    needed = {(row["move"], row["strategy"]): row["needed"] for row in rows}
    # Two halves of a push, half a period apart, leave the load leaning by a/g while it lasts.
    assert needed["trolley", "operator + ZV"] == pytest.approx(1.0, abs=0.01)
