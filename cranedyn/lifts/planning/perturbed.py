"""Perturbed lifts: a certified lift simulated many times with other loads, cables, winds and
sensors; how often it comes closer than required, and how close.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.checks import finite, short_repr, whole, within, worker_count
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.inputs import check_fits_memory
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.disturbances.wind import drag_force, gust_shape
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.lifts.planning.certificate import AFTER, Certificate, controller_of
from cranedyn.lifts.planning.clearance import Clearance, Joints
from cranedyn.lifts.planning.curve import interpolate_columns
from cranedyn.lifts.planning.lift import Lift
from cranedyn.model.crane import Crane

CONFIDENCE = 0.95
"""Confidence of the interval of a probability."""

_RECORDING_INTERVAL = 0.1
"""Time between rows that are kept [s]."""

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of the box around a load."""

_LOAD_LEVELS = 13
"""Number of different masses of the load. Lifts of the same mass are simulated at once."""

_CHUNK_SIZE = 300
"""Largest number of lifts that are simulated at once."""

_NUMBERS_PER_LIFT = 12
"""Numbers for each lift that `perturb` holds in memory: those drawn, the results, and room for
those on the way."""


@dataclass(frozen=True)
class Spread:
    """Ranges in which lifts differ from the plan; each number is drawn uniformly.

    Attributes:
        load: Change of the mass of the load, as a share of it; in 13 steps.
        cable: Error of the measured cable length [m].
        wind: Largest steady wind [m/s], from any side, in which the load hangs at the start.
        gust: Largest rise of one gust [m/s], of shape (1 - cos)/2, in the same direction, at any
            time of the lift.
        gust_lasts: Shortest and longest gust [s].
        late: Delays of the sensors to draw from [s].

    Raises:
        OutOfRange: If a number is none, negative or not finite, the load could be gone, or a gust
            has no length.
        CraneError: If there is no delay of the sensors.
    """

    load: float = 0.3
    cable: float = 0.5
    wind: float = 4.0
    gust: float = 6.0
    gust_lasts: tuple[float, float] = (3.0, 12.0)
    late: tuple[float, ...] = (0.0, 0.005, 0.010, 0.020)

    def __post_init__(self) -> None:
        """Check the numbers."""
        within("share of the load", self.load, 0.0, 0.99)
        for name, unit in (("cable", "m"), ("wind", "m/s"), ("gust", "m/s")):
            within(f"spread of the {name}", getattr(self, name), 0.0, 100.0, unit)
        shortest, longest = finite("lengths of a gust", self.gust_lasts, (2,), unit="s")
        shortest = within("shortest gust", shortest, 1e-3, 3600.0, "s")
        within("longest gust", longest, shortest, 3600.0, "s")
        for delay in finite("delays of the sensors", self.late, ("n",), unit="s"):
            within("delay of the sensors", delay, 0.0, 10.0, "s")
        if not len(self.late):
            raise CraneError("delays of the sensors is (); allowed is one or more [s].")


@dataclass(frozen=True, eq=False)
class Perturbed:
    """Results of perturbed lifts.

    Attributes:
        least: Lower bound of the distance between anything that hangs and any obstacle in each lift
            [m], exact where it could be less than required; the distance from zones, which require
            none, counts with the required distance added; not a number where the lift failed: the
            rope slack, a range left; shape (n,).
        required: Required distance [m].
        drawn: Numbers drawn for each lift, by name.
        swing: Amplitude of the swing after each lift [rad], shape (n,).
    """

    least: np.ndarray
    required: float
    drawn: dict[str, np.ndarray]
    swing: np.ndarray

    @property
    def failures(self) -> int:
        """Number of lifts that came closer than required, or failed."""
        return int(np.count_nonzero(~(self.least >= self.required)))

    @property
    def broken_off(self) -> int:
        """Number of lifts in which a joint left its range or the rope was slack."""
        return int(np.count_nonzero(np.isnan(self.least)))

    def interval(self) -> tuple[float, float]:
        """Return the confidence interval of the probability of a failure, by Clopper and Pearson
        (1934).
        """
        from scipy.stats import binomtest  # slow, and needed once there are results

        low, high = binomtest(self.failures, len(self.least)).proportion_ci(CONFIDENCE, "exact")
        return float(low), float(high)


def perturb(
    certificate: Certificate,
    count: int,
    *,
    spread: Spread = Spread(),
    seed: int = 1,
    dt: float = 1e-3,
    threads: int | None = None,
) -> Perturbed:
    """Simulate a certified lift many times with perturbations.

    Args:
        certificate: The lift.
        count: Number of lifts.
        spread: Ranges of the perturbations.
        seed: Seed of the random numbers.
        dt: Physics step [s].
        threads: Number of threads; by default one for each processor.

    Raises:
        OutOfRange: If the count is not a whole number from 1 on, or the random numbers do not fit
            into memory.
    """
    whole("number of lifts", count, 1)
    check_fits_memory("number of lifts", short_repr(count), _NUMBERS_PER_LIFT * count)
    lift = certificate.lift
    rng = np.random.default_rng(whole("seed", seed, 0))
    # The order of these calls decides which numbers are drawn from a seed.
    levels = np.sort(rng.integers(0, _LOAD_LEVELS, count))
    drawn = {
        "load": 1.0 + spread.load * np.linspace(-1.0, 1.0, _LOAD_LEVELS)[levels],
        "cable_m": rng.uniform(-spread.cable, spread.cable, count),
        "wind_m_s": rng.uniform(0.0, spread.wind, count),
        "gust_m_s": rng.uniform(0.0, spread.gust, count),
        "gust_at_s": rng.uniform(0.0, lift.timed.motion.arrival, count),
        "gust_lasts_s": rng.uniform(*spread.gust_lasts, count),
        "direction_rad": rng.uniform(-math.pi, math.pi, count),
        "late_s": rng.choice(spread.late, count),
    }
    least = np.empty(count)
    swing = np.empty(count)
    for chunk in simulate_perturbed(certificate, drawn, dt=dt, threads=threads):
        least[chunk.rows] = chunk.least
        swing[chunk.rows] = chunk.batch.residual_swing
    return Perturbed(least, lift.clearance.site.distance, drawn, swing)


class PerturbedBatch(NamedTuple):
    """Perturbed lifts of one load that were simulated at once.

    Attributes:
        rows: Indices of these lifts among all, shape (k,).
        crane: The crane with their load.
        batch: The simulated lifts, a row each tenth of a second.
        force: Force of the wind on the points of the crane from each of these rows to the next [N],
            shape (k, rows, 3 points).
        least: Lower bounds of the least distance [m], as `Perturbed.least`, shape (k,).
    """

    rows: np.ndarray
    crane: Crane
    batch: Batch
    force: np.ndarray
    least: np.ndarray


def simulate_perturbed(
    certificate: Certificate,
    drawn: dict[str, np.ndarray],
    *,
    dt: float = 1e-3,
    threads: int | None = None,
) -> Iterator[PerturbedBatch]:
    """Simulate a certified lift once for each set of numbers, some hundred lifts at a time.

    Args:
        certificate: The lift.
        drawn: Perturbations by the names of `Perturbed.drawn`, shape (n,) each.
        dt: Physics step [s].
        threads: Number of threads; by default one for each processor.
    """
    lift = certificate.lift
    nominal = controller_of(lift, dt=dt)
    cranes = {}
    for load in np.unique(drawn["load"]).tolist():
        cranes[load] = _crane_with_load(lift.crane, load)
    planned = certificate.run.q[:: _periods_per_row(lift)]
    margins = np.array([lift.clearance.margin(q) for q in planned])
    workers = worker_count("threads", threads)

    def finished(chunk: np.ndarray, simulation: Future[_ChunkResult]) -> PerturbedBatch:
        batch, force = simulation.result()
        least = _least_distances(lift.clearance, planned, margins, batch)
        crane = cranes[float(drawn["load"][chunk[0]])]
        return PerturbedBatch(chunk, crane, batch, force, least)

    # Distances are measured here while the threads simulate the next chunks. No more than one chunk
    # beyond their number is submitted at a time, so that few results wait in memory.
    running = deque[tuple[np.ndarray, Future[_ChunkResult]]]()
    with ThreadPoolExecutor(workers) as pool:
        for chunk in _chunks(drawn):
            values = {name: column[chunk] for name, column in drawn.items()}
            simulation = pool.submit(_simulate_chunk, lift, nominal, values, cranes, dt)
            running.append((chunk, simulation))
            if len(running) > workers:
                yield finished(*running.popleft())
        while running:
            yield finished(*running.popleft())


def _chunks(drawn: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Return the indices of lifts that are simulated at once: of the same load and delay, so that
    they share a controller, and at most `_CHUNK_SIZE`.
    """
    kinds = np.stack([drawn["load"], drawn["late_s"]])
    _, kind_of_lift = np.unique(kinds, axis=1, return_inverse=True)
    kind_of_lift = kind_of_lift.ravel()
    chunks = []
    for kind in range(kind_of_lift.max() + 1):
        lifts = np.flatnonzero(kind_of_lift == kind)
        chunks += np.array_split(lifts, math.ceil(len(lifts) / _CHUNK_SIZE))
    return chunks


def _crane_with_load(crane: Crane, load: float) -> Crane:
    """Return the crane with a multiple of the mass of its load, whose size and inertia about its
    centre stay as they are.
    """
    if load == 1.0:
        return crane
    model = crane.model.copy()
    joint = crane.payload.body + 1
    inertia = model.inertias[joint]
    inertia.mass = load * inertia.mass
    model.inertias[joint] = inertia
    return replace(crane, model=model)


def with_sensor_delay(controller: HoistIntegral, delay: float) -> Tracking:
    """Return the tracking controller of a lift whose sensors are late by a delay [s].

    What it reads at a time t is the state at t less the delay. Where the lift goes as planned, that
    is as if its setpoint were ahead by the delay.
    """
    table = controller.tracking
    rows = np.arange(len(table.setpoint))
    setpoint = interpolate_columns(rows + delay / table.period, rows, table.setpoint)
    return replace(table, setpoint=setpoint)


def _simulate_chunk(
    lift: Lift,
    nominal: HoistIntegral,
    drawn: dict[str, np.ndarray],
    cranes: dict[float, Crane],
    dt: float,
) -> _ChunkResult:
    """Simulate lifts of one load.

    Args:
        lift: The lift.
        nominal: Its controller.
        drawn: Perturbations by the names of `Perturbed.drawn`, shape (k,) each.
        cranes: Crane of each load.
        dt: Physics step [s].
    """
    crane = lift.crane
    motion = lift.timed.motion
    load = float(drawn["load"][0])
    hoist = lift.clearance.joints.hoist

    # Code is compiled for the numbers that differ in a batch. All batches share one if the mass of
    # the load always differs: the last lift is simulated again with another load, and left out of
    # the results.
    drawn = {name: np.append(values, values[-1]) for name, values in drawn.items()}
    count = len(drawn["load"])
    other_loads = [other for other in cranes if other != load]
    other_crane = cranes[other_loads[0]] if other_loads else cranes[load]

    # The load has hung there for a while: the integral holds what its weight differs by.
    missing_weight = (1.0 - load) * crane.payload_mass * crane.gravity
    integral = missing_weight / nominal.integral_gain
    controllers = {}
    for delay in np.unique(drawn["late_s"]).tolist():
        tracking = with_sensor_delay(nominal, delay)
        controllers[delay] = replace(nominal, tracking=tracking, integral=integral)

    # The cable is longer than planned, and measured as planned.
    force = _wind_forces(lift, drawn)
    start = np.tile(lift.states()[0].q, (count, 1))
    start[:, hoist] += drawn["cable_m"]
    sensor_offset = np.zeros((count, 2 * crane.layout.n))
    sensor_offset[:, hoist] = -drawn["cable_m"]
    _hang_in_wind(start, force[:, 0, :3], cranes[load], lift.clearance.joints)

    batch = simulate_batch(
        [*[cranes[load]] * (count - 1), other_crane],
        [controllers[delay] for delay in drawn["late_s"].tolist()],
        motion,
        start=State(start, np.zeros_like(start)),
        duration=motion.period * _period_count(lift),
        dt=dt,
        control_period=motion.period,
        force=force,
        force_interval=_periods_per_row(lift),
        sensor_offset=sensor_offset,
        residual_from=motion.arrival,
        record=_periods_per_row(lift),
        threads=1,
    )
    batch = replace(
        batch,
        peak_swing=batch.peak_swing[:-1],
        residual_swing=batch.residual_swing[:-1],
        largest_effort=batch.largest_effort[:-1],
        valid_until=batch.valid_until[:-1],
    )
    return _ChunkResult(batch, force[:-1])


class _ChunkResult(NamedTuple):
    """Simulated lifts of one chunk.

    Attributes:
        batch: The simulated lifts.
        force: Force of the wind as of `PerturbedBatch`.
    """

    batch: Batch
    force: np.ndarray


def _period_count(lift: Lift) -> int:
    """Return the number of control periods for which a lift is simulated."""
    motion = lift.timed.motion
    return round(motion.arrival / motion.period) + math.ceil(AFTER / motion.period)


def _periods_per_row(lift: Lift) -> int:
    """Return the number of control periods between rows that are kept."""
    return max(1, round(_RECORDING_INTERVAL / lift.timed.motion.period))


def _hang_in_wind(start: np.ndarray, force: np.ndarray, crane: Crane, joints: Joints) -> None:
    """Set the swing angles of loads so that wind and weight balance, their pivots unmoved.

    The rope points along the sum of weight W and force F. Its radial angle turns first, so that it
    takes the outward part F_o against W, and its tangential angle takes the part F_t along the
    direction of positive slew against √(W² + F_o²).

    Args:
        start: Coordinates, shape (k, n); the swing angles are overwritten.
        force: Forces of the wind in the world [N], shape (k, 3).
        crane: The crane with the load.
        joints: Its joints.
    """
    gamma = start[:, joints.slew]
    weight = crane.payload_mass * crane.gravity
    # At a slew of zero the jib points along -Y, and positive slew moves it towards +X.
    outward = force[:, 0] * np.sin(gamma) - force[:, 1] * np.cos(gamma)
    tangential = force[:, 0] * np.cos(gamma) + force[:, 1] * np.sin(gamma)
    start[:, joints.radial_swing] = -np.arctan2(outward, weight)
    start[:, joints.tangential_swing] = -np.arctan2(tangential, np.hypot(weight, outward))


def _wind_forces(lift: Lift, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """Return the drag of the wind on the load, which moves as planned, in the middle between rows
    that are kept [N], shape (k, rows, 3 points).
    """
    motion = lift.timed.motion
    rows = np.arange(0, _period_count(lift) + 1, _periods_per_row(lift))
    times = motion.period * (rows + _periods_per_row(lift) / 2.0)

    points = lift.clearance.point(lift.timed.places)
    step = motion.arrival / (len(points) - 1)
    point_times = step * np.arange(len(points))
    load_velocity = interpolate_columns(times, point_times, np.gradient(points, step, axis=0))
    load_velocity[times > step * (len(points) - 1)] = 0.0

    # One row for each lift, to be combined with one column for each time.
    steady = drawn["wind_m_s"][:, None]
    rise = drawn["gust_m_s"][:, None]
    begin = drawn["gust_at_s"][:, None]
    duration = drawn["gust_lasts_s"][:, None]
    direction = drawn["direction_rad"][:, None]
    speed = (steady + rise * gust_shape(times, begin, duration))[..., None]
    unit_vector = np.stack([np.cos(direction), np.sin(direction)], axis=-1)

    area = DRAG_COEFFICIENT * _largest_silhouette(lift.clearance.bodies.load)
    # Of the points of a crane the payload is the first.
    force = np.zeros((len(drawn["load"]), len(times), 3 * len(lift.crane.points)))
    force[..., :2] = drag_force(area, speed * unit_vector - load_velocity[:, :2])
    return force


def _largest_silhouette(corners: np.ndarray) -> float:
    """Return the largest area that the box around a load shows to a horizontal wind [m²]: that of
    its vertical section through opposite edges.
    """
    length, width, height = np.ptp(corners, axis=0)
    return float(math.hypot(length, width) * height)


def _least_distances(
    clearance: Clearance, planned: np.ndarray, margins: np.ndarray, batch: Batch
) -> np.ndarray:
    """Return a lower bound of the least distance in each lift [m], shape (k,); NaN for a lift that
    failed.

    Where a lift differs from planned coordinates by less than their margins, that difference gives
    the bound. Elsewhere distances are measured in the recorded rows, less the way between these,
    and bound those of the rows around by the way to them.

    Args:
        clearance: Crane and site.
        planned: Planned coordinates in the recorded rows, shape (rows, n).
        margins: Their margins [m], shape (rows,).
        batch: The lifts.
    """
    # Nothing that hangs moves farther between two rows than this. So at every instant it is no
    # farther than half of it from where it is in one of them.
    way = clearance.displacement(batch.q[:, :-1, :], batch.q[:, 1:, :])
    half_way = way / 2.0
    half_way_before = np.pad(half_way, ((0, 0), (1, 0)))
    half_way_after = np.pad(half_way, ((0, 0), (0, 1)))
    step = np.maximum(half_way_before, half_way_after)
    moved = np.pad(np.cumsum(2.0 * half_way, axis=1), ((0, 0), (1, 0)))

    by_plan = margins - clearance.displacement(planned, batch.q) - step
    held = np.isfinite(by_plan).all(axis=1) & ~np.isfinite(batch.valid_until)
    distances = np.full(len(batch.q), np.nan)
    for i in np.flatnonzero(held):
        least_margin = _least_margin(clearance, batch.q[i], by_plan[i], moved[i], step[i])
        distances[i] = least_margin + clearance.site.distance
    return distances


def _least_margin(
    clearance: Clearance, q: np.ndarray, bounds: np.ndarray, moved: np.ndarray, step: np.ndarray
) -> float:
    """Return a lower bound of the least margin in a lift [m], exact where it is negative.

    The row with the lowest bound is measured until that bound is not negative, or is that of a row
    that was measured.

    Args:
        clearance: Crane and site.
        q: Coordinates, shape (rows, n).
        bounds: Lower bounds of the margin about each row [m], shape (rows,).
        moved: Way of what hangs up to each row [m], shape (rows,).
        step: Way about each row that it stands for [m], shape (rows,).
    """
    measured = set[int]()
    while True:
        k = int(np.argmin(bounds))
        if k in measured or not bounds[k] < 0.0:
            return float(bounds[k])
        margin = clearance.margin(q[k])
        bounds = np.maximum(bounds, margin - np.abs(moved - moved[k]) - step)
        measured.add(k)
