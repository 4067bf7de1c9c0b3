"""Which cases a study is made of: every combination, points that fill a box, and products of
both.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from cranedyn.checks import number, short_repr
from cranedyn.errors import CraneError, DataError, OutOfRange, shown
from cranedyn.sweep.limits import check_memory, whole

RESERVED = ("case", "error")
"""Columns that every result has besides."""

METHODS = ("sobol", "latin hypercube")
"""How a box of parameters is sampled."""

Values = Sequence[float] | Sequence[str] | np.ndarray | float | str
"""What a column is made of: numbers or words, several or one."""


@dataclass(frozen=True, eq=False)
class Design:
    """A table of cases, one a row.

    Attributes:
        columns: By the name of the parameter, in this order: finite numbers, or words that name a
            controller, a reference or the like; shape (n,) each. They are copied, and cannot be
            written to.

    Raises:
        CraneError: If there is no column or no row, the columns differ in length, a name is empty
            or one of `RESERVED`, or values are neither finite numbers nor printable words.
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
        """Number of cases."""
        return len(next(iter(self.columns.values())))

    def rows(self, first: int, last: int) -> dict[str, np.ndarray]:
        """The columns of the cases from one up to, not including, another.

        Raises:
            OutOfRange: If there is no such case.
        """
        first, last = whole("first", first, 0, len(self)), whole("last", last, 0, len(self))
        return {name: values[first:last] for name, values in self.columns.items()}

    @property
    def fingerprint(self) -> str:
        """The same for the same names, values and order, and for no other; hexadecimal."""
        digest = hashlib.sha256()
        for name, values in self.columns.items():
            kind = values.dtype.newbyteorder("<")
            digest.update(json.dumps([name, kind.str, len(values)]).encode())
            digest.update(values.astype(kind).tobytes())
        return digest.hexdigest()


def grid(**values: Values) -> Design:
    """Every combination; the last parameter changes fastest.

    Args:
        values: By parameter, the numbers or words it takes, or one that all cases share.

    Raises:
        CraneError: As `Design`, or if the table would not fit the memory.
    """
    designs = [Design({name: _column(name, given)}) for name, given in values.items()] or [
        Design({})
    ]
    _check_memory(math.prod(map(len, designs)), *designs)
    return reduce(cross, designs)


def sampled(
    count: int, /, *, seed: int, method: str = "sobol", **ranges: tuple[float, float]
) -> Design:
    """Points that fill a box evenly; the same seed gives the same points.

    A Latin hypercube has one point in each of ``count`` equal slices of every range (McKay, Beckman
    and Conover 1979). Sobol points, scrambled, fill the box itself (Sobol 1967, Owen 1995). They
    are balanced where their count is a power of two; of another count they are the first points of
    the next power of two, and more points of the same seed go on from the fewer.

    Args:
        count: Number of points.
        seed: Of their random numbers, 0 or more.
        method: ``"sobol"`` or ``"latin hypercube"``.
        ranges: By parameter, its smallest and its largest value.

    Raises:
        CraneError: If a number is not allowed, the method is unknown, a range is not two finite
            numbers in increasing order, or the table would not fit the memory.
    """
    from scipy.stats import qmc

    if not isinstance(method, str) or method not in METHODS:
        raise OutOfRange("method", short_repr(method), f"one of {', '.join(METHODS)}")
    n, rng = (
        whole("number of points", count, 1, 2**30),
        np.random.default_rng(whole("seed", seed, 0)),
    )
    box = np.array([_range(name, given) for name, given in ranges.items()]).reshape(-1, 2).T
    if not ranges:
        return Design({})
    _check_memory(n, *(Design({name: np.zeros(1)}) for name in ranges))
    if method == "sobol":
        points = qmc.Sobol(len(ranges), seed=rng).random_base2((n - 1).bit_length())[:n]
    else:
        points = qmc.LatinHypercube(len(ranges), seed=rng).random(n)
    low, high = box[0], box[1]
    return Design(dict(zip(ranges, (low + (high - low) * points).clip(low, high).T, strict=True)))


def cross(a: Design, b: Design) -> Design:
    """Every case of one design with every case of another, the first changing slowest.

    Raises:
        CraneError: If they share a parameter, or the table would not fit the memory.
    """
    if shared := [name for name in a.columns if name in b.columns]:
        raise DataError(
            f"Both designs have the parameter {', '.join(shared)}; each may be in one of them."
        )
    _check_memory(len(a) * len(b), a, b)
    slow = {name: np.repeat(values, len(b)) for name, values in a.columns.items()}
    return Design(slow | {name: np.tile(values, len(a)) for name, values in b.columns.items()})


def _check_memory(count: int, *parts: Design) -> None:
    width = sum(column.itemsize for part in parts for column in part.columns.values())
    check_memory(f"A design of {count} cases", float(min(count, 10**300)) * width)


def _range(name: str, given: Any) -> tuple[float, float]:
    try:
        low, high = given
    except (TypeError, ValueError):
        raise OutOfRange(f"range of {name}", given, "two numbers, the smaller first") from None
    ends = number(f"smallest {name}", low), number(f"largest {name}", high)
    if not 0.0 < ends[1] - ends[0] < math.inf:
        raise OutOfRange(f"range of {name}", f"{low} to {high}", "two numbers, the smaller first")
    return ends


def _column(name: str, given: Values) -> np.ndarray:
    if not isinstance(name, str) or not name or not name.isprintable() or name in RESERVED:
        raise CraneError(
            f"A parameter cannot be called {shown(name)}; allowed is any word but "
            f"{' and '.join(RESERVED)}."
        )
    values = (
        np.array(given, dtype=float)
        if isinstance(given, np.ndarray) and given.dtype.kind in "biuf"
        else _listed(name, given)
    )
    if values.ndim != 1:
        raise OutOfRange(f"shape of {name}", values.shape, "one row of values")
    if values.dtype.kind == "f" and not (finite := np.isfinite(values)).all():
        raise OutOfRange(
            f"{name} of case {int(np.argmin(finite))}", float(values[~finite][0]), "a finite number"
        )
    values.flags.writeable = False
    return values


def _listed(name: str, given: object) -> np.ndarray:
    if isinstance(given, np.ndarray):
        given = given.tolist()
    items = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]
    words = [item for item in items if isinstance(item, str)]
    if 0 < len(words) < len(items):
        raise OutOfRange(f"column {name}", "of numbers and words", "one of them")
    if items and not words:
        return np.array([number(name, item) for item in items])
    for word in words:
        if not word or not word.isprintable():
            raise OutOfRange(f"a value of {name}", repr(word), "a number or a printable word")
    return np.array(words, dtype=str) if words else np.empty(0)
