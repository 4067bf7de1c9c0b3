"""Cranes that differ in a few numbers, interpolated between two loaded cranes for each number.

Masses, inertias, damping and gravity enter a model linearly. Linearity in the changed numbers is
checked once, against a loaded crane.
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
    """Cranes as a function of some arguments.

    Attributes:
        names: Names of the arguments.
        base: Crane at the first values.
    """

    def __init__(
        self, load: Callable[..., Crane], first: Mapping[str, float], second: Mapping[str, float]
    ) -> None:
        """Load the cranes to interpolate between.

        Args:
            load: Function that loads a crane with values of the arguments.
            first: First value of each argument.
            second: Second value of each argument.

        Raises:
            ModelError: If the cranes are not linear in the arguments.
        """
        self.names, self.base = tuple(first), load(**first)
        self._first = np.array(list(first.values()))
        self._row = _row(self.base)
        steps = np.array([second[name] for name in self.names]) - self._first
        rows = [_row(load(**{**first, name: second[name]})) for name in self.names]
        self._slopes = [(row - self._row) / step for row, step in zip(rows, steps, strict=True)]
        if self.names:
            interpolated, loaded = (
                numbers(crane) for crane in (self.at(self._first + steps), load(**second))
            )
            largest = np.maximum(np.abs(loaded), 1.0)
            if (
                interpolated.shape != loaded.shape
                or (np.abs(interpolated - loaded) > _AGREES * largest).any()
            ):
                raise ModelError(
                    f"The crane depends on {', '.join(self.names)} in another way than masses, "
                    "inertias, damping and gravity do; such numbers cannot be identified."
                )

    def at(self, values: np.ndarray) -> Crane:
        """Return the crane at values of the arguments, shape (arguments,)."""
        if not self.names:
            return self.base
        row = self._row.copy()
        for slope, value, first in zip(self._slopes, values, self._first, strict=True):
            row += slope * (value - first)
        model, n = self.base.model.copy(), self.base.layout.n
        bodies = row[: 10 * n].reshape(n, 10)
        for i, inertial in enumerate(bodies, start=1):
            if inertial[0] > 0.0:
                model.inertias[i] = pin.Inertia.FromDynamicParameters(inertial)
        model.gravity.linear = np.array([0.0, 0.0, -row[-1]])
        return replace(self.base, model=model, damping=row[10 * n : 11 * n])


def _row(crane: Crane) -> np.ndarray:
    """Return the numbers that enter linearly: ten inertial numbers of each body, damping,
    gravity.
    """
    bodies = [inertia.toDynamicParameters() for inertia in list(crane.model.inertias)[1:]]
    return np.concatenate([*bodies, crane.damping, [crane.gravity]])
