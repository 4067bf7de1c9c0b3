"""How often the intervals of an identification hold the truth.

Synthetic cranes, each with numbers and moves of its own, are run by `simulate` or by MuJoCo and
recorded with noise. Each is identified from its record, beginning with the same wrong crane. Of
95 % intervals, about 95 % have to hold the true numbers.
"""

from __future__ import annotations

import argparse
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cranedyn.checks import number, whole
from cranedyn.errors import DataError
from cranedyn.export.crane_data import urdf_element
from cranedyn.export.mjcf_file import mjcf
from cranedyn.identification import Model, Prior, Record, identify
from cranedyn.identification.drive_motion import SampledMotion
from cranedyn.identification.estimate import WHITENESS_LEVEL
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.sweep import grid, sweep
from experiments.harness import Claim, Outcome, ResultTable, Setup, swept_columns
from experiments.identify.trial import simulate_motion

NAMES = ("l_offset", "payload_mass", "damp_swing", "delay", "phi_bias", "theta_bias", "x_friction")
"""Parameters that are estimated of each crane."""

RANGES = {
    "l_offset": (-0.5, 0.5),
    "payload_mass": (700.0, 2500.0),
    "damp_swing": (1500.0, 4000.0),
    "delay": (0.0, 0.2),
    "phi_bias": (-5e-3, 5e-3),
    "theta_bias": (-5e-3, 5e-3),
    "x_friction": (200.0, 800.0),
}
"""Lower and upper end of the true value of each parameter [its SI unit]; it is drawn evenly, and
without regard to the others."""

DURATION = 40.0
"""Duration of a record [s]."""

INTERVAL = 0.1
"""Time from one row of a record to the next [s]."""

SWING = math.radians(20.0)
"""Largest angle of a swing joint at the beginning [rad]."""

NOISE = {"swing": 2e-3, "effort": 50.0}
"""Standard deviation of the noise of the sensors: of a swing [rad], of an effort [N]."""

PLANT_PERIOD = 2e-3
"""Time between rows of the plant [s]."""

MUJOCO_SUBSTEPS = 4
"""Steps of MuJoCo between two rows."""

SERVO_FREQUENCY = 500.0
"""Frequency of the servos that make MuJoCo's motors follow the motion [rad/s]."""

TAIL_PROBABILITY = 5e-4
"""Probability that a correct count is below what a claim allows, and that it is above."""


class Moves(NamedTuple):
    """Moves of a drive in a record.

    Attributes:
        number: Number of moves.
        distance: Largest distance of a move [rad or m].
        shortest: Shortest duration [s].
        longest: Longest duration [s].
    """

    number: int
    distance: float
    shortest: float
    longest: float


MOVES = {
    "x": Moves(2, 2.0, 2.0, 6.0),
    "gamma": Moves(1, 0.3, 3.0, 8.0),
    "l": Moves(1, 3.0, 6.0, 12.0),
}
"""Moves of each drive, by its symbol."""


@cache
def believed() -> Prior:
    """Return the prior of all cranes: the crane of the description."""
    return Prior()


def synthetic(
    seed: int, *, plant: str = "simulate", resolution: float = 0.0
) -> tuple[Model, dict[str, float]]:
    """Record a crane that differs from what is believed of it.

    Args:
        seed: Seed of all that is random.
        plant: What moves the crane, one of `PLANTS`.
        resolution: Steps in which the positions of trolley and hoist are recorded [m]; that of the
            slew is recorded in steps of as many degrees. 0 for exact positions.

    Returns:
        The model with its record, and the true value of each parameter.
    """
    steps = {"m": resolution, "rad": math.radians(resolution)}
    rng = np.random.default_rng(seed)
    prior = believed()
    truth = {name: float(rng.uniform(*ends)) for name, ends in RANGES.items()}
    crane = prior.load(payload_mass=truth["payload_mass"], damp_swing=truth["damp_swing"])
    t = PLANT_PERIOD * np.arange(round(DURATION / PLANT_PERIOD) + 1)
    position, velocity = _motion(crane, rng, t)
    first = dict(zip(("gamma", "x", "l"), position[0].tolist(), strict=True))
    # The true pendulum is longer than the cable that is recorded.
    first["l"] += truth["l_offset"]
    swing = {name: float(rng.uniform(-SWING, SWING)) for name in ("phi", "theta")}
    q, effort = PLANTS[plant](crane, crane.state(**first, **swing), position, velocity)

    stride = round(INTERVAL / PLANT_PERIOD)
    columns = {"t_s": t[::stride]}
    for i, joint in enumerate(crane.layout.driven):
        symbol = joint.symbol
        index = int(crane.layout.drives[i])
        recorded = (q[:, index] - truth.get(f"{symbol}_offset", 0.0))[::stride]
        if resolution > 0.0:
            recorded = steps[joint.unit] * np.round(recorded / steps[joint.unit])
        columns[joint.columns[0]] = recorded
        noise = NOISE["effort"] * rng.standard_normal(len(columns["t_s"]))
        # The plant moves its drives without friction: it is added to their efforts.
        friction = truth.get(f"{symbol}_friction", 0.0) * np.sign(velocity[:, i])
        if symbol != "gamma":
            columns[joint.effort_column] = (effort[:, i] + friction)[::stride] + noise
    for index in crane.swings.tolist():
        joint = crane.layout.joints[index]
        signal = CubicSpline(t, q[:, crane.layout.index(joint.symbol)])
        late = signal(np.maximum(columns["t_s"] - truth["delay"], 0.0))
        noise = NOISE["swing"] * rng.standard_normal(len(late))
        columns[joint.columns[0]] = late + truth[f"{joint.symbol}_bias"] + noise
    record = Record.of(prior.crane, columns, name=f"crane {seed}")
    return Model.of(prior, [record], NAMES, drives="motion"), truth


def _motion(crane: Crane, rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rates of the drives at times [s], shape (rows, m) each.

    Each drive starts at a random place and makes its `MOVES`, one after the other, by quintic
    splines of random begin, duration, direction and size.
    """
    start = {"x": rng.uniform(6.0, 16.0), "gamma": 0.0, "l": rng.uniform(8.0, 16.0)}
    position = np.zeros((len(t), crane.layout.m))
    velocity = np.zeros((len(t), crane.layout.m))
    for i, joint in enumerate(crane.layout.driven):
        moves = MOVES[joint.symbol]
        position[:, i] = start[joint.symbol]
        for k in range(moves.number):
            begins = rng.uniform(k, k + 0.8) * (DURATION - moves.longest) / moves.number
            lasts = rng.uniform(moves.shortest, moves.longest)
            phase = np.clip((t - begins) / lasts, 0.0, 1.0)
            size = rng.choice([-1.0, 1.0]) * rng.uniform(0.4, 1.0) * moves.distance
            position[:, i] += size * phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
            velocity[:, i] += size / lasts * 30.0 * (phase * (1.0 - phase)) ** 2
    return position, velocity


def _simulated(
    crane: Crane, start: State, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates, shape (rows, n), and logged efforts, shape (rows, m), of a run of
    `simulate` whose drives follow positions and velocities.
    """
    motion = SampledMotion(PLANT_PERIOD, position, velocity)
    run = simulate_motion(crane, start, motion, DURATION, validity="mark")
    return run.q, run.effort


def _by_mujoco(
    crane: Crane, start: State, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the same as `_simulated` of a run of MuJoCo, whose motors are stiff servos.

    A motor's force is the one that the motion needs of a crane at rest at the start, with a
    critically damped servo that takes what is left of the error.
    """
    try:
        import mujoco
    except ImportError:
        raise DataError("mujoco is not installed: pip install 'cranedyn[mujoco]'.") from None
    dt = PLANT_PERIOD / MUJOCO_SUBSTEPS
    text = ET.tostring(mjcf(crane, urdf_element(crane), dt), encoding="unicode")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    drives = crane.layout.drives
    data.qpos[:] = start.q
    data.qvel[:] = start.v
    # Relative to the start: the record does not show the offset of the cable length.
    aim = position + (start.q[drives] - position[0])
    acceleration = np.gradient(velocity, PLANT_PERIOD, axis=0)
    inertia = np.zeros((crane.layout.n, crane.layout.n))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    # What a drive has to move where the others and the load are free to yield.
    mass = 1.0 / np.diag(np.linalg.inv(inertia))[drives]
    needed = data.qfrc_bias[drives] + mass * acceleration
    q = np.empty((len(aim), crane.layout.n))
    effort = np.empty_like(aim)
    for k in range(len(aim)):
        q[k] = data.qpos
        for step in range(MUJOCO_SUBSTEPS):
            after = step * dt
            moved = after * (velocity[k] + 0.5 * after * acceleration[k])
            position_error = data.qpos[drives] - aim[k] - moved
            rate_error = data.qvel[drives] - velocity[k] - after * acceleration[k]
            # ω² times the error and 2 ω times its rate: a critically damped oscillator.
            data.ctrl[:] = needed[k] - mass * SERVO_FREQUENCY * (
                SERVO_FREQUENCY * position_error + 2.0 * rate_error
            )
            mujoco.mj_step(model, data)
            if step == 0:
                effort[k] = data.actuator_force
    return q, effort


PLANTS = {"simulate": _simulated, "mujoco": _by_mujoco}
"""What makes the records. The identification predicts them by neither."""


def coverage(cases: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Identify synthetic cranes: a study for `cranedyn.sweep`.

    Args:
        cases: Columns ``seed``, ``plant`` and ``resolution``.

    Returns:
        For each parameter, its error and half the width of its interval [its unit]; and the number
        of channels whose residual is not white.
    """
    columns: dict[str, list[Any]] = {}
    seeds = cases["seed"].tolist()
    plants = cases["plant"].tolist()
    resolutions = cases["resolution"].tolist()
    for seed, plant, resolution in zip(seeds, plants, resolutions, strict=True):
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
        error = data[f"{name}_off"]
        margin = data[f"{name}_margin"]
        hits = int((np.abs(error) <= margin).sum())
        rows.append((name, hits, 100.0 * hits / count, float(margin.mean()), float(error.std())))

    # Workers, which judge nothing, do not wait for this import.
    from scipy.stats import binom

    # The count of intervals that hold is binomial with a probability of 95 %.
    low = int(binom.ppf(TAIL_PROBABILITY, count, 0.95))
    high = int(binom.ppf(1.0 - TAIL_PROBABILITY, count, 0.95))
    is_exact = resolution == 0.0
    claims = []
    for name, hits, *_ in rows:
        sentence = f"{name}: {hits} of {count} intervals hold the truth; "
        # Errors of a rounded motion have a memory, for which intervals are widened: then more of
        # them may hold.
        if is_exact:
            sentence += f"95 % of as many would be {low} to {high}."
            holds = low <= hits <= high
        else:
            sentence += f"at least {low} of such as hold it in 95 % do."
            holds = low <= hits
        claims.append(Claim(sentence, holds))
    if is_exact:
        # Four channels of each crane: two swings and the efforts of two drives.
        channels = 4 * count
        coloured = int(data["not_white"].sum())
        bound = int(binom.ppf(1.0 - TAIL_PROBABILITY, channels, WHITENESS_LEVEL))
        sentence = (
            f"{coloured} of {channels} residuals are not white; of white ones {bound} would be "
            "at most."
        )
        claims.append(Claim(sentence, coloured <= bound))
    claims.append(Claim("No crane failed.", end.errors == 0))
    columns = [("parameter", ""), ("held", "d"), ("%", ".1f"), ("±, mean", ".3g"), ("std", ".3g")]
    certainty = 100 * (1 - 2 * TAIL_PROBABILITY)
    note = (
        f"Exact intervals hold in {low} to {high} with {certainty:g} % certainty. "
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
