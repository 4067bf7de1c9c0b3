"""Pages of docs/: how they begin, and what a reader is told to run."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import cranedyn as cd
from cranedyn.__main__ import main
from cranedyn.lifts.planning.perturbed import CONFIDENCE
from cranedyn.lifts.planning.site_file import read_site
from experiments.harness.document import unlike_files
from experiments.scenarios.strategies import STRATEGIES
from tests.helpers import ROOT

PAGES = sorted([*(ROOT / "docs").glob("**/*.md"), ROOT / "README.md"])
KINDS = ("tutorial", "howto", "concepts", "results")
ELSEWHERE = {"README.md", "README.ja.md", "sweep.md", "experiment.md", "benchmark.md"}
"""Pages whose code other tests run: test_readme.py, tests/sweep/test_sweep_dask.py, those of
tests/benchmark, and below."""
LONG = {
    *("control.md", "design_to_plc.md", "drive.md", "drives.md", "first_lift.md"),
    "foreign_cranes.md",
    *(
        "judge_lift.md",
        "lift_chain.md",
        "lift_from_ground.md",
        "other_cranes_lift.md",
        "own_design.md",
    ),
    *("planning.md", "several_cranes.md"),
}
"""Pages whose code takes longest."""
MODULES = {
    "compiled": "llvmlite",
    "optimal": "casadi",
    "planning": "toppra",
    "serve": "asyncua",
}
"""Module to look for by the name of its extra, where they differ."""


def scripts(page: Path) -> list[str]:
    """Return the Python of a page."""
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)


def of_kinds(*kinds: str) -> list[Path]:
    """Return the pages of kinds."""
    folders = [ROOT / "docs" / kind for kind in kinds]
    return [page for page in PAGES if page.parent in folders]


def name(page: Path) -> str:
    """Return the path of a page below the repository."""
    return page.relative_to(ROOT).as_posix()


def anchors_of(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as the documentation makes them."""
    anchors = set()
    for heading in re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.M):
        words_only = re.sub(r"[^\w\s-]", "", heading.strip().lower())
        anchors.add(re.sub(r"\s+", "-", words_only))
    return anchors


@pytest.mark.parametrize("page", of_kinds(*KINDS), ids=name)
def test_a_page_begins_with_a_sentence_and_an_example(page: Path) -> None:
    title, first, *others = re.split(r"\n\n+", page.read_text(encoding="utf-8"))
    assert title.startswith("# ")
    assert first.endswith((".", ":"))
    assert not first.startswith(("|", "!", "```"))
    assert any(part.startswith("```") for part in others[:3])


def test_the_glossary_is_in_order_and_names_an_existing_heading_for_each_word() -> None:
    """Each entry explains its words in a line that ends with links to the pages about them."""
    glossary = ROOT / "docs/concepts/glossary.md"
    entries = re.findall(r"^\* \*\*(.+?)\*\*(.+)$", glossary.read_text(encoding="utf-8"), re.M)
    words = [re.sub(r"[^a-z0-9 ]", "", word.lower()) for word, _ in entries]
    assert words == sorted(words)
    assert len(words) > 100
    for word, text in entries:
        links = re.findall(r"\]\(([^)#]+)(?:#([^)]+))?\)", text)
        assert links or "see *" in text, word
        for target, anchor in links:
            page = (glossary.parent / target).resolve()
            assert page.is_file(), f"{word}: {target}"
            assert not anchor or anchor in anchors_of(page), f"{word}: {target}#{anchor}"


def test_every_csv_file_is_linked_from_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in of_kinds("results"))
    files = {file.name for file in (ROOT / "docs/results").glob("*.csv")}
    assert files == set(re.findall(r"\]\((\w+\.csv)\)", text))


def test_the_first_page_links_every_other_one() -> None:
    """On the forge there is no menu of pages."""
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(([\w/.]+\.md)", text))
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in PAGES if page.parent != ROOT}
    assert pages - linked == {"index.md", "README.ja.md"}


@pytest.mark.parametrize("page", of_kinds("results"), ids=name)
def test_a_page_shows_the_tables_that_lie_beside_it_as_csv_files(page: Path) -> None:
    assert unlike_files(page) == []


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to run a page in, beside the experiments, with no viewer and no browser."""
    monkeypatch.chdir(tmp_path)
    for name in ("experiments", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.setattr(cd, "view", lambda run: None)
    monkeypatch.setattr("webbrowser.open", lambda address: None)
    # a page adds a strategy of its own
    monkeypatch.setattr("experiments.scenarios.strategies.STRATEGIES", dict(STRATEGIES))
    # tests/export/test_page.py plans them
    monkeypatch.setattr("cranedyn.export.driving_page.exercises", lambda *_: [])
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.long if page.name in LONG else ())
        for page in PAGES
        if scripts(page) and page.name not in ELSEWHERE and page not in of_kinds("tutorial")
    ],
    ids=name,
)
def test_the_python_of_a_page_runs(page: Path, folder: Path) -> None:
    for extra in re.findall(r"pip install 'cranedyn\[(\w+)\]'", page.read_text(encoding="utf-8")):
        pytest.importorskip(MODULES.get(extra, extra), reason=f"the extra {extra} is not installed")
    scope: dict[str, object] = {"__name__": "page"}
    for script in scripts(page):
        exec(compile(script, page.name, "exec", dont_inherit=True), scope)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.long if page.name in LONG else ())
        for page in of_kinds("tutorial")
    ],
    ids=name,
)
def test_every_line_of_a_tutorial_runs(page: Path, folder: Path) -> None:
    if page.name == "first_lift.md":
        pytest.importorskip("toppra", reason="the extra planning is not installed")
    text = page.read_text(encoding="utf-8")
    scope: dict[str, object] = {"__name__": "page"}
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, re.S | re.M):
        if language == "python":
            exec(compile(block, page.name, "exec", dont_inherit=True), scope)
            continue
        if language == "toml":
            (folder / "yard.toml").write_text(block)
            continue
        for _, *words in map(shlex.split, block.splitlines()):
            # the lift of the tutorial's own site is no go, exit code 1
            is_no_go = "lift_report" in words and "yard.toml" in words
            assert main(words) == int(is_no_go)


@pytest.mark.slow
@pytest.mark.long
def test_the_comparison_makes_its_moves_by_the_strategy_that_a_script_of_the_page_adds(
    tmp_path: Path,
) -> None:
    script = scripts(ROOT / "docs/howto/compare_controllers.md")[-1]
    (tmp_path / "mine.py").write_text(script, encoding="utf-8")
    words = ["mine.py", "--engine", "compiled", "--only", "mine", "--out", "out"]
    done = subprocess.run(
        [sys.executable, *words],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode in (0, 1), done.stderr
    result = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))
    moves = [table for table in result["tables"] if table["title"].startswith("Move")]
    assert len(moves) == 4
    for table in moves:
        assert [row[0] for row in table["rows"]] == ["mine"], table["title"]
        assert None not in table["rows"][0], table["title"]


@pytest.mark.parametrize("page", ["tutorial/first_lift.md", "howto/judge_lift.md"])
def test_a_page_asks_for_as_many_lifts_as_show_a_risk_below_one_per_cent(page: str) -> None:
    """Clopper and Pearson's upper bound for no failure in n lifts is 1 - α^(1/n)."""
    alpha = (1.0 - CONFIDENCE) / 2.0
    lifts = math.ceil(math.log(alpha) / math.log(1.0 - 0.01))
    assert f" {lifts} " in (ROOT / "docs" / page).read_text(encoding="utf-8")


def test_the_site_file_of_the_how_to_about_a_crane_is_one(tmp_path: Path) -> None:
    text = (ROOT / "docs/howto/my_tower_crane.md").read_text(encoding="utf-8")
    (table,) = re.findall(r"^```toml\n(.*?)^```", text, re.S | re.M)
    (tmp_path / "crane.toml").write_text(table, encoding="utf-8")
    site = read_site(tmp_path / "crane.toml")
    assert site.chart == "mct88"
    assert site.crane["trolley_max"] == 29.9


@pytest.mark.slow
def test_the_experiment_of_the_how_to_holds_its_claim_and_writes_its_files(folder: Path) -> None:
    (script,) = scripts(ROOT / "docs/howto/experiment.md")
    scope: dict[str, Any] = {"__name__": "page"}
    exec(compile(script, "experiment.md", "exec", dont_inherit=True), scope)
    assert scope["main"](["--out", str(folder / "out")]) == 0
    names = ("result.json", "free_swing.parquet", "free_swing.png", "NAME.rrd")
    assert [name for name in names if not (folder / "out" / name).is_file()] == []
