"""Exercises for driving the crane in a page, each beside what a planned motion needs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.dynamics.pinocchio import payload_position, pivot_position
from cranedyn.errors import CraneError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning.lift import plan_lift
from cranedyn.planning.site import Site
from cranedyn.planning.solids import Solid, box
from cranedyn.references.limits import Limits
from cranedyn.references.motion import motion_efforts

SWING = math.radians(0.5)
"""Swing within which a load counts as still [rad]."""


@dataclass(frozen=True, eq=False)
class Best:
    """What the planned motion of an exercise needs.

    Attributes:
        time: Time [s].
        swing: Largest angle of the rope from plumb [rad].
        energy: Work that the drives put in [J]; what they take back does not count.
    """

    time: float
    swing: float
    energy: float


@dataclass(frozen=True, eq=False)
class Exercise:
    """An exercise with a tower crane.

    Attributes:
        name, title, text: Name, title, and what to do.
        start: State at the start.
        goal: Where the centre of the load is to be [m], shape (3,); None for anywhere.
        radius: Distance from there that is allowed [m].
        solids: Obstacles; none for those of the site.
        blind: Whether it is seen from the cabin only.
        best: What the planner needs; None if there is no plan.
    """

    name: str
    title: str
    text: str
    start: State
    goal: np.ndarray | None = None
    radius: float = 0.6
    solids: tuple[Solid, ...] = ()
    blind: bool = False
    best: Best | None = None


def exercises(crane: Crane, limits: Limits) -> Iterator[Exercise]:
    """Yield the exercises for a tower crane, within the limits of its drives where a motion is
    planned.
    """
    reach = float(crane.upper[crane.layout.role("trolley", "An exercise")])
    low = 0.2 * _height(crane)
    # the load swings as far
    near = 0.6 * reach
    far = 0.75 * reach
    aside = _height(crane) / 8.0
    start = _hanging(crane, 0.0, near, low)
    yield Exercise(
        "stop",
        "Stop the swing",
        "The load swings. Bring it to rest, anywhere.",
        crane.state(phi=0.12, theta=0.08),
    )
    goal = _point(1.4, far, 0.1 * _height(crane))
    yield _planned(
        crane,
        limits,
        Exercise("ring", "Land in the ring", "Hold the load still in the ring.", start, goal),
    )
    walls = tuple(
        _wall(name, 0.7, first, last, 0.8 * _height(crane))
        for name, first, last in (
            ("inner wall", 0.1 * reach, near - aside),
            ("outer wall", near + aside, 1.1 * reach),
        )
    )
    goal = _point(1.4, near, low)
    text = "Take the load through the gap between the walls."
    yield _planned(
        crane, limits, Exercise("gap", "Through the gap", text, start, goal, solids=walls)
    )
    house = (_wall("house", 1.0, near - 5.0, near + 5.0, 0.45 * _height(crane)),)
    text = "Set the load behind the house. The cabin is your only view: watch the shadow."
    yield _planned(
        crane,
        limits,
        Exercise("blind", "Blind behind the wall", text, start, goal, solids=house, blind=True),
    )


def lift_exercise(crane: Crane, limits: Limits, site: Site) -> Exercise | None:
    """Return the lift of a site as an exercise, its goal in the frame of the site; None if the site
    has none whose load hangs at the goal.
    """
    if site.start is None or site.goal is None or len(site.goal) == 2:
        return None
    text = f"Lift the load from start to goal of the site {site.name}."
    exercise = Exercise("lift", "The lift", text, crane.start, site.goal)
    return _planned(crane, limits, exercise, site)


def _height(crane: Crane) -> float:
    return float(pivot_position(crane, crane.start.q)[2])


def _point(slew: float, radius: float, height: float) -> np.ndarray:
    return np.array([radius * math.sin(slew), -radius * math.cos(slew), height])


def _hanging(crane: Crane, slew: float, radius: float, height: float) -> State:
    """Return the state at rest with the load at a height [m]."""
    above = float(payload_position(crane, crane.start.q)[2]) - height
    length = float(crane.start.q[crane.layout.role("hoist", "An exercise")]) + above
    return crane.state(gamma=slew, x=radius, l=length)


def _wall(name: str, slew: float, first: float, last: float, height: float) -> Solid:
    """Return a wall along the jib at a slew angle, from one radius to another, 2 m thick."""
    middle = _point(slew, (first + last) / 2.0, 0.0)[:2]
    size = (last - first, 2.0, height)
    return box(name, middle.tolist(), size, 0.0, slew - math.pi / 2.0)


def _planned(
    crane: Crane, limits: Limits, exercise: Exercise, site: Site | None = None
) -> Exercise:
    """Return an exercise with its start and what it needs by a planned lift, on a site of its own
    unless one is given; unchanged if there is no plan.
    """
    if site is None:
        start = payload_position(crane, exercise.start.q)
        site = Site(exercise.name, exercise.solids, start=start, goal=exercise.goal)
    try:
        motion = plan_lift(site, limits, crane=crane).timed.motion
    except CraneError:
        return exercise
    rates = motion.v[:, motion.drives]
    power = np.clip((motion_efforts(crane, motion) * rates).sum(axis=1), 0.0, None)
    swings = motion.q[:, crane.swings] - crane.rest.angle
    best = Best(
        motion.arrival,
        float(np.linalg.norm(swings, axis=1).max()),
        float(power.sum() * motion.period),
    )
    return replace(exercise, start=State(motion.q[0], motion.v[0]), best=best)
