"""Windows and pages: who can connect, what is sent, and what is refused."""

from __future__ import annotations

import os
import re
import shlex
import sys
import urllib.request
from pathlib import Path

import pytest

from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, DataError
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, open_viewer, record, serve, view
from cranedyn.recording.process import free_port, is_free
from cranedyn.recording.viewer import check_recording
from cranedyn.simulation.simulate import simulate


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    crane = load_crane()
    run = simulate(crane, hold_controller(crane), duration=0.1)
    return record(tmp_path_factory.mktemp("viewer") / "a.rrd", [Run("a", crane, run)], title="A")


def _port() -> int:
    """Return a port that is free, as is the next."""
    return next(port for port in iter(free_port, None) if is_free(port + 1) and port < 65534)


@pytest.mark.slow
def test_serving_answers_on_this_machine_alone_and_ends(file: Path) -> None:
    with serve(file, port=(port := _port())) as server:
        assert urllib.request.urlopen(server.address, timeout=60).status == 200
        if sys.platform == "linux":
            sockets = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
            listening = [words[1].split(":") for words in sockets if words[3] == "0A"]
            hosts = [host for host, number in listening if int(number, 16) in (port, port + 1)]
            assert hosts == ["0100007F"] * 2
        with pytest.raises(CraneError, match=f"Port {port} .* in use"):
            serve(file, port=port)
    assert server.process.poll() is not None
    with pytest.raises(OSError):
        urllib.request.urlopen(server.address, timeout=60)


@pytest.mark.slow
def test_a_viewer_that_we_start_sends_nothing_and_leaves_the_users_own_setting_alone(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in os.environ if name == "CI" or name.startswith("XDG_")]:
        monkeypatch.delenv(name)
    # Rerun keeps its setting, and what it is about to send, in the home folder.
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    with serve(file, port=_port()) as server:
        with urllib.request.urlopen(server.address, timeout=60) as page:
            policy = page.headers["Content-Security-Policy"]
            assert b"re_viewer" in page.read()
    allowed = server.data.removeprefix("rerun+").removesuffix("/proxy")
    assert re.findall(r"\w+://[^ ;]*", policy) == [allowed]
    assert "default-src 'self'" in policy
    assert list(tmp_path.iterdir()) == []
    assert "Every program on this machine can read what is served, and add to" in server.message
    assert server.address in server.message


def test_a_file_that_is_no_recording_is_neither_served_nor_opened(
    file: Path, tmp_path: Path
) -> None:
    old = tmp_path / "old.rrd"
    old.write_bytes(b"RRF2" + bytes([0, 30, 0, 0]) + file.read_bytes()[8:])
    for path, message in (
        (tmp_path / "none.rrd", "Cannot read"),
        (Path(__file__), "not a Rerun recording"),
        (old, "written by Rerun 0.30"),
    ):
        for look in (serve, open_viewer):
            with pytest.raises(DataError, match=message):
                look(path)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_without_a_display_the_viewer_points_to_serving_the_file(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(CraneError, match=rf"display.* view {file} --serve"):
        open_viewer(file)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_a_run_viewed_without_a_display_is_kept_and_the_error_has_the_command_that_serves_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    crane = load_crane()
    run = simulate(crane, hold_controller(crane), duration=0.02)
    with pytest.raises(CraneError) as error:
        view(run, crane, file=tmp_path / "my run.rrd")
    command = str(error.value).rpartition("instead: ")[2].removesuffix(".")
    program, subcommand, file, option = shlex.split(command)
    assert (program, subcommand, option) == ("cranedyn", "view", "--serve")
    check_recording(file)


def test_a_missing_viewer_is_an_error(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setitem(os.environ, "DISPLAY", ":0")
    for look in (serve, open_viewer):
        with pytest.raises(CraneError, match="not installed"):
            look(file)
