"""Which effects records show: each fitted to all of them by an independent pendulum.

A combination of effects, one of `CANDIDATES`, is fitted to all records at once. Its parameters are
*shared*, with one number for all records, such as the delay of the sensor; or each record's *own*,
such as the swing with which it begins. Akaike's criterion compares the combinations.
"""

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


class _Start(NamedTuple):
    """Where the fit of a parameter begins.

    Attributes:
        value: First value.
        scale: Typical change, by which the fit scales the parameter.
    """

    value: float
    scale: float


SHARED_PARAMETERS = {
    "damping": _Start(0.05, 0.02),
    "delay": _Start(0.17, 0.05),
    "window": _Start(0.35, 0.05),
    "gain": _Start(1.0, 0.1),
    "drag": _Start(0.0, 0.1),
    "friction": _Start(0.0, 0.01),
    "centring": _Start(0.0, 0.01),
    "tilt": _Start(0.0, 0.01),
}
"""Parameters with one number for all records.

These are the viscous damping [1/s]; delay [s], averaging window [s] and gain of the swing sensor;
drag [1/rad], dry friction and centring [rad/s²], see `simulate_swing`; and the tilt of the rail
with the position of the trolley [rad/m].
"""

OWN_PARAMETERS = {
    "offset": _Start(-0.04, 0.01),
    "bias": _Start(0.0, 0.01),
    "start": _Start(0.0, 0.02),
    "rate": _Start(0.0, 0.1),
}
"""Parameters with a number for each record.

These are the pendulum less the recorded cable [m], the bias of the swing sensor [rad], and the
first swing [rad] with its rate [rad/s]. The offset is the first: `fit` reads it there.
"""

WITHOUT_EFFECT = {**dict.fromkeys(SHARED_PARAMETERS, 0.0), "gain": 1.0}
"""Value of each shared parameter where the effect is absent."""

FIRST_TIME = 0.6
"""Time of the first row that a fit uses [s].

An earlier report may average over times before the record, in which the swing is not known.
"""

DIFFERENCE_STEP = 1e-4
"""Step of the finite differences, in scales of a parameter."""

QUANTILE_95 = 1.96
"""Half the 95 % interval of a normal distribution, in standard deviations."""

ARRIVAL_TOLERANCE = 1e-3
"""Distance from its last position within which a trolley has arrived [m]."""

MIN_FREE_TIME = 5.0
"""Shortest time after the arrival of the trolley in which a residue is looked for [s]."""

RESIDUE_RATIOS = np.linspace(1.15, 2.5, 136)
"""Frequencies of the oscillations looked for in a residue, over that of the swing.

They begin above 1: errors of damping and length leave oscillations at the swing's own frequency.
"""


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
        # Row i is the offset i less the weighted mean. The mean contains the record itself, so its
        # uncertainty and that of the offset do not simply add.
        deviation = np.eye(len(weights)) - weights
        margins = QUANTILE_95 * np.sqrt(np.diag(deviation @ self.covariance @ deviation.T))
        return float(weights @ self.offsets), np.abs(deviation @ self.offsets) <= margins

    @property
    def gravity(self) -> tuple[float, float]:
        """Gravity [m/s²] for which all records have one offset, and half its 95 % interval, as much
        wider as the records differ by more than their intervals (Birge 1932).
        """
        # A fit gives the length L of a record for standard gravity g, since a period tells l / g
        # only. With another gravity γ it is γ/g L, which is to be the recorded cable plus one
        # offset for all: cable = γ/g L - offset, linear in γ/g and the offset.
        slopes = np.column_stack([self.cables + self.offsets, -np.ones(len(self.cables))])
        weight = np.linalg.inv(self.covariance)
        variance = np.linalg.inv(slopes.T @ weight @ slopes)
        solution = variance @ slopes.T @ weight @ self.cables
        error = slopes @ solution - self.cables
        # Birge's ratio: χ² over its degrees of freedom, where that is more than 1.
        beyond = max(error @ weight @ error / max(len(error) - 2, 1), 1.0)
        margin = QUANTILE_95 * np.sqrt(beyond * variance[0, 0])
        return STANDARD_GRAVITY * solution.item(0), STANDARD_GRAVITY * float(margin)


class _Pendulums:
    """Records predicted by the independent pendulum.

    All parameters together are one vector: the shared ones, then those of each record in turn.

    Attributes:
        names: Names of the parameters of one record: the shared ones, then its own.
        shared_count: Number of shared parameters.
        record_count: Number of records.
        first: First value of each parameter of one record.
        scale: Scale of each parameter of one record.
        cable: Recorded cable length of each record [m], shape (records,).
        t: Times of the reports of each record [s].
        measured: Recorded swing at these times [rad].
        row_ends: Number of rows of all records up to and including each one.
    """

    def __init__(self, records: Sequence[Record], effects: Sequence[str]) -> None:
        """Prepare the motions of the trolleys.

        Args:
            records: Records with the motion of a trolley.
            effects: Names of the effects beside viscous damping.
        """
        self.names = ("damping", *effects, *OWN_PARAMETERS)
        self.shared_count = 1 + len(effects)
        self.record_count = len(records)
        starts = [{**SHARED_PARAMETERS, **OWN_PARAMETERS}[name] for name in self.names]
        self.first = np.array([start.value for start in starts])
        self.scale = np.array([start.scale for start in starts])

        self._trolley_acceleration = _trolley_accelerations(records)
        self.cable = np.array([np.mean(record.columns["l_m"]) for record in records])
        self.t = []
        self.measured = []
        self._distance = []
        for record in records:
            used = record.t >= FIRST_TIME
            x = record.columns["x_m"]
            self.t.append(record.t[used])
            self.measured.append(record.columns["phi_rad"][used])
            self._distance.append(x[used] - x[0])
        self.row_ends = np.cumsum([len(t) for t in self.t])

    def of_all(self, numbers: np.ndarray) -> np.ndarray:
        """Return a vector with a number for each parameter of all records, from numbers for those
        of one.
        """
        own = np.tile(numbers[self.shared_count :], self.record_count)
        return np.concatenate([numbers[: self.shared_count], own])

    def by_record(self, z: np.ndarray) -> np.ndarray:
        """Return the parameters of each record, shape (records, parameters of one), from the vector
        of all parameters.
        """
        own = z[self.shared_count :].reshape(self.record_count, -1)
        shared = np.tile(z[: self.shared_count], (self.record_count, 1))
        return np.hstack([shared, own])

    def predicted(self, rows: np.ndarray, records: np.ndarray) -> list[np.ndarray]:
        """Return the reported swing of each lane at the times of its record [rad].

        Args:
            rows: Parameters of each lane, shape (lanes, parameters of one record).
            records: Index of the record of each lane, shape (lanes,).
        """
        p = {name: np.full(len(records), value) for name, value in WITHOUT_EFFECT.items()}
        for name, values in zip(self.names, rows.T, strict=True):
            p[name] = values
        phi = simulate_swing(
            self._trolley_acceleration[:, records],
            self.cable[records] + p["offset"],
            np.stack([p["start"], p["rate"]]),
            p["damping"],
            p["drag"],
            p["friction"],
            p["centring"],
        )

        predicted = []
        for lane, i in enumerate(records):
            late = reported(self.t[i], phi[:, lane], p["delay"][lane], p["window"][lane])
            bias = p["bias"][lane]
            tilt = p["tilt"][lane]
            predicted.append(p["gain"][lane] * late + bias + tilt * self._distance[i])
        return predicted

    def residual(self, z: np.ndarray) -> np.ndarray:
        """Return the predicted less the recorded swing of all records in turn [rad]."""
        predicted = self.predicted(self.by_record(z), np.arange(self.record_count))
        return np.concatenate(predicted) - np.concatenate(self.measured)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the derivatives of the residual by finite differences, shape (rows, parameters).

        Each record takes a lane without a difference and one for each of its parameters; all lanes
        are simulated at once. A parameter of another record does not change a record.
        """
        width = len(self.names)
        steps = DIFFERENCE_STEP * self.scale
        differences = np.vstack([np.zeros(width), np.diag(steps)])
        rows = (self.by_record(z)[:, None] + differences).reshape(-1, width)
        lane_count = width + 1
        lanes = self.predicted(rows, np.repeat(np.arange(self.record_count), lane_count))

        jacobian = np.zeros((self.row_ends[-1], len(z)))
        for i, end in enumerate(self.row_ends.tolist()):
            base, *varied = lanes[i * lane_count : (i + 1) * lane_count]
            first_own = self.shared_count + i * len(OWN_PARAMETERS)
            own = range(first_own, first_own + len(OWN_PARAMETERS))
            columns = [*range(self.shared_count), *own]
            jacobian[end - len(base) : end, columns] = (np.array(varied) - base).T / steps
        return jacobian

    def by_rows(self, values: np.ndarray) -> list[np.ndarray]:
        """Return what belongs to each record of an array with all rows."""
        return np.split(values, self.row_ends[:-1])


def _trolley_accelerations(records: Sequence[Record]) -> np.ndarray:
    """Return the acceleration of the trolley of each record, `STEP` / 2 apart, as long as the
    longest record [m/s²], shape (2 steps + 1, records); 0 after the end of a record.
    """
    longest = max(record.duration for record in records)
    steps = int(np.ceil(longest / STEP)) + 1
    t = 0.5 * STEP * np.arange(2 * steps + 1)
    accelerations = []
    for record in records:
        motion = CubicHermiteSpline(record.t, record.columns["x_m"], record.columns["x_dot_m_s"])
        accelerations.append(np.where(t <= motion.x[-1], motion(t, 2), 0.0))
    return np.stack(accelerations, axis=1)


def fit(records: Sequence[Record], names: tuple[str, ...]) -> Fit:
    """Fit effects with one number each for all records; length, bias and first swing are each
    record's own.

    Args:
        records: Records with the motion of a trolley.
        names: Names of the effects.
    """
    model = _Pendulums(records, names)
    first = model.of_all(model.first)
    solution = least_squares(
        model.residual,
        first,
        jac=model.jacobian,
        x_scale=model.of_all(model.scale),
        xtol=1e-6,
        ftol=1e-7,
        max_nfev=30,
    )
    errors = model.by_rows(solution.fun)

    # Akaike's criterion of normal noise whose variance is estimated for each record:
    # rows × ln(mean square) of each, and two for each parameter.
    criterion = sum(len(e) * np.log(np.mean(e**2)) for e in errors) + 2.0 * len(first)
    variance = sum(float(np.sum((y - y.mean()) ** 2)) for y in model.measured)
    left = 2.0 * solution.cost / variance

    # The offset is the first of each record's own parameters.
    offset_columns = model.shared_count + np.arange(model.record_count) * len(OWN_PARAMETERS)
    offsets = solution.x[offset_columns]
    covariance = _covariance(model, solution.jac, solution.fun)
    # A cable that is recorded in steps is off by up to half of one: a uniform distribution.
    steps = np.array([record.resolution.get("l_m", 0.0) for record in records])
    offset_covariance = covariance[np.ix_(offset_columns, offset_columns)] + np.diag(
        steps**2 / 12.0
    )

    residues = []
    lengths = (model.cable + offsets).tolist()
    for record, t, error, length in zip(records, model.t, errors, lengths, strict=True):
        residues.append(residue(record, t, error, length))
    return Fit(
        names=names,
        values=dict(zip(model.names[: model.shared_count], solution.x.tolist(), strict=False)),
        cables=model.cable,
        offsets=offsets,
        covariance=offset_covariance,
        residues=np.array(residues),
        left=left,
        criterion=criterion,
    )


def _covariance(model: _Pendulums, jacobian: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the covariance of all parameters, for errors that are correlated in time.

    It is the sandwich estimator (JᵀJ)⁻¹ M (JᵀJ)⁻¹, where M is the long-run covariance of the scores
    J e of each record, see `long_run`. Records do not correlate with each other.
    """
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    scores = model.by_rows(jacobian * errors[:, None])
    return inverse @ sum(long_run(of_record) for of_record in scores) @ inverse


def residue(record: Record, t: np.ndarray, error: np.ndarray, length: float) -> tuple[float, float]:
    """Return the largest oscillation that a fit leaves while the trolley stands.

    Args:
        record: The record.
        t: Times of the errors [s].
        error: Predicted less recorded swing [rad].
        length: Length of the pendulum [m].

    Returns:
        Its frequency over that of the swing, and its amplitude [rad]; NaN both if the trolley
        stands for less than `MIN_FREE_TIME`.
    """
    x = record.columns["x_m"]
    is_moving = np.abs(x - x[-1]) > ARRIVAL_TOLERANCE
    arrived = float(np.max(record.t[is_moving], initial=0.0))
    if t[-1] - arrived < MIN_FREE_TIME:
        return np.nan, np.nan
    free = t > arrived
    error = error[free] - np.mean(error[free])
    t = t[free]
    power = lombscargle(t, error, RESIDUE_RATIOS * np.sqrt(STANDARD_GRAVITY / length))
    largest = int(np.argmax(power))
    # The periodogram of a sine with amplitude A sampled n times is n A² / 4.
    amplitude = np.sqrt(4.0 * power[largest] / len(t))
    return float(RESIDUE_RATIOS[largest]), float(amplitude)


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
        ("±", ".1f", lambda row: 1e3 * QUANTILE_95 * row[2]),
        ("residue [mrad]", ".1f", lambda row: finite_or_none(1e3 * row[3][1])),
        ("at [swing frequencies]", ".2f", lambda row: finite_or_none(row[3][0])),
        note="With all effects of the best row. Residue: largest oscillation left at rest.",
    )
