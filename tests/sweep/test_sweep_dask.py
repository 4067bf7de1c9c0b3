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
from contextlib import ExitStack, contextmanager
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
from tests.sweep.test_sweep_interrupted import CASES, CHUNK, answered, parts, ran, sweeping, until

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]
dask = pytest.importorskip("dask", reason="the extra dask is not installed")
pytest.importorskip("distributed", reason="the extra dask is not installed")


@contextmanager
def _dask(*words: str, log: Path, **environment: str) -> Iterator[subprocess.Popen[bytes]]:
    """A ``dask`` command in a group of its own, all of it killed in the end."""
    more = {
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
            env=os.environ | more,
            start_new_session=True,
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
    process.wait(60)


@contextmanager
def _cluster(
    folder: Path, **environment: str
) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """Address of a scheduler, and the processes of the scheduler and two workers."""
    quiet = ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    with ExitStack() as stack:
        log = folder / "scheduler.log"
        words = ("scheduler", "--host", "127.0.0.1", "--port", "0", *quiet)
        processes = [stack.enter_context(_dask(*words, log=log, **environment))]
        until(lambda: re.search(r"Scheduler at: +(tcp://\S+)", log.read_text()))
        address = re.search(r"Scheduler at: +(tcp://\S+)", log.read_text())[1]  # type: ignore[index]
        for i in range(2):
            words = ("worker", address, "--host", "127.0.0.1", "--nthreads", "1", *quiet)
            processes.append(
                stack.enter_context(_dask(*words, log=folder / f"worker{i}.log", **environment))
            )
        until(lambda: log.read_text().count("Register worker") == 2)
        yield address, processes


def test_a_cluster_whose_workers_are_killed_ends_what_it_can_and_says_when_none_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, log, design = tmp_path / "sweep", tmp_path / "log", grid(x=range(40))
    gate, environment = tmp_path / "gate", {"SWEEP_LOG": str(log), "SWEEP_PAUSE": "0.05"}
    with _cluster(tmp_path, **environment, SWEEP_GATE=str(gate)) as (address, processes):
        scheduler, one, other = processes

        def kill_one() -> None:
            until(lambda: len(ran(log)[1]) == 2)  # both work
            _kill(one)
            gate.touch()

        threading.Thread(target=kill_one).start()
        end = sweep(studies.logged, design, folder, chunk=1, scheduler=address)
        assert end == Progress(40, 40, 0, 0)
        table = results(folder)
        assert table["case"].to_pylist() == list(range(40))
        assert table["y"].to_pylist() == [float(x * x) for x in range(40)]
        assert table["error"].null_count == 40

        _kill(other)
        monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 1)
        with pytest.raises(CraneError, match=rf"{address} has no worker; start some with: dask w"):
            sweep(studies.squares, design, tmp_path / "b", scheduler=address)

        monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 60)
        said = tmp_path / "scheduler.log"
        clients = said.read_text().count("Receive client connection")

        def kill_scheduler() -> None:
            until(lambda: said.read_text().count("Receive client connection") > clients)
            _kill(scheduler)

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
    design, dead, late = grid(x=range(6)), tmp_path / "dead", tmp_path / "late"
    with _cluster(tmp_path, DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES="0") as (address, _):
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
    folder, log = tmp_path / "sweep", tmp_path / "log"
    with _cluster(tmp_path, SWEEP_LOG=str(log), SWEEP_PAUSE="1.0") as (address, (scheduler, *_)):
        with sweeping(folder, log, 1.0, address) as process:
            until(lambda: len(parts(folder)) >= 2)
            if hung:
                scheduler.send_signal(signal.SIGSTOP)
            os.killpg(process.pid, signal.SIGINT)
            err = answered(process)
        done = CHUNK * len(parts(folder))
        assert (
            err == f"Interrupted: {done} of {CASES} cases are done, and kept in {folder}; the same "
            "sweep goes on from there.\n"
        )
        assert process.returncode == 130


def _listening(session: int) -> dict[int, set[str]]:
    """Addresses on which each process of a session listens."""
    found: dict[int, set[str]] = {}
    for process in psutil.process_iter():
        try:
            if os.getsid(process.pid) == session:
                found[process.pid] = {
                    c.laddr.ip for c in process.net_connections() if c.status == psutil.CONN_LISTEN
                }
        except (ProcessLookupError, psutil.NoSuchProcess):
            continue
    return {pid: addresses for pid, addresses in found.items() if addresses}


@contextmanager
def _documented(folder: Path, kind: int, listeners: int = 0) -> Iterator[tuple[str, str]]:
    """What the commands of a block of docs/howto/sweep.md said, and the address of their scheduler,
    while their servers still run.

    Of these there are to be so many processes. None of them, and not the program that sweeps, ever
    listens beyond 127.0.0.1.
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
    commands = blocks[kind].replace("PYTHONPATH=.", f"PYTHONPATH=.:{ROOT}")
    with (folder / "said").open("w") as out:
        shell = subprocess.Popen(
            ["bash", "-ec", commands],
            cwd=folder,
            env=environment,
            stdout=out,
            start_new_session=True,
        )
    seen: dict[int, set[str]] = {}
    try:
        while shell.poll() is None or (shell.returncode == 0 and len(seen) < listeners):
            for pid, addresses in _listening(shell.pid).items():
                seen.setdefault(pid, set()).update(addresses)
            time.sleep(0.2)
        assert shell.returncode == 0
        assert set().union(*seen.values()) <= {"127.0.0.1"}
        yield (folder / "said").read_text(), f"127.0.0.1:{port}"
    finally:
        _kill(shell)


_COLUMNS = "['case', 'strategy', 'l_m', 'A_rad', 'T_s', 'error']"
_ALL = f"2048 cases, 0 bad, 2048 of them computed just now\n{_COLUMNS}\n"


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, pa.Table]:
    """What the first commands of the documentation said and left."""
    folder = tmp_path_factory.mktemp("local")
    with _documented(folder, 0) as (said, _):
        return said, results(folder / "out" / "periods")


def test_the_commands_of_the_documentation_work(local: tuple[str, pa.Table]) -> None:
    assert local[0] == f"{_ALL}2048 cases, 0 bad, 0 of them computed just now\n{_COLUMNS}\n"


@pytest.mark.long
def test_the_documented_cluster_computes_the_same_and_listens_to_nobody_else(
    local: tuple[str, pa.Table], tmp_path: Path
) -> None:
    # The scheduler, two workers, and a nanny for each.
    with _documented(tmp_path, 1, listeners=5) as (said, _):
        assert said == _ALL
    assert results(tmp_path / "out" / "periods").equals(local[1])


@pytest.mark.skipif(shutil.which("openssl") is None, reason="certificates are made by openssl")
@pytest.mark.long
def test_with_tls_only_who_has_a_certificate_can_connect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 1.0)
    with _documented(tmp_path, 2, listeners=3) as (said, place):
        assert said == _ALL
        make = (
            "openssl req -x509 -newkey rsa:2048 -nodes -days 1 -subj /CN=stranger -keyout "
            "strange.key -out strange.pem"
        )
        subprocess.run(make.split(), cwd=tmp_path, capture_output=True, check=True)
        ours, strange, key = (
            str(tmp_path / name) for name in ("cert.pem", "strange.pem", "strange.key")
        )
        for protocol, security in (
            ("tls", cluster.tls(ours, strange, key)),
            ("tls", cluster.tls(strange, strange, key)),
            ("tls", None),
            ("tcp", None),
            ("tcp", cluster.tls(ours, strange, key)),
        ):
            address, folder = f"{protocol}://{place}", tmp_path / "refused"
            with pytest.raises(CraneError, match=f"No Dask scheduler answers at {address}"):
                sweep(studies.squares, grid(x=[1.0]), folder, scheduler=address, security=security)
            assert not folder.exists()


def test_certificates_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "none.pem"
    with pytest.raises(CraneError, match=r"Cannot read .*none\.pem: there is no such file\."):
        cluster.tls(str(file), str(file), str(file))
    file.write_text("none")
    security = cluster.tls(str(file), str(file), str(file))
    options = {"scheduler": "tls://127.0.0.1:1", "security": security}
    with pytest.raises(CraneError, match=r"No Dask scheduler answers at tls://"):
        sweep(studies.squares, grid(x=[1.0]), tmp_path / "sweep", **options)  # type: ignore[arg-type]
    assert not (tmp_path / "sweep").exists()


@pytest.mark.parametrize(
    "answer",
    [
        lambda to: to.sendall(b"SSH-2.0-OpenSSH_9.2\r\n"),
        lambda to: to.close(),
        lambda to: to.recv(1),
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
    began = time.monotonic()
    with (
        # Dask itself would wait for longer than a test may take.
        dask.config.set({"distributed.comm.timeouts.connect": "1000s"}),
        pytest.raises(CraneError, match=r"No Dask scheduler answers at tcp://127.*: it timed"),
    ):
        sweep(studies.squares, grid(x=range(4)), tmp_path, scheduler="tcp://127.0.0.1:1")
    assert time.monotonic() - began > 0.5


def test_ctrl_c_is_answered_while_a_scheduler_keeps_silent(tmp_path: Path) -> None:
    """It greets, as one that hangs would, and that is all."""
    with socket.create_server(("127.0.0.1", 0)) as server, ExitStack() as stack:
        with sweeping(
            tmp_path / "sweep", tmp_path / "log", 0.1, f"tcp://127.0.0.1:{server.getsockname()[1]}"
        ) as process:
            stack.enter_context(server.accept()[0]).sendall((100).to_bytes(8, "little"))
            time.sleep(0.3)
            os.killpg(process.pid, signal.SIGINT)
            err = answered(process)
    assert err.startswith(f"Interrupted: 0 of {CASES} cases are done") and err.count("\n") == 1


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
    assert "cranedyn" in modules and not {"dask", "distributed", "scipy"} & modules
