"""Who becomes slower is found out."""

from __future__ import annotations

import random
import re
from pathlib import Path

import pytest

from benchmarks import bars
from benchmarks.bars import SHARE, Bar, Workload, judge_bars, main

ROOT = Path(__file__).parents[2]


class Machine:
    """A processor whose time passes as it is told: work takes its time, and what others do in
    between up to three times as much again.
    """

    def __init__(self) -> None:
        self.now = 0.0
        self.disturbed = random.Random(1)

    def work(self, seconds: float, amount: float = 1.0, every: int = 1) -> Workload:
        """Work that takes so long at least."""

        def run() -> None:
            self.now += seconds * (1.0 + 3.0 * self.disturbed.random())

        return Workload(run, amount, every, lambda: self.now)


def usual(slower: float = 1.0, every: int = 1) -> list[Bar]:
    """One bar of work that is ten times as quick as its yardstick, or by so much less."""
    machine = Machine()
    quick = machine.work(0.02 * slower, 100.0, every)
    slow = machine.work(0.02, 10.0)
    return [Bar("steady", machine.work(0.02, 100.0), slow, 10.0), Bar("new", quick, slow, 10.0)]


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time to give up is counted in rounds, not by a clock."""
    rounds = iter(range(10**6))
    monkeypatch.setattr(bars, "process_time", lambda: float(next(rounds)))


@pytest.mark.parametrize(("slower", "code"), [(0.5, 0), (1.0, 0), (1.1, 0), (1.0 / 0.82, 1)])
def test_who_loses_more_than_15_percent_fails_by_name_whatever_else_the_machine_does(
    slower: float, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert judge_bars(usual(slower), 300.0) == code
    assert ("Slower than allowed: new." in capsys.readouterr().out) == bool(code)


def test_what_is_done_in_some_rounds_only_is_judged_as_well() -> None:
    assert judge_bars(usual(every=10), 300.0) == 0
    assert judge_bars(usual(1.3, every=10), 300.0) == 1


def test_a_bar_that_is_missed_gives_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bars, "all_bars", lambda: usual(1.3))
    assert main(["--seconds", "300"]) == 1
    assert main(["--seconds", "300", "--share", "0.5"]) == 0


@pytest.mark.slow
def test_the_bars_of_this_project_are_measured_and_ci_asks_for_them() -> None:
    found = bars.all_bars()
    assert len({bar.name for bar in found}) == len(found)
    assert re.search(
        r"^\.venv/bin/python -m benchmarks\.bars$",
        (ROOT / ".ci/run").read_text(encoding="utf-8"),
        re.M,
    )
    # impossible ones, in two rounds
    assert judge_bars(found[:2], 0.0, share=1e6) == 1


def test_the_page_tells_how_many_bars_there_are_and_what_they_allow() -> None:
    page = (ROOT / "docs/results/speed.md").read_text(encoding="utf-8")
    assert len(bars.all_bars()) == 7
    assert f"if one of seven workloads has lost more than {100 * (1 - SHARE):.0f} % " in page
