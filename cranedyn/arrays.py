"""Arrays from elsewhere: each is looked at before anything is computed from it."""

from __future__ import annotations

from dataclasses import fields
from reprlib import Repr
from typing import Any

import numpy as np

from cranedyn.errors import Misshapen, OutOfRange

DOUBLE = np.dtype(float)

Shape = tuple[int | str, ...]
"""How many along each axis; a letter stands for any number."""


def shaped(name: str, value: Any, *shapes: Shape) -> np.ndarray:
    """A value as an array of doubles, finite or not; an array of doubles as it is.

    Args:
        name: What it is, for the sentence.
        value: Anything.
        shapes: Those that are allowed.

    Raises:
        Misshapen: If it is no array of real numbers, or has another shape.
    """
    if type(value) is np.ndarray and value.dtype is DOUBLE:
        if value.shape in shapes:
            return value
    elif masked(value):
        value = "one with masked numbers"
    else:
        try:
            found = np.asarray(value)
            value = (
                found.astype(float)
                if found.dtype.kind in "iuf"
                else f"one of {found.dtype}"
                if found.shape
                else type(value).__name__
            )
        except Exception:  # whatever a stranger's object raises
            value = type(value).__name__
    if isinstance(value, str):
        raise Misshapen(name, f"no array of numbers but {value}", f"an array of {_words(shapes)}")
    if not any(_fits(value.shape, shape) for shape in shapes):
        raise Misshapen(name, f"an array of shape {value.shape}", f"one of {_words(shapes)}")
    return value


def finite(name: str, value: Any, *shapes: Shape, unit: str = "") -> np.ndarray:
    """A value as an array of finite numbers in a unit, see `shaped`.

    Raises:
        Misshapen: As `shaped`.
        OutOfRange: If a number is not finite.
    """
    array = shaped(name, value, *shapes)
    wrong = ~np.isfinite(array)
    if wrong.any():
        raise OutOfRange(name, float(array[wrong][0]), "finite", unit)
    return array


def masked(value: Any) -> bool:
    """Whether a value is a masked array of NumPy with numbers that are not to be looked at, which
    as a plain array would be whatever stands there.
    """
    return isinstance(value, np.ndarray) and bool(np.any(getattr(value, "mask", False)))


def fixed(array: np.ndarray) -> np.ndarray:
    """The same numbers for somebody who must not change them."""
    view = array.view()
    view.flags.writeable = False
    return view


def _fits(found: tuple[int, ...], shape: Shape) -> bool:
    return len(found) == len(shape) and all(
        isinstance(b, str) or a == b for a, b in zip(found, shape, strict=True)
    )


def _words(shapes: tuple[Shape, ...]) -> str:
    return "shape " + " or ".join(
        f"({', '.join(map(str, shape))}{',' * (len(shape) == 1)})" for shape in shapes
    )


class OneLine:
    """A dataclass whose ``repr`` is one line, with the shapes of long arrays."""

    def __repr__(self) -> str:
        """Return the name of the class and its public fields."""
        shown = (
            f"{one.name}={_SHORT.repr(getattr(self, one.name))}"
            for one in fields(self)  # type: ignore[arg-type]
            if one.repr and not one.name.startswith("_")
        )
        return f"{type(self).__name__}({', '.join(shown)})"


class _Short(Repr):
    def repr_ndarray(self, array: np.ndarray, level: int) -> str:
        return str(array.tolist()) if array.size <= 9 else f"array of shape {array.shape}"

    def repr_instance(self, value: object, level: int) -> str:
        line = repr(value).partition("\n")[0]
        return line if len(line) <= 100 else f"{type(value).__name__}(...)"


_SHORT = _Short()
