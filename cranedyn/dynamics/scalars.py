"""Choices, comparisons and small linear algebra on any kind of number, so that physics is written
once.

A number is a float, an array of floats (many rows at once), or a value of a program under
construction, which brings its own way to choose as `choices`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


class Rows(np.ndarray):
    """One quantity in many rows, as an element of an array of objects: it knows sine and cosine as
    symbols do.

    As in code, nothing is multiplied by the numbers 0 or 1, or added to 0, which would be most of
    the work.
    """

    def __mul__(self, other: Any) -> Any:
        if type(other) is float and other in (0.0, 1.0):
            return self if other else 0.0
        return super().__mul__(other)

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        return self if type(other) is float and other == 0.0 else super().__add__(other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self if type(other) is float and other == 0.0 else super().__sub__(other)

    def sin(self) -> np.ndarray:
        """Return the sine of each."""
        return np.sin(self)

    def cos(self) -> np.ndarray:
        """Return the cosine of each."""
        return np.cos(self)


def rows(table: np.ndarray) -> np.ndarray:
    """Return columns of a table, shape (n, k), as an array of k objects of n rows each."""
    columns = np.empty(table.shape[1], dtype=object)
    for i, column in enumerate(np.asarray(table, dtype=float).T):
        columns[i] = column.view(Rows)
    return columns


def chosen(condition: Any, yes: Any, no: Any) -> Any:
    """Return one number where a condition holds, another where not.

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


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers."""
    return chosen(a < b, a, b)


def larger(a: Any, b: Any) -> Any:
    """Return the larger of two numbers."""
    return chosen(a > b, a, b)


def clipped(value: Any, low: Any, high: Any) -> Any:
    """Return a number cut to a range; what is not a number stays."""
    value = chosen(value < low, low, value)
    return chosen(value > high, high, value)


def flag(condition: Any, of: Any) -> Any:
    """Return 1 where a condition on a number holds, else 0, as such a number."""
    if isinstance(condition, bool | np.bool_ | np.ndarray):
        return chosen(condition, 1.0, 0.0)
    return of.choices.chosen(condition, 1.0, 0.0)


def magnitude(value: Any) -> Any:
    """Return a number without its sign."""
    return chosen(value < 0.0, -value, value)


def square_root(value: Any) -> Any:
    """Return the square root of a number that is not negative."""
    return value.choices.call("llvm.sqrt", value) if hasattr(value, "choices") else np.sqrt(value)


def rounded(value: Any) -> Any:
    """Return the nearest whole number, the even one of two."""
    return value.choices.call("llvm.rint", value) if hasattr(value, "choices") else np.rint(value)


def array(elements: Sequence[Any]) -> np.ndarray:
    """Return an object array, numbers among its elements as Python floats."""
    objects = np.empty(len(elements), dtype=object)
    for i, element in enumerate(elements):
        objects[i] = float(element) if isinstance(element, float | int) else element
    return objects


def is_zero(element: Any) -> bool:
    """Return whether an element is known to be zero."""
    return isinstance(element, float) and element == 0.0


def cross_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product, shape (3,)."""
    return array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def solve_linear(mass: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve mass @ x = right for a symmetric positive definite matrix; zeros between branches of
    the tree are left out.

    Unknowns are eliminated from the last, two at a time: by determinants two take one division,
    where one after the other they take two, and the second waits for the first. The last two are
    multiplied by the determinant of those before, so that they do not wait for its division.
    """
    lower = mass.copy()
    x = right.copy()
    blocks = list[tuple[range, np.ndarray, np.ndarray]]()
    end = len(mass)
    while end:
        begin = end - (1 if end == 1 or isinstance(lower[end - 1, end - 1], float) else 2)
        adjugate, determinant = _adjugate(lower[begin:end, begin:end])
        if begin > 2:
            adjugate = adjugate * (1.0 / determinant)
            determinant = np.ones(1)
        shares, (scale,) = adjugate @ lower[begin:end, :begin], determinant
        for i in range(begin):
            for j in range(i + 1):
                lower[i, j] = lower[i, j] * scale - shares[:, i] @ lower[begin:end, j]
            x[i] = x[i] * scale - shares[:, i] @ x[begin:end]
        x[begin:end] = adjugate @ x[begin:end]
        blocks.append((range(begin, end), 1.0 / determinant, shares))
        end = begin
    for block, inverse, shares in reversed(blocks):
        x[block] = (x[block] - shares @ x[: block.start]) * inverse
    return x


def _adjugate(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the adjugate and determinant, shape (1,), from the lower triangle of a symmetric
    matrix of one row or two.
    """
    if len(block) == 1:
        return np.ones((1, 1)), block[0]
    (a, c), b = (block[0, 0], block[1, 0]), block[1, 1]
    return array([b, -c, -c, a]).reshape(2, 2), array([a * b - c * c])
