"""Files that are kept for later processes, and when they are not read."""

from __future__ import annotations

import multiprocessing
import os
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from cranedyn.data import kept_files
from cranedyn.data.kept_files import digest_of_parts, keep, read_kept

NAME = digest_of_parts("a name")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which files are kept, which is not there yet."""
    folder = tmp_path / "cache" / "cranedyn"
    monkeypatch.setenv(kept_files.VARIABLE, str(folder))
    return folder


def names(folder: Path) -> set[str]:
    """Names of the files that are kept in a folder."""
    return {path.name for path in folder.iterdir()} - {"tidied"}


def test_what_was_kept_is_read_by_its_name_and_is_nobody_elses_business(folder: Path) -> None:
    assert read_kept(NAME) is None
    keep(NAME, b"content")
    assert read_kept(NAME) == b"content"
    assert read_kept(digest_of_parts("another name")) is None
    assert folder.stat().st_mode & 0o777 == 0o700
    assert (folder / NAME).stat().st_mode & 0o777 == 0o600


def test_by_default_the_folder_is_that_of_the_user(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(kept_files.VARIABLE)
    kept_files._folder.cache_clear()
    monkeypatch.setattr("platformdirs.user_cache_path", lambda name, **_: tmp_path / name)
    try:
        keep(NAME, b"content")
        assert names(tmp_path / "cranedyn") == {NAME}
    finally:
        kept_files._folder.cache_clear()


def test_a_digest_tells_where_a_part_ends() -> None:
    assert digest_of_parts("ab", "c") != digest_of_parts("a", "bc")
    assert digest_of_parts("ab") != digest_of_parts("ab", "")
    assert digest_of_parts("ä") == digest_of_parts("ä".encode())


def test_a_file_that_is_damaged_cut_off_or_renamed_counts_as_missing(folder: Path) -> None:
    keep(NAME, b"content")
    file = folder / NAME
    whole = file.read_bytes()
    for i in range(len(whole)):
        file.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        assert read_kept(NAME) is None
        file.write_bytes(whole[:i])
        assert read_kept(NAME) is None
    other = digest_of_parts("another name")
    (folder / other).write_bytes(whole)
    assert read_kept(other) is None
    keep(NAME, b"content")
    assert read_kept(NAME) == b"content"


def test_nothing_is_read_or_written_where_others_can_write(folder: Path) -> None:
    keep(NAME, b"content")
    other = digest_of_parts("another name")
    for place in (folder / NAME, folder, folder.parent):
        mode = place.stat().st_mode
        for writable in (0o020, 0o002):
            place.chmod(mode | writable)
            assert read_kept(NAME) is None
            if place.is_dir():
                keep(other, b"content")
                assert names(folder) == {NAME}
        place.chmod(mode)
        assert read_kept(NAME) == b"content"


def test_a_folder_above_in_which_only_owners_rename_will_do(folder: Path) -> None:
    keep(NAME, b"content")
    folder.parent.chmod(0o1777)
    assert read_kept(NAME) == b"content"
    folder.chmod(0o1777)
    assert read_kept(NAME) is None


@pytest.mark.skipif(os.getuid() != 0, reason="only the administrator can give files away")
def test_files_and_folders_of_others_are_not_read(folder: Path) -> None:
    keep(NAME, b"content")
    for place in (folder / NAME, folder, folder.parent):
        os.chown(place, 12345, -1)
        assert read_kept(NAME) is None
        os.chown(place, 0, -1)
        assert read_kept(NAME) == b"content"


def test_what_a_link_leads_to_is_not_read(folder: Path, tmp_path: Path) -> None:
    keep(NAME, b"content")
    elsewhere = tmp_path / "elsewhere"
    (folder / NAME).rename(elsewhere)
    (folder / NAME).symlink_to(elsewhere)
    assert read_kept(NAME) is None


def test_a_folder_through_a_link_counts_where_it_leads(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "link"
    link.symlink_to(folder)
    keep(NAME, b"content")
    monkeypatch.setenv(kept_files.VARIABLE, str(link))
    assert read_kept(NAME) == b"content"
    folder.parent.chmod(0o777)
    assert read_kept(NAME) is None


def test_a_pipe_in_the_place_of_a_file_is_not_waited_for(folder: Path) -> None:
    keep(NAME, b"content")
    (folder / NAME).unlink()
    os.mkfifo(folder / NAME, 0o600)
    assert read_kept(NAME) is None


def test_where_nothing_can_be_written_nothing_is_kept_and_nothing_is_left(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(NAME, b"content")

    def full(*_: object) -> None:
        raise OSError("No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    keep(digest_of_parts("another name"), b"content")
    assert names(folder) == {NAME}
    monkeypatch.setenv(kept_files.VARIABLE, str(folder / NAME / "below"))
    keep(NAME, b"content")
    assert read_kept(NAME) is None


def test_off_keeps_nothing(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep(NAME, b"content")
    monkeypatch.setenv(kept_files.VARIABLE, kept_files.OFF)
    assert read_kept(NAME) is None


def keep_often(_: int) -> bool:
    """Keep and read the same file again and again; whether it was always whole."""
    content = b"content" * 100_000
    for _ in range(30):
        keep(NAME, content)
        if read_kept(NAME) != content:
            return False
    return True


def test_processes_that_keep_the_same_file_at_once_see_it_whole(folder: Path) -> None:
    keep(NAME, b"content" * 100_000)
    with ProcessPoolExecutor(3, multiprocessing.get_context("spawn")) as pool:
        assert all(pool.map(keep_often, range(3)))
    assert names(folder) == {NAME}


def age(path: Path, days: float) -> None:
    """Let a file have been read so many days ago."""
    before = time.time() - 86400.0 * days
    os.utime(path, (before, before))


def test_what_was_not_read_for_long_is_removed_and_foreign_files_are_not(folder: Path) -> None:
    used = digest_of_parts("used")
    unfinished = f"{digest_of_parts('unfinished')}.0123"
    for name in (NAME, used):
        keep(name, b"content")
    (folder / unfinished).touch()
    (folder / "thesis.txt").touch()
    for path in folder.iterdir():
        age(path, kept_files.MAX_AGE_DAYS + 1.0)
    assert read_kept(used) == b"content"
    # The folder was last looked through long ago.
    keep(digest_of_parts("new"), b"content")
    assert names(folder) == {used, digest_of_parts("new"), "thesis.txt"}


def test_what_was_read_longest_ago_is_removed_where_all_is_too_much(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept_files, "MAX_TOTAL_SIZE", 2500)
    monkeypatch.setattr(kept_files, "_TIDYING_SIZE", 500)
    monkeypatch.setattr(kept_files, "_written", 0)
    for i in range(4):
        keep(digest_of_parts(str(i)), b"x" * 1000)
        age(folder / digest_of_parts(str(i)), 0.9 - 0.2 * i)
        assert read_kept(digest_of_parts("0")) is not None or i >= 3
    assert read_kept(digest_of_parts("1")) is None
    assert read_kept(digest_of_parts("3")) is not None
