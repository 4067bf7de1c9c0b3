"""What somebody reads first: short, true, and every command and link of it there."""

from __future__ import annotations

import csv
import re
import tomllib
from pathlib import Path

import pytest

import cranedyn as cd
from cranedyn import __main__ as face
from cranedyn import plugins
from tests.document_numbers import missing
from tests.helpers import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
NUMBER = r"[+-]?\d+(?:\.\d+)?(?:e-\d+)?"
PAGES = sorted(
    [ROOT / "README.md", *(ROOT / "docs").glob("**/*.md"), *(ROOT / "examples").glob("*.md")]
)


def test_the_japanese_readme_has_commands_pictures_and_numbers_of_the_english_one() -> None:
    japanese = (ROOT / "docs/README.ja.md").read_text(encoding="utf-8")
    for pattern in (r"```.*?```", r"!\[.*?\]\((?:docs/)?(.*?)\)", r"`cranedyn .*?`"):
        english, other = (re.findall(pattern, text, re.DOTALL) for text in (README, japanese))
        assert english == other
        assert english
    english, other = (re.findall(r"^\|.*(?:mrad|`).*", text, re.M) for text in (README, japanese))
    assert len(english) > 10
    for rows in zip(english, other, strict=True):
        first, second = (sorted(re.findall(NUMBER, row)) for row in rows)
        assert first == second, rows


def test_the_readme_tells_of_lifts_and_twins_what_the_results_do() -> None:
    page = (ROOT / "docs/results/lifts.md").read_text(encoding="utf-8")
    below = re.findall(r"^\| \w+ \| 10000 \| \d+ \| (\S+) \|", page, re.MULTILINE)
    told = [f"0 to {max(map(float, below))} % of perturbed lifts"]
    table = ROOT / "docs/results/identify_positions_estimates.csv"
    row = next(csv.DictReader(table.open(encoding="utf-8")))
    assert row["parameter"] == "l_offset"
    told.append(f"a cable offset of {row['true']} m, identified to ± {row['±']} m")
    assert missing(told, "README.md") == []


@pytest.mark.slow
def test_the_python_of_the_readme_runs_and_makes_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (script,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(script.splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    made: dict[str, object] = {}
    exec(compile(script, "README.md", "exec"), made)
    run = made["run"]
    assert isinstance(run, cd.Trajectory)
    assert run.t[-1] == 20.0
    assert (tmp_path / "run.csv").stat().st_size > 100_000
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_file_that_a_page_links_to_is_there(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if not target.startswith(("http", "#")):
            assert (page.parent / target.partition("#")[0]).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_command_of_ours_that_a_page_names_is_there(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m (experiments\.[\w.]+)", text):
        path = ROOT / Path(*module.rstrip(".").split("."))
        assert path.with_suffix(".py").exists() or path.is_dir() or module.endswith("NAME"), module
    for word, name in re.findall(r"(?:^|`)cranedyn ([\w-]+)(?: (\w+))?", text, re.MULTILINE):
        assert word in face.COMMANDS
        assert word != "run" or name in ["", *plugins.names("experiment")]


def test_version_changelog_and_citation_agree_on_a_dated_release() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert project["tool"]["hatch"]["version"]["path"] == "cranedyn/version.py"
    newest = re.search(
        r"^## (\S+) - (\d{4}-\d\d-\d\d)$",
        (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert newest is not None
    assert newest[1] == cd.__version__
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {newest[1]}\ndate-released: {newest[2]}\n" in citation
