"""Choices and comparisons on any kind of number, so that physics is written once.

A number is a float, an array of floats (many rows at once), or a value of a program under
construction, which brings its own way to choose as `choices`.
"""

from __future__ import annotations

from typing import Any

import numpy as np


class Rows(np.ndarray):
    """One quantity in many rows, as an element of an array of objects: it knows sine and cosine as
    symbols do.

    As in code, nothing is multiplied by the numbers 0 or 1, or added to 0, which would be most of
    the work.
    """

    def __mul__(self, other: Any) -> Any:
        """The product."""
        if type(other) is float and other in (0.0, 1.0):
            return self if other else 0.0
        return super().__mul__(other)

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        """The sum."""
        return self if type(other) is float and other == 0.0 else super().__add__(other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        """The difference."""
        return self if type(other) is float and other == 0.0 else super().__sub__(other)

    def sin(self) -> np.ndarray:
        """Sine of each."""
        return np.sin(self)

    def cos(self) -> np.ndarray:
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
        condition: What a comparison of two such numbers gives. Never that of two arrays of objects:
            NumPy takes all of theirs for true.
        yes: A number.
        no: Another.
    """
    if isinstance(condition, bool | np.bool_):
        return yes if condition else no
    if isinstance(condition, np.ndarray):
        return np.where(condition, yes, no)
    return next(number for number in (yes, no) if hasattr(number, "choices")).choices.chosen(
        condition, yes, no
    )


def clipped(value: Any, low: Any, high: Any) -> Any:
    """A number cut to a range; what is not a number stays."""
    value = chosen(value < low, low, value)
    return chosen(value > high, high, value)


def flag(condition: Any, of: Any) -> Any:
    """1 where a condition on a number holds, else 0, as such a number."""
    if isinstance(condition, bool | np.bool_ | np.ndarray):
        return chosen(condition, 1.0, 0.0)
    return of.choices.chosen(condition, 1.0, 0.0)


def magnitude(value: Any) -> Any:
    """A number without its sign."""
    return chosen(value < 0.0, -value, value)


def root(value: Any) -> Any:
    """The square root of a number that is not negative."""
    return value.choices.call("llvm.sqrt", value) if hasattr(value, "choices") else np.sqrt(value)


def rounded(value: Any) -> Any:
    """The nearest whole number, the even one of two."""
    return value.choices.call("llvm.rint", value) if hasattr(value, "choices") else np.rint(value)
