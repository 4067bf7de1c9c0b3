"""Experiment factors: formulas as printed, the same by simulation, and what control needs."""

from __future__ import annotations

import json

import pytest

from experiments import factors
from experiments.harness.document import read_document
from experiments.harness.outcome import ResultTable
from experiments.standards.derived import AGREES
from experiments.standards.formulas import FORMULAS, Compared
from tests.helpers import ROOT


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    folder = tmp_path_factory.mktemp("factors") / "out"
    assert factors.main(["--out", str(folder)]) == 0
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("formula", FORMULAS, ids=lambda one: one.name)
def test_a_formula_gives_what_its_source_prints(formula: Compared) -> None:
    assert formula.holds, formula.formula


def test_every_claim_about_factors_holds(result: dict) -> None:
    assert len(FORMULAS) >= 20
    assert [claim["sentence"] for claim in result["claims"] if claim["holds"] is not True] == []
    formulas, found, moves, hoists = result["tables"]
    assert len(formulas["rows"]) == len(FORMULAS) and len(found["rows"]) == 19
    assert len(moves["rows"]) == 8 and len(hoists["rows"]) == 4


def test_a_factor_that_is_not_mechanics_is_seen() -> None:
    public = Compared("ψ_h", "braking", 2.082, 2.041196, AGREES)
    assert not public.holds
    assert public._replace(formula=2.041241).holds


def test_a_shaped_drive_needs_no_more_than_a_load_that_leans(result: dict) -> None:
    needed = {(row[0], row[1]): row[4] for row in result["tables"][2]["rows"]}
    # Two halves of a push, half a period apart, leave the load leaning by a/g while it lasts.
    assert needed["trolley", "operator + ZV"] == pytest.approx(1.0, abs=0.01)


def test_the_page_on_lifting_shows_what_the_experiment_prints(result: dict) -> None:
    tables = [ResultTable.of(kept) for kept in result["tables"]]
    page = read_document(ROOT / "docs" / "lifting.md", "factors")
    assert page.stale(tables) == []
