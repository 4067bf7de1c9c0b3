"""The experiment observer: loads and cables that nobody told."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from experiments import harness, observer
from tests.helpers import FAST


@pytest.mark.slow
def test_a_corner_of_the_grid_is_made_judged_and_holds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(observer, "LOADS", (0.5,))
    monkeypatch.setattr(observer, "CABLES", (0.1,))
    folder = tmp_path / "out"
    assert observer.main(["--sensors", "drives", "--engine", FAST, "--out", str(folder)]) == 0
    result = json.loads((folder / "result.json").read_text())
    ((_, share), (_, offset)) = result["tables"][0]["rows"]
    assert 0.0 < share < 0.5 and 0.0 < offset < 0.5  # mrad
    assert [claim["holds"] for claim in result["claims"]] == [True]


def test_a_run_that_breaks_off_is_no_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {
        observer.GridCase("drives", "share", 0.5, 0.1): 1e-5,
        observer.GridCase("drives", "offset", 0.5, 0.1): math.inf,
    }
    monkeypatch.setattr(observer, "residual_swings", lambda setup, sensors: found)
    options = type("Options", (), {"sensors": ["drives"]})()
    outcome = observer.experiment(options, harness.Setup())
    assert [claim.holds for claim in outcome.claims] == [False]
