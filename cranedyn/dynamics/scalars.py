"""Choices and comparisons on any kind of number, so that physics is written once.

A number is a float, an array of floats (many rows at once), a symbol of CasADi, or a value of a program under construction; each of the
last two brings its own way to choose. Arrays of objects are taken element by element.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np


class Rows(np.ndarray):
    """One quantity in many rows, as an element of an array of objects: it knows sine and cosine as symbols do."""

    def sin(self) -> Rows:
        """Sine of each."""
        return np.sin(self)

    def cos(self) -> Rows:
        """Cosine of each."""
        return np.cos(self)


def rows(table: np.ndarray) -> np.ndarray:
    """Columns of a table, shape (n, k), as an array of k objects, each a quantity in n rows."""
    made = np.empty(table.shape[1], dtype=object)
    for i, column in enumerate(np.asarray(table, dtype=float).T):
        made[i] = column.view(Rows)
    return made


def chosen(condition: Any, yes: Any, no: Any) -> Any:
    """One number where a condition holds, another where not.

    Args:
        condition: What a comparison of such numbers gives, or an array of these.
        yes, no: Numbers, or arrays of the same shape.
    """
    if isinstance(condition, np.ndarray) and condition.dtype == object:
        return _each(chosen, condition, yes, no)
    maker = _maker(condition, yes, no)
    return np.where(condition, yes, no) if maker is None else maker.chosen(condition, yes, no)


def clipped(value: Any, low: Any, high: Any) -> Any:
    """A number cut to a range; what is not a number stays."""
    return chosen(value > high, high, chosen(value < low, low, value))


def all_of(conditions: list[Any]) -> Any:
    """Whether all conditions hold."""
    return reduce(lambda a, b: a & b, conditions)


def any_of(conditions: list[Any]) -> Any:
    """Whether one of the conditions holds."""
    return reduce(lambda a, b: a | b, conditions)


def _maker(*numbers: Any) -> Any:
    """What makes choices for numbers of a kind of its own; None for floats and their arrays."""
    return next((number.choices for number in numbers if hasattr(number, "choices")), None)


def _each(function: Callable[..., Any], *arrays: Any) -> np.ndarray:
    parts = np.broadcast_arrays(*(np.asarray(array, dtype=object) for array in arrays))
    made = np.empty(parts[0].shape, dtype=object)
    for place in np.ndindex(made.shape):
        made[place] = function(*(part[place] for part in parts))
    return made
