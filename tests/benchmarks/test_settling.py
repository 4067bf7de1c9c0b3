"""Random moves by predictive control beside their least time."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("casadi", reason="extra optimal (casadi) is not installed")

from benchmarks import settling
from benchmarks.settling import SettlingTimes, SettlingTrial, alike, judge_moves, settle, trials
from experiments.scenarios.moves import RestToRest

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_random_move_settles_within_one_and_a_half_times_the_least_time_at_any_size() -> None:
    (usual,) = trials(1, seed=1)
    size = 0.25
    start, goal = (
        (turn, size * x, size * cable) for turn, x, cable in (usual.move.start, usual.move.goal)
    )
    move = RestToRest("smaller", start, goal, 0.0)
    one, other = settle([usual, SettlingTrial(size, alike(size, np.ones(3)), move)])
    # no move is over before the slew alone could be there under the same limits
    slew = abs(one.move.goal[0])
    assert one.least > slew / 0.0838 + 0.0838 / 0.02 if slew > 0.0838**2 / 0.02 else True
    assert one.least < 1.02 * one.taken
    assert one.ratio < settling.MAX_RATIO
    # Times go with the root of the size under limits that go with it. Moves are planned in whole
    # control periods, which are the same for both, and so are times between optimisations.
    assert other.least == pytest.approx(0.5 * one.least, abs=5e-3)
    assert other.taken == pytest.approx(0.5 * one.taken, rel=0.02)


def test_fewer_moves_are_the_first_of_more() -> None:
    assert [one.move for one in trials(3, 2)] == [one.move for one in trials(10, 2)][:3]


def test_each_crane_is_another_only_where_that_is_asked_for() -> None:
    assert {one.size for one in trials(3, 1)} == {1.0}
    assert len({one.size for one in trials(3, 1, any_crane=True)}) == 3


@pytest.mark.parametrize(("worst", "code"), [(14.9, 0), (15.1, 1), (math.inf, 1)])
def test_the_claim_is_judged_on_the_worst_move(
    worst: float, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [SettlingTimes(trials(1, seed=1)[0].move, 10.0, taken) for taken in (11.0, worst, 12.0)]
    monkeypatch.setattr(settling, "settle", lambda drawn: found)
    assert settling.main([]) == code
    assert ("holds " if code == 0 else "FAILS ") in capsys.readouterr().out
    assert judge_moves(found, 1.5).claims[0].holds is (code == 0)


def test_no_moves_are_refused() -> None:
    with pytest.raises(SystemExit) as ended:
        settling.main(["--moves", "0"])
    assert ended.value.code == 2
