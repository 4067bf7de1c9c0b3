"""Files that are either whole or not there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cranedyn.errors import DataError


@contextmanager
def written(path: str | Path) -> Iterator[Path]:
    """A path to write to, beside the final one; renamed to it at the end, removed if anything goes wrong.

    Raises:
        DataError: If the folder does not exist or the system refuses to write.
    """
    final = Path(path)
    if not final.parent.is_dir():
        raise DataError(f"Cannot write {final}: the folder {final.parent} does not exist.")
    if final.is_dir():
        raise DataError(f"Cannot write {final}: it is a folder.")
    draft = final.with_name(f".{final.stem}.{os.getpid()}{final.suffix}")
    try:
        yield draft
        os.replace(draft, final)
    except OSError as error:
        raise DataError(f"Cannot write {final}: {error.strerror or error}.") from error
    finally:
        draft.unlink(missing_ok=True)
