"""A box on the ground: how far it sinks, where friction holds it, how it slides, how it rebounds,
and where it leans on a platform that is turned.

The box is free in a plane and pushed at its centre, so that nothing but the law of contact acts.
Contacts need steps of 0.5 ms at most, so that a step here is a fortieth of the bench's.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from cranedyn.controllers import Hold
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, Platform, box_corners
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.validate.bench import MASS, Bench, G
from experiments.validate.oracle import Oracle

SUBSTEPS = 40
"""Step of the bench over a step of contacts."""

DT = 5e-4
"""Step of the runs whose end is a state of rest, so that the step does not show in it [s]."""

WIDTH = 1.0
"""Width of the box in the plane of its motion [m]."""

HEIGHT = 2.0
"""Height of the box [m]."""

FRICTION = 0.4
"""Coefficient of friction."""

SINK = 0.002
"""Depth by which the box sinks into the ground under its weight [m]."""

HOLDING_RATIO = 0.95
"""Push over the largest friction that must not move the box."""

SLIDING_RATIO = 1.2
"""Push over the largest friction under which the box must slide."""

PUSH_TIME = 2.0
"""Time for which a push lasts [s]."""

TILT = 1e-4
"""Tilt to either side of balance on an edge from which the box is released [rad]."""

IMPACT_SPEED = 1.0
"""Speed of an impact [m/s]."""

RESTITUTION = 0.5
"""Coefficient of restitution of this impact."""

REBOUND_TIME = 0.08
"""Time from touching to the row that is read [s]; the box is in the air again."""

REBOUND_ERROR = 1e-6
"""Error of the rebound that does not go with a power of the step [m/s].

Contact ends within a step. Up to the end of it the force is off by as much as ω² v dt, over a time
of dt: ½ ω² v dt².
"""

REBOUND_REASON = "the end of contact between two steps"
"""The reason that is stated for this error, see `Oracle.reason`."""

BUMPER_AHEAD = 0.8
"""Distance by which a point of the box, the bumper, is ahead of its centre [m]."""

BUMPER_ASIDE = 0.3
"""Distance by which the bumper is aside of the centre [m]."""

PLATFORM = Platform((3.0, -0.2), (2.0, 4.0), 3.0, yaw=math.radians(30.0))
"""A platform ahead of the box, turned from X towards Y."""

LEANING_FORCE = 2000.0
"""Force with which the box leans on the platform [N]."""


def free_box() -> Crane:
    """Return a box that is free in the plane of X and Z, and pushed along X.

    It is a chain of three joints without mass before the box: two that shift and one that tips it.
    """
    inertia = MASS * (WIDTH**2 + HEIGHT**2) / 12.0
    chain = ""
    for name, kind, axis, parent, child in (
        ("x", "prismatic", "1 0 0", "world", "carriage"),
        ("z", "prismatic", "0 0 1", "carriage", "lift"),
        ("p", "revolute", "0 1 0", "lift", "box"),
    ):
        chain += (
            f'<link name="{parent}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><axis xyz="{axis}"/>'
            '<limit lower="-100" upper="100" effort="1e9" velocity="100"/></joint>'
        )
    moments = " ".join(f'i{axis}{axis}="{inertia}"' for axis in "xyz")
    body = f'<mass value="{MASS}"/><inertia {moments} ixy="0" ixz="0" iyz="0"/>'
    urdf = f'<robot name="box">{chain}<link name="box"><inertial>{body}</inertial></link></robot>'
    record = {
        "urdf": urdf,
        "gravity": G,
        "joints": {},
        "driven": ["x"],
        "payload": "p",
        # These joints are none of a crane.
        "check_axes": False,
    }
    return load_crane(from_record={"crane": record})


@cache
def push(
    crane: Crane,
    force: float,
    duration: float,
    dt: float,
    restitution: float = 0.1,
    ground: Ground | None = None,
    **start: float,
) -> Trajectory:
    """Return a run of the box under a constant force.

    Args:
        crane: The box, see `free_box`.
        force: Force along X [N].
        duration: Duration [s].
        dt: Step [s].
        restitution: Coefficient of restitution of a ground that is not given.
        ground: Ground; level and bare if it is None.
        **start: Coordinates at the start; at rest on the ground unless they are given.
    """
    if ground is None:
        ground = Ground(box_corners(WIDTH, WIDTH, HEIGHT), (), FRICTION, restitution, SINK)
    return simulate(
        crane,
        Hold(crane, np.zeros(1), np.zeros(1), np.array([force])),
        start=crane.state(**{"z": HEIGHT / 2.0 - SINK} | start),
        duration=duration,
        dt=dt,
        control_period=2 * dt,
        ground=ground,
        validity="mark",
    )


def oracles(bench: Bench) -> list[Oracle]:
    """Return the oracles of a box on the ground."""
    crane = free_box()
    largest_friction = FRICTION * MASS * G

    def sink(dt: float) -> float:
        return HEIGHT / 2.0 - float(push(crane, 0.0, 0.2, DT)["z_m"][-1])

    def creep(dt: float) -> float:
        run = push(crane, HOLDING_RATIO * largest_friction, PUSH_TIME, DT)
        return float(run["x_dot_m_s"][-1])

    def slide(dt: float) -> float:
        run = push(crane, SLIDING_RATIO * largest_friction, PUSH_TIME, DT)
        # Over the last quarter, after the box has settled.
        row = len(run.t) * 3 // 4
        rate = run["x_dot_m_s"]
        return float((rate[-1] - rate[row]) / (run.t[-1] - run.t[row]))

    def balance(dt: float) -> float:
        """Return the tilt at which the box stands still on its edge [rad].

        On either side of it the box begins to tip; between the two rates is zero.
        """
        low = math.atan(WIDTH / HEIGHT) - TILT
        high = math.atan(WIDTH / HEIGHT) + TILT
        low_rate = _tipping_rate(crane, low)
        high_rate = _tipping_rate(crane, high)
        return float(low - low_rate * (high - low) / (high_rate - low_rate))

    def rebound(dt: float) -> float:
        run = push(
            crane,
            0.0,
            REBOUND_TIME,
            dt / SUBSTEPS,
            RESTITUTION,
            z=HEIGHT / 2.0,
            z_dot=-IMPACT_SPEED,
        )
        # In the air the energy stays: it tells the speed at the height where the box touched.
        return math.sqrt(2.0 * (run.energy[-1] / MASS - G * HEIGHT / 2.0))

    def lean(dt: float) -> float:
        points = (*box_corners(WIDTH, WIDTH, HEIGHT), (BUMPER_AHEAD, BUMPER_ASIDE, 0.0))
        smooth_ground = Ground(points, (PLATFORM,), friction=0.0, sink=SINK)
        near = _leaning_place() - 0.005
        run = push(crane, LEANING_FORCE, PUSH_TIME, DT, ground=smooth_ground, x=near)
        return float(run["x_m"][-1])

    slides = (SLIDING_RATIO - 1.0) * FRICTION * G
    return [
        Oracle("static sink", "m", SINK, sink),
        Oracle(f"creeps under {HOLDING_RATIO:g} of the largest friction", "m/s", 0.0, creep),
        Oracle(f"slides under {SLIDING_RATIO:g} of it", "m/s²", slides, slide),
        Oracle("balances on its edge, tan b/h", "rad", math.atan(WIDTH / HEIGHT), balance, TILT**2),
        Oracle(
            f"rebounds from {IMPACT_SPEED:g} m/s",
            "m/s",
            _rebound_speed(),
            rebound,
            REBOUND_ERROR,
            REBOUND_REASON,
        ),
        Oracle("leans on a platform turned by 30°", "m", _leaning_place(), lean),
    ]


def _leaning_place() -> float:
    """Return where the centre of the box is while it leans on the platform [m]."""
    x, y = PLATFORM.centre
    yaw = math.pi / 6.0
    cosine = math.cos(yaw)
    # The side of the platform that faces the box is half the platform ahead of its middle, at a
    # right angle to the side: over the cosine along X. The bumper meets it farther aside, and by
    # the tangent nearer.
    side = x - 0.5 * PLATFORM.size[0] / cosine - (BUMPER_ASIDE - y) * math.tan(yaw)
    # Without friction the force of the side is normal to it. Its component along X, by the cosine,
    # carries the push, so the force is the push over the cosine. It presses the bumper into the
    # side by its own size over the stiffness; along X that is over the cosine once more.
    # Four corners of the box carry its weight at the static sink.
    stiffness = MASS * G / (4.0 * SINK)
    return side - BUMPER_AHEAD + LEANING_FORCE / (stiffness * cosine**2)


def _tipping_rate(crane: Crane, tilt: float) -> float:
    """Return the rate of tipping of a box soon after it is released on its edge [rad/s]."""
    # One edge carries all the weight, by two of the four corners: it sinks twice as far.
    above = 0.5 * (WIDTH * math.sin(tilt) + HEIGHT * math.cos(tilt))
    run = push(crane, 0.0, 0.02, DT, z=above - 2.0 * SINK, p=tilt)
    return float(run["p_dot_rad_s"][-1])


def _rebound_speed() -> float:
    """Return the speed of the box after the impact, at the height where it touched first [m/s].

    It moves on the spring and damper of the contact under gravity, integrated up to where these no
    longer push; from there it is in free flight.
    """
    # The weight makes the static sink: k SINK = m g, and ω² = k/m.
    omega = math.sqrt(G / SINK)
    ratio = _impact_ratio(RESTITUTION)

    def push_off(t: float, state: np.ndarray) -> float:
        """Return the force of the contact over the mass [m/s²], from depth and its rate."""
        return float(omega**2 * state[0] + 2.0 * ratio * omega * state[1])

    def motion(t: float, state: np.ndarray) -> list[float]:
        return [state[1], G - push_off(t, state)]

    push_off.terminal = True  # type: ignore[attr-defined]
    push_off.direction = -1.0  # type: ignore[attr-defined]
    impact = solve_ivp(
        motion, (0.0, 1.0), [0.0, IMPACT_SPEED], events=push_off, rtol=1e-12, atol=1e-14
    )
    depth, rate = impact.y[:, -1]
    return math.sqrt(rate**2 - 2.0 * G * depth)


def _impact_ratio(restitution: float) -> float:
    """Return the damping ratio of a contact from its coefficient of restitution.

    A point that hits a spring and damper without gravity leaves them, where they no longer push, at
    the coefficient times its speed. The motion is integrated in units in which ω, mass and speed
    are 1.
    """

    def excess(ratio: float) -> float:
        """Return the share of the speed at which the point leaves, less the coefficient."""

        def push_off(t: float, state: np.ndarray) -> float:
            return float(state[0] + 2.0 * ratio * state[1])

        def motion(t: float, state: np.ndarray) -> list[float]:
            return [state[1], -push_off(t, state)]

        push_off.terminal = True  # type: ignore[attr-defined]
        push_off.direction = -1.0  # type: ignore[attr-defined]
        impact = solve_ivp(motion, (0.0, 9.0), [0.0, 1.0], events=push_off, rtol=1e-12, atol=1e-14)
        return -float(impact.y[1, -1]) - restitution

    return float(brentq(excess, 0.01, 2.0, xtol=1e-13))
