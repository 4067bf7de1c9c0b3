"""Motion of a load along its path: as fast as the drives allow, with no more swing than is allowed
and none at the end.

A *law of time* says when the load is where on its path. TOPP-RA (Pham & Pham 2018) gives the
fastest one under limits of rates, accelerations and swing. Its accelerations jump, and between the
points of its grid it exceeds the limits a little. Its average over time has no jumps, and exceeds a
limit less or not at all. The load follows that average, not the trolley: the drives go where the
rope of such a load points (`cranedyn.references.flat`).

Averaging lengthens a motion and leaves some of its limits unused. So the bounds that TOPP-RA is
given are fitted, round by round, until the averaged motion just keeps its limits, see
`_fit_bounds`. Only motions that keep all of them are used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from cranedyn.checks import number
from cranedyn.command import uninterrupted_import
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.curve import Path, interpolate_columns
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion

RAMP = 0.5
"""Shortest time to the limit of acceleration of a drive [s], which sets the limit of its jerk."""

STEP = 0.02
"""Time between the samples of the average [s]."""

_GRID_STEP = 0.15
"""Distance between the evenly spaced points of TOPP-RA's grid along a path [s]. It is up to a
fiftieth more, as the number of points is rounded and counts both ends."""

_MIN_GRID_POINTS = 60
"""Least number of evenly spaced grid points of a path."""

_CORNER_POINTS = 9
"""Number of grid points in each rounded corner, where the direction of the path changes."""

_MIN_GRID_DISTANCE = 1e-4
"""Distance of two grid points up to which one of them is left out [s]; on a path so short that its
evenly spaced points are about as close, half of their distance."""

_POLYGON_SIDES = 16
"""Number of sides of the polygon that replaces the circle of the load's acceleration."""

_AVERAGING_TIMES = (1.2, 1.5, 1.8, 2.2, 2.6, 3.2)
"""Times over which a law of time is averaged [s], of which the fastest motion is used."""

_AVERAGING_SHARES = (1.0, 0.7, 0.4)
"""Shares of that time over which the law is averaged, one after the other. Of the shares that were
tried in development these gave the fastest short moves."""

_REDUCTIONS = (1.0, 1.5, 3.0, 6.0)
"""Factors by which accelerations are reduced, one after the other, until a motion is proven.

Averaging takes a motion off its path by a distance that is proportional to its acceleration, see
`timed`, so that a gentler motion is nearer to the path, which is proven.
"""

_MAX_DURATION = 1e5
"""Longest time of a motion [s], more than a day."""

_FITTING_ROUNDS = 6
"""Number of rounds in which the bounds of a law of time are fitted."""

_KEPT_SHARE = 1.0 + 1e-6
"""Share of a limit up to which the limit counts as kept; the excess is a rounding error."""

_FITTED_SHARE = 0.995
"""Share of an acceleration or of the swing that a round of fitting aims at: just below the limit,
since the share does not change exactly as the bound does."""

_FITTED_RATE_SHARE = 0.999
"""Share of a rate that a round of fitting aims at."""

_MIN_FIT_FACTOR = 0.3
"""Smallest factor by which a round of fitting changes a bound."""

_MAX_FIT_FACTOR = 2.0
"""Largest factor by which a round of fitting changes a bound."""

_MIN_SHARE = 1e-3
"""Share of a limit that fitting assumes at least, so that it never divides by zero."""

_SETTLED_ROUND = 2
"""Round of fitting, counted from 0, from which on no motion that is too long is given another
round. Before it, a round may still loosen a bound and so shorten a motion that is somewhat too
long."""

_TOO_LONG = 1.12
"""Ratio of the duration of a motion to the longest duration of use above which, before
`_SETTLED_ROUND`, no further round makes it short enough."""

_REST_SAMPLES = 8
"""Samples at rest before and after a motion, so that its interpolating spline starts and ends at
rest."""

_SPLINE_DEGREE = 7
"""Degree of the splines through the samples of a motion.

The joints' accelerations contain the fourth derivative of the load's path: two derivatives lead
from the load to the rope that carries it, and two more to accelerations. A spline of degree 7 has
six continuous derivatives.
"""

_MIN_CHANGE = 1e-12
"""Change of a place between two samples [rad or m] above which the load counts as moving."""


class Bounds(NamedTuple):
    """Bounds of a law of time.

    Attributes:
        rates: Rates of the drives [rad/s or m/s], shape (3,).
        accelerations: Their accelerations [rad/s² or m/s²], shape (3,).
        load_acceleration: Horizontal acceleration of the load [m/s²]; infinite if it is not
            bounded.
    """

    rates: np.ndarray
    accelerations: np.ndarray
    load_acceleration: float


class _TimeLaw(NamedTuple):
    """A law of time.

    Attributes:
        t: Times [s], shape (n,).
        places: Places of the load at these times, shape (n, 3).
    """

    t: np.ndarray
    places: np.ndarray

    @property
    def duration(self) -> float:
        """Time from the first to the last place [s]."""
        return float(self.t[-1])


@dataclass(frozen=True, eq=False)
class TimedMotion:
    """A motion along a path.

    Attributes:
        places: Places of the load, in rows a `STEP` apart, shape (n, 3).
        motion: The motion of all joints.
        bound: Shortest time in which the drives alone get along the path within their limits [s],
            whatever the load does.
        shares: Share of each limit that the motion uses, by name.
    """

    places: np.ndarray
    motion: Motion
    bound: float
    shares: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Task:
    """What `timed` is asked for; see its arguments."""

    clearance: Clearance
    path: Path
    limits: Limits
    proven: Callable[[TimedMotion], bool]
    shorter_than: float


class _Outcome(NamedTuple):
    """Result of a search for a motion.

    Attributes:
        best: The fastest proven motion so far; None if there is none.
        too_long: Whether the search ended because its motions last too long, so that slower ones
            need not be tried.
    """

    best: TimedMotion | None
    too_long: bool


def timed(
    clearance: Clearance,
    path: Path,
    limits: Limits,
    proven: Callable[[TimedMotion], bool],
    *,
    shorter_than: float = math.inf,
    period: float = 5e-3,
) -> TimedMotion | None:
    """Return the fastest motion of the load along a path that keeps the limits of the drives and
    the swing of the site, and is proven.

    Averaging takes a motion off its path where that bends: a mean over times of the variance σ²
    moves a point of the acceleration a by a σ²/2.

    Args:
        clearance: Crane and site.
        path: The path of the load.
        limits: Rates and accelerations of the drives.
        proven: Function that says whether a motion is proven free; where it is not, slower ones are
            tried.
        shorter_than: Duration [s] from which on a motion is of no use, as a shorter one is known.
        period: Time between rows of the motion [s].

    Returns:
        The motion; None if none is proven, or no law of time keeps the limits.

    Raises:
        CraneError: If TOPP-RA is not installed, no speed along the path keeps the limits, or a
            motion would last longer than a day.
    """
    task = _Task(clearance, path, limits, proven, shorter_than)
    for reduction in _REDUCTIONS:
        outcome = _best_of_averages(task, reduction)
        if outcome.best is not None:
            return _finished(task, outcome.best, period)
        if outcome.too_long:
            break  # with smaller accelerations it would last longer still
    return None


def _finished(task: _Task, best: TimedMotion, period: float) -> TimedMotion:
    """Return a motion with rows a period [s] apart and with its `TimedMotion.bound`. While motions
    are compared neither is needed.
    """
    rates = np.array(task.limits.rates)
    accelerations = np.array(task.limits.accelerations)
    drives_alone = _fastest(task.clearance, task.path, Bounds(rates, accelerations, math.inf))
    motion = motion_of_load(task.clearance, best.places, period)
    return replace(best, motion=motion, bound=drives_alone.duration)


def _best_of_averages(task: _Task, reduction: float) -> _Outcome:
    """Return the fastest proven motion over all times of averaging, with the accelerations of
    drives and load reduced by a factor.
    """
    # The rope of a load that accelerates by a leans by arctan(a/g).
    load_acceleration = task.clearance.crane.gravity * math.tan(task.clearance.site.swing)
    accelerations = np.array(task.limits.accelerations) / reduction
    rates = np.array(task.limits.rates)
    first_bounds = Bounds(rates, accelerations, load_acceleration / reduction)
    first_law = _fastest(task.clearance, task.path, first_bounds)

    best: TimedMotion | None = None
    all_too_long = True
    for averaging_time in _AVERAGING_TIMES:
        outcome = _fit_bounds(task, reduction, first_bounds, first_law, averaging_time, best)
        best = outcome.best
        all_too_long = all_too_long and outcome.too_long
    return _Outcome(best, all_too_long)


def _fit_bounds(
    task: _Task,
    reduction: float,
    first_bounds: Bounds,
    first_law: _TimeLaw,
    averaging_time: float,
    best: TimedMotion | None,
) -> _Outcome:
    """Fit the bounds of a law of time so that its average uses its limits fully, and return the
    fastest proven motion among these averages and the best one so far.

    In each round the law is averaged, the shares of its limits are measured, and the bounds changed
    by them. The rounds end early where a further one is of no use:

    * The motion lasts too long, before `_SETTLED_ROUND` by so much that loosened bounds would not
      help.
    * It exceeds a limit and is no faster than what is known, so that it is slower still once it
      keeps the limit.
    * It keeps all limits and is not proven: a faster one would be farther off its path.

    Args:
        task: What is asked for.
        reduction: Factor by which accelerations are to be less than their limits.
        first_bounds: Bounds to begin with.
        first_law: The fastest law of time within them, which is the same for all averages.
        averaging_time: Time that `_AVERAGING_SHARES` are shares of [s].
        best: The fastest proven motion so far; None if there is none.
    """
    bounds = first_bounds
    law = first_law
    for round_ in range(_FITTING_ROUNDS):
        if round_ > 0:
            law = _fastest(task.clearance, task.path, bounds)
        places = _averaged(law, averaging_time)
        duration = STEP * (len(places) - 1)
        longest = task.shorter_than
        if best is not None:
            longest = min(longest, best.motion.arrival)
        may_get_shorter = round_ < _SETTLED_ROUND
        useless_from = _TOO_LONG * longest if may_get_shorter else longest - STEP
        if duration >= useless_from:  # before the motion is computed, which takes longest
            return _Outcome(best, too_long=True)

        motion = motion_of_load(task.clearance, places, STEP)
        shares = limit_shares(task.clearance, motion, task.limits)
        if max(shares.values()) <= _KEPT_SHARE:
            candidate = TimedMotion(places, motion, math.nan, shares)
            if not task.proven(candidate):
                return _Outcome(best, too_long=False)
            if best is None or motion.arrival < best.motion.arrival:
                best = candidate
        elif duration >= longest:
            return _Outcome(best, too_long=True)
        bounds = _fitted(bounds, shares, reduction, task.clearance.drive_names)
    return _Outcome(best, too_long=False)


def _fitted(
    bounds: Bounds, shares: dict[str, float], reduction: float, drives: Sequence[str]
) -> Bounds:
    """Return the bounds of the law of time for the next round: each bound is divided by the share
    of its limit that the averaged motion uses.

    Accelerations aim at their limits divided by the reduction; rates are only reduced, as their
    first bounds are the limits themselves. The shares are under the names of the drives.
    """
    rate = _drive_shares(shares, "rate", drives)
    acceleration = _drive_shares(shares, "acceleration", drives)
    jerk = _drive_shares(shares, "jerk", drives)
    effort = _drive_shares(shares, "effort", drives)

    # A smaller acceleration reduces jerk and effort, too. An effort depends on the accelerations of
    # all drives, so that the largest one counts for each.
    used = np.maximum(np.maximum(acceleration, jerk), effort.max())
    acceleration_factor = _fit_factor(used, reduction)
    swing_factor = _fit_factor(np.array(shares["swing"]), reduction)
    return Bounds(
        rates=bounds.rates / np.maximum(1.0, rate / _FITTED_RATE_SHARE),
        accelerations=bounds.accelerations * acceleration_factor,
        load_acceleration=bounds.load_acceleration * float(swing_factor),
    )


def _drive_shares(shares: dict[str, float], kind: str, drives: Sequence[str]) -> np.ndarray:
    """Return the shares of a kind of limit, such as "rate", of the drives of these names, shape
    (3,).
    """
    return np.array([shares[f"{kind} of the {drive}"] for drive in drives])


def _fit_factor(share: np.ndarray, reduction: float) -> np.ndarray:
    """Return the factors of bounds that would bring shares of limits to `_FITTED_SHARE` divided by
    the reduction, if shares were proportional to bounds.
    """
    factor = _FITTED_SHARE / (reduction * np.maximum(share, _MIN_SHARE))
    return np.clip(factor, _MIN_FIT_FACTOR, _MAX_FIT_FACTOR)


def _fastest(clearance: Clearance, path: Path, bounds: Bounds) -> _TimeLaw:
    """Return the fastest law of time along a path within bounds, at times a `STEP` apart and at its
    end.

    Raises:
        CraneError: If TOPP-RA is not installed, no speed keeps the bounds, or it would last longer
            than `_MAX_DURATION`.
    """
    s = _grid(path).s
    speeds = _fastest_speeds(clearance, path, bounds)

    # TOPP-RA assumes a constant acceleration s'' along the path between two grid points, so that
    # the mean speed there is the mean of the speeds at both.
    times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (speeds[1:] + speeds[:-1]))])
    if not times[-1] <= _MAX_DURATION:
        raise CraneError(
            f"A load on this path takes more than {_MAX_DURATION:g} s, {times[-1]:.4g} s; enter "
            "faster [drives], or look whether those entered are in °/s and m/s."
        )
    t = np.append(np.arange(0.0, times[-1], STEP), times[-1])
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(s) - 2)
    since_point = t - times[k]
    accelerations = np.diff(speeds) / np.diff(times)
    reached = s[k] + since_point * (speeds[k] + accelerations[k] * since_point / 2.0)
    return _TimeLaw(t, path.derivatives(np.clip(reached, 0.0, path.duration))[0])


def _fastest_speeds(clearance: Clearance, path: Path, bounds: Bounds) -> np.ndarray:
    """Return the largest speeds along a path at its grid points by TOPP-RA, from rest to rest,
    shape (n,).

    Raises:
        CraneError: If TOPP-RA is not installed, or no speed keeps the bounds.
    """
    toppra, constraint, algorithm = _toppra()
    s = _grid(path).s
    at_s = _grid(path).derivatives

    def accelerations(
        drive_position: np.ndarray, first: np.ndarray, second: np.ndarray
    ) -> np.ndarray:
        """Return the accelerations of the three drives, and two horizontal ones of the load, shape
        (n, 5). With derivatives by the parameter of the path these are coefficients of s'' and
        s'².
        """
        of_load = clearance.load_accelerations(drive_position, first, second)
        return np.column_stack([second, of_load])

    # The base classes of these two are known only once TOPP-RA has been imported. It calls their
    # methods and reads their attributes by the names that they have here.
    class Geometric(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc, name-defined]
        """The path as TOPP-RA asks for it: places or their derivatives of an order, at positions
        along it.
        """

        dof = 3
        path_interval = np.array([0.0, path.duration])
        waypoints = None

        def __call__(self, path_positions: Any, order: int = 0) -> np.ndarray:
            assert np.array_equal(path_positions, s)  # TOPP-RA asks for no others
            return at_s[order]

    class Accelerations(constraint.LinearConstraint):  # type: ignore[misc, name-defined]
        """Bounds of the accelerations of the drives, and of the horizontal acceleration of the
        load, whose circle is replaced by the polygon inside it: for TOPP-RA, linear inequalities
        in s'' and s'² at each grid point.
        """

        def __init__(self) -> None:
            super().__init__()
            self.identical = True
            self.discretization_type = constraint.DiscretizationType.Interpolation

        def compute_constraint_params(self, path: Any, gridpoints: np.ndarray) -> Any:
            # With the speed s' along the path, places q(s) have q'' = q_s s'' + q_ss s'². TOPP-RA
            # takes the coefficients of s'' and of s'² separately.
            drive_position, first, second = at_s
            no_speed = np.zeros_like(first)
            a = accelerations(drive_position, no_speed, first)
            b = accelerations(drive_position, first, second)
            rows, upper = _polygon(bounds)
            return constraint.linear_constraint.canlinear_colloc_to_interpolate(
                a, b, np.zeros_like(a), rows, upper, None, None, gridpoints, identical=True
            )

    velocity = constraint.JointVelocityConstraint(np.column_stack([-bounds.rates, bounds.rates]))
    problem = algorithm.TOPPRA(
        [velocity, Accelerations()], Geometric(), gridpoints=s, solver_wrapper="seidel"
    )
    _, speeds, _ = problem.compute_parameterization(0.0, 0.0)
    if speeds is None:
        raise CraneError(
            "No speed along this path keeps the limits of the drives, as TOPP-RA finds; larger "
            "rates or accelerations in [drives] may."
        )
    return speeds


def _polygon(bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds as linear inequalities in the accelerations of the drives and of the load, see
    `_fastest_speeds`: their matrix, shape (k, 5), and their right-hand sides, shape (k,).
    """
    rows = []
    upper = []
    for drive, limit in enumerate(bounds.accelerations.tolist()):
        unit = np.eye(5)[drive]
        for sign in (1.0, -1.0):
            rows.append(sign * unit)
            upper.append(limit)
    if math.isfinite(bounds.load_acceleration):
        # The sides of a regular polygon with corners on the circle of the radius r are
        # r cos(π/n) from its centre.
        apothem = bounds.load_acceleration * math.cos(math.pi / _POLYGON_SIDES)
        for angle in 2.0 * math.pi * np.arange(_POLYGON_SIDES) / _POLYGON_SIDES:
            rows.append(np.array([0.0, 0.0, 0.0, math.cos(angle), math.sin(angle)]))
            upper.append(apothem)
    return np.array(rows), np.array(upper)


class _PathGrid(NamedTuple):
    """Grid of TOPP-RA along a path.

    Attributes:
        s: Parameters of the path [s], increasing from 0 to its duration, shape (n,).
        derivatives: Places there and their first and second derivatives, shape (n, 3) each.
    """

    s: np.ndarray
    derivatives: tuple[np.ndarray, np.ndarray, np.ndarray]


@lru_cache(maxsize=1)  # one path is timed many times, then the next one
def _grid(path: Path) -> _PathGrid:
    """Return the grid of TOPP-RA along a path: evenly spaced points, and more of them in each
    rounded corner, where accelerations change.
    """
    count = max(_MIN_GRID_POINTS, math.ceil(path.duration / _GRID_STEP))
    groups = [np.linspace(0.0, path.duration, count)]
    for corner, width in zip(path.knots[1:-1], path.widths, strict=True):
        groups.append(corner + width * np.linspace(-1.0, 1.0, _CORNER_POINTS))
    points = np.unique(np.concatenate(groups))

    # Points that are too close to the one before are left out. The last of all stays, and the one
    # before it goes instead.
    even_distance = path.duration / (count - 1)
    too_close = min(_MIN_GRID_DISTANCE, even_distance / 2.0)
    is_kept = np.append(True, np.diff(points) > too_close)
    is_kept[-1] = True
    points = points[is_kept]
    if points[-1] - points[-2] <= too_close:
        points = np.delete(points, -2)
    return _PathGrid(points, path.derivatives(points))


def _averaged(law: _TimeLaw, averaging_time: float) -> np.ndarray:
    """Return places in rows a `STEP` apart, averaged by moving means over times: each of
    `_AVERAGING_SHARES` of a time [s], one mean after the other, shape (n, 3).

    The average lasts longer than the law by the sum of these times. Its first and last two rows are
    the same: it begins and ends at rest.
    """
    rows = STEP * np.arange(math.ceil(law.duration / STEP) + 1)
    averaged = interpolate_columns(rows, law.t, law.places)
    for share in _AVERAGING_SHARES:
        count = max(1, round(share * averaging_time / STEP))
        padded = np.pad(averaged, ((count, count), (0, 0)), mode="edge")
        # Means by differences of cumulative sums; offsets from the first place keep these small,
        # and so their rounding errors.
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(padded - padded[0], axis=0)])
        averaged = padded[0] + (sums[count:] - sums[:-count]) / count

    # The padding is left out, but for one row at rest at each end.
    steps = np.abs(np.diff(averaged, axis=0)).max(axis=1)
    moving = np.flatnonzero(steps > _MIN_CHANGE)
    return averaged[moving[0] : moving[-1] + 2]


def motion_of_load(clearance: Clearance, drive_positions: np.ndarray, period: float) -> Motion:
    """Return the motion of all joints in which the load is at places a `STEP` apart, at rest at
    both ends, with rows a period [s] apart.

    A load with rotational inertia I swings as a point at its centre of oscillation, I/(m l) below
    its centre. The path of that point is planned, as in `cranedyn.references.flat.flat`: it is
    I/(m l) below each place. So the centre of the load is at its place where the rope hangs plumb,
    and within I/(m l) times the swing of it elsewhere.

    Args:
        clearance: Crane and site.
        drive_positions: Places of the load, shape (n, 3).
        period: Time between rows of the motion [s].

    Raises:
        OutOfRange: If the rope would be slack.
    """
    crane = clearance.crane
    padded = np.pad(drive_positions, ((_REST_SAMPLES, _REST_SAMPLES), (0, 0)), mode="edge")
    t = STEP * (np.arange(len(padded)) - _REST_SAMPLES)

    # The centre of oscillation lies I/(m l) below the centre of the load.
    cable = clearance.cable(clearance.q(padded))[:, None]
    oscillating = clearance.point(padded) - np.array([0.0, 0.0, clearance.swing_inertia]) / cable
    path = scipy.interpolate.make_interp_spline(t, oscillating, k=_SPLINE_DEGREE)
    acceleration = path.derivative(2)(t)

    # The rope carries the load against gravity and accelerates it: it points along p'' + g ẑ.
    rope = acceleration / crane.gravity + np.array([0.0, 0.0, 1.0])
    least_pull = float(rope[:, 2].min())
    if not least_pull > 0.0:
        raise OutOfRange(
            "least vertical pull of the rope along this path, divided by the weight of the load",
            least_pull,
            "> 0, as smaller accelerations in [drives] make it",
        )
    unit_rope = rope / np.linalg.norm(rope, axis=1)[:, None]
    q = clearance.carry(oscillating, unit_rope, padded)

    curve = scipy.interpolate.make_interp_spline(t, q, k=_SPLINE_DEGREE)
    duration = (len(drive_positions) - 1) * STEP
    # A duration that is a multiple of the period must not get a row more by rounding.
    rows = period * np.arange(math.ceil(duration / period - 1e-9) + 1)
    positions = curve(rows)
    v = curve.derivative(1)(rows)
    a = curve.derivative(2)(rows)
    # The spline passes its ends with rounding errors; there the load is exactly at rest.
    for row in (0, -1):
        positions[row] = clearance.q(drive_positions[row])
        v[row] = 0.0
        a[row] = 0.0
    return Motion(period, positions, v, a, crane.layout.drives)


def limit_shares(clearance: Clearance, motion: Motion, limits: Limits) -> dict[str, float]:
    """Return the share of each limit that a motion uses, by name: rates, accelerations, efforts and
    jerks of the drives, and the swing of the site.

    Raises:
        OutOfRange: If a share is not a number; a maximum would pass over it.
    """
    shares = use(clearance.crane, motion, limits)
    # A drive reaches its limit of acceleration A in the time `RAMP` at the shortest: jerk ≤ A/RAMP.
    changes = np.abs(np.diff(motion.a[:, clearance.drive_joints], axis=0)).max(axis=0)
    jerk = changes / motion.period
    jerk_shares = (jerk * RAMP / np.array(limits.accelerations)).tolist()
    for drive, share in zip(clearance.drive_names, jerk_shares, strict=True):
        shares[f"jerk of the {drive}"] = share
    shares["swing"] = float(clearance.tilt(motion.q).max()) / clearance.site.swing
    for name, share in shares.items():
        number(f"share of the {name}", share, "", ">= 0")
    return shares


def _toppra() -> tuple[Any, Any, Any]:
    """Return the modules toppra, toppra.constraint and toppra.algorithm, which are slow to import.

    Raises:
        CraneError: If TOPP-RA is not installed.
    """
    try:
        toppra = uninterrupted_import("toppra")
        constraint = uninterrupted_import("toppra.constraint")
        algorithm = uninterrupted_import("toppra.algorithm")
    except ImportError as error:
        raise CraneError(
            "To time a path install the extra planning: pip install 'cranedyn[planning]'."
        ) from error
    toppra.setup_logging("ERROR")
    return toppra, constraint, algorithm
