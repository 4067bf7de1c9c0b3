"""Least squares over all records at once, and how sure what comes out is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, t as student

from cranedyn.arguments import checked
from cranedyn.errors import DataError, UnknownName
from cranedyn.identification.model import Model

CONFIDENCE = 0.95
"""Of the intervals."""

HORIZONS = (0.125, 0.25, 0.5, 1.0)
"""Shares of a record that are fitted one after the other: over a short time a wrong period loses
no whole turn, so that the search finds its way from far off."""

_LEAST, _MOST, _LAGS, _WHITE = 12.0, 60, 20, 1e-3
_FAR, _NEAR, _CLOSE, _QUIET, _ROOM = 1e6, 1e-3, 1e-9, 0.2, 1e4


@dataclass(frozen=True, eq=False)
class Estimate:
    """What was found.

    Attributes:
        model: What it was found with.
        values: Of all parameters, shape (parameters,).
        covariance: Of these, shape (parameters, parameters).
        noise: Standard deviation of what is left of each channel of each record.
        residuals: Recorded less predicted, of each record, shape (channels, rows looked at).
        white: Whether what is left is white noise, channel by channel. Where it is not the model
            lacks something; intervals are then those of correlated errors.
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
        names = [one.name for one in self.model.parameters if one.record is None]
        if name not in names:
            raise UnknownName("parameter", name, names)
        return names.index(name)

    @checked
    def value(self, name: str) -> float:
        """What was found of a parameter of the crane, in its unit.

        Raises:
            UnknownName: If it was not looked for.
        """
        return float(self.values[self._place(name)])

    @checked
    def margin(self, name: str) -> float:
        """Half the width of its interval, which holds the truth with 95 % confidence."""
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
        return {
            one.name: (self.value(one.name), self.margin(one.name))
            for one in self.model.parameters
            if one.record is None
        }

    @property
    def found_arguments(self) -> dict[str, float]:
        """Values of the arguments of the crane that were found, gravity among them, by name."""
        return {
            one.name: self.value(one.name)
            for one in self.model.parameters
            if one.kind == "argument"
        }

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


@checked
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
    search = _Search(model, progress)
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
    covariance = _covariance(model, jacobians, residuals, noise, white)
    return Estimate(model, values, covariance, tuple(noise), residuals, white, search.evaluations)


def inside(model: Model) -> np.ndarray:
    """Where the search begins, shape (parameters,): where one believes, but so far from the ends of
    what is allowed that a channel changes by a hundredth of its range; a search that begins at an
    end leaves it slowly.
    """
    ends = (np.array([getattr(one, end) for one in model.parameters]) for end in ("low", "high"))
    low, high = ends
    room = np.minimum(_ROOM * np.abs(model.steps), 0.1 * (high - low))
    return np.clip(model.first, low + room, high - room)


class _Search:
    """Predictions beside the records, weighted; what was computed last is kept, since a solver asks
    for the Jacobian where it has just been.
    """

    def __init__(self, model: Model, progress: Callable[[int], object] | None) -> None:
        self.model, self.evaluations, self._progress = model, 0, progress
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
        found = least_squares(
            lambda z: self._both(z * scale, weights, share)[0],
            begin,
            jac=lambda z: self._both(z * scale, weights, share)[1] * scale,
            bounds=(low, high),
            x_scale="jac",
            ftol=_CLOSE if share == 1.0 else _NEAR,
            xtol=_CLOSE if share == 1.0 else _NEAR,
            gtol=None,
            max_nfev=_MOST,
        )
        return found.x * scale

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
    for lane, place in enumerate(places, start=1):
        slope[:, :, place] = (shown[lane] - shown[0]) / steps[place]
    return shown[0] - model.measured(index, until), slope


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
    return bool(chi2.sf(statistic, _LAGS) > _WHITE)


def _covariance(
    model: Model,
    jacobians: list[np.ndarray],
    residuals: tuple[np.ndarray, ...],
    noise: list[np.ndarray],
    white: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Covariance of the parameters: that of least squares, or where a residual is not white that of
    errors with a memory (Newey and West 1987, over a tenth of the record).
    """
    scale, count = model.scale, len(model.parameters)
    bread, meat = np.zeros((count, count)), np.zeros((count, count))
    for part, left, spread, plain in zip(jacobians, residuals, noise, white, strict=True):
        for slope, off, sigma, simple in zip(part, left, spread, plain, strict=True):
            weighted = slope * scale / sigma
            own = weighted.T @ weighted
            bread += own
            meat += own if simple else _remembering(weighted * (off / sigma)[:, None])
    inverse = np.linalg.pinv(bread, rcond=1e-15, hermitian=True)
    return scale[:, None] * (inverse @ meat @ inverse) * scale


def _remembering(scores: np.ndarray) -> np.ndarray:
    """Long-run covariance of scores, shape (rows, parameters), with Bartlett's weights."""
    reach = max(1, len(scores) // 10)
    found = scores.T @ scores
    for lag in range(1, reach + 1):
        cross = scores[lag:].T @ scores[:-lag]
        found += (1.0 - lag / (reach + 1.0)) * (cross + cross.T)
    return found


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
            symbol = model.known.crane.layout.symbols[channel.at]
            at_first = [abs(begins[index, symbol, kind]) for kind in ("start", "start rate")]
            ours, theirs = float(np.std(shown[c])), float(np.std(seen[c]))
            quiet = max(at_first) < _QUIET * theirs
            if quiet and ours > 1e-3 and 25.0 < theirs / ours < 130.0:
                raise DataError(
                    f"{record.name}: {channel.column} swings {theirs / ours:.3g} times as much as "
                    "the drives make it swing, as degrees do; allowed are radians. Say so: "
                    f"--columns {channel.column}={channel.column}[deg]."
                )
