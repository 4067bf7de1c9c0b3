"""Two cranes at one load, as the command does it: all claims hold, in a minute of fewer lifts."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import pytest
from rich.progress import Progress

from cranedyn.lifts.planning.file_templates import template_text
from experiments import tandem
from experiments.harness import ProgressReporter, run


@pytest.mark.slow
def test_the_claims_of_a_tandem_lift_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("coal", reason="extra planning (coal) is not installed")
    # Five times the step: its errors are 5e-4 of the frequencies.
    monkeypatch.setattr(tandem, "DT", 5e-3)
    bars = Progress(disable=True)
    monkeypatch.setattr(run, "reporting", lambda: nullcontext(ProgressReporter(bars)))
    assert tandem.main(["--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert [len(table["rows"]) for table in result["tables"]][:2] == [7, 5]
    assert all(claim["holds"] for claim in result["claims"])
    # Seven lifts, and those that are compared with closed forms.
    assert [(task.completed, task.total) for task in bars.tasks] == [(8, 8)]


@pytest.mark.slow
def test_a_lift_of_a_file_is_planned_around_its_obstacle_and_judged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("coal", reason="extra planning (coal) is not installed")
    monkeypatch.setattr(tandem, "DT", 4e-3)
    site = tmp_path / "lift.toml"
    site.write_text(template_text("tandem"), encoding="utf-8")
    assert tandem.main(["--site", str(site), "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert any("the load and container" in claim["sentence"] for claim in result["claims"])
    unjudged = [claim for claim in result["claims"] if claim["holds"] is None]
    assert len(unjudged) == 2
    assert (tmp_path / "out" / "tandem.rrd").exists()
    assert tandem.main(["--site", str(tmp_path / "none.toml"), "--out", str(tmp_path / "o")]) == 2
