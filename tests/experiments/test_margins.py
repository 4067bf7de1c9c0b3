"""The experiment margins: what the map says, and what simulation makes of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import margins
from experiments.scenarios.strategies import LQR, PAPER, PD
from tests.helpers import FAST

pytest.importorskip("control", reason="extra control (python-control) is not installed")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The least of it, once."""
    folder = tmp_path_factory.mktemp("margins") / "out"
    assert margins.main(["--points", "2", "--engine", FAST, "--out", str(folder)]) == 0
    return folder


def test_every_claim_is_judged_and_holds(done: Path) -> None:
    claims = json.loads((done / "result.json").read_text())["claims"]
    assert len(claims) == 5
    assert all(claim["holds"] is True for claim in claims)


def test_the_map_tells_what_is_near_its_end(done: Path) -> None:
    table = json.loads((done / "result.json").read_text())["tables"][0]
    late = {row[0]: row[10] for row in table["rows"]}
    damping = {row[0]: row[1] for row in table["rows"]}
    stronger = {row[0]: row[4] for row in table["rows"]}
    # a PD that knows nothing of the swing leaves it undamped; an LQR made for elsewhere does worse
    assert damping[margins.KEPT] < 0.0 < damping[PD] < 0.1 < 5.0 < damping[LQR]
    # a Kalman filter takes away what an LQR has of margins (Doyle 1978)
    assert stronger[margins.BLIND] < 1.1 < 10.0 < stronger[LQR]
    assert late[margins.BLIND] < late[LQR] and late[PAPER] > 5.0
    assert (done / "margins_map.png").is_file()


def test_a_map_of_one_place_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert margins.main(["--points", "1"]) == 2
    assert "points is 1" in capsys.readouterr().err
