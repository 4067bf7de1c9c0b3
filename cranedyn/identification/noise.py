"""Noise of what was recorded, whether it is white, and what follows for the parameters."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from cranedyn.errors import DataError
from cranedyn.identification.model import Model

WHITE = 1e-3
"""Share of white residuals that the test takes for others."""

_LAGS, _FLOOR = 20, 1e-13


def initial_noise(model: Model) -> list[np.ndarray]:
    """Noise of each channel as its second differences show it: what is smooth has little of them.

    No less than a hundred thousandth of its range.
    """
    found = []
    for index in range(len(model.records)):
        measured = model.measured(index)
        bent = np.diff(measured, 2, axis=1)
        spread = np.sqrt(np.mean(bent**2, axis=1) / 6.0)
        found.append(np.maximum(spread, 1e-5 * np.ptp(measured, axis=1) + 1e-12))
    return found


def noise_of(
    model: Model, residuals: list[np.ndarray] | tuple[np.ndarray, ...]
) -> list[np.ndarray]:
    """Noise of each channel as its residual shows it, with the rows that parameters cost."""
    total = sum(one.size for one in residuals)
    free = total - len(model.parameters)
    if free <= 0:
        raise DataError(
            f"The records have {total} numbers for {len(model.parameters)} parameters; allowed are "
            "more numbers than parameters."
        )
    return [np.maximum(np.sqrt(np.mean(one**2, axis=1) * total / free), 1e-14) for one in residuals]


def is_white(residual: np.ndarray) -> bool:
    """Whether a residual has no memory, by Ljung and Box (1978) at 0.1 %."""
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
    """Return the covariance of the parameters: that of least squares, or where a residual is not
    white and that is wider, that of errors with a memory (Newey and West 1987, over a tenth of the
    record). Infinite for a parameter of which the records say nothing.
    """
    scale, count = model.scale, len(model.parameters)
    bread, meat = np.zeros((count, count)), np.zeros((count, count))
    for part, left, spread, plain in zip(jacobians, residuals, noise, white, strict=True):
        for slope, off, sigma, simple in zip(part, left, spread, plain, strict=True):
            weighted = slope * scale / sigma
            own = weighted.T @ weighted
            bread += own
            meat += own if simple else _remembering(weighted * (off / sigma)[:, None])
    inverse, told = inverted(bread)
    remembered = inverse @ meat @ inverse
    plain, long = np.diag(inverse), np.diag(remembered)
    wider = scale * np.sqrt(np.maximum(plain, long) / np.where(long > 0.0, long, 1.0))
    found = wider[:, None] * remembered * wider
    found[~told, ~told] = np.inf
    return found


def inverted(known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of information, and of which parameters it says anything, shape (parameters,).

    What it hardly tells apart keeps a large variance, not the none that a pseudoinverse gives.
    """
    size = np.sqrt(np.diag(known))
    told = size > 0.0
    unit = np.where(told, size, 1.0)
    share, axes = np.linalg.eigh(known / np.outer(unit, unit))
    inverse = (axes / np.maximum(share, _FLOOR)) @ axes.T
    inverse[~told] = inverse[:, ~told] = 0.0
    return inverse / np.outer(unit, unit), told


def _remembering(scores: np.ndarray) -> np.ndarray:
    """Long-run covariance of scores, shape (rows, parameters), with Bartlett's weights."""
    reach = max(1, len(scores) // 10)
    found = scores.T @ scores
    for lag in range(1, reach + 1):
        cross = scores[lag:].T @ scores[:-lag]
        found += (1.0 - lag / (reach + 1.0)) * (cross + cross.T)
    return found
