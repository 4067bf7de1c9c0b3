"""Lift from the ground or to it: lift-off before a planned lift, and set-down after it.

The controller is made for the crane of the plan, whose load hangs on a rigid rope. It is given the
coordinates of that crane: direction and distance of the load from its pivot. While the rope does
not carry the load, it is given no swing, and the hoist exerts only the tension that there is.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from cranedyn import theory
from cranedyn.checks import number, within
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import OFF_LEAD, Ground, Hull, box_corners, standing
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import body_points, payload_position, point_velocities
from cranedyn.interfaces import Controller, EngineName, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.urdf import inertial_element, set_placement
from cranedyn.planning.clearance import Clearance
from cranedyn.planning.coverage import Pairs, coverage_check, hanging_pairs, slewing_pairs
from cranedyn.planning.lift import Lift, NoWay
from cranedyn.planning.proof import unproven_row
from cranedyn.planning.site import Site
from cranedyn.planning.standing import standing_check, standing_parts
from cranedyn.planning.support import (
    NO_SUPPORT,
    Support,
    contact_check,
    meshes_at,
    support_of,
)
from cranedyn.references.flat import cruise
from cranedyn.references.motion import Motion
from cranedyn.simulation.simulate import simulate
from cranedyn.verdict import Check

LEAST_HOIST_SPEED = 1e-3
"""Least creep speed or sink rate [m/s], with which slack and stretch of a rope take minutes."""

SLACK = 0.05
"""Slack of the rope of a load that stands [m]."""

PAUSE = 2.0
"""Pause between phases [s]."""

HOIST_ACCELERATION = 0.02
"""Mean acceleration of the hoist at lift-off and set-down [m/s²]."""

BOX_SHARE = 0.99
"""Volume of a load over that of the box around it from which on it is a box."""

ROPE_DAMPING = 2e4
"""Damping of the rope [N s/m]."""

HANGING_TENSION_RATIO = 0.9
"""The load counts as hanging once the rope carries this share of its weight."""

GOAL_TOLERANCE = 0.01
"""Largest distance from the goal at the end of a lift [m]."""

MAX_FINAL_SPEED = 1e-3
"""Largest speed of the load at the end of a lift [m/s]."""

_DRUM = 5.0
"""Mass of hoist drum and motor at the rope over that of the load, for a crane that gives none."""

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

    def near(vertices: np.ndarray) -> bool:
        if within is None:
            return True
        centres, reach = within
        low, high = vertices.min(axis=0)[:2] - reach, vertices.max(axis=0)[:2] + reach
        return bool(((low < centres[:, :2]) & (centres[:, :2] < high)).all(axis=1).any())

    solids = (solid for solid in site.seen_by_crane() if not solid.zone)
    hulls = [Hull(part.tolist()) for solid in solids for part in solid.parts if near(part)]
    return Ground(points, tuple(hulls), height=site.ground - float(site.foot[2]), **properties)


@dataclass(frozen=True, eq=False)
class GroundLift:
    """A lift from the ground or to it.

    Attributes:
        lift: The planned lift, whose start and goal hang, above their supports where the load is
            lifted off or set down.
        crane: Its crane with a rope that stretches and the load on its lug.
        ground: Ground and platforms.
        motion: Motion of the crane of the plan.
        controller: Controller of the crane of the plan.
        phases: Time at which each phase begins [s], by name: "motion", before it "lift-off" and
            "pause", after it "set-down".
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
        hangs = tension > HANGING_TENSION_RATIO * weight
        effort = np.array(self.controller(t, self.seen(state, hangs=hangs), self.motion(t)))
        effort += 0.0 if hangs else (weight - tension) * self.crane.layout.along("l")
        return effort

    def seen(self, state: State, *, hangs: bool = True) -> State:
        """Return the state of the crane of the plan, without swing for a load that does not hang.

        The load's angles are those of rope and sling by their lengths. Shape (n,) or (n, rows).
        """
        at, lug = self.crane.layout.at, _lug(self.crane)
        swing, sling = at("phi", "theta"), at("sling_radial", "sling_tangential")
        share = lug / (state.q[at("l")] + lug)
        q, v = (
            np.concatenate([z[at("gamma", "x")], hangs * (z[swing] + share * z[sling]), z[at("l")]])
            for z in state
        )
        q[self.motion.drives[2]] += lug
        return State(q, v)


def stands_at(end: np.ndarray | None) -> bool:
    """Return whether a load stands at an end of a lift, which then has two coordinates."""
    return end is not None and len(end) == 2


def from_ground(
    lift: Lift,
    *,
    rope_stiffness: float = 2e7,
    creep: float = 0.1,
    sink_rate: float = 0.1,
    stands: tuple[bool, bool] = (True, True),
) -> GroundLift:
    """Return a lift that begins on the ground or obstacle below its start and ends on that below
    its goal.

    Args:
        lift: The planned lift; its load is a box.
        rope_stiffness: EA of a fall of the rope [N].
        creep: Largest hoisting speed of the lift-off [m/s], from `LEAST_HOIST_SPEED` to the largest
            rate of the hoist.
        sink_rate: Largest speed of the set-down [m/s], in the same range.
        stands: Whether the load stands at the start and at the goal; else it hangs there.

    Raises:
        OutOfRange: If a number is out of its range.
        NoWay: If the load would stand on or in a mesh that is not convex, or is no box.
        ModelError: If joints or links of the crane have names of those of a rope that stretches.
    """
    clearance, planned = lift.clearance, lift.timed.motion
    number("EA of the rope", rope_stiffness, "N", "> 0")
    fastest = float(lift.limits.rates[lift.crane.layout.drive("l")])
    creep = within("creep speed", creep, LEAST_HOIST_SPEED, fastest, "m/s")
    sink_rate = within("sink rate", sink_rate, LEAST_HOIST_SPEED, fastest, "m/s")
    _refuse_unless_a_box(clearance.bodies.load)
    crane, sides = _on_rope(clearance, rope_stiffness)
    ends = clearance.point(lift.ends), clearance.bodies.spread + clearance.site.distance
    ground = ground_of(clearance.site, box_corners(*sides), within=ends)

    def lowered(place: int, speed: float) -> np.ndarray:
        """Return q, v and a of a set-down and a pause after it, shape (3, rows, 5)."""
        ramp = max(1.0, speed / HOIST_ACCELERATION)
        stands = _standing(crane, ground, planned(planned.arrival * -place).position)
        travel = SLACK + float(stands.q[crane.layout.index("rope_stretch")])
        duration = planned.period * math.ceil((travel / speed + ramp) / planned.period)
        t = np.arange(0.0, duration + PAUSE, planned.period)
        rows = np.zeros((3, len(t), planned.q.shape[1]))
        rows[0] = planned.q[place]
        for order in range(3):
            rows[order, :, planned.drives[2]] += travel * cruise(t, duration, ramp, order)
        return rows

    pieces: dict[str, np.ndarray] = {}
    if stands[0]:
        signs = np.array([1.0, -1.0, 1.0])[:, None, None]  # of q, v and a backward in time
        raised = lowered(0, creep)[:, ::-1] * signs
        pause = np.repeat(raised[:, -1:], round(PAUSE / planned.period), axis=1)
        pieces |= {"lift-off": raised, "pause": pause}
    pieces["motion"] = np.stack([planned.q, planned.v, planned.a])
    if stands[1]:
        pieces["set-down"] = lowered(-1, sink_rate)
    begins = planned.period * np.cumsum([0, *(rows.shape[1] for rows in pieces.values())])
    q, v, a = np.concatenate([*pieces.values()], axis=1)
    motion = Motion(planned.period, q, v, a, planned.drives)
    phases = dict(zip(pieces, begins.tolist(), strict=False))
    made = GroundLift(lift, crane, ground, motion, lqr(lift.crane, motion), phases)
    _refuse_meshes(made, stands)
    return made


def _refuse_unless_a_box(load: np.ndarray) -> None:
    """Refuse a load that is no upright box: it stands on the corners of one in the simulation.

    Raises:
        NoWay: With the share of its box that it fills.
    """
    share = float(ConvexHull(load).volume / np.ptp(load, axis=0).prod())
    if not share >= BOX_SHARE:
        raise NoWay(
            f"A load that stands must be an upright box; this one fills {100.0 * share:.0f} % of "
            "its box. Enter its size, or let it hang at both ends."
        )


def _refuse_meshes(lift: GroundLift, stands: tuple[bool, bool]) -> None:
    """Refuse a lift whose load would stand on or in a mesh that is not convex.

    Raises:
        NoWay: With the name of the mesh.
    """
    ends = zip(("start", "goal"), stands, (0.0, lift.lift.timed.motion.arrival), strict=True)
    for name, is_standing, t in ends:
        if not is_standing:
            continue
        drives = lift.lift.timed.motion(t).position
        corners = load_corners(lift, _standing(lift.crane, lift.ground, drives).q)
        for mesh in meshes_at(lift.lift.clearance.site, corners):
            raise NoWay(
                f"At the {name} the load would stand on or in {mesh}, a mesh that is not convex, "
                "which cannot be a support: enter what it stands on as boxes or prisms, or the "
                "mesh with hull = true."
            )


def certify_ground_lift(
    lift: GroundLift, *, engine: EngineName = "compiled"
) -> tuple[Trajectory, list[Check]]:
    """Simulate a lift from the ground or to it, and check each phase.

    Raises:
        RunError: If the simulation breaks off.
    """
    crane, motion = lift.crane, lift.motion
    drives = motion(0.0).position
    hangs = State(crane.hanging(_below(crane, drives).q), np.zeros(crane.layout.n))
    run = simulate(
        crane,
        lift.command,
        lift.setpoint,
        start=_standing(crane, lift.ground, drives) if "lift-off" in lift.phases else hangs,
        duration=motion.arrival,
        control_period=motion.period,
        engine=engine,
        ground=lift.ground,
    )
    phases = _Phases.of(lift, run)
    checks: list[Check] = []
    if "lift-off" in lift.phases:
        checks.append(_lift_off_check(lift, run, phases))
    checks.append(_motion_check(lift, phases))
    checks.append(_range_check(lift))
    checks += _distance_checks(lift, run, phases)
    if "set-down" in lift.phases:
        checks.append(_set_down_check(lift, run, phases))
    return run, checks


@dataclass(frozen=True, eq=False)
class _Phases:
    """A run of a ground lift as the crane of the plan would see it, and its phases.

    Attributes:
        seen: Coordinates of the crane of the plan, shape (rows, n).
        pull: Tension of the rope over the weight of the load, shape (rows,).
        swing: Angle of the rope from plumb [rad], shape (rows,).
        moving: Row in which the motion of the plan begins.
        down: Row in which it ends.
    """

    seen: np.ndarray
    pull: np.ndarray
    swing: np.ndarray
    moving: int
    down: int

    @classmethod
    def of(cls, lift: GroundLift, run: Trajectory) -> _Phases:
        """Return the phases of a run."""
        crane, period = lift.crane, lift.motion.period
        begins = {name: round(t / period) for name, t in lift.phases.items()}
        seen = lift.seen(State(run.q.T, run.v.T)).q.T
        weight = crane.payload_mass * crane.gravity
        return cls(
            seen=seen,
            pull=JointForces.of(crane).tension(run.q.T, run.v.T) / weight,
            swing=lift.lift.clearance.tilt(seen),
            moving=begins["motion"],
            down=begins.get("set-down", len(run) - 1),
        )


def _lift_off_check(lift: GroundLift, run: Trajectory, phases: _Phases) -> Check:
    """Check that the rope pulls no more than the closed form, and the load swings little then."""
    pull, moving = phases.pull, phases.moving
    allowed = lift.lift.clearance.site.swing
    carries = pull[:moving] >= 1.0
    if not carries.any():
        return Check("Lift-off: the rope never carries the weight of the load.", False)
    lifted = int(np.argmax(carries))
    largest = _largest_pull(lift.crane, lift.motion, slice(lifted, moving))
    bound = f"{largest:.3f} by closed form"
    if (run["phase"][:moving] == OFF_LEAD).any():
        largest = math.nan
        bound = "without a bound: the load slides or leans while the rope pulls"
    return Check(
        f"Lift-off: the rope pulls {pull[:moving].max():.3f} of the weight at most, {bound}; "
        f"hanging, the load swings {1e3 * phases.swing[moving]:.2f} mrad, {1e3 * allowed:.1f} "
        "allowed.",
        bool(pull[:moving].max() <= largest and phases.swing[moving] <= allowed),
    )


def _motion_check(lift: GroundLift, phases: _Phases) -> Check:
    """Check that the load swings no more than allowed and the rope stays taut."""
    rows = slice(phases.moving, phases.down)
    allowed = lift.lift.clearance.site.swing
    largest, least_pull = phases.swing[rows].max(), phases.pull[rows].min()
    return Check(
        f"Motion: the load swings {1e3 * largest:.1f} mrad at most, {1e3 * allowed:.1f} allowed; "
        f"the rope pulls {least_pull:.3f} of the weight at least.",
        bool(largest <= allowed and least_pull > 0.0),
    )


def _range_check(lift: GroundLift) -> Check:
    """Check that the rope is long enough, and that the other drives stay in their ranges.

    The simulated crane has as much rope as the ground needs, see `_on_rope`, so that its own range
    says nothing.
    """
    crane = lift.lift.crane
    drives = crane.layout.drives
    positions = lift.motion.q[:, lift.motion.drives]
    longest = float(positions[:, crane.layout.drive("l")].max())
    allowed = float(crane.upper[drives][crane.layout.drive("l")])
    inside = (positions >= crane.lower[drives] - 1e-9) & (positions <= crane.upper[drives] + 1e-9)
    return Check(
        f"The cable is {longest:.2f} m long at most, {allowed:.2f} m there are; the drives "
        f"{'stay in' if inside.all() else 'leave'} their ranges.",
        bool(inside.all()),
    )


def _set_down_check(lift: GroundLift, run: Trajectory, phases: _Phases) -> Check:
    """Check that the load is set down gently, at its goal, and stands there below a slack rope."""
    crane, clearance, down = lift.crane, lift.lift.clearance, phases.down
    slackened = np.flatnonzero(phases.pull[down:] < HANGING_TENSION_RATIO)
    if not len(slackened):
        return Check("Set-down: the load does not touch what is below it.", False)
    speed = float(run.v[down + int(slackened[0]), crane.layout.index("l")])
    sink_rate = float(lift.motion.v[down:, lift.motion.drives[2]].max())
    end = payload_position(crane, run.q[-1]) - clearance.point(lift.lift.ends[1])
    apart = float(np.linalg.norm(end[:2]))
    still = np.linalg.norm(point_velocities(crane, run.state(-1))[0]) < MAX_FINAL_SPEED
    return Check(
        f"Set-down: the load touches at {speed:.3f} m/s, {sink_rate:.3f} allowed; it stands "
        f"{1e3 * apart:.1f} mm from its goal, {1e3 * GOAL_TOLERANCE:g} allowed, below a slack "
        "rope.",
        bool(speed <= sink_rate and apart <= GOAL_TOLERANCE and still and phases.pull[-1] == 0.0),
    )


def _distance_checks(lift: GroundLift, run: Trajectory, phases: _Phases) -> list[Check]:
    """Check that all that hangs keeps its distance from everything, in all phases, but for the
    surfaces that the load stands on before and after the motion; that it does not sink into these;
    and that nothing is left out.

    The load is where the rope has it. Where it turns in its sling, it is off its seen attitude by
    the angles of the sling and, with its centre, by their share in the seen swing.
    """
    clearance, layout, lug = lift.lift.clearance, lift.crane.layout, _lug(lift.crane)
    q, hoist = phases.seen.copy(), lift.motion.drives[2]
    assert lift.crane.springs.rope is not None
    q[:, hoist] += run.q[:, lift.crane.springs.rope.stretch]
    turned = np.abs(run.q[:, layout.at("sling_radial", "sling_tangential")]).sum(axis=1)
    radius = clearance.bodies.below + float(np.linalg.norm(clearance.bodies.hook[1]))
    aside = (3.0 * lug + 2.0 * radius) * turned
    moving, down = phases.moving, phases.down
    stands: list[tuple[str, Support, np.ndarray]] = []
    parts = [(slice(moving, down + 1), NO_SUPPORT)]
    for name, row, rows in (
        ("start", 0, slice(moving + 1)),
        ("goal", -1, slice(down, None)),
    ):
        if ("lift-off" if name == "start" else "set-down") not in lift.phases:
            continue
        support = support_of(clearance, load_corners(lift, run.q[row]))
        lowest = np.array([load_corners(lift, state)[:, 2].min() for state in run.q[rows]])
        stands.append((name, support, lowest))
        parts.append((rows, support))

    least, unproven = [], []
    standing_result = standing_parts(clearance)
    covered: Pairs | None = None
    for rows, support in parts:
        beside = clearance.without(support.parts)
        least.append(beside.nearest(q[rows][beside.nearest_row(q[rows])]))
        failing = unproven_row(beside, q[rows], lift.motion.period, envelope=aside[rows])
        unproven += [] if failing is None else [float(run.t[rows][failing])]
        pairs = hanging_pairs(beside) | support.pairs
        covered = pairs if covered is None else covered & pairs
    nearest, proof = min(least), "proven between all instants"
    if unproven:
        proof = f"not proven at t = {unproven[0]:.2f} s"
    slews = q[:, lift.motion.drives[0]]
    turns_freely = lift.lift.slews.low <= slews.min() and slews.max() <= lift.lift.slews.high
    assert covered is not None  # there is always a motion
    return [
        Check(
            "Above its supports nothing that hangs comes nearer to another obstacle than "
            f"{nearest.distance:.2f} m ({nearest.obstacle}), {clearance.site.distance:g} m "
            f"required; {proof}.",
            bool(not unproven and nearest.distance >= clearance.site.distance),
        ),
        contact_check(stands),
        Check(
            "Slewing: the jib stays in the angles that are proven free."
            if turns_freely
            else "Slewing: the jib leaves the angles that are proven free.",
            bool(turns_freely),
        ),
        standing_check(standing_result),
        coverage_check(clearance.site, covered | slewing_pairs(clearance) | standing_result.pairs),
    ]


def load_corners(lift: GroundLift, q: np.ndarray) -> np.ndarray:
    """Return the corners of the load at coordinates of the lift's crane, shape (n,), in the frame
    of the crane [m], shape (8, 3).
    """
    crane = lift.crane
    points = crane.payload.lever + np.array(lift.ground.points)
    body = crane.payload.body
    position, _ = body_points(crane.model, crane.data, body, points, q, np.zeros_like(q))
    return position.T


def _on_rope(clearance: Clearance, rope_stiffness: float) -> tuple[Crane, list[float]]:
    """Return the crane with its load, a box, on a lug below a rope that stretches and reaches the
    ground; and the sides of the box [m], shape (3,).

    Rope and sling have the names that they have in the crane of this project.
    """
    crane, site, model = clearance.crane, clearance.site, clearance.crane.model
    robot, hoist = ET.fromstring(crane.urdf), clearance.joints.hoist
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    hook = data.oMi[hoist + 1].rotation
    sides = np.ptp(clearance.bodies.load @ hook.T, axis=0).tolist()
    old = {frame.name for frame in model.frames if frame.parentJoint == hoist + 1}
    for link in robot.iterfind("link"):
        if link.get("name") in old and (inertial := link.find("inertial")) is not None:
            link.remove(inertial)
    arguments = {
        "falls": 1.0,
        "drum_inertia": model.armature[hoist] or _DRUM * crane.payload_mass,
        **crane.record.get("arguments", {}),
    }
    joint = next(j for j in robot.iterfind("joint") if j.get("name") == model.names[hoist + 1])
    child, limit, dynamics = (joint.find(tag) for tag in ("child", "limit", "dynamics"))
    assert child is not None and limit is not None  # see check_urdf
    dynamics = ET.SubElement(joint, "dynamics") if dynamics is None else dynamics
    dynamics.set("armature", repr(float(arguments["drum_inertia"])))
    lowest = clearance.height - site.ground + float(site.foot[2])
    limit.set("upper", repr(max(lowest, float(crane.upper[hoist]))))
    load, lug = child.get("link", ""), pin.SE3(np.eye(3), np.array([0.0, 0.0, sides[2] / 2.0]))
    child.set("link", "rope_link")
    ea = float(arguments["falls"]) * rope_stiffness
    robot.extend(ET.fromstring(_ROPE.format(ea=ea, damping=ROPE_DAMPING, load=load)))
    stretch, at_load = robot.findall("joint")[-4], robot.findall("joint")[-1]
    set_placement(stretch, pin.SE3(hook.T, np.zeros(3)))
    set_placement(at_load, lug.inverse() * pin.SE3(hook, np.zeros(3)))
    box = pin.Inertia.FromBox(crane.payload_mass, *sides)
    robot.findall("link")[-1].append(inertial_element(lug.actInv(box)))
    record = {**crane.record, "payload": "sling_tangential_joint"}
    record.pop("arguments", None)
    record["urdf"] = ET.tostring(robot, encoding="unicode")
    return load_crane(from_record={"crane": record}), sides


_ROPE = """<robot>
  <link name="rope_link"/>
  <link name="lug_link"/>
  <link name="sling_link"/>
  <link name="payload_link"/>
  <joint name="rope_stretch_joint" type="prismatic">
    <parent link="rope_link"/> <child link="lug_link"/> <axis xyz="0 0 -1"/>
    <limit lower="-1000" upper="5" effort="1e9" velocity="10"/> <dynamics damping="{damping}"/>
  </joint>
  <joint name="sling_radial_joint" type="revolute">
    <parent link="lug_link"/> <child link="sling_link"/> <axis xyz="1 0 0"/>
    <limit lower="-1.5" upper="1.5" effort="1e7" velocity="10"/> <dynamics damping="300"/>
  </joint>
  <joint name="sling_tangential_joint" type="revolute">
    <parent link="sling_link"/> <child link="payload_link"/> <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1e7" velocity="10"/> <dynamics damping="300"/>
  </joint>
  <joint name="load_joint" type="fixed">
    <parent link="payload_link"/> <child link="{load}"/>
  </joint>
  <gazebo reference="rope_stretch_joint"><ropeStiffness>{ea}</ropeStiffness></gazebo>
</robot>"""
"""Rope that stretches, and load on a lug below it, in axes of the world."""


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


def _below(crane: Crane, drives: np.ndarray) -> State:
    """Return the state in which the load is below the trolley, at a place of the plan."""
    q = np.zeros(crane.layout.n)
    q[crane.layout.drives] = drives - [0.0, 0.0, _lug(crane)]
    return State(q, 0.0 * q)


def _standing(crane: Crane, ground: Ground, drives: np.ndarray) -> State:
    """Return the state in which the load stands below the trolley, at a place of the plan."""
    return standing(crane, ground, _below(crane, drives))
