"""Two cranes at one load, as the command does it: all claims hold, in a minute of fewer lifts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import tandem


@pytest.mark.slow
def test_the_claims_of_a_tandem_lift_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("coal", reason="extra planning (coal) is not installed")
    # Five times the step: its errors are 5e-4 of the frequencies.
    monkeypatch.setattr(tandem, "DT", 5e-3)
    assert tandem.main(["--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert [len(table["rows"]) for table in result["tables"]][:2] == [6, 4]
    assert all(claim["holds"] for claim in result["claims"])
