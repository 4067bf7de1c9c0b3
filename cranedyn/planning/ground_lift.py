"""Lift from the ground to the ground: lift-off before a planned lift, and set-down after it.

The controller is made for the crane of the plan, whose load hangs on a rigid rope. It is given the
coordinates of that crane: direction and distance of the load from its pivot. While the rope does
not carry the load, it is given no swing, and the hoist exerts only the tension that there is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import Ground, Platform, box_corners, box_load, standing
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import payload_position, point_velocities
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Controller, EngineName, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.certificate import Check
from cranedyn.planning.clearance import GROUND
from cranedyn.planning.lift import Lift
from cranedyn.references.flat import cruise
from cranedyn.references.motion import Motion
from cranedyn.simulation.simulate import simulate

SLACK, PAUSE = 0.05, 2.0
"""Slack of the rope of a load that stands [m], and pause between phases [s]."""

HANGS, PULL, OFF, STILL = 0.9, 1.1, 0.01, 1e-3
"""Tension over the weight from which on a load hangs, the largest at lift-off, and the largest
distance from the goal [m] and speed of the load at the end [m/s]."""

_SLOWLY = 0.02
"""Acceleration of the hoist at lift-off and set-down [m/s²]."""

_DAMPING = {"rope_damping": 2e4, "damp_sling": 300.0}


@dataclass(frozen=True, eq=False)
class GroundLift:
    """A lift from the ground to the ground: run it by `certify_ground_lift`.

    Attributes:
        lift: The planned lift, whose start and goal hang above their supports.
        crane: Its crane with a rope that stretches and the load on its lug.
        ground: Ground and platforms.
        motion: Motion of the crane of the plan.
        controller: Controller of the crane of the plan.
        phases: Time at which each phase begins [s], by name.
    """

    lift: Lift
    crane: Crane
    ground: Ground
    motion: Motion
    controller: Controller
    phases: Mapping[str, float]

    def setpoint(self, t: float) -> Setpoint:
        """Return the setpoint of the drives at a time [s]."""
        position, velocity, acceleration = self.motion(t)
        return Setpoint(position - [0.0, 0.0, _lug(self.crane)], velocity, acceleration)

    def start(self) -> State:
        """Return the state in which the load stands at the start."""
        return _standing(self.crane, self.ground, self.setpoint(0.0).position)

    def command(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts of the drives [N m or N], shape (3,)."""
        crane, weight = self.crane, self.crane.payload_mass * self.crane.gravity
        tension = float(JointForces.of(crane).tension(*state))
        hangs = tension > HANGS * weight
        effort = np.array(self.controller(t, self.seen(state, hangs=hangs), self.motion(t)))
        effort[2] += 0.0 if hangs else weight - tension
        return effort

    def seen(self, state: State, *, hangs: bool = True) -> State:
        """Return the state of the crane of the plan."""
        swing, hoist = self.crane.layout.at("phi", "theta"), self.crane.layout.index("l")
        sling = self.crane.layout.at("sling_radial", "sling_tangential")
        length = state.q[hoist] + _lug(self.crane)
        share = _lug(self.crane) / length
        q, v = (
            np.array([*z[:2], *(hangs * (z[swing] + share * z[sling])), z[hoist]]) for z in state
        )
        return State(np.array([*q[:4], length]), v)


def from_ground(
    lift: Lift,
    *,
    rope_stiffness: float = 2e7,
    creep: float = 0.1,
    sink_rate: float = 0.1,
    platforms: tuple[Platform, ...] = (),
) -> GroundLift:
    """Return a lift that begins on the support below its start and ends on that below its goal.

    Args:
        lift: The planned lift; its load is a box.
        rope_stiffness: EA of the rope [N].
        creep: Largest hoisting speed of the lift-off [m/s].
        sink_rate: Largest speed of the set-down [m/s].
        platforms: Platforms in the frame of the crane.

    Raises:
        OutOfRange: If a number is not positive, or the ground is not as high as the crane's foot.
    """
    site, planned = lift.clearance.site, lift.timed.motion
    if site.ground != site.foot[2]:
        raise OutOfRange("height of the ground", site.ground, "that of the foot of the crane", "m")
    sides = np.ptp(lift.clearance.bodies.load, axis=0).tolist()
    values = {**site.crane, **box_load(lift.crane.payload_mass, *sides), **_DAMPING}
    values |= {"rope_stiffness": rope_stiffness, "hoist_max": lift.clearance.height}
    crane = load_crane(gravity=lift.crane.gravity, values=values)
    ground = Ground(box_corners(*sides), platforms)

    def lowered(place: int, name: str, speed: float) -> np.ndarray:
        """Return q, v and a of a set-down and a pause after it, shape (3, rows, 5)."""
        rows = np.zeros((3, 1, 5)) + np.stack([planned.q[place], *np.zeros((2, 5))])[:, None]
        drives = planned.q[place, planned.drives] - [0.0, 0.0, _lug(crane)]
        standing_q = _standing(crane, ground, drives).q
        way = SLACK + standing_q[crane.layout.index("rope_stretch")]
        ramp = max(1.0, number(name, speed, "m/s", "> 0") / _SLOWLY)
        duration = planned.period * math.ceil((way / speed + ramp) / planned.period)
        t = np.arange(0.0, duration + PAUSE, planned.period)
        rows = np.repeat(rows, len(t), axis=1)
        for order in range(3):
            rows[order, :, planned.drives[2]] += way * cruise(t, duration, ramp, order)
        return rows

    raised = lowered(0, "creep speed", creep)[:, ::-1] * np.array([1.0, -1.0, 1.0])[:, None, None]
    pieces = {
        "lift-off": raised,
        "pause": np.repeat(raised[:, -1:], round(PAUSE / planned.period), axis=1),
        "motion": np.stack([planned.q, planned.v, planned.a]),
        "set-down": lowered(-1, "sink rate", sink_rate),
    }
    starts = planned.period * np.cumsum([0, *(piece.shape[1] for piece in pieces.values())])
    rows = np.concatenate([*pieces.values()], axis=1)
    motion = Motion(planned.period, rows[0], rows[1], rows[2], planned.drives)
    phases = dict(zip(pieces, starts.tolist(), strict=False))
    return GroundLift(lift, crane, ground, motion, lqr(lift.crane, motion), phases)


class GroundCertificate(NamedTuple):
    """A simulated lift from the ground to the ground, and its checks.

    Attributes:
        lift: The lift.
        run: The run.
        pull: Tension of the rope over the weight at each row, shape (rows,).
        checks: All requirements.
    """

    lift: GroundLift
    run: Trajectory
    pull: np.ndarray
    checks: tuple[Check, ...]

    @property
    def holds(self) -> bool:
        """Whether all checks hold."""
        return all(check.holds for check in self.checks)


def certify_ground_lift(
    lift: GroundLift, *, start: State | None = None, engine: EngineName = "compiled"
) -> GroundCertificate:
    """Simulate a lift from the ground to the ground, and check each phase.

    Args:
        lift: The lift.
        start: State at the start; None for that of the lift.
        engine: Engine that computes a step.

    Raises:
        RunError: If the simulation breaks off.
    """
    crane, clearance, period = lift.crane, lift.lift.clearance, lift.motion.period
    run = simulate(
        crane,
        lift.command,
        lift.setpoint,
        start=lift.start() if start is None else start,
        duration=lift.motion.arrival,
        control_period=period,
        engine=engine,
        ground=lift.ground,
    )
    pull = JointForces.of(crane).tension(run.q.T, run.v.T) / (crane.payload_mass * crane.gravity)
    rows = {name: round(t / period) for name, t in lift.phases.items()}
    seen = np.array([lift.seen(State(*row)).q for row in zip(run.q, run.v, strict=True)])
    swing = clearance.tilt(seen)
    off, motion, down = (rows[name] for name in ("lift-off", "motion", "set-down"))
    distance, name = min(
        (pair.distance, obstacle)
        for row in np.r_[off:motion:20, down : len(run) : 20]
        for obstacle, pair in clearance.distances(seen[row], jib=False).items()
        if obstacle != GROUND
    )
    site, touch = clearance.site, down + int(np.flatnonzero(pull[down:] < HANGS)[0])
    goal, end = clearance.point(lift.lift.ends[1]), payload_position(crane, run.q[-1])
    apart = float(np.linalg.norm((end - goal)[:2]))
    still = float(np.linalg.norm(point_velocities(crane, State(run.q[-1], run.v[-1]))[0]))
    checks = (
        Check(
            f"Lift-off: the rope pulls {pull[off:motion].max():.3f} of the weight at most, "
            f"{PULL:g} allowed; clear of the ground the load swings "
            f"{1e3 * swing[motion]:.2f} mrad, {1e3 * site.swing:.1f} allowed.",
            bool(pull[off:motion].max() <= PULL and swing[motion] <= site.swing),
        ),
        Check(
            f"Motion: the load swings {1e3 * swing[motion:down].max():.1f} mrad at most, "
            f"{1e3 * site.swing:.1f} allowed, on a taut rope.",
            bool(swing[motion:down].max() <= site.swing and pull[motion:down].min() > 0.0),
        ),
        Check(
            f"Above its supports nothing comes nearer to an obstacle than {distance:.2f} m "
            f"({name}), {site.distance:g} m required.",
            distance >= site.distance,
        ),
        Check(
            f"Set-down: the load touches at {run.v[touch, crane.layout.index('l')]:.3f} m/s, ends "
            f"{1e3 * apart:.1f} mm from its goal, {1e3 * OFF:g} allowed, below a rope that is "
            f"{-run.q[-1, crane.layout.index('rope_stretch')]:.3f} m slack.",
            bool(apart <= OFF and pull[-1] == 0.0 and still < STILL),
        ),
    )
    return GroundCertificate(lift, run, pull, checks)


def _lug(crane: Crane) -> float:
    """Return the height of the lug above the centre of the load [m]."""
    return -float(crane.payload.lever[2])


def _standing(crane: Crane, ground: Ground, drives: np.ndarray) -> State:
    """Return the state in which the load stands below the trolley, shape (3,)."""
    q = np.zeros(crane.layout.n)
    q[crane.layout.drives] = drives
    return standing(crane, ground, State(q, 0.0 * q))
