"""Sweeps that are killed or interrupted: nothing that was done is lost, and nothing done twice."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cranedyn.sweep import Progress, grid, results, sweep
from tests import studies
from tests.helpers import ROOT, files, within

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]
proc = pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="processes are looked up in /proc"
)
CASES, CHUNK = 24, 2

_STUCK_SWEEP = """
import sys
from cranedyn.sweep import grid, sweep
from tests import studies

if __name__ == "__main__":
    sweep(studies.stuck, grid(x=[3.0, 3.0]), sys.argv[1], chunk=1, workers=2)
"""

_STUCK_COMPARE = """
from experiments.harness.processes import processes
from tests.studies import deaf

if __name__ == "__main__":
    with processes(1) as workers:
        workers.submit(deaf, 100).result()
"""

_SWEEP = """
import sys
from cranedyn.command import command
from cranedyn.sweep import cluster, grid, sweep
from tests import studies

def main():
    cluster.CONNECT_TIMEOUT = 60.0
    where = {"scheduler": sys.argv[4]} if sys.argv[4:] else {"workers": 2}
    design = grid(x=range(int(sys.argv[2])))
    sweep(studies.logged, design, sys.argv[1], chunk=int(sys.argv[3]), **where)
    return 0

if __name__ == "__main__":
    sys.exit(command(main))
"""


def until(holds: Callable[[], object], seconds: float = 120.0) -> None:
    """Return as soon as it holds."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come to hold"
        time.sleep(0.01)


@contextmanager
def sweeping(
    folder: Path, log: Path, pause: float = 0.1, *scheduler: str
) -> Iterator[subprocess.Popen[str]]:
    """A slow sweep in a process of its own, in a group of its own as a terminal would have it;
    ended in any case. From case 8 on it waits for a file "gate" beside its log.
    """
    script = log.with_name("slow.py")
    script.write_text(_SWEEP)
    process = subprocess.Popen(
        [sys.executable, str(script), str(folder), str(CASES), str(CHUNK), *scheduler],
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env=os.environ
        | {"PYTHONPATH": str(ROOT), "SWEEP_LOG": str(log), "SWEEP_PAUSE": str(pause)}
        | {"SWEEP_GATE": str(log.with_name("gate"))},
        start_new_session=True,
    )
    try:
        yield process
    finally:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        process.communicate(timeout=60)


def answered(process: subprocess.Popen[str]) -> str:
    """What a sweep that has just been interrupted says, within 2 s."""
    assert process.stderr is not None
    assert within(2.0, lambda: select.select([process.stderr], [], [], 0.0)[0]), "no answer"
    return process.communicate(timeout=60)[1]


def parts(folder: Path) -> dict[str, int]:
    """The finished parts and when they were written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("part-*.parquet")}


def ran(log: Path) -> tuple[Counter[int], set[int]]:
    """How often each case was run, and by which processes."""
    lines = [line.split() for line in log.read_text().splitlines()] if log.exists() else []
    return Counter(int(x) for _, x in lines), {int(pid) for pid, _ in lines}


def gone(pids: set[int]) -> bool:
    """Whether none of these processes runs any more."""
    return not any(
        Path(f"/proc/{pid}").exists()
        and "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
        for pid in pids
    )


def finish(folder: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweep on, here; every case is there once, and none of a part that was there has been run
    again.
    """
    there = parts(folder)
    kept = {CHUNK * int(name[5:11]) + i for name in there for i in range(CHUNK)}
    monkeypatch.setenv("SWEEP_LOG", str(log))
    monkeypatch.setenv("SWEEP_PAUSE", "0")
    end = sweep(studies.logged, grid(x=range(CASES)), folder, chunk=CHUNK, workers=2)
    assert end == Progress(CASES, CASES, 0, len(kept))
    table = results(folder)
    assert table["case"].to_pylist() == list(range(CASES))
    assert table["y"].to_pylist() == [float(x * x) for x in range(CASES)]
    runs = ran(log)[0]
    assert {x: runs[x] for x in kept} == dict.fromkeys(kept, 1)
    assert all(1 <= runs[x] <= 2 for x in range(CASES))  # twice only those that were under way
    # Two chunks that were under way at most, and two whose parts were being written.
    assert sum(runs.values()) <= CASES + 4 * CHUNK
    assert parts(folder).items() >= there.items()  # not even written again
    assert all(name.startswith(("_sweep.json", "part-")) for name in files(folder))


@proc
def test_a_sweep_killed_in_the_middle_goes_on_and_leaves_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, log = tmp_path / "sweep", tmp_path / "log"
    with sweeping(folder, log) as process:
        until(lambda: len(parts(folder)) >= 3)
        os.kill(process.pid, signal.SIGKILL)
        process.wait(60)
        until(lambda: gone(ran(log)[1]))
    assert 3 <= len(parts(folder)) < CASES // CHUNK
    (folder / f".part-000009.{process.pid}.parquet").write_text("half")
    (folder / f"._sweep.{process.pid}.json").write_text("half")
    finish(folder, log, monkeypatch)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)]
)
def test_an_interrupted_sweep_says_how_to_go_on(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, log = tmp_path / "sweep", tmp_path / "log"
    with sweeping(folder, log) as process:
        until(lambda: len(parts(folder)) >= 2)
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does: all processes hear of it
        else:
            process.send_signal(number)
        err = answered(process)
    done = CHUNK * len(parts(folder))
    assert (
        err
        == f"Interrupted: {done} of {CASES} cases are done, and kept in {folder}; the same sweep "
        "goes on from there.\n"
    )
    assert process.returncode == 130
    assert gone(ran(log)[1])
    finish(folder, log, monkeypatch)


def test_an_interruption_while_workers_start_is_as_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, log = tmp_path / "sweep", tmp_path / "log"
    with sweeping(folder, log, pause=60.0) as process:
        until(folder.exists)
        time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and not folder.exists()
    assert err.startswith("Interrupted: 0 of 24 cases are done") and err.count("\n") == 1
    finish(folder, log, monkeypatch)


def test_two_processes_never_sweep_the_same_folder(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    with sweeping(folder, tmp_path / "log") as one:
        until(lambda: (tmp_path / "log").exists())
        (tmp_path / "b").mkdir()
        with sweeping(folder, tmp_path / "b" / "log") as other:
            _, err = other.communicate(timeout=120)
        assert other.returncode == 2 and one.poll() is None
        assert err.startswith(f"error: Cannot write to {folder}: another run is writing there;")


def test_a_worker_that_is_killed_costs_its_chunk_a_second_try_and_no_other(tmp_path: Path) -> None:
    folder, log = tmp_path / "sweep", tmp_path / "log"
    with sweeping(folder, log) as process:
        until(lambda: len(parts(folder)) >= 2)
        _, pids = ran(log)
        os.kill(min(pids), signal.SIGKILL)
        (tmp_path / "gate").touch()
        assert process.wait(120) == 0
    runs, after = ran(log)
    assert len(after) == 3  # it had a successor
    assert sorted(runs) == list(range(CASES)) and sum(runs.values()) <= CASES + CHUNK
    assert results(folder)["error"].null_count == CASES


def test_a_script_that_sweeps_while_it_is_imported_is_told_how_not_to(tmp_path: Path) -> None:
    script = """if True:
        from cranedyn.sweep import grid, sweep
        from tests import studies
        sweep(studies.squares, grid(x=range(4)), "sweep", workers=1)
    """
    (tmp_path / "careless.py").write_text(script)
    run = subprocess.run(
        [sys.executable, "careless.py"],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert run.stderr.splitlines()[-1].endswith(
        "before it began; a script that sweeps must do so under if __name__ == '__main__'."
    )


@proc
@pytest.mark.parametrize(
    ("script", "workers"), [(_STUCK_SWEEP, 2), (_STUCK_COMPARE, 1)], ids=["sweep", "compare"]
)
def test_no_worker_outlives_a_killed_parent_by_two_seconds(
    script: str, workers: int, tmp_path: Path
) -> None:
    """Not even from native code that keeps Python's lock."""
    log = tmp_path / "log"
    (tmp_path / "stuck.py").write_text(script)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "stuck.py"), str(tmp_path / "sweep")],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "SWEEP_LOG": str(log)},
        start_new_session=True,
    )
    try:
        until(lambda: len(ran(log)[1]) == workers)
        process.kill()
        process.wait(60)
        assert within(2.0, lambda: gone(ran(log)[1]))
    finally:
        for pid in ran(log)[1]:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
