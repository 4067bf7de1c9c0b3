"""What holds of every experiment, each run whole: its claims, its documents, its files."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest

from experiments.catalogue import EXPERIMENTS
from experiments.harness.document import read_document
from experiments.harness.table import ResultTable
from experiments.report import page
from tests.experiments.conftest import Ran
from tests.helpers import FAST, ROOT, files

WHOLE = [
    "b1",
    "cylinders",
    "factors",
    "gazebo",
    "hook",
    "rope",
    # The longest; test files of their names test them in parts.
    *(
        pytest.param(name, marks=pytest.mark.long)
        for name in ("cranes", "liftoff", "linear_vs_full", "ship", "validate")
    ),
]

NEEDED = {
    "cranes": ("llvmlite", "mujoco"),
    "factors": ("llvmlite",),
    "hook": ("llvmlite",),
    "liftoff": ("llvmlite",),
}
"""Modules of extras without which an experiment is skipped."""

pytestmark = pytest.mark.slow


@pytest.fixture(params=WHOLE)
def result(request: pytest.FixtureRequest, ran: Callable[..., Ran]) -> Ran:
    """An experiment as run."""
    for module in NEEDED.get(request.param, ()):
        pytest.importorskip(module)
    return ran(request.param, "--engine", FAST)


def test_every_claim_is_judged_and_holds(result: Ran) -> None:
    assert result.failed() == []
    assert result.code == 0
    count = len(result.result["claims"])
    assert f"{count} of {count} claims hold, 0 not judged." in result.text


def test_documents_show_its_tables(result: Ran) -> None:
    name = result.result["experiment"]
    tables = result.result["tables"]
    for document in (ROOT / "docs").rglob("*.md"):
        if re.search(
            f"<!-- {name}( table)?( [a-z0-9_]+[.]csv)?:", document.read_text(encoding="utf-8")
        ):
            made = [ResultTable.of(table) for table in tables]
            assert read_document(document, name).stale(made) == []


def test_its_files_are_those_it_lists_and_nothing_else(result: Ran) -> None:
    name = result.result["experiment"]
    figures = result.result["figures"]
    expected = {f"{run}.parquet" for run in result.result["runs"]}
    expected |= {*figures, *(figure.replace(".png", ".svg") for figure in figures)}
    recording = () if name == "gazebo" else (f"{name}.rrd",)
    assert {*files(result.folder)} == expected | {"result.json", *recording}
    captions = [EXPERIMENTS[name].caption(figure.removesuffix(".png")) for figure in figures]
    assert all(len(caption.split()) > 4 for caption in captions)


def test_the_report_shows_it(result: Ran) -> None:
    assert f'<section id="{result.result["experiment"]}">' in page([result.folder])
