"""Pages of docs/: how they begin, and what a reader is told to run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import cranedyn as cd
from cranedyn.__main__ import main
from cranedyn.lifts.planning.site_file import read_site
from tests.helpers import ROOT

PAGES = sorted([*(ROOT / "docs").glob("**/*.md"), ROOT / "README.md"])
KINDS = ("tutorial", "howto", "concepts", "results")
ELSEWHERE = {"README.md", "README.ja.md", "sweep.md", "experiment.md"}
"""Pages whose code other tests run: test_readme.py, tests/sweep/test_sweep_dask.py and below."""
LONG = {
    *("control.md", "drive.md", "drives.md", "first_lift.md", "judge_lift.md"),
    *("lift_from_ground.md", "other_cranes_lift.md", "planning.md", "several_cranes.md"),
}
"""Pages whose code takes longest."""
MODULES = {"compiled": "llvmlite", "optimal": "casadi", "planning": "toppra"}
"""Module to look for by the name of its extra, where they differ."""


def scripts(page: Path) -> list[str]:
    """Return the Python of a page."""
    return re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M)


def of_kinds(*kinds: str) -> list[Path]:
    """Return the pages of kinds."""
    return [page for page in PAGES if page.parent.name in kinds]


def name(page: Path) -> str:
    """Return the path of a page below the repository."""
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", of_kinds(*KINDS), ids=name)
def test_a_page_begins_with_a_sentence_and_an_example(page: Path) -> None:
    title, first, *others = re.split(r"\n\n+", page.read_text(encoding="utf-8"))
    assert title.startswith("# ")
    assert first.endswith((".", ":"))
    assert not first.startswith(("|", "!", "```"))
    assert any(part.startswith("```") for part in others[:3])


def test_every_csv_file_is_linked_from_a_page() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in of_kinds("results"))
    files = {file.name for file in (ROOT / "docs/results").glob("*.csv")}
    assert files == set(re.findall(r"\]\((\w+\.csv)\)", text))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to run a page in, beside the experiments, with no viewer and no browser."""
    monkeypatch.chdir(tmp_path)
    for name in ("experiments", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.setattr(cd, "view", lambda run: None)
    monkeypatch.setattr("webbrowser.open", lambda address: None)
    # tests/export/test_page.py plans them
    monkeypatch.setattr("cranedyn.export.driving_page.exercises", lambda *_: [])
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.long if page.name in LONG else ())
        for page in PAGES
        if scripts(page) and page.name not in ELSEWHERE and page.parent.name != "tutorial"
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
            # a lift without the masses of its crane is no go, exit code 1
            assert main(words) == int("lift_report" in words)


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
