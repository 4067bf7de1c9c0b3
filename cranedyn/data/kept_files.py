"""Files kept for later processes: what takes long to make and is the same whenever it is made, such
as compiled code.

They are in the user's cache folder, or in the folder that the environment variable
`CRANEDYN_CACHE` names; with ``CRANEDYN_CACHE=off`` nothing is kept. The folder may be removed at
any time: whatever is missing is made again.

Some of them are machine code, which this process runs. So they are read only where nobody but this
user, or the administrator of the machine, can write: neither in the file, nor in its folder, nor in
a folder above. Where somebody else can, nothing is kept. A file begins with a digest of its name
and content, so that one that is damaged, cut off or renamed counts as missing.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

VARIABLE = "CRANEDYN_CACHE"
"""Name of the environment variable that names the folder, or turns it off."""

OFF = "off"
"""Value of that variable with which nothing is kept."""

MAX_AGE_DAYS = 30.0
"""Days after which a file that nothing has read is removed."""

MAX_TOTAL_SIZE = 256_000_000
"""Size of all files above which those that were read longest ago are removed [byte]. The code of a
crane has ten to a hundred kilobytes."""

_TIDYING_INTERVAL = 86400.0
"""Time after which the folder is looked through again [s]."""

_TIDYING_SIZE = MAX_TOTAL_SIZE // 4
"""Size of the files that one process writes before it looks through the folder [byte]."""

_USE_RESOLUTION = 3600.0
"""Time within which a file that is read again is not marked as used again [s]."""

_TIDIED = "tidied"
"""Name of the empty file whose time says when the folder was last looked through."""

_DIGEST_SIZE = hashlib.sha256().digest_size


def digest_of_parts(*parts: str | bytes) -> str:
    """Return a digest of some texts in hexadecimal digits, which also tells where one ends and the
    next begins: the name of a file that depends on them and on nothing else.
    """
    digest = hashlib.sha256()
    for part in parts:
        content = part.encode() if isinstance(part, str) else part
        digest.update(b"%d:" % len(content))
        digest.update(content)
    return digest.hexdigest()


def read_kept(name: str) -> bytes | None:
    """Return the content that was kept under a name; None if there is none, or it is damaged.

    Args:
        name: Digest of all that the content depends on, see `digest_of_parts`.
    """
    folder = _folder(os.environ.get(VARIABLE, ""))
    if folder is None or not is_guarded(folder):
        return None
    try:
        content = _read_own(folder / name)
    except OSError:
        return None
    digest = content[:_DIGEST_SIZE]
    content = content[_DIGEST_SIZE:]
    return content if digest == _seal(name, content) else None


def keep(name: str, content: bytes) -> None:
    """Keep a content under a name, if that is possible.

    Another process never sees a part of it, since it is written beside and renamed. A process that
    is writing the same at the same time writes the same bytes.

    Args:
        name: Digest of all that the content depends on, see `digest_of_parts`.
        content: The content.
    """
    folder = _folder(os.environ.get(VARIABLE, ""))
    # Without the folder, or on a full disk, the next process makes it again.
    with contextlib.suppress(OSError):
        if folder is None or not _make_guarded(folder):
            return
        draft = folder / f"{name}.{os.urandom(8).hex()}"
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
            with open(os.open(draft, flags, 0o600), "wb") as file:
                file.write(_seal(name, content) + content)
            draft.replace(folder / name)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
        _tidy_at_times(folder, len(content))


@lru_cache(maxsize=8)
def _folder(value: str) -> Path | None:
    """Return the folder for a value of the environment variable; None to keep nothing, as where a
    system does not tell who owns a file.
    """
    if value == OFF or not hasattr(os, "getuid"):
        return None
    if value:
        return Path(value).absolute()
    import platformdirs  # it is needed only where the variable names no folder

    return platformdirs.user_cache_path("cranedyn", appauthor=False).absolute()


def _seal(name: str, content: bytes) -> bytes:
    """Return the digest with which a file begins."""
    return bytes.fromhex(digest_of_parts(name, content))


def _read_own(path: Path) -> bytes:
    """Return the content of a file of this user, and mark it as used.

    Raises:
        OSError: If it cannot be read, or somebody else can write it.
    """
    with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or not _only_owner_writes(status):
            raise PermissionError(f"{path} can be written by others")
        if time.time() - status.st_mtime > _USE_RESOLUTION:
            # A folder may be there to be read only.
            with contextlib.suppress(OSError):
                os.utime(file.fileno())
        return file.read()


def _only_owner_writes(status: os.stat_result) -> bool:
    """Return whether nobody but this user and the administrator may write to what has a status."""
    return status.st_uid in (os.getuid(), 0) and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def is_guarded(folder: Path) -> bool:
    """Return whether a folder is there in which nobody else can put, replace or rename a file.

    Whoever can write to a folder above could put another folder in its place, except where only
    owners can rename, as in /tmp.
    """
    try:
        if not _only_owner_writes(folder.stat()):
            return False
        for path in (*folder.parents, *folder.resolve().parents):
            status = path.stat()
            kept_by_owners = bool(status.st_mode & stat.S_ISVTX) and status.st_uid in (
                os.getuid(),
                0,
            )
            if not _only_owner_writes(status) and not kept_by_owners:
                return False
    except OSError:
        return False
    return True


def _make_guarded(folder: Path) -> bool:
    """Make a folder that only this user can read and write, if it is not there, and return whether
    it is guarded, see `is_guarded`.
    """
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
    return is_guarded(folder)


_written = 0
"""Size of the files that this process has written since it looked through the folder [byte]."""


def _tidy_at_times(folder: Path, size: int) -> None:
    """Remove what is too old or too much, if the folder has not been looked through for a day, or
    this process has written much since.

    Args:
        folder: The folder.
        size: Size of the file that was written last [byte].
    """
    global _written
    _written += size
    mark = folder / _TIDIED
    try:
        is_due = time.time() - mark.stat().st_mtime > _TIDYING_INTERVAL
    except FileNotFoundError:
        is_due = True
    if is_due or _written > _TIDYING_SIZE:
        _written = 0
        mark.touch(mode=0o600)
        tidy(folder)


def tidy(folder: Path) -> None:
    """Remove the files of a folder that nothing has read for `MAX_AGE_DAYS`, then those that were
    read longest ago until all together are within `MAX_TOTAL_SIZE`.
    """
    last = time.time() - 86400.0 * MAX_AGE_DAYS
    total = 0
    newest_first = sorted(_files(folder), key=lambda file: file[1].st_mtime, reverse=True)
    for path, status in newest_first:
        total += status.st_size
        if status.st_mtime < last or total > MAX_TOTAL_SIZE:
            # Another process may remove it at the same time.
            with contextlib.suppress(OSError):
                path.unlink()


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield the files that are kept in a folder, also such as were not finished. Their names begin
    with a digest: nothing else in the folder is removed.
    """
    for entry in os.scandir(folder):
        name = entry.name.partition(".")[0]
        is_digest = len(name) == 2 * _DIGEST_SIZE and not set(name) - set("0123456789abcdef")
        if is_digest and entry.is_file(follow_symlinks=False):
            with contextlib.suppress(FileNotFoundError):
                yield Path(entry.path), entry.stat(follow_symlinks=False)
