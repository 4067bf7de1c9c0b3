"""Which friction the trolley's drive shows: its motion predicted from the motor's command alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from experiments.harness import ResultTable, make_table

STEP, STRIBECK_RATE = 0.02, 0.05
"""Step [s], and rate [m/s] at which the surplus of friction at rest has fallen to 1/e."""

_FIRST, _SCALE = np.array([[4.0, 1.0, 0.62, 0.02], [1.0, 0.5, 0.02, 0.02]])

Log = Mapping[str, np.ndarray]


def simulate_trolley(command: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the way of trolleys from rest [m], shape (steps, lanes).

    Args:
        command: Share of the full voltage in each step, shape (steps, lanes).
        values: Acceleration at full command [m/s²], losses and back-EMF [1/s], dry friction and
            its surplus at rest, both over full command; shape (4,).
    """
    gain, loss, dry, surplus = values
    x = np.zeros_like(command)
    v = np.zeros(command.shape[1])
    for k, share in enumerate(command[:-1]):
        friction = STEP * gain * (dry + surplus * np.exp(-np.abs(v) / STRIBECK_RATE))
        v = v + STEP * (gain * share - loss * v)
        v = np.sign(v) * np.maximum(np.abs(v) - friction, 0.0)
        x[k + 1] = x[k] + STEP * v
    return x


def drive_errors(logs: Sequence[Log], values: np.ndarray) -> np.ndarray:
    """Return predicted less recorded way [m] until the command of a record ends, 0 from there on;
    shape (steps, records).
    """
    ends = np.array([log["t_s"][np.flatnonzero(log["x_command"])[-1]] for log in logs])
    t = np.arange(0.0, max(ends), STEP)
    rows = [np.clip(np.searchsorted(log["t_s"], t, side="right") - 1, 0, None) for log in logs]
    command = np.column_stack([log["x_command"][i] for log, i in zip(logs, rows, strict=True)])
    travel = np.column_stack([np.interp(t, log["t_s"], log["x_m"] - log["x_m"][0]) for log in logs])
    return np.where(t[:, None] <= ends, simulate_trolley(command, values) - travel, 0.0)


def fit_drive(logs: Sequence[Log], count: int) -> np.ndarray:
    """Return the values of `simulate_trolley`, the first of them fitted and the others 0."""
    solution = least_squares(
        lambda z: drive_errors(logs, np.append(z, np.zeros(4 - count))).ravel(), _FIRST[:count],
        x_scale=_SCALE[:count], diff_step=3e-3, max_nfev=25, bounds=(0.0, 100.0),
    )  # fmt: skip
    return np.append(solution.x, np.zeros(4 - count))


def drive_table(logs: Sequence[Log]) -> ResultTable:
    """Return a row for dry friction, and one with Stribeck's surplus at rest, too."""
    total = np.sum(drive_errors(logs, np.array([0.0, 0.0, 1.0, 0.0])) ** 2)  # it stands
    rows = []
    for count in (3, 4):
        values = [fit_drive(half, count) for half in (logs, logs[1::2], logs[::2])]
        errors = map(drive_errors, (logs, logs[::2], logs[1::2]), values)
        rows.append((values[0], *(100.0 * np.sum(error**2) / total for error in errors)))
    return make_table(
        "What the trolley's drive shows",
        rows,
        ("dry friction [%]", ".1f", lambda row: 100.0 * row[0][2]),
        ("Stribeck's surplus at rest [%]", ".1f", lambda row: 100.0 * row[0][3]),
        ("left [%]", ".1f", lambda row: row[1]),
        ("held out [%]", ".1f", lambda row: row[2] + row[3]),
        note="Friction over full command. Left: mean square error of the way over its mean square.",
    )
