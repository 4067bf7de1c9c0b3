"""Exercises for driving the crane in a page, each beside what a planned motion needs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.dynamics.equations_of_motion import payload_position, pivot_position
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.lifts.planning.lift import plan_lift
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import Solid, box
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.motion import motion_efforts

SWING = math.radians(0.5)
"""Swing within which a load counts as still [rad]."""

GOAL_SLEW = 1.4
"""Slew angle of the goals [rad]; the start is at 0."""

STOP_TEXT = "The load swings. Bring it to rest, anywhere."
"""What the operator has to do where the load swings at the start."""

RING_TEXT = "Bring the load to rest in the green ring."
"""What the operator has to do where there is a goal and nothing else."""

WALL_THICKNESS = 2.0
"""Thickness of a wall [m]."""

INNER_WALL_RATIO = 0.15
"""Share of the reach at which the wall next to the mast begins: nearer, the foot of the mast would
stand in it."""

FIRST_SWINGS = (0.12, 0.08)
"""Angles from rest at which the first two swing joints begin, where the load swings at first [rad].
"""

RADIUS = 0.6
"""Allowed distance from a goal [m]."""

RADIUS_RATIO = 0.1
"""The same as a share of the length of the rope, for small cranes."""

TRAVEL_RATIO = 0.25
"""Share of the range of a drive between start and goal, for a crane that is no tower crane."""

MAX_TRAVEL = {"prismatic": 10.0, "revolute": 1.0}
"""The most that a drive of a kind moves on this way [m or rad]: ranges may be long, or endless."""


@dataclass(frozen=True, eq=False)
class Best:
    """Score of the planned motion of an exercise, with which an operator compares.

    Attributes:
        time: Time until the load has arrived [s].
        swing: Largest angle of the rope from plumb [rad].
        energy: Work that the drives do [J]; what they take back while they brake is not subtracted.
    """

    time: float
    swing: float
    energy: float


@dataclass(frozen=True, eq=False)
class Exercise:
    """An exercise with a tower crane.

    Attributes:
        name: Short name, by which the page and its worker refer to it.
        title: Title for the operator.
        text: What the operator has to do.
        start: State at the start.
        goal: Place at which the centre of the load is to come to rest [m], shape (3,); None for
            anywhere.
        radius: Allowed distance from the goal [m].
        solids: Obstacles of the exercise; empty where those of the site are the obstacles.
        blind: Whether the operator sees it from the cabin only.
        best: Score of the planned motion; None if there is none.
        no_best: Why an exercise that is planned has no score, for the operator; else empty.
    """

    name: str
    title: str
    text: str
    start: State
    goal: np.ndarray | None = None
    radius: float = RADIUS
    solids: tuple[Solid, ...] = ()
    blind: bool = False
    best: Best | None = None
    no_best: str = ""


def exercises(crane: Crane, limits: Limits) -> Iterator[Exercise]:
    """Yield the exercises for a tower crane.

    Places are shares of the reach of the jib and of the height of the pivot, so that they fit any
    tower crane.

    Args:
        crane: The crane.
        limits: Limits of its drives, within which motions are planned.
    """
    reach = float(crane.upper[crane.layout.role("trolley", "An exercise")])
    height = _height(crane)
    low = 0.2 * height
    near = 0.6 * reach
    far = 0.75 * reach
    start = _hanging(crane, 0.0, near, low)
    yield Exercise(
        name="stop",
        title="Stop the swing",
        text=STOP_TEXT,
        start=_swinging(crane),
    )

    ring = Exercise(
        name="ring",
        title="Land in the ring",
        text=RING_TEXT,
        start=start,
        goal=_point(GOAL_SLEW, far, 0.1 * height),
    )
    yield _planned(crane, limits, ring)

    # The gap is in the middle of the way, at half of the slew angle of the goal, around the radius
    # of start and goal.
    half_width = height / 8.0
    walls = (
        _wall("inner wall", 0.7, INNER_WALL_RATIO * reach, near - half_width, 0.8 * height),
        _wall("outer wall", 0.7, near + half_width, 1.1 * reach, 0.8 * height),
    )
    gap = Exercise(
        name="gap",
        title="Through the gap",
        text="Go through the gap between the walls, and bring the load to rest in the green ring.",
        start=start,
        goal=_point(GOAL_SLEW, near, low),
        solids=walls,
    )
    yield _planned(crane, limits, gap)

    house = _wall("house", 1.0, near - 5.0, near + 5.0, 0.45 * height)
    blind = Exercise(
        name="blind",
        title="Blind behind the wall",
        text="Bring the load to rest in the ring behind the house. The cabin is your only view: "
        "watch the shadow.",
        start=start,
        goal=_point(GOAL_SLEW, near, low),
        solids=(house,),
        blind=True,
    )
    yield _planned(crane, limits, blind)


def simple_exercises(crane: Crane) -> Iterator[Exercise]:
    """Yield the exercises for a crane that is no tower crane: to stop the swing, and to bring the
    load into a ring that all drives but the hoist have to move for. There is no planner for such a
    crane, so they have no score.

    There are none for a mechanism whose load does not hang from a swing joint, and no ring where it
    would be below the ground.
    """
    if not crane.rest.hangs or not len(crane.swings):
        return
    yield Exercise(name="stop", title="Stop the swing", text=STOP_TEXT, start=_swinging(crane))

    goal = payload_position(crane, _travelled(crane))
    start = payload_position(crane, crane.start.q)
    rope = float(np.linalg.norm(pivot_position(crane, crane.start.q) - start))
    radius = min(RADIUS, RADIUS_RATIO * rope)
    # A crane whose drives only hoist has nowhere to go.
    if goal[2] > radius and float(np.linalg.norm(goal - start)) > radius:
        yield Exercise(
            name="ring",
            title="Land in the ring",
            text=RING_TEXT,
            start=crane.start,
            goal=goal,
            radius=radius,
        )


def lift_exercise(crane: Crane, limits: Limits, site: Site) -> Exercise | None:
    """Return the lift of a site as an exercise, with its goal in the frame of the site.

    None if the site has no start or no goal, or a goal of two coordinates: there the load is set
    down on the ground, and does not hang.
    """
    if site.start is None or site.goal is None or len(site.goal) == 2:
        return None
    text = f"Lift the load to the green ring, the goal of the site {site.name}."
    exercise = Exercise("lift", "The lift", text, crane.start, site.goal)
    return _planned(crane, limits, exercise, site)


def _swinging(crane: Crane) -> State:
    """Return the start with the load aside by `FIRST_SWINGS`, where the ranges of its joints allow
    that.
    """
    q = crane.start.q.copy()
    for joint, angle in zip(crane.swings, FIRST_SWINGS, strict=False):
        q[joint] = np.clip(q[joint] + angle, crane.lower[joint], crane.upper[joint])
    return State(q, np.zeros_like(q))


def _travelled(crane: Crane) -> np.ndarray:
    """Return the coordinates at rest, shape (n,), after all drives but those that only hoist have
    moved from the start towards the farther end of their ranges.
    """
    q = crane.start.q.copy()
    for joint in crane.layout.drives:
        if _hoists(crane, joint):
            continue
        low = crane.lower[joint]
        high = crane.upper[joint]
        travel = min(TRAVEL_RATIO * (high - low), MAX_TRAVEL[crane.layout.joints[joint].kind])
        q[joint] += travel if high - q[joint] >= q[joint] - low else -travel
    return crane.resting(q)


def _hoists(crane: Crane, joint: int) -> bool:
    """Return whether a drive moves the load up and down only, at the start."""
    q = crane.start.q.copy()
    before = payload_position(crane, q)
    # A step of a millimetre or milliradian, inwards where the drive stands at its upper end.
    step = 1e-3 if q[joint] + 1e-3 <= crane.upper[joint] else -1e-3
    q[joint] += step
    moved = payload_position(crane, q) - before
    return bool(np.linalg.norm(moved[:2]) < 1e-3 * np.linalg.norm(moved))


def _height(crane: Crane) -> float:
    """Return the height of the pivot at the start [m]."""
    return float(pivot_position(crane, crane.start.q)[2])


def _point(slew: float, radius: float, height: float) -> np.ndarray:
    """Return a point below the jib [m], shape (3,). At slew angle 0 the jib points along -Y.

    Args:
        slew: Slew angle [rad].
        radius: Distance from the slew axis [m].
        height: Height above the ground [m].
    """
    return np.array([radius * math.sin(slew), -radius * math.cos(slew), height])


def _hanging(crane: Crane, slew: float, radius: float, height: float) -> State:
    """Return the state at rest with the load at a slew angle [rad], a radius and a height [m]."""
    lowered = float(payload_position(crane, crane.start.q)[2]) - height
    length = float(crane.start.q[crane.layout.role("hoist", "An exercise")]) + lowered
    return crane.state(gamma=slew, x=radius, l=length)


def _wall(name: str, slew: float, first: float, last: float, height: float) -> Solid:
    """Return a wall that stands along the jib.

    Args:
        name: Its name.
        slew: Slew angle at which the jib is above it [rad].
        first: Radius at which it begins [m].
        last: Radius at which it ends [m].
        height: Its height [m].
    """
    middle = _point(slew, (first + last) / 2.0, 0.0)[:2]
    size = (last - first, WALL_THICKNESS, height)
    return box(name, middle.tolist(), size, 0.0, slew - math.pi / 2.0)


def _planned(
    crane: Crane, limits: Limits, exercise: Exercise, site: Site | None = None
) -> Exercise:
    """Return an exercise with the start and the score of a planned lift.

    Args:
        crane: The crane.
        limits: Limits of its drives.
        exercise: The exercise; if no lift can be planned, it is returned with the reason.
        site: Site of the lift; None for one with the obstacles, start and goal of the exercise.
    """
    if site is None:
        start = payload_position(crane, exercise.start.q)
        site = Site(exercise.name, exercise.solids, start=start, goal=exercise.goal)
    try:
        motion = plan_lift(site, limits, crane=crane).timed.motion
    except CraneError as error:
        return replace(exercise, no_best=str(error))
    rates = motion.v[:, motion.drives]
    power = (motion_efforts(crane, motion) * rates).sum(axis=1)
    power_put_in = np.clip(power, 0.0, None)
    swings = crane.swing_angles(motion.q)
    best = Best(
        time=motion.arrival,
        swing=float(np.linalg.norm(swings, axis=1).max()),
        energy=float(power_put_in.sum() * motion.period),
    )
    return replace(exercise, start=State(motion.q[0], motion.v[0]), best=best)
