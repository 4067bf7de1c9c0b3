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


def test_there_are_a_dozen_and_the_list_names_each() -> None:
    assert len(SCRIPTS) >= 12
    named = re.findall(
        r"\]\((\w+\.(?:py|ipynb))\)", (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    )
    assert sorted(named) == sorted(
        path.name for ending in ("*.py", "*.ipynb") for path in (ROOT / "examples").glob(ending)
    )


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_an_example_runs_and_is_a_screenful(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = script.read_text(encoding="utf-8")
    assert text.startswith('"""') and len(text.splitlines()) <= 45
    if needs := re.search(r"Needs: (\w+)\.", text):
        if importlib.util.find_spec(needs[1]) is None:
            pytest.skip(f"{needs[1]} is not installed")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    before = sorted(path.name for path in script.parent.iterdir() if path.name != "__pycache__")
    if "python -m " in text.split('"""')[1]:  # one whose functions workers import
        command = [sys.executable, "-m", script.stem]
        path = os.pathsep.join([str(script.parent), str(ROOT)])
        done = subprocess.run(
            command,
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
    assert said and "nan" not in said.lower()
    assert (
        sorted(path.name for path in script.parent.iterdir() if path.name != "__pycache__")
        == before
    )
    for picture in tmp_path.glob("*.png"):
        assert picture.stat().st_size > 10_000


def test_the_wall_crane_is_held_and_swept_to_less_than_a_milliradian(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    import wall_crane  # type: ignore[import-not-found]

    wall_crane.main(tmp_path)
    last = [
        float(line.split(": ")[1].split(" mrad")[0])
        for line in capsys.readouterr().out.splitlines()[:2]
    ]
    assert max(last) < 1.0  # of 141 and 283 mrad at the start
    assert (tmp_path / "wall_crane.rrd").stat().st_size > 1e5


@pytest.mark.parametrize(
    "notebook", sorted((ROOT / "examples").glob("*.ipynb")), ids=lambda notebook: notebook.stem
)
def test_a_notebook_runs_and_stands_there_run_with_its_pictures(
    notebook: Path, tmp_path: Path
) -> None:
    nbformat = pytest.importorskip(
        "nbformat", reason="the extra notebook is not installed: pip install 'cranedyn[notebook]'"
    )
    nbclient = pytest.importorskip(
        "nbclient", reason="the extra notebook is not installed: pip install 'cranedyn[notebook]'"
    )
    kept = nbformat.read(notebook, as_version=4)
    now = nbformat.read(notebook, as_version=4)
    nbclient.NotebookClient(
        now, timeout=120, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    for cell, fresh in zip(kept.cells, now.cells, strict=True):
        if cell.cell_type == "code":
            assert _kinds(cell) == _kinds(fresh)
            assert [one.get("text") for one in cell.outputs] == [
                one.get("text") for one in fresh.outputs
            ]
    assert any(
        "image/png" in one.get("data", {}) for cell in kept.cells for one in cell.get("outputs", [])
    )


def _kinds(cell: Any) -> list[set[str]]:
    """What each output of a cell can be shown as."""
    return [set(one.get("data", {})) for one in cell.outputs]
