"""The files of a run belong together: they appear as one set, say so, and readers look."""

from __future__ import annotations

import io
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pytest

from cranedyn import recording
from cranedyn.controllers import hold_controller
from cranedyn.data.files import digest
from cranedyn.data.trajectory import Trajectory, read
from cranedyn.errors import CraneError, DataError
from cranedyn.plotting.figures import panels
from cranedyn.recording import Live, Run
from cranedyn.simulation.simulate import simulate
from experiments import a1, demo, harness, report
from experiments.harness.document import read_document
from tests.helpers import FAST, crane, files, quickly

pytestmark = pytest.mark.slow

SET = ["a1.rrd", "figure.png", "figure.svg", "result.json", "run.parquet"]


def said(run: Callable[[], int]) -> tuple[int, str]:
    """Exit code and standard error of a command."""
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
        code = run()
    return code, err.getvalue()


def conducted(
    folder: Path,
    mass: float = 1000.0,
    words: tuple[str, ...] = (),
    inside: Callable[[], object] = lambda: None,
) -> tuple[int, str]:
    """A small run in the name of A1; another mass makes other files."""

    def experiment(options: Any, setup: harness.Setup) -> harness.Outcome:
        inside()
        heavy = crane(payload_mass=mass)
        run = quickly(heavy, hold_controller(heavy), duration=0.02)
        figure, (ax,) = panels(height=1.0)
        ax.plot([0, mass])
        table = harness.ResultTable("t", [("m", ".1f")], [(mass,)])
        return harness.Outcome(
            [table], [], {"mass": mass}, {"run": run}, {"figure": figure}, [Run("r", heavy, run)]
        )

    parser = harness.parser("a1", "A trial.")
    argv = ["--out", str(folder), *words]
    return said(lambda: harness.run_experiment(parser, experiment, argv))


def reported(folder: Path) -> tuple[int, str]:
    """The report of that run alone."""
    return said(lambda: report.main(["--out", str(folder.parent), "--only", folder.name]))


def contents(folder: Path) -> dict[str, str]:
    return {name: digest(folder / name) for name in files(folder)}


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files of a run in it, to be left alone."""
    folder = tmp_path_factory.mktemp("first") / "a1"
    assert conducted(folder) == (0, "")
    return folder


@pytest.fixture
def folder(first: Path, tmp_path: Path) -> Path:
    """A folder with the same files."""
    return shutil.copytree(first, tmp_path / "a1")


def test_a_result_lists_the_files_of_its_run_with_their_digests(folder: Path) -> None:
    assert files(folder) == SET
    found = contents(folder)
    del found["result.json"]
    assert json.loads((folder / "result.json").read_text())["files"] == found
    assert reported(folder) == (0, "")


def renamed(folder: Path, name: str = "run", words: tuple[str, ...] = ()) -> tuple[int, str]:
    """A run that writes its only trajectory under this name."""

    def experiment(options: Any, setup: harness.Setup) -> harness.Outcome:
        run = quickly(crane(), hold_controller(crane()), duration=0.02)
        return harness.Outcome([], [], {}, {name: run}, {}, [Run("r", crane(), run)])

    parser = harness.parser("a1", "A trial.")
    argv = ["--out", str(folder), *words]
    return said(lambda: harness.run_experiment(parser, experiment, argv))


def test_a_run_removes_the_files_of_the_run_before_it_and_no_other(folder: Path) -> None:
    (folder / "notes.txt").write_text("mine")
    assert renamed(folder, "other") == (0, "")
    assert files(folder) == ["a1.rrd", "notes.txt", "other.parquet", "result.json"]
    assert reported(folder) == (0, "")


def test_a_run_keeps_an_earlier_file_that_somebody_has_replaced(folder: Path) -> None:
    (folder / "run.parquet").write_text("mine")
    assert renamed(folder, "other") == (0, "")
    assert (folder / "run.parquet").read_text() == "mine"


def test_a_run_keeps_an_earlier_recording_whose_name_a_user_chose(tmp_path: Path) -> None:
    folder = tmp_path / "a1"
    assert renamed(folder, words=("--save", str(tmp_path / "mine.rrd"))) == (0, "")
    assert renamed(folder, words=("--save", str(folder / "mine.rrd"))) == (0, "")
    assert renamed(folder) == (0, "")
    assert files(folder) == ["a1.rrd", "mine.rrd", "result.json", "run.parquet"]


@pytest.mark.parametrize("name", ["../victim", "{parent}/victim"])
def test_a_result_that_names_a_file_elsewhere_removes_nothing_there(
    name: str, folder: Path
) -> None:
    victim = folder.parent / "victim"
    victim.write_text("mine")
    file = folder / "result.json"
    result = json.loads(file.read_text())
    result["files"][name.format(parent=folder.parent)] = digest(victim)
    file.write_text(json.dumps(result))
    assert renamed(folder, "other") == (0, "")
    assert victim.read_text() == "mine"


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"files": 1, "named_by_user": []}'])
def test_an_earlier_result_that_cannot_be_read_is_replaced_and_removes_nothing(
    text: str, folder: Path
) -> None:
    (folder / "result.json").write_text(text)
    assert renamed(folder, "other") == (0, "")
    assert files(folder) == sorted([*SET, "other.parquet"])


@pytest.mark.parametrize("call", [0, len(SET) - 1])
def test_a_second_run_cut_off_while_it_writes_leaves_the_first_as_it_was(
    call: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    left = call
    sync = os.fsync

    def cut(file: int) -> None:
        nonlocal left
        if left == 0:
            raise KeyboardInterrupt
        left -= 1
        sync(file)

    monkeypatch.setattr("os.fsync", cut)
    assert conducted(folder, 900.0)[0] == 130
    monkeypatch.undo()
    assert contents(folder) == before
    assert reported(folder) == (0, "")


def test_files_of_two_runs_are_not_reported(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    move = os.replace
    left = 2

    def cut(*paths: Path) -> None:
        nonlocal left
        left -= 1
        if left < 0:
            raise KeyboardInterrupt
        move(*paths)

    monkeypatch.setattr("os.replace", cut)
    assert conducted(folder, 900.0)[0] == 130
    monkeypatch.undo()
    assert files(folder) == SET
    reason = "run.parquet there is of another run than its result.json; run it --again."
    assert reported(folder) == (2, f"error: Cannot read {folder}: {reason}\n")
    assert not (folder.parent / "report.html").exists()


@pytest.mark.parametrize("lost", ["figure.png", "result.json"])
def test_a_report_makes_what_one_that_was_cut_off_has_not(
    lost: str, first: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "COMMAND", ("/nothing is run",))
    assert reported(folder) == (0, "")
    (folder / lost).unlink()
    script = f"import shutil; shutil.copytree({str(first)!r}, {str(folder)!r}, dirs_exist_ok=True)"
    monkeypatch.setattr(report, "COMMAND", (sys.executable, "-c", script))
    assert reported(folder) == (0, "")
    assert files(folder) == SET


def test_of_two_runs_in_one_folder_one_wins_whole_and_the_other_says_so(folder: Path) -> None:
    other: list[tuple[int, str]] = []
    first = conducted(folder, 900.0, inside=lambda: other.append(conducted(folder, 800.0)))
    assert first == (0, "")
    reason = "another run is writing there; wait for it, or give another folder."
    assert other == [(2, f"error: Cannot write to {folder}: {reason}\n")]
    assert json.loads((folder / "result.json").read_text())["parameters"] == {"mass": 900.0}
    assert reported(folder) == (0, "")
    assert conducted(folder, 800.0) == (0, "")


def test_whatever_is_refused_at_the_last_file_has_written_none(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise CraneError("No.")

    monkeypatch.setattr(recording, "record", refuse)
    before = contents(folder)
    for place in (folder, folder.parent / "new"):
        assert conducted(place, 900.0) == (2, "error: No.\n")
    assert contents(folder) == before
    assert not (folder.parent / "new").exists()


@pytest.mark.parametrize("value", ["0", "OFF"])
def test_a_recording_that_rerun_would_not_make_is_refused_before_the_run(
    value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RERUN", value)
    code, err = conducted(tmp_path / "a1", inside=lambda: pytest.fail("it was run"))
    reason = "Rerun is switched off by the environment variable RERUN; unset it to record"
    assert (code, err) == (2, f"error: {reason}.\n")
    assert files(tmp_path) == []


# --- names ----------------------------------------------------------------------------------------

NAME = os.fsdecode(b"\xff\xe4")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have names of text only")
def test_names_that_are_no_text_are_names(tmp_path: Path) -> None:
    folder = tmp_path / NAME
    assert conducted(folder, words=("--save", str(tmp_path / f"{NAME}.rrd"))) == (0, "")
    assert files(folder) == SET[1:]
    assert f"{NAME}.rrd" in files(tmp_path)
    assert json.loads((folder / "result.json").read_text())["command"].endswith(f"{NAME}.rrd")
    assert len(read(folder / "run.parquet")) > 1
    folder.rename(tmp_path / "a1")
    assert reported(tmp_path / "a1") == (0, "")
    t = np.arange(0.0, 40.0, 0.01)
    file = tmp_path / f"{NAME}.csv"
    table = pa.table({"t_s": t, "phi_rad": 0.1 * np.cos(t), "l_m": 0 * t + 10})
    pyarrow.csv.write_csv(table, tmp_path / "a.csv")
    (tmp_path / "a.csv").rename(file)
    words = ["--from", str(file), "--out", str(tmp_path / "a1")]
    assert said(lambda: a1.main(words)) == (0, "")
    result = json.loads((tmp_path / "a1" / "result.json").read_text())
    assert result["tables"][0]["rows"][0][0] == str(file)
    assert reported(tmp_path / "a1") == (0, "")


@pytest.mark.parametrize(
    "words", ["--out a\0b", "--save a\0b.rrd", "--from a\0b.csv", "--document a\0b.md"]
)
def test_a_name_with_a_nul_is_refused_in_a_sentence(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, err = said(lambda: a1.main(words.split(" ")))
    assert (code, err.count("\n"), files(tmp_path)) == (2, 1, [])
    assert err.startswith("error: Cannot ")


def test_a_document_that_cannot_be_written_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "page.md").write_text("<!-- a1: -->\n<!-- end -->\n")
    # No room for a draft of any name.
    monkeypatch.setattr("os.urandom", lambda count: bytes(128))
    with pytest.raises(DataError, match=r"Cannot write page\.md: File name too long\."):
        read_document("page.md", "a1")
    assert files(tmp_path) == ["page.md"]


# --- a recording that grows -----------------------------------------------------------------------


def test_arguments_that_are_refused_leave_the_recording_that_was_there(tmp_path: Path) -> None:
    for words in (["--dt", "1e-11"], ["--gravity", "-1"], ["--control-period", "0.0012"]):
        (tmp_path / "demo.rrd").write_text("old")
        argv = [*words, "--engine", FAST, "--out", str(tmp_path)]
        code, err = said(lambda argv=argv: demo.main(argv))  # type: ignore[misc]
        assert (code, err.count("\n")) == (2, 1)
        assert ((tmp_path / "demo.rrd").read_text(), files(tmp_path)) == ("old", ["demo.rrd"])


def test_a_demo_interrupted_before_its_first_row_is_130_and_leaves_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Iterator[Trajectory]:
        raise KeyboardInterrupt
        yield

    monkeypatch.setattr(demo, "pieces", interrupted)
    (tmp_path / "demo.rrd").write_text("old")
    code, err = said(lambda: demo.main(["--cycles", "1", "--out", str(tmp_path)]))
    assert (code, err) == (130, "Interrupted before the first half second was over.\n")
    assert files(tmp_path) == ["demo.rrd"]


def test_a_live_recording_has_its_name_when_its_first_row_stands(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    path.write_text("old")
    path.chmod(0o640)
    run = simulate(crane(), hold_controller(crane()), duration=0.02)
    with Live(crane(), "r", title="t", file=path):
        assert path.read_text() == "old"
    assert (path.read_text(), files(tmp_path)) == ("old", ["a.rrd"])
    with Live(crane(), "r", title="t", file=path) as live:
        live.append(run)
        recording.viewer.check_recording(path)
        first = path.stat()
        assert (files(tmp_path), first.st_mode & 0o777) == (["a.rrd"], 0o640)
        t = float(run.t[-1])
        start = run.state(-1)
        live.append(
            simulate(crane(), hold_controller(crane()), t_start=t, start=start, duration=0.02)
        )
    assert path.stat().st_ino == first.st_ino
    assert path.stat().st_size > first.st_size
