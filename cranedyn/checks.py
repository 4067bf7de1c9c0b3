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
        if isinstance(value, str):
            if unit and value.strip().endswith(unit):  # the message would repeat the unit
                raise OutOfRange(name, quoted(value), f"the number alone, in {unit}") from None
            value = quoted(value)
        raise OutOfRange(
            name, value, "a number" if allowed == "any" else f"a number {allowed}", unit
        ) from None
    low, high = (
        map(float, allowed.split(" to ")) if " to " in allowed
        else (-math.inf if allowed == "any" else 0.0, math.inf)
    )  # fmt: skip
    if x == math.inf and allowed.endswith(" or inf"):
        return x
    if "whole" in allowed and not (x >= 1.0 and x.is_integer()):
        raise OutOfRange(name, value, allowed, unit)
    if not math.isfinite(x) or not low <= x <= high or (allowed == "> 0" and x == 0.0):
        raise OutOfRange(name, value, "a finite number" if allowed == "any" else allowed, unit)
    return x


def within(name: str, value: object, low: float, high: float, unit: str = "") -> float:
    """Return the value as a float if it is finite and from `low` to `high`.

    Raises:
        OutOfRange: If it is no number, not finite, or outside.
    """
    x = number(name, value, unit)
    if not low <= x <= high:
        ends = f"{low:g}", f"{high:g}"
        if float(ends[0]) <= x <= float(ends[1]):  # rounded ends would include the value
            ends = str(float(low)), str(float(high))
        raise OutOfRange(name, value, " to ".join(ends), unit)
    return x


def whole(name: str, value: object, minimum: int, unit: str = "") -> int:
    """Return the value as an int if it is a whole number of at least `minimum`.

    Raises:
        OutOfRange: If it is not whole, less, or larger than `sys.maxsize`.
    """
    if type(value) is int and minimum <= value <= sys.maxsize:  # quick
        return value
    if isinstance(value, bool) or not isinstance(value, Integral) or value < minimum:
        raise OutOfRange(name, value, f"a whole number >= {minimum}", unit)
    if int(value) > sys.maxsize:
        raise OutOfRange(name, value, f"a whole number up to {sys.maxsize:g}", unit)
    return int(value)


def worker_count(name: str, count: object) -> int:
    """Return a number of threads or processes, 1024 at most; for None that of usable processors.

    Raises:
        OutOfRange: If it is not whole, or out of range.
    """
    if count is None:
        affine = hasattr(os, "sched_getaffinity")  # not on macOS
        return min(len(os.sched_getaffinity(0)) if affine else os.cpu_count() or 1, 1024)
    return int(within(name, whole(name, count, 1), 1, 1024))


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
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    masked = array is not value and "numpy.ma" in sys.modules and np.ma.is_masked(value)
    if array.dtype.kind not in "iuf" or masked:
        words = {"U": "words", "S": "bytes", "b": "True and False", "c": "complex numbers"}
        kind = f"one of {words.get(array.dtype.kind, str(array.dtype))}"
        if not array.shape:
            kind = type(value).__name__
        kind = "one with masked numbers" if masked else kind
        given = f"no array of numbers but {kind}"
        raise Misshapen(name, given, meaning or f"an array of {_format_shapes(shapes)}")
    if not any(_matches(array.shape, shape) for shape in shapes):
        allowed = meaning or f"one of {_format_shapes(shapes)}"
        raise Misshapen(name, f"an array of shape {array.shape}", allowed)
    return array.astype(float, copy=False)


def finite(name: str, value: Any, *shapes: Shape, unit: str = "", meaning: str = "") -> np.ndarray:
    """Return a value as an array of finite doubles, see `as_array`.

    Raises:
        Misshapen: As `as_array`.
        OutOfRange: If a number is not finite.
    """
    array = as_array(name, value, *shapes, meaning=meaning)
    rows = equal_rows(array)
    if not (fine := np.isfinite(rows)).all():
        first = np.argwhere(~fine)[0].tolist()
        raise OutOfRange(name, float(rows[~fine][0]), f"finite{_entry(first, rows.shape)}", unit)
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
        definite: Whether its eigenvalues must be positive; else they may be 0, and negative by
            round-off, 1e-9 of the largest element.

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
    if least < (np.nextafter(0, 1) if definite else -1e-9 * np.abs(weight).max()):
        raise OutOfRange(name, f"{matrix} with the eigenvalue {least:.3g}", allowed)
    return weight


def equal_rows(array: np.ndarray) -> np.ndarray:
    """Return the first row of an array whose rows share their memory, and others as they are."""
    return array[:1] if array.ndim > 1 and not array.strides[0] else array


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a read-only view of an array."""
    view = array.view()
    view.flags.writeable = False
    return view


def _matches(lengths: tuple[int, ...], shape: Shape) -> bool:
    return len(lengths) == len(shape) and all(
        isinstance(b, str) or a == b for a, b in zip(lengths, shape, strict=True)
    )


def _format_shapes(shapes: tuple[Shape, ...]) -> str:
    texts = (f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in shapes)
    return f"shape {' or '.join(texts)}"


class ShortRepr:
    """Mixin for dataclasses whose ``repr`` is one line, with the shapes of long arrays."""

    def __repr__(self) -> str:
        values = (
            f"{field.name}={short_repr(getattr(self, field.name))}"
            for field in fields(self)  # type: ignore[arg-type]
            if field.repr and not field.name.startswith("_")
        )
        return f"{type(self).__name__}({', '.join(values)})"


class _Short(reprlib.Repr):
    def repr_ndarray(self, array: np.ndarray, level: int) -> str:
        return str(array.tolist()) if 0 < array.size <= 9 else f"array of shape {array.shape}"

    def repr_instance(self, value: object, level: int) -> str:
        line = repr(value).partition("\n")[0]
        return line if len(line) <= 100 else f"{type(value).__name__}(...)"


short_repr = _Short().repr
"""Return the ``repr`` of a value on one line, shortened; of a long array its shape."""

_DOUBLE = np.dtype(float)
