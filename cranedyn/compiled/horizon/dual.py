"""Dual numbers: values with their derivatives by some variables.

The value and the derivatives may be floats, or values of code under construction. The derivatives
of the equations of motion are computed by running these once on dual numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cranedyn.dynamics.scalars import array, is_zero


class Dual:
    """Number of any kind with its derivatives by some variables.

    Attributes:
        value: The number.
        slopes: Its derivatives; products with a float 0 are not computed.
    """

    __slots__ = ("slopes", "value")

    def __init__(self, value: Any, slopes: Sequence[Any]) -> None:
        self.value = value
        self.slopes = slopes

    def _of_two(self, value: Any, by_self: Any, operand: Dual, by_operand: Any) -> Dual:
        """Return a function f of this number and another, given f and its partial derivatives."""
        slopes = []
        for own, other in zip(self.slopes, operand.slopes, strict=True):
            slopes.append(by_self * own + by_operand * other)
        return Dual(value, slopes)

    def _of_one(self, value: Any, derivative: Any) -> Dual:
        """Return a function f of this number, given f and its derivative."""
        return Dual(value, [derivative * slope for slope in self.slopes])

    def __add__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            return self._of_two(self.value + operand.value, 1.0, operand, 1.0)
        return Dual(self.value + operand, self.slopes)

    __radd__ = __add__

    def __sub__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            return self._of_two(self.value - operand.value, 1.0, operand, -1.0)
        return Dual(self.value - operand, self.slopes)

    def __rsub__(self, operand: Any) -> Dual:
        return self._of_one(operand - self.value, -1.0)

    def __mul__(self, operand: Any) -> Any:
        if isinstance(operand, Dual):
            return self._of_two(self.value * operand.value, operand.value, operand, self.value)
        return 0.0 if is_zero(operand) else self._of_one(self.value * operand, operand)

    __rmul__ = __mul__

    def __truediv__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            value = self.value / operand.value
            return self._of_two(value, 1.0 / operand.value, operand, -(value / operand.value))
        return self._of_one(self.value / operand, 1.0 / operand)

    def __neg__(self) -> Dual:
        return self._of_one(-self.value, -1.0)

    def sin(self) -> Dual:
        """Return the sine of an angle [rad]."""
        return self._of_one(np.sin(self.value), np.cos(self.value))

    def cos(self) -> Dual:
        """Return the cosine of an angle [rad]."""
        return self._of_one(np.cos(self.value), -np.sin(self.value))


def variables(*groups: np.ndarray) -> list[np.ndarray]:
    """Return groups of values as independent variables of one set of derivatives.

    The derivatives are by the values of the first group, then by those of the next, and so on.
    """
    count = sum(len(group) for group in groups)
    unit_vectors = np.eye(count).tolist()
    dual_groups = []
    first = 0
    for group in groups:
        duals = [Dual(value, unit_vectors[first + i]) for i, value in enumerate(group)]
        dual_groups.append(array(duals))
        first += len(group)
    return dual_groups


def constants(values: np.ndarray, count: int) -> np.ndarray:
    """Return values whose derivatives by `count` variables are zero."""
    return array([Dual(value, [0.0] * count) for value in values])


def slopes(numbers: np.ndarray, count: int) -> np.ndarray:
    """Return the derivatives of numbers by `count` variables, shape (numbers, count).

    Numbers that depend on no variable may be plain: their derivatives are zero.
    """
    derivatives = np.zeros((len(numbers), count), dtype=object)
    for row, number in zip(derivatives, numbers, strict=True):
        row[:] = number.slopes if isinstance(number, Dual) else [0.0] * count
    return derivatives
