"""Files that are read whole and not endless, and written whole or not at all, alone or as a set."""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import secrets
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, Literal

from cranedyn.errors import DataError, quoted

MOST_TEXT = 5_000_000
"""Most bytes of a file that is read as text."""


def opened(path: str | Path) -> BinaryIO:
    """A file to read. Its size is known: pipes and devices, which may never end nor even begin, are
    refused at once.

    Raises:
        DataError: If it cannot be opened, or is no regular file.
    """
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            return open(path, "rb")
    except (OSError, ValueError) as error:
        raise DataError(
            f"Cannot read {path}: {getattr(error, 'strerror', None) or error}."
        ) from error
    raise DataError(
        f"Cannot read {path}: it is {'a folder' if stat.S_ISDIR(mode) else 'no file but a device'}."
    )


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
        DataError: If it cannot be read, is no regular file, is not text, or is larger than
            `MOST_TEXT`.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"Cannot read {path}: it is not text.") from error


def parse_json(text: str | bytes) -> Any:
    """What a JSON text says, if all numbers in it are finite.

    Raises:
        ValueError: If it is no JSON, or a number in it is not finite or too large for a double,
            such as 1e400.
    """
    return json.loads(
        text,
        parse_float=_finite,
        parse_constant=_finite,
        parse_int=lambda digits: int(digits) if _finite(digits) else 0,
    )


def _finite(digits: str) -> float:
    if not math.isfinite(number := float(digits)):
        raise ValueError(f"{quoted(digits)} is no finite number")
    return number


def write_text(path: str | Path, text: str) -> None:
    r"""Write a UTF-8 file.

    Bytes of names that are not UTF-8 become ``\udc80`` to ``\udcff``, which JSON reads back as they
    were.

    Raises:
        DataError: As `written`.
    """
    with written(path) as draft:
        draft.write_bytes(text.encode("utf-8", "backslashreplace"))


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits.

    Raises:
        OSError: If it cannot be read.
    """
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def make_folder(folder: Path) -> Path:
    """The folder, made if it is not there.

    Raises:
        DataError: If it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise DataError(
            f"Cannot make the folder {folder}: {getattr(error, 'strerror', None) or error}."
        ) from error
    return folder


@contextmanager
def reserved(folder: Path) -> Iterator[None]:
    """Have a folder for one writer at a time. It is made if it is not there, and removed at the end
    if it was made here and is empty.

    Raises:
        DataError: If another writer has it, or it cannot be made or opened.
    """
    missing = [one for one in (folder, *folder.parents) if not os.path.exists(one)]
    lock = _locked(folder)
    try:
        yield
    finally:
        try:
            remove_empty(missing)
        finally:
            os.close(lock)


def _locked(folder: Path) -> int:
    """A folder, open and locked; where the file system knows no locks, open."""
    while True:
        make_folder(folder)
        try:
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except FileNotFoundError:
            continue  # another writer has just removed it
        except OSError as error:
            raise DataError(f"Cannot write to {folder}: {error.strerror}.") from error
        outcome = flocked(lock, folder)
        if outcome in ("ours", "unknown"):
            return lock
        os.close(lock)
        if outcome == "taken":
            raise DataError(
                f"Cannot write to {folder}: another run is writing there; wait for it, or give "
                "another folder."
            )


def flocked(file: int, path: Path) -> Literal["ours", "taken", "gone", "unknown"]:
    """Lock what was opened at a path for this process, and say whether that is done.

    Args:
        file: Its descriptor; the lock goes with it.
        path: Its name.

    Returns:
        "ours" if it is locked now; "taken" if another process has it; "gone" if its name has come
        to stand for something else since it was opened; "unknown" where the file system knows no
        locks.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return "taken"
    except OSError:
        return "unknown"
    with suppress(FileNotFoundError):
        if os.path.samestat(os.fstat(file), os.stat(path)):
            return "ours"
    return "gone"


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove folders, the innermost first, as far as they are empty."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()


def check_writable(path: str | Path) -> None:
    """Return if a file can be written there, its folder made if need be, and a block of it has
    room; nothing is left behind.

    Raises:
        DataError: If it cannot.
    """
    final = Path(path)
    missing = [folder for folder in final.parents if not os.path.exists(folder)]
    try:
        make_folder(final.parent)
        draft = Draft(final)
        try:
            with _sentence(final):
                draft.path.write_bytes(bytes(4096))
        finally:
            draft.drop()
    finally:
        remove_empty(missing)


class Draft:
    """A file under a hidden name that cannot be guessed, of the same ending and folder, until it is
    whole and gets its own name.

    Attributes:
        path: Where to write, by opening that name or by the system's own means.
        final: The name it is to have.
    """

    def __init__(self, final: Path) -> None:
        """Make the file, empty, readable for nobody who may not read the one it is to replace.

        Raises:
            DataError: If something other than a file stands at the final name, or the system
                refuses.
        """
        with _sentence(final):
            self._mode = _mode(final)
            self.final = final
            self.path = final.with_name(
                f".{final.stem[:40]}.{secrets.token_hex(8)}{final.suffix[-20:]}"
            )
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
            try:
                self._file = os.fdopen(
                    os.open(self.path, flags, 0o666 if self._mode is None else 0o600 | self._mode),
                    "rb",
                )
            except KeyboardInterrupt:
                with suppress(OSError):
                    self.path.unlink()
                raise

    def sync(self) -> None:
        """Have all that was written, and the mode of the file it replaces, on the disk.

        Raises:
            DataError: If that fails, or another file stands in the place of the draft.
        """
        with _sentence(self.final):
            if not os.path.samestat(os.fstat(self._file.fileno()), self.path.lstat()):
                raise DataError(
                    f"Cannot write {self.final}: its draft {self.path} was moved or replaced."
                )
            if self._mode is not None:
                os.fchmod(self._file.fileno(), self._mode)
            os.fsync(self._file.fileno())

    def name(self) -> None:
        """Give it its final name; that this is on the disk, too, is for `sync_folder`.

        Raises:
            DataError: If the system refuses.
        """
        with _sentence(self.final):
            os.replace(self.path, self.final)
            self._file.close()

    def drop(self) -> None:
        """Remove it if it has not got its name."""
        if not self._file.closed:
            with suppress(OSError):
                self.path.unlink()
            self._file.close()


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk, where the file system can."""
    with suppress(OSError):
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(file)
        finally:
            os.close(file)


_SET: ContextVar[list[Draft] | None] = ContextVar("_SET", default=None)


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A path to write to, beside the final one; renamed to it at the end, removed if anything goes
    wrong.

    At the end the content is on the disk. Within `together`, the name waits for the others.

    Raises:
        DataError: If the folder does not exist, something other than a file stands there, or the
            system refuses to write.
    """
    final, others = Path(path), _SET.get()
    if not final.parent.is_dir():
        raise DataError(f"Cannot write {final}: the folder {final.parent} does not exist.")
    draft = Draft(final)
    try:
        with _sentence(final):
            yield draft.path
        draft.sync()
        if others is None:
            draft.name()
            sync_folder(final.parent)
        else:
            others.append(draft)
    except BaseException:
        draft.drop()
        raise


@contextmanager
def together() -> Iterator[list[Draft]]:
    """Files that are `written` in this context get their names when it ends, one right after the
    other, or none does if it breaks off.

    Yields:
        The drafts so far, each of them whole, in the order in which they were written.

    Raises:
        DataError: As `written`.
    """
    drafts: list[Draft] = []
    before = _SET.set(drafts)
    try:
        yield drafts
        for draft in drafts:
            draft.name()
        for folder in {draft.final.parent for draft in drafts}:
            sync_folder(folder)
    finally:
        _SET.reset(before)
        for draft in drafts:
            draft.drop()


def _mode(final: Path) -> int | None:
    """The permissions of the file that stands there, None if there is none."""
    if "\0" in str(final):
        raise DataError(f"Cannot write {final}: no name holds a NUL.")
    try:
        mode = final.stat().st_mode
    except FileNotFoundError:
        return None
    if not stat.S_ISREG(mode):
        raise DataError(
            f"Cannot write {final}: it is "
            f"{'a folder' if stat.S_ISDIR(mode) else 'no file but a device'}."
        )
    return mode & 0o777


@contextmanager
def _sentence(final: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DataError(f"Cannot write {final}: {error.strerror or error}.") from error
