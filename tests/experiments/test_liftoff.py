"""A load that is lifted off and set down, as the command does it, in a few of its cases;
`test_whole.py` runs all of them.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import liftoff
from tests.helpers import FAST


@pytest.mark.slow
def test_the_claims_hold_in_one_case_of_each_kind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    fewer = {
        "CLASSES": liftoff.CLASSES[:1],
        "DRIVES": liftoff.DRIVES[:1],
        "OFFSETS": (0.5,),
        "FRICTIONS": (0.2,),
        "OFF_LEAD_SPEEDS": (0.2,),
        "THROWN_SPEEDS": (0.5,),
        "SINK_RATES": (0.1,),
    }
    for name, values in fewer.items():
        monkeypatch.setattr(liftoff, name, values)
    assert liftoff.main(["--engine", FAST, "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert [len(table["rows"]) for table in result["tables"]] == [1, 1, 1, 1]
    assert all(claim["holds"] for claim in result["claims"])
