"""Files: read up to a bound, written whole or not at all, alone or as a set."""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import BufferedReader
from pathlib import Path
from typing import Any

from cranedyn.errors import DataError, decimal_comma, quoted

MOST_TEXT = 5_000_000
"""Largest file that is read as text [byte]."""


# --- reading --------------------------------------------------------------------------------------


def open_file(path: str | Path) -> BufferedReader:
    """Open a regular file to read; pipes and devices, which may never end, are refused.

    Raises:
        DataError: If it cannot be opened, or is no regular file.
    """
    with _as_data_error("read", path):
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            return open(path, "rb")
    raise DataError(f"Cannot read {path}: it is {_kind(mode)}.")


def read_bytes(path: str | Path, limit: int = MOST_TEXT) -> bytes:
    """Return the content of a file of at most so many bytes.

    Raises:
        DataError: If it cannot be read, is no regular file, or is larger.
    """
    with open_file(path) as file, _as_data_error("read", path):
        content = file.read(limit + 1) if os.fstat(file.fileno()).st_size <= limit else None
    if content is None or len(content) > limit:
        raise DataError(f"Cannot read {path}: it is larger than {limit / 1e6:g} MB.")
    return content


def read_text(path: str | Path) -> str:
    """Return the text of a UTF-8 file of at most `MOST_TEXT` bytes.

    Raises:
        DataError: As `read_bytes`, or if it is not text.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error


def parse_json(text: str | bytes) -> Any:
    """Parse a JSON text in which all numbers are finite.

    Raises:
        ValueError: If it is no JSON, or a number is not finite or too large for a double, such as
            1e400.
    """
    return json.loads(text, parse_float=_finite, parse_constant=_finite, parse_int=_finite_integer)


def parse_toml(text: str, path: str | Path) -> dict[str, Any]:
    """Parse a TOML text.

    Args:
        text: The text.
        path: Its file, for the error message.

    Raises:
        DataError: If it is no TOML, with the line, and what to write instead of a decimal comma.
    """
    import tomllib  # it takes long, and few runs need it

    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        advice = _advice_on_comma(text, str(error))
        raise DataError(f"{path} is not TOML: {error}.{advice}") from error


def _advice_on_comma(text: str, message: str) -> str:
    """Return what to write instead of a decimal comma in the line of a TOML text that a message of
    its parser names; empty if it names none, or there is no such comma.
    """
    place = _TOML_LINE.search(message)
    if place is None:
        return ""
    lines = text.splitlines()
    index = int(place[1]) - 1
    if index >= len(lines):  # the error is at the end of the text
        return ""
    number = _TOML_NUMBER.fullmatch(lines[index])
    return "" if number is None else decimal_comma(number[1])


_TOML_LINE = re.compile(r"\(at line (\d+), column \d+\)")
"""Where the parser of TOML says that it failed."""

_TOML_NUMBER = re.compile(r"\s*[\w.-]+\s*=\s*([+-]?\d+,\d+)\s*(?:#.*)?")
"""A line of TOML with a decimal comma."""


def _finite(digits: str) -> float:
    """Return the number of some digits, or of a word such as NaN.

    Raises:
        ValueError: If it is not finite, or too large for a double.
    """
    number = float(digits)
    if not math.isfinite(number):
        raise ValueError(f"{quoted(digits)} is no finite number")
    return number


def _finite_integer(digits: str) -> int:
    """Return the whole number of some digits.

    Raises:
        ValueError: If it is too large for a double.
    """
    _finite(digits)
    return int(digits)


def digest(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal digits.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# --- folders --------------------------------------------------------------------------------------


def make_folder(folder: Path) -> Path:
    """Make a folder if it is not there, and return it.

    Raises:
        DataError: If it cannot be made.
    """
    with _as_data_error("make the folder", folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove those folders that are empty, in the order given."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Make a folder if it is not there and lock it for this process; remove it at the end if it was
    made here and is empty.

    Raises:
        DataError: If another process has locked it, or it cannot be made or opened.
    """
    missing = [path for path in (folder, *folder.parents) if not os.path.exists(path)]
    make_folder(folder)
    with _as_data_error("write to", folder):
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with suppress(OSError):  # a file system without locks
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise DataError(
                    f"Cannot write to {folder}: another run is writing there; wait for it, or give "
                    "another folder."
                ) from None
        yield
    finally:
        remove_empty(missing)
        os.close(lock)


def sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk, where the file system can."""
    with suppress(OSError):
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(file)
        finally:
            os.close(file)


# --- writing --------------------------------------------------------------------------------------


class Draft:
    """A file under a hidden name that cannot be guessed, beside its final name and of the same
    ending.

    Attributes:
        path: Where to write.
        final: The name it is to have.
    """

    def __init__(self, final: Path) -> None:
        """Create the file, empty, with the permissions of the file that it is to replace.

        Raises:
            DataError: If something other than a file has the final name, or the system refuses.
        """
        self.final = final
        self._mode: int | None = None  # of the file that it is to replace
        with _as_data_error("write", final):
            with suppress(FileNotFoundError):
                self._mode = final.stat().st_mode
            if self._mode is not None and not stat.S_ISREG(self._mode):
                raise DataError(f"Cannot write {final}: it is {_kind(self._mode)}.")
            # Stem and ending are cut so that the name is not longer than a file system allows.
            token = os.urandom(8).hex()
            self.path = final.with_name(f".{final.stem[:40]}.{token}{final.suffix[-20:]}")
            # A new file gets the permissions that the umask of the process allows. One that takes
            # the place of another gets those of that file at the end, see `sync`; until then its
            # owner can write it in any case.
            mode = 0o666 if self._mode is None else 0o600 | stat.S_IMODE(self._mode)
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
            os.close(os.open(self.path, flags, mode))

    def sync(self) -> None:
        """Flush content and permissions to the disk.

        Raises:
            DataError: If that fails.
        """
        with _as_data_error("write", self.final), self.path.open("rb") as file:
            if self._mode is not None:
                os.fchmod(file.fileno(), stat.S_IMODE(self._mode))
            os.fsync(file.fileno())

    def name(self) -> None:
        """Give it its final name; `sync_folder` flushes the name to the disk.

        Raises:
            DataError: If the system refuses.
        """
        with _as_data_error("write", self.final):
            os.replace(self.path, self.final)

    def drop(self) -> None:
        """Remove it if it does not have its final name."""
        with suppress(OSError):
            self.path.unlink()


_DRAFT_SET: ContextVar[list[Draft] | None] = ContextVar("_DRAFT_SET", default=None)
"""Drafts of the present `atomic_write_set`; None outside of one."""


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; at the end flush that file to the disk and rename
    it to the final path, or remove it after an error.

    Within `atomic_write_set`, the renaming waits for the other files.

    Raises:
        DataError: If the folder does not exist, something other than a file stands there, or the
            system refuses to write.
    """
    final = Path(path)
    drafts = _DRAFT_SET.get()
    if not final.parent.is_dir():
        raise DataError(f"Cannot write {final}: the folder {final.parent} does not exist.")
    draft = Draft(final)
    try:
        with _as_data_error("write", final):
            yield draft.path
        draft.sync()
        if drafts is None:
            draft.name()
            sync_folder(final.parent)
        else:
            drafts.append(draft)
    except BaseException:
        draft.drop()
        raise


@contextmanager
def atomic_write_set() -> Iterator[list[Draft]]:
    """Rename the files of every `atomic_write` in this context at its end, one right after the
    other, or remove all of them after an error.

    Yields:
        The drafts so far, each of them whole, in the order of writing.

    Raises:
        DataError: As `atomic_write`.
    """
    drafts: list[Draft] = []
    token = _DRAFT_SET.set(drafts)
    try:
        yield drafts
        for draft in drafts:
            draft.name()
        for folder in {draft.final.parent for draft in drafts}:
            sync_folder(folder)
    finally:
        _DRAFT_SET.reset(token)
        for draft in drafts:
            draft.drop()


def with_ending(path: str | Path, *endings: str) -> Path:
    """Return a path that has one of some endings, such as ".mp4".

    Raises:
        DataError: If it has another.
    """
    path = Path(path)
    if path.suffix not in endings:
        raise DataError(f"Cannot write {path}: the ending must be {' or '.join(endings)}.")
    return path


def write_text(path: str | Path, text: str) -> None:
    r"""Write a UTF-8 file by `atomic_write`.

    Bytes of file names that are not UTF-8 become ``\udc80`` to ``\udcff``, which JSON reads back.

    Raises:
        DataError: As `atomic_write`.
    """
    with atomic_write(path) as draft:
        draft.write_bytes(text.encode("utf-8", "backslashreplace"))


def check_writable(path: str | Path) -> None:
    """Check that a file can be written there, by writing a block and removing it, with any folders
    that this needs.

    Raises:
        DataError: If it cannot.
    """
    final = Path(path)
    missing = [folder for folder in final.parents if not os.path.exists(folder)]
    try:
        make_folder(final.parent)
        draft = Draft(final)
        try:
            with _as_data_error("write", final):
                draft.path.write_bytes(bytes(4096))
        finally:
            draft.drop()
    finally:
        remove_empty(missing)


def _kind(mode: int) -> str:
    """Return what something is that is no regular file, by its mode."""
    return "a folder" if stat.S_ISDIR(mode) else "no file but a device"


@contextmanager
def _as_data_error(action: str, path: str | Path) -> Iterator[None]:
    """Turn errors of the system over a path into a `DataError` that it cannot do an action."""
    try:
        yield
    except (OSError, ValueError) as error:
        # The system refuses a path with a zero byte by a ValueError; any other one is not about
        # the path.
        if isinstance(error, ValueError) and "\0" not in str(path):
            raise
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"Cannot {action} {path}: {reason}.") from error
