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
from cranedyn.model.crane import Crane
from cranedyn.planning.certificate import AFTER, Certificate, controller_of
from cranedyn.planning.clearance import Clearance, Joints
from cranedyn.planning.curve import interpolate_columns
from cranedyn.planning.lift import Lift

CONFIDENCE = 0.95
"""Confidence of the interval of a probability."""

_RECORDED = 0.1
"""Time between rows that are kept [s]."""

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of the box around a load."""

_LEVELS = 13
"""Number of masses of the load."""


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
    check_fits_memory("number of lifts", short_repr(count), 12 * count)
    lift, rng = certificate.lift, np.random.default_rng(whole("seed", seed, 0))
    loads = np.sort(rng.integers(0, _LEVELS, count))
    drawn = {
        "load": 1.0 + spread.load * np.linspace(-1.0, 1.0, _LEVELS)[loads],
        "cable_m": rng.uniform(-spread.cable, spread.cable, count),
        "wind_m_s": rng.uniform(0.0, spread.wind, count),
        "gust_m_s": rng.uniform(0.0, spread.gust, count),
        "gust_at_s": rng.uniform(0.0, lift.timed.motion.arrival, count),
        "gust_lasts_s": rng.uniform(*spread.gust_lasts, count),
        "direction_rad": rng.uniform(-math.pi, math.pi, count),
        "late_s": rng.choice(spread.late, count),
    }
    distance, swing = np.empty(count), np.empty(count)
    for chunk in simulate_perturbed(certificate, drawn, dt=dt, threads=threads):
        distance[chunk.rows], swing[chunk.rows] = chunk.least, chunk.batch.residual_swing
    return Perturbed(distance, lift.clearance.site.distance, drawn, swing)


class PerturbedBatch(NamedTuple):
    """Perturbed lifts of one load that were simulated at once.

    Attributes:
        rows: Indices of these lifts among all, shape (k,).
        crane: The crane with their load.
        batch: The simulated lifts, a row each tenth of a second.
        force: Force of the wind on the points of the crane from each of these rows to the next [N],
            shape (k, rows, 3 points).
        least: As of `Perturbed`, shape (k,).
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
    lift, nominal = certificate.lift, controller_of(certificate.lift, dt=dt)
    cranes = {level: _crane(lift.crane, level) for level in np.unique(drawn["load"]).tolist()}
    planned = certificate.run.q[:: _every(lift)]
    margins = np.array([lift.clearance.margin(q) for q in planned])
    workers, chunks = worker_count("threads", threads), _chunks(drawn)
    running = deque[Future[tuple[Batch, np.ndarray]]]()
    with ThreadPoolExecutor(workers) as pool:
        for i in range(len(chunks) + workers):
            if i < len(chunks):
                values = {name: column[chunks[i]] for name, column in drawn.items()}
                running.append(pool.submit(_batch, lift, nominal, values, cranes, dt))
            if i >= workers:
                chunk, (batch, force) = chunks[i - workers], running.popleft().result()
                distances = _least(lift.clearance, planned, margins, batch)
                crane = cranes[float(drawn["load"][chunk[0]])]
                yield PerturbedBatch(chunk, crane, batch, force, distances)


def _chunks(drawn: dict[str, np.ndarray], largest: int = 300) -> list[np.ndarray]:
    """Return the indices of lifts of the same load and delay, which share a controller, at most so
    many at once.
    """
    kinds = np.stack([drawn["load"], drawn["late_s"]])
    alike = np.unique(kinds, axis=1, return_inverse=True)[1].ravel()
    groups = [np.flatnonzero(alike == kind) for kind in range(alike.max() + 1)]
    return [rows for group in groups for rows in np.array_split(group, -(-len(group) // largest))]


def _crane(crane: Crane, load: float) -> Crane:
    """Return the crane with a multiple of the mass of its load."""
    if load == 1.0:
        return crane
    model, joint = crane.model.copy(), crane.payload.body + 1
    inertia = model.inertias[joint]
    inertia.mass = load * inertia.mass
    model.inertias[joint] = inertia
    return replace(crane, model=model)


def late(controller: HoistIntegral, seconds: float) -> Tracking:
    """Return the tracking controller of a lift with sensors that are late.

    What it reads at a time t is the state at t less the delay. Where the lift goes as planned, that
    is as if its setpoint were ahead by the delay.
    """
    table = controller.tracking
    rows = np.arange(len(table.setpoint))
    setpoint = interpolate_columns(rows + seconds / table.period, rows, table.setpoint)
    return replace(table, setpoint=setpoint)


def _batch(
    lift: Lift,
    nominal: HoistIntegral,
    drawn: dict[str, np.ndarray],
    cranes: dict[float, Crane],
    dt: float,
) -> tuple[Batch, np.ndarray]:
    """Simulate lifts of one load; return also the forces of the wind in the rows that are kept."""
    crane, motion, load = lift.crane, lift.timed.motion, float(drawn["load"][0])
    # All batches share one compiled code if the last lift is simulated again with another load.
    added = next((crane for level, crane in cranes.items() if level != load), cranes[load])
    drawn = {name: np.append(values, values[-1]) for name, values in drawn.items()}
    count, lighter = len(drawn["load"]), (1.0 - load) * crane.payload_mass * crane.gravity
    integral = lighter / nominal.integral_gain
    controllers = {
        delay: replace(nominal, tracking=late(nominal, delay), integral=integral)
        for delay in np.unique(drawn["late_s"]).tolist()
    }
    force = _forces(lift, drawn)
    start = np.tile(lift.states()[0].q, (count, 1))
    offset = np.zeros((count, 2 * crane.layout.n))
    hoist = lift.clearance.joints.hoist
    start[:, hoist] += drawn["cable_m"]
    offset[:, hoist] = -drawn["cable_m"]
    _hang(start, force[:, 0, :3], cranes[load], lift.clearance.joints)
    batch = simulate_batch(
        [*[cranes[load]] * (count - 1), added],
        [controllers[delay] for delay in drawn["late_s"].tolist()],
        motion,
        start=State(start, np.zeros_like(start)),
        duration=motion.period * _periods(lift),
        dt=dt,
        control_period=motion.period,
        force=force,
        force_interval=_every(lift),
        sensor_offset=offset,
        residual_from=motion.arrival,
        record=_every(lift),
        threads=1,
    )
    names = ("peak_swing", "residual_swing", "largest_effort", "valid_until")
    batch = replace(batch, **{name: getattr(batch, name)[:-1] for name in names})
    return batch, force[:-1]


def _periods(lift: Lift) -> int:
    """Return the number of control periods that a lift is watched."""
    motion = lift.timed.motion
    return round(motion.arrival / motion.period) + math.ceil(AFTER / motion.period)


def _every(lift: Lift) -> int:
    """Return the number of control periods between rows that are kept."""
    return max(1, round(_RECORDED / lift.timed.motion.period))


def _hang(start: np.ndarray, force: np.ndarray, crane: Crane, joints: Joints) -> None:
    """Set loads, shape (n, coordinates), where forces of the wind in the world [N], shape (n, 3),
    hold them, their pivots unmoved.
    """
    gamma, weight = start[:, joints.slew], crane.payload_mass * crane.gravity
    outward = force[:, 0] * np.sin(gamma) - force[:, 1] * np.cos(gamma)
    along = force[:, 0] * np.cos(gamma) + force[:, 1] * np.sin(gamma)
    start[:, joints.radial_swing] = -np.arctan2(outward, weight)
    start[:, joints.tangential_swing] = -np.arctan2(along, np.hypot(weight, outward))


def _forces(lift: Lift, drawn: dict[str, np.ndarray]) -> np.ndarray:
    """Return the drag of the wind on the load, which moves as planned, in the middle between rows
    that are kept [N], shape (n, rows, 3 points).
    """
    rows = np.arange(0, _periods(lift) + 1, _every(lift))
    times = lift.timed.motion.period * (rows + _every(lift) / 2.0)
    area = DRAG_COEFFICIENT * _silhouette(lift.clearance.bodies.load)
    points = lift.clearance.point(lift.timed.places)
    step = lift.timed.motion.arrival / (len(points) - 1)
    load_rates = np.gradient(points, step, axis=0)
    load_rates = interpolate_columns(times, step * np.arange(len(points)), load_rates)
    load_rates[times > step * (len(points) - 1)] = 0.0
    names = ("wind_m_s", "gust_m_s", "gust_at_s", "gust_lasts_s", "direction_rad")
    steady, rise, start, duration, direction = (drawn[name][:, None] for name in names)
    speed = (steady + rise * gust_shape(times, start, duration))[..., None]
    along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    force = np.zeros((len(drawn["load"]), len(times), 3 * len(lift.crane.points)))
    force[..., :2] = drag_force(area, speed * along - load_rates[:, :2])
    return force


def _silhouette(corners: np.ndarray) -> float:
    """Return the largest area that the box around a load shows to a horizontal wind [m²]."""
    length, width, height = np.ptp(corners, axis=0)
    return float(math.hypot(length, width) * height)


def _least(
    clearance: Clearance, planned: np.ndarray, margins: np.ndarray, batch: Batch
) -> np.ndarray:
    """Return a lower bound of the least distance in each lift [m], shape (n,).

    Where a lift differs from planned coordinates, shape (rows, n), by less than their margins [m],
    shape (rows,), that difference gives the bound. Elsewhere distances are measured in the recorded
    rows, less the way between these, and bound those of the rows around by the way to them.
    """
    between = clearance.displacement(batch.q[:, :-1, :], batch.q[:, 1:, :]) / 2.0
    moved = np.pad(np.cumsum(2.0 * between, axis=1), ((0, 0), (1, 0)))
    step = np.maximum(np.pad(between, ((0, 0), (1, 0))), np.pad(between, ((0, 0), (0, 1))))
    at_least = margins - clearance.displacement(planned, batch.q) - step
    distances = np.full(len(batch.q), np.nan)
    for i in np.flatnonzero(np.isfinite(at_least).all(axis=1) & ~np.isfinite(batch.valid_until)):
        bounds, measured = at_least[i], set[int]()
        while (k := int(np.argmin(bounds))) not in measured and bounds[k] < 0.0:
            margin = clearance.margin(batch.q[i, k])
            bounds = np.maximum(bounds, margin - np.abs(moved[i] - moved[i, k]) - step[i])
            measured.add(k)
        distances[i] = bounds[k] + clearance.site.distance
    return distances
