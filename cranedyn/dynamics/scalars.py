"""Choices and comparisons on any kind of number, so that physics is written once.

A number is a float, an array of floats (many rows at once), or a value of a program under construction, which brings its own way to
choose as `choices`.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def chosen(condition: Any, yes: Any, no: Any) -> Any:
    """One number where a condition holds, another where not.

    Args:
        condition: What a comparison of two such numbers gives. Never that of two arrays of objects: NumPy takes all of theirs for true.
        yes, no: Numbers.
    """
    if isinstance(condition, bool | np.bool_):
        return yes if condition else no
    if isinstance(condition, np.ndarray):
        return np.where(condition, yes, no)
    return next(number for number in (yes, no) if hasattr(number, "choices")).choices.chosen(condition, yes, no)


def clipped(value: Any, low: Any, high: Any) -> Any:
    """A number cut to a range; what is not a number stays."""
    value = chosen(value < low, low, value)
    return chosen(value > high, high, value)
