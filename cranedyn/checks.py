"""Checks of numbers, arrays and choices at the API: ranges, shapes, finiteness."""

from __future__ import annotations

import math
import os
import reprlib
import sys
from dataclasses import fields
from numbers import Integral
from typing import Any, get_args

import numpy as np

from cranedyn.errors import Misshapen, OutOfRange, quoted

Shape = tuple[int | str, ...]
"""Length along each axis; a letter stands for any length."""

_DOUBLE = np.dtype(float)
"""Type of the elements of all arrays; NumPy has one object for it, so `is` compares it fast."""

_MAX_WORKERS = 1024
"""Largest number of threads or processes."""

_SEMIDEFINITE_TOLERANCE = 1e-9
"""Size of negative eigenvalues that count as round-off, as a share of the largest element."""

_MAX_ELEMENTS = 9
"""Number of elements up to which `short_repr` writes an array out: those of a 3 by 3 matrix."""

_MAX_REPR_LENGTH = 100
"""Number of characters up to which `short_repr` keeps the ``repr`` of an object."""

_KINDS = {"U": "words", "S": "bytes", "b": "True and False", "c": "complex numbers"}
"""What an array holds in words, by the kind of NumPy's types."""


def number(name: str, value: object, unit: str = "", allowed: str = "any") -> float:
    """Return the value as a float if it is finite and in the allowed range.

    Args:
        name: Name of the number for the error message.
        value: Anything that ``float`` takes.
        unit: Unit for the error message.
        allowed: ``"any"``, ``"> 0"``, ``">= 0"``, ``">= 0 or inf"``, ``"LOW to HIGH"`` or
            ``"a whole number >= 1"``.

    Raises:
        OutOfRange: If it is no number, not finite, or not in the range.
    """
    try:
        x = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise _not_a_number(name, value, unit, allowed) from None
    low, high = _ends(allowed)
    if x == math.inf and allowed.endswith(" or inf"):
        return x
    if "whole" in allowed and not (x >= 1.0 and x.is_integer()):
        raise OutOfRange(name, value, allowed, unit)
    is_excluded_zero = allowed == "> 0" and x == 0.0
    if not math.isfinite(x) or not low <= x <= high or is_excluded_zero:
        raise OutOfRange(name, value, "a finite number" if allowed == "any" else allowed, unit)
    return x


def _ends(allowed: str) -> tuple[float, float]:
    """Return the ends of a range in the words of `number`; both belong to it, except 0 of "> 0"."""
    if allowed == "any":
        return -math.inf, math.inf
    if " to " in allowed:
        low, high = allowed.split(" to ")
        return float(low), float(high)
    return 0.0, math.inf


def _not_a_number(name: str, value: object, unit: str, allowed: str) -> OutOfRange:
    """Return the error for a value that ``float`` does not take; arguments as of `number`."""
    if isinstance(value, str):
        if unit and value.strip().endswith(unit):
            # The unit of the message would repeat that of the text.
            return OutOfRange(name, quoted(value), f"the number alone, in {unit}")
        value = quoted(value)
    return OutOfRange(name, value, "a number" if allowed == "any" else f"a number {allowed}", unit)


def within(name: str, value: object, low: float, high: float, unit: str = "") -> float:
    """Return the value as a float if it is finite and from `low` to `high`.

    Raises:
        OutOfRange: If it is no number, not finite, or outside.
    """
    x = number(name, value, unit)
    if not low <= x <= high:
        low_text = f"{low:g}"
        high_text = f"{high:g}"
        if float(low_text) <= x <= float(high_text):
            # Rounded to six digits the ends would include the value: write all digits.
            low_text = str(float(low))
            high_text = str(float(high))
        raise OutOfRange(name, value, f"{low_text} to {high_text}", unit)
    return x


def whole(name: str, value: object, minimum: int, unit: str = "") -> int:
    """Return the value as an int if it is a whole number of at least `minimum`.

    Raises:
        OutOfRange: If it is not whole, less, or larger than `sys.maxsize`.
    """
    # First what nearly all values are: `isinstance` of an abstract class takes long.
    if type(value) is int and minimum <= value <= sys.maxsize:
        return value
    # True and False are integers for Python, but no numbers for a user.
    if isinstance(value, bool) or not isinstance(value, Integral) or value < minimum:
        raise OutOfRange(name, value, f"a whole number >= {minimum}", unit)
    if int(value) > sys.maxsize:
        raise OutOfRange(name, value, f"a whole number up to {sys.maxsize:g}", unit)
    return int(value)


def worker_count(name: str, count: object) -> int:
    """Return a number of threads or processes, 1024 at most.

    Args:
        name: Name of the number for the error message.
        count: The number; None for that of the processors which this program may use.

    Raises:
        OutOfRange: If it is not whole, or out of range.
    """
    if count is None:
        return min(_usable_processors(), _MAX_WORKERS)
    return int(within(name, whole(name, count, 1), 1, _MAX_WORKERS))


def _usable_processors() -> int:
    """Return the number of processors that the system lets this program use, 1 if unknown."""
    # Linux may restrict a process to some processors, as container systems do; macOS cannot.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_choice(name: str, value: str, choices: Any) -> None:
    """Check that a word is one of those that a Literal lists.

    Raises:
        OutOfRange: If it is not.
    """
    if value not in get_args(choices):
        raise OutOfRange(name, value, " or ".join(get_args(choices)))


def as_array(name: str, value: Any, *shapes: Shape, meaning: str = "") -> np.ndarray:
    """Return a value as an array of doubles, finite or not; an array of doubles is not copied.

    Args:
        name: Name of the array for the error message.
        value: Array or nested sequence of real numbers.
        shapes: Shapes that are allowed.
        meaning: What is allowed, in words; empty for the shapes.

    Raises:
        Misshapen: If it is no array of real numbers, has masked elements, or another shape.
    """
    if type(value) is np.ndarray and value.dtype is _DOUBLE and value.shape in shapes:
        return value
    try:
        array = np.asarray(value)
    except ValueError:
        # Rows of different lengths: an array of no numbers, which is refused below.
        array = np.asarray(None)
    # NumPy drops the mask of an array, and with it that its elements are no measurements. The
    # module is asked only if somebody has loaded it, since its import takes long.
    masked = array is not value and "numpy.ma" in sys.modules and np.ma.is_masked(value)
    if array.dtype.kind not in "iuf" or masked:
        if masked:
            kind = "one with masked numbers"
        elif not array.shape:
            kind = type(value).__name__
        else:
            kind = f"one of {_KINDS.get(array.dtype.kind, str(array.dtype))}"
        given = f"no array of numbers but {kind}"
        raise Misshapen(name, given, meaning or f"an array of {_format_shapes(shapes)}")
    if not any(_matches(array.shape, shape) for shape in shapes):
        allowed = meaning or f"one of {_format_shapes(shapes)}"
        raise Misshapen(name, f"an array of shape {array.shape}", allowed)
    return array.astype(float, copy=False)


def finite(name: str, value: Any, *shapes: Shape, unit: str = "", meaning: str = "") -> np.ndarray:
    """Return a value as an array of finite doubles.

    Args:
        name: Name of the array for the error message.
        value: Array or nested sequence of real numbers.
        shapes: Shapes that are allowed.
        unit: Unit for the error message.
        meaning: What is allowed, in words; empty for the shapes.

    Raises:
        Misshapen: As `as_array`.
        OutOfRange: If a number is not finite.
    """
    array = as_array(name, value, *shapes, meaning=meaning)
    rows = equal_rows(array)
    are_finite = np.isfinite(rows)
    if not are_finite.all():
        first = np.argwhere(~are_finite)[0].tolist()
        value_there = float(rows[~are_finite][0])
        raise OutOfRange(name, value_there, f"finite{_entry(first, rows.shape)}", unit)
    return array


def _entry(index: list[int], shape: tuple[int, ...]) -> str:
    """Return which entry of an array is meant, in words and in brackets, counted from 1; empty for
    an array of one entry, or of more than two axes.
    """
    if math.prod(shape) == 1 or not 1 <= len(shape) <= 2:
        return ""
    if len(shape) == 1:
        return f" (entry {index[0] + 1} of {shape[0]})"
    return f" (row {index[0] + 1}, column {index[1] + 1})"


def weight_matrix(name: str, value: Any, size: int, *, definite: bool) -> np.ndarray:
    """Return a symmetric weight of a quadratic cost, checked, shape (size, size).

    Args:
        name: Name of the weight for the error message.
        value: The weight.
        size: Its number of rows and columns.
        definite: Whether its eigenvalues must be positive. Otherwise they may be 0, and negative by
            round-off, see `_SEMIDEFINITE_TOLERANCE`.

    Raises:
        Misshapen: As `as_array`.
        OutOfRange: If a number is not finite, or the matrix is not symmetric or has an eigenvalue
            that is not allowed.
    """
    weight = as_array(name, value, (size, size))
    allowed = "symmetric and positive " + ("definite" if definite else "semidefinite")
    matrix = f"a matrix of {size} by {size}"
    if not np.isfinite(weight).all():
        raise OutOfRange(name, f"{matrix} with numbers that are not finite", allowed)
    if not np.allclose(weight, weight.T):
        asymmetry = float(np.abs(weight - weight.T).max())
        raise OutOfRange(name, f"{matrix} that is unsymmetric by {asymmetry:.3g}", allowed)
    least = float(np.linalg.eigvalsh(weight).min())
    if definite:
        # The smallest number above 0.
        allowed_least = np.nextafter(0, 1)
    else:
        allowed_least = -_SEMIDEFINITE_TOLERANCE * np.abs(weight).max()
    if least < allowed_least:
        raise OutOfRange(name, f"{matrix} with the eigenvalue {least:.3g}", allowed)
    return weight


def equal_rows(array: np.ndarray) -> np.ndarray:
    """Return the first row of an array whose rows share their memory, and others as they are.

    NumPy's ``broadcast_to`` makes such arrays, for a batch of a million equal rows: it is enough to
    check one.
    """
    return array[:1] if array.ndim > 1 and not array.strides[0] else array


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def _matches(lengths: tuple[int, ...], shape: Shape) -> bool:
    """Return whether an array of these lengths has an allowed shape."""
    if len(lengths) != len(shape):
        return False
    for length, allowed in zip(lengths, shape, strict=True):
        if not isinstance(allowed, str) and length != allowed:
            return False
    return True


def _format_shapes(shapes: tuple[Shape, ...]) -> str:
    """Return shapes as Python writes tuples, but letters without quotation marks."""
    texts = []
    for shape in shapes:
        lengths = ", ".join(str(length) for length in shape)
        texts.append(f"({lengths},)" if len(shape) == 1 else f"({lengths})")
    return f"shape {' or '.join(texts)}"


class ShortRepr:
    """Mixin for dataclasses whose ``repr`` is one line, with the shapes of long arrays."""

    def __repr__(self) -> str:
        values = []
        for field in fields(self):  # type: ignore[arg-type]
            if field.repr and not field.name.startswith("_"):
                values.append(f"{field.name}={short_repr(getattr(self, field.name))}")
        return f"{type(self).__name__}({', '.join(values)})"


class _Short(reprlib.Repr):
    """Writes values on one line; `reprlib` calls the method that is named after the type."""

    def repr_ndarray(self, array: np.ndarray, level: int) -> str:
        """Return the elements of a small array, and the shape of others."""
        if 0 < array.size <= _MAX_ELEMENTS:
            return str(array.tolist())
        return f"array of shape {array.shape}"

    def repr_instance(self, value: object, level: int) -> str:
        """Return the first line of the ``repr`` of any other object; its type if that is long."""
        line = repr(value).partition("\n")[0]
        return line if len(line) <= _MAX_REPR_LENGTH else f"{type(value).__name__}(...)"


short_repr = _Short().repr
"""Return the ``repr`` of a value on one line, shortened; of a long array its shape."""
