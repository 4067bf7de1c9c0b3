"""Target of an export: a new folder or file, written completely or not at all, and what is said of
what is written.
"""

from __future__ import annotations

import os
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cranedyn.data.files import atomic_write, check_writable, sync_folder
from cranedyn.dynamics.converters import default_rates
from cranedyn.errors import DataError
from cranedyn.model.crane import Crane


def name_default_rates(crane: Crane) -> None:
    """Print a line to standard error for each drive whose converter has a default rate, since
    whoever gets the export would take it for that of the crane.
    """
    for sentence in default_rates(crane):
        print(sentence, file=sys.stderr)


def check_free(target: Path) -> None:
    """Check that a target can be created.

    Raises:
        DataError: If the target exists, or its folder does not.
    """
    if "\0" in str(target):
        raise DataError(f"Cannot write {target}: no name holds a NUL.")
    if os.path.lexists(target):
        raise DataError(f"Cannot write {target}: it is there already; name another, or remove it.")
    if not target.absolute().parent.is_dir():
        raise DataError(
            f"Cannot write {target}: the folder {target.absolute().parent} does not exist."
        )


def check_new_folder(target: Path) -> None:
    """Check that a folder can be created and a file written into it, and create the folders above
    it: for work that takes long and is written at its end.

    Raises:
        DataError: If the target exists, or the system refuses.
    """
    above = target.absolute().parent
    try:
        above.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DataError(f"Cannot write {target}: {reason}.") from error
    check_free(target)
    check_writable(target)


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a folder to fill, beside the final one; it is renamed at the end, and removed on an
    error.

    Raises:
        DataError: As `check_free`, or if the system refuses.
    """
    check_free(target)
    draft = target.absolute().with_name(f".{target.name[:40]}.{secrets.token_hex(8)}")
    try:
        draft.mkdir()
        yield draft
        check_free(target)
        draft.rename(target)
        sync_folder(target.absolute().parent)
    except OSError as error:
        raise DataError(f"Cannot write {target}: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


@contextmanager
def new_file(target: Path) -> Iterator[Path]:
    """Yield a file to write, as `cranedyn.data.files.atomic_write`; the target must not exist.

    Raises:
        DataError: As `check_free` and `atomic_write`.
    """
    check_free(target)
    with atomic_write(target) as draft:
        yield draft
