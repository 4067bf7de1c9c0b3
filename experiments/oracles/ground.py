"""A box on the ground: how far it sinks, where friction holds it, how it slides, how it rebounds,
and where it leans on a platform that is turned.

The box is free in a plane and pushed at its centre, so that the law of contact is on its own.
Contacts act in steps of 0.5 ms at most, so a step here is a fortieth of the bench's.
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
from cranedyn.interfaces import EngineName
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.oracles.bench import MASS, Bench, G, Oracle

SHARE = 40
"""Step of the bench over a step of contacts."""

WIDTH, HEIGHT = 1.0, 2.0
"""Sides of the box in the plane [m]."""

FRICTION, SINK = 0.4, 0.002
"""Coefficient of friction and static sink [m]."""

HELD, PUSHED = 0.95, 1.2
"""Pushes over the largest friction: one that must not move the box, and one that must."""

LEAVES = 1e-6, "the end of contact between two steps"
"""Error of the rebound [m/s] that does not go with a power of the step: ½ ω² v dt²."""

DT, SETTLED, TILT = 5e-4, 2.0, 1e-4
"""Step of the runs in which the step does not show [s], time for which a push lasts [s], and tilts
from balance on an edge [rad]."""

SPEED, RESTITUTION, AFTER = 1.0, 0.5, 0.08
"""Speed of an impact [m/s], coefficient of restitution, and time from touching to the row that is
read, when the box is in the air again [s]."""


BUMPER, OFFSET = 0.8, 0.3
"""How far a point of the box is ahead of its centre, and aside of it [m]."""

PLATFORM = Platform((3.0, -0.2), (2.0, 4.0), 3.0, yaw=math.radians(30.0))
"""Stands ahead of the box, turned from X towards Y."""

LEANING = 2000.0
"""Force with which the box leans on it [N]."""


def free_box() -> Crane:
    """Return a box that is free in the plane of X and Z and pushed along X."""
    inertia = MASS * (WIDTH**2 + HEIGHT**2) / 12.0
    joints = [("x", "prismatic", "1 0 0"), ("z", "prismatic", "0 0 1"), ("p", "revolute", "0 1 0")]
    links = ["world", "carriage", "lift", "box"]
    chain = "".join(
        f'<link name="{parent}"/><joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{axis}"/>'
        '<limit lower="-100" upper="100" effort="1e9" velocity="100"/></joint>'
        for (name, kind, axis), parent, child in zip(joints, links[:-1], links[1:], strict=True)
    )
    moments = " ".join(f'i{axis}{axis}="{inertia}"' for axis in "xyz")
    body = f'<mass value="{MASS}"/><inertia {moments} ixy="0" ixz="0" iyz="0"/>'
    urdf = f'<robot name="box">{chain}<link name="box"><inertial>{body}</inertial></link></robot>'
    record = {"urdf": urdf, "gravity": G, "joints": {}, "driven": ["x"], "payload": "p"}
    return load_crane(from_record={"crane": {**record, "check_axes": False}})


@cache
def push(
    crane: Crane,
    force: float,
    duration: float,
    dt: float,
    engine: EngineName,
    restitution: float = 0.1,
    ground: Ground | None = None,
    **start: float,
) -> Trajectory:
    """Return a run of the box under a force along X [N], from rest on the ground unless its start
    is given by its coordinates. The ground is level and bare unless it is given.
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
        engine=engine,
        ground=ground,
        validity="mark",
    )


def box_on_ground(bench: Bench) -> list[Oracle]:
    """Return the oracles of a box on the ground."""
    crane = free_box()
    cone = FRICTION * MASS * G

    def sink(dt: float) -> float:
        return HEIGHT / 2.0 - float(push(crane, 0.0, 0.2, DT, bench.engine)["z_m"][-1])

    def creep(dt: float) -> float:
        return float(push(crane, HELD * cone, SETTLED, DT, bench.engine)["x_dot_m_s"][-1])

    def slide(dt: float) -> float:
        run = push(crane, PUSHED * cone, SETTLED, DT, bench.engine)
        row = len(run.t) * 3 // 4
        return float((run["x_dot_m_s"][-1] - run["x_dot_m_s"][row]) / (run.t[-1] - run.t[row]))

    def balance(dt: float) -> float:
        """Return the tilt at which the box stands still on its edge, by two runs [rad]."""
        tilts = math.atan(WIDTH / HEIGHT) + TILT * np.array([-1.0, 1.0])
        first, second = (_tipping(crane, tilt, bench.engine) for tilt in tilts.tolist())
        return float(tilts[0] - first * (tilts[1] - tilts[0]) / (second - first))

    def rebound(dt: float) -> float:
        run = push(
            crane, 0.0, AFTER, dt / SHARE, bench.engine, RESTITUTION, z=HEIGHT / 2.0, z_dot=-SPEED
        )
        return math.sqrt(2.0 * (run.energy[-1] / MASS - G * HEIGHT / 2.0))

    def lean(dt: float) -> float:
        points = (*box_corners(WIDTH, WIDTH, HEIGHT), (BUMPER, OFFSET, 0.0))
        smooth_ground = Ground(points, (PLATFORM,), friction=0.0, sink=SINK)
        near = _leaning_place() - 0.005
        run = push(crane, LEANING, SETTLED, DT, bench.engine, ground=smooth_ground, x=near)
        return float(run["x_m"][-1])

    return [
        Oracle("static sink", "m", SINK, sink),
        Oracle(f"creeps under {HELD:g} of the largest friction", "m/s", 0.0, creep),
        Oracle(f"slides under {PUSHED:g} of it", "m/s²", (PUSHED - 1.0) * FRICTION * G, slide),
        Oracle("balances on its edge, tan b/h", "rad", math.atan(WIDTH / HEIGHT), balance, TILT**2),
        Oracle(f"rebounds from {SPEED:g} m/s", "m/s", _rebound_speed(), rebound, *LEAVES),
        Oracle("leans on a platform turned by 30°", "m", _leaning_place(), lean),
    ]


def _leaning_place() -> float:
    """Return where the box leans on the platform [m]. By trigonometry, the side that faces it
    crosses the line of its bumper half the platform over the cosine ahead of the middle, and by
    the tangent nearer for what the bumper is aside of it. There the normal force carries the push
    by its cosine, and the bumper is in the side by that force over the stiffness of a point, m g
    over four sinks; along the push that is over the cosine once more.
    """
    x, y = PLATFORM.centre
    cosine = math.cos(math.pi / 6.0)
    tangent = math.tan(math.pi / 6.0)
    side = x - 0.5 * PLATFORM.size[0] / cosine - (OFFSET - y) * tangent
    stiffness = MASS * G / (4.0 * SINK)
    return side - BUMPER + LEANING / (stiffness * cosine**2)


def _tipping(crane: Crane, tilt: float, engine: EngineName) -> float:
    """Return the rate of tipping of a box soon after it is released on its edge [rad/s]."""
    above = 0.5 * (WIDTH * math.sin(tilt) + HEIGHT * math.cos(tilt))
    run = push(crane, 0.0, 0.02, DT, engine, z=above - 2.0 * SINK, p=tilt)
    return float(run["p_dot_rad_s"][-1])


def _rebound_speed() -> float:
    """Return the speed of the box after the impact, where it touched first [m/s]: the motion on
    spring, damper and gravity up to where they no longer push.
    """
    omega = math.sqrt(G / SINK)
    ratio = _impact_ratio(RESTITUTION)

    def push_off(t: float, state: np.ndarray) -> float:
        return float(omega**2 * state[0] + 2.0 * ratio * omega * state[1])

    def motion(t: float, state: np.ndarray) -> list[float]:
        return [state[1], G - push_off(t, state)]

    push_off.terminal, push_off.direction = True, -1.0  # type: ignore[attr-defined]
    impact = solve_ivp(motion, (0.0, 1.0), [0.0, SPEED], events=push_off, rtol=1e-12, atol=1e-14)
    depth, rate = impact.y[:, -1]
    return math.sqrt(rate**2 - 2.0 * G * depth)


def _impact_ratio(restitution: float) -> float:
    """Return the damping ratio at which a point that hits spring and damper without gravity leaves
    them at a share of its speed, by integration up to where they no longer push.
    """

    def excess(ratio: float) -> float:
        def push_off(t: float, state: np.ndarray) -> float:
            return float(state[0] + 2.0 * ratio * state[1])

        def motion(t: float, state: np.ndarray) -> list[float]:
            return [state[1], -push_off(t, state)]

        push_off.terminal, push_off.direction = True, -1.0  # type: ignore[attr-defined]
        impact = solve_ivp(motion, (0.0, 9.0), [0.0, 1.0], events=push_off, rtol=1e-12, atol=1e-14)
        return -float(impact.y[1, -1]) - restitution

    return float(brentq(excess, 0.01, 2.0, xtol=1e-13))
