"""What is allowed: whole numbers, and sizes that fit the memory and the disk."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

from cranedyn.checks import number
from cranedyn.errors import DataError, OutOfRange


def whole(name: str, value: object, least: int, most: float = math.inf) -> int:
    """The value as a whole number.

    Raises:
        OutOfRange: If it is none, or not from least to most.
    """
    x = number(name, value)
    if x != int(x) or not least <= x <= most:
        raise OutOfRange(
            name, value, f"a whole number from {least}" + (f" to {most}" if most < math.inf else "")
        )
    return int(x)


def memory() -> int:
    """Bytes that a table may take: half of what this machine has."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2


def check_memory(what: str, needed: float) -> None:
    """Return if a table fits.

    Raises:
        DataError: If it does not, with both sizes.
    """
    if needed > (allowed := memory()):
        raise DataError(
            f"{what} would take {needed / 1e9:.3g} GB of memory; allowed are {allowed / 1e9:.3g} "
            "GB, half of what there is."
        )


def check_disk(folder: Path, cases: int, width: float) -> None:
    """Return if results to come fit the disk.

    Args:
        folder: Where they shall be.
        cases: How many are to come.
        width: Bytes of each.

    Raises:
        DataError: If they do not, with both sizes.
    """
    needed, free = cases * width, shutil.disk_usage(folder).free
    if needed > free:
        raise DataError(
            f"The results of {cases} cases would take {needed / 1e9:.3g} GB; {free / 1e9:.3g} GB "
            f"are free in {folder}."
        )
