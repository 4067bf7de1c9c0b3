"""Wind limit of a lift: the strongest gust, from any side and at any time, in which utilisation,
swing and clearance keep their limits.

The wind acts on the load alone, as in `cranedyn.lifts.planning.perturbed`. What it does to the
crane's own structure is not in it, and the speed at which the crane must stop is its maker's to
say.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cranedyn import theory
from cranedyn.checks import whole, within
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.lifts.judging.chart import CUT_OUT, Chart
from cranedyn.lifts.judging.loads import loads_of_rows
from cranedyn.lifts.planning.certificate import Certificate, controller_of
from cranedyn.lifts.planning.clearance import Nearest
from cranedyn.lifts.planning.perturbed import CONFIDENCE, PerturbedBatch, simulate_perturbed

GUST_FACTOR = 1.5
"""Speed of a gust over that of the mean wind in which it comes: an assumption, for the rough
terrain of a city."""

SHORTEST_GUST = 3.0
"""Shortest gust [s]."""

LONGEST_GUST = 12.0
"""Longest gust [s]."""

STRONGEST = 28.0
"""Strongest gust to try [m/s]."""

STEP = 1.0
"""Step from one speed to the next [m/s], and the weakest gust that is tried."""

FIRST_SPEED = 12.0
"""Speed at which the first worst gusts are looked for [m/s]: a usual limit of a load in wind."""

DIRECTIONS = 8
"""Number of directions of the gusts of the grid. What a gust adds to the swing goes with the cosine
of the angle from the worst direction, so that one of them has 92 % of the worst or more."""

STARTS_IN_PERIOD = 4
"""Number of starts of gusts of the grid in a period of the swing. What a gust adds goes with the
cosine of the phase, so that one of them has 92 % of the worst or more."""

DURATIONS = (SHORTEST_GUST, 6.0, 9.0, LONGEST_GUST)
"""Durations of the gusts of the grid [s]. A load on 10 to 40 m of rope swings most in a gust of 0.8
to 1.2 of its period, 5 to 15 s, and nearly as much in one that is a quarter longer or shorter."""

WORST_COUNT = 4
"""Number of the worst gusts about which others are searched."""

SEARCH_HALVINGS = 4
"""Number of times by which the step of the search about the worst gusts is halved, from half of
that of the grid: to 1.4°, and to a 128th of the period."""

SEARCHED_SPEEDS = 3
"""Number of weaker speeds at which what a search found is simulated, too."""

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
        worst: Worst of all lifts in gusts of each speed or weaker ones: utilisation, swing [rad],
            clearance [m], by name, shape (k,) each; a lift that failed, or left the radii of the
            chart, counts as a million, or as minus a million for clearance. A clearance that
            suffices is a lower bound: it is not measured further.
        allowed: Limit of each, by name.
        lifts: Number of simulated lifts.
        at_limit: Number of gusts that were simulated at the limit.
        drawn: Number of gusts among these that were drawn at random.
        nearest: What comes nearest to what in the worst gust of the weakest speed in which the
            clearance is exceeded; None if it is kept in all, or such a lift broke off.
    """

    speeds: np.ndarray
    worst: Mapping[str, np.ndarray]
    allowed: Mapping[str, float]
    lifts: int
    at_limit: int = 0
    drawn: int = 0
    nearest: Nearest | None = None

    @property
    def largest_share(self) -> float:
        """Upper bound of the share of gusts at the limit that break it, with `CONFIDENCE`; 1 if
        none was drawn.

        None of n gusts that were drawn broke it, which has the probability (1 - p)^n if a share of
        p does. That is 1 - `CONFIDENCE` at the bound.
        """
        return 1.0 if not self.drawn else 1.0 - (1.0 - CONFIDENCE) ** (1.0 / self.drawn)

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
        """Return whether a limit is kept in gusts of each speed and weaker ones, shape (k,)."""
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
    share: float = CUT_OUT,
    swing: float = math.radians(5.0),
    count: int = 32,
    seed: int = 1,
    dt: float = 1e-3,
) -> WindLimit:
    """Return the strongest gust in which a certified lift keeps its limits.

    Each gust of shape (1 - cos)/2 rises from a mean wind of its speed over `GUST_FACTOR`, in which
    the load hangs at the start.

    What is tried does not rest on chance. A grid of gusts, see `_grid`, covers directions, starts
    and durations, and a search about the worst of them finds those between. The limit is the speed
    at which the whole grid, and all that the search found, keep all limits. Then `count` gusts that
    are drawn are simulated at the limit, which falls as long as one of them breaks it. More of them
    never raise it: the first ones are the same.

    Args:
        certificate: The lift.
        chart: Load chart of the crane.
        falls: Number of falls that carry the hook; None for the fewest of the chart.
        share: Largest share of the rated load that may be used.
        swing: Largest angle of the rope from plumb that is allowed [rad].
        count: Number of gusts to draw.
        seed: Seed of the random numbers.
        dt: Physics step [s].

    Raises:
        OutOfRange: If a limit or the count is out of its range.
        UnknownName: If the chart has no such number of falls.
        NotCovered: If the chart does not cover the length of the boom.
    """
    chart.of_falls(falls)  # refuses an unknown number of falls before anything is simulated
    allowed = {
        "utilisation": within("share of the rated load", share, 0.0, CUT_OUT),
        "swing": within("swing", swing, 0.0, math.pi / 2.0, "rad"),
        "clearance": certificate.lift.clearance.site.distance,
    }
    rng = np.random.default_rng(whole("seed", seed, 0))
    count = whole("number of lifts", count, 1)
    ranges = _GustRanges.of(certificate)
    trial = _Trial(certificate, chart, falls, allowed, dt)

    rows = _worst_of_grid(trial, ranges)
    drawn = ranges.lowest + ranges.widths * rng.random((count, 3))
    limits = _limits(rows, allowed)
    speed = math.inf
    while limits.limit() < speed and limits.limit() > 0.0:
        speed = limits.limit()
        rows = trial.extended(rows, np.array([speed]), drawn)
        limits = _limits(rows, allowed)
    at_limit = int((rows[:, 0] == limits.limit()).sum())
    limits = replace(limits, at_limit=at_limit, drawn=count if limits.limit() > 0.0 else 0)
    limits = _with_weaker(limits)
    if limits.kept("clearance").all():
        return limits
    speed = float(limits.speeds[~limits.kept("clearance")][0])
    worst_gust = _worst_gusts(rows, limits, "clearance")[0]
    return replace(limits, nearest=trial.nearest(speed, worst_gust))


@dataclass(frozen=True, eq=False)
class _GustRanges:
    """What gusts may be: start [s], duration [s] and direction [rad].

    Attributes:
        lowest, highest: The ranges, shape (3,) each.
        steps: Steps of the grid, shape (3,).
    """

    lowest: np.ndarray
    highest: np.ndarray
    steps: np.ndarray

    @classmethod
    def of(cls, certificate: Certificate) -> _GustRanges:
        """Return the ranges of the gusts of a lift: over its whole time, and from every side."""
        lift = certificate.lift
        arrival = lift.timed.motion.arrival
        shortest_cable = float(np.min(lift.clearance.cable(certificate.run.q)))
        period = float(theory.point_period(shortest_cable, lift.crane.gravity))
        start_count = max(2, math.ceil(arrival * STARTS_IN_PERIOD / period) + 1)
        return cls(
            lowest=np.array([0.0, SHORTEST_GUST, -math.pi]),
            highest=np.array([arrival, LONGEST_GUST, math.pi]),
            steps=np.array(
                [
                    arrival / (start_count - 1),
                    DURATIONS[1] - DURATIONS[0],
                    2.0 * math.pi / DIRECTIONS,
                ]
            ),
        )

    @property
    def widths(self) -> np.ndarray:
        """Widths of the ranges, shape (3,)."""
        return self.highest - self.lowest

    def grid(self) -> np.ndarray:
        """Return the gusts of the grid, shape (n, 3)."""
        # A start is a whole number of steps; the last direction is the first one again.
        starts = np.linspace(0.0, self.highest[0], round(self.highest[0] / self.steps[0]) + 1)
        directions = -math.pi + self.steps[2] * np.arange(DIRECTIONS)
        axes = np.meshgrid(starts, DURATIONS, directions, indexing="ij")
        return np.stack([axis.ravel() for axis in axes], axis=1)

    def around(self, gusts: np.ndarray, share: float) -> np.ndarray:
        """Return gusts that differ from others in one number by a share of the step of the grid,
        shape (6 k, 3) for k of them.
        """
        offsets = share * np.vstack([np.diag(self.steps), -np.diag(self.steps)])
        found = (gusts[:, None] + offsets).reshape(-1, 3)
        # Directions need no range: they go round.
        found[:, :2] = np.clip(found[:, :2], self.lowest[:2], self.highest[:2])
        return found


def _worst_of_grid(trial: _Trial, ranges: _GustRanges) -> np.ndarray:
    """Simulate gusts until the grid keeps each limit at the speed of that limit, and return the
    rows of all, see `_Trial.simulate`.

    The worst gusts of the grid are searched about at the weakest speed at which they break a limit,
    and what is found is simulated at weaker speeds, too. A limit only falls by that. Where it
    falls, the grid is simulated at the new limit, and so on.
    """
    speeds = STEP * np.arange(1.0, round(STRONGEST / STEP) + 1.0)
    grid = ranges.grid()
    rows = trial.simulate(np.array([FIRST_SPEED]), grid)
    at_first = _limits(rows, trial.allowed)
    worst = [_worst_gusts(rows, at_first, name) for name in trial.allowed]
    rows = trial.extended(rows, speeds, np.vstack(worst))
    covered = {0.0, FIRST_SPEED}
    while True:
        limits = _limits(rows, trial.allowed)
        missing = {limits.limit(name) for name in trial.allowed} - covered
        if not missing:
            return rows
        rows = trial.extended(rows, np.array(sorted(missing)), grid)
        covered |= missing
        for name in trial.allowed:
            if not _limits(rows, trial.allowed).kept(name).all():
                rows = _search(trial, ranges, rows, name)


def _search(trial: _Trial, ranges: _GustRanges, rows: np.ndarray, name: str) -> np.ndarray:
    """Search about the worst gusts for a limit by ever smaller steps, and return the rows with
    those of all that was simulated.
    """
    for halving in range(1, SEARCH_HALVINGS + 1):
        limits = _limits(rows, trial.allowed)
        worst = _worst_gusts(rows, limits, name)
        speed = np.array([_speed_of_worst(limits, name)])
        near = ranges.around(worst, 0.5**halving)
        rows = trial.extended(rows, speed, near)
    limits = _limits(rows, trial.allowed)
    worst = _worst_gusts(rows, limits, name)
    broken = _speed_of_worst(limits, name)
    weaker = np.arange(max(STEP, broken - SEARCHED_SPEEDS * STEP), broken, STEP)
    return trial.extended(rows, weaker, worst)


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
        return self._with_values(_each_at_each(speeds, gusts))

    def extended(self, rows: np.ndarray, speeds: np.ndarray, gusts: np.ndarray) -> np.ndarray:
        """Return rows of `simulate` with those of further gusts at further speeds. What is among
        the rows is not simulated again: a gust that stands there twice would be taken for two of
        the worst ones.
        """
        known = {tuple(row) for row in rows[:, :_FIRST_VALUE].tolist()}
        added = []
        for row in _each_at_each(speeds, gusts).tolist():
            if tuple(row) not in known:
                known.add(tuple(row))
                added.append(row)
        if not added:
            return rows
        return np.vstack([rows, self._with_values(np.array(added))])

    def _with_values(self, rows: np.ndarray) -> np.ndarray:
        """Return rows of speed and gust, shape (n, 4), with the value of each limit behind them."""
        drawn = _perturbations(rows)
        # What no lift overwrites counts as failed.
        values = {}
        for name in self.allowed:
            failed = -_FAILED if name == "clearance" else _FAILED
            values[name] = np.full(len(rows), failed)
        for batch in self._simulated(drawn):
            _enter_values(values, batch, self.chart, self.falls)
        return np.column_stack([rows, *values.values()])

    def _simulated(self, drawn: dict[str, np.ndarray]) -> Iterator[PerturbedBatch]:
        """Simulate perturbed lifts, all of them by one controller."""
        return simulate_perturbed(self.certificate, drawn, dt=self.dt, controller=self._controller)

    @cached_property
    def _controller(self) -> HoistIntegral:
        """The controller of the lift."""
        return controller_of(self.certificate.lift, dt=self.dt)

    def nearest(self, speed: float, gust: np.ndarray) -> Nearest | None:
        """Return what comes nearest to what in a gust; None if the lift breaks off in it.

        Args:
            speed: Speed of the gust [m/s].
            gust: Its start [s], duration [s] and direction [rad], shape (3,).
        """
        drawn = _perturbations(np.array([[speed, *gust]]))
        clearance = self.certificate.lift.clearance
        for perturbed in self._simulated(drawn):
            q = perturbed.batch.q[0]
            if np.isfinite(q).all():
                return clearance.nearest(q[clearance.nearest_row(q)])
        return None


def _each_at_each(speeds: np.ndarray, gusts: np.ndarray) -> np.ndarray:
    """Return a row of speed and gust for each gust at each speed, shape (k j, 4); arguments as of
    `_Trial.simulate`.
    """
    return np.column_stack([np.repeat(speeds, len(gusts)), np.tile(gusts, (len(speeds), 1))])


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


def _speed_of_worst(limits: WindLimit, name: str) -> float:
    """Return the weakest speed at which a limit is not kept [m/s], or the strongest if there is
    none.
    """
    broken = limits.speeds[~limits.kept(name)]
    return float(broken[0] if len(broken) else limits.speeds[-1])


def _worst_gusts(rows: np.ndarray, limits: WindLimit, name: str) -> np.ndarray:
    """Return the gusts that are worst for a limit at the speed of `_speed_of_worst`, shape
    (`WORST_COUNT`, 3) or fewer, the worst first.
    """
    at_speed = rows[rows[:, 0] == _speed_of_worst(limits, name)]
    values = at_speed[:, _FIRST_VALUE + list(limits.allowed).index(name)]
    best_last = values if name == "clearance" else -values
    order = np.argsort(best_last, kind="stable")
    return at_speed[order][:WORST_COUNT, _GUST_COLUMNS]


def _limits(rows: np.ndarray, allowed: Mapping[str, float]) -> WindLimit:
    """Return the worst at each speed alone, of rows as of `_Trial.simulate`."""
    speeds = np.unique(rows[:, 0])
    worst = {}
    for column, name in enumerate(allowed, _FIRST_VALUE):
        extreme = np.min if name == "clearance" else np.max
        worst[name] = np.array([extreme(rows[rows[:, 0] == speed, column]) for speed in speeds])
    return WindLimit(speeds, worst, allowed, len(rows))


def _with_weaker(limits: WindLimit) -> WindLimit:
    """Return limits with the worst in gusts of each speed or weaker ones. Beyond the speed at which
    a limit breaks few gusts are tried, so that those alone could seem to keep it.
    """
    worst = {}
    for name, values in limits.worst.items():
        extreme = np.minimum if name == "clearance" else np.maximum
        worst[name] = extreme.accumulate(values)
    return replace(limits, worst=worst)


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
        pivot_radius = loads["pivot_radius_m"]
        inside = np.clip(pivot_radius, reeving.least, reeving.radii[-1])
        used = loads["pull_N"] / (gravity * reeving.at_swinging(radius, inside))
        used = np.where(inside == pivot_radius, used, _FAILED)
    values["utilisation"][rows] = used.max(axis=1)
    # Both leads are angles from plumb in planes at right angles: squares of their tangents add.
    lead = np.hypot(np.tan(loads["off_lead_rad"]), np.tan(loads["side_lead_rad"]))
    values["swing"][rows] = np.arctan(lead).max(axis=1)
    values["clearance"][rows] = perturbed.least[valid]
