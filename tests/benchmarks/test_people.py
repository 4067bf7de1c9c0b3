"""What people wait for is measured with all its processes, beside what was committed."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from benchmarks import people
from benchmarks.people import Wait
from cranedyn.errors import CraneError

BUSY = "import time; end = time.process_time() + 0.15\nwhile time.process_time() < end: pass"
"""Program that takes 0.15 s of the processor."""


@pytest.mark.slow
def test_the_time_of_a_command_is_that_of_all_its_processes_and_of_no_preparation(
    tmp_path: Path,
) -> None:
    """It is processor time, so that it does not depend on what else the machine does."""
    busy = tmp_path / "busy.py"
    busy.write_text(BUSY)
    parent = tmp_path / "parent.py"
    parent.write_text(
        "import subprocess, sys\n"
        f"for _ in range(2): subprocess.run([sys.executable, {str(busy)!r}])\n"
        "sys.exit(3)"
    )
    seconds, code = people.measure_wait(Wait(f"python {parent}", 1.0, f"python {busy}"))
    assert code == 3
    alone, _ = people.measure_wait(Wait(f"python {busy}", 1.0))
    # Two busy loops in the parent's children; the preparation would be a third.
    assert 2 * 0.15 < seconds
    assert 0.15 < alone < seconds


def test_a_preparation_that_fails_is_said_and_nothing_is_measured(tmp_path: Path) -> None:
    with pytest.raises(CraneError, match=r"python -c exit\(4\) ended with exit code 4"):
        people.measure_wait(Wait("python -c pass", 1.0, "python -c exit(4)"))


def test_what_was_not_measured_stays_as_it_was_committed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    table = tmp_path / "people_commands.csv"
    table.write_text(
        "command,goal [s],before [s],now [s],exit code\n"
        "python -c pass,0.1,9.5,7.5,0\n"
        "python -c exit(1),1.0,-,0.5,1\n"
    )
    monkeypatch.setattr(people.committed_rows, "__defaults__", (table,))
    waits = {
        "known": Wait("python -c pass", 0.1),
        "measured": Wait("python -c exit(1)", 1.0),
        "never": Wait("python -c exit(2)", 1.0),
    }
    monkeypatch.setattr(people, "WAITS", waits)
    monkeypatch.setattr(people, "measure_wait", lambda wait: (0.25, 1))
    (result,) = people.measure(argparse.Namespace(only=["measured"], document="speed.md"))
    assert result.rows == [
        ("python -c pass", 0.1, "9.5", "7.5", "0"),
        ("python -c exit(1)", 1.0, "0.5", "0.2", "1"),
        ("python -c exit(2)", 1.0, "-", "-", "-"),
    ]
    (printed,) = people.measure(argparse.Namespace(only=["measured"], document=None))
    assert printed.rows == result.rows[1:2]


def test_a_table_shows_no_path_of_this_machine() -> None:
    for wait in people.WAITS.values():
        assert str(people.ROOT) not in people.shown_line(wait.line)
