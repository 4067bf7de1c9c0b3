"""Motion of a load along its path: as fast as the drives allow, with no more swing than is allowed
and none at the end.

TOPP-RA (Pham & Pham 2018) gives the fastest law of time under limits of rates, accelerations and
swing. It exceeds these between the points of its grid, and its accelerations jump. Its average over
time does neither, since a mean never exceeds its values. The load follows that average, not the
trolley: the drives go where the rope of such a load points
(`cranedyn.references.flat`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from cranedyn.checks import number
from cranedyn.command import uninterrupted_import
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.curve import Path, interpolate_columns
from cranedyn.references.flat import recover
from cranedyn.references.limits import Limits, use
from cranedyn.references.motion import Motion

RAMP = 0.5
"""Shortest time to the limit of acceleration of a drive [s], which sets the limit of its jerk."""

STEP = 0.02
"""Time between the samples of the average [s]."""

_GRID, _IN_CORNER = 0.15, 9
_SIDES = 16
_AVERAGES = (1.2, 1.5, 1.8, 2.2, 2.6, 3.2)
"""Times over which a law of time is averaged [s], of which the fastest motion is used."""

_SHARES = (1.0, 0.7, 0.4)
"""Shares of that time over which it is averaged, one after the other: of those tried the fastest
for short moves."""

_SLOWER = (1.0, 1.5, 3.0, 6.0)
"""Factors by which accelerations are reduced, one after the other, until a motion is proven."""

_LONGEST = 1e5
"""Longest time of a motion [s], more than a day."""

_ROUNDS, _KEPT, _MORE = 6, 1.0 + 1e-6, 2.0
"""Rounds of fitting bounds, share of a limit that is kept, largest change of a bound in a round."""

_TOO_LONG = 1.12
"""Duration over the longest of use from which on no further round makes a motion short enough."""

_PADDING = 8
"""Samples at rest before and after a motion."""


class Bounds(NamedTuple):
    """Bounds of a law of time.

    Attributes:
        rates: Rates of slew [rad/s], trolley and hoist [m/s], shape (3,).
        accelerations: Their accelerations, shape (3,).
        across: Horizontal acceleration of the load [m/s²].
    """

    rates: np.ndarray
    accelerations: np.ndarray
    across: float


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


def timed(
    clearance: Clearance,
    path: Path,
    limits: Limits,
    proven: Callable[[TimedMotion], bool],
    *,
    within: float = math.inf,
    period: float = 5e-3,
) -> TimedMotion | None:
    """Return the fastest motion of the load along a path that keeps the limits of the drives and
    the swing of the site, and is proven.

    Averaging takes a motion off its path where that bends, by half of its acceleration times the
    variance of the times averaged over.

    Args:
        clearance: Crane and site.
        path: The path of the load.
        limits: Rates and accelerations of the drives.
        proven: Function that says whether a motion is proven free; where it is not, slower ones are
            tried.
        within: Duration [s] from which on a motion is of no use.
        period: Time between rows of the motion [s].

    Returns:
        The motion; None if none is proven, or no law of time keeps the limits.

    Raises:
        CraneError: If TOPP-RA is not installed.
    """
    crane = clearance.crane
    rates, accelerations = np.array(limits.rates), np.array(limits.accelerations)
    for slower in _SLOWER:
        best: TimedMotion | None = None
        too_long = True
        across = crane.gravity * math.tan(clearance.site.swing) / slower
        first_bounds = Bounds(rates, accelerations / slower, across)
        first_law = _fastest(path, first_bounds)
        for average in _AVERAGES:
            bounds = first_bounds
            for round_ in range(_ROUNDS):
                law = _fastest(path, bounds) if round_ else first_law
                drive_positions = _averaged(*law, average)
                duration = STEP * (len(drive_positions) - 1)
                longest = within if best is None else min(within, best.motion.arrival)
                if duration >= (longest - STEP if round_ > 1 else _TOO_LONG * longest):
                    break
                motion = load_motion(clearance, drive_positions, STEP)
                shares = limit_shares(clearance, motion, limits)
                candidate = TimedMotion(drive_positions, motion, math.nan, shares)
                if max(shares.values()) <= _KEPT:
                    if not proven(candidate):
                        too_long = False
                        break
                    if best is None or motion.arrival < best.motion.arrival:
                        best = candidate
                elif duration >= longest:
                    break  # it lasts longer still once it keeps its limits
                bounds = _fitted(bounds, shares, slower)
            else:
                too_long = False
        if best is not None:
            bound = float(_fastest(path, Bounds(rates, accelerations, math.inf))[0][-1])
            return replace(best, motion=load_motion(clearance, best.places, period), bound=bound)
        if too_long:
            break
    return None


def _fitted(bounds: Bounds, shares: dict[str, float], slower: float) -> Bounds:
    """Return bounds of the law of time for an averaged motion that uses its limits fully."""
    rate, acceleration, jerk, effort = (
        np.array([shares[f"{kind} of the {name}"] for name in ("slew", "trolley", "hoist")])
        for kind in ("rate", "acceleration", "jerk", "effort")
    )
    used = np.maximum(np.maximum(acceleration, jerk), effort.max())
    factor, across = (
        np.clip(0.995 / (slower * np.maximum(share, 1e-3)), 0.3, _MORE)
        for share in (used, shares["swing"])
    )
    rates = bounds.rates / np.maximum(1.0, rate / 0.999)
    return Bounds(rates, bounds.accelerations * factor, bounds.across * float(across))


def _fastest(path: Path, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s], shape (n,), and places, shape (n, 3), of the fastest law of time."""
    toppra, constraint, algorithm = _toppra()
    s, at_s = _grid(path)

    class Geometric(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc, name-defined]
        dof = 3
        path_interval = np.array([0.0, path.duration])
        waypoints = None

        def __call__(self, path_positions: Any, order: int = 0) -> np.ndarray:
            assert np.array_equal(path_positions, s)  # TOPP-RA asks for no others
            return at_s[order]

    class Accelerations(constraint.LinearConstraint):  # type: ignore[misc, name-defined]
        """Accelerations of the drives, and of the load across, whose circle is replaced by the
        polygon inside it.
        """

        def __init__(self) -> None:
            super().__init__()
            self.identical = True
            self.discretization_type = constraint.DiscretizationType.Interpolation

        def compute_constraint_params(self, path: Any, gridpoints: np.ndarray) -> Any:
            drive_position, first, second = at_s
            a = _accelerations(drive_position, np.zeros_like(first), first)
            b = _accelerations(drive_position, first, second)
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
    times = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (speeds[1:] + speeds[:-1]))])
    if not times[-1] <= _LONGEST:
        raise CraneError(
            f"A load on this path takes more than {_LONGEST:g} s, {times[-1]:.4g} s; enter faster "
            "[drives], or look whether their units are those of the page."
        )
    t = np.append(np.arange(0.0, times[-1], STEP), times[-1])
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(s) - 2)
    since, gain = t - times[k], np.diff(speeds) / np.diff(times)
    reached = s[k] + since * (speeds[k] + gain[k] * since / 2.0)
    return t, path.derivatives(np.clip(reached, 0.0, path.duration))[0]


def _accelerations(drive_position: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return accelerations of slew, trolley and hoist, and of the load outward and along the
    circle, shape (n, 5).
    """
    (_, x, _), (slew, outward, _) = drive_position.T, first.T
    return np.column_stack(
        [second, second[:, 1] - x * slew**2, x * second[:, 0] + 2.0 * outward * slew]
    )


def _polygon(bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and upper bounds of linear inequalities in these accelerations."""
    rows = list(np.kron(np.eye(3, 5), [[1.0], [-1.0]]))
    upper = np.repeat(bounds.accelerations, 2).tolist()
    if math.isfinite(bounds.across):
        for angle in 2.0 * math.pi * np.arange(_SIDES) / _SIDES:
            rows.append(np.array([0.0, 0.0, 0.0, math.cos(angle), math.sin(angle)]))
            upper.append(bounds.across * math.cos(math.pi / _SIDES))
    return np.array(rows), np.array(upper)


@lru_cache(maxsize=1)
def _grid(path: Path) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the grid points of TOPP-RA along a path, with places and derivatives there."""
    even = np.linspace(0.0, path.duration, max(60, math.ceil(path.duration / _GRID)))
    corners = [
        knot + width * np.linspace(-1.0, 1.0, _IN_CORNER)
        for knot, width in zip(path.knots[1:-1], path.widths, strict=True)
    ]
    points = np.unique(np.concatenate([even, *corners]))
    if path.duration - points[-2] <= 1e-4:
        points = np.delete(points, -2)
    else:
        points = points[np.append(True, np.diff(points) > 1e-4)]
    return points, path.derivatives(points)


def _averaged(t: np.ndarray, drive_positions: np.ndarray, average: float) -> np.ndarray:
    """Return places a `STEP` apart, averaged three times; the average lasts longer by the times
    that are averaged over.
    """
    rows = STEP * np.arange(math.ceil(t[-1] / STEP) + 1)
    averaged = interpolate_columns(rows, t, drive_positions)
    for share in _SHARES:
        count = max(1, round(share * average / STEP))
        padded = np.pad(averaged, ((count, count), (0, 0)), mode="edge")
        sums = np.concatenate([np.zeros((1, 3)), np.cumsum(padded - padded[0], axis=0)])
        averaged = padded[0] + (sums[count:] - sums[:-count]) / count
    moving = np.flatnonzero(np.abs(np.diff(averaged, axis=0)).max(axis=1) > 1e-12)
    return averaged[moving[0] : moving[-1] + 2]


def load_motion(clearance: Clearance, drive_positions: np.ndarray, period: float) -> Motion:
    """Return the motion of all joints in which the load is at places a `STEP` apart, at rest at
    both ends, with rows a period [s] apart.

    The load is at its place with its centre of oscillation, as in `cranedyn.references.flat.flat`.

    Raises:
        OutOfRange: If the rope would be slack.
    """
    crane = clearance.crane
    inertia = (crane.payload_inertia[0, 0] + sum(crane.dummy_inertia) / 2.0) / crane.payload_mass
    padded = np.pad(drive_positions, ((_PADDING, _PADDING), (0, 0)), mode="edge")
    t = STEP * (np.arange(len(padded)) - _PADDING)
    point = clearance.point(padded) - np.array([0.0, 0.0, inertia]) / padded[:, 2:]
    acceleration = scipy.interpolate.make_interp_spline(t, point, k=7).derivative(2)(t)
    rope = acceleration / crane.gravity + np.array([0.0, 0.0, 1.0])
    if not (tension := float(rope[:, 2].min())) > 0.0:
        raise OutOfRange(
            "least tension of the rope along this path, over the weight of the load",
            tension,
            "> 0, as smaller accelerations in [drives] make it",
        )
    q = recover(point, rope / np.linalg.norm(rope, axis=1)[:, None], clearance.height, inertia)
    slew = clearance.joints.slew
    q[:, slew] += drive_positions[0, 0] - q[0, slew]
    curve = scipy.interpolate.make_interp_spline(t, q, k=7)
    rows = period * np.arange(math.ceil((len(drive_positions) - 1) * STEP / period - 1e-9) + 1)
    positions, v, a = (curve.derivative(order)(rows) for order in range(3))
    for k in (0, -1):
        positions[k], v[k], a[k] = clearance.q(drive_positions[k]), 0.0, 0.0
    return Motion(period, positions, v, a, crane.layout.drives)


def limit_shares(clearance: Clearance, motion: Motion, limits: Limits) -> dict[str, float]:
    """Return the share of each limit that a motion uses, by name.

    Raises:
        OutOfRange: If a share is not a number; a maximum would pass over it.
    """
    shares = use(clearance.crane, motion, limits)
    jerk = np.abs(np.diff(motion.a[:, clearance.drive_joints], axis=0)).max(axis=0) / motion.period
    jerk_shares = (jerk * RAMP / np.array(limits.accelerations)).tolist()
    for name, share in zip(("slew", "trolley", "hoist"), jerk_shares, strict=True):
        shares[f"jerk of the {name}"] = share
    shares["swing"] = float(clearance.tilt(motion.q).max()) / clearance.site.swing
    for name, share in shares.items():
        number(f"share of the {name}", share, "", ">= 0")
    return shares


def _toppra() -> tuple[Any, Any, Any]:
    try:
        toppra, constraint, algorithm = map(
            uninterrupted_import, ("toppra", "toppra.constraint", "toppra.algorithm")
        )
    except ImportError as error:
        raise CraneError(
            "To time a path install the extra planning: pip install 'cranedyn[planning]'."
        ) from error
    toppra.setup_logging("ERROR")
    return toppra, constraint, algorithm
