"""Lift from the ground to the ground: lift-off before a planned lift, and set-down after it.

The controller is made for the crane of the plan, whose load hangs on a rigid rope. It is given the
coordinates of that crane: direction and distance of the load from its pivot. While the rope does
not carry the load, it is given no swing, and the hoist exerts only the tension that there is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn import theory
from cranedyn.checks import number
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import OFF_LEAD, Ground, Hull, box_corners, box_load, standing
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import payload_position, point_velocities
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, EngineName, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.certificate import Check
from cranedyn.planning.clearance import Clearance, Nearest
from cranedyn.planning.lift import Lift
from cranedyn.planning.site import Site
from cranedyn.references.flat import cruise
from cranedyn.references.motion import Motion
from cranedyn.simulation.simulate import simulate

SLACK, PAUSE, HOIST_ACCELERATION = 0.05, 2.0, 0.02
"""Slack of the rope of a load that stands [m], pause between phases [s], and mean acceleration of
the hoist at lift-off and set-down [m/s²]."""

ROPE_DAMPING = 2e4
"""Damping of the rope [N s/m]."""

HANGS, OFF, STILL = 0.9, 0.01, 1e-3
"""Tension over the weight from which on a load hangs; largest distance from the goal [m] and speed
of the load [m/s] at the end."""

_MEASURED = 20
"""Rows between measurements of distances."""

_DAMPED = 0.99
"""Largest damping ratio of the bounce that the bound of the pull counts on."""


def ground_of(
    site: Site,
    points: Sequence[Sequence[float]],
    *,
    within: tuple[np.ndarray, float] | None = None,
    **properties: float,
) -> Ground:
    """Return the ground of a site with its obstacles as supports and walls, in the frame of the
    crane; without zones and what is not convex.

    Args:
        site: The site.
        points: Points of the load, see `Ground`.
        within: Places in the frame of the crane, shape (k, 3), and a distance in plan [m]: what is
            farther from all places is left out; None for none.
        properties: Friction, restitution and sink, see `Ground`.
    """

    def near(part: np.ndarray) -> bool:
        if within is None:
            return True
        places, reach = within
        low, high = part.min(axis=0)[:2] - reach, part.max(axis=0)[:2] + reach
        return bool(((low < places[:, :2]) & (places[:, :2] < high)).all(axis=1).any())

    solids = (solid for solid in site.seen_by_crane() if not solid.zone)
    hulls = [Hull(part.tolist()) for solid in solids for part in solid.parts if near(part)]
    return Ground(points, tuple(hulls), height=site.ground - float(site.foot[2]), **properties)


@dataclass(frozen=True, eq=False)
class GroundLift:
    """A lift from the ground to the ground.

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

    def command(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts of the drives [N m or N], shape (3,)."""
        weight = self.crane.payload_mass * self.crane.gravity
        tension = float(JointForces.of(self.crane).tension(*state))
        hangs = tension > HANGS * weight
        effort = np.array(self.controller(t, self.seen(state, hangs=hangs), self.motion(t)))
        effort += 0.0 if hangs else (weight - tension) * self.crane.layout.along("l")
        return effort

    def seen(self, state: State, *, hangs: bool = True) -> State:
        """Return the state of the crane of the plan, without swing for a load that does not hang.

        The angles of the load from its pivot are those of rope and sling by their lengths.
        """
        at, lug = self.crane.layout.at, _lug(self.crane)
        drives, swing = at("gamma", "x", "l"), at("phi", "theta")
        share = lug / (state.q[drives[2]] + lug)
        sling = at("sling_radial", "sling_tangential")
        q, v = (np.insert(z[drives], 2, hangs * (z[swing] + share * z[sling])) for z in state)
        q[self.motion.drives[2]] += lug
        return State(q, v)


def from_ground(
    lift: Lift,
    *,
    rope_stiffness: float = 2e7,
    creep: float = 0.1,
    sink_rate: float = 0.1,
) -> GroundLift:
    """Return a lift that begins on the ground or obstacle below its start and ends on that below
    its goal.

    Args:
        lift: The planned lift of a crane of this project; its load is a box.
        rope_stiffness: EA of the rope [N].
        creep: Largest hoisting speed of the lift-off [m/s].
        sink_rate: Largest speed of the set-down [m/s].

    Raises:
        CraneError: If a number is not positive, or the crane has another URDF.
    """
    clearance, planned = lift.clearance, lift.timed.motion
    if (arguments := lift.crane.record.get("arguments")) is None:
        raise CraneError("A lift from the ground needs the tower crane of this project.")
    sides = np.ptp(clearance.bodies.load, axis=0).tolist()
    values = {**arguments, **box_load(lift.crane.payload_mass, *sides), "damp_sling": 300.0}
    values |= {"rope_stiffness": rope_stiffness, "rope_damping": ROPE_DAMPING}
    lowest = clearance.height - clearance.site.ground + float(clearance.site.foot[2])
    values["hoist_max"] = max(lowest, float(arguments.get("hoist_max", 0.0)))
    crane = load_crane(gravity=lift.crane.gravity, values=values)
    ends = clearance.point(lift.ends), clearance.bodies.spread + clearance.site.distance
    ground = ground_of(clearance.site, box_corners(*sides), within=ends)

    def lowered(place: int, name: str, speed: float) -> np.ndarray:
        """Return q, v and a of a set-down and a pause after it, shape (3, rows, 5)."""
        ramp = max(1.0, number(name, speed, "m/s", "> 0") / HOIST_ACCELERATION)
        stands = _standing(crane, ground, planned(planned.arrival * -place).position)
        way = SLACK + float(stands.q[crane.layout.index("rope_stretch")])
        duration = planned.period * math.ceil((way / speed + ramp) / planned.period)
        t = np.arange(0.0, duration + PAUSE, planned.period)
        rows = np.zeros((3, len(t), planned.q.shape[1]))
        rows[0] = planned.q[place]
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
    begins = planned.period * np.cumsum([0, *(rows.shape[1] for rows in pieces.values())])
    q, v, a = np.concatenate([*pieces.values()], axis=1)
    motion = Motion(planned.period, q, v, a, planned.drives)
    phases = dict(zip(pieces, begins.tolist(), strict=False))
    return GroundLift(lift, crane, ground, motion, lqr(lift.crane, motion), phases)


def certify_ground_lift(
    lift: GroundLift, *, engine: EngineName = "compiled"
) -> tuple[Trajectory, list[Check]]:
    """Simulate a lift from the ground to the ground, and check each phase.

    Raises:
        RunError: If the simulation breaks off.
    """
    crane, clearance, motion = lift.crane, lift.lift.clearance, lift.motion
    run = simulate(
        crane,
        lift.command,
        lift.setpoint,
        start=_standing(crane, lift.ground, motion(0.0).position),
        duration=motion.arrival,
        control_period=motion.period,
        engine=engine,
        ground=lift.ground,
    )
    pull = JointForces.of(crane).tension(run.q.T, run.v.T) / (crane.payload_mass * crane.gravity)
    seen = np.array([lift.seen(State(*row)).q for row in zip(run.q, run.v, strict=True)])
    off, _, moving, down = (round(t / motion.period) for t in lift.phases.values())
    swing, allowed = 1e3 * clearance.tilt(seen), 1e3 * clearance.site.swing
    nearest = min(
        _nearest_beside_support(clearance, seen[rows], support)
        for rows, support in ((slice(moving), 0), (slice(down, None), -1))
    )
    touched = down + int(np.flatnonzero(pull[down:] < HANGS)[0])
    speed = float(run.v[touched, crane.layout.index("l")])
    end = payload_position(crane, run.q[-1]) - clearance.point(lift.lift.ends[1])
    apart = float(np.linalg.norm(end[:2]))
    still = np.linalg.norm(point_velocities(crane, State(run.q[-1], run.v[-1]))[0]) < STILL
    hoist = motion.drives[2]
    lifted = off + int(np.argmax(pull[off:moving] >= 1.0))
    most = _largest_pull(crane, motion, slice(lifted, moving))
    bound = f"{most:.3f} by closed form"
    if (run["phase"][off:moving] == OFF_LEAD).any():
        most, bound = math.nan, "without a bound: the load slides or leans while the rope pulls"
    sink_rate = float(motion.v[down:, hoist].max())
    return run, [
        Check(
            f"Lift-off: the rope pulls {pull[:moving].max():.3f} of the weight at most, {bound}; "
            f"hanging, the load swings {swing[moving]:.2f} mrad, {allowed:.1f} allowed.",
            bool(pull[:moving].max() <= most and swing[moving] <= allowed),
        ),
        Check(
            f"Motion: the load swings {swing[moving:down].max():.1f} mrad at most, {allowed:.1f} "
            f"allowed; the rope pulls {pull[moving:down].min():.3f} of the weight at least.",
            bool(swing[moving:down].max() <= allowed and pull[moving:down].min() > 0.0),
        ),
        Check(
            f"Above its supports nothing that hangs comes nearer to another obstacle than "
            f"{nearest.distance:.2f} m ({nearest.obstacle}), {clearance.site.distance:g} m "
            "required.",
            nearest.distance >= clearance.site.distance,
        ),
        Check(
            f"Set-down: the load touches at {speed:.3f} m/s, {sink_rate:.3f} allowed; it stands "
            f"{1e3 * apart:.1f} mm from its goal, {1e3 * OFF:g} allowed, below a slack rope.",
            bool(speed <= sink_rate and apart <= OFF and still and pull[-1] == 0.0),
        ),
    ]


def _nearest_beside_support(clearance: Clearance, q: np.ndarray, support: int) -> Nearest:
    """Return the nearest pair of a body that hangs and an obstacle on which the load does not stand
    in a row, of coordinates of all rows, shape (rows, n).
    """
    standing = clearance.distances(q[support], jib=False)
    return min(
        pair
        for row in q[::_MEASURED]
        for name, pair in clearance.distances(row, jib=False).items()
        if standing[name].distance > 0.0
    )


def _largest_pull(crane: Crane, motion: Motion, rows: slice) -> float:
    """Return an upper bound of the tension over the weight in rows that begin where the load leaves
    the ground, for a hoist that follows its motion and small strains.

    With D = T/m - g - a and the rate w at which the rope would stretch, w' = -D and D' = ω² w -
    2 ζ ω D - a'. So D is that of a load picked up at a constant speed, and |a| at first and the
    change of a, which D² + ω² w² cannot amplify, at most.
    """
    rope, mass, hoist = crane.springs.rope, crane.payload_mass, motion.drives[2]
    assert rope is not None
    a, lug = -motion.a[rows, hoist], _lug(crane)
    lengths = motion.q[rows, hoist] - lug
    omega = theory.rope_bounce(float(rope.stiffness), float(lengths.min()), mass)
    damping_ratio = min(ROPE_DAMPING / (2.0 * mass * omega), _DAMPED)
    picked_up = theory.pickup_factor(
        -float(motion.v[rows, hoist][0]), omega, crane.gravity, damping_ratio
    )
    change = a + np.cumsum(np.abs(np.diff(a, prepend=0.0)))
    stiffening = math.sqrt(float(lengths[0] / lengths.min()))
    return picked_up + stiffening * float(change.max()) / crane.gravity


def _lug(crane: Crane) -> float:
    """Return the height of the lug above the centre of the load [m]."""
    return -float(crane.payload.lever[2])


def _standing(crane: Crane, ground: Ground, drives: np.ndarray) -> State:
    """Return the state in which the load stands below the trolley, at a place of the plan."""
    q = np.zeros(crane.layout.n)
    q[crane.layout.drives] = drives - [0.0, 0.0, _lug(crane)]
    return standing(crane, ground, State(q, 0.0 * q))
