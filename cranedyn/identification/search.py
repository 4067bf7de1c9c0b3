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
    low, high = model.bounds
    room = np.minimum(_ROOM * np.abs(model.steps), 0.1 * (high - low)) * (model.sensitivity > 0.0)
    return np.clip(model.first, low + room, high - room)


class Search:
    """Search for the values of the parameters that fit the records best.

    Attributes:
        evaluations: Number of predictions of the records so far.
    """

    def __init__(
        self, model: Model, progress: Callable[[int], object] | None, evaluations: int
    ) -> None:
        self.model, self.evaluations, self._progress = model, evaluations, progress

    def solve(self, values: np.ndarray, noise: list[np.ndarray], share: float) -> np.ndarray:
        """Solve the least squares over a share of each record, from initial values.

        Raises:
            DataError: If the crane cannot be simulated from there.
        """
        scale = self.model.scale
        low, high = (end / scale for end in self.model.bounds)
        begin = np.clip(values / scale, low + 1e-9, high - 1e-9)
        residual, slope = self._linearise(begin * scale, noise, share)
        if not np.isfinite(residual).all():
            raise DataError(
                "The crane cannot be simulated through the record from where the search begins; "
                "say better what is known of it."
            )
        free = slope.any(axis=0)  # the others keep their values

        def expand(z: np.ndarray) -> np.ndarray:
            scaled = begin.copy()
            scaled[free] = z
            return scaled * scale

        # The solver asks for the Jacobian at the point of its last residual.
        last = {(begin * scale).tobytes(): _reduced(residual, slope, scale)}

        def evaluate(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            point = expand(z)
            if (key := point.tobytes()) not in last:
                residual, slope = self._linearise(point, noise, share)
                last.clear()
                last[key] = _reduced(residual, slope, scale)
            return last[key]

        close = _CLOSE if share == 1.0 else _NEAR
        solution = least_squares(
            lambda z: evaluate(z)[0],
            begin[free],
            jac=lambda z: (evaluate(z)[1] * scale)[:, free],
            bounds=(low[free], high[free]),
            x_scale="jac",
            ftol=close,
            xtol=close,
            gtol=None,
            max_nfev=_MOST,
        )
        return expand(solution.x)

    def _linearise(
        self, values: np.ndarray, noise: list[np.ndarray], share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals of all records over the noise, and their derivatives, shapes (rows,)
        and (rows, parameters).
        """
        residuals, slopes = [], []
        for index, (record, deviation) in enumerate(zip(self.model.records, noise, strict=True)):
            until = max(share * record.duration, min(_LEAST, record.duration))
            off, slope = jacobian(self.model, values, index, until)
            weight = 1.0 / deviation[:, None]
            residuals.append((off * weight).ravel())
            slopes.append((slope * weight[:, :, None]).reshape(-1, len(values)))
        self.evaluations += 1
        if self._progress is not None:
            self._progress(self.evaluations)
        return np.concatenate(residuals), np.concatenate(slopes)


def _reduced(
    residual: np.ndarray, slope: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a residual and its Jacobian, reduced by a QR decomposition that keeps norms and inner
    products, shapes (parameters + 1,) and (parameters + 1, parameters).
    """
    wild = ~np.isfinite(residual)
    residual, slope = np.where(wild, _FAR, residual), np.where(wild[:, None], 0.0, slope)
    turned, upright = np.linalg.qr(slope * scale)
    along = turned.T @ residual
    beside = float(np.sqrt(max(residual @ residual - along @ along, 0.0)))
    return np.append(along, beside), np.vstack([upright, np.zeros((1, len(scale)))]) / scale


def jacobian(
    model: Model, values: np.ndarray, index: int, until: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Return predicted less recorded of one record, shape (channels, rows), and its derivatives by
    the parameters, shape (channels, rows, parameters).
    """
    steps = np.where(values + model.steps > model.bounds[1], -1.0, 1.0) * model.steps
    outputs = model.variations(index, values, steps, until)
    slope = np.zeros((*outputs.shape[1:], len(values)))
    measured = model.measured(index, until)
    threshold = ROUND_OFF * (measured.max(axis=1) - measured.min(axis=1))[:, None]
    for lane, i in enumerate(model.of_record(index), start=1):
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
