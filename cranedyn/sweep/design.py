"""Designs: tables of cases, made as grids, as points that fill a box, and as products of both."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number, whole, within
from cranedyn.errors import CraneError, DataError, OutOfRange, shown

RESERVED = ("case", "error")
"""Columns of every table of results that no parameter and no result may be called."""

Values = Sequence[float] | Sequence[str] | np.ndarray | float | str
"""Values of a parameter: numbers or words, several or one."""


@dataclass(frozen=True, eq=False)
class Design:
    """Table of cases, one per row.

    Attributes:
        columns: Values by parameter, finite numbers or printable words, shape (n,) each. They are
            copied and read-only.

    Raises:
        CraneError: If there is no column or no row, columns differ in length, a name is empty or
            one of `RESERVED`, or a value is neither a finite number nor a printable word.
    """

    columns: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        """Check and freeze the columns."""
        columns = {name: _column(name, values) for name, values in self.columns.items()}
        lengths = {len(values) for values in columns.values()}
        if len(lengths) != 1 or lengths == {0}:
            counts = ", ".join(f"{name} has {len(values)}" for name, values in columns.items())
            raise DataError(
                "A design needs columns of one length, with a case at least; "
                f"{counts or 'there is no column'}."
            )
        object.__setattr__(self, "columns", columns)

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def rows(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Return the columns of the cases from `first` up to, not including, `last`.

        Raises:
            OutOfRange: If there are no such cases.
        """
        within("last", whole("last", last, 0), whole("first", first, 0), len(self))
        return {name: values[first:last] for name, values in self.columns.items()}

    @property
    def fingerprint(self) -> str:
        """SHA-256 of names, values and order, hexadecimal."""
        digest = hashlib.sha256()
        for name, values in self.columns.items():
            # In one byte order, so that all machines agree.
            dtype = values.dtype.newbyteorder("<")
            digest.update(json.dumps([name, dtype.str, len(values)]).encode())
            digest.update(values.astype(dtype).tobytes())
        return digest.hexdigest()


def grid(**values: Values) -> Design:
    """Return every combination of values; the last parameter changes fastest.

    Args:
        values: By parameter, the numbers or words it takes, or one that all cases share.

    Raises:
        CraneError: As `Design`, or if the table would not fit the memory.
    """
    designs = [Design({name: column}) for name, column in values.items()]  # type: ignore[dict-item]
    if not designs:
        return Design({})
    # The whole table is judged before a part of it is made.
    _check_size(math.prod(len(design) for design in designs), *designs)
    product = designs[0]
    for design in designs[1:]:
        product = cross(product, design)
    return product


def sample(
    count: int, /, *, seed: int, method: str = "sobol", **ranges: tuple[float, float]
) -> Design:
    """Return points that fill a box evenly; the same seed gives the same points.

    A Latin hypercube has one point in each of `count` equal slices of every range (McKay, Beckman
    and Conover 1979). Scrambled Sobol points fill the box itself (Sobol 1967, Owen 1995). They are
    balanced if their count is a power of two. Any other count takes the first points of the next
    power of two, so a larger sample of the same seed begins with the smaller one.

    Args:
        count: Number of points, 1 to 2^30.
        seed: Seed of the random numbers, 0 or more.
        method: ``"sobol"`` or ``"latin hypercube"``.
        ranges: By parameter, its smallest and its largest value.

    Raises:
        CraneError: If the count or the seed is out of range, the method is unknown, a range is not
            two finite numbers in increasing order, or the table would not fit the memory.
    """
    from scipy.stats import qmc

    if method not in ("sobol", "latin hypercube"):
        raise OutOfRange("method", shown(method), "one of sobol, latin hypercube")
    within("number of points", whole("number of points", count, 1), 1, 2**30)
    rng = np.random.default_rng(whole("seed", seed, 0))
    box = [_range(name, ends) for name, ends in ranges.items()]
    if not box:
        return Design({})
    _check_size(count, *[Design({name: np.zeros(1)}) for name in ranges])
    if method == "sobol":
        exponent = (count - 1).bit_length()  # of the next power of two
        points = qmc.Sobol(len(box), seed=rng).random_base2(exponent)[:count]
    else:
        points = qmc.LatinHypercube(len(box), seed=rng).random(count)
    low, high = np.array(box).T
    # Rounding may put a point beyond the end of its range.
    scaled = (low + (high - low) * points).clip(low, high)
    return Design({name: scaled[:, i] for i, name in enumerate(ranges)})


def cross(a: Design, b: Design) -> Design:
    """Return every case of a design with every case of another one.

    Args:
        a: Design whose cases change slowly.
        b: Design all cases of which follow for each case of `a`.

    Raises:
        CraneError: If they share a parameter, or the table would not fit the memory.
    """
    shared = [name for name in a.columns if name in b.columns]
    if shared:
        raise DataError(
            f"Both designs have the parameter {', '.join(shared)}; each may be in one of them."
        )
    _check_size(len(a) * len(b), a, b)
    slow = {name: np.repeat(values, len(b)) for name, values in a.columns.items()}
    fast = {name: np.tile(values, len(a)) for name, values in b.columns.items()}
    return Design(slow | fast)


def check_memory(table: str, size: float) -> None:
    """Check that a table takes no more than half of this machine's memory.

    Args:
        table: What it is, the subject of the message.
        size: Its size [byte].

    Raises:
        DataError: If it takes more.
    """
    allowed = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
    if size > allowed:
        raise DataError(
            f"{table} would take {size / 1e9:.3g} GB of memory; allowed are {allowed / 1e9:.3g} "
            "GB, half of what there is."
        )


def _check_size(count: int, *designs: Design) -> None:
    """Check that a table of so many cases with the columns of some designs fits the memory."""
    row_size = 0  # bytes
    for design in designs:
        row_size += sum(column.itemsize for column in design.columns.values())
    # Python's integers have no largest number, but a float has.
    check_memory(f"A design of {count} cases", float(min(count, 10**300)) * row_size)


def _range(name: str, ends: tuple[float, float]) -> tuple[float, float]:
    """Return the range of a parameter, checked."""
    if np.shape(ends) == (2,):
        low = number(f"smallest {name}", ends[0])
        high = number(f"largest {name}", ends[1])
        if 0.0 < high - low < math.inf:
            return low, high
    raise OutOfRange(f"range of {name}", ends, "two numbers, the smaller first")


def _column(name: str, values: Values) -> np.ndarray:
    """Return the values of a parameter as a read-only column, checked."""
    if not isinstance(name, str) or not name or not name.isprintable() or name in RESERVED:
        raise CraneError(
            f"A parameter cannot be called {shown(name)}; allowed is any word but "
            f"{' and '.join(RESERVED)}."
        )
    column = np.atleast_1d(np.array(values))
    if column.ndim != 1:
        raise OutOfRange(f"shape of {name}", column.shape, "one row of values")
    if column.dtype.kind == "U":
        # NumPy turns numbers among words into words; as objects they keep their types.
        for item in np.atleast_1d(np.array(values, dtype=object)):
            if not isinstance(item, str) or not item or not item.isprintable():
                raise OutOfRange(f"a value of {name}", repr(item), "a printable word, as others")
    elif column.dtype.kind in "biuf":
        column = column.astype(float)
        is_finite = np.isfinite(column)
        if not is_finite.all():
            case = int(np.argmin(is_finite))  # the first that is not
            raise OutOfRange(f"{name} of case {case}", float(column[case]), "a finite number")
    else:
        raise OutOfRange(f"type of {name}", column.dtype, "numbers or words")
    column.flags.writeable = False
    return column
