"""The study of the sweep: the combined move by a strategy, on cranes that are not as planned.

Each strategy plans the move once. Many cranes then make it together as a batch. They differ from
the planned one in load and cable; or, where cases are drawn at random, in everything at once: load,
cable, wind, sensors and drives.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.checks import whole
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.kernel import Precision
from cranedyn.disturbances.wind import drag_force, gust_shape
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.dynamics.validity import conditions, hoist_force, valid
from cranedyn.estimation.sensor_model import noise_of
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references.shaped import zv, zvd
from cranedyn.sweep import Design, cross, grid
from experiments.harness.setup import Setup
from experiments.scenarios import shaping, strategies
from experiments.scenarios.moves import (
    COMBINED,
    DRAG,
    IDEAL,
    MovePlan,
    Planner,
    RestToRest,
    instant,
    on_converters,
)

AFTER = 10.0
"""Time after the arrival at which the residual swing is read [s]."""

WORLD_COLUMNS = ("gravity_m_s2", "dt_s", "control_period_s")
"""Columns of a design with gravity and clocks, which are the same in every case."""

COMPARED_CASES = 8
"""Number of cases of a batch in single precision that are computed in doubles, too."""


SWEPT: dict[str, Planner] = {
    strategies.PD: strategies.STRATEGIES[strategies.PD],
    "spline alone": strategies.STRATEGIES["spline alone"],
    "spline + ZV": shaping.shaped_plan(zv(), shaping.spline_base),
    "spline + ZVD": shaping.shaped_plan(zvd(), shaping.spline_base),
    "spline + ZV for a moving cable": shaping.plan_for_moving_cable(shaping.spline_base),
    strategies.PAPER: strategies.STRATEGIES[strategies.PAPER],
    strategies.LQR: strategies.STRATEGIES[strategies.LQR],
    strategies.FLAT: strategies.STRATEGIES[strategies.FLAT],
}
"""Strategies of the grid, by name. Those without a controller in their name have drives that follow
exactly, as stiff velocity-controlled drives do."""

STRATEGIES = strategies.STRATEGIES | SWEPT
"""All strategies, by name."""


NOISY_BATCH = 128
"""Largest number of moves in a batch whose sensors have noise; each of them needs some MB."""

ROW_INTERVAL = 0.05
"""Time between the instants at which drawn cases are recorded [s]."""

Cases = Mapping[str, np.ndarray]
"""Columns of cases by name, shape (cases,) each."""


def simulate_cases(cases: Cases) -> dict[str, np.ndarray]:
    """Make the move of each case: a study for `cranedyn.sweep`.

    Args:
        cases: Columns of all cases: ``strategy``; ``duration_s``, the planned duration; ``load``,
            the mass of the payload over the planned one; ``cable_error_m``, the true less the
            measured cable length; and `WORLD_COLUMNS`. Also ``drive``, "ideal" or "velocity", by
            default "ideal"; ``precision``, "single" or by default "double", the same in all cases;
            and of cases that are drawn the columns of `drawn`.

    Returns:
        Columns of all cases: largest swing, and amplitude of the swing 10 s after the arrival
        [rad]; distance of the payload from its goal then [m]; largest efforts over those of the
        drives; and the time at which the model ceased to hold or drives could not follow [s],
        masked where that did not occur. In single precision also ``rounding_rad``: by how much the
        swing that is left differs from that in doubles [rad], masked in all but `COMPARED_CASES`
        cases of each batch, which alone are computed in doubles, too. Of cases that are drawn also
        the amplitude at the arrival [rad], whether a range was left or the rope went slack (1 or
        0), and the processor time of the case [s]; where such a crane diverged, what is not finite
        is masked.
    """
    # All cases of a sweep are in one world.
    gravity, dt, control_period = (float(cases[name][0]) for name in WORLD_COLUMNS)
    setup = Setup(gravity, dt=dt, control_period=control_period)
    count = len(cases["strategy"])
    drives = cases.get("drive", np.full(count, IDEAL))
    precision: Precision = "double"
    if "precision" in cases and cases["precision"][0] == "single":
        precision = "single"
    # Cases with the same strategy, duration and drives have one plan, and run as a batch.
    kinds = list(
        zip(cases["strategy"].tolist(), cases["duration_s"].tolist(), drives.tolist(), strict=True)
    )
    columns: dict[str, np.ndarray] = {}
    for kind in dict.fromkeys(kinds):
        rows = np.array([row for row, kind_of_row in enumerate(kinds) if kind_of_row == kind])
        batches = math.ceil(len(rows) / NOISY_BATCH) if "noise" in cases else 1
        plan, move = _planned(gravity, dt, control_period, *kind)
        for chunk in np.array_split(rows, batches):
            of_chunk = {name: column[chunk] for name, column in cases.items()}
            for name, values in _batch_columns(setup, plan, move, of_chunk, precision).items():
                columns.setdefault(name, np.ma.masked_all(count))[chunk] = values
    return columns


@lru_cache(maxsize=64)
def _planned(
    gravity: float, dt: float, control_period: float, strategy: str, duration: float, drive: str
) -> tuple[MovePlan, RestToRest]:
    """Plan a move by a strategy, once for all chunks of a process."""
    setup = Setup(gravity, dt=dt, control_period=control_period)
    move = replace(COMBINED, duration=duration)
    plan = STRATEGIES[strategy](setup, move)
    return (plan if drive == IDEAL else on_converters(setup, plan)), move


def _batch_columns(
    setup: Setup, plan: MovePlan, move: RestToRest, cases: Cases, precision: Precision
) -> dict[str, np.ndarray]:
    """Simulate cases with one plan as a batch, and return their columns of results.

    Args:
        setup: The world.
        plan: How the move is made.
        move: The move.
        cases: Columns of these cases.
        precision: Precision of the steps.
    """
    began = time.process_time()
    crane = setup.crane
    masses = (cases["load"] * crane.payload_mass).tolist()
    cranes = [_crane(setup.gravity, mass) for mass in masses]
    is_drawn = "noise" in cases
    move_start, move_goal = move.ends(crane)
    start = _longer(crane, move_start, cases["cable_error_m"])
    goal = _longer(crane, move_goal, cases["cable_error_m"])
    # A plan without an arrival, such as one that goes to a goal, is read after the planned time.
    arrives = instant(plan.arrives or move.duration, setup.control_period)
    ends = instant(arrives + AFTER, setup.control_period)
    times = setup.control_period * np.arange(round(ends / setup.control_period) + 1)
    stride = max(1, round(ROW_INTERVAL / setup.control_period))
    # Drives that follow exactly need no sensors.
    if plan.drive == "motion":
        cases = {name: column for name, column in cases.items() if name not in SENSOR_COLUMNS}
    force = gusts(crane, cases, times) if is_drawn else None
    offset = readings(crane, cases, len(times))
    delays = cases["delay"].astype(int) if "delay" in cases else None
    lags = lagging(crane, cases) if is_drawn and plan.drive == "velocity" else None
    numbers = np.arange(len(cranes))

    def run(rows: slice | np.ndarray, precision: Precision) -> Batch:
        """Make the moves of some of the cases."""
        return simulate_batch(
            [cranes[row] for row in numbers[rows]],
            plan.controller(),
            plan.reference,
            start=State(start.q[rows], start.v[rows]),
            duration=ends,
            dt=setup.dt,
            control_period=setup.control_period,
            drive=plan.drive,
            force=None if force is None else force[rows],
            sensor_offset=offset[rows],
            sensor_delay=0 if delays is None else delays[rows].tolist(),
            converters=None if lags is None else [lags[row] for row in numbers[rows]],
            record=stride if is_drawn else 0,
            residual_from=ends,
            threads=1,
            precision=precision,
        )

    batch = run(slice(None), precision)
    columns = {
        "peak_swing_rad": batch.peak_swing,
        "residual_swing_rad": batch.residual_swing,
        "off_goal_m": _distances_from_goals(cranes, batch.end.q, goal.q),
    }
    if precision == "single":
        compared = np.unique(np.linspace(0, len(cranes) - 1, COMPARED_CASES).astype(int))
        exact = run(compared, "double").residual_swing
        rounding = np.ma.masked_all(len(cranes))
        rounding[compared] = np.abs(batch.residual_swing[compared] - exact)
        columns["rounding_rad"] = np.ma.masked_invalid(rounding)
    shares = batch.largest_effort / crane.effort_limit
    for i, drive in enumerate(DRIVES):
        columns[f"{drive}_effort_share"] = shares[:, i]
    if is_drawn:
        row = int(np.searchsorted(batch.t, arrives - 1e-9))
        spent = (time.process_time() - began) / len(masses)
        columns["valid_until_s"] = batch.valid_until
        columns["arrival_swing_rad"] = _amplitudes(crane, batch, row)
        columns["broken"] = (~_stays_valid(crane, batch)).astype(float)
        columns["spent_s"] = np.full(len(masses), spent)
        return {name: np.ma.masked_invalid(values) for name, values in columns.items()}
    # A time that is not finite did not occur. Whatever else is not finite on the grid is a fault,
    # which is not masked.
    columns["valid_until_s"] = np.ma.masked_invalid(batch.valid_until)
    return columns


DRIVES = ("slew", "trolley", "hoist")
"""Names of the drives, in the order of the chain."""

SENSOR_COLUMNS = ("noise", "delay")
"""Columns of cases that change sensors."""


def gusts(crane: Crane, cases: Cases, times: np.ndarray) -> np.ndarray:
    """Return the forces of a gust on each load [N], shape (cranes, rows, 3 points).

    The speed of a gust rises and falls as (1 - cos)/2. The load's own velocity is neglected: the
    force is that on a load at rest.

    Args:
        crane: The crane.
        cases: The cases.
        times: Times of the rows [s].
    """
    shape = gust_shape(times, cases["gust_at_s"][:, None], cases["gust_lasts_s"][:, None])
    speed = cases["gust_m_s"][:, None] * shape
    direction = cases["gust_to_rad"]
    unit_vector = np.column_stack([np.cos(direction), np.sin(direction)])
    first = 3 * crane.layout.points.index("payload")
    force = np.zeros((*speed.shape, 3 * len(crane.points)))
    force[..., first : first + 2] = drag_force(DRAG, speed[..., None] * unit_vector[:, None])
    return force


def readings(crane: Crane, cases: Cases, rows: int) -> np.ndarray:
    """Return the errors of the sensors of coordinates and rates.

    Args:
        crane: The crane.
        cases: The cases, with noise or without.
        rows: Number of rows of a run.

    Returns:
        Errors by the cable, shape (cranes, 2 n); with noise, shape (cranes, rows, 2 n).
    """
    errors = cases["cable_error_m"]
    hoist = crane.layout.index("l")
    if "noise" not in cases:
        added = np.zeros((len(errors), 2 * crane.layout.n))
    else:
        sizes = noise_of(crane)
        added = np.empty((len(errors), rows, len(sizes)))
        for noise, seed, number in zip(added, cases["seed"], cases["number"], strict=True):
            # Each case has noise of its own, so that it does not depend on the batch it is in.
            bits = np.random.SFC64([int(seed), int(number)])
            np.random.Generator(bits).standard_normal(out=noise)
        added *= cases["noise"][:, None, None] * sizes
    # The cable is longer than measured by the error. With noise there is an axis more, of rows.
    cable_errors = errors if added.ndim == 2 else errors[:, None]
    added[..., hoist] -= cable_errors
    return added


def lagging(crane: Crane, cases: Cases) -> list[Converters]:
    """Return typical frequency converters with a lag of its own for each crane."""
    typical = converters(crane)
    return [replace(typical, lags=lag * typical.lags) for lag in cases["lag"].tolist()]


def _distances_from_goals(cranes: list[Crane], ends: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Return the distances of loads from their goals [m]; NaN where a crane diverged."""
    distances = []
    for crane, q, goal in zip(cranes, ends, goals, strict=True):
        distance = math.nan
        if np.isfinite(q).all():
            offset = payload_position(crane, q) - payload_position(crane, goal)
            distance = float(np.linalg.norm(offset))
        distances.append(distance)
    return np.array(distances)


def _amplitudes(crane: Crane, batch: Batch, row: int) -> np.ndarray:
    """Return amplitudes of the swing at a recorded row [rad], shape (cranes,)."""
    q = batch.q[:, row]
    v = batch.v[:, row]
    swings = crane.swings
    length = q[:, crane.layout.index("l")]
    return swing_amplitude(q[:, swings], v[:, swings], length, crane.gravity)


def _stays_valid(crane: Crane, batch: Batch) -> np.ndarray:
    """Return whether the joints stay in range, the rope taut and the load above ground, shape
    (cranes,).
    """
    shape = batch.q.shape[:2]
    q = batch.q.reshape(-1, batch.q.shape[-1])
    v = batch.v.reshape(-1, batch.v.shape[-1])
    effort = batch.effort.reshape(-1, batch.effort.shape[-1])
    # A crane that diverged has numbers that are not finite.
    with np.errstate(invalid="ignore"):
        holds = valid(conditions(crane, q, v, hoist_force(crane, effort))).reshape(shape)
    return np.asarray(holds.all(axis=1))


def _longer(crane: Crane, state: State, extra: np.ndarray) -> State:
    """Return copies of a state at rest, each with a cable that is longer by so much [m]."""
    q = np.tile(state.q, (len(extra), 1))
    q[:, crane.layout.index("l")] += extra
    return State(q, np.zeros_like(q))


@lru_cache(maxsize=4096)
def _crane(gravity: float, payload_mass: float) -> Crane:
    """Return the crane with another load, cached by load."""
    return Setup(gravity).variant(payload_mass=payload_mass)


RANGES = {
    "load": (0.5, 1.5),
    "cable_error_m": (-1.5, 1.5),
    "gust_m_s": (0.0, 12.0),
    "gust_to_rad": (-math.pi, math.pi),
    "gust_at_s": (0.0, 8.0),
    "gust_lasts_s": (4.0, 8.0),
    "noise": (0.0, 2.0),
    "delay": (0.0, 5.0),
    "lag": (0.5, 2.0),
}
"""Lower and upper end of the range from which each number of a case is drawn evenly.

These are the mass of the payload over the planned one; the true less the measured cable length [m];
of a gust of wind the largest speed [m/s], the direction in which it blows, from the world's +X
[rad], its beginning and its duration [s]; the noise of the sensors as a multiple of
`sensor_model.noise_of`; their delay in whole control periods, 0 to 4; and the lags of frequency
converters over the typical ones.
"""

LEVELS = 129
"""Number of different loads, at equal distances: so not every case needs a crane of its own."""

UNBATCHED = {
    strategies.MPC: "its optimiser is called from Python; the compiled one stands for it",
    strategies.YIELD: "its rates are not affine in the state",
}
"""Why strategies cannot run in a batch, by their names."""

DRAWN = [name for name in strategies.STRATEGIES if name not in UNBATCHED]
"""Strategies for which cases are drawn."""


def drawn(setup: Setup, names: Sequence[str], drive: str, count: int, seed: int) -> Design:
    """Draw cases, the same for each strategy.

    With the same seed, fewer cases are the first of more.

    Args:
        setup: Gravity and clocks.
        names: Names of strategies.
        drive: Kind of drives, "ideal" or "velocity".
        count: Number of cases for each strategy.
        seed: Seed of the random numbers.

    Raises:
        OutOfRange: If the seed is not a whole number from 0.
        CraneError: If the table would not fit the memory.
    """
    seed = whole("seed", seed, 0)
    plans = grid(
        strategy=list(names),
        drive=drive,
        duration_s=COMBINED.duration,
        gravity_m_s2=setup.gravity,
        dt_s=setup.dt,
        control_period_s=setup.control_period,
        seed=seed,
    )
    # A row of random numbers for each case, so that fewer cases are the first of more.
    low, high = np.array(list(RANGES.values())).T
    shares = np.random.default_rng(seed).random((count, len(RANGES)))
    columns = dict(zip(RANGES, (low + (high - low) * shares).T, strict=True))
    # Loads are rounded to levels, delays to whole periods.
    lightest, heaviest = RANGES["load"]
    levels = np.linspace(lightest, heaviest, LEVELS)
    share = (columns["load"] - lightest) / (heaviest - lightest)
    columns["load"] = levels[np.rint(share * (LEVELS - 1)).astype(int)]
    columns["delay"] = np.floor(columns["delay"])
    return cross(plans, Design(columns | {"number": np.arange(count, dtype=float)}))
