"""Dual numbers: values with their derivatives."""

from __future__ import annotations

import itertools
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

    def _both(self, value: Any, mine: Any, operand: Dual, its: Any) -> Dual:
        """Return a function of two numbers, given its value and partial derivatives."""
        pairs = zip(self.slopes, operand.slopes, strict=True)
        return Dual(value, [mine * a + its * b for a, b in pairs])

    def _chain(self, value: Any, slope: Any) -> Dual:
        return Dual(value, [slope * a for a in self.slopes])

    def __add__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            return self._both(self.value + operand.value, 1.0, operand, 1.0)
        return Dual(self.value + operand, self.slopes)

    __radd__ = __add__

    def __sub__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            return self._both(self.value - operand.value, 1.0, operand, -1.0)
        return Dual(self.value - operand, self.slopes)

    def __rsub__(self, operand: Any) -> Dual:
        return self._chain(operand - self.value, -1.0)

    def __mul__(self, operand: Any) -> Any:
        if isinstance(operand, Dual):
            return self._both(self.value * operand.value, operand.value, operand, self.value)
        return 0.0 if is_zero(operand) else self._chain(self.value * operand, operand)

    __rmul__ = __mul__

    def __truediv__(self, operand: Any) -> Dual:
        if isinstance(operand, Dual):
            value = self.value / operand.value
            return self._both(value, 1.0 / operand.value, operand, -(value / operand.value))
        return self._chain(self.value / operand, 1.0 / operand)

    def __neg__(self) -> Dual:
        return self._chain(-self.value, -1.0)

    def sin(self) -> Dual:
        """Return the sine of an angle [rad]."""
        return self._chain(np.sin(self.value), np.cos(self.value))

    def cos(self) -> Dual:
        """Return the cosine of an angle [rad]."""
        return self._chain(np.cos(self.value), -np.sin(self.value))


def variables(*groups: np.ndarray) -> list[np.ndarray]:
    """Return groups of values as independent variables of one set of derivatives."""
    count = sum(map(len, groups))
    numbers = itertools.count()
    return [
        array([Dual(value, np.eye(count)[next(numbers)].tolist()) for value in group])
        for group in groups
    ]


def constants(values: np.ndarray, count: int) -> np.ndarray:
    """Return values whose derivatives by so many variables are zero."""
    return array([Dual(value, [0.0] * count) for value in values])


def slopes(numbers: np.ndarray, count: int) -> np.ndarray:
    """Return derivatives of numbers, some of which may be plain, shape (n, count)."""
    derivatives = np.zeros((len(numbers), count), dtype=object)
    for row, number in zip(derivatives, numbers, strict=True):
        row[:] = number.slopes if isinstance(number, Dual) else [0.0] * count
    return derivatives
