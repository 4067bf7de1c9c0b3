"""Entries in a process of their own: what they may do, and what a faulty one is told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from cranedyn.benchmark.entry import Declined
from cranedyn.benchmark.entry_process import EntryFailed, EntryLimits, EntryProcess, check_opens
from cranedyn.benchmark.entry_source import find_entry
from cranedyn.benchmark.evaluate import run_instance
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError, UnknownName
from tests.benchmark.toys import toy, toy_instance

ENTRIES = '''
import os
import sys

import numpy as np

from cranedyn.benchmark import Declined


def many(briefing):
    """One function for many faults, by the first number of the reading."""
    if briefing.kind == "wind":
        raise Declined("It is for still air.")
    if briefing.kind == "path":
        raise ValueError("no path")
    if briefing.kind == "operator":
        return 7
    print("A print does not disturb the conversation.")

    def rates(reading):
        fault = int(reading.t)
        if fault == 1:
            raise KeyError("swing")
        if fault == 2:
            return np.zeros(2)
        if fault == 3:
            return [0.0, float("nan"), 0.0]
        if fault == 4:
            return np.zeros(10**12)
        if fault == 5:
            sys.exit(3)
        if fault == 6:
            while True:
                pass
        if fault == 7:
            raise Declined("Not any more.")
        return np.concatenate([reading.position[:1], reading.swing])

    return rates


def broken_at_once(briefing):
    return lambda reading: os._exit(9)
'''


class PatientLimits(EntryLimits):
    """Limits of processor time alone: how long that takes depends on what else the machine does."""

    @property
    def patience(self) -> float:
        """Return five minutes."""
        return 300.0


@pytest.fixture
def process(tmp_path: Path) -> Iterator[EntryProcess]:
    """An entry with many faults in a process of its own."""
    file = tmp_path / "entries.py"
    file.write_text(ENTRIES, encoding="utf-8")
    process = EntryProcess(find_entry(f"{file}:many"), PatientLimits(seconds=1.0))
    yield process
    process.close()


def reading(t: float) -> SensorReading:
    """A reading with a number in each place."""
    three = np.array([0.3, 0.4, 0.5])
    return SensorReading(
        t, three, 10.0 * three, np.array([0.1, 0.2]), np.array([1.0, 2.0]), 0.0 * three
    )


@pytest.mark.slow
def test_a_faulty_entry_fails_in_a_sentence_and_its_process_goes_on_or_is_started_again(
    process: EntryProcess,
) -> None:
    with pytest.raises(Declined, match=r"^It is for still air\.$"):
        process.begin(toy("wind"))
    with pytest.raises(EntryFailed, match=r"ValueError in many.*no path"):
        process.begin(toy("path"))
    with pytest.raises(EntryFailed, match="is int; allowed is a function of a reading"):
        process.begin(toy("operator"))
    process.begin(toy("move"))
    command, seconds = process.command(reading(0.0))
    assert command.tolist() == [0.3, 0.1, 0.2]
    assert 0.0 <= seconds < 1.0
    faults = {
        1.0: r"KeyError in rates, line \d+ of entries.py: 'swing'",
        2.0: r"shape \(2,\); needed is \(3,\)",
        3.0: "nan",
        4.0: "memory",
        7.0: "declined in the middle",
    }
    for t, sentence in faults.items():
        with pytest.raises(EntryFailed, match=sentence):
            process.command(reading(t))
    # It still answers after all of these.
    assert process.command(reading(0.0))[0].tolist() == [0.3, 0.1, 0.2]
    with pytest.raises(EntryFailed, match="exit code 3"):
        process.command(reading(5.0))
    process.begin(toy("move"))
    with pytest.raises(EntryFailed, match="more than 1 s of processor time"):
        process.command(reading(6.0))


@pytest.mark.slow
def test_an_instance_of_an_entry_that_ends_its_process_fails(tmp_path: Path) -> None:
    file = tmp_path / "entries.py"
    file.write_text(ENTRIES, encoding="utf-8")
    process = EntryProcess(find_entry(f"{file}:broken_at_once"), EntryLimits())
    try:
        result = run_instance(toy_instance("move"), process)
    finally:
        process.close()
    with pytest.raises(EntryFailed, match=r"no function in .* 'absent'"):
        check_opens(find_entry(f"{file}:absent"), EntryLimits())
    assert (result.status, result.reason) == ("failed", "Its process ended with the exit code 9.")
    assert result.metrics == {}


def test_an_entry_that_is_none_is_refused_before_anything_runs(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        find_entry(str(tmp_path / "none.py:f"))
    with pytest.raises(DataError, match=r"write mine\.py:FUNCTION"):
        find_entry("mine.py")
    with pytest.raises(UnknownName, match="the nearest is mpc_goal"):
        find_entry("mpc_gaol")
    with pytest.raises(CraneError, match="names no entry"):
        find_entry("mine.txt")
