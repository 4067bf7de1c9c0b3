"""A crane on a ship, as the command does it, in a few of its cases; `test_whole.py` runs all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import ship
from tests.helpers import FAST


@pytest.mark.slow
def test_the_claims_hold_on_one_roll(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ship, "CONTROL_PERIODS", (15.0,))
    monkeypatch.setattr(ship, "CONTROL_FROM", 7.5)
    monkeypatch.setattr(ship, "CONTROL_DURATION", 15.0)
    monkeypatch.setattr(ship, "SEEDS", ())
    assert ship.main(["--engine", FAST, "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert [len(table["rows"]) for table in result["tables"]] == [5, 1, 3, 3]
    assert all(claim["holds"] for claim in result["claims"])
