"""Sweeps on a Dask cluster as its users start it: scheduler and workers are processes, and some of
them are killed.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import psutil
import pyarrow as pa
import pytest

from cranedyn.errors import CraneError
from cranedyn.recording.process import free_port
from cranedyn.sweep import Progress, cluster, grid, results, sweep
from cranedyn.sweep.study import DIED
from tests import studies
from tests.helpers import ROOT, files, python
from tests.sweep.test_sweep_interrupted import (
    CASES,
    CHUNK,
    message_within_two_seconds,
    parts,
    ran,
    sweeping,
    until,
)

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]
dask = pytest.importorskip("dask", reason="the extra dask is not installed")
pytest.importorskip("distributed", reason="the extra dask is not installed")


@contextmanager
def _dask(*words: str, log: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A ``dask`` command in a group of its own, all of it killed in the end."""
    variables = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
        "DASK_TEMPORARY_DIRECTORY": str(log.parent),
        **environment,
    }
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "dask", *words],
            stdout=file,
            stderr=file,
            cwd=ROOT,
            env=variables,
            start_new_session=True,
        )
    try:
        yield process
    finally:
        kill_group(process)


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a command and all processes of its group."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait(60)


@contextmanager
def dask_cluster(
    folder: Path, **environment: str
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and the processes of the scheduler and two workers."""
    local = ("--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    log = folder / "scheduler.log"

    def address_in_log() -> re.Match[str] | None:
        return re.search(r"Scheduler at: +(tcp://\S+)", log.read_text())

    with ExitStack() as stack:
        scheduler = _dask("scheduler", "--port", "0", *local, log=log, **environment)
        processes = [stack.enter_context(scheduler)]
        until(address_in_log)
        match = address_in_log()
        assert match is not None
        address = match[1]
        for i in range(2):
            worker_log = folder / f"worker{i}.log"
            options = ("--nthreads", "1", *local)
            worker = _dask("worker", address, *options, log=worker_log, **environment)
            processes.append(stack.enter_context(worker))
        until(lambda: log.read_text().count("Register worker") == 2)
        yield address, processes


def test_a_cluster_whose_workers_are_killed_ends_what_it_can_and_says_when_none_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
    gate = tmp_path / "gate"
    design = grid(x=range(40))
    environment = {"SWEEP_LOG": str(log), "SWEEP_PAUSE": "0.05", "SWEEP_GATE": str(gate)}
    with dask_cluster(tmp_path, **environment) as (address, processes):
        scheduler, first_worker, second_worker = processes

        def kill_one() -> None:
            until(lambda: len(ran(log)[1]) == 2)  # both work
            kill_group(first_worker)
            gate.touch()

        threading.Thread(target=kill_one).start()
        end = sweep(studies.logged, design, folder, chunk=1, scheduler=address)
        assert end == Progress(done=40, cases=40, errors=0, before=0)
        table = results(folder)
        assert table["case"].to_pylist() == list(range(40))
        assert table["y"].to_pylist() == [float(x * x) for x in range(40)]
        assert table["error"].null_count == 40

        kill_group(second_worker)
        monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 1)
        with pytest.raises(CraneError, match=rf"{address} has no worker; start some with: dask w"):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)

        monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 60)
        scheduler_log = tmp_path / "scheduler.log"

        def count_clients() -> int:
            return scheduler_log.read_text().count("Receive client connection")

        clients = count_clients()

        def kill_scheduler() -> None:
            until(lambda: count_clients() > clients)
            kill_group(scheduler)

        threading.Thread(target=kill_scheduler).start()
        # Whichever comes first: the sweep is under way, or its client has not been answered yet.
        gone = rf"The cluster at {address} failed or is gone|No Dask scheduler answers at {address}"
        with pytest.raises(CraneError, match=gone):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)


@pytest.mark.long
def test_a_case_that_kills_its_worker_is_bad_alone_on_a_cluster_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The scheduler gives up a chunk at the first death instead of the fourth, to be done
    sooner.
    """
    design = grid(x=range(6))
    dead = tmp_path / "dead"
    late = tmp_path / "late"
    with dask_cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as (address, _):
        sweep(studies.deadly, design, dead, chunk=2, scheduler=address)
        errors = results(dead)["error"].to_pylist()
        assert errors == [DIED if x == 3 else None for x in range(6)]
        sweep(studies.stuck, design, late, chunk=1, scheduler=address, limit=3.0)
        errors = results(late)["error"].to_pylist()
        assert errors.pop(3).endswith("the case took longer than the 3 s that a case may.")
        assert errors == [None] * 5
        monkeypatch.setattr(studies.squares, "__module__", "tests.elsewhere")
        with pytest.raises(CraneError, match=r"cannot import the study tests\.elsewhere:squares"):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)


@pytest.mark.parametrize("hung", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_sweep_on_a_cluster_answers_ctrl_c_within_two_seconds(hung: bool, tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    log = tmp_path / "log"
    with dask_cluster(tmp_path, SWEEP_LOG=str(log), SWEEP_PAUSE="1.0") as (
        address,
        (scheduler, *_),
    ):
        with sweeping(folder, log, 1.0, address) as process:
            until(lambda: len(parts(folder)) >= 2)
            if hung:
                scheduler.send_signal(signal.SIGSTOP)
            os.killpg(process.pid, signal.SIGINT)
            err = message_within_two_seconds(process)
        done = CHUNK * len(parts(folder))
        assert err == (
            f"Interrupted: {done} of {CASES} cases are done, and kept in {folder}; the same sweep "
            "goes on from there.\n"
        )
        assert process.returncode == 130


def _listening(session: int) -> dict[int, set[str]]:
    """Addresses on which processes of a session listen, by the number of the process."""
    addresses: dict[int, set[str]] = {}
    for process in psutil.process_iter():
        try:
            connections = []
            if os.getsid(process.pid) == session:
                connections = process.net_connections()
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
        for connection in connections:
            if connection.status == psutil.CONN_LISTEN:
                addresses.setdefault(process.pid, set()).add(connection.laddr.ip)
    return addresses


@contextmanager
def _documented(folder: Path, block: int, listeners: int = 0) -> Iterator[tuple[str, str]]:
    """Run the commands of a block of docs/howto/sweep.md, and keep their servers for the context.

    None of the processes, and not the program that sweeps, ever listens beyond 127.0.0.1.

    Args:
        folder: Where the commands run.
        block: Number of the block, after that of the study.
        listeners: Number of processes that are waited for to listen.

    Yields:
        What the commands printed, and host and port of their scheduler.
    """
    port = free_port()
    study, *blocks = re.findall(
        r"```(?:python)?\n(.*?)```",
        (ROOT / "docs" / "howto" / "sweep.md").read_text().replace("8786", str(port)),
        re.DOTALL,
    )
    (folder / "swings.py").write_text(study)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "DASK_TEMPORARY_DIRECTORY": str(folder),
    }
    environment["PYTHONPATH"] = f".:{ROOT}"
    commands = blocks[block].replace("PYTHONPATH=.", f"PYTHONPATH=.:{ROOT}")
    output = folder / "output"
    with output.open("w") as out:
        shell = subprocess.Popen(
            ["bash", "-ec", commands],
            cwd=folder,
            env=environment,
            stdout=out,
            start_new_session=True,
        )
    listening_pids = set[int]()
    addresses = set[str]()
    try:
        while shell.poll() is None or (shell.returncode == 0 and len(listening_pids) < listeners):
            for pid, addresses_of_process in _listening(shell.pid).items():
                listening_pids.add(pid)
                addresses |= addresses_of_process
            time.sleep(0.2)
        assert shell.returncode == 0
        assert addresses <= {"127.0.0.1"}
        yield output.read_text(), f"127.0.0.1:{port}"
    finally:
        kill_group(shell)


_SWINGS = "PD: 247 mrad at most\nLQR: 28 mrad at most\n"
"""Results of the documented study, as its program prints them."""

_ALL = f"2048 cases, 0 bad, 2048 of them computed just now\n{_SWINGS}"
"""What the documented program prints when it has computed every case."""


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, pa.Table]:
    """What the first commands of the documentation printed, and the table that they computed."""
    folder = tmp_path_factory.mktemp("local")
    with _documented(folder, block=0) as (output, _):
        return output, results(folder / "out" / "swings")


def test_the_commands_of_the_documentation_work(local: tuple[str, pa.Table]) -> None:
    assert local[0] == f"{_ALL}2048 cases, 0 bad, 0 of them computed just now\n{_SWINGS}"


@pytest.mark.long
def test_the_documented_cluster_computes_the_same_and_listens_to_nobody_else(
    local: tuple[str, pa.Table], tmp_path: Path
) -> None:
    # The scheduler, two workers, and a nanny for each.
    with _documented(tmp_path, block=1, listeners=5) as (output, _):
        assert output == _ALL
    assert results(tmp_path / "out" / "swings").equals(local[1])


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
@pytest.mark.long
def test_with_tls_only_who_has_a_certificate_can_connect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 1.0)
    with _documented(tmp_path, block=2, listeners=3) as (output, host_and_port):
        assert output == _ALL
        make_certificate = (
            "openssl req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=stranger -keyout "
            "strange.key -out strange.pem"
        )
        subprocess.run(make_certificate.split(), cwd=tmp_path, capture_output=True, check=True)
        ours = str(tmp_path / "cert.pem")
        strange = str(tmp_path / "strange.pem")
        key = str(tmp_path / "strange.key")
        for protocol, security in (
            ("tls", cluster.tls(ours, strange, key)),
            ("tls", cluster.tls(strange, strange, key)),
            ("tls", None),
            ("tcp", None),
            ("tcp", cluster.tls(ours, strange, key)),
        ):
            address = f"{protocol}://{host_and_port}"
            folder = tmp_path / "refused"
            with pytest.raises(CraneError, match=f"No Dask scheduler answers at {address}"):
                sweep(studies.squares, grid(x=[1.0]), folder, scheduler=address, security=security)
            assert not folder.exists()


def test_certificates_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "none.pem"
    with pytest.raises(CraneError, match=r"Cannot read .*none\.pem: there is no such file\."):
        cluster.tls(str(file), str(file), str(file))
    file.write_text("none")
    security = cluster.tls(str(file), str(file), str(file))
    design = grid(x=[1.0])
    folder = tmp_path / "sweep"
    address = "tls://127.0.0.1:1"
    with pytest.raises(CraneError, match=r"No Dask scheduler answers at tls://"):
        sweep(studies.squares, design, folder, scheduler=address, security=security)
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize(
    "answer",
    [
        lambda connection: connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n"),
        lambda connection: connection.close(),
        lambda connection: connection.recv(1),
    ],
    ids=["other", "closes", "silent"],
)
def test_a_server_that_is_no_scheduler_is_reported(
    answer: Callable[[socket.socket], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=lambda: answer(server.accept()[0]), daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(CraneError, match=f"No Dask scheduler answers at {address}: "):
            sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler=address)
    assert files(tmp_path) == []


def test_a_scheduler_that_is_not_there_is_reported_when_it_had_time_to_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cluster.CONNECT_TIMEOUT <= 5.0
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.5)
    start = time.monotonic()
    with (
        # Dask itself would wait for longer than a test may take.
        dask.config.set({"distributed.comm.timeouts.connect": "1000s"}),
        pytest.raises(CraneError, match=r"No Dask scheduler answers at tcp://127.*: it timed"),
    ):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler="tcp://127.0.0.1:1")
    assert time.monotonic() - start > 0.5


def test_ctrl_c_is_answered_while_a_scheduler_keeps_silent(tmp_path: Path) -> None:
    """It greets, as one that hangs would, and that is all."""
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with sweeping(tmp_path / "sweep", tmp_path / "log", 0.1, address) as process:
            stack.enter_context(server.accept()[0]).sendall((100).to_bytes(8, "little"))
            time.sleep(0.3)
            os.killpg(process.pid, signal.SIGINT)
            err = message_within_two_seconds(process)
    assert err.startswith(f"Interrupted: 0 of {CASES} cases are done")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "address",
    ["", "nonsense", "tcp://127.0.0.1", "http://a:1", "tcp://127.0.0.1:1/a", "tcp://\ud800:1", 5],
)
def test_a_wrong_address_is_refused_and_leaves_nothing(address: str, tmp_path: Path) -> None:
    with pytest.raises(CraneError, match="No Dask scheduler answers at "):
        sweep(studies.squares, grid(x=range(4)), tmp_path / "a" / "b", scheduler=address)
    assert files(tmp_path) == []


def test_without_dask_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CraneError, match=r"Dask; install it with: pip install 'cranedyn\[dask\]'"):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler="tcp://127.0.0.1:1")


def test_sweeping_on_local_cores_imports_no_dask() -> None:
    script = "import sys, cranedyn.sweep; print(*{name.split('.')[0] for name in sys.modules})"
    modules = {*python(script).stdout.split()}
    assert "cranedyn" in modules
    assert not {"dask", "distributed", "scipy"} & modules
