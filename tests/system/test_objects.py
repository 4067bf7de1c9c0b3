"""What the processes of a test run share, see `tests.objects`."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from cranedyn.data import kept_files
from tests import objects


def test_what_was_made_once_is_not_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(objects.FOLDER, str(tmp_path))
    made: list[Path] = []

    def make(file: Path) -> None:
        made.append(file)
        file.write_text("content")

    file = objects.made_once("name", make)
    assert objects.made_once("name", make) == file
    assert file.read_text() == "content"
    assert len(made) == 1
    assert os.path.dirname(file) == str(tmp_path)


def test_what_no_run_has_used_for_long_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(objects.FOLDER, str(tmp_path))
    objects.made_once("used", Path.touch)
    (tmp_path / "unused").touch()
    long_ago = time.time() - 86400.0 * (objects.UNUSED_DAYS + 1.0)
    for file in tmp_path.iterdir():
        os.utime(file, (long_ago, long_ago))
    objects.made_once("used", Path.touch)
    objects.forget_unused(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == {"used", "used.lock"}


def test_a_folder_to_which_others_may_write_is_not_private(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    assert kept_files.is_guarded(tmp_path)
    tmp_path.chmod(0o777)
    assert not kept_files.is_guarded(tmp_path)
