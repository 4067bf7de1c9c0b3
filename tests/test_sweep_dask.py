"""Sweeps on a Dask cluster as its users start it: scheduler and workers are processes, and some of them are killed."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from cranedyn.errors import CraneError
from cranedyn.recording.process import free_port
from cranedyn.sweep import Progress, cluster, grid, results, sweep
from cranedyn.sweep.chunk import DIED
from tests import studies
from tests.helpers import ROOT
from tests.test_sweep_interrupted import parts, ran, until

pytestmark = pytest.mark.usefixtures("limited")
pytest.importorskip("distributed", reason="the extra dask is not installed")


@contextmanager
def _dask(*words: str, log: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A ``dask`` command in a group of its own, all of it killed in the end."""
    more = {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]), "DASK_TEMPORARY_DIRECTORY": str(log.parent), **environment}
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words], stdout=file, stderr=file, cwd=ROOT, env=os.environ | more, start_new_session=True
        )
    try:
        yield process
    finally:
        _kill(process)


def _kill(process: subprocess.Popen[bytes]) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait(10)


@contextmanager
def _cluster(folder: Path, **environment: str) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and the processes of the scheduler and two workers."""
    quiet = ("--dashboard-address", "127.0.0.1:0")
    with ExitStack() as stack:
        log = folder / "scheduler.log"
        words = ("scheduler", "--host", "127.0.0.1", "--port", "0", *quiet)
        processes = [stack.enter_context(_dask(*words, log=log, **environment))]
        until(lambda: re.search(r"Scheduler at: +(tcp://\S+)", log.read_text()))
        address = re.search(r"Scheduler at: +(tcp://\S+)", log.read_text())[1]  # type: ignore[index]
        for i in range(2):
            words = ("worker", address, "--nthreads", "1", *quiet)
            processes.append(stack.enter_context(_dask(*words, log=folder / f"worker{i}.log", **environment)))
        until(lambda: log.read_text().count("Register worker") == 2)
        yield address, processes


def test_a_cluster_whose_workers_are_killed_ends_what_it_can_and_says_when_none_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, log, design = tmp_path / "sweep", tmp_path / "log", grid(x=range(40))
    with _cluster(tmp_path, SWEEP_LOG=str(log), SWEEP_PAUSE="0.05") as (address, (scheduler, one, other)):
        victims = iter([lambda: _kill(one)])

        def killing(progress: Progress) -> None:
            if progress.done >= 10:
                next(victims, lambda: None)()

        assert sweep(studies.logged, design, folder, chunk=1, scheduler=address, progress=killing) == Progress(40, 40, 0, 0)
        table = results(folder)
        assert table["case"].to_pylist() == list(range(40))
        assert table["y"].to_pylist() == [float(x * x) for x in range(40)]
        assert table["error"].null_count == 40
        assert len(ran(log)[1]) == 2  # both worked

        _kill(other)
        monkeypatch.setattr(cluster, "WORKERLESS", 1)
        with pytest.raises(CraneError, match=rf"The scheduler at {address} has no worker; start some with: dask worker {address}"):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)

        monkeypatch.setattr(cluster, "WORKERLESS", 60)
        threading.Timer(0.5, lambda: _kill(scheduler)).start()
        with pytest.raises(CraneError, match=rf"The scheduler at {address} is gone"):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)


def test_a_case_that_kills_its_worker_is_bad_alone_on_a_cluster_too(tmp_path: Path) -> None:
    """The scheduler gives up a chunk at the first death instead of the fourth, to be done sooner."""
    with _cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as (address, _):
        sweep(studies.deadly, grid(x=range(6)), tmp_path / "sweep", chunk=2, scheduler=address)
        assert results(tmp_path / "sweep")["error"].to_pylist() == [DIED if x == 3 else None for x in range(6)]
        studies.squares.__module__, before = "tests.elsewhere", studies.squares.__module__
        try:
            with pytest.raises(CraneError, match=r"cannot import the study tests\.elsewhere:squares"):
                sweep(studies.squares, grid(x=range(6)), tmp_path / "b", scheduler=address)
        finally:
            studies.squares.__module__ = before


def test_the_commands_of_the_documentation_work(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "sweeps.md").read_text().replace("8786", str(free_port()))
    study, local, clustered, _ = re.findall(r"```(?:python)?\n(.*?)```", text, re.DOTALL)
    (tmp_path / "swings.py").write_text(study)
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "DASK_TEMPORARY_DIRECTORY": str(tmp_path)}
    environment["PYTHONPATH"] = f".:{ROOT}"
    said = []
    for commands in (local, clustered.replace("PYTHONPATH=.", f"PYTHONPATH=.:{ROOT}")):
        with (tmp_path / "said").open("w") as out:
            shell = subprocess.Popen(["bash", "-ec", commands], cwd=tmp_path, env=environment, stdout=out, start_new_session=True)
        try:
            assert shell.wait(50) == 0
        finally:
            _kill(shell)
        said.append((tmp_path / "said").read_text())
        (tmp_path / "out" / "periods").rename(tmp_path / f"periods{len(said)}")
    columns = "['case', 'way', 'l_m', 'A_rad', 'T_s', 'error']"
    assert (
        said[0]
        == f"2048 cases, 0 bad, 2048 of them computed just now\n{columns}\n2048 cases, 0 bad, 0 of them computed just now\n{columns}\n"
    )
    assert said[1] == f"2048 cases, 0 bad, 2048 of them computed just now\n{columns}\n"
    assert results(tmp_path / "periods1").equals(results(tmp_path / "periods2"))


@contextmanager
def _server(answer: Callable[[socket.socket], object]) -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            try:
                answer(server.accept()[0])
            except OSError:
                pass

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (lambda to: to.sendall(b"SSH-2.0-OpenSSH_9.2\r\n"), r"what listens there is something else\."),
        (lambda to: to.close(), r"what listens there is something else\."),
        (lambda to: to.recv(1), r"timed out\."),
    ],
)
def test_a_server_that_is_no_scheduler_is_said_in_a_sentence(
    answer: Callable[[socket.socket], object], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECTING", 0.5)
    with _server(answer) as address, pytest.raises(CraneError, match=rf"No Dask scheduler answers at {address}: {says}"):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler=address)
    assert parts(tmp_path) == {}


@pytest.mark.parametrize(
    "address", ["", "  ", "nonsense", "127.0.0.1:8786", "tcp://127.0.0.1", "tcp://127.0.0.1:x", "http://a:1", 5, "tcp://[::1"]
)
def test_what_is_no_address_is_said_in_a_sentence(address: str, tmp_path: Path) -> None:
    with pytest.raises(CraneError, match=r"The address of a scheduler is .*; allowed is one like tcp://127\.0\.0\.1:8786\."):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler=address)


def test_a_scheduler_that_is_not_there_is_said_when_it_had_time_to_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cluster.CONNECTING <= 5.0
    monkeypatch.setattr(cluster, "CONNECTING", 0.5)
    began = time.monotonic()
    with pytest.raises(CraneError, match=r"No Dask scheduler answers at tcp://127\.0\.0\.1:1: Connection refused\."):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler="tcp://127.0.0.1:1")
    assert 0.5 < time.monotonic() - began < 5.0  # half a second of waiting, and the import of Dask


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CraneError, match=r"needs Dask; install it with: pip install 'cranedyn\[dask\]'"):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler="tcp://127.0.0.1:1")


def test_sweeping_on_local_cores_imports_no_dask() -> None:
    script = "import sys, cranedyn.sweep; print([name for name in sys.modules if name.split('.')[0] in ('dask', 'distributed', 'scipy')])"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=30, cwd=ROOT, check=True)
    assert run.stdout == "[]\n"
