"""Cranes that differ in a few numbers, made of two loaded cranes a number instead of loading each.

Masses, inertias, damping and gravity enter a model linearly; whether all that was changed does is
looked at once, against a crane that is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError
from cranedyn.model.crane import Crane
from cranedyn.plant.plant import numbers

_AGREES = 1e-9


class Family:
    """Cranes by the values of some arguments.

    Attributes:
        names: Of the arguments.
        base: The crane at the first values.
    """

    def __init__(
        self, load: Callable[..., Crane], first: Mapping[str, float], other: Mapping[str, float]
    ) -> None:
        """Load the cranes that tell all others.

        Args:
            load: Makes a crane from the arguments.
            first: A value of each argument.
            other: Another value of each.

        Raises:
            ModelError: If the cranes are not linear in the arguments.
        """
        self.names, self.base = tuple(first), load(**first)
        self._first = np.array(list(first.values()))
        self._row = _row(self.base)
        away = np.array([other[name] for name in self.names]) - self._first
        rows = [_row(load(**{**first, name: other[name]})) for name in self.names]
        self._slopes = [(row - self._row) / step for row, step in zip(rows, away, strict=True)]
        if self.names:
            ours, loaded = (
                numbers(crane) for crane in (self.at(self._first + away), load(**other))
            )
            largest = np.maximum(np.abs(loaded), 1.0)
            if ours.shape != loaded.shape or (np.abs(ours - loaded) > _AGREES * largest).any():
                raise ModelError(
                    f"The crane depends on {', '.join(self.names)} in another way than masses, "
                    "inertias, damping and gravity do; such numbers cannot be identified."
                )

    def at(self, values: np.ndarray) -> Crane:
        """The crane at values of the arguments, shape (arguments,)."""
        if not self.names:
            return self.base
        row = self._row.copy()
        for slope, value, first in zip(self._slopes, values, self._first, strict=True):
            row += slope * (value - first)
        model, n = self.base.model.copy(), self.base.layout.n
        bodies = row[: 10 * n].reshape(n, 10)
        for i, own in enumerate(bodies, start=1):
            if own[0] > 0.0:
                model.inertias[i] = pin.Inertia.FromDynamicParameters(own)
        model.gravity.linear = np.array([0.0, 0.0, -row[-1]])
        return replace(self.base, model=model, damping=row[10 * n : 11 * n])


def _row(crane: Crane) -> np.ndarray:
    """What enters linearly: of each body ten inertial numbers, damping, gravity."""
    bodies = [one.toDynamicParameters() for one in list(crane.model.inertias)[1:]]
    return np.concatenate([*bodies, crane.damping, [crane.gravity]])
