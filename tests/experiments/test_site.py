"""Cranes that share a site."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import site

pytestmark = pytest.mark.long


def test_supervised_cranes_do_not_touch_and_keep_distance_swing_and_boxes(tmp_path: Path) -> None:
    arguments = "--site two_towers --hours 0.02 --minutes 6 --cycles 50 --out"
    assert site.main([*arguments.split(), str(tmp_path)]) in (0, 1)
    claims = json.loads((tmp_path / "result.json").read_text("utf-8"))["claims"]
    # A shift without lifts and contacts says nothing of what supervision is worth.
    assert [claim["holds"] for claim in claims[:4]] == [True, True, None, None]
