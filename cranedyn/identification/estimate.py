"""Least squares over all records at once, with confidence intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc, stdtrit

from cranedyn.errors import DataError, UnknownName
from cranedyn.identification.least_squares import (
    HORIZONS,
    Search,
    check_units,
    first_values,
    jacobian,
)
from cranedyn.identification.record_prediction import Model

CONFIDENCE = 0.95
"""Confidence level of the intervals."""

WHITENESS_LEVEL = 1e-3
"""Significance level of the test for white residuals: the share of white ones that it rejects."""

EXPLAINED_SHARE = 0.9
"""Share of the variance of a swing that an estimate must explain to be believed."""

SIGN_EVIDENCE = 10.0
"""How much larger the logarithm of the likelihood must be with the other sign of a swing than with
the recorded one, for the other one to be taken. Residuals that are not white make a difference look
several times as sure as it is."""

_WHITENESS_LAGS = 20
"""Number of lags of the test for white residuals."""

_MIN_EIGENVALUE = 1e-13
"""Least eigenvalue of a correlation matrix that is not round-off."""

_REPEATED_MEASUREMENTS = 24
"""How often smoothed motions are measured again to see how far estimates move. The standard
deviation of so many draws is known within 15 %."""


class Interval(NamedTuple):
    """Estimate of a parameter, in its unit.

    Attributes:
        value: The estimate.
        margin: Half the width of its 95 % confidence interval; inf where the records do not
            determine the parameter.
    """

    value: float
    margin: float


@dataclass(frozen=True)
class SignDecision:
    """With which sign a swing was taken, where the estimate did not explain it as recorded.

    Attributes:
        column: Name of the column.
        is_turned: Whether the other sign was taken.
        as_recorded: Largest logarithm of the likelihood of the records with the recorded sign.
        turned: The same with the other sign.
    """

    column: str
    is_turned: bool
    as_recorded: float
    turned: float


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
        signs: Decisions about the signs of swings; none where the swings are explained as they
            were recorded, or the user stated their signs.
    """

    model: Model
    values: np.ndarray
    covariance: np.ndarray
    noise: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    white: tuple[np.ndarray, ...]
    evaluations: int
    signs: tuple[SignDecision, ...] = ()

    def value(self, name: str) -> float:
        """Return the estimate of a parameter of the crane, in its unit.

        Raises:
            UnknownName: If it was not estimated.
        """
        return self._interval(name).value

    def margin(self, name: str) -> float:
        """Return half the width of the 95 % confidence interval of a parameter of the crane; inf
        where the records do not determine it.
        """
        return self._interval(name).margin

    def _interval(self, name: str) -> Interval:
        """Return the interval of a parameter of the crane.

        Raises:
            UnknownName: If it was not estimated.
        """
        if name not in self.intervals:
            raise UnknownName("parameter", name, self.intervals)
        return self.intervals[name]

    @cached_property
    def quantile(self) -> float:
        """Half width of an interval over the standard error: the quantile of Student's t."""
        rows = sum(residual.size for residual in self.residuals)
        return float(stdtrit(max(rows - len(self.values), 1), 0.5 + CONFIDENCE / 2.0))

    @cached_property
    def intervals(self) -> dict[str, Interval]:
        """Values and half widths of all parameters of the crane, by name."""
        margins = (self.quantile * np.sqrt(np.diag(self.covariance))).tolist()
        values = self.values.tolist()
        # The parameters of the crane are the first ones; those of the records follow.
        return {p.name: Interval(values[i], margins[i]) for i, p in enumerate(self.model.own)}

    @property
    def arguments(self) -> dict[str, float]:
        """Values of the estimated arguments of the crane, gravity among them, by name."""
        return {p.name: self.value(p.name) for p in self.model.parameters if p.kind == "argument"}

    @cached_property
    def not_white(self) -> tuple[str, ...]:
        """Columns whose residual is not white noise, each with the name of its record."""
        names = []
        for i, record in enumerate(self.model.records):
            for channel, is_channel_white in zip(
                self.model.channels[i], self.white[i], strict=True
            ):
                if not is_channel_white:
                    names.append(f"{record.name}: {channel.column}")
        return tuple(names)

    @cached_property
    def least_explained(self) -> tuple[float, str]:
        """Least share of the variance of a swing that the model explains, and its column with its
        record.
        """
        model = self.model
        shares = []
        for i, record in enumerate(model.records):
            measured = model.measured(i)
            for c, channel in enumerate(model.channels[i]):
                if channel.kind != "swing":
                    continue
                # A swing that is constant where it is evaluated has no variance to explain.
                variance = np.var(measured[c]) or np.inf
                share = 1.0 - float(np.mean(self.residuals[i][c] ** 2) / variance)
                shares.append((share, f"{channel.column} of {record.name}"))
        return min(shares)

    @cached_property
    def log_likelihood(self) -> float:
        """Logarithm of the likelihood of the records, of white normal errors whose variance is that
        of the residual of each channel.
        """
        # With the variance s² of n residuals the logarithm is -n/2 (ln(2 π s²) + 1).
        total = 0.0
        for record in self.residuals:
            for residual in record:
                variance = max(float(np.mean(residual**2)), 1e-28)
                total -= 0.5 * residual.size * (math.log(2.0 * math.pi * variance) + 1.0)
        return total

    @cached_property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that ended at a bound; their intervals are meaningless."""
        names = []
        for p, value in zip(self.model.parameters, self.values.tolist(), strict=True):
            distance = min(value - p.low, p.high - value)
            if distance < 1e-3 * p.scale:
                names.append(p.name)
        return tuple(names)


def identify(model: Model, *, progress: Callable[[int], object] | None = None) -> Estimate:
    """Estimate the parameters of a model by least squares, each channel weighted by its noise.

    Finite differences give the Jacobian; its columns are simulated in one batch. If the estimate
    explains less than `EXPLAINED_SHARE` of a swing, the search begins again from other delays of
    the swing sensor, with each sign of each swing that the user did not state, and the most likely
    estimate counts. Its `Estimate.model` has the records with the signs found, and `Estimate.signs`
    says how likely each is.

    Args:
        model: Records and parameters.
        progress: Called with the number of predictions so far.

    Raises:
        DataError: If the swing is in degrees, the crane cannot be simulated through a record, or
            there are fewer rows than parameters.
    """
    check_units(model)
    first = _fit(model, progress)
    if first.least_explained[0] >= EXPLAINED_SHARE:
        return first
    results = [first]
    done = first.evaluations
    for alternative in model.alternatives():
        results.append(_fit(alternative, progress, done))
        done = results[-1].evaluations
    best = max(results, key=_preference)
    return replace(best, evaluations=done, signs=_sign_decisions(results, best))


def _turned_columns(estimate: Estimate) -> set[str]:
    """Return the names of the swings that were taken with the other sign."""
    turned = set()
    for record in estimate.model.records:
        turned |= {column for column, sign in record.signs.items() if sign < 0}
    return turned


def _preference(estimate: Estimate) -> float:
    """Return the number by which estimates with swings of either sign are compared: the logarithm
    of the likelihood, and `SIGN_EVIDENCE` less for each sign that is not the recorded one.
    """
    return estimate.log_likelihood - SIGN_EVIDENCE * len(_turned_columns(estimate))


def _sign_decisions(results: list[Estimate], best: Estimate) -> tuple[SignDecision, ...]:
    """Return the decisions about the signs of swings that were tried either way."""
    turned_columns = [_turned_columns(result) for result in results]
    decisions: list[SignDecision] = []
    for column in sorted(set().union(*turned_columns)):
        as_recorded: list[float] = []
        turned: list[float] = []
        for result, columns in zip(results, turned_columns, strict=True):
            likelihoods = turned if column in columns else as_recorded
            likelihoods.append(result.log_likelihood)
        if as_recorded and turned:
            is_turned = column in _turned_columns(best)
            decisions.append(SignDecision(column, is_turned, max(as_recorded), max(turned)))
    return tuple(decisions)


def _fit(model: Model, progress: Callable[[int], object] | None, before: int = 0) -> Estimate:
    """Estimate the parameters from the first values of a model.

    Args:
        model: Records and parameters.
        progress: Called with the number of predictions so far.
        before: Number of predictions by earlier searches.
    """
    search = Search(model, progress, before)
    values = first_values(model)
    noise = initial_noise(model)
    for share in HORIZONS:
        values = search.solve(values, noise, share)
    # The weights of the channels follow from the noise, and the residuals, which show the noise,
    # from the weights: both are improved in turn until the noise hardly changes.
    for _ in range(3):
        previous = noise
        noise = residual_noise(model, _residuals(model, values))
        if all(np.allclose(a, b, rtol=0.05) for a, b in zip(noise, previous, strict=True)):
            break
        values = search.solve(values, noise, 1.0)
    residuals = _residuals(model, values)
    noise = residual_noise(model, residuals)
    white = tuple(np.array([is_white(channel) for channel in record]) for record in residuals)
    covariance = _covariance(model, values, residuals, noise, white)
    return Estimate(model, values, covariance, tuple(noise), residuals, white, search.evaluations)


def _residuals(model: Model, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return recorded less predicted of each record, shape (channels, rows)."""
    return tuple(_residual(model, index, values) for index in range(len(model.records)))


def _residual(model: Model, index: int, values: np.ndarray) -> np.ndarray:
    """Return recorded less predicted of one record, shape (channels, rows)."""
    return model.measured(index) - model.predicted(index, values[None])[0]


def initial_noise(model: Model) -> list[np.ndarray]:
    """Return the noise of each channel, from its second differences: those of a smooth signal are
    small.

    It is at least a hundred thousandth of the channel's range.
    """
    noise = []
    for index in range(len(model.records)):
        measured = model.measured(index)
        # A second difference of white noise has 1 + 4 + 1 times its variance.
        differences = np.diff(measured, 2, axis=1)
        deviation = np.sqrt(np.mean(differences**2, axis=1) / 6.0)
        noise.append(np.maximum(deviation, 1e-5 * np.ptp(measured, axis=1) + 1e-12))
    return noise


def residual_noise(model: Model, residuals: tuple[np.ndarray, ...]) -> list[np.ndarray]:
    """Return the noise of each channel from its residual, corrected for the degrees of freedom of
    the parameters.

    Raises:
        DataError: If there are no more numbers than parameters.
    """
    total = sum(residual.size for residual in residuals)
    free = total - len(model.parameters)
    if free <= 0:
        raise DataError(
            f"The records have {total} numbers for {len(model.parameters)} parameters; allowed are "
            "more numbers than parameters."
        )
    return [
        np.maximum(np.sqrt(np.mean(residual**2, axis=1) * total / free), 1e-14)
        for residual in residuals
    ]


def is_white(residual: np.ndarray) -> bool:
    """Return whether a residual has no autocorrelation, by the test of Ljung and Box (1978) at the
    level `WHITENESS_LEVEL`.

    Of white noise, Q = n (n + 2) Σ ρ_k² / (n - k) over the autocorrelations ρ_k of the first lags
    has a chi-squared distribution. A residual that is too short to be tested counts as white.
    """
    deviation = residual - residual.mean()
    power = float(deviation @ deviation)
    n = len(deviation)
    if power <= 0.0 or n <= 2 * _WHITENESS_LAGS:
        return True
    lags = np.arange(1, _WHITENESS_LAGS + 1)
    rho = np.array([deviation[k:] @ deviation[:-k] for k in lags.tolist()]) / power
    statistic = n * (n + 2) * float(np.sum(rho**2 / (n - lags)))
    return bool(chdtrc(_WHITENESS_LAGS, statistic) > WHITENESS_LEVEL)


def _covariance(
    model: Model,
    values: np.ndarray,
    residuals: tuple[np.ndarray, ...],
    noise: list[np.ndarray],
    white: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Return the covariance of the parameters, shape (parameters, parameters): that of least
    squares, or, where a residual is not white and that is wider, that of autocorrelated errors; and
    what errors of the motions of the drives add. The variance of a parameter that the records do
    not determine is infinite.

    With J the Jacobian of the residuals over their noise, least squares have the covariance
    (JᵀJ)⁻¹ if the errors are white. Otherwise it is (JᵀJ)⁻¹ M (JᵀJ)⁻¹, with M the long-run
    covariance of the scores.

    Source: Newey and West, Econometrica 55 (1987), 703-708.
    """
    scale = model.scale
    count = len(model.parameters)
    slopes = [jacobian(model, values, index).slope for index in range(len(model.records))]
    information = np.zeros((count, count))
    for index in range(len(model.records)):
        for c, slope in enumerate(slopes[index]):
            weighted = slope * scale / noise[index][c]
            information += weighted.T @ weighted
    inverse, determined = invert_information(information)

    # (JᵀJ)⁻¹ is applied to the rows before they are summed. It is huge where the records hardly
    # tell two parameters apart, and between two such factors the round-off of a summed M would
    # outweigh the variance and might even turn its sign.
    autocorrelated = np.zeros((count, count))
    for index in range(len(model.records)):
        for c, slope in enumerate(slopes[index]):
            sigma = noise[index][c]
            influence = (slope * scale / sigma) @ inverse
            if white[index][c]:
                autocorrelated += influence.T @ influence
            else:
                autocorrelated += long_run(influence * (residuals[index][c] / sigma)[:, None])

    # Each parameter gets the larger of both variances; correlations are those of the second.
    long_variance = np.diag(autocorrelated)
    largest = np.maximum(np.diag(inverse), long_variance)
    ratio = largest / np.where(long_variance > 0.0, long_variance, 1.0)
    widening = scale * np.sqrt(ratio)
    covariance = widening[:, None] * autocorrelated * widening
    np.fill_diagonal(covariance, scale**2 * largest)
    covariance[~determined, ~determined] = np.inf
    return covariance + _motion_covariance(model, values, slopes, noise, inverse)


def _motion_covariance(
    model: Model,
    values: np.ndarray,
    slopes: list[np.ndarray],
    noise: list[np.ndarray],
    inverse: np.ndarray,
) -> np.ndarray:
    """Return the covariance that errors of smoothed motions of the drives add, shape (parameters,
    parameters).

    A residual does not tell it: a drive that stands is rounded in the same way in each row, and
    what a wrong motion does to a swing is seldom larger than the noise of its sensor. So the
    smoothed motion is rounded and smoothed once more, on grids that lie otherwise, and the
    estimates move with what this changes in the residuals, to first order: a change δ of the
    residuals moves the estimates by (JᵀJ)⁻¹ Jᵀ δ.

    Args:
        model: Records and parameters.
        values: Estimates, shape (parameters,).
        slopes: Derivatives of the residuals of each record, shape (channels, rows, parameters).
        noise: Standard deviation of each channel of each record.
        inverse: (JᵀJ)⁻¹ in the scales of the parameters, shape (parameters, parameters).
    """
    scale = model.scale
    count = len(model.parameters)
    covariance = np.zeros((count, count))
    if not any(record.curves for record in model.records):
        return covariance
    rng = np.random.default_rng(0)
    # Where a grid lies is drawn evenly: each draw is the middle of one of equal parts of -1/2 to
    # 1/2.
    strata = (np.arange(_REPEATED_MEASUREMENTS) + 0.5) / _REPEATED_MEASUREMENTS - 0.5
    for index, record in enumerate(model.records):
        # Each shift of a grid once for each drive, in an order of its own.
        shifts = {key: rng.permutation(strata) for key in record.curves}
        unchanged = _residual(model, index, values)
        for draw in range(_REPEATED_MEASUREMENTS):
            shift = {key: float(order[draw]) for key, order in shifts.items()}
            records = list(model.records)
            records[index] = record.measured_again(shift, rng)
            change = _residual(replace(model, records=tuple(records)), index, values) - unchanged
            score = np.zeros(count)
            for c, slope in enumerate(slopes[index]):
                sigma = noise[index][c]
                score += (slope * scale / sigma).T @ (change[c] / sigma)
            shift_of_estimates = scale * (inverse @ score)
            outer = np.outer(shift_of_estimates, shift_of_estimates)
            covariance += outer / _REPEATED_MEASUREMENTS
    return covariance


def invert_information(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse of an information matrix, and which parameters it determines, shape
    (parameters,).

    Eigenvalues near zero are floored: such directions keep a large variance, where a
    pseudoinverse would give none.
    """
    # Round-off may leave a number below zero where nothing is determined.
    root = np.sqrt(np.maximum(np.diag(information), 0.0))
    determined = root > 0.0
    unit = np.where(determined, root, 1.0)
    # A matrix with ones on its diagonal has eigenvalues that do not depend on units.
    eigenvalues, eigenvectors = np.linalg.eigh(information / np.outer(unit, unit))
    inverse = (eigenvectors / np.maximum(eigenvalues, _MIN_EIGENVALUE)) @ eigenvectors.T
    inverse[~determined] = 0.0
    inverse[:, ~determined] = 0.0
    return inverse / np.outer(unit, unit), determined


def long_run(scores: np.ndarray) -> np.ndarray:
    """Return the long-run covariance of scores, shape (rows, parameters): the sum of their
    autocovariances over all lags up to a tenth of the record.

    Bartlett's weights, which fall linearly with the lag, keep it positive semidefinite (Newey and
    West 1987).
    """
    max_lag = max(1, len(scores) // 10)
    covariance = scores.T @ scores
    for lag in range(1, max_lag + 1):
        cross = scores[lag:].T @ scores[:-lag]
        covariance += (1.0 - lag / (max_lag + 1.0)) * (cross + cross.T)
    return covariance
