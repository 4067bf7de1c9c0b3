"""Files that are read whole and not endless, and written whole or not at all."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from cranedyn.errors import DataError

MOST_TEXT = 5_000_000
"""Most bytes of a file that is read as text."""


def opened(path: str | Path) -> BinaryIO:
    """A file to read. Its size is known: pipes and devices, which may never end nor even begin, are refused at once.

    Raises:
        DataError: If it cannot be opened, or is no regular file.
    """
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            return open(path, "rb")
    except (OSError, ValueError) as error:
        raise DataError(f"Cannot read {path}: {getattr(error, 'strerror', None) or error}.") from error
    raise DataError(f"Cannot read {path}: it is {'a folder' if stat.S_ISDIR(mode) else 'no file but a device'}.")


def read_bytes(path: str | Path, most: int = MOST_TEXT) -> bytes:
    """What stands in a file.

    Args:
        path: The file.
        most: How many bytes it may hold.

    Raises:
        DataError: If it cannot be read, is no regular file, or is larger.
    """
    with opened(path) as file:
        try:
            content = file.read(most + 1) if os.fstat(file.fileno()).st_size <= most else None
        except OSError as error:
            raise DataError(f"Cannot read {path}: {error.strerror}.") from error
    if content is None or len(content) > most:
        raise DataError(f"Cannot read {path}: it is larger than {most / 1e6:g} MB.")
    return content


def read_text(path: str | Path) -> str:
    """The text of a UTF-8 file.

    Raises:
        DataError: If it cannot be read, is no regular file, is not text, or is larger than `MOST_TEXT`.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error


def make_folder(folder: Path) -> Path:
    """The folder, made if it is not there.

    Raises:
        DataError: If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise DataError(f"Cannot make the folder {folder}: {getattr(error, 'strerror', None) or error}.") from error
    return folder


def check_writable(path: str | Path) -> None:
    """Return if a file can be written there, its folder made if need be, and a block of it has room; nothing is left behind.

    Raises:
        DataError: If it cannot.
    """
    final = Path(path)
    with _sentence(final):
        missing = [folder for folder in final.parents if not folder.exists()]
        try:
            make_folder(final.parent)
            draft = _draft(final)
            try:
                draft.write_bytes(bytes(4096))
            finally:
                with suppress(OSError):
                    draft.unlink()
        finally:
            for folder in missing:
                with suppress(OSError):
                    folder.rmdir()


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A path to write to, beside the final one; renamed to it at the end, removed if anything goes wrong.

    Raises:
        DataError: If the folder does not exist, something other than a file stands there, or the system refuses to write.
    """
    final = Path(path)
    with _sentence(final):
        if not final.parent.is_dir():
            raise DataError(f"Cannot write {final}: the folder {final.parent} does not exist.")
        draft = _draft(final)
        try:
            yield draft
            os.replace(draft, final)
        finally:
            with suppress(OSError):
                draft.unlink()


def _draft(final: Path) -> Path:
    """Where to write before the renaming: hidden, of the same ending, under a name that is short enough."""
    with suppress(FileNotFoundError):
        mode = final.stat().st_mode
        if not stat.S_ISREG(mode):
            raise DataError(f"Cannot write {final}: it is {'a folder' if stat.S_ISDIR(mode) else 'no file but a device'}.")
    return final.with_name(f".{final.stem[:40]}.{os.getpid()}{final.suffix}")


@contextmanager
def _sentence(final: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DataError(f"Cannot write {final}: {error.strerror or error}.") from error
