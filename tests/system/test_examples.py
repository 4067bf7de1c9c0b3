"""Every example runs as it stands, is a screenful, and leaves what it makes where it was
started.
"""

from __future__ import annotations

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.helpers import ROOT

SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def test_there_are_a_dozen_and_the_list_names_each() -> None:
    page = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    assert len(SCRIPTS) >= 12
    named = re.findall(r"\]\((\w+\.(?:py|ipynb))\)", page)
    assert sorted(named) == sorted(path.name for path in SCRIPTS + NOTEBOOKS)


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_an_example_runs_and_is_a_screenful(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith('"""')
    assert len(text.splitlines()) <= 45
    if needs := re.search(r"Needs: (\w+)\.", text):
        if importlib.util.find_spec(needs[1]) is None:
            pytest.skip(f"{needs[1]} is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    before = _names(script.parent)
    if "python -m " in text.split('"""')[1]:  # one whose functions workers import
        path = os.pathsep.join([str(script.parent), str(ROOT)])
        done = subprocess.run(
            [sys.executable, "-m", script.stem],
            capture_output=True,
            text=True,
            env=os.environ | {"PYTHONPATH": path},
            check=False,
            timeout=120,
        )
        assert (done.returncode, done.stderr) == (0, "")
        said = done.stdout
    else:
        runpy.run_path(str(script), run_name="__main__")
        said, error = capsys.readouterr()
        assert error == ""
    assert said
    assert "nan" not in said.lower()
    assert _names(script.parent) == before
    for picture in tmp_path.glob("*.png"):
        assert picture.stat().st_size > 10_000


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name != "__pycache__")


@pytest.mark.slow
def test_the_wall_crane_is_held_and_swept_to_less_than_a_milliradian(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import wall_crane  # type: ignore[import-not-found]

    wall_crane.main(tmp_path)
    last = re.findall(r": ([\d.]+) mrad", capsys.readouterr().out)[:2]
    assert max(map(float, last)) < 1.0  # of 141 and 283 mrad at the start
    assert (tmp_path / "wall_crane.rrd").stat().st_size > 1e5


@pytest.mark.slow
@pytest.mark.parametrize(
    "notebook",
    [
        pytest.param(path, marks=[pytest.mark.long] * path.stem.startswith("recording"))
        for path in NOTEBOOKS
    ],
    ids=lambda notebook: notebook.stem,
)
def test_a_notebook_runs_and_stands_there_run_with_its_pictures(
    notebook: Path, tmp_path: Path
) -> None:
    reason = "the extra notebook is not installed: pip install 'cranedyn[notebook]'"
    nbformat = pytest.importorskip("nbformat", reason=reason)
    nbclient = pytest.importorskip("nbclient", reason=reason)
    kept, now = (nbformat.read(notebook, as_version=4) for _ in range(2))
    where = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(now, timeout=120, resources=where).execute()
    for cell, fresh in zip(kept.cells, now.cells, strict=True):
        if cell.cell_type == "code":
            assert [_seen(output) for output in cell.outputs] == [*map(_seen, fresh.outputs)]
    outputs = [output for cell in kept.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in outputs)


def _seen(output: Any) -> tuple[set[str], Any]:
    """Return the forms in which an output can be shown, and its text."""
    return set(output.get("data", {})), output.get("text")
