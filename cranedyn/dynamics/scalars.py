"""Choices, comparisons and small linear algebra on any kind of number, so that physics is written
once.

A number is a float, an array of floats (many rows at once), or a value of a program under
construction. The attribute `choices` of such a value is the program, whose methods ``where`` and
``call`` emit choices and calls of functions.

A comparison of values of a program gives a condition that is not known while the program is made,
so that Python's ``if``, ``and`` and ``or`` do not work on it. That is why physics chooses by
`where`, `smaller`, `larger` and `clipped`, and computes with `indicator`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np


class Rows(np.ndarray):
    """One quantity in many rows, as an element of an array of objects.

    NumPy computes sine and cosine of an array of objects by methods of its elements, which this
    class has, as symbols do. As in code, nothing is multiplied by the numbers 0 or 1, or added to
    0, which would be most of the work.
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
        """Return the sine of each row."""
        return np.sin(self)

    def cos(self) -> np.ndarray:
        """Return the cosine of each row."""
        return np.cos(self)


def column_objects(table: np.ndarray) -> np.ndarray:
    """Return the columns of a table of coordinates or efforts in many rows, shape (rows, k), as an
    array of k objects, each of which holds one quantity in all rows.
    """
    columns = np.empty(table.shape[1], dtype=object)
    for i, column in enumerate(np.asarray(table, dtype=float).T):
        columns[i] = column.view(Rows)
    return columns


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return one number where a condition holds, another where not.

    Args:
        condition: Result of a comparison of two such numbers. Never that of two arrays of objects:
            NumPy turns their conditions into booleans, which are all true.
        yes: A number.
        no: Another. Where the condition is one of a program, one of the two must be a value of it.
    """
    if isinstance(condition, bool | np.bool_):
        return yes if condition else no
    if isinstance(condition, np.ndarray):
        return np.where(condition, yes, no)
    value = yes if hasattr(yes, "choices") else no
    return value.choices.where(condition, yes, no)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers."""
    return where(a < b, a, b)


def larger(a: Any, b: Any) -> Any:
    """Return the larger of two numbers."""
    return where(a > b, a, b)


def clipped(value: Any, low: Any, high: Any) -> Any:
    """Clip a number to the range [low, high]. NaN is returned unchanged."""
    value = where(value < low, low, value)
    return where(value > high, high, value)


def indicator(condition: Any, compared: Any) -> Any:
    """Return 1 where a condition holds, else 0.

    Args:
        condition: The condition.
        compared: A number of the same kind as those that were compared. Of a program under
            construction it is a value, whose program emits the choice, see `where`.
    """
    if isinstance(condition, bool | np.bool_ | np.ndarray):
        return where(condition, 1.0, 0.0)
    return compared.choices.where(condition, 1.0, 0.0)


def magnitude(value: Any) -> Any:
    """Return a number without its sign."""
    return where(value < 0.0, -value, value)


def square_root(value: Any) -> Any:
    """Return the square root of a number that is not negative."""
    if hasattr(value, "choices"):
        return value.choices.call("llvm.sqrt", value)
    return np.sqrt(value)


def rounded(value: Any) -> Any:
    """Return the nearest whole number; of two that are as near, the even one."""
    if hasattr(value, "choices"):
        return value.choices.call("llvm.rint", value)
    return np.rint(value)


def array(elements: Sequence[Any]) -> np.ndarray:
    """Return an object array in which numbers are Python floats.

    It is filled one by one, since ``np.array`` would look into elements that are sequences. Python
    floats, and not those of NumPy, leave their products with symbols to the symbols.
    """
    objects = np.empty(len(elements), dtype=object)
    for i, element in enumerate(elements):
        objects[i] = float(element) if isinstance(element, float | int) else element
    return objects


def is_zero(element: Any) -> bool:
    """Return whether an element is known to be zero, so that its products can be left out."""
    return isinstance(element, float) and element == 0.0


def cross_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product, shape (3,)."""
    return array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def common_factor(numbers: np.ndarray) -> tuple[Any, np.ndarray]:
    """Return a factor of all numbers that are not known to be zero, and the numbers without it.

    Values of a program know the product that they are. Other numbers have the factor 1.
    """
    present = [number for number in numbers if not is_zero(number)]
    if len(present) > 1 and all(hasattr(number, "choices") for number in present):
        return present[0].choices.common_factor(numbers)
    return 1.0, numbers


def solve_linear(mass: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve mass @ x = right for a symmetric positive definite matrix.

    Elements that are known to be zero, between branches of the tree, take no code: a value of a
    program times the float 0 is folded to 0.

    Unknowns are eliminated from the last, two at a time. A 2 × 2 block takes one division by its
    determinant; two pivots one after the other would take two, the second of which depends on the
    first. With the last block B, its coupling C to the unknowns before, and the right sides r and
    rB, those before solve

        (A - Cᵀ B⁻¹ C) x = r - Cᵀ B⁻¹ rB     and then     xB = B⁻¹ (rB - C x),

    where B⁻¹ = adj(B)/det(B). Where at most two unknowns are left, their equations are multiplied
    by det(B) instead, so that they do not wait for its division.
    """
    lower = mass.copy()  # only the lower triangle is used
    x = right.copy()
    eliminated: list[_EliminatedBlock] = []
    end = len(mass)
    while end:
        # A last pivot that is a float takes no division in code, so that it is eliminated alone.
        is_alone = end == 1 or isinstance(lower[end - 1, end - 1], float)
        begin = end - (1 if is_alone else 2)
        adjugate, determinant = _adjugate(lower[begin:end, begin:end])
        if begin > 2:
            adjugate = adjugate * (1.0 / determinant)
            determinant = np.ones(1)
        shares = adjugate @ lower[begin:end, :begin]
        scale = determinant[0]
        for i in range(begin):
            for j in range(i + 1):
                lower[i, j] = lower[i, j] * scale - shares[:, i] @ lower[begin:end, j]
            x[i] = x[i] * scale - shares[:, i] @ x[begin:end]
        x[begin:end] = adjugate @ x[begin:end]
        eliminated.append(_EliminatedBlock(begin, end, 1.0 / determinant, shares))
        end = begin
    for block in reversed(eliminated):
        known = x[: block.begin]
        coupled = x[block.begin : block.end] - block.shares @ known
        x[block.begin : block.end] = coupled * block.inverse_determinant
    return x


class _EliminatedBlock(NamedTuple):
    """One or two unknowns that `solve_linear` eliminated.

    Attributes:
        begin: The first of them.
        end: The one after the last.
        inverse_determinant: Factor on their values, shape (1,).
        shares: Their changes with the unknowns before, before that factor, shape (1 or 2, begin).
    """

    begin: int
    end: int
    inverse_determinant: np.ndarray
    shares: np.ndarray


def _adjugate(block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the adjugate and determinant, shape (1,), from the lower triangle of a symmetric
    matrix of one row or two.
    """
    if len(block) == 1:
        return np.ones((1, 1)), block[0]
    a = block[0, 0]
    c = block[1, 0]
    b = block[1, 1]
    return array([b, -c, -c, a]).reshape(2, 2), array([a * b - c * c])
