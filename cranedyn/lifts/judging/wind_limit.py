"""Wind limit of a lift: the strongest gust, from any side and at any time, in which utilisation,
swing and clearance keep their limits.

The wind acts on the load alone, as in `cranedyn.lifts.planning.perturbed`. What it does to the
crane's own structure is not in it, and the speed at which the crane must stop is its maker's to
say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.checks import whole, within
from cranedyn.lifts.judging.chart import CUT_OUT, Chart
from cranedyn.lifts.judging.loads import loads_of_rows
from cranedyn.lifts.planning.certificate import Certificate
from cranedyn.lifts.planning.clearance import Nearest
from cranedyn.lifts.planning.perturbed import PerturbedBatch, simulate_perturbed

GUST_FACTOR = 1.5
"""Speed of a gust over that of the mean wind in which it comes: an assumption, for the rough
terrain of a city."""

SHORTEST_GUST = 3.0
"""Shortest gust [s]."""

LONGEST_GUST = 12.0
"""Longest gust [s]."""

STRONGEST = 28.0
"""Strongest gust to try [m/s]."""

STEP = 4.0
"""Step from one speed to the next [m/s]."""

STEP_PARTS = 4
"""Number of parts into which the step at which a limit is met is divided."""

WORST_COUNT = 4
"""Number of the worst gusts about which others are searched."""

SEARCH_SPREADS = (0.2, 0.1, 0.05, 0.02)
"""Distances of these others from the worst, as shares of the ranges of gusts: one search after the
other, ever closer."""

_FAILED = 1e6
"""Stands for what is beyond all limits: a lift that failed."""

FAILED_SHARE = 1e3
"""Share of a limit from which on a gust has no values in tables and figures: lifts failed in it."""

_GUST_COLUMNS = slice(1, 4)
"""Columns of a table of simulated lifts with start [s], duration [s] and direction [rad] of the
gust. The first column is its speed [m/s], and those behind are the value of each limit."""

_FIRST_VALUE = 4
"""First column of the values of the limits."""


@dataclass(frozen=True, eq=False)
class WindLimit:
    """Limits of a lift in gusts.

    Attributes:
        speeds: Speeds of the gusts [m/s], increasing, shape (k,).
        worst: Worst of all lifts at each speed: utilisation, swing [rad], clearance [m], by name,
            shape (k,) each; a lift that failed, or left the radii of the chart, counts as a
            million, or as minus a million for clearance.
        allowed: Limit of each, by name.
        lifts: Number of simulated lifts.
        nearest: What comes nearest to what in the worst gust of the weakest speed in which the
            clearance is exceeded; None if it is kept in all, or such a lift broke off.
    """

    speeds: np.ndarray
    worst: Mapping[str, np.ndarray]
    allowed: Mapping[str, float]
    lifts: int
    nearest: Nearest | None = None

    def limit(self, name: str | None = None) -> float:
        """Return the strongest gust up to which a limit is kept by all lifts, by default all
        limits [m/s]; 0 if not even in the weakest.
        """
        if name is not None:
            return self._limit(name)
        return min(self._limit(each) for each in self.allowed)

    def interval(self) -> tuple[float, float]:
        """Return the strongest gust up to which all limits are kept by all lifts, and the weakest
        in which some lift does not [m/s], infinite if there is none.
        """
        all_kept = np.all([self.kept(name) for name in self.allowed], axis=0)
        broken = self.speeds[~all_kept]
        weakest = float(broken[0]) if len(broken) else math.inf
        return self.limit(), weakest

    @property
    def binding(self) -> str | None:
        """Name of the limit that is exceeded in the weakest gust; None if none is in any."""
        exceeded = [name for name in self.allowed if not self.kept(name).all()]
        return min(exceeded, key=self._limit, default=None)

    def kept(self, name: str) -> np.ndarray:
        """Return whether a limit is kept at each speed, shape (k,)."""
        # The worst is the smallest clearance, and the largest of the others.
        if name == "clearance":
            return self.worst[name] >= self.allowed[name]
        return self.worst[name] <= self.allowed[name]

    def _limit(self, name: str) -> float:
        """Return the speed before the first at which a limit is not kept [m/s], the last if there
        is none, 0 if it is the first.
        """
        broken = np.flatnonzero(~self.kept(name))
        if not len(broken):
            return float(self.speeds[-1])
        first_broken = int(broken[0])
        if first_broken == 0:
            return 0.0
        return float(self.speeds[first_broken - 1])


def wind_limit(
    certificate: Certificate,
    chart: Chart,
    falls: int | None = None,
    *,
    swing: float = math.radians(5.0),
    count: int = 32,
    seed: int = 1,
    dt: float = 1e-3,
) -> WindLimit:
    """Simulate a certified lift in ever stronger gusts.

    Each gust of shape (1 - cos)/2 rises from a mean wind of its speed over `GUST_FACTOR`, in which
    the load hangs at the start. Directions, times and lengths are drawn once and are the same at
    every speed.

    A draw may miss the worst gust, so that a search follows, once for each of `SEARCH_SPREADS`. It
    takes, for each limit, the `WORST_COUNT` worst gusts at the weakest speed at which that limit is
    exceeded, and simulates these and others near them at speeds about that limit.

    Args:
        certificate: The lift.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        swing: Largest angle of the rope from plumb that is allowed [rad].
        count: Number of gusts to draw, and to search about the worst each time.
        seed: Seed of the random numbers.
        dt: Physics step [s].

    Raises:
        OutOfRange: If a limit or the count is out of its range.
        UnknownName: If the chart has no such number of falls.
        NotCovered: If the chart does not cover the length of the boom.
    """
    chart.of_falls(falls)  # refuses an unknown number of falls before anything is simulated
    allowed = {
        "utilisation": CUT_OUT,
        "swing": within("swing", swing, 0.0, math.pi / 2.0, "rad"),
        "clearance": certificate.lift.clearance.site.distance,
    }
    rng = np.random.default_rng(whole("seed", seed, 0))
    count = whole("number of lifts", count, 1)
    arrival = certificate.lift.timed.motion.arrival
    # Of start, duration and direction of a gust.
    lowest = np.array([0.0, SHORTEST_GUST, -math.pi])
    widths = np.array([arrival, LONGEST_GUST - SHORTEST_GUST, 2.0 * math.pi])
    highest = lowest + widths
    trial = _Trial(certificate, chart, falls, allowed, dt)

    speeds = np.arange(STEP, STRONGEST + STEP / 2.0, STEP)
    rows = trial.simulate(speeds, lowest + widths * rng.random((count, 3)))
    for spread in SEARCH_SPREADS:
        limits = _limits(rows, allowed)
        added = []
        for name in allowed:
            worst = _worst_gusts(rows, limits, name)
            steps = spread * widths * rng.normal(size=(count, 3))
            gusts = worst[np.arange(count) % len(worst)] + steps
            # Directions need no range: they go round.
            gusts[:, :2] = np.clip(gusts[:, :2], lowest[:2], highest[:2])
            speeds = _speeds_about(limits.limit(name))
            added.append(trial.simulate(speeds, np.vstack([worst, gusts])))
        rows = np.vstack([rows, *added])
    limits = _limits(rows, allowed)
    if limits.kept("clearance").all():
        return limits
    speed = float(limits.speeds[~limits.kept("clearance")][0])
    worst_gust = _worst_gusts(rows, limits, "clearance")[0]
    return replace(limits, nearest=trial.nearest(speed, worst_gust))


@dataclass(frozen=True, eq=False)
class _Trial:
    """A certified lift that is tried in gusts.

    Attributes:
        certificate: The lift.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        allowed: Limits by name.
        dt: Physics step [s].
    """

    certificate: Certificate
    chart: Chart
    falls: int | None
    allowed: Mapping[str, float]
    dt: float

    def simulate(self, speeds: np.ndarray, gusts: np.ndarray) -> np.ndarray:
        """Simulate each gust at each speed.

        Args:
            speeds: Speeds of the gusts [m/s], shape (k,).
            gusts: Their start [s], duration [s] and direction [rad], shape (j, 3).

        Returns:
            Rows of speed, gust and the value of each limit, shape (k j, 4 + limits).
        """
        rows = np.column_stack([np.repeat(speeds, len(gusts)), np.tile(gusts, (len(speeds), 1))])
        drawn = _perturbations(rows)
        # What no lift overwrites counts as failed.
        values = {}
        for name in self.allowed:
            failed = -_FAILED if name == "clearance" else _FAILED
            values[name] = np.full(len(rows), failed)
        for batch in simulate_perturbed(self.certificate, drawn, dt=self.dt):
            _enter_values(values, batch, self.chart, self.falls)
        return np.column_stack([rows, *values.values()])

    def nearest(self, speed: float, gust: np.ndarray) -> Nearest | None:
        """Return what comes nearest to what in a gust; None if the lift breaks off in it.

        Args:
            speed: Speed of the gust [m/s].
            gust: Its start [s], duration [s] and direction [rad], shape (3,).
        """
        drawn = _perturbations(np.array([[speed, *gust]]))
        clearance = self.certificate.lift.clearance
        for perturbed in simulate_perturbed(self.certificate, drawn, dt=self.dt):
            q = perturbed.batch.q[0]
            if np.isfinite(q).all():
                return clearance.nearest(q[clearance.nearest_row(q)])
        return None


def _perturbations(rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return the perturbations of lifts in gusts, by the names of `Perturbed.drawn`: the load as
    entered, and a gust whose peak is its speed.

    Args:
        rows: Speed [m/s], start [s], duration [s] and direction [rad] of each gust, shape (n, 4).
    """
    speed = rows[:, 0]
    return {
        "load": np.ones(len(rows)),
        "cable_m": np.zeros(len(rows)),
        "wind_m_s": speed / GUST_FACTOR,
        "gust_m_s": speed - speed / GUST_FACTOR,
        "gust_at_s": rows[:, 1],
        "gust_lasts_s": rows[:, 2],
        "direction_rad": rows[:, 3],
        "late_s": np.zeros(len(rows)),
    }


def _worst_gusts(rows: np.ndarray, limits: WindLimit, name: str) -> np.ndarray:
    """Return the gusts that are worst for a limit, shape (`WORST_COUNT`, 3) or fewer, the worst
    first: at the weakest speed at which it is not kept, or the strongest if there is none.
    """
    limit = limits.limit(name)
    broken = limits.speeds[limits.speeds > limit]
    speed = broken[0] if len(broken) else limit
    at_speed = rows[rows[:, 0] == speed]
    values = at_speed[:, _FIRST_VALUE + list(limits.allowed).index(name)]
    best_last = values if name == "clearance" else -values
    order = np.argsort(best_last, kind="stable")
    return at_speed[order][:WORST_COUNT, _GUST_COLUMNS]


def _speeds_about(limit: float) -> np.ndarray:
    """Return speeds in parts of a step about a limit: from one part below it to the last part
    before the next step, as far as they are in the range [m/s].
    """
    speeds = limit + STEP / STEP_PARTS * np.arange(-1, STEP_PARTS)
    return speeds[(speeds > 0.0) & (speeds <= STRONGEST)]


def _limits(rows: np.ndarray, allowed: Mapping[str, float]) -> WindLimit:
    """Return the worst at each speed, of rows as of `_Trial.simulate`."""
    speeds = np.unique(rows[:, 0])
    worst = {}
    for column, name in enumerate(allowed, _FIRST_VALUE):
        extreme = np.min if name == "clearance" else np.max
        worst[name] = np.array([extreme(rows[rows[:, 0] == speed, column]) for speed in speeds])
    return WindLimit(speeds, worst, allowed, len(rows))


def _enter_values(
    values: dict[str, np.ndarray], perturbed: PerturbedBatch, chart: Chart, falls: int | None
) -> None:
    """Enter the values of some lifts; those of lifts that failed stay as they are.

    Args:
        values: Value of each limit for all lifts, by name, shape (n,) each; changed in place.
        perturbed: Some of these lifts.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
    """
    batch = perturbed.batch
    valid = np.isfinite(batch.q).all(axis=(1, 2)) & ~np.isfinite(batch.valid_until)
    valid &= np.isfinite(perturbed.least)
    if not valid.any():
        return
    rows = perturbed.rows[valid]
    loads = loads_of_rows(
        perturbed.crane,
        batch.q[valid],
        batch.v[valid],
        batch.effort[valid],
        perturbed.force[valid],
    )
    # Outside of its radii a chart has no rated load: such a lift has failed.
    boom = loads.get("boom_m")  # a lift is planned with a boom of one length
    reeving = chart.on(falls, None if boom is None else float(boom.flat[0]))
    gravity = perturbed.crane.gravity
    radius = loads.get("radius_m")
    if radius is None:  # it does not slew
        used = loads["pull_N"] / (gravity * reeving.constant)
    else:
        inside = np.clip(radius, reeving.least, reeving.radii[-1])
        used = loads["pull_N"] / (gravity * reeving.at(inside))
        used = np.where(inside == radius, used, _FAILED)
    values["utilisation"][rows] = used.max(axis=1)
    # Both leads are angles from plumb in planes at right angles: squares of their tangents add.
    lead = np.hypot(np.tan(loads["off_lead_rad"]), np.tan(loads["side_lead_rad"]))
    values["swing"][rows] = np.arctan(lead).max(axis=1)
    values["clearance"][rows] = perturbed.least[valid]
