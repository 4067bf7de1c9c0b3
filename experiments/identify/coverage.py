"""Synthetic cranes, each with numbers and moves of its own, identified from a noisy record of a run
of `simulate` or of MuJoCo: how often the intervals hold the truth.
"""

from __future__ import annotations

import argparse
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.stats import binom

from cranedyn.bridges.joints import urdf_element
from cranedyn.bridges.mjcf import mjcf
from cranedyn.checks import number, whole
from cranedyn.errors import DataError
from cranedyn.identification import Model, Prior, Record, identify
from cranedyn.identification.estimate import WHITE
from cranedyn.identification.motion import SampledMotion
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.sweep import grid, sweep
from experiments.harness import Claim, Outcome, ResultTable, Setup, swept_columns
from experiments.identify.trial import simulate_motion

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

DURATION, INTERVAL, SWING = 40.0, 0.1, math.radians(20.0)
"""Of a record [s], from row to row, and largest angle of a swing joint at its beginning [rad]."""

NOISE = {"swing": 2e-3, "effort": 50.0}
"""Standard deviation of what the sensors add: to a swing [rad], to an effort [N]."""

_PERIOD, _FINE, _STIFF = 2e-3, 4, 500.0
"""Time between rows of the plant [s], in how many steps of MuJoCo, and frequency of the servos that
bring its motors along [rad/s]."""

_TAIL = 5e-4
"""Probability of a count below, and above, what a claim allows."""

_MOVES = {"x": (2, 2.0, 2.0, 6.0), "gamma": (1, 0.3, 3.0, 8.0), "l": (1, 3.0, 6.0, 12.0)}


@cache
def believed() -> Prior:
    """Return the prior of all of them: the crane of its description."""
    return Prior()


def synthetic(
    seed: int, *, plant: str = "simulate", resolution: float = 0.0
) -> tuple[Model, dict[str, float]]:
    """Record a crane that is not as one believes, and return what is true of it, too.

    Args:
        seed: Of all that is random.
        plant: What moves the crane, one of `PLANTS`.
        resolution: Steps in which the positions of trolley and hoist are recorded [m], and that of
            the slew by as many degrees as these are metres; 0 for exact positions.
    """
    steps = {"m": resolution, "rad": math.radians(resolution)}
    rng = np.random.default_rng(seed)
    prior = believed()
    truth = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    crane = prior.load(payload_mass=truth["payload_mass"], damp_swing=truth["damp_swing"])
    t = _PERIOD * np.arange(round(DURATION / _PERIOD) + 1)
    position, velocity = _motion(crane, rng, t)
    first = dict(zip(("gamma", "x", "l"), position[0].tolist(), strict=True))
    first["l"] += truth["l_offset"]
    swing = {name: float(rng.uniform(-SWING, SWING)) for name in ("phi", "theta")}
    q, effort = PLANTS[plant](crane, crane.state(**first, **swing), position, velocity)
    stride = round(INTERVAL / _PERIOD)
    columns = {"t_s": t[::stride]}
    for i, joint in enumerate(crane.layout.driven):
        symbol = joint.symbol
        index = int(crane.layout.drives[i])
        recorded = (q[:, index] - truth.get(f"{symbol}_offset", 0.0))[::stride]
        if resolution > 0.0:
            recorded = steps[joint.unit] * np.round(recorded / steps[joint.unit])
        columns[joint.columns[0]] = recorded
        noise = NOISE["effort"] * rng.standard_normal(len(columns["t_s"]))
        friction = truth.get(f"{symbol}_friction", 0.0) * np.sign(velocity[:, i])
        if symbol != "gamma":
            columns[joint.effort_column] = (effort[:, i] + friction)[::stride] + noise
    for joint in (crane.layout.joints[i] for i in crane.swings.tolist()):
        signal = CubicSpline(t, q[:, crane.layout.index(joint.symbol)])
        late = signal(np.maximum(columns["t_s"] - truth["delay"], 0.0))
        noise = NOISE["swing"] * rng.standard_normal(len(late))
        columns[joint.columns[0]] = late + truth[f"{joint.symbol}_bias"] + noise
    record = Record.of(prior.crane, columns, name=f"crane {seed}")
    return Model.of(prior, [record], NAMES, drives="motion"), truth


def _motion(crane: Crane, rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the drives should be and how fast, shape (rows, m) each."""
    start = {"x": rng.uniform(6.0, 16.0), "gamma": 0.0, "l": rng.uniform(8.0, 16.0)}
    position, velocity = np.zeros((2, len(t), crane.layout.m))
    for i, joint in enumerate(crane.layout.driven):
        times, distance, shortest, longest = _MOVES[joint.symbol]
        position[:, i] = start[joint.symbol]
        for k in range(times):
            begins = rng.uniform(k, k + 0.8) * (DURATION - longest) / times
            lasts = rng.uniform(shortest, longest)
            phase = np.clip((t - begins) / lasts, 0.0, 1.0)
            size = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0) * distance
            position[:, i] += size * phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
            velocity[:, i] += size / lasts * 30.0 * (phase * (1.0 - phase)) ** 2
    return position, velocity


def _simulated(
    crane: Crane, start: State, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates, shape (rows, n), and logged efforts of drives that follow a motion."""
    motion = SampledMotion(_PERIOD, position, velocity)
    run = simulate_motion(crane, start, motion, DURATION, validity="mark")
    return run.q, run.effort


def _by_mujoco(
    crane: Crane, start: State, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of MuJoCo, whose motors are stiff servos."""
    try:
        import mujoco
    except ImportError:
        raise DataError("mujoco is not installed: pip install 'cranedyn[mujoco]'.") from None
    dt = _PERIOD / _FINE
    text = ET.tostring(mjcf(crane, urdf_element(crane), dt), encoding="unicode")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    drives = crane.layout.drives
    data.qpos[:], data.qvel[:] = start
    aim = position + (start.q[drives] - position[0])
    acceleration = np.gradient(velocity, _PERIOD, axis=0)
    inertia = np.zeros((crane.layout.n, crane.layout.n))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    mass = 1.0 / np.diag(np.linalg.inv(inertia))[drives]
    needed = data.qfrc_bias[drives] + mass * acceleration
    q = np.empty((len(aim), crane.layout.n))
    effort = np.empty_like(aim)
    for k in range(len(aim)):
        q[k] = data.qpos
        for step in range(_FINE):
            after = step * dt
            moved = after * (velocity[k] + 0.5 * after * acceleration[k])
            off = data.qpos[drives] - aim[k] - moved
            rate = data.qvel[drives] - velocity[k] - after * acceleration[k]
            data.ctrl[:] = needed[k] - mass * _STIFF * (_STIFF * off + 2.0 * rate)
            mujoco.mj_step(model, data)
            if step == 0:
                effort[k] = data.actuator_force
    return q, effort


PLANTS = {"simulate": _simulated, "mujoco": _by_mujoco}
"""What makes the records: neither is what predicts them."""


def coverage(cases: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Identify synthetic cranes; a study for `cranedyn.sweep`.

    Args:
        cases: Columns ``seed``, ``plant`` and ``resolution``.

    Returns:
        For each parameter how far off it is [its unit], and half the width of its interval; and
        how many channels left a residual that is not white.
    """
    columns: dict[str, list[Any]] = {}
    rows = zip(*(cases[name].tolist() for name in ("seed", "plant", "resolution")), strict=True)
    for seed, plant, resolution in rows:
        model, truth = synthetic(int(seed), plant=plant, resolution=resolution)
        estimate = identify(model)
        for name, value in truth.items():
            columns.setdefault(f"{name}_off", []).append(estimate.value(name) - value)
            columns.setdefault(f"{name}_margin", []).append(estimate.margin(name))
        columns.setdefault("not_white", []).append(len(estimate.not_white))
    return {name: np.array(values) for name, values in columns.items()}


def covered(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Identify synthetic cranes, and count how often the intervals hold the truth."""
    count = whole("coverage", options.coverage, 1)
    plant = options.plant or "simulate"
    resolution = number("resolution", options.resolution or 0.0, "m", ">= 0")
    folder = options.folder / "cases"
    end = sweep(
        coverage,
        grid(seed=list(range(count)), plant=plant, resolution=resolution),
        folder,
        chunk=10,
        workers=options.workers,
        progress=setup.reporter.sweep("cranes"),
    )
    data = swept_columns(folder)
    rows = []
    for name in NAMES:
        off = data[f"{name}_off"]
        margin = data[f"{name}_margin"]
        hits = int((np.abs(off) <= margin).sum())
        rows.append((name, hits, 100.0 * hits / count, float(margin.mean()), float(off.std())))
    low, high = (int(binom.ppf(share, count, 0.95)) for share in (_TAIL, 1.0 - _TAIL))
    channels = 4 * count
    coloured = int(data["not_white"].sum())
    bound = int(binom.ppf(1.0 - _TAIL, channels, WHITE))
    claims = []
    for name, hits, *_ in rows:
        sentence = f"{name}: {hits} of {count} intervals hold the truth; "
        # Errors of a rounded motion have a memory, for which intervals are widened.
        exact = resolution == 0.0
        if exact:
            sentence += f"95 % of as many would be {low} to {high}."
        else:
            sentence += f"at least {low} of such as hold it in 95 % do."
        claims.append(Claim(sentence, low <= hits and (hits <= high or not exact)))
    if resolution == 0.0:
        claims.append(
            Claim(
                f"{coloured} of {channels} residuals are not white; of white ones {bound} would be "
                "at most.",
                coloured <= bound,
            )
        )
    claims.append(Claim("No crane failed.", end.errors == 0))
    columns = [("parameter", ""), ("held", "d"), ("%", ".1f"), ("±, mean", ".3g"), ("std", ".3g")]
    note = (
        f"Exact intervals hold in {low} to {high} with {100 * (1 - 2 * _TAIL):g} % certainty. "
        f"Records are made by {'MuJoCo' if plant == 'mujoco' else '`simulate`'}, with efforts as "
        f"logged; swings begin at up to {math.degrees(SWING):.0f}° in each joint. Each crane has "
        "numbers, moves and noise of its own; all fits start from the same wrong crane."
    )
    if resolution > 0.0:
        note += f" Positions are recorded in steps of {resolution:g} m and {resolution:g}°."
    return Outcome(
        tables=[ResultTable(f"Intervals of {count:,} synthetic cranes", columns, rows, note)],
        claims=claims,
        parameters={"cranes": count, "plant": plant, "resolution_m": resolution},
    )
