"""Up to which wind a lift can be made: gusts of a speed, from all sides and at all times, until
utilisation, swing or clearance reaches its limit.

The wind acts on the load alone, as in `cranedyn.planning.perturbed`. What it does to the crane's
own structure is not in it, and the speed at which the crane must stop is its maker's to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cranedyn.arguments import checked
from cranedyn.errors import number, whole, within
from cranedyn.lifting.chart import CUT_OUT, Chart
from cranedyn.lifting.loads import loads_of_rows
from cranedyn.planning.certificate import Certificate
from cranedyn.planning.perturbed import PerturbedBatch, simulate_perturbed

GUST_FACTOR = 1.5
"""Speed of a gust over that of the mean wind in which it comes; ours, of a rough city's terrain."""

LASTS = (3.0, 12.0)
"""Shortest and longest gust [s]."""

STRONGEST, STEP, FINER = 28.0, 4.0, 4
"""Strongest gust that is tried, the step from one to the next [m/s], and into how many parts the
step at which a limit is met is divided."""

WORST, SPREADS = 4, (0.2, 0.1, 0.05, 0.02)
"""About how many of the worst gusts others are searched, one time after the other, and how far
from them, as shares of what gusts are drawn from."""

_NONE = 1e6
"""Stands for what is beyond all limits: a lift that failed."""


@dataclass(frozen=True, eq=False)
class WindLimit:
    """What gusts do to a lift.

    Attributes:
        speeds: Of the gusts that were tried [m/s], increasing, shape (k,).
        worst: Of all lifts in each: utilisation, swing [rad], clearance [m], by name, shape (k,)
            each; a lift that failed, or left the radii of the chart, counts as a million, or as
            minus a million for clearance.
        allowed: Limit of each, by name.
        lifts: How many were made in all.
    """

    speeds: np.ndarray
    worst: Mapping[str, np.ndarray]
    allowed: Mapping[str, float]
    lifts: int

    def limit(self, name: str | None = None) -> float:
        """Strongest gust up to which a limit is kept by all lifts, or with no name all limits are
        [m/s]; 0 if not even the weakest that was tried.
        """
        names = list(self.allowed) if name is None else [name]
        return min(self._limit(one) for one in names)

    def interval(self) -> tuple[float, float]:
        """Return the strongest gust up to which all limits are kept by all lifts, and the weakest
        in which some lift does not [m/s], infinite if none was found.
        """
        kept = np.all([self.kept(name) for name in self.allowed], axis=0)
        broken = self.speeds[~kept]
        return self.limit(), float(broken[0]) if len(broken) else math.inf

    @property
    def binding(self) -> str:
        """Which limit is met first."""
        return min(self.allowed, key=self._limit)

    def kept(self, name: str) -> np.ndarray:
        """Whether a limit is kept at each speed, shape (k,)."""
        worst, allowed = self.worst[name], self.allowed[name]
        return worst >= allowed if name == "clearance" else worst <= allowed

    def _limit(self, name: str) -> float:
        broken = np.flatnonzero(~self.kept(name))
        if not len(broken):
            return float(self.speeds[-1])
        return float(self.speeds[broken[0] - 1]) if broken[0] else 0.0


@checked
def wind_limit(
    certificate: Certificate,
    chart: Chart,
    falls: int | None = None,
    *,
    swing: float = math.radians(5.0),
    utilisation: float = CUT_OUT,
    count: int = 32,
    seed: int = 1,
    dt: float = 1e-3,
    threads: int | None = None,
) -> WindLimit:
    """Make a certified lift in ever stronger gusts.

    Each gust of shape (1 - cos)/2 rises from a mean wind of its speed over `GUST_FACTOR`, in which
    the load hangs at the start. Directions, times and lengths are drawn once and are the same at
    every speed; then worse ones are searched about the worst of them, for each limit about the
    speed at which it is met.

    Args:
        certificate: The lift.
        chart: Of the crane.
        falls: How many carry the hook; None for the fewest of the chart.
        swing: Largest angle of the rope from plumb that is allowed [rad].
        utilisation: Largest share of the rated load moment that is allowed.
        count: How many gusts are drawn, and searched about the worst each time.
        seed: Of what is drawn.
        dt: Physics step [s].
        threads: How many; by default one for each processor.

    Raises:
        OutOfRange: If a limit or the count is none that there could be.
        UnknownName: If the chart does not know so many falls.
    """
    chart.on(falls)
    allowed = {
        "utilisation": number("utilisation", utilisation, "", "> 0"),
        "swing": within("swing", swing, 0.0, math.pi / 2.0, "rad"),
        "clearance": certificate.lift.clearance.site.distance,
    }
    rng, each = np.random.default_rng(seed), whole("number of lifts", count, 1)
    lowest = np.array([0.0, LASTS[0], -math.pi])
    widths = np.array([certificate.lift.timed.motion.arrival, LASTS[1] - LASTS[0], 2.0 * math.pi])

    def made(speeds: np.ndarray, gusts: np.ndarray) -> np.ndarray:
        """Return rows of speed, gust and what each limit is measured by, for each gust at each
        speed.
        """
        rows = np.column_stack([np.repeat(speeds, len(gusts)), np.tile(gusts, (len(speeds), 1))])
        speed, at, lasts, direction = rows.T
        drawn = {
            "load": np.ones(len(rows)),
            "cable_m": np.zeros(len(rows)),
            "wind_m_s": speed / GUST_FACTOR,
            "gust_m_s": speed - speed / GUST_FACTOR,
            "gust_at_s": at,
            "gust_lasts_s": lasts,
            "direction_rad": direction,
            "late_s": np.zeros(len(rows)),
        }
        found = {
            name: np.full(len(rows), -_NONE if name == "clearance" else _NONE) for name in allowed
        }
        for some in simulate_perturbed(certificate, drawn, dt=dt, threads=threads):
            _note(found, some, chart, falls)
        return np.column_stack([rows, *found.values()])

    speeds = np.arange(STEP, STRONGEST + STEP / 2.0, STEP)
    tried = made(speeds, lowest + widths * rng.random((each, 3)))
    for spread in SPREADS:
        found = _limits(tried, allowed)
        more = []
        for column, name in enumerate(allowed, 4):
            limit = found.limit(name)
            broken = found.speeds[found.speeds > limit]
            rows = tried[tried[:, 0] == (broken[0] if len(broken) else limit)]
            sign = 1.0 if name == "clearance" else -1.0
            worst = rows[np.argsort(sign * rows[:, column], kind="stable")][:WORST, 1:4]
            about = worst[np.arange(each) % len(worst)] + spread * widths * rng.normal(
                size=(each, 3)
            )
            about[:, :2] = np.clip(about[:, :2], lowest[:2], (lowest + widths)[:2])
            near = limit + STEP / FINER * np.arange(-1, FINER)
            more.append(made(near[(near > 0.0) & (near <= STRONGEST)], np.vstack([worst, about])))
        tried = np.vstack([tried, *more])
    return _limits(tried, allowed)


def _limits(tried: np.ndarray, allowed: Mapping[str, float]) -> WindLimit:
    """Return the worst at each speed of rows of `made`."""
    speeds = np.unique(tried[:, 0])
    worst = {
        name: np.array(
            [
                (np.min if name == "clearance" else np.max)(tried[tried[:, 0] == speed, column])
                for speed in speeds
            ]
        )
        for column, name in enumerate(allowed, 4)
    }
    return WindLimit(speeds, worst, allowed, len(tried))


def _note(
    found: dict[str, np.ndarray], made: PerturbedBatch, chart: Chart, falls: int | None
) -> None:
    """Write down what became of some lifts; those that failed stay as they are."""
    batch, count = made.batch, len(made.rows)
    well = np.isfinite(batch.q).all(axis=(1, 2)) & ~np.isfinite(batch.valid_until)
    well &= np.isfinite(made.least)
    if not well.any():
        return
    rows = made.rows[well]
    carried = loads_of_rows(
        made.crane,
        batch.q[well],
        batch.v[:count][well],
        batch.effort[:count][well],
        made.force[well],
    )
    on, radius = chart.on(falls), carried["radius_m"]
    inside = np.clip(radius, on.least, on.radii[-1])
    used = carried["pull_N"] / (made.crane.gravity * on.at(inside))
    found["utilisation"][rows] = np.where(inside == radius, used, _NONE).max(axis=1)
    lead = np.hypot(np.tan(carried["off_lead_rad"]), np.tan(carried["side_lead_rad"]))
    found["swing"][rows] = np.arctan(lead).max(axis=1)
    found["clearance"][rows] = made.least[well]
