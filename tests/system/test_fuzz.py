"""Whatever strangers bring, from a shell, in a file or in Python: it works, or it is refused in one
sentence, and nothing is lost.

`tests.system.fuzz` makes the input and judges what comes of it; here a bounded number is tried, the
same every time. More of it, with other numbers: ``python -m tests.system.fuzz --count 1000000
--seed 1``.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn import plugins
from tests.system.fuzz import api, files, lines
from tests.system.fuzz.__main__ import main
from tests.system.fuzz.core import Broken, Case, drawn, judged, listed, smallest
from tests.system.fuzz.generators import GENERATORS
from tests.system.fuzz.pool import Block, Workers

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="processes are watched by means of Linux"
)

TRIED: Counter[str] = Counter()
"""How many inputs were tried, by what they were and how they ended; printed at the end of the
session."""

COUNTS = {
    "file URDF, bytes": 250,
    "file URDF, elements": 250,
    "file URDF, recorded": 40,
    "file xacro, bytes": 40,
    "file CSV, bytes": 250,
    "file Parquet, bytes": 250,
    "file --from": 30,
    "file sweep": 60,
    "file result.json": 60,
    "file recording": 100,
    "file document": 100,
    "file IFC, bytes": 10,
    "file IFC, entities": 15,
    "file site, bytes": 15,
    "file site, values": 15,
    "loop receding": 2,
    "export mjcf": 5,
    "export ros2": 5,
    "export gazebo": 5,
    "export mcap": 5,
    "export fmu": 4,
    "signals": 6,
    "line world": 40,
    "line sweep": 12,
    "line report": 12,
    "line description": 12,
    "line compare": 15,
    "line linear_vs_full": 14,
    "line factors": 6,
    "line identify": 14,
    "line lift": 8,
    "line lift_benchmark": 6,
    "line lift_report": 6,
    "line margins": 8,
    "line observer": 10,
}
"""How many cases of each kind are tried here; of calls and lines `_OTHERS`."""

_OTHERS = {"line": 20, "api": 100, "loop": 30}


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    made = Workers(1)
    yield made
    made.close()


def _cases() -> list[Any]:
    return [
        pytest.param(name, COUNTS.get(name, _OTHERS.get(name.partition(" ")[0], 50)), id=name)
        for name in GENERATORS
    ]


@pytest.mark.parametrize(("name", "count"), _cases())
def test_generated_input_works_or_is_refused_in_a_sentence_and_loses_nothing(
    name: str, count: int, workers: Workers
) -> None:
    found = workers.run([Block(name, 0, count)])
    TRIED.update({f"{one}, {word}": times for (one, word), times in found.tried.items()})
    assert found.tried.total() == count
    broken = list(found.found.values())
    workers.shrink(broken, seconds=3.0)
    assert not broken, listed(broken, GENERATORS)


def test_enough_was_tried_of_each_and_both_ends_were_met() -> None:
    if TRIED.total() < 1000:
        pytest.skip("the tests above were not run in this process")
    for what in (
        "URDF, bytes",
        "URDF, elements",
        "URDF, recorded",
        "xacro, bytes",
        "CSV, bytes",
        "Parquet, bytes",
        "chart, bytes",
        "chart, values",
        "twin, values",
        "mesh, bytes",
        "mesh, shapes",
        "MCAP, messages",
        "bag, bytes",
    ):
        assert TRIED[f"file {what}, good"] > 0 and TRIED[f"file {what}, refused"] > 0, what
    assert TRIED["line world, code 0"] > 0 and TRIED["line world, code 2"] > 0
    for group in api.PUBLIC:
        assert TRIED[f"api {group}, good"] > 0, group
    for what in ("Fleet", "Stepper", "TowerCraneEnv", "TowerCraneVectorEnv"):
        assert TRIED[f"loop {what}, good"] > 0 and TRIED[f"loop {what}, some refused"] > 0, what
    for door in plugins.names("exporter"):
        assert TRIED[f"export {door}, good"] > 0, door


# --- the generators cover what there is -----------------------------------------------------------


def test_every_module_is_fuzzed_or_said_to_be_internal() -> None:
    assert api.unlisted() == []


@pytest.mark.parametrize("group", api.PUBLIC)
def test_every_public_function_is_called_rightly_before_it_is_called_wrongly(
    group: str, tmp_path: Path
) -> None:
    """A function that is refused its good arguments would only ever have its first check tried."""
    calls = next(one for one in api.GENERATORS if one.group == group)
    for i, name in enumerate(api.functions(group)):
        folder = tmp_path / str(i)
        folder.mkdir()
        before = Path.cwd()
        try:
            assert calls.attempt(Case((name, False), []), folder) == "good", name
        finally:
            os.chdir(before)


def test_every_command_has_lines_of_its_own_parser() -> None:
    for command in lines.commands():
        flags = {flag for action in lines.grammar(command) for flag in action.option_strings}
        assert flags, command
        said = {
            word.partition("=")[0]
            for number in range(300)
            for part in drawn(GENERATORS[_line(command)], number).parts
            for word in part
        }
        assert flags <= said, command


def _line(command: str) -> str:
    return f"line {command.rpartition('.')[2]}"


# --- the engine -----------------------------------------------------------------------------------


class _Trial:
    """A generator that does as it is told."""

    name, weight, interruptible = "trial", 1.0, True

    def __init__(self, do: Callable[[Case, Path], str]) -> None:
        self._do = do

    def draw(self, rng: Random) -> Case:
        """Some numbers."""
        return Case(None, [rng.randrange(10) for _ in range(6)])

    def attempt(self, case: Case, folder: Path) -> str:
        """As told."""
        return self._do(case, folder)

    def shown(self, case: Case) -> str:
        """The numbers."""
        return str(case.parts)


def _spin(seconds: float) -> str:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return "spun"


def _deaf(seconds: float) -> str:
    try:
        return _spin(seconds)
    except KeyboardInterrupt:
        return _spin(seconds)


def _loud(case: Case, folder: Path) -> str:
    os.write(2, b"raw words\n")
    return "good"


def _refused(case: Case, folder: Path) -> str:
    files.load(b"<robot/>", folder)
    return "good"


def _broken(case: Case, folder: Path) -> str:
    raise Broken("a promise", "and how")


@pytest.mark.parametrize(
    ("do", "place"),
    [
        (lambda case, folder: "good", ""),
        (_broken, "a promise"),
        (_refused, "ModelError at cranedyn/"),
        (lambda case, folder: str(1 // 0), "ZeroDivisionError in the fuzzer"),
        (_loud, "raw words beside ours: raw words"),
        (lambda case, folder: _spin(0.3), ""),
        (lambda case, folder: _deaf(0.3), "Ctrl-C is not answered in"),
    ],
)
def test_each_kind_of_broken_promise_is_seen(
    do: Callable[[Case, Path], str], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.system.fuzz.core.BUDGET", 0.1)
    monkeypatch.setattr("tests.system.fuzz.core.PATIENCE", 0.1)
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGPROF)
    verdict = judged(_Trial(do), Case(None, []))
    assert verdict.place.startswith(place) and bool(verdict.place) is bool(place)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGPROF)) == handlers


def test_a_case_that_kills_its_process_is_told_of_and_the_others_go_on(workers: Workers) -> None:
    crash = Case(("simulate", False), [("controller", "raises.__globals__['os'].abort()")])
    verdict = workers.judge("api simulate", crash)
    assert verdict.place.startswith("killed by SIGABRT"), verdict
    assert workers.judge("file document", Case(0, [])).word == "good"


def test_the_same_number_makes_the_same_input() -> None:
    for name, generator in GENERATORS.items():
        assert repr(drawn(generator, 7)) == repr(drawn(generator, 7)), name


@given(
    parts=st.lists(st.integers(0, 20), max_size=12),
    bad=st.sets(st.integers(0, 20), min_size=1, max_size=3),
)
def test_the_smallest_input_still_fails_and_has_nothing_left_to_leave_out(
    parts: list[int], bad: set[int]
) -> None:
    def fails(case: Case) -> bool:
        return bad <= set(case.parts)

    case = Case(None, [*parts, *bad])
    small = smallest(case, fails, tries=1000)
    assert sorted(small.parts) == sorted(bad)


def test_the_command_counts_what_it_tried_and_repeats_a_case(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--count", "20", "--jobs", "1", "--only", "file recording", "--seed", "100"]) == 0
    said = capsys.readouterr().out
    assert "file recording" in said and "in all                          20  0 places" in said
    assert main(["--again", "file recording/3", "--jobs", "1"]) == 0
    assert main(["--only", "nothing of that name"]) == 2
