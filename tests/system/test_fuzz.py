"""Input that nobody thought of, from a shell, in a file or in Python: it works, or it is refused in
one sentence, and nothing is lost.

`tests.system.fuzz` makes the input and judges what comes of it; here a bounded number is tried, the
same every time. More of it: ``python -m tests.system.fuzz --count 1000000 --seed 1``.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest

from cranedyn import plugins
from tests.system.fuzz import api, files, lines
from tests.system.fuzz.__main__ import main
from tests.system.fuzz.core import Broken, Case, drawn, judged
from tests.system.fuzz.generators import GENERATORS
from tests.system.fuzz.pool import tried

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and pipes as in Linux")

TRIED: Counter[str] = Counter()
"""Number of inputs, by what they were and how they ended; printed at the end of the session."""

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
    "api planning": 20,
    "export fmu": 4,
    "line world": 40,
    "line compare": 15,
    "line linear_vs_full": 14,
    "line identify": 14,
}
"""Cases of each kind; of all others those of `_OTHERS`."""

_OTHERS = {"line": 10, "api": 60, "loop": 30, "export": 5, "file": 50}


@pytest.mark.parametrize("name", GENERATORS)
def test_generated_input_works_or_is_refused_in_a_sentence_and_loses_nothing(name: str) -> None:
    count = COUNTS.get(name, _OTHERS[name.partition(" ")[0]])
    cases = list(tried(name, range(count)))
    TRIED.update(f"{name}, {case.verdict.word}" for case in cases)
    assert len(cases) == count
    broken = [case for case in cases if case.verdict.place]
    assert not broken, "\n" + "\n".join(map(str, broken[:5]))


def test_enough_was_tried_of_each_and_both_ends_were_met() -> None:
    if TRIED.total() < 1000:
        pytest.skip("the tests above were not run in this process")
    both = (
        *("URDF, bytes", "URDF, elements", "URDF, recorded", "xacro, bytes", "CSV, bytes"),
        *("Parquet, bytes", "chart, bytes", "chart, values", "twin, values", "mesh, bytes"),
        *("mesh, shapes", "MCAP, messages", "bag, bytes"),
    )
    for name in both:
        assert TRIED[f"file {name}, good"] > 0 and TRIED[f"file {name}, refused"] > 0, name
    assert TRIED["line world, code 0"] > 0 and TRIED["line world, code 2"] > 0
    for group in api.PUBLIC:
        assert TRIED[f"api {group}, good"] > 0, group
    for loop in ("Fleet", "Stepper", "TowerCraneEnv", "TowerCraneVectorEnv"):
        assert TRIED[f"loop {loop}, good"] > 0 and TRIED[f"loop {loop}, some refused"] > 0, loop
    for exporter in plugins.names("exporter"):
        assert TRIED[f"export {exporter}, good"] > 0, exporter


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
        generator = GENERATORS[f"line {command.rpartition('.')[2]}"]
        used = {
            word.partition("=")[0]
            for number in range(300)
            for part in drawn(generator, number).parts
            for word in part
        }
        assert flags <= used, command


# --- the engine -----------------------------------------------------------------------------------


class _Trial:
    name, weight, interruptible = "trial", 1.0, True

    def __init__(self, attempt: Callable[[Case, Path], str]) -> None:
        self.attempt = attempt

    def draw(self, rng: Random) -> Case:
        """Draw nothing."""
        return Case(None, [])

    def shown(self, case: Case) -> str:
        """Show nothing."""
        return ""


def _spin(seconds: float) -> str:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return "spun"


def _ignore_interrupt(seconds: float) -> str:
    try:
        return _spin(seconds)
    except KeyboardInterrupt:
        return _spin(seconds)


def _write_raw(case: Case, folder: Path) -> Any:
    os.write(2, b"raw words\n")
    return "good"


def _raise_broken(case: Case, folder: Path) -> str:
    raise Broken("a promise", "and how")


@pytest.mark.parametrize(
    ("attempt", "place"),
    [
        (lambda case, folder: "good", ""),
        (_raise_broken, "a promise"),
        (lambda case, folder: files.load(b"<robot/>", folder), "ModelError at cranedyn/"),
        (lambda case, folder: str(1 // 0), "ZeroDivisionError in the fuzzer"),
        (_write_raw, "raw words beside ours: raw words"),
        (lambda case, folder: _spin(0.3), ""),
        (lambda case, folder: _ignore_interrupt(0.3), "Ctrl-C is not answered in"),
    ],
)
def test_each_kind_of_broken_promise_is_seen(
    attempt: Callable[[Case, Path], str], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.system.fuzz.core.BUDGET", 0.1)
    monkeypatch.setattr("tests.system.fuzz.core.PATIENCE", 0.1)
    handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGPROF)
    verdict = judged(_Trial(attempt), Case(None, []))
    assert verdict.place.startswith(place) and bool(verdict.place) is bool(place)
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGPROF)) == handlers


def test_the_command_counts_what_it_tried_and_repeats_a_case(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--count", "20", "--only", "file recording", "--seed", "100"]) == 0
    assert "file recording" in capsys.readouterr().out
    assert main(["--again", "file recording/3"]) == 0
