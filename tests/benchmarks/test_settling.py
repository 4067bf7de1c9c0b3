"""Random moves by predictive control beside their least time."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("casadi", reason="extra optimal (casadi) is not installed")

from benchmarks import settling
from benchmarks.settling import Settled, judged, moves, settle


def test_a_random_move_settles_within_one_and_a_half_times_the_least_time() -> None:
    (one,) = settle(moves(1, seed=1))
    # no move is over before the slew alone could be there under the same limits
    slew = abs(one.move.goal[0])
    assert one.least > slew / 0.0838 + 0.0838 / 0.02 if slew > 0.0838**2 / 0.02 else True
    assert one.least < 1.02 * one.taken and one.ratio < settling.RATIO


def test_fewer_moves_are_the_first_of_more() -> None:
    assert moves(3, seed=2) == moves(10, seed=2)[:3]


@pytest.mark.parametrize(("worst", "code"), [(14.9, 0), (15.1, 1), (math.inf, 1)])
def test_the_claim_is_judged_on_the_worst_move(
    worst: float, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = [Settled(moves(1, seed=1)[0], 10.0, taken) for taken in (11.0, worst, 12.0)]
    monkeypatch.setattr(settling, "settle", lambda drawn: found)
    assert settling.main([]) == code
    assert ("holds " if code == 0 else "FAILS ") in capsys.readouterr().out
    assert judged(found).claims[0].holds is (code == 0)


def test_no_moves_are_refused() -> None:
    with pytest.raises(SystemExit) as ended:
        settling.main(["--moves", "0"])
    assert ended.value.code == 2
