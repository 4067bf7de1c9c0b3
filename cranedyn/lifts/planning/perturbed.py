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
from cranedyn.disturbances.wind import drag_force, gust_shape
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.lifts.planning.certificate import AFTER, Certificate, controller_of
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.curve import interpolate_columns
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.motion_proof import MAX_ACCELERATION
from cranedyn.model.crane import Crane

CONFIDENCE = 0.95
"""Confidence of the interval of a probability."""

_RECORDING_INTERVAL = 0.1
"""Time between rows that are kept [s]."""

MAX_SENSOR_DELAY = 1.0
"""Largest delay of the sensors [s]. No crane is controlled by readings as late as that."""

_ROUNDING = 1e-6
"""Rounding error of a number of control periods: a delay this little above a whole number of them
is that number."""

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of the box around a load, for which a site may enter another."""

_LOAD_LEVELS = 13
"""Number of different masses of the load. Lifts of the same mass are simulated at once."""

_CHUNK_SIZE = 300
"""Largest number of lifts that are simulated at once."""

_BOUNDED_AT_ONCE = 16
"""Number of lifts whose distances are bounded at once. Their arrays fit into the cache of a
processor; those of a whole chunk do not, and take twice as long."""

_NUMBERS_PER_LIFT = 12
"""Numbers for each lift that `perturb` holds in memory: those drawn, the results, and room for
those on the way."""


@dataclass(frozen=True)
class Spread:
    """Ranges in which lifts differ from the plan; each number is drawn uniformly.

    Attributes:
        load: Largest change of the mass of the load, as a share of it; one of `_LOAD_LEVELS`
            equally spaced masses is drawn.
        cable: Error of the measured cable length [m].
        wind: Largest steady wind [m/s], from any side, in which the load hangs at the start.
        gust: Largest rise of one gust [m/s], of shape (1 - cos)/2, in the same direction, at any
            time of the lift.
        gust_lasts: Shortest and longest gust [s].
        late: Delays of the sensors to draw from [s], `MAX_SENSOR_DELAY` at most; each is rounded up
            to whole control periods.

    Raises:
        OutOfRange: If a value is not a number, negative, not finite or beyond its range, the load
            could be gone, or a gust has no length.
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
            within("delay of the sensors", delay, 0.0, MAX_SENSOR_DELAY, "s")
        if not len(self.late):
            raise CraneError("delays of the sensors is (); allowed is one or more [s].")


@dataclass(frozen=True, eq=False)
class Perturbed:
    """Results of perturbed lifts.

    Attributes:
        least: Lower bound of the distance between anything that hangs and any obstacle in each lift
            at all times [m], shape (n,). Zones require no distance, so that the distance from a
            zone counts with the required one added. NaN for a lift that broke off: its rope was
            slack, or a joint left its range.
        required: Required distance [m].
        drawn: Numbers drawn for each lift, by name.
        swing: Amplitude of the swing after each lift [rad], shape (n,); not finite where the
            simulation of a lift that broke off was not.
    """

    least: np.ndarray
    required: float
    drawn: dict[str, np.ndarray]
    swing: np.ndarray

    @property
    def failures(self) -> int:
        """Number of lifts that came closer than required, or broke off."""
        # Written so that NaN, a lift that broke off, counts.
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
    controller: HoistIntegral | None = None,
) -> Iterator[PerturbedBatch]:
    """Simulate a certified lift once for each set of numbers, some hundred lifts at a time.

    Args:
        certificate: The lift.
        drawn: Perturbations by the names of `Perturbed.drawn`, shape (n,) each.
        dt: Physics step [s].
        threads: Number of threads; by default one for each processor.
        controller: The controller of the lift for this physics step, for whoever asks often: to
            design it takes as long as some hundred lifts. None to design it here.
    """
    lift = certificate.lift
    if controller is None:
        controller = controller_of(lift, dt=dt)
    cranes = {}
    for load in np.unique(drawn["load"]).tolist():
        cranes[load] = _crane_with_load(lift.crane, load)
    nominal = certificate.run.q[:: _periods_per_row(lift)]
    margins = np.array([lift.clearance.margins_by_motion(q) for q in nominal])
    workers = worker_count("threads", threads)

    def finished(chunk: np.ndarray, simulation: Future[_ChunkResult]) -> PerturbedBatch:
        batch, force = simulation.result()
        row_interval = _periods_per_row(lift) * lift.timed.motion.period
        least = np.concatenate(
            [
                _least_distances(lift.clearance, nominal, margins, q, valid_until, row_interval)
                for q, valid_until in _in_blocks(batch)
            ]
        )
        crane = cranes[float(drawn["load"][chunk[0]])]
        return PerturbedBatch(chunk, crane, batch, force, least)

    # Distances are measured here while the threads simulate the next chunks. No more than one chunk
    # beyond their number is submitted at a time, so that few results wait in memory.
    running = deque[tuple[np.ndarray, Future[_ChunkResult]]]()
    with ThreadPoolExecutor(workers) as pool:
        for chunk in _chunks(drawn["load"]):
            values = {name: column[chunk] for name, column in drawn.items()}
            simulation = pool.submit(_simulate_chunk, lift, controller, values, cranes, dt)
            running.append((chunk, simulation))
            if len(running) > workers:
                yield finished(*running.popleft())
        while running:
            yield finished(*running.popleft())


def _chunks(loads: np.ndarray) -> list[np.ndarray]:
    """Return the indices of lifts that are simulated at once: of the same load, so that they share
    a crane and a controller, and at most `_CHUNK_SIZE`.
    """
    chunks = []
    for load in np.unique(loads):
        lifts = np.flatnonzero(loads == load)
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


def _simulate_chunk(
    lift: Lift,
    controller: HoistIntegral,
    drawn: dict[str, np.ndarray],
    cranes: dict[float, Crane],
    dt: float,
) -> _ChunkResult:
    """Simulate lifts of one load.

    Args:
        lift: The lift.
        controller: Its controller.
        drawn: Perturbations by the names of `Perturbed.drawn`, shape (k,) each.
        cranes: Crane of each load.
        dt: Physics step [s].
    """
    crane = lift.crane
    motion = lift.timed.motion
    load = float(drawn["load"][0])
    hoist = lift.clearance.hoist

    # A compiled program has the numbers of the crane that are the same in its whole batch as
    # constants. In a chunk all loads are the same, so that each load would need a program of its
    # own. Therefore the last lift is simulated a second time with another load, and left out of the
    # results: the load then differs within every chunk, and one program serves all.
    drawn = {name: np.append(values, values[-1]) for name, values in drawn.items()}
    count = len(drawn["load"])
    other_loads = [other for other in cranes if other != load]
    other_crane = cranes[other_loads[0]] if other_loads else cranes[load]

    # The load has hung there for a while: the integral holds what its weight differs by.
    missing_weight = (1.0 - load) * crane.payload_mass * crane.gravity
    controller = replace(controller, integral=missing_weight / controller.integral_gain)
    delay = np.ceil(drawn["late_s"] / motion.period - _ROUNDING)

    # The cable is longer than planned, and measured as planned.
    force = _wind_forces(lift, drawn)
    start = np.tile(lift.states()[0].q, (count, 1))
    start[:, hoist] += drawn["cable_m"]
    sensor_offset = np.zeros((count, 2 * crane.layout.n))
    sensor_offset[:, hoist] = -drawn["cable_m"]
    weight = cranes[load].payload_mass * crane.gravity
    start = hanging_in_wind(lift.clearance, start, force[:, 0, :3], weight)

    batch = simulate_batch(
        [*[cranes[load]] * (count - 1), other_crane],
        controller,
        motion,
        start=State(start, np.zeros_like(start)),
        duration=motion.period * _period_count(lift),
        dt=dt,
        control_period=motion.period,
        force=force,
        force_interval=_periods_per_row(lift),
        sensor_offset=sensor_offset,
        sensor_delay=delay.astype(int).tolist(),
        residual_from=motion.arrival,
        record=_periods_per_row(lift),
        threads=1,
    )
    return _ChunkResult(_without_last(batch), force[:-1])


def hanging_in_wind(
    clearance: Clearance, start: np.ndarray, force: np.ndarray, weight: float
) -> np.ndarray:
    """Return coordinates in which loads hang in a steady wind, the drives as they are.

    Wind and weight balance, the pivots unmoved: the rope points along their sum.

    Args:
        clearance: Crane and site.
        start: Coordinates, shape (k, n).
        force: Force of the wind on each load [N], shape (k, 3).
        weight: Weight of a load [N].
    """
    return clearance.hang_along(start, force - np.array([0.0, 0.0, weight]))


def _without_last(batch: Batch) -> Batch:
    """Return a batch without its last crane. What is read from its log, such as `Batch.q`, has as
    many cranes as the other arrays.
    """
    coordinates, rates = batch.end
    return replace(
        batch,
        end=State(coordinates[:-1], rates[:-1]),
        peak_swing=batch.peak_swing[:-1],
        residual_swing=batch.residual_swing[:-1],
        largest_effort=batch.largest_effort[:-1],
        valid_until=batch.valid_until[:-1],
        failures=batch.failures[:-1],
        refusals=batch.refusals[:-1],
    )


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

    area = drag_area(lift.clearance)
    # Of the points of a crane the payload is the first.
    force = np.zeros((len(drawn["load"]), len(times), 3 * len(lift.crane.points)))
    force[..., :2] = drag_force(area, speed * unit_vector - load_velocity[:, :2])
    return force


def drag_area(clearance: Clearance) -> float:
    """Return the area that the load of a site turns to the wind, times its drag coefficient [m²]:
    each as entered, or else the largest section of the box around it and `DRAG_COEFFICIENT`.
    """
    load = clearance.site.details.load
    area = _largest_silhouette(clearance.bodies.load) if load.area is None else load.area
    return area * (DRAG_COEFFICIENT if load.drag is None else load.drag)


def _largest_silhouette(corners: np.ndarray) -> float:
    """Return the largest area that the box around a load shows to a horizontal wind [m²]: that of
    its vertical section through opposite edges.
    """
    length, width, height = np.ptp(corners, axis=0)
    return float(math.hypot(length, width) * height)


def _in_blocks(batch: Batch) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the recorded coordinates of some lifts of a batch at a time, shape (k, rows, n), and
    the times at which their models ceased to hold [s], shape (k,).
    """
    for first in range(0, len(batch.q), _BOUNDED_AT_ONCE):
        lifts = slice(first, first + _BOUNDED_AT_ONCE)
        yield batch.q[lifts], batch.valid_until[lifts]


def _least_distances(
    clearance: Clearance,
    nominal: np.ndarray,
    margins: np.ndarray,
    q: np.ndarray,
    valid_until: np.ndarray,
    row_interval: float,
) -> np.ndarray:
    """Return a lower bound of the least distance in each lift at all times [m], shape (k,); NaN for
    a lift that broke off.

    Where a lift differs from the nominal one by less than the margin of that, the difference gives
    the bound. Elsewhere distances are measured in the recorded rows, less the way to the instants
    between these, and bound those of the rows around by the way to them. All this is done for each
    group of `Clearance.margins_by_motion`: a rope that runs beside a girder is always near it.

    Args:
        clearance: Crane and site.
        nominal: Coordinates of the certified lift without perturbations in the recorded rows, shape
            (rows, n).
        margins: Its `Clearance.margins_by_motion` in these rows [m], shape (rows, groups).
        q: Coordinates of the lifts in these rows, shape (k, rows, n).
        valid_until: Times at which their models ceased to hold [s], inf for never, shape (k,).
        row_interval: Time between two recorded rows [s].
    """
    # A straight line from a point's place in one row to its place in the next is no longer than
    # this, so that no place on it is farther than half of it from the nearer end. The point itself
    # is off that line by a h²/8 at most, with its largest acceleration a and the time h between the
    # rows.
    way = clearance.displacements(q[:, :-1, :], q[:, 1:, :])
    bend = MAX_ACCELERATION * row_interval**2 / 8.0
    half_way = way / 2.0
    half_way_before = np.pad(half_way, ((0, 0), (1, 0), (0, 0)))
    half_way_after = np.pad(half_way, ((0, 0), (0, 1), (0, 0)))
    step = np.maximum(half_way_before, half_way_after) + bend
    moved = np.pad(np.cumsum(way, axis=1), ((0, 0), (1, 0), (0, 0)))

    by_plan = margins - clearance.displacements(nominal, q) - step
    held = np.isfinite(q).all(axis=(1, 2)) & ~np.isfinite(valid_until)
    least_margins = np.where(held, by_plan.min(axis=(1, 2)), np.nan)
    # Of most lifts the difference from the plan bounds the distance well enough.
    for i in np.flatnonzero(least_margins < 0.0):
        least_margins[i] = _least_margin(clearance, q[i], by_plan[i], moved[i], step[i])
    return least_margins + clearance.site.distance


def _least_margin(
    clearance: Clearance, q: np.ndarray, bounds: np.ndarray, moved: np.ndarray, step: np.ndarray
) -> float:
    """Return a lower bound of the least margin in a lift [m].

    A measurement takes much longer than a bound. So the row with the lowest bound is measured,
    which raises the bounds of the rows around it. That is repeated until the lowest bound is not
    negative, which suffices, or is that of a measured row, which no further measurement raises.

    Args:
        clearance: Crane and site.
        q: Coordinates, shape (rows, n).
        bounds: Lower bounds of the margins about each row [m], shape (rows, groups).
        moved: Way of each group up to each row [m], shape (rows, groups).
        step: How far each group is from its place in a row at most, at the instants that are nearer
            to this row than to another [m], shape (rows, groups).
    """
    measured = set[int]()
    while True:
        lowest = bounds.min(axis=1)
        k = int(np.argmin(lowest))
        if k in measured or not lowest[k] < 0.0:
            return float(lowest[k])
        margins = clearance.margins_by_motion(q[k])
        bounds = np.maximum(bounds, margins - np.abs(moved - moved[k]) - step)
        measured.add(k)
