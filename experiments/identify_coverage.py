"""Synthetic cranes, each with numbers and moves of its own, identified from a noisy record: how
often the intervals hold the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from cranedyn.identification import Estimate, Known, Model, Record, identify

NAMES = ("l_offset", "payload_mass", "damp_swing", "delay", "phi_bias", "theta_bias", "x_friction")
"""What is found of each crane."""

RANGES = {
    "l_offset": (-0.5, 0.5),
    "payload_mass": (700.0, 2500.0),
    "damp_swing": (1500.0, 4000.0),
    "delay": (0.0, 0.2),
    "phi_bias": (-5e-3, 5e-3),
    "theta_bias": (-5e-3, 5e-3),
    "x_friction": (200.0, 800.0),
}
"""Between what the truth lies, each number by itself and evenly."""

DURATION, INTERVAL = 40.0, 0.1
"""Of a record [s], and from row to row."""

NOISE = {"swing": 2e-3, "effort": 50.0}
"""Standard deviation of what the sensors add: to a swing [rad], to an effort [N]."""

_MOVES = {"x": (2, 2.0, 2.0, 6.0), "gamma": (1, 0.3, 3.0, 8.0), "l": (1, 3.0, 6.0, 12.0)}


@cache
def believed() -> Known:
    """What one believes of all of them: the crane as its description says."""
    return Known()


def synthetic(seed: int, known: Known | None = None) -> tuple[Model, dict[str, float]]:
    """A noisy record of a crane that is not as one believes, with what is true of it.

    Args:
        seed: Of all that is random.
        known: What one believes of it; None for the crane as its description says.
    """
    rng, known = np.random.default_rng(seed), known or believed()
    truth = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    model = Model.of(known, [_record(known, rng)], NAMES, drives="motion")
    begins = {"start": 0.03, "start rate": 0.03}
    values = np.array(
        [
            truth[one.name] if one.record is None else begins[one.kind] * rng.standard_normal()
            for one in model.parameters
        ]
    )
    shown = model_over_all(model, values)
    columns = dict(model.records[0].columns)
    for channel, column in zip(model.channels[0], shown, strict=True):
        noise = NOISE[channel.kind] * rng.standard_normal(len(column))
        columns[channel.column] = column + noise
    record = Record.of(known.crane, {"t_s": model.records[0].t, **columns}, name=f"crane {seed}")
    return Model.of(known, [record], NAMES, drives="motion"), truth


def model_over_all(model: Model, values: np.ndarray) -> np.ndarray:
    """What the first record would show in all of its rows, shape (channels, rows); rows that no
    sensor sees in time keep what they have.
    """
    record, rows = model.records[0], model.rows(0)
    shown = np.array([record.columns[one.column].copy() for one in model.channels[0]])
    seen = model.predicted(0, values[None])[0]
    shown[:, rows] = seen
    # A search begins with the first rows: they have the swing that the crane begins with.
    for c, channel in enumerate(model.channels[0]):
        symbol = model.known.crane.layout.symbols[channel.at]
        first = [values[i] for i, one in enumerate(model.parameters)
                 if one.record == 0 and one.of == symbol]  # fmt: skip
        if channel.kind == "swing":
            shown[c, : rows[0]] = first[0] + first[1] * record.t[: rows[0]]
    return shown


def _record(known: Known, rng: np.random.Generator) -> Record:
    """The motion of the drives, with columns for whatever is to be predicted."""
    t = INTERVAL * np.arange(round(DURATION / INTERVAL) + 1)
    start = {"x": rng.uniform(6.0, 16.0), "gamma": 0.0, "l": rng.uniform(8.0, 16.0)}
    columns: dict[str, np.ndarray] = {}
    for joint in known.crane.layout.driven:
        times, far, least, most = _MOVES[joint.symbol]
        place = np.full_like(t, start[joint.symbol])
        for part in range(times):
            begins = rng.uniform(part, part + 0.8) * (DURATION - most) / times
            share = np.clip((t - begins) / rng.uniform(least, most), 0.0, 1.0)
            size = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0) * far
            place += size * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        columns[joint.columns[0]] = place
    placeholder = np.sin(t)
    columns |= {name: 1e-3 * placeholder for name in ("phi_rad", "theta_rad")}
    columns |= {name: placeholder for name in ("F_x_N", "F_l_N")}
    return Record.of(known.crane, {"t_s": t, **columns})


def holds(estimate: Estimate, truth: Mapping[str, float]) -> dict[str, bool]:
    """Whether each interval holds the truth."""
    return {
        name: abs(estimate.value(name) - value) <= estimate.margin(name)
        for name, value in truth.items()
    }


def coverage(cases: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Identify synthetic cranes; a study for `cranedyn.sweep`.

    Args:
        cases: A column ``seed``.

    Returns:
        For each parameter how far off it is [its unit], and half the width of its interval.
    """
    found: dict[str, list[Any]] = {}
    for seed in cases["seed"].tolist():
        model, truth = synthetic(int(seed))
        estimate = identify(model)
        for name, value in truth.items():
            found.setdefault(f"{name}_off", []).append(estimate.value(name) - value)
            found.setdefault(f"{name}_margin", []).append(estimate.margin(name))
    return {name: np.array(values) for name, values in found.items()}
