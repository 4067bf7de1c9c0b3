"""Many lifts that are not quite as planned: how often they come nearer than they should, and how
near.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest

from cranedyn.arguments import checked, described
from cranedyn.arrays import finite
from cranedyn.compiled.batch import Batch, simulate_batch
from cranedyn.compiled.inputs import fit
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.tracking import Tracking
from cranedyn.disturbances.wind import drag_force, gust_shape
from cranedyn.errors import CraneError, whole, within
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning.certificate import AFTER, HOIST_INTEGRAL, Certificate, controller_of
from cranedyn.planning.clearance import Clearance, Joints
from cranedyn.planning.lift import Lift

CONFIDENCE = 0.95
"""Of the interval in which the probability lies."""

_RECORDED, _DRAG, _LEVELS = 0.1, 1.2, 13


@dataclass(frozen=True)
class Spread:
    """In what lifts differ from the plan; each number is drawn evenly within its range.

    Attributes:
        load: Mass of the load, by which share more or less; in 13 steps.
        cable: How much longer or shorter the cable is than measured [m].
        wind: Largest steady wind [m/s], from any side, in which the load hangs at the start.
        gust: Largest rise of one gust [m/s], of shape (1 - cos)/2, in the same direction, at any
            time of the lift.
        gust_lasts: Shortest and longest gust [s].
        late: How late the sensors are, one of these [s].

    Raises:
        OutOfRange: If a number is none, negative or not finite, the load could be gone, or a gust
            has no length.
        CraneError: If nothing is said of how late the sensors are.
    """

    load: float = 0.3
    cable: float = 0.5
    wind: float = 4.0
    gust: float = 6.0
    gust_lasts: tuple[float, float] = (3.0, 12.0)
    late: tuple[float, ...] = (0.0, 0.005, 0.010, 0.020)

    def __post_init__(self) -> None:
        within("share of the load", self.load, 0.0, 0.99)
        for name, unit in (("cable", "m"), ("wind", "m/s"), ("gust", "m/s")):
            within(f"spread of the {name}", getattr(self, name), 0.0, 100.0, unit)
        shortest, longest = finite("lengths of a gust", self.gust_lasts, (2,), unit="s")
        within(
            "longest gust",
            longest,
            within("shortest gust", shortest, 1e-3, 3600.0, "s"),
            3600.0,
            "s",
        )
        for late in finite("delays of the sensors", self.late, ("n",), unit="s"):
            within("delay of the sensors", late, 0.0, 10.0, "s")
        if not len(self.late):
            raise CraneError(
                "delays of the sensors is (); allowed is one or more [s], of which one is drawn "
                "for each lift."
            )


@dataclass(frozen=True, eq=False)
class Perturbed:
    """What became of many lifts.

    Attributes:
        least: How far at least anything that hangs stayed from anything in each lift [m], measured
            where it could be less than required; from zones, which ask for none, by what is
            required more; not a number where the lift failed: the rope slack, a range left; shape
            (n,).
        required: How near it may come [m].
        drawn: What was drawn for each lift, by name.
        swing: Amplitude of the swing after each lift [rad], shape (n,).
    """

    least: np.ndarray
    required: float
    drawn: dict[str, np.ndarray]
    swing: np.ndarray

    @property
    def failures(self) -> int:
        """How many came nearer than required, or failed."""
        return int(np.count_nonzero(~(self.least >= self.required)))

    def interval(self) -> tuple[float, float]:
        """Within which the probability of coming nearer than required lies, by Clopper and Pearson
        (1934).
        """
        test = binomtest(self.failures, len(self.least))
        low, high = test.proportion_ci(CONFIDENCE, "exact")
        return float(low), float(high)


@checked
def perturb(
    certificate: Certificate,
    count: int,
    *,
    spread: Spread = Spread(),
    seed: int = 1,
    dt: float = 1e-3,
    threads: int | None = None,
) -> Perturbed:
    """Make a certified lift many times, each time not quite as planned.

    Args:
        certificate: The lift.
        count: How many lifts.
        spread: In what they differ.
        seed: Of what is drawn.
        dt: Physics step [s].
        threads: How many; by default one for each processor.

    Raises:
        OutOfRange: If the count is not a whole number from 1 on, or what is drawn would not fit.
    """
    whole("number of lifts", count, 1)
    fit("number of lifts", described(count), 12 * count)
    lift, rng = certificate.lift, np.random.default_rng(seed)
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
    least, swing = np.empty(count), np.empty(count)
    for made in simulate_perturbed(certificate, drawn, dt=dt, threads=threads):
        least[made.rows], swing[made.rows] = made.least, made.batch.residual_swing
    return Perturbed(least, lift.clearance.site.distance, drawn, swing)


class PerturbedBatch(NamedTuple):
    """Lifts of one load that were made at once, not as planned.

    Attributes:
        rows: Which of all they are, shape (k,).
        crane: With their load.
        batch: What became of them, a row each tenth of a second.
        force: Of the wind on the points of the crane in these rows [N], shape (k, rows, 3 points).
        least: How far at least anything that hangs stayed from anything [m], see `Perturbed`, shape
            (k,).
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
    """Make a certified lift as often as numbers are drawn, some hundred at a time.

    Args:
        certificate: The lift.
        drawn: In what each lift differs, by the names of `Perturbed.drawn`, shape (n,) each.
        dt: Physics step [s].
        threads: How many; by default one for each processor.
    """
    lift, nominal = certificate.lift, controller_of(certificate.lift, dt=dt)
    cranes = {level: _crane(lift.crane, level) for level in np.unique(drawn["load"]).tolist()}
    rows = np.searchsorted(certificate.run.t, _recorded(lift) - 1e-9)
    planned = certificate.run.q[rows]
    room = np.array([lift.clearance.true_room(q) for q in planned])

    def make(some: np.ndarray) -> tuple[Batch, np.ndarray]:
        own = {name: values[some] for name, values in drawn.items()}
        return _batch(lift, nominal, own, cranes, dt)

    workers, chunks = threads or len(os.sched_getaffinity(0)), _chunks(drawn["load"])
    under_way = deque[Future[tuple[Batch, np.ndarray]]]()
    with ThreadPoolExecutor(workers) as pool:
        for ahead in range(len(chunks) + workers):
            if ahead < len(chunks):
                under_way.append(pool.submit(make, chunks[ahead]))
            if ahead >= workers:
                some, (batch, force) = chunks[ahead - workers], under_way.popleft().result()
                least = _least(lift.clearance, planned, room, batch)
                yield PerturbedBatch(
                    some, cranes[float(drawn["load"][some[0]])], batch, force, least
                )


def _chunks(loads: np.ndarray, most: int = 200) -> list[np.ndarray]:
    """Rows to make at once, of the same load."""
    levels = [np.flatnonzero(loads == level) for level in np.unique(loads)]
    return [some for rows in levels for some in np.array_split(rows, math.ceil(len(rows) / most))]


def _crane(crane: Crane, load: float) -> Crane:
    """The crane with another mass of the load."""
    if load == 1.0:
        return crane
    model, joint = crane.model.copy(), crane.payload.body + 1
    inertia = model.inertias[joint]
    inertia.mass = load * inertia.mass
    model.inertias[joint] = inertia
    return replace(crane, model=model)


def late(controller: HoistIntegral, seconds: float) -> Tracking:
    """A tracking controller whose sensors are late, as far as they are late to show what is
    planned.

    What it sees at a time t is the state at t less the delay; where the lift goes as planned, this
    is as if its setpoint were ahead by it.
    """
    table = controller.tracking
    rows = np.arange(len(table.setpoint)) + seconds / table.period
    ahead = np.column_stack(
        [np.interp(rows, np.arange(len(table.setpoint)), column) for column in table.setpoint.T]
    )
    return replace(table, setpoint=ahead)


def _batch(
    lift: Lift,
    nominal: HoistIntegral,
    drawn: dict[str, np.ndarray],
    cranes: dict[float, Crane],
    dt: float,
) -> tuple[Batch, np.ndarray]:
    """What becomes of lifts, and the forces of the wind in the rows that are kept."""
    crane, motion, count = lift.crane, lift.timed.motion, len(drawn["load"])
    load = float(drawn["load"][0])
    heavier = (load - 1.0) * crane.payload_mass * crane.gravity
    delays = np.unique(drawn["late_s"]).tolist()
    made = {
        one: replace(nominal, tracking=late(nominal, one), integral=-heavier / HOIST_INTEGRAL)
        for one in delays
    }
    times = motion.period * np.arange(_periods(lift) + 1)
    # So that all batches share one code, the last crane is made once more with another load.
    other = next((one for level, one in cranes.items() if level != load), cranes[load])
    force = _forces(lift, {name: np.append(one, one[-1:]) for name, one in drawn.items()}, times)
    start = np.tile(lift.states()[0].q, (count, 1))
    hoist = lift.clearance.joints.hoist
    start[:, hoist] += drawn["cable_m"]
    offset = np.zeros((count, 2 * crane.layout.n))
    offset[:, hoist] = -drawn["cable_m"]
    _hang(start, force[:-1, 0, :3], cranes[load], lift.clearance.joints)
    batch = _without_last(
        simulate_batch(
            [*[cranes[load]] * count, other],
            [*(made[one] for one in drawn["late_s"].tolist()), made[delays[0]]],
            motion,
            start=State(np.vstack([start, start[-1:]]), np.zeros((count + 1, start.shape[1]))),
            duration=motion.period * _periods(lift),
            dt=dt,
            control_period=motion.period,
            force=force,
            sensor_offset=np.vstack([offset, offset[-1:]]),
            residual_from=motion.arrival,
            record=_every(lift),
            threads=1,
        )
    )
    return batch, force[:-1, np.rint(batch.t / motion.period).astype(int)]


def _periods(lift: Lift) -> int:
    """Control periods that a lift is watched."""
    motion = lift.timed.motion
    return round(motion.arrival / motion.period) + math.ceil(AFTER / motion.period)


def _every(lift: Lift) -> int:
    """Control periods from one row that is kept to the next."""
    return max(1, round(_RECORDED / lift.timed.motion.period))


def _recorded(lift: Lift) -> np.ndarray:
    """Times of the rows that are kept [s]."""
    return lift.timed.motion.period * np.arange(0, _periods(lift) + 1, _every(lift))


def _without_last(batch: Batch) -> Batch:
    parts = {
        name: getattr(batch, name)[:-1]
        for name in ("peak_swing", "residual_swing", "largest_effort", "valid_until", "q", "v")
    }
    return replace(batch, **parts)


def _hang(start: np.ndarray, force: np.ndarray, crane: Crane, joints: Joints) -> None:
    """Let loads hang as the wind holds them at the start, their pivots where they are; forces in
    the world [N], shape (n, 3).
    """
    gamma, weight = start[:, joints.slew], crane.payload_mass * crane.gravity
    outward = force[:, 0] * np.sin(gamma) - force[:, 1] * np.cos(gamma)
    along = force[:, 0] * np.cos(gamma) + force[:, 1] * np.sin(gamma)
    start[:, joints.radial_swing] = -np.arctan2(outward, weight)
    start[:, joints.tangential_swing] = -np.arctan2(along, np.hypot(weight, outward))


def _forces(lift: Lift, drawn: dict[str, np.ndarray], times: np.ndarray) -> np.ndarray:
    """Drag of the wind on the points of the crane [N], shape (n, rows, 3 points), on the load
    alone, which moves as planned.
    """
    area = _DRAG * _silhouette(lift.clearance.bodies.load)
    points = lift.clearance.point(lift.timed.places)
    velocity = np.gradient(points, _step(lift), axis=0)
    own = np.column_stack(
        [
            np.interp(times, _step(lift) * np.arange(len(points)), part, right=0.0)
            for part in velocity.T
        ]
    )
    force = np.zeros((len(drawn["load"]), len(times), 3 * len(lift.crane.points)))
    for i, row in enumerate(
        zip(
            *(
                drawn[name]
                for name in ("wind_m_s", "gust_m_s", "gust_at_s", "gust_lasts_s", "direction_rad")
            ),
            strict=True,
        )
    ):
        steady, rise, at, lasts, direction = row
        speed = np.full(len(times), steady)
        blows = slice(*np.searchsorted(times, (at, at + lasts)))
        speed[blows] += rise * gust_shape(times[blows], at, lasts)
        along = np.array([math.cos(direction), math.sin(direction)])
        force[i, :, :2] = drag_force(area, speed[:, None] * along - own[:, :2])
    return force


def _silhouette(corners: np.ndarray) -> float:
    """Largest area that the box around a load shows to a horizontal wind [m²]."""
    length, width, height = np.ptp(corners, axis=0)
    return float(math.hypot(length, width) * height)


def _step(lift: Lift) -> float:
    return lift.timed.motion.arrival / (len(lift.timed.places) - 1)


def _least(clearance: Clearance, planned: np.ndarray, room: np.ndarray, batch: Batch) -> np.ndarray:
    """How near each lift comes to anything [m], at least so far, shape (n,): at the instants
    recorded, less how far it moves between these; from the coordinates planned for these, and how
    near it comes there.

    Where a lift differs from its plan by less than the plan is free, that tells; elsewhere
    distances are measured.
    """
    between = clearance.moved(batch.q[:, :-1, :], batch.q[:, 1:, :]) / 2.0
    step = np.maximum(np.pad(between, ((0, 0), (1, 0))), np.pad(between, ((0, 0), (0, 1))))
    at_least = room - clearance.moved(planned, batch.q) - step
    least = np.full(len(batch.q), np.nan)
    for i in np.flatnonzero(np.isfinite(at_least).all(axis=1) & ~np.isfinite(batch.valid_until)):
        bounds, looked_at = at_least[i], set[int]()
        while (k := int(np.argmin(bounds))) not in looked_at and bounds[k] < 0.0:
            bounds[k] = clearance.true_room(batch.q[i, k]) - step[i, k]
            looked_at.add(k)
        least[i] = bounds[k] + clearance.site.distance
    return least
