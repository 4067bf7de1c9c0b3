"""Least squares over all records at once, and how sure what comes out is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from cranedyn.errors import UnknownName
from cranedyn.identification.model import Model
from cranedyn.identification.noise import covariance_of, initial_noise, is_white, noise_of
from cranedyn.identification.search import HORIZONS, Search, check_units, inside, jacobian

CONFIDENCE = 0.95
"""Of the intervals."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What was found.

    Attributes:
        model: What it was found with.
        values: Of all parameters, shape (parameters,).
        covariance: Of these, shape (parameters, parameters); a variance is inf where the records
            say nothing of a parameter.
        noise: Standard deviation of what is left of each channel of each record.
        residuals: Recorded less predicted, of each record, shape (channels, rows looked at).
        white: Whether what is left is white noise, channel by channel. Where it is not the model
            lacks something; intervals are then no narrower than those of correlated errors.
        evaluations: How often the records were predicted.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    noise: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    white: tuple[np.ndarray, ...]
    evaluations: int

    def _place(self, name: str) -> int:
        names = [one.name for one in self.model.own]
        if name not in names:
            raise UnknownName("parameter", name, names)
        return names.index(name)

    def value(self, name: str) -> float:
        """What was found of a parameter of the crane, in its unit.

        Raises:
            UnknownName: If it was not looked for.
        """
        return float(self.values[self._place(name)])

    def margin(self, name: str) -> float:
        """Half the width of its interval, which holds the truth with 95 % confidence; inf where the
        records say nothing of it.
        """
        place = self._place(name)
        return self.factor * float(np.sqrt(self.covariance[place, place]))

    @cached_property
    def factor(self) -> float:
        """Half the width of an interval over the standard error: the quantile of Student's t."""
        rows = sum(one.size for one in self.residuals)
        return float(student.ppf(0.5 + CONFIDENCE / 2.0, max(rows - len(self.values), 1)))

    @property
    def found(self) -> dict[str, tuple[float, float]]:
        """Values and half widths of all parameters of the crane, by name."""
        return {one.name: (self.value(one.name), self.margin(one.name)) for one in self.model.own}

    @property
    def found_arguments(self) -> dict[str, float]:
        """Values of the arguments of the crane that were found, gravity among them, by name."""
        return {
            one.name: self.value(one.name)
            for one in self.model.parameters
            if one.kind == "argument"
        }

    @cached_property
    def not_white(self) -> tuple[str, ...]:
        """Columns, each behind the name of its record, whose residual is not white noise."""
        model = self.model
        return tuple(
            f"{record.name}: {channel.column}"
            for record, channels, white in zip(
                model.records, model.channels, self.white, strict=True
            )
            for channel, plain in zip(channels, white, strict=True)
            if not plain
        )

    @cached_property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that ended at the end of what is allowed; their intervals say
        nothing.
        """
        ends = zip(self.model.parameters, self.values.tolist(), strict=True)
        return tuple(
            one.name
            for one, value in ends
            if min(value - one.low, one.high - value) < 1e-3 * one.scale
        )


def identify(model: Model, *, progress: Callable[[int], object] | None = None) -> Estimate:
    """Find the parameters of a model by least squares, each channel weighted by what it leaves.

    The Jacobian's columns are cranes of one batch, one beside each parameter.

    Args:
        model: Records, and what is to be found.
        progress: Called with the number of predictions made so far.

    Raises:
        DataError: If the swing is in degrees, the crane cannot be simulated through a record, or
            there are fewer rows than parameters.
    """
    check_units(model)
    search = Search(model, progress)
    values, noise = inside(model), initial_noise(model)
    for share in HORIZONS:
        values = search.solved(values, noise, share)
    for _ in range(3):
        left = [search.residual(values, i) for i in range(len(model.records))]
        found = noise_of(model, left)
        same = all(np.allclose(a, b, rtol=0.05) for a, b in zip(found, noise, strict=True))
        noise = found
        if same:
            break
        values = search.solved(values, noise, 1.0)
    residuals = tuple(search.residual(values, i) for i in range(len(model.records)))
    noise = noise_of(model, residuals)
    jacobians = [jacobian(model, values, i)[1] for i in range(len(model.records))]
    white = tuple(np.array([is_white(one) for one in part]) for part in residuals)
    covariance = covariance_of(model, jacobians, residuals, noise, white)
    return Estimate(model, values, covariance, tuple(noise), residuals, white, search.evaluations)
