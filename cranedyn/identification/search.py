"""The search: least squares from what one believes, over ever longer parts of the records."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from cranedyn.errors import DataError
from cranedyn.identification.model import ROUND_OFF, Model

HORIZONS = (0.125, 0.25, 0.5, 1.0)
"""Shares of a record that are fitted one after the other: over a short time a wrong period loses
no whole turn, so that the search finds its way from far off."""

_LEAST, _MOST = 12.0, 60
_FAR, _NEAR, _CLOSE, _QUIET, _ROOM = 1e6, 1e-3, 1e-9, 0.2, 1e4


def inside(model: Model) -> np.ndarray:
    """Where the search begins, shape (parameters,): where one believes, but so far from the ends of
    what is allowed that a channel changes by a hundredth of its range; a search that begins at an
    end leaves it slowly.
    """
    ends = (np.array([getattr(one, end) for one in model.parameters]) for end in ("low", "high"))
    low, high = ends
    room = np.minimum(_ROOM * np.abs(model.steps), 0.1 * (high - low)) * (model.tells > 0.0)
    return np.clip(model.first, low + room, high - room)


class Search:
    """Predictions beside the records, weighted; what was computed last is kept, since a solver asks
    for the Jacobian where it has just been.
    """

    def __init__(self, model: Model, progress: Callable[[int], object] | None) -> None:
        self.model, self.evaluations, self._progress = model, 0, progress
        self._told: np.ndarray = np.ones(len(model.parameters), dtype=bool)
        self._last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    def residual(self, values: np.ndarray, index: int) -> np.ndarray:
        """Recorded less predicted, shape (channels, rows)."""
        predicted = self.model.predicted(index, values[None])[0]
        return self.model.measured(index) - predicted

    def solved(self, values: np.ndarray, noise: list[np.ndarray], share: float) -> np.ndarray:
        """The least squares over a share of each record, from some values on."""
        model, scale = self.model, self.model.scale
        low, high = (
            np.array([getattr(one, end) for one in model.parameters]) / scale
            for end in ("low", "high")
        )
        self._last = None
        begin = np.clip(values / scale, low + 1e-9, high - 1e-9)
        weights = [1.0 / one for one in noise]
        self._both(begin * scale, weights, share)
        free = self._told.copy()  # what nothing shows keeps its value

        def at(part: np.ndarray) -> np.ndarray:
            whole = begin.copy()
            whole[free] = part
            return whole * scale

        close = _CLOSE if share == 1.0 else _NEAR
        found = least_squares(
            lambda z: self._both(at(z), weights, share)[0],
            begin[free],
            jac=lambda z: (self._both(at(z), weights, share)[1] * scale)[:, free],
            bounds=(low[free], high[free]),
            x_scale="jac",
            ftol=close,
            xtol=close,
            gtol=None,
            max_nfev=_MOST,
        )
        return at(found.x)

    def _both(
        self, values: np.ndarray, weights: list[np.ndarray], share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Weighted residual and its Jacobian, both turned so that few rows are left: the same
        length, the same products with each other, shape (parameters + 1,) and (parameters + 1,
        parameters).
        """
        key = values.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1:]
        parts, slopes = [], []
        for index, record in enumerate(self.model.records):
            until = max(share * record.duration, min(_LEAST, record.duration))
            off, slope = jacobian(self.model, values, index, until)
            parts.append((off * weights[index][:, None]).ravel())
            slopes.append((slope * weights[index][:, None, None]).reshape(-1, len(values)))
        self.evaluations += 1
        if self._progress is not None:
            self._progress(self.evaluations)
        residual = np.concatenate(parts)
        if self._last is None and not np.isfinite(residual).all():
            raise DataError(
                "The crane cannot be simulated through the record from where the search begins; "
                "say better what is known of it."
            )
        wild = ~np.isfinite(residual)
        residual[wild] = _FAR
        slope = np.concatenate(slopes)
        slope[wild] = 0.0
        self._told = np.asarray(slope.any(axis=0))
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
    """Predicted less recorded of one record, shape (channels, rows), and how it changes with each
    parameter, shape (channels, rows, parameters).
    """
    places = model.of_record(index)
    ends = np.array([one.high for one in model.parameters])
    steps = np.where(values + model.steps > ends, -1.0, 1.0) * model.steps
    variants = np.tile(values, (len(places) + 1, 1))
    variants[np.arange(1, len(places) + 1), places] += steps[places]
    shown = model.predicted(index, variants, until)
    slope = np.zeros((*shown.shape[1:], len(values)))
    measured = model.measured(index, until)
    least = ROUND_OFF * (measured.max(axis=1) - measured.min(axis=1))[:, None]
    for lane, place in enumerate(places, start=1):
        change = shown[lane] - shown[0]
        if not (np.abs(change) <= least).all():
            slope[:, :, place] = change / steps[place]
    return shown[0] - measured, slope


def check_units(model: Model) -> None:
    """Return if a swing is about as large as the recorded motion of the drives makes it.

    Raises:
        DataError: If it is some 57 times as large, as one in degrees.
    """
    if model.drives != "motion":
        return
    values, begins = model.first.copy(), {}
    for i, one in enumerate(model.parameters):
        if one.kind in ("start", "start rate"):
            begins[one.record, one.of, one.kind], values[i] = values[i], 0.0
    for index, record in enumerate(model.records):
        shown, seen = model.predicted(index, values[None])[0], model.measured(index)
        for c, channel in enumerate(model.channels[index]):
            if channel.kind != "swing":
                continue
            symbol = model.prior.crane.layout.symbols[channel.at]
            at_first = [abs(begins[index, symbol, kind]) for kind in ("start", "start rate")]
            ours, theirs = float(np.std(shown[c])), float(np.std(seen[c]))
            quiet = max(at_first) < _QUIET * theirs
            if quiet and ours > 1e-3 and 25.0 < theirs / ours < 130.0:
                raise DataError(
                    f"{record.name}: {channel.column} swings {theirs / ours:.3g} times as much as "
                    "the drives make it swing, as degrees do; allowed are radians. Say so: "
                    f"--columns {channel.column}={channel.column}[deg]."
                )
