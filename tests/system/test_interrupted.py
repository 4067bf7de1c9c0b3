"""Whatever happens to the machine: words cost no files, an interruption is quiet, and nothing is
half there under its name.
"""

from __future__ import annotations

import io
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr
from pathlib import Path

import pytest

from cranedyn.controllers import hold_controller
from cranedyn.data.files import check_writable, read_text, written
from cranedyn.errors import CraneError, DataError, OutOfRange, RunError
from cranedyn.recording import Live
from cranedyn.recording.process import free
from cranedyn.simulation.simulate import simulate
from experiments import harness
from tests.helpers import ROOT, crane, files, python

# --- what is written ------------------------------------------------------------------------------


def test_an_error_is_one_printable_line_of_bounded_length_whatever_it_quotes() -> None:
    for error in (
        DataError("a\nb\x1b[31m\udcff\u2028c" + "x" * 10**6),
        OutOfRange("n\r", "1\n2", "> 0"),
    ):
        assert str(error).isprintable() and len(str(error)) < 2100


@pytest.mark.parametrize(
    "error",
    [
        DataError("x"),
        OutOfRange("a", 1.0, "> 2", "m"),
        RunError("It broke.", t=1.5, joint="yaw_joint", value=7.0),
    ],
)
def test_an_error_comes_back_whole_from_another_process(error: CraneError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_only_files_are_written_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match="it is no file but a device"), written(tmp_path / "pipe"):
        pytest.fail("must not get here")
    with pytest.raises(DataError, match=r"/dev/null: it is no file but a device"):
        check_writable("/dev/null")
    assert not Path("/dev/null").is_file() and not (tmp_path / "pipe").is_file()


@pytest.mark.parametrize("name", ["a" * 240 + ".csv", "ä" * 110 + ".csv"])
def test_a_name_as_long_as_the_system_allows_is_written(name: str, tmp_path: Path) -> None:
    with written(tmp_path / name) as draft:
        draft.write_text("x")
    assert files(tmp_path) == [name]


def test_a_file_without_end_is_not_read() -> None:
    with pytest.raises(DataError, match=r"Cannot read /dev/zero: it is no file but a device\."):
        read_text("/dev/zero")


def test_whether_a_file_can_be_written_is_found_out_without_a_trace(tmp_path: Path) -> None:
    (tmp_path / "old.csv").write_text("old")
    for name in ("old.csv", "new.csv", "a/b/c/new.csv"):
        check_writable(tmp_path / name)
    with pytest.raises(DataError, match=r"Cannot make the folder .*Not a directory"):
        check_writable(tmp_path / "old.csv" / "x" / "new.csv")
    assert files(tmp_path) == ["old.csv"]
    assert (tmp_path / "old.csv").read_text() == "old"


def test_a_run_that_breaks_off_over_a_full_disk_says_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def experiment(options: object, setup: harness.Setup) -> harness.Outcome:
        (tmp_path / "out").rmdir()
        (tmp_path / "out").write_text("in the way")
        raise RunError(
            "It broke.",
            t=1.0,
            trajectory=simulate(crane(), hold_controller(crane()), duration=0.02),
        )

    with redirect_stderr(io.StringIO()) as err:
        assert (
            harness.run_experiment(
                harness.parser("trial", "A trial."), experiment, ["--out", str(tmp_path / "out")]
            )
            == 1
        )
    first, second = err.getvalue().splitlines()
    assert first == "error: It broke."
    assert second.startswith("What was recorded up to then is lost: Cannot make the folder ")


_KILLED = """
import os, signal, sys
from pathlib import Path
from cranedyn.data.files import written

with written(sys.argv[1]) as draft:
    draft.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_writer_that_is_killed_leaves_the_old_file_and_no_obstacle(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("old")
    assert python(_KILLED, path).returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    stale = [name for name in files(tmp_path) if name != "a.csv"]
    assert len(stale) == 1 and stale[0].startswith(".a.")
    with written(path) as draft:
        draft.write_text("new")
    assert (path.read_text(), files(tmp_path)) == ("new", [*stale, "a.csv"])


# --- words, pipes, signals and disks --------------------------------------------------------------

_TRIAL = """
import os, resource, signal, sys
from experiments import harness
from cranedyn.controllers import hold_controller
from cranedyn.plotting.figures import panels
from cranedyn.recording import Run
from cranedyn.simulation.simulate import simulate

def experiment(options, world):
    run = simulate(world.crane, hold_controller(world.crane), duration=0.5)
    table = harness.Table("φ and θ", [("φ [rad]", ".3f")], [(0.0,)] * 2000)
    claim = harness.Claim("ω is √(g/l).", True)
    figures, shown = {"figure": panels()[0]}, [Run("r", world.crane, run)]
    return harness.Outcome([table], [claim], {}, {"run": run}, figures, shown)

def trial(*words):
    made = harness.parser("trial", "A trial.")
    harness.add_setup(made)
    return harness.run_experiment(made, experiment, words)
"""
WHOLE = ["figure.png", "figure.svg", "result.json", "run.csv", "run.parquet", "trial.rrd"]


@pytest.mark.parametrize(
    ("shell", "says"),
    [
        ("{} | true", ""),
        ("{} | head -1", ""),
        ("PYTHONIOENCODING=latin-1 {} | tail -3", "holds"),
        ("{} >/dev/full", "Some words could not be written: No space left on device."),
        ("{} >&-", ""),
        ("{} >&- 2>&-", ""),
    ],
)
def test_files_are_whole_whoever_listens(shell: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "trial.py").write_text(f"{_TRIAL}\nsys.exit(trial('--out', sys.argv[1]))")
    command = shell.format(f'"{sys.executable}" "{tmp_path / "trial.py"}" "{tmp_path / "out"}"')
    run = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command}"],
        capture_output=True,
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        check=False,
    )
    assert run.returncode == 0
    assert b"Traceback" not in run.stderr and b"Exception" not in run.stderr
    assert says.encode() in run.stdout + run.stderr
    assert files(tmp_path / "out") == WHOLE


def test_the_urdf_may_be_read_by_halves() -> None:
    command = f'set -o pipefail; "{sys.executable}" -m cranedyn.model.description | head -1'
    run = subprocess.run(
        ["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert (run.returncode, run.stderr) == (0, "")


_INTERRUPTED = f"""{_TRIAL}
import json, shutil, time
from pathlib import Path

folder = Path(sys.argv[1])
trial("--out", str(folder))  # so that all is imported
began = time.monotonic()
trial("--out", str(folder))
whole = time.monotonic() - began
signal.signal(
    signal.SIGALRM,
    lambda *_: os.kill(os.getpid(), signal.SIGINT if k % 2 else signal.SIGTERM),
)
signal.signal(signal.SIGTERM, signal.SIG_DFL)
for k in range(24):
    shutil.rmtree(folder, ignore_errors=True)
    ready = False
    def experiment(options, world, inner=experiment):
        signal.setitimer(signal.ITIMER_REAL, 1.1 * whole * (k + 0.5) / 24)
        return inner(options, world)
    made = harness.parser("trial", "A trial.")
    harness.add_setup(made)
    try:
        code = harness.run_experiment(made, experiment, ["--out", str(folder)])
        signal.setitimer(signal.ITIMER_REAL, 0)
    except KeyboardInterrupt:
        code = None  # it came when the experiment was over
    left = sorted(os.listdir(folder)) if folder.exists() else []
    print(json.dumps(["code", code, left]), flush=True)
    time.sleep(0.02)
    for path in folder.glob("*.parquet"):
        from cranedyn.data.trajectory import read
        read(path)
"""


def test_an_interruption_at_any_moment_is_130_and_leaves_whole_files_only(tmp_path: Path) -> None:
    run = python(_INTERRUPTED, tmp_path / "out")
    assert run.returncode in (0, -signal.SIGTERM), run.stderr
    assert "Traceback" not in run.stderr
    found = [json.loads(line) for line in run.stdout.splitlines() if line.startswith('["code"')]
    codes = [code for _, code, _ in found]
    assert codes.count(130) >= 5
    assert set(codes) <= {0, 130, None}
    for _, code, names in found:
        assert set(names) <= {*WHOLE, "broken_off.parquet"}
        assert code != 0 or names == WHOLE


def test_an_interruption_while_a_command_is_being_imported_ends_it(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-X",
            "importtime",
            "-m",
            "experiments.energy",
            "--out",
            str(tmp_path / "out"),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stderr is not None
    for line in process.stderr:
        if line.rstrip().endswith("numpy"):
            break
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == -signal.SIGINT  # 130 to a shell
    assert "Traceback" not in said
    assert files(tmp_path) == []


_WITHIN_TEXT = """
from cranedyn.command import command

def run():
    exec("raise KeyboardInterrupt")

code = command(run)
assert code == 130, code
"""


def test_an_interruption_within_executed_text_does_not_kill_the_program_at_its_end() -> None:
    run = python(_WITHIN_TEXT)
    assert (run.returncode, run.stderr) == (0, "Interrupted.\n")


_SERVED = f"""{_TRIAL}
from cranedyn.recording.process import free, start
import cranedyn.recording.viewer as viewer
first = 21000 + 2 * (os.getpid() % 4000)  # whoever else looks for ports begins elsewhere
port = next(p for p in range(first, 30000, 2) if free(p) and free(p + 1))
def telling(*words, **more):
    made = start(*words, **more)
    print("viewer", made.pid, flush=True)
    return made
viewer.start = telling
sys.stdout.reconfigure(line_buffering=True)
sys.exit(trial("--out", sys.argv[1], "--serve", "--port", str(port)))
"""


@pytest.mark.parametrize("word", [signal.SIGINT, signal.SIGTERM])
def test_a_server_that_is_told_to_end_ends_its_viewer_and_with_the_code_of_its_claims(
    word: signal.Signals, tmp_path: Path
) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVED, str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    viewer = 0
    for line in process.stdout:
        if line.startswith("viewer "):
            viewer = int(line.split()[1])
        if line.startswith("Serving at "):
            break
    os.kill(viewer, 0)  # it runs
    process.send_signal(word)
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")
    with pytest.raises(ProcessLookupError):
        os.kill(viewer, 0)
    assert files(tmp_path / "out") == WHOLE


def test_a_viewer_ends_within_two_seconds_of_a_program_that_is_killed(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", _SERVED, str(tmp_path / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
    )
    assert process.stdout is not None
    said = next(line for line in process.stdout if line.startswith("Serving at "))
    ports = [int(port) for port in re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", said)]
    assert len(ports) == 2 and not any(map(free, ports))
    process.kill()
    process.wait()
    killed = time.monotonic()
    while not all(map(free, ports)) and time.monotonic() < killed + 10.0:
        time.sleep(0.05)
    assert time.monotonic() < killed + 2.0


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
    assert len(codes) >= 5 and set(codes) == {"code 2"}
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
