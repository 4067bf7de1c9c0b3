"""Files are whole or not there; what goes wrong is one sentence that carries its numbers."""

from __future__ import annotations

import errno
import json
import math
import os
import pickle
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cranedyn.checks import number, within
from cranedyn.data.files import (
    atomic_write,
    atomic_write_set,
    check_writable,
    digest,
    lock_folder,
    read_text,
    write_text,
)
from cranedyn.errors import CraneError, DataError, OutOfRange, RunError, UnknownName
from cranedyn.plotting.figures import panels, save
from tests.helpers import files

# --- files ----------------------------------------------------------------------------------------


def test_a_file_appears_only_when_it_is_whole(tmp_path: Path) -> None:
    final = tmp_path / "a.csv"
    with atomic_write(final) as draft:
        draft.write_text("half")
        assert not final.exists()
        assert draft.parent == tmp_path  # beside, so that the renaming is one step
        assert draft.suffix == ".csv"  # writers choose the format by it
        draft.write_text("whole")
    assert final.read_text() == "whole"
    assert files(tmp_path) == ["a.csv"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, CraneError])
def test_nothing_is_left_behind_when_writing_breaks_off(
    tmp_path: Path, error: type[BaseException]
) -> None:
    (tmp_path / "a.csv").write_text("old")
    with pytest.raises(error), atomic_write(tmp_path / "a.csv") as draft:
        draft.write_text("half")
        raise error("stop")
    assert files(tmp_path) == ["a.csv"]
    assert (tmp_path / "a.csv").read_text() == "old"


def test_a_full_disk_is_a_sentence_and_leaves_nothing_behind(tmp_path: Path) -> None:
    with (
        pytest.raises(DataError, match=r"Cannot write .*a.csv: No space left on device\."),
        atomic_write(tmp_path / "a.csv") as draft,
    ):
        draft.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")
    assert files(tmp_path) == []


def test_a_missing_folder_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    with (
        pytest.raises(DataError, match=r"Cannot write .*: the folder .*missing does not exist"),
        atomic_write(tmp_path / "missing" / "a.csv"),
    ):
        pytest.fail("must not get here")


def test_a_folder_is_no_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(DataError, match="it is a folder"), atomic_write(tmp_path / "a.csv"):
        pytest.fail("must not get here")


@pytest.mark.slow
def test_a_figure_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    figure, axes = panels(2, 2)
    assert len(axes) == 4
    axes[0].plot([0, 1], [0, 1])
    assert save(figure, tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(DataError, match="does not exist"):
        save(figure, tmp_path / "missing" / "a.png")
    assert files(tmp_path) == ["a.png"]


def test_drafts_of_many_threads_with_names_alike_are_never_each_others(tmp_path: Path) -> None:
    def write(name: str) -> None:
        with atomic_write(tmp_path / name) as draft:
            draft.write_text(name[:60])
            draft.write_text(name)

    names = [f"{'a run with a name longer than forty letters ' * 3}{i}.csv" for i in range(48)]
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(write, names))
    assert files(tmp_path) == sorted(names)
    assert [name for name in names if (tmp_path / name).read_text() != name] == []


def test_a_draft_cannot_be_guessed_and_follows_no_link_that_stands_there_already(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drafts = []
    for _ in range(2):
        with atomic_write(tmp_path / "a.csv") as draft:
            drafts.append(draft.name)
    assert drafts[0] != drafts[1]
    assert min(len(name) for name in drafts) > len(".a..csv") + 15
    (tmp_path / "precious").write_text("precious")
    (tmp_path / f".a.{b'guessed'.hex()}.csv").symlink_to("precious")
    monkeypatch.setattr("os.urandom", lambda count: b"guessed")
    with (
        pytest.raises(DataError, match=r"Cannot write .*a\.csv: File exists"),
        atomic_write(tmp_path / "a.csv"),
    ):
        pytest.fail("must not get here")
    assert (tmp_path / "precious").read_text() == "precious"


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o755])
def test_a_file_keeps_the_mode_of_the_one_it_replaces_and_nobody_else_reads_its_draft(
    mode: int, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    write_text(path, "old")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~_umask()
    path.chmod(mode)
    with atomic_write(path) as draft:
        assert stat.S_IMODE(draft.stat().st_mode) & ~(mode | 0o600) == 0
        draft.write_text("new")
    assert (path.read_text(), stat.S_IMODE(path.stat().st_mode)) == ("new", mode)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_a_name_counts_when_content_and_folder_are_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    sync = os.fsync
    move = os.replace

    def synced(file: int) -> None:
        mode = os.fstat(file).st_mode
        seen.append("folder" if stat.S_ISDIR(mode) else f"file of {os.fstat(file).st_size} bytes")
        sync(file)

    monkeypatch.setattr("os.fsync", synced)
    monkeypatch.setattr("os.replace", lambda *paths: (seen.append("name"), move(*paths)))
    write_text(tmp_path / "a.csv", "four")
    assert seen == ["file of 4 bytes", "name", "folder"]
    seen.clear()
    with atomic_write_set():
        write_text(tmp_path / "a.csv", "four")
        write_text(tmp_path / "b.csv", "five!")
    assert seen == ["file of 4 bytes", "file of 5 bytes", "name", "name", "folder"]


def test_a_set_of_files_appears_together_or_not_at_all(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        write_text(tmp_path / name, "old")
    with pytest.raises(KeyboardInterrupt), atomic_write_set():
        write_text(tmp_path / "a.csv", "new")
        write_text(tmp_path / "c.csv", "new")
        raise KeyboardInterrupt
    assert {name: (tmp_path / name).read_text() for name in files(tmp_path)} == {
        "a.csv": "old",
        "b.csv": "old",
    }
    with atomic_write_set() as drafts:
        write_text(tmp_path / "a.csv", "new")
        write_text(tmp_path / "c.csv", "new")
        assert (tmp_path / "a.csv").read_text() == "old"
        assert not (tmp_path / "c.csv").exists()
        assert [draft.final.name for draft in drafts] == ["a.csv", "c.csv"]
        found = [digest(draft.path) for draft in drafts]
    assert files(tmp_path) == ["a.csv", "b.csv", "c.csv"]
    assert found == [digest(tmp_path / "a.csv"), digest(tmp_path / "c.csv")] == [found[0]] * 2
    write_text(tmp_path / "d.csv", "alone again")
    assert (tmp_path / "d.csv").exists()


def test_a_folder_has_one_writer_at_a_time_and_goes_if_it_stays_empty(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    for _ in range(2):
        with lock_folder(folder):
            with (
                pytest.raises(DataError, match="another run is writing there"),
                lock_folder(folder),
            ):
                pytest.fail("must not get here")
            with lock_folder(tmp_path / "c"):
                pass
        assert files(tmp_path) == []
    with lock_folder(folder):
        write_text(folder / "x", "x")
    assert files(tmp_path) == ["a", "a/b", "a/b/x"]


def test_a_name_with_a_nul_is_a_sentence(tmp_path: Path) -> None:
    name = str(tmp_path / "a\0b.csv")
    for use in (
        read_text,
        lambda path: write_text(path, "x"),
        lambda path: lock_folder(Path(path)).__enter__(),
    ):
        with pytest.raises(
            DataError, match=r"^Cannot (read|write|make).*(NUL|null (byte|character))( in path)?\.$"
        ):
            use(name)


def test_bytes_of_names_that_are_no_text_come_back_from_json(tmp_path: Path) -> None:
    name = os.fsdecode(b"a\xff\xe4b")
    write_text(tmp_path / "a.json", json.dumps({"name": name}, ensure_ascii=False))
    assert json.loads(read_text(tmp_path / "a.json")) == {"name": name}


def test_only_files_are_written_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with (
        pytest.raises(DataError, match="it is no file but a device"),
        atomic_write(tmp_path / "pipe"),
    ):
        pytest.fail("must not get here")
    with pytest.raises(DataError, match=r"/dev/null: it is no file but a device"):
        check_writable("/dev/null")
    assert not Path("/dev/null").is_file()
    assert not (tmp_path / "pipe").is_file()


@pytest.mark.parametrize("name", ["a" * 240 + ".csv", "ä" * 110 + ".csv"])
def test_a_name_as_long_as_the_system_allows_is_written(name: str, tmp_path: Path) -> None:
    with atomic_write(tmp_path / name) as draft:
        draft.write_text("x")
    assert files(tmp_path) == [name]


def test_whether_a_file_can_be_written_is_found_out_without_a_trace(tmp_path: Path) -> None:
    (tmp_path / "old.csv").write_text("old")
    for name in ("old.csv", "new.csv", "a/b/c/new.csv"):
        check_writable(tmp_path / name)
    with pytest.raises(DataError, match=r"Cannot make the folder .*Not a directory"):
        check_writable(tmp_path / "old.csv" / "x" / "new.csv")
    assert files(tmp_path) == ["old.csv"]
    assert (tmp_path / "old.csv").read_text() == "old"


# --- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "allowed", "result"),
    [
        (1, "any", 1.0),
        ("-2.5e3", "any", -2500.0),
        (0, ">= 0", 0.0),
        (1e-300, "> 0", 1e-300),
        (3, "3 to 4", 3.0),
        (np.float64(4), "3 to 4", 4.0),
    ],
)
def test_a_number_in_its_range_is_handed_back_as_a_float(
    value: object, allowed: str, result: float
) -> None:
    found = number("n", value, "m", allowed)
    assert (type(found), found) == (float, result)


@pytest.mark.parametrize(
    ("value", "allowed", "sentence"),
    [
        (math.nan, "any", "n is nan m; allowed is a finite number."),
        (-math.inf, "any", "n is -inf m; allowed is a finite number."),
        (math.nan, "> 0", "n is nan m; allowed is > 0."),
        (0.0, "> 0", "n is 0.0 m; allowed is > 0."),
        (-1e-9, ">= 0", "n is -1e-09 m; allowed is >= 0."),
        (math.inf, ">= 0", "n is inf m; allowed is >= 0."),
        (2.999, "3 to 4", "n is 2.999 m; allowed is 3 to 4."),
        (-4, "-3 to -1", "n is -4 m; allowed is -3 to -1."),
        ("many", "> 0", "n is many; allowed is a number > 0 [m]."),
        (None, "any", "n is None; allowed is a number [m]."),
    ],
)
def test_a_number_out_of_its_range_is_refused_with_value_unit_and_range(
    value: object, allowed: str, sentence: str
) -> None:
    with pytest.raises(OutOfRange) as caught:
        number("n", value, "m", allowed)
    assert str(caught.value) == sentence
    assert (caught.value.name, caught.value.unit) == ("n", "m")
    assert caught.value.value is value


def test_a_number_between_two_is_handed_back_and_any_other_refused_to_the_last_digit() -> None:
    low = 0.1
    high = 2 / 3
    assert [within("n", x, low, high) for x in (low, "0.2", high)] == [low, 0.2, high]
    for x, allowed in (
        (0.0, "0.1 to 0.666667"),
        (math.nextafter(high, 1.0), "0.1 to 0.6666666666666666"),
        (math.nan, "a finite number"),
    ):
        with pytest.raises(OutOfRange) as caught:
            within("n", x, low, high, "m")
        assert str(caught.value) == f"n is {x} m; allowed is {allowed}."


# --- errors ---------------------------------------------------------------------------------------


def test_every_error_is_a_crane_error_that_carries_its_values() -> None:
    unknown = UnknownName("drive", "y", ["x", "l"])
    assert str(unknown) == "There is no drive 'y'; there are x, l."
    assert (unknown.given, unknown.known) == ("y", ("x", "l"))
    broken = RunError("It broke.", t=1.5, joint="yaw_joint", value=7.0)
    attributes = str(broken), broken.t, broken.joint, broken.value, broken.trajectory
    assert attributes == ("It broke.", 1.5, "yaw_joint", 7.0, None)
    for error in (unknown, broken, OutOfRange("a", 1, "> 2"), DataError("x")):
        assert isinstance(error, CraneError)


def test_an_error_is_one_printable_line_of_bounded_length_whatever_it_quotes() -> None:
    for error in (
        DataError("a\nb\x1b[31m\udcff\u2028c" + "x" * 10**6),
        OutOfRange("n\r", "1\n2", "> 0"),
    ):
        assert str(error).isprintable()
        assert len(str(error)) < 2100


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
