"""Which friction the trolley's drive shows: its motion predicted from the motor's command alone.

The model of the drive is a DC motor on a cart. With the share u of the full voltage, the rate v and
the acceleration at full command a, see `simulate_trolley`,

    dv/dt = a u - b v - a (f + s exp(-|v| / v_s)) sign(v)

where b collects viscous losses and back-EMF, f is dry friction and s Stribeck's surplus, by which
friction at rest is larger than in motion. Both frictions are counted in shares of the full command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from experiments.harness import ResultTable, make_table

STEP = 0.02
"""Integration step [s]."""

STRIBECK_RATE = 0.05
"""Rate at which the surplus of friction at rest has fallen to 1/e, v_s [m/s]."""

FIRST_VALUES = np.array([4.0, 1.0, 0.62, 0.02])
"""Values of the model from which a fit begins, in the order of `simulate_trolley`."""

VALUE_SCALES = np.array([1.0, 0.5, 0.02, 0.02])
"""Typical changes of these values, by which a fit scales them."""

Log = Mapping[str, np.ndarray]
"""Columns of a record by name, shape (rows,) each."""


def simulate_trolley(command: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the distance that trolleys move from rest [m], shape (steps, lanes).

    Args:
        command: Share of the full voltage in each step, shape (steps, lanes).
        values: Acceleration at full command a [m/s²], losses and back-EMF b [1/s], dry friction f
            and its surplus at rest s, both over full command; shape (4,).
    """
    gain, loss, dry, surplus = values
    x = np.zeros_like(command)
    v = np.zeros(command.shape[1])
    for k, share in enumerate(command[:-1]):
        friction = STEP * gain * (dry + surplus * np.exp(-np.abs(v) / STRIBECK_RATE))
        v = v + STEP * (gain * share - loss * v)
        # Friction takes off no more than the rate that there is: then the trolley stands.
        v = np.sign(v) * np.maximum(np.abs(v) - friction, 0.0)
        x[k + 1] = x[k] + STEP * v
    return x


def drive_errors(logs: Sequence[Log], values: np.ndarray) -> np.ndarray:
    """Return the predicted less the recorded distance [m], shape (steps, records).

    It is 0 from the time on at which the command of a record ends.

    Args:
        logs: Records with the columns `t_s`, `x_m` and `x_command`.
        values: Values of `simulate_trolley`.
    """
    ends = []
    for log in logs:
        last_command = np.flatnonzero(log["x_command"])[-1]
        ends.append(log["t_s"][last_command])
    t = np.arange(0.0, max(ends), STEP)

    commands = []
    distances = []
    for log in logs:
        # A command holds until the next one; positions are interpolated.
        rows = np.clip(np.searchsorted(log["t_s"], t, side="right") - 1, 0, None)
        commands.append(log["x_command"][rows])
        distances.append(np.interp(t, log["t_s"], log["x_m"] - log["x_m"][0]))
    predicted = simulate_trolley(np.column_stack(commands), values)
    errors = predicted - np.column_stack(distances)
    return np.where(t[:, None] <= np.array(ends), errors, 0.0)


def fit_drive(logs: Sequence[Log], count: int) -> np.ndarray:
    """Return the values of `simulate_trolley` with the least mean square error, shape (4,).

    Args:
        logs: Records.
        count: Number of values to fit, the first ones; the others are 0.
    """
    left_out = np.zeros(len(FIRST_VALUES) - count)

    def residuals(fitted: np.ndarray) -> np.ndarray:
        return drive_errors(logs, np.append(fitted, left_out)).ravel()

    solution = least_squares(
        residuals,
        FIRST_VALUES[:count],
        x_scale=VALUE_SCALES[:count],
        # Where a trolley begins to move jumps from step to step: derivatives take a difference that
        # is larger than such jumps.
        diff_step=3e-3,
        max_nfev=25,
        bounds=(0.0, 100.0),
    )
    return np.append(solution.x, left_out)


class DriveFit(NamedTuple):
    """A fit of the drive to all records, and its prediction of those that it does not know.

    Attributes:
        values: Values of `simulate_trolley`.
        left: Mean square error of the distance over its mean square [%].
        held_out: The same, each half of the records predicted by a fit to the other half.
    """

    values: np.ndarray
    left: float
    held_out: float


def _fit_and_predict(logs: Sequence[Log], count: int, total: float) -> DriveFit:
    """Fit the first values of the model.

    Args:
        logs: Records.
        count: Number of values to fit.
        total: Sum of the squared distances [m²].
    """

    def share(predicted: Sequence[Log], values: np.ndarray) -> float:
        return float(100.0 * np.sum(drive_errors(predicted, values) ** 2) / total)

    even = logs[::2]
    odd = logs[1::2]
    values = fit_drive(logs, count)
    held_out = share(even, fit_drive(odd, count)) + share(odd, fit_drive(even, count))
    return DriveFit(values, share(logs, values), held_out)


def drive_table(logs: Sequence[Log]) -> ResultTable:
    """Return a row for a drive with dry friction, and one with Stribeck's surplus at rest, too."""
    # Without acceleration the predicted trolley stands, and its error is the whole distance.
    standing = np.array([0.0, 0.0, 1.0, 0.0])
    total = float(np.sum(drive_errors(logs, standing) ** 2))
    return make_table(
        "What the trolley's drive shows",
        [_fit_and_predict(logs, count, total) for count in (3, 4)],
        ("dry friction [%]", ".1f", lambda fit: 100.0 * fit.values[2]),
        ("Stribeck's surplus at rest [%]", ".1f", lambda fit: 100.0 * fit.values[3]),
        ("left [%]", ".1f", lambda fit: fit.left),
        ("held out [%]", ".1f", lambda fit: fit.held_out),
        note="Friction over full command. Left: mean square error of the way over its mean square.",
    )
