"""Interruptions, broken pipes, full disks and killed processes leave whole files only."""

from __future__ import annotations

import io
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr
from pathlib import Path

import pytest

from cranedyn.command import INTERRUPTED, command, side_thread
from cranedyn.controllers import hold_controller
from cranedyn.data.files import atomic_write
from cranedyn.errors import DataError, RunError
from cranedyn.recording import Live
from cranedyn.recording.process import is_free
from cranedyn.simulation.simulate import simulate
from experiments import harness
from tests.helpers import ROOT, crane, files, python, within

pytestmark = pytest.mark.slow

_TRIAL = """
import os, resource, signal, sys
from experiments import harness
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import panels
from cranedyn.recording import Run
from cranedyn.simulation.simulate import simulate

def experiment(options, world):
    run = simulate(world.crane, hold_controller(world.crane), duration=0.5)
    table = harness.ResultTable("φ and θ", [("φ [rad]", ".3f")], [(0.0,)] * 2000)
    claim = harness.Claim("ω is √(g/l).", True)
    figures, shown = {"figure": panels()[0]}, [Run("r", world.crane, run)]
    return harness.Outcome([table], [claim], {}, {"run": run}, figures, shown)

def trial(*words):
    made = harness.parser("trial", "A trial.")
    harness.add_setup(made)
    return harness.run_experiment(made, experiment, words)
"""
WHOLE = ["figure.png", "figure.svg", "result.json", "run.parquet", "trial.rrd"]


@pytest.mark.parametrize("words", [["describe"], ["list"], ["describe", "--help"]])
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
def test_a_full_disk_behind_standard_output_is_one_sentence(words: list[str]) -> None:
    command = [sys.executable, "-m", "cranedyn", *words]
    with open("/dev/full", "w") as full:
        run = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False
        )
    assert run.returncode == 2
    assert run.stderr == "error: Cannot write to standard output: No space left on device.\n"


def test_a_reader_that_stops_reading_costs_no_files(tmp_path: Path) -> None:
    (tmp_path / "trial.py").write_text(f"{_TRIAL}\nsys.exit(trial('--out', sys.argv[1]))")
    # Nobody reads from the start: a reader that stops later may come after the last line.
    reading, writing = os.pipe()
    os.close(reading)
    run = subprocess.run(
        [sys.executable, str(tmp_path / "trial.py"), str(tmp_path / "out")],
        stdout=writing,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    os.close(writing)
    assert (run.returncode, run.stderr) == (1, b"")
    assert files(tmp_path / "out") == WHOLE


# --- Ctrl-C and SIGTERM ---------------------------------------------------------------------------

_SIGNALLED = f"""{_TRIAL}
import time
from cranedyn.data.trajectory import Trajectory
from cranedyn.plotting import figures
from cranedyn.simulation.log import Log

where, number = sys.argv[2], signal.Signals[sys.argv[3]]

def arrive(*_):
    print("signal at", time.process_time(), flush=True)
    os.kill(os.getpid(), number)
    time.sleep(9)

def long_experiment(options, world):
    signal.signal(signal.SIGVTALRM, arrive)
    signal.setitimer(signal.ITIMER_VIRTUAL, 0.3)
    simulate(world.crane, hold_controller(world.crane), duration=1e3)

def once_more(function):
    def interrupted(*words, **named):
        os.kill(os.getpid(), number)
        return function(*words, **named)

    return interrupted

if where == "files":
    figures.save = arrive
else:
    experiment = long_experiment
if where == "run, again before the rows are read":
    Log.trajectory = once_more(Log.trajectory)
if where == "run, again before the file is written":
    Trajectory.write = once_more(Trajectory.write)
sys.exit(trial("--out", sys.argv[1]))
"""


@pytest.mark.parametrize(
    ("where", "left", "number"),
    [
        ("run", ["broken_off.parquet"], "SIGINT"),
        ("run, again before the rows are read", ["broken_off.parquet"], "SIGINT"),
        ("run, again before the file is written", ["broken_off.parquet"], "SIGINT"),
        ("files", [], "SIGTERM"),
    ],
)
def test_an_interruption_ends_a_command_within_two_seconds_and_leaves_whole_files_only(
    where: str, left: list[str], number: str, tmp_path: Path
) -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = python(_SIGNALLED, tmp_path / "out", where, number)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    assert (run.returncode, run.stderr.count("Traceback")) == (INTERRUPTED, 0)
    assert "Interrupted" in run.stderr
    (signalled,) = re.findall(r"signal at ([\d.]+)", run.stdout)
    assert used - float(signalled) < 2.0  # of the processor, which others use, too
    assert (files(tmp_path / "out") if left else files(tmp_path)) == left


WHOLE_COUNT = 20_000_000
"""What a processor counts to in seconds."""


def _count(count: list[int]) -> None:
    """Count, as a thread does that computes in Python."""
    while count[0] < WHOLE_COUNT:
        count[0] += 1


def test_an_interruption_ends_what_runs_beside_it(capfd: pytest.CaptureFixture[str]) -> None:
    count = [0]
    with pytest.raises(KeyboardInterrupt), side_thread(_count, count):
        while not count[0]:
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert count[0] < WHOLE_COUNT
    reached = count[0]
    time.sleep(0.1)
    assert count[0] == reached
    assert capfd.readouterr() == ("", "")


def test_what_runs_beside_gives_its_result_or_its_error() -> None:
    with side_thread(divmod, 7, 2) as whole, side_thread(divmod, 7, 0) as fault:
        pass
    assert whole.result() == (3, 1)
    with pytest.raises(ZeroDivisionError):
        fault.result()


def _taken_for_a_fault() -> None:
    """Raise what a library makes of an interruption that it takes for a fault of its own."""
    try:
        raise KeyboardInterrupt
    except KeyboardInterrupt:
        raise UnboundLocalError("cannot access local variable 'ArgException'") from None


def _raise_interrupt() -> int:
    raise KeyboardInterrupt


def _raise_hidden() -> int:
    _taken_for_a_fault()
    return 0


@pytest.mark.parametrize("run", [_raise_interrupt, _raise_hidden])
def test_an_interruption_is_130_whatever_a_library_made_of_it(
    run: Callable[[], int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert command(run) == INTERRUPTED
    assert capsys.readouterr().err == "Interrupted.\n"


_INTERRUPTED_IMPORT = """
import os, signal, sys
import numpy as np
from cranedyn import load_crane, simulate
from cranedyn.controllers import hold_controller
from cranedyn.lifts.planning.solids import body

class Interruption:
    def find_spec(self, name, *_):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
run = simulate(crane := load_crane(), hold_controller(crane), duration=0.1)
sys.meta_path.insert(0, Interruption())
for call in sys.argv[2:]:
    try:
        eval(call)
        print("done")
    except KeyboardInterrupt:
        print("interrupted")
"""


@pytest.mark.parametrize(
    ("module", "first", "second"),
    [
        ("trimesh.path", wedge := "body('wedge', np.eye(4, 3), faces)", wedge),
        ("pandas._libs.tslibs.timedeltas", "run.to_pandas()", "run.to_pandas()"),
    ],
)
def test_an_interruption_of_an_import_is_neither_swallowed_nor_leaves_half_a_library(
    module: str, first: str, second: str
) -> None:
    library = module.partition(".")[0]
    pytest.importorskip(library, reason=f"{library} is not installed")
    answer = python(_INTERRUPTED_IMPORT, module, first, second)
    assert answer.stdout.split() == ["interrupted", "done"], answer.stderr


def test_a_fault_of_ours_is_not_taken_for_an_interruption() -> None:
    with pytest.raises(ZeroDivisionError):
        command(lambda: 1 // 0)


_SERVED = f"""{_TRIAL}
from cranedyn.recording.process import is_free, start
import cranedyn.recording.viewer as viewer
first = 21000 + 2 * (os.getpid() % 4000)  # whoever else looks for ports begins elsewhere
port = next(p for p in range(first, 30000, 2) if is_free(p) and is_free(p + 1))
def telling(*words, **more):
    made = start(*words, **more)
    print("viewer", made.pid, flush=True)
    return made
viewer.start = telling
sys.stdout.reconfigure(line_buffering=True)
sys.exit(trial("--out", sys.argv[1], "--serve", "--port", str(port)))
"""


def _serving(folder: Path) -> tuple[subprocess.Popen[str], int, list[int]]:
    """Return a program that serves a recording, its viewer and their ports."""
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVED, str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if line.startswith("Serving at "):
            break
    viewer = next(int(line.split()[1]) for line in lines if line.startswith("viewer "))
    ports = [int(port) for port in re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", lines[-1])]
    assert len(ports) == 2
    assert not any(map(is_free, ports))
    return process, viewer, ports


def test_a_server_that_is_told_to_end_ends_its_viewer_and_with_the_code_of_its_claims(
    tmp_path: Path,
) -> None:
    process, viewer, _ = _serving(tmp_path / "out")
    os.kill(viewer, 0)  # it runs
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    with pytest.raises(ProcessLookupError):
        os.kill(viewer, 0)
    assert files(tmp_path / "out") == WHOLE


def test_a_viewer_ends_within_two_seconds_of_a_program_that_is_killed(tmp_path: Path) -> None:
    process, _, ports = _serving(tmp_path / "out")
    process.kill()
    process.wait()
    assert within(2.0, lambda: all(map(is_free, ports)))


# --- disks and kill -9 ----------------------------------------------------------------------------

_KILLED = """
import os, signal, sys
from pathlib import Path
from cranedyn.data.files import atomic_write

with atomic_write(sys.argv[1]) as draft:
    draft.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_writer_that_is_killed_leaves_the_old_file_and_no_obstacle(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    assert python(_KILLED, path).returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    stale = [name for name in files(tmp_path) if name != "a.csv"]
    assert len(stale) == 1
    assert stale[0].startswith(".a.")
    with atomic_write(path) as draft:
        draft.write_text("new")
    assert (path.read_text(), files(tmp_path)) == ("new", [*stale, "a.csv"])


def test_a_run_that_breaks_off_over_a_full_disk_says_both(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def experiment(options: object, setup: harness.Setup) -> harness.Outcome:
        out.rmdir()
        out.write_text("in the way")
        run = simulate(crane(), hold_controller(crane()), duration=0.02)
        raise RunError("It broke.", t=1.0, trajectory=run)

    parser = harness.parser("trial", "A trial.")
    with redirect_stderr(io.StringIO()) as err:
        assert harness.run_experiment(parser, experiment, ["--out", str(out)]) == 1
    first, second = err.getvalue().splitlines()
    assert first == "error: It broke."
    assert second.startswith("What was recorded up to then is lost: Cannot make the folder ")


_FULL = f"""{_TRIAL}
from cranedyn.recording import Live
from pathlib import Path
trial("--out", sys.argv[1])
sizes = {{p.name: p.stat().st_size for p in Path(sys.argv[1]).iterdir()}}
limits = sorted({{0, 4000, *(int(0.9 * size) for size in sizes.values() if size > 5000)}})
for limit in limits:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    folder = Path(f"{{sys.argv[1]}}{{limit}}")
    print("code", trial("--out", str(folder)), file=sys.stderr)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    for path in folder.glob("*") if folder.exists() else ():
        assert sizes[path.name] == path.stat().st_size or path.name == "result.json", path
"""


def test_a_disk_that_is_full_at_any_file_is_one_sentence_and_no_half_file(tmp_path: Path) -> None:
    run = python(_FULL, tmp_path / "out")
    assert run.returncode == 0, run.stderr
    lines = run.stderr.splitlines()
    codes = [line for line in lines if line.startswith("code")]
    sentences = [line for line in lines if line.startswith("error: Cannot write ")]
    assert len(codes) >= 5
    assert set(codes) == {"code 2"}
    assert len(sentences) == len(codes)
    assert all("File too large." in sentence for sentence in sentences)
    assert [name for name in files(tmp_path) if "/." in name] == []


def test_a_live_recording_on_a_full_disk_is_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Path, content: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(DataError, match=r"Cannot write .*a\.rrd: No space left on device\."):
        Live(crane(), "r", title="t", file=tmp_path / "a.rrd")
