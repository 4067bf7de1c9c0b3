"""Input that nobody thought of, from a shell, in a file or in Python: it works, or it is refused in
one sentence, and nothing is lost.

A bounded number is tried here, the same every time. More: ``python -m tests.system.fuzz --help``.
"""

from __future__ import annotations

import gc
import hashlib
import importlib
import multiprocessing
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from tests.system.fuzz import api, lines
from tests.system.fuzz.__main__ import GENERATORS, main
from tests.system.fuzz.core import Broken, Generator, drawn, judged

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals and pipes as in Linux")

COUNTS = {
    **{"file signals": 30, "file building model": 10, "file site": 100},
    **{"line trial": 60, "api lifting": 20},
    # A process reads each of these files, and starting it takes most of the time.
    **dict.fromkeys(("file MATLAB", "file HDF5", "file MJCF"), 60),
    **dict.fromkeys(("file database", "file workbook"), 60),
}
"""Cases of each kind; of all others those of `_OTHERS`."""

_OTHERS = {"line": 10, "api": 400, "file": 200}


@pytest.fixture(scope="module")
def other_process() -> Iterator[ProcessPoolExecutor]:
    """A process for what is interrupted anywhere: a library that does not expect it may be left
    with objects that end the process when their garbage is collected.
    """
    with ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as pool:
        yield pool


def _judge_all(name: str) -> tuple[list[str], set[str]]:
    """Judge the cases of a generator, and return the faults of those that break a promise, and the
    first word of each verdict.
    """
    generator = GENERATORS[name]
    count = COUNTS.get(name, _OTHERS[name.partition(" ")[0]])
    cases = [drawn(generator, number) for number in range(count)]
    verdicts = [judged(generator, case) for case in cases]
    faults = [f"{case}: {v.fault}" for case, v in zip(cases, verdicts, strict=True) if v.fault]
    return faults, {verdict.word for verdict in verdicts}


@pytest.mark.long
@pytest.mark.parametrize("name", GENERATORS)
def test_generated_input_works_or_is_refused_in_a_sentence_and_loses_nothing(
    name: str, other_process: ProcessPoolExecutor
) -> None:
    faults, words = other_process.submit(_judge_all, name).result()
    assert not faults, "\n".join(faults[:5])
    if not name.startswith("line") and name != "file recording":
        assert {"good", "refused"} <= words


@pytest.mark.slow
@pytest.mark.parametrize("group", api.CALLS)
def test_every_public_function_is_called_rightly_before_it_is_called_wrongly(
    group: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    api.furnish(tmp_path)
    for call in api.calls(group):
        eval(call, dict(api.namespace()))


def test_every_function_of_a_public_package_is_called() -> None:
    called = {word for group in api.CALLS for word in re.findall(r"\w+", api.CALLS[group])}
    packages = [importlib.import_module(name) for name in api.MODULES]
    public = {name for package in packages for name in getattr(package, "__all__", ())}
    assert {name for name in public if name.islower()} - called == api.NOT_CALLED


@pytest.mark.slow
def test_every_command_has_lines_of_its_own_parser() -> None:
    for command in lines.commands():
        flags = {flag for action in lines.grammar(command) for flag in action.option_strings}
        generator = GENERATORS[f"line {command.rpartition('.')[2]}"]
        assert flags <= {word for number in range(300) for word in drawn(generator, number)[2]}


# --- the engine -----------------------------------------------------------------------------------


LONG = 20.0
"""Processor time that no case takes, since it is interrupted [s]: far above the budget, because a
loaded machine may deliver the signal late.
"""


def _spin(seconds: float) -> str:
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
    return "spun"


def _ignore_interrupt() -> str:
    try:
        return _spin(LONG)
    except KeyboardInterrupt:
        return _spin(LONG)


def _spin_in_collector() -> str:
    gc.callbacks.append(lambda phase, info: _spin(0.3) and None)
    try:
        gc.collect()
    finally:
        gc.callbacks.pop()
    return _spin(LONG)


def _spin_beside_threads() -> str:
    # The system mostly hands the timer's signal to one of these, which are busy without Python's
    # lock. The main thread would hear of it as late as one of them ends.
    for _ in range(4):
        threading.Thread(target=hashlib.pbkdf2_hmac, args=("sha256", b"", b"", 3_000_000)).start()
    return _spin(2.0)


def _raise_broken() -> str:
    raise Broken("a promise", "and how")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("action", "fault"),
    [
        (lambda: "good", ""),
        (_raise_broken, "Broken: a promise: and how"),
        (lambda: str(1 // 0), "ZeroDivisionError"),
        (lambda: str(os.write(2, b"raw words\n")), "raw words beside ours: raw words"),
        (lambda: _spin(LONG), "takes more than 0.1 s"),
        (_spin_in_collector, "takes more than 0.1 s"),
        (_spin_beside_threads, "takes more than 0.1 s"),
        (_ignore_interrupt, "Ctrl-C is not answered in 0.1 s"),
    ],
)
def test_each_kind_of_broken_promise_is_seen(
    action: Callable[[], str], fault: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tests.system.fuzz.core.BUDGET", 0.1)
    monkeypatch.setattr("tests.system.fuzz.core.PATIENCE", 0.1)
    generator = Generator("trial", lambda rng: None, lambda case, folder: action())
    # Finalizers of what other tests left would run within the case. Python drops an interruption
    # that comes in one of them.
    gc.collect()
    # To collect among all that a worker has loaded by then takes longer than the budget of a case.
    gc.freeze()
    try:
        verdict = judged(generator, None)
    finally:
        gc.unfreeze()
    assert fault in verdict.fault
    assert bool(verdict.fault) is bool(fault)


@pytest.mark.slow
def test_the_command_counts_what_it_tried_and_repeats_a_case(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["--count", "20", "--only", "file recording", "--seed", "100"]) == 0
    assert "file recording" in capsys.readouterr().out
    assert main(["--again", "file recording/3"]) == 0
