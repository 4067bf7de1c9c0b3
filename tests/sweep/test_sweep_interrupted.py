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
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from cranedyn.sweep import Progress, grid, results, sweep
from tests import studies
from tests.helpers import ROOT, files, within

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]
proc = pytest.mark.skipif(
    not Path("/proc/self").exists(), reason="processes are looked up in /proc"
)

CASES = 24
"""Cases of the slow sweep."""

CHUNK = 2
"""Cases of a chunk of it."""

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


def until(condition: Callable[[], object], seconds: float = 120.0) -> None:
    """Wait until a condition holds."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition does not hold in time"
        time.sleep(0.01)


@contextmanager
def sweeping(
    folder: Path, log: Path, pause: float = 0.1, *scheduler: str
) -> Iterator[subprocess.Popen[str]]:
    """A slow sweep in a process and a group of its own, as a terminal starts it; ended in any case.

    From case 8 on it waits for a file "gate" beside its log.

    Args:
        folder: Folder of the results.
        log: File of what is run, see `ran`.
        pause: Time that each chunk takes [s].
        scheduler: Address of a Dask scheduler; without one, two processes compute.
    """
    script = log.with_name("slow.py")
    script.write_text(_SWEEP)
    process = subprocess.Popen(
        [sys.executable, str(script), str(folder), str(CASES), str(CHUNK), *scheduler],
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "SWEEP_LOG": str(log),
            "SWEEP_PAUSE": str(pause),
            "SWEEP_GATE": str(log.with_name("gate")),
        },
        start_new_session=True,
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate(timeout=60)


def message_within_two_seconds(process: subprocess.Popen[str]) -> str:
    """What a sweep that has just been interrupted writes to stderr; it begins within 2 s."""
    stderr = process.stderr
    assert stderr is not None
    assert within(2.0, lambda: select.select([stderr], [], [], 0.0)[0]), "no answer"
    return process.communicate(timeout=60)[1]


def parts(folder: Path) -> dict[str, int]:
    """The finished parts and when they were written."""
    return {path.name: path.stat().st_mtime_ns for path in folder.glob("part-*.parquet")}


def ran(log: Path) -> tuple[Counter[int], set[int]]:
    """How often each case was run, and by which processes."""
    runs = Counter[int]()
    pids = set[int]()
    if log.exists():
        for line in log.read_text().splitlines():
            pid, case = line.split()
            runs[int(case)] += 1
            pids.add(int(pid))
    return runs, pids


def gone(pids: set[int]) -> bool:
    """Whether none of these processes runs any more; one that nobody has waited for does not."""
    for pid in pids:
        try:
            status = Path(f"/proc/{pid}/status").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if "\nState:\tZ" not in status:
            return False
    return True


def finish(folder: Path, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sweep on in this process; no case is missing then, and no finished part was run again.

    Args:
        folder: Folder of the sweep.
        log: File of what was run, and will be.
        monkeypatch: Sets the variables that the study reads.
    """
    finished = parts(folder)
    kept = set[int]()
    for name in finished:
        first = CHUNK * int(name.removeprefix("part-").removesuffix(".parquet"))
        kept.update(range(first, first + CHUNK))
    monkeypatch.setenv("SWEEP_LOG", str(log))
    monkeypatch.setenv("SWEEP_PAUSE", "0")
    end = sweep(studies.logged, grid(x=range(CASES)), folder, chunk=CHUNK, workers=2)
    assert end == Progress(done=CASES, cases=CASES, errors=0, before=len(kept))
    table = results(folder)
    assert table["case"].to_pylist() == list(range(CASES))
    assert table["y"].to_pylist() == [float(x * x) for x in range(CASES)]
    runs = ran(log)[0]
    assert {x: runs[x] for x in kept} == dict.fromkeys(kept, 1)
    assert all(1 <= runs[x] <= 2 for x in range(CASES))  # twice only those that were under way
    # Two chunks that were under way at most, and two whose parts were being written.
    assert sum(runs.values()) <= CASES + 4 * CHUNK
    assert parts(folder).items() >= finished.items()  # not even written again
    assert all(name.startswith(("_sweep.json", "part-")) for name in files(folder))


@proc
def test_a_sweep_killed_in_the_middle_goes_on_and_leaves_no_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
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
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
    with sweeping(folder, log) as process:
        until(lambda: len(parts(folder)) >= 2)
        if number == signal.SIGINT:
            os.killpg(process.pid, number)  # as a terminal does: all processes hear of it
        else:
            process.send_signal(number)
        err = message_within_two_seconds(process)
    done = CHUNK * len(parts(folder))
    assert err == (
        f"Interrupted: {done} of {CASES} cases are done, and kept in {folder}; the same sweep goes "
        "on from there.\n"
    )
    assert process.returncode == 130
    assert gone(ran(log)[1])
    finish(folder, log, monkeypatch)


def test_an_interruption_while_workers_start_is_as_quiet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
    with sweeping(folder, log, pause=60.0) as process:
        until(folder.exists)
        time.sleep(0.1)
        os.killpg(process.pid, signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert not folder.exists()
    assert err.startswith("Interrupted: 0 of 24 cases are done")
    assert err.count("\n") == 1
    finish(folder, log, monkeypatch)


def test_two_processes_never_sweep_the_same_folder(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    with sweeping(folder, tmp_path / "log") as first:
        until(lambda: (tmp_path / "log").exists())
        (tmp_path / "b").mkdir()
        with sweeping(folder, tmp_path / "b" / "log") as second:
            _, err = second.communicate(timeout=120)
        assert second.returncode == 2
        assert first.poll() is None
        assert err.startswith(f"error: Cannot write to {folder}: another run is writing there;")


def test_a_worker_that_is_killed_costs_its_chunk_a_second_try_and_no_other(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
    with sweeping(folder, log) as process:
        until(lambda: len(parts(folder)) >= 2)
        _, pids = ran(log)
        os.kill(min(pids), signal.SIGKILL)
        (tmp_path / "gate").touch()
        assert process.wait(120) == 0
    runs, pids = ran(log)
    assert len(pids) == 3  # it had a successor
    assert sorted(runs) == list(range(CASES))
    assert sum(runs.values()) <= CASES + CHUNK
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
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
