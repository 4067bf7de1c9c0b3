"""The experiment margins: what the map says, and what simulation makes of it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from experiments import margins
from experiments.scenarios.strategies import LQR, PAPER, PD
from tests.experiments.conftest import Ran
from tests.helpers import FAST

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def done(ran: Callable[..., Ran]) -> Ran:
    """The least of it, once."""
    return ran("margins", "--points", "2", "--engine", FAST)


def test_every_claim_is_judged_and_holds(done: Ran) -> None:
    assert (len(done.result["claims"]), done.failed()) == (5, [])


def test_the_map_tells_what_is_near_its_end(done: Ran) -> None:
    rows = {row["strategy"]: row for row in done.table("Least margins over trolley radius")}
    damping, stronger, late = (
        {strategy: row[column] for strategy, row in rows.items()}
        for column in ("damping [%]", "upper gain margin", "delay margin [ms]")
    )
    # a PD that knows nothing of the swing leaves it undamped; an LQR made for elsewhere does worse
    assert damping[margins.UNSCHEDULED] < 0.0 < damping[PD] < 0.1 < 5.0 < damping[LQR]
    # a Kalman filter takes away what an LQR has of margins (Doyle 1978)
    assert stronger[margins.NO_SWING_SENSOR] < 1.1 < 10.0 < stronger[LQR]
    assert late[margins.NO_SWING_SENSOR] < late[LQR]
    assert late[PAPER] > 5.0
    assert (done.folder / "margins_map.png").is_file()


def test_a_map_of_one_place_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert margins.main(["--points", "1"]) == 2
    assert "points is 1" in capsys.readouterr().err
