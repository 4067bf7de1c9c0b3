"""Noise of recorded channels, tests of whiteness, and the covariance of the parameters."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from cranedyn.errors import DataError
from cranedyn.identification.model import Model

WHITE = 1e-3
"""Significance level of the test: share of white residuals that it rejects."""

_LAGS, _FLOOR = 20, 1e-13


def initial_noise(model: Model) -> list[np.ndarray]:
    """Return the noise of each channel, from its second differences: those of a smooth signal are
    small.

    It is at least a hundred thousandth of the channel's range.
    """
    noise = []
    for index in range(len(model.records)):
        measured = model.measured(index)
        bent = np.diff(measured, 2, axis=1)
        spread = np.sqrt(np.mean(bent**2, axis=1) / 6.0)
        noise.append(np.maximum(spread, 1e-5 * np.ptp(measured, axis=1) + 1e-12))
    return noise


def residual_noise(
    model: Model, residuals: list[np.ndarray] | tuple[np.ndarray, ...]
) -> list[np.ndarray]:
    """Return the noise of each channel from its residual, corrected for the degrees of freedom of
    the parameters.
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
    """Return whether a residual has no autocorrelation, by Ljung and Box (1978) at 0.1 %."""
    off = residual - residual.mean()
    power, n = float(off @ off), len(off)
    if power <= 0.0 or n <= 2 * _LAGS:
        return True
    rho = np.array([off[k:] @ off[:-k] for k in range(1, _LAGS + 1)]) / power
    statistic = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, _LAGS + 1))))
    return bool(chi2.sf(statistic, _LAGS) > WHITE)


def covariance_of(
    model: Model,
    jacobians: list[np.ndarray],
    residuals: tuple[np.ndarray, ...],
    noise: list[np.ndarray],
    white: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Return the covariance of the parameters: that of least squares, or, where a residual is not
    white and that is wider, that of autocorrelated errors (Newey and West 1987, over a tenth of the
    record). It is infinite for a parameter that the records do not determine.
    """
    scale, count = model.scale, len(model.parameters)
    bread, meat = np.zeros((count, count)), np.zeros((count, count))
    for jacobian, residual, spread, is_plain in zip(
        jacobians, residuals, noise, white, strict=True
    ):
        for slope, off, sigma, simple in zip(jacobian, residual, spread, is_plain, strict=True):
            weighted = slope * scale / sigma
            outer = weighted.T @ weighted
            bread += outer
            meat += outer if simple else _long_run(weighted * (off / sigma)[:, None])
    inverse, determined = invert_information(bread)
    remembered = inverse @ meat @ inverse
    short, long = np.diag(inverse), np.diag(remembered)
    wider = scale * np.sqrt(np.maximum(short, long) / np.where(long > 0.0, long, 1.0))
    covariance = wider[:, None] * remembered * wider
    covariance[~determined, ~determined] = np.inf
    return covariance


def invert_information(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the inverse of an information matrix, and which parameters it determines, shape
    (parameters,).

    Eigenvalues near zero are floored: such directions keep a large variance, where a
    pseudoinverse would give none.
    """
    size = np.sqrt(np.diag(information))
    determined = size > 0.0
    unit = np.where(determined, size, 1.0)
    share, axes = np.linalg.eigh(information / np.outer(unit, unit))
    inverse = (axes / np.maximum(share, _FLOOR)) @ axes.T
    inverse[~determined] = inverse[:, ~determined] = 0.0
    return inverse / np.outer(unit, unit), determined


def _long_run(scores: np.ndarray) -> np.ndarray:
    """Return the long-run covariance of scores, shape (rows, parameters), with Bartlett's
    weights.
    """
    reach = max(1, len(scores) // 10)
    covariance = scores.T @ scores
    for lag in range(1, reach + 1):
        cross = scores[lag:].T @ scores[:-lag]
        covariance += (1.0 - lag / (reach + 1.0)) * (cross + cross.T)
    return covariance
