"""Least squares over all records at once, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import t as student

from cranedyn.errors import UnknownName
from cranedyn.identification.model import Model
from cranedyn.identification.noise import covariance_of, initial_noise, is_white, residual_noise
from cranedyn.identification.search import HORIZONS, Search, check_units, initial_values, jacobian

CONFIDENCE = 0.95
"""Confidence level of the intervals."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated parameters and their covariance.

    Attributes:
        model: Model of the records.
        values: Values of all parameters, shape (parameters,).
        covariance: Covariance of the values, shape (parameters, parameters); a variance is inf
            where the records do not determine a parameter.
        noise: Standard deviation of the residual of each channel of each record.
        residuals: Recorded less predicted, of each record, shape (channels, rows evaluated).
        white: Whether the residual of each channel is white noise. If not, the model lacks an
            effect; intervals are then no narrower than those of correlated errors.
        evaluations: Number of predictions of the records.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    noise: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    white: tuple[np.ndarray, ...]
    evaluations: int

    def _index(self, name: str) -> int:
        names = [p.name for p in self.model.own]
        if name not in names:
            raise UnknownName("parameter", name, names)
        return names.index(name)

    def value(self, name: str) -> float:
        """Return the estimate of a parameter of the crane, in its unit.

        Raises:
            UnknownName: If it was not estimated.
        """
        return float(self.values[self._index(name)])

    def margin(self, name: str) -> float:
        """Return half the width of the 95 % confidence interval of a parameter of the crane; inf
        where the records do not determine it.
        """
        i = self._index(name)
        return self.factor * float(np.sqrt(self.covariance[i, i]))

    @cached_property
    def factor(self) -> float:
        """Half width of an interval over the standard error: the quantile of Student's t."""
        rows = sum(residual.size for residual in self.residuals)
        return float(student.ppf(0.5 + CONFIDENCE / 2.0, max(rows - len(self.values), 1)))

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Values and half widths of all parameters of the crane, by name."""
        return {p.name: (self.value(p.name), self.margin(p.name)) for p in self.model.own}

    @property
    def arguments(self) -> dict[str, float]:
        """Values of the estimated arguments of the crane, gravity among them, by name."""
        return {p.name: self.value(p.name) for p in self.model.parameters if p.kind == "argument"}

    @cached_property
    def not_white(self) -> tuple[str, ...]:
        """Columns whose residual is not white noise, each with the name of its record."""
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
        """Names of parameters that ended at a bound; their intervals are meaningless."""
        ends = zip(self.model.parameters, self.values.tolist(), strict=True)
        return tuple(
            p.name for p, value in ends if min(value - p.low, p.high - value) < 1e-3 * p.scale
        )


def identify(model: Model, *, progress: Callable[[int], object] | None = None) -> Estimate:
    """Estimate the parameters of a model by least squares, each channel weighted by its noise.

    Finite differences give the Jacobian; its columns are simulated in one batch.

    Args:
        model: Records and parameters.
        progress: Called with the number of predictions so far.

    Raises:
        DataError: If the swing is in degrees, the crane cannot be simulated through a record, or
            there are fewer rows than parameters.
    """
    check_units(model)
    search = Search(model, progress)
    values, noise = initial_values(model), initial_noise(model)
    for share in HORIZONS:
        values = search.solve(values, noise, share)
    for _ in range(3):
        current = [search.residual(values, i) for i in range(len(model.records))]
        previous, noise = noise, residual_noise(model, current)
        if all(np.allclose(a, b, rtol=0.05) for a, b in zip(noise, previous, strict=True)):
            break
        values = search.solve(values, noise, 1.0)
    residuals = tuple(search.residual(values, i) for i in range(len(model.records)))
    noise = residual_noise(model, residuals)
    jacobians = [jacobian(model, values, i)[1] for i in range(len(model.records))]
    white = tuple(np.array([is_white(channel) for channel in record]) for record in residuals)
    covariance = covariance_of(model, jacobians, residuals, noise, white)
    return Estimate(model, values, covariance, tuple(noise), residuals, white, search.evaluations)
