"""Wind limit of a lift: the strongest gust, from any side and at any time, in which utilisation,
swing and clearance keep their limits.

The wind acts on the load alone, as in `cranedyn.planning.perturbed`. What it does to the crane's
own structure is not in it, and the speed at which the crane must stop is its maker's to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import whole, within
from cranedyn.lifting.chart import CUT_OUT, Chart
from cranedyn.lifting.loads import loads_of_rows
from cranedyn.planning.certificate import Certificate
from cranedyn.planning.perturbed import PerturbedBatch, simulate_perturbed

GUST_FACTOR = 1.5
"""Speed of a gust over that of the mean wind in which it comes; ours, of a rough city's terrain."""

LASTS = (3.0, 12.0)
"""Shortest and longest gust [s]."""

STRONGEST, STEP, FINER = 28.0, 4.0, 4
"""Strongest gust to try, step from one speed to the next [m/s], and number of parts into which the
step at which a limit is met is divided."""

WORST, SPREADS = 4, (0.2, 0.1, 0.05, 0.02)
"""Number of the worst gusts about which others are searched, one time after the other, and how far
from them, as shares of the ranges of gusts."""

_FAILED = 1e6
"""Stands for what is beyond all limits: a lift that failed."""


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
    """

    speeds: np.ndarray
    worst: Mapping[str, np.ndarray]
    allowed: Mapping[str, float]
    lifts: int

    def limit(self, name: str | None = None) -> float:
        """Return the strongest gust up to which a limit is kept by all lifts, by default all
        limits [m/s]; 0 if not even in the weakest.
        """
        return min(map(self._limit, self.allowed if name is None else [name]))

    def interval(self) -> tuple[float, float]:
        """Return the strongest gust up to which all limits are kept by all lifts, and the weakest
        in which some lift does not [m/s], infinite if there is none.
        """
        broken = self.speeds[~np.all([self.kept(name) for name in self.allowed], axis=0)]
        return self.limit(), float(broken[0]) if len(broken) else math.inf

    @property
    def binding(self) -> str:
        """Name of the limit that is met first."""
        return min(self.allowed, key=self._limit)

    def kept(self, name: str) -> np.ndarray:
        """Return whether a limit is kept at each speed, shape (k,)."""
        worst, allowed = self.worst[name], self.allowed[name]
        return worst >= allowed if name == "clearance" else worst <= allowed

    def _limit(self, name: str) -> float:
        broken = np.flatnonzero(~self.kept(name))
        if not len(broken):
            return float(self.speeds[-1])
        return float(self.speeds[broken[0] - 1]) if broken[0] else 0.0


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
    every speed. Then worse ones are searched about the worst of them, for each limit about the
    speed at which it is met.

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
    """
    chart.on(falls)
    allowed = {
        "utilisation": CUT_OUT,
        "swing": within("swing", swing, 0.0, math.pi / 2.0, "rad"),
        "clearance": certificate.lift.clearance.site.distance,
    }
    rng, count = np.random.default_rng(whole("seed", seed, 0)), whole("number of lifts", count, 1)
    lowest = np.array([0.0, LASTS[0], -math.pi])
    widths = np.array([certificate.lift.timed.motion.arrival, LASTS[1] - LASTS[0], 2.0 * math.pi])

    def simulated(speeds: np.ndarray, gusts: np.ndarray) -> np.ndarray:
        """Return rows of speed, gust and the value of each limit, for each gust at each speed."""
        rows = np.column_stack([np.repeat(speeds, len(gusts)), np.tile(gusts, (len(speeds), 1))])
        speed, start, duration, direction = rows.T
        drawn = {
            "load": np.ones(len(rows)),
            "cable_m": np.zeros(len(rows)),
            "wind_m_s": speed / GUST_FACTOR,
            "gust_m_s": speed - speed / GUST_FACTOR,
            "gust_at_s": start,
            "gust_lasts_s": duration,
            "direction_rad": direction,
            "late_s": np.zeros(len(rows)),
        }
        values = {
            name: np.full(len(rows), -_FAILED if name == "clearance" else _FAILED)
            for name in allowed
        }
        for batch in simulate_perturbed(certificate, drawn, dt=dt):
            _note(values, batch, chart, falls)
        return np.column_stack([rows, *values.values()])

    speeds = np.arange(STEP, STRONGEST + STEP / 2.0, STEP)
    rows = simulated(speeds, lowest + widths * rng.random((count, 3)))
    for spread in SPREADS:
        limits = _limits(rows, allowed)
        added = []
        for column, name in enumerate(allowed, 4):
            limit = limits.limit(name)
            broken = limits.speeds[limits.speeds > limit]
            at_limit = rows[rows[:, 0] == (broken[0] if len(broken) else limit)]
            sign = 1.0 if name == "clearance" else -1.0
            worst = at_limit[np.argsort(sign * at_limit[:, column], kind="stable")][:WORST, 1:4]
            steps = spread * widths * rng.normal(size=(count, 3))
            gusts = worst[np.arange(count) % len(worst)] + steps
            gusts[:, :2] = np.clip(gusts[:, :2], lowest[:2], (lowest + widths)[:2])
            finer = limit + STEP / FINER * np.arange(-1, FINER)
            finer = finer[(finer > 0.0) & (finer <= STRONGEST)]
            added.append(simulated(finer, np.vstack([worst, gusts])))
        rows = np.vstack([rows, *added])
    return _limits(rows, allowed)


def _limits(rows: np.ndarray, allowed: Mapping[str, float]) -> WindLimit:
    """Return the worst at each speed."""
    speeds = np.unique(rows[:, 0])
    worst = {}
    for column, name in enumerate(allowed, 4):
        extreme = np.min if name == "clearance" else np.max
        worst[name] = np.array([extreme(rows[rows[:, 0] == speed, column]) for speed in speeds])
    return WindLimit(speeds, worst, allowed, len(rows))


def _note(
    values: dict[str, np.ndarray], perturbed: PerturbedBatch, chart: Chart, falls: int | None
) -> None:
    """Enter the values of some lifts; those of lifts that failed stay as they are."""
    batch, count = perturbed.batch, len(perturbed.rows)
    valid = np.isfinite(batch.q).all(axis=(1, 2)) & ~np.isfinite(batch.valid_until)
    valid &= np.isfinite(perturbed.least)
    if not valid.any():
        return
    rows = perturbed.rows[valid]
    states = batch.q[valid], batch.v[:count][valid], batch.effort[:count][valid]
    loads = loads_of_rows(perturbed.crane, *states, perturbed.force[valid])
    reeving, radius = chart.on(falls), loads["radius_m"]
    inside = np.clip(radius, reeving.least, reeving.radii[-1])
    used = loads["pull_N"] / (perturbed.crane.gravity * reeving.at(inside))
    values["utilisation"][rows] = np.where(inside == radius, used, _FAILED).max(axis=1)
    lead = np.hypot(np.tan(loads["off_lead_rad"]), np.tan(loads["side_lead_rad"]))
    values["swing"][rows] = np.arctan(lead).max(axis=1)
    values["clearance"][rows] = perturbed.least[valid]
