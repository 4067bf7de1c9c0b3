"""Plan of a tandem lift: the load moves along straight lines with a constant heading, and the
drives of both cranes so that it does not swing.

Where a load accelerates, both ropes lean by the same angle: each pulls along the direction n of
r̈ - g, with the acceleration r̈ of the load and gravity g. So the pivot of each crane is on the line
through its lug in that direction, and the length of each rope is the distance less its stretch.
What the drives have to do follows from the motion of the load, as for one crane in
`cranedyn.references.flat`. The motion begins and ends with rates, accelerations and two further
derivatives of zero, so that the drives begin and end at rest.

* Across the line of the lugs the load leans with the ropes, so that both pull through its centre of
  mass. The torque that turns it so, its inertia times the acceleration of the lean, is neglected:
  it leaves a small roll, which the simulation shows.
* Along the line of the lugs the load stays level. The pulls of the ropes differ instead: the shares
  are those of a load that is tilted by the lean, see `cranedyn.lifts.tandem.statics`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from cranedyn.checks import finite, number
from cranedyn.errors import CraneError, OutOfRange, UnknownName, quoted
from cranedyn.lifts.sites.crane_site import CraneSite, Station
from cranedyn.lifts.tandem.drives import DriveMotion, TandemDrives
from cranedyn.lifts.tandem.load import TandemLoad, TandemRope
from cranedyn.lifts.tandem.statics import static_shares
from cranedyn.references.limits import Limits

_ROWS = 201
"""Number of instants at which the drives of a plan are computed; splines join them."""

_SMOOTH = np.array([126.0, -420.0, 540.0, -315.0, 70.0])
"""Coefficients of s⁵ to s⁹ of the polynomial from 0 to 1 whose first four derivatives are zero at
both ends."""

_START_POINTS = 12
"""Values of each drive from which the first posture is searched."""

_PIVOT_ERROR = 1e-9
"""Largest distance of a pivot from where the plan wants it in plan view [m]: below what the
accelerations of the drives would show of it.
"""

_NEWTON_STEPS = 30
"""Steps of Newton's method to such a posture; from one row to the next it takes three or four."""

_ITERATIONS = 30
"""Corrections of the duration until the drives keep their limits."""

_MAX_LEAN = 0.1
"""Horizontal acceleration of the load over gravity at most, so that ropes lean by 5.7° at most."""


@dataclass(frozen=True, eq=False)
class TandemLift:
    """Two cranes of a site and the load that they carry together.

    Attributes:
        site: The site.
        names: Names of the two cranes, the first at the first lug.
        load: The load.
        rope: The ropes of both.
        limits: Largest rates and accelerations of the drives of each crane; for those that are left
            out, the limits of its converters.
    """

    site: CraneSite
    names: tuple[str, str]
    load: TandemLoad
    rope: TandemRope
    limits: Sequence[Limits] = field(default_factory=tuple)

    def __post_init__(self) -> None:
        """Check the names and that both cranes stand in one gravity.

        Raises:
            UnknownName: If the site has no such crane.
            OutOfRange: If both are the same crane.
            CraneError: If the cranes have different gravities.
        """
        known = [station.name for station in self.site.stations]
        for name in self.names:
            if name not in known:
                raise UnknownName("crane", name, known)
        if self.names[0] == self.names[1]:
            raise OutOfRange("cranes of a tandem lift", quoted(self.names[0]), "two different ones")
        first, second = self.stations
        if first.crane.gravity != second.crane.gravity:
            raise CraneError("Both cranes of a tandem lift need the same gravity.")

    @property
    def stations(self) -> tuple[Station, Station]:
        """Both cranes at their places."""
        by_name = {station.name: station for station in self.site.stations}
        return by_name[self.names[0]], by_name[self.names[1]]

    @property
    def gravity(self) -> float:
        """Gravity [m/s²]."""
        return self.stations[0].crane.gravity

    def limits_of(self, crane: int) -> Limits:
        """Return the largest rates and accelerations of the drives of a crane, 0 or 1."""
        if len(self.limits) > crane:
            return self.limits[crane]
        station = self.stations[crane]
        converters = station.converters
        return Limits(list(converters.rates), list(converters.accelerations))


class TandemPlan(NamedTuple):
    """A planned tandem lift.

    Attributes:
        lift: The lift.
        drives: Motions of the drives of both cranes.
        start: Place of the centre of mass at the start in the frame of the site [m], shape (3,).
        goal: Its place at the end [m], shape (3,).
        yaw: Angle of the load's X axis from that of the site [rad].
        duration: Duration of the motion [s].
        largest_lean: Largest angle of the ropes from plumb [rad].
        via: Places between start and goal at which the load stands still for a moment [m], shape
            (k, 3).
        poses: Where the load is over time.
    """

    lift: TandemLift
    drives: TandemDrives
    start: np.ndarray
    goal: np.ndarray
    yaw: float
    duration: float
    largest_lean: float
    via: np.ndarray
    poses: PlannedPoses


class PlannedPoses(NamedTuple):
    """Where the load of a plan is over time.

    Attributes:
        t: Times [s], shape (rows,).
        centres: Places of the centre of mass in the frame of the site [m], shape (rows, 3).
        rotations: Rotations from the axes of the load to those of the site, one for each row.
    """

    t: np.ndarray
    centres: np.ndarray
    rotations: Rotation


def plan_tandem(
    lift: TandemLift,
    start: Sequence[float],
    goal: Sequence[float],
    *,
    yaw: float = 0.0,
    via: Sequence[Sequence[float]] = (),
    duration: float | None = None,
) -> TandemPlan:
    """Return the motion of a load along straight lines, without swing and without turning.

    Args:
        lift: The lift.
        start: Place of the centre of mass at the start in the frame of the site [m].
        goal: Its place at the end [m].
        yaw: Angle of the load's X axis from that of the site [rad]; the load is level.
        via: Places between them at which the load stands still for a moment [m]; none for one
            straight line. `cranedyn.lifts.tandem.way` finds those that lead over obstacles.
        duration: Duration of one straight line [s]; None for the shortest in which the drives keep
            their limits, as it is with `via`.

    Raises:
        OutOfRange: If a number is not finite, the duration is too short for the drives, or it is
            given beside `via`.
        CraneError: If a crane does not reach its lug, with the crane and the place.
    """
    begin = finite("start of the load", start, (3,), unit="m")
    end = finite("goal of the load", goal, (3,), unit="m")
    number("yaw of the load", yaw, "rad")
    points = finite("places between start and goal", np.reshape(via, (-1, 3)), ("k", 3), unit="m")
    if len(points):
        if duration is not None:
            allowed = "None where the way has places between start and goal"
            raise OutOfRange("duration of a tandem lift", f"{duration:g}", allowed, "s")
        corners = np.vstack([begin, points, end])
        legs = []
        for first, last in itertools.pairwise(corners):
            legs.append(plan_tandem(lift, first, last, yaw=yaw))
        return _one_after_another(legs)
    shortest = _shortest_duration(float(np.linalg.norm(end - begin)), lift.gravity)
    if duration is not None:
        number("duration of a tandem lift", duration, "s")
        if duration < shortest:
            lean = math.degrees(math.atan(_MAX_LEAN))
            allowed = f"{shortest:.4g} or more; with less the ropes would lean by over {lean:.1f}°"
            raise OutOfRange("duration of a tandem lift", f"{duration:g}", allowed, "s")
        trial = _motions(lift, begin, end, yaw, duration)
        if trial.excess > 1.0 + 1e-9:
            raise OutOfRange(
                "duration of a tandem lift",
                f"{duration:g}",
                f"longer: drives would exceed their limits {trial.excess:.3g} times",
                "s",
            )
        return _plan(lift, begin, end, yaw, duration, trial)
    seconds = shortest
    for _ in range(_ITERATIONS):
        trial = _motions(lift, begin, end, yaw, seconds)
        if trial.excess <= 1.0:
            return _plan(lift, begin, end, yaw, seconds, trial)
        # Rates go with 1/T and accelerations with 1/T², but that the lean of the ropes goes with
        # the accelerations, too; the last steps are therefore small.
        seconds *= max(trial.rate_excess, math.sqrt(trial.acceleration_excess), 1.001)
    raise CraneError("No duration was found in which the drives of both cranes keep their limits.")


def _one_after_another(legs: Sequence[TandemPlan]) -> TandemPlan:
    """Return several plans, each of which begins where the one before ends, as one."""
    first, *others = legs
    motions = list(first.drives)
    duration = first.duration
    t = [first.poses.t]
    for leg in others:
        motions = [motion.after(sooner) for motion, sooner in zip(leg.drives, motions, strict=True)]
        t.append(duration + leg.poses.t)
        duration += leg.duration
    poses = PlannedPoses(
        np.concatenate(t),
        np.concatenate([leg.poses.centres for leg in legs]),
        Rotation.concatenate([leg.poses.rotations for leg in legs]),
    )
    return first._replace(
        drives=TandemDrives(motions[0], motions[1]),
        goal=legs[-1].goal,
        duration=duration,
        largest_lean=max(leg.largest_lean for leg in legs),
        via=np.array([leg.start for leg in others]),
        poses=poses,
    )


def _shortest_duration(distance: float, gravity: float) -> float:
    """Return the duration [s] in which a load is moved by a distance [m] with no more than the
    acceleration of `_MAX_LEAN`, the shortest that is looked at.

    Args:
        distance: The distance [m].
        gravity: Gravity [m/s²].

    Raises:
        OutOfRange: If the load is not moved.
    """
    number("distance from start to goal", distance, "m", "> 0")
    largest = np.abs(_path_share().deriv(2)(np.linspace(0.0, 1.0, _ROWS))).max()
    return math.sqrt(float(largest) * distance / (_MAX_LEAN * gravity))


def _path_share() -> np.polynomial.Polynomial:
    """Return the share of the path over the share of the duration."""
    return np.polynomial.Polynomial([0.0] * 5 + _SMOOTH.tolist())


class _Motions(NamedTuple):
    """Motions of the drives of both cranes for a duration.

    Attributes:
        drives: The motions.
        rate_excess: Largest rate over its limit.
        acceleration_excess: Largest acceleration over its limit.
        largest_lean: Largest angle of the ropes from plumb [rad].
        poses: Where the load is.
    """

    drives: TandemDrives
    rate_excess: float
    acceleration_excess: float
    largest_lean: float
    poses: PlannedPoses

    @property
    def excess(self) -> float:
        """Largest rate or acceleration over its limit."""
        return max(self.rate_excess, self.acceleration_excess)


def _plan(
    lift: TandemLift,
    start: np.ndarray,
    goal: np.ndarray,
    yaw: float,
    duration: float,
    motions: _Motions,
) -> TandemPlan:
    """Return a plan of its parts."""
    return TandemPlan(
        lift=lift,
        drives=motions.drives,
        start=start,
        goal=goal,
        yaw=yaw,
        duration=duration,
        largest_lean=motions.largest_lean,
        via=np.zeros((0, 3)),
        poses=motions.poses,
    )


def _motions(
    lift: TandemLift, start: np.ndarray, goal: np.ndarray, yaw: float, duration: float
) -> _Motions:
    """Return the motions of the drives that move the load in a duration [s]."""
    share = np.linspace(0.0, 1.0, _ROWS)
    t = duration * share
    polynomial = _path_share()
    way = goal - start
    centre = start + polynomial(share)[:, None] * way
    acceleration = polynomial.deriv(2)(share)[:, None] * way / duration**2

    # Apparent gravity, against which both ropes pull.
    pull = acceleration + np.array([0.0, 0.0, lift.gravity])
    size = np.linalg.norm(pull, axis=1)
    direction = pull / size[:, None]
    lean = float(np.arccos(np.clip(direction[:, 2], -1.0, 1.0)).max())
    leaning = _leaning_lugs(lift.load, yaw, direction)

    motions = []
    rate_excess = 0.0
    acceleration_excess = 0.0
    for i, station in enumerate(lift.stations):
        tension = leaning.shares[:, i] * lift.load.mass * size
        lugs = centre + leaning.places[:, i]
        position = _drive_positions(station, lugs, direction, tension, lift.rope)
        spline = CubicSpline(t, position, bc_type="clamped")
        rate = spline(t, 1)
        motions.append(DriveMotion(t, position, rate))
        limits = lift.limits_of(i)
        rate_excess = max(rate_excess, float((np.abs(rate) / limits.rates).max()))
        ratio = np.abs(spline(t, 2)) / limits.accelerations
        acceleration_excess = max(acceleration_excess, float(ratio.max()))
    drives = TandemDrives(motions[0], motions[1])
    poses = PlannedPoses(t, centre, leaning.rotations)
    return _Motions(drives, rate_excess, acceleration_excess, lean, poses)


class _LeaningLugs(NamedTuple):
    """Lugs of a load that leans with its ropes across the line of the lugs.

    Attributes:
        places: Places from the centre of mass along the axes of the site [m], shape (rows, 2, 3).
        shares: Shares of the tension, shape (rows, 2).
        rotations: Rotations from the axes of the load to those of the site, one for each row.
    """

    places: np.ndarray
    shares: np.ndarray
    rotations: Rotation


def _leaning_lugs(load: TandemLoad, yaw: float, direction: np.ndarray) -> _LeaningLugs:
    """Return the lugs of a load whose ropes pull along unit vectors, shape (rows, 3)."""
    lugs = Rotation.from_euler("z", yaw).apply(np.array(load.lugs, dtype=float))
    line = lugs[1] - lugs[0]
    line[2] = 0.0
    line /= np.linalg.norm(line)
    along = direction @ line
    across = direction - along[:, None] * line
    # The load turns about the line of the lugs until its Z axis points along the pull across it.
    angle = np.arctan2(across @ np.cross([0.0, 0.0, 1.0], line), across[:, 2])
    turns = Rotation.from_rotvec(-angle[:, None] * line)
    places = np.stack([turns.apply(lug) for lug in lugs], axis=1)
    shares = np.array([static_shares(load, tilt) for tilt in np.arcsin(along)])
    return _LeaningLugs(places, shares, turns * Rotation.from_euler("z", yaw))


def _drive_positions(
    station: Station,
    lugs: np.ndarray,
    direction: np.ndarray,
    tension: np.ndarray,
    rope: TandemRope,
) -> np.ndarray:
    """Return positions of the drives of a crane, shape (rows, m), with which its rope goes from a
    lug to its pivot.

    Args:
        station: The crane.
        lugs: Places of the lug [m], shape (rows, 3).
        direction: Unit vectors from the lug towards the pivot, shape (rows, 3).
        tension: Tension of the rope [N], shape (rows,).
        rope: The rope, whose stretch its winch takes off.

    Raises:
        CraneError: If the crane does not reach a lug.
    """
    positions = []
    guess = None
    low, high = station.ranges
    winch = station.crane.winch
    for lug, upwards, pull in zip(lugs, direction, tension, strict=True):
        posture = _posture(station, lug, upwards, guess)
        guess = posture.drives
        distance = float(np.linalg.norm(posture.pivot - lug))
        row = guess.copy()
        row[winch] = distance / (1.0 + float(pull) / rope.stiffness)
        if not low[winch] <= row[winch] <= high[winch]:
            raise CraneError(
                f"{quoted(station.name)} needs {distance:.2f} m of rope to its lug at "
                f"{_place(lug)}; its hoist has {low[winch]:g} to {high[winch]:g} m."
            )
        positions.append(row)
    return np.array(positions)


class _Posture(NamedTuple):
    """A crane whose pivot is on the line of its rope.

    Attributes:
        drives: Positions of the drives, shape (m,).
        pivot: Place of the pivot in the frame of the site [m], shape (3,).
    """

    drives: np.ndarray
    pivot: np.ndarray


def _posture(
    station: Station, lug: np.ndarray, upwards: np.ndarray, guess: np.ndarray | None
) -> _Posture:
    """Return positions of the drives that bring the pivot of a crane onto the line from a lug.

    Args:
        station: The crane.
        lug: Place of the lug [m], shape (3,).
        upwards: Unit vector towards the pivot, shape (3,).
        guess: Positions near to them; None where there are none.

    Raises:
        CraneError: If the crane does not reach the lug.
    """
    chain = station.bodies.columns[:-1]
    low, high = station.ranges[:, chain]
    drives = station.crane.start.q[station.crane.layout.drives].copy()
    drives[chain] = _nearest_start(station, lug) if guess is None else guess[chain]
    # The line moves aside by this for each metre upwards.
    slope = upwards[:2] / upwards[2]
    for _ in range(_NEWTON_STEPS):
        q, _ = station.plumb(drives[None])
        rope = station.rope(q)
        pivot = rope.pivot[0]
        motion = rope.motion[0, chain]
        miss = pivot[:2] - lug[:2] - slope * (pivot[2] - lug[2])
        if np.linalg.norm(miss) < _PIVOT_ERROR:
            return _Posture(drives, pivot)
        # Newton's method on two coordinates of the pivot; the ranges stop it at the reach.
        jacobian = (motion[:, :2] - motion[:, 2:] * slope).T
        step = np.linalg.lstsq(jacobian, -miss, rcond=None)[0]
        drives[chain] = np.clip(drives[chain] + step, low, high)
    raise CraneError(
        f"{quoted(station.name)} does not reach its lug at {_place(lug)}: its rope would hang "
        f"{float(np.linalg.norm(miss)):.2f} m beside it."
    )


def _nearest_start(station: Station, lug: np.ndarray) -> np.ndarray:
    """Return positions of the drives that move the pivot, of a grid over their ranges, at which it
    is nearest to a lug in plan view.
    """
    chain = station.bodies.columns[:-1]
    low, high = station.ranges[:, chain]
    # A slew without end is searched over one turn.
    turns = np.array([station.crane.layout.driven[i].kind == "revolute" for i in chain])
    low = np.where(turns, np.maximum(low, -math.pi), low)
    high = np.where(turns, np.minimum(high, math.pi), high)
    axes = [np.linspace(a, b, _START_POINTS) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(chain))
    base = station.crane.start.q[station.crane.layout.drives]
    drives = np.tile(base, (len(grid), 1))
    drives[:, chain] = grid
    q, _ = station.plumb(drives)
    pivots = station.rope(q).pivot
    return grid[np.linalg.norm(pivots[:, :2] - lug[:2], axis=1).argmin()]


def _place(point: np.ndarray) -> str:
    """Return a place in the frame of the site in words."""
    return f"({', '.join(f'{value:.2f}' for value in point)}) m"
