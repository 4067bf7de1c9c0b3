"""Which effects records show: each fitted to all of them by an independent pendulum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares
from scipy.signal import lombscargle

from cranedyn.identification import Record
from cranedyn.identification.estimate import long_run
from cranedyn.model.crane import STANDARD_GRAVITY
from experiments.harness import ResultTable, finite_or_none, make_table
from experiments.measured.pendulum import STEP, reported, simulate_swing

CANDIDATES = (
    ("delay",),
    ("window",),
    ("window", "gain"),
    ("window", "friction"),
    ("window", "drag"),
    ("window", "centring"),
    ("window", "drag", "centring"),
    ("window", "drag", "centring", "tilt"),
)
"""Effects beside viscous damping, each with one number for all records."""

_SHARED = {
    "damping": (0.05, 0.02), "delay": (0.17, 0.05), "window": (0.35, 0.05), "gain": (1.0, 0.1),
    "drag": (0.0, 0.1), "friction": (0.0, 0.01), "centring": (0.0, 0.01), "tilt": (0.0, 0.01),
}  # fmt: skip
_OWN = {"offset": (-0.04, 0.01), "bias": (0.0, 0.01), "start": (0.0, 0.02), "rate": (0.0, 0.1)}
"""First value and scale of each parameter of all records, and of each record."""

_ABSENT = {**dict.fromkeys(_SHARED, 0.0), "gain": 1.0}
_FIRST_ROW, _STEP = 0.6, 1e-4
_QUANTILE, _ARRIVED, _FREE, _RATIOS = 1.96, 1e-3, 5.0, np.linspace(1.15, 2.5, 136)


class Fit(NamedTuple):
    """Fit of effects to records.

    Attributes:
        names: Names of the effects.
        values: Value of each, and of the viscous damping [1/s], by name.
        cables: Recorded cable of each record [m], shape (records,).
        offsets: Pendulum less recorded cable of each record [m], shape (records,).
        covariance: Covariance of the offsets [m²], of correlated errors and with the steps of the
            recorded cables, shape (records, records).
        residues: Largest oscillation that is left while the trolley stands: its frequency over
            that of the swing, and its amplitude [rad]; nan without 5 s, shape (records, 2).
        left: Share of the variance that is left.
        criterion: Akaike's information criterion, with noise of its own for each record.
    """

    names: tuple[str, ...]
    values: dict[str, float]
    cables: np.ndarray
    offsets: np.ndarray
    covariance: np.ndarray
    residues: np.ndarray
    left: float
    criterion: float

    @property
    def agreement(self) -> tuple[float, np.ndarray]:
        """Mean of the offsets [m], weighted by their variances, and which offsets differ from it by
        no more than the 95 % interval of their difference, shape (records,).
        """
        weights = 1.0 / np.diag(self.covariance)
        weights /= weights.sum()
        deviation = np.eye(len(weights)) - weights
        margins = _QUANTILE * np.sqrt(np.diag(deviation @ self.covariance @ deviation.T))
        return float(weights @ self.offsets), np.abs(deviation @ self.offsets) <= margins

    @property
    def gravity(self) -> tuple[float, float]:
        """Gravity [m/s²] for which all records have one offset, and half its 95 % interval, as much
        wider as the records differ by more than their intervals (Birge 1932).
        """
        slopes = np.column_stack([self.cables + self.offsets, -np.ones(len(self.cables))])
        weight = np.linalg.inv(self.covariance)
        variance = np.linalg.inv(slopes.T @ weight @ slopes)
        solution = variance @ slopes.T @ weight @ self.cables
        error = slopes @ solution - self.cables
        beyond = max(error @ weight @ error / max(len(error) - 2, 1), 1.0)
        margin = _QUANTILE * np.sqrt(beyond * variance[0, 0])
        return STANDARD_GRAVITY * solution.item(0), STANDARD_GRAVITY * float(margin)


class _Pendulums:
    """Records predicted by the independent pendulum."""

    def __init__(self, records: Sequence[Record], names: Sequence[str]) -> None:
        self.names = ("damping", *names, *_OWN)
        self.count = 1 + len(names)
        self.size = len(records)
        numbers = [{**_SHARED, **_OWN}[name] for name in self.names]
        self.first, self.scale = np.array(numbers).T
        steps = int(np.ceil(max(record.duration for record in records) / STEP)) + 1
        half = 0.5 * STEP * np.arange(2 * steps + 1)
        motions = [
            CubicHermiteSpline(r.t, r.columns["x_m"], r.columns["x_dot_m_s"]) for r in records
        ]
        self.pull = np.stack(
            [np.where(half <= motion.x[-1], motion(half, 2), 0.0) for motion in motions], axis=1
        )
        self.cable = np.array([np.mean(r.columns["l_m"]) for r in records])
        self.t = [r.t[r.t >= _FIRST_ROW] for r in records]
        self.way = [r.columns["x_m"][r.t >= _FIRST_ROW] - r.columns["x_m"][0] for r in records]
        self.measured = [r.columns["phi_rad"][r.t >= _FIRST_ROW] for r in records]
        self.ends = np.cumsum([len(t) for t in self.t])

    def full(self, z: np.ndarray) -> np.ndarray:
        """Return the parameters of each record, shape (records, parameters of one)."""
        offsets = z[self.count :].reshape(self.size, -1)
        return np.hstack([np.tile(z[: self.count], (self.size, 1)), offsets])

    def predicted(self, rows: np.ndarray, of: np.ndarray) -> list[np.ndarray]:
        """Return the reported swing of each lane: parameters and index of a record."""
        p = {name: np.full(len(of), value) for name, value in _ABSENT.items()}
        p |= dict(zip(self.names, rows.T, strict=True))
        effects = (p[name] for name in ("damping", "drag", "friction", "centring"))
        start = np.stack([p["start"], p["rate"]])
        phi = simulate_swing(self.pull[:, of], self.cable[of] + p["offset"], start, *effects)
        sensors = zip(
            *(p[name] for name in ("gain", "delay", "window", "bias", "tilt")), strict=True
        )
        return [
            gain * reported(self.t[i], lane, delay, window) + bias + tilt * self.way[i]
            for i, lane, (gain, delay, window, bias, tilt) in zip(of, phi.T, sensors, strict=True)
        ]

    def residual(self, z: np.ndarray) -> np.ndarray:
        """Return predicted less recorded of all records, one after the other."""
        predicted = self.predicted(self.full(z), np.arange(self.size))
        return np.concatenate(predicted) - np.concatenate(self.measured)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residual by finite differences of all lanes at once."""
        width = len(self.names)
        steps = np.vstack([np.zeros(width), np.diag(_STEP * self.scale)])
        rows = (self.full(z)[:, None] + steps).reshape(-1, width)
        lanes = self.predicted(rows, np.repeat(np.arange(self.size), width + 1))
        slope = np.zeros((self.ends[-1], len(z)))
        for i, end in enumerate(self.ends.tolist()):
            base, *varied = lanes[i * (width + 1) : (i + 1) * (width + 1)]
            start = self.count + i * len(_OWN)
            columns = [*range(self.count), *range(start, start + len(_OWN))]
            change = (np.array(varied) - base).T / (_STEP * self.scale)
            slope[end - len(base) : end, columns] = change
        return slope


def fit(records: Sequence[Record], names: tuple[str, ...]) -> Fit:
    """Fit effects, a number each for all records; length, bias and first swing are each record's.

    Args:
        records: Records with the motion of a trolley.
        names: Names of the effects.
    """
    model = _Pendulums(records, names)
    first, scale = (
        np.concatenate([numbers[: model.count], np.tile(numbers[model.count :], model.size)])
        for numbers in (model.first, model.scale)
    )
    solution = least_squares(
        model.residual, first, jac=model.jacobian, x_scale=scale, xtol=1e-6, ftol=1e-7, max_nfev=30
    )
    errors = np.split(solution.fun, model.ends[:-1])
    variance = sum(float(np.sum((y - y.mean()) ** 2)) for y in model.measured)
    criterion = sum(len(e) * np.log(np.mean(e**2)) for e in errors) + 2.0 * len(first)
    values = dict(zip(model.names[: model.count], solution.x.tolist(), strict=False))
    rows = model.count + np.arange(model.size) * len(_OWN)  # an offset is the first of its record
    scores = np.split(solution.jac * solution.fun[:, None], model.ends[:-1])
    inverse = np.linalg.inv(solution.jac.T @ solution.jac)
    covariance = inverse @ sum(map(long_run, scores)) @ inverse
    steps = np.array([record.resolution.get("l_m", 0.0) for record in records])
    offsets = solution.x[rows]
    lengths = (model.cable + offsets).tolist()
    covariance = covariance[np.ix_(rows, rows)] + np.diag(steps**2 / 12.0)
    residues = [residue(*row) for row in zip(records, model.t, errors, lengths, strict=True)]
    loss = 2.0 * solution.cost / variance
    return Fit(names, values, model.cable, offsets, covariance, np.array(residues), loss, criterion)


def residue(record: Record, t: np.ndarray, error: np.ndarray, length: float) -> tuple[float, float]:
    """Return frequency, over that of the swing, and amplitude of the largest oscillation left."""
    x = record.columns["x_m"]
    arrived = float(np.max(record.t[np.abs(x - x[-1]) > _ARRIVED], initial=0.0))
    if t[-1] - arrived < _FREE:
        return np.nan, np.nan
    free = t > arrived
    t = t[free]
    error = error[free] - np.mean(error[free])
    power = lombscargle(t, error, _RATIOS * np.sqrt(STANDARD_GRAVITY / length))
    largest = int(np.argmax(power))
    return float(_RATIOS[largest]), float(np.sqrt(4.0 * power[largest] / len(t)))


def effects_table(fits: Sequence[Fit]) -> ResultTable:
    """Return a row for each combination of effects."""
    return make_table(
        "What the records show",
        fits,
        ("effects", "", lambda f: " + ".join(f.names)),
        ("left [%]", ".3f", lambda f: 100.0 * f.left),
        ("AIC less that of a delay", ",.0f", lambda f: f.criterion - fits[0].criterion),
        ("drag [1/rad]", ".3f", lambda f: f.values.get("drag")),
        ("centring [rad/s²]", ".4f", lambda f: f.values.get("centring")),
        ("tilt of the rail [rad/m]", ".4f", lambda f: f.values.get("tilt")),
        ("offsets from", ".1f", lambda f: 1e3 * f.offsets.min()),
        ("to [mm]", ".1f", lambda f: 1e3 * f.offsets.max()),
        ("standard deviation", ".1f", lambda f: 1e3 * f.offsets.std()),
        note="Left: share of the variance. Offset, bias and first swing are each record's own.",
    )


def offsets_table(best: Fit, records: Sequence[Record]) -> ResultTable:
    """Return a row for each record, fitted with the effects that all records show."""
    return make_table(
        "All records together",
        zip(records, best.offsets, np.sqrt(np.diag(best.covariance)), best.residues, strict=True),
        ("record", "", lambda row: row[0].name),
        ("offset [mm]", ".1f", lambda row: 1e3 * row[1]),
        ("±", ".1f", lambda row: 1e3 * _QUANTILE * row[2]),
        ("residue [mrad]", ".1f", lambda row: finite_or_none(1e3 * row[3][1])),
        ("at [swing frequencies]", ".2f", lambda row: finite_or_none(row[3][0])),
        note="With all effects of the best row. Residue: largest oscillation left at rest.",
    )
