"""Least squares from the prior values, over ever longer stretches of the records."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from cranedyn.errors import DataError
from cranedyn.identification.model import ROUND_OFF, Model

HORIZONS = (0.125, 0.25, 0.5, 1.0)
"""Shares of a record that are fitted in turn: over a short time a wrong period is less than a turn
off, so that the search converges from far away."""

_LEAST, _MOST = 12.0, 60
_FAR, _NEAR, _CLOSE, _QUIET, _ROOM = 1e6, 1e-3, 1e-9, 0.2, 1e4


def initial_values(model: Model) -> np.ndarray:
    """Return the start of the search, shape (parameters,): the prior values, moved off the bounds
    so far that a channel changes by a hundredth of its range; a search that starts at a bound
    leaves it slowly.
    """
    ends = (np.array([getattr(p, end) for p in model.parameters]) for end in ("low", "high"))
    low, high = ends
    room = np.minimum(_ROOM * np.abs(model.steps), 0.1 * (high - low)) * (model.sensitivity > 0.0)
    return np.clip(model.first, low + room, high - room)


class Search:
    """Weighted residuals and Jacobians; the last ones are cached, since the solver asks for the
    Jacobian at the point of the last residual.
    """

    def __init__(self, model: Model, progress: Callable[[int], object] | None) -> None:
        self.model, self.evaluations, self._progress = model, 0, progress
        self._determined: np.ndarray = np.ones(len(model.parameters), dtype=bool)
        self._last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    def residual(self, values: np.ndarray, index: int) -> np.ndarray:
        """Return recorded less predicted, shape (channels, rows)."""
        predicted = self.model.predicted(index, values[None])[0]
        return self.model.measured(index) - predicted

    def solve(self, values: np.ndarray, noise: list[np.ndarray], share: float) -> np.ndarray:
        """Solve the least squares over a share of each record, from initial values."""
        model, scale = self.model, self.model.scale
        low, high = (
            np.array([getattr(p, end) for p in model.parameters]) / scale for end in ("low", "high")
        )
        self._last = None
        begin = np.clip(values / scale, low + 1e-9, high - 1e-9)
        weights = [1.0 / deviation for deviation in noise]
        self._residual_and_jacobian(begin * scale, weights, share)
        free = self._determined.copy()  # the others keep their values

        def expand(z: np.ndarray) -> np.ndarray:
            scaled = begin.copy()
            scaled[free] = z
            return scaled * scale

        close = _CLOSE if share == 1.0 else _NEAR
        solution = least_squares(
            lambda z: self._residual_and_jacobian(expand(z), weights, share)[0],
            begin[free],
            jac=lambda z: (self._residual_and_jacobian(expand(z), weights, share)[1] * scale)[
                :, free
            ],
            bounds=(low[free], high[free]),
            x_scale="jac",
            ftol=close,
            xtol=close,
            gtol=None,
            max_nfev=_MOST,
        )
        return expand(solution.x)

    def _residual_and_jacobian(
        self, values: np.ndarray, weights: list[np.ndarray], share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted residual and its Jacobian, reduced by a QR decomposition that keeps
        norms and inner products, shapes (parameters + 1,) and (parameters + 1, parameters).
        """
        key = values.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1:]
        residuals, slopes = [], []
        for index, record in enumerate(self.model.records):
            until = max(share * record.duration, min(_LEAST, record.duration))
            off, slope = jacobian(self.model, values, index, until)
            residuals.append((off * weights[index][:, None]).ravel())
            slopes.append((slope * weights[index][:, None, None]).reshape(-1, len(values)))
        self.evaluations += 1
        if self._progress is not None:
            self._progress(self.evaluations)
        residual = np.concatenate(residuals)
        if self._last is None and not np.isfinite(residual).all():
            raise DataError(
                "The crane cannot be simulated through the record from where the search begins; "
                "say better what is known of it."
            )
        wild = ~np.isfinite(residual)
        residual[wild] = _FAR
        slope = np.concatenate(slopes)
        slope[wild] = 0.0
        self._determined = np.asarray(slope.any(axis=0))
        turned, upright = np.linalg.qr(slope * self.model.scale)
        along = turned.T @ residual
        beside = float(np.sqrt(max(residual @ residual - along @ along, 0.0)))
        self._last = (
            key,
            np.append(along, beside),
            np.vstack([upright, np.zeros((1, len(values)))]) / self.model.scale,
        )
        return self._last[1:]


def jacobian(
    model: Model, values: np.ndarray, index: int, until: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Return predicted less recorded of one record, shape (channels, rows), and its derivatives by
    the parameters, shape (channels, rows, parameters).
    """
    indices = model.of_record(index)
    ends = np.array([p.high for p in model.parameters])
    steps = np.where(values + model.steps > ends, -1.0, 1.0) * model.steps
    variants = np.tile(values, (len(indices) + 1, 1))
    variants[np.arange(1, len(indices) + 1), indices] += steps[indices]
    outputs = model.predicted(index, variants, until)
    slope = np.zeros((*outputs.shape[1:], len(values)))
    measured = model.measured(index, until)
    threshold = ROUND_OFF * (measured.max(axis=1) - measured.min(axis=1))[:, None]
    for lane, i in enumerate(indices, start=1):
        change = outputs[lane] - outputs[0]
        if not (np.abs(change) <= threshold).all():
            slope[:, :, i] = change / steps[i]
    return outputs[0] - measured, slope


def check_units(model: Model) -> None:
    """Check that a swing is about as large as the recorded motion of the drives makes it.

    Raises:
        DataError: If it is some 57 times as large, as one in degrees.
    """
    if model.drives != "motion":
        return
    values, initial = model.first.copy(), {}
    for i, p in enumerate(model.parameters):
        if p.kind in ("start", "start rate"):
            initial[p.record, p.of, p.kind], values[i] = values[i], 0.0
    for index, record in enumerate(model.records):
        predicted, measured = model.predicted(index, values[None])[0], model.measured(index)
        for c, channel in enumerate(model.channels[index]):
            if channel.kind != "swing":
                continue
            symbol = model.prior.crane.layout.symbols[channel.at]
            at_first = [abs(initial[index, symbol, kind]) for kind in ("start", "start rate")]
            ours, theirs = float(np.std(predicted[c])), float(np.std(measured[c]))
            quiet = max(at_first) < _QUIET * theirs
            if quiet and ours > 1e-3 and 25.0 < theirs / ours < 130.0:
                raise DataError(
                    f"{record.name}: {channel.column} swings {theirs / ours:.3g} times as much as "
                    "the drives make it swing, as degrees do; allowed are radians. Say so: "
                    f"--columns {channel.column}={channel.column}[deg]."
                )
