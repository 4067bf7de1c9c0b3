"""Lift from the ground or to it: lift-off before a planned lift, and set-down after it.

The controller is made for the crane of the plan, whose load hangs on a rigid rope. It is given the
coordinates of that crane: direction and distance of the load from its pivot. While the rope does
not carry the load, it is given no swing, and the hoist exerts only the tension that there is.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from cranedyn import theory
from cranedyn.checks import number, whole, within
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import OFF_LEAD, Ground, Hull, box_corners, standing
from cranedyn.dynamics.equations_of_motion import body_points, payload_position, point_velocities
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import tower_clearance
from cranedyn.lifts.planning.coverage import Pairs, coverage_check, hanging_pairs, slewing_pairs
from cranedyn.lifts.planning.lift import Lift, NoWay
from cranedyn.lifts.planning.motion_proof import PROOF_MARGIN, unproven_row
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.standing import standing_check, standing_parts
from cranedyn.lifts.planning.support import (
    NO_SUPPORT,
    Support,
    balance_check,
    contact_check,
    meshes_at,
    support_of,
)
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.model.urdf import inertial_element, set_placement
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
"""Mean acceleration of the hoist at lift-off and set-down [m/s²]. A ramp takes a second at least,
so that a slow hoist accelerates less.
"""

BOX_SHARE = 0.99
"""Volume of a load over that of the box around it from which on it is a box."""

MAX_OFFSET_SHARE = 0.01
"""Distance in plan of the centre of gravity of a box from its middle, over its shorter side, up to
which it counts as in the middle: what the share `BOX_SHARE` of its volume may hide."""

ROPE_DAMPING = 2e4
"""Damping of the bounce of the rope, all falls together [N s/m]: for a tonne on two falls of 27 m a
quarter of the critical one. No site enters it, and it decides the largest pull at lift-off and its
bound: a tonne that is hoisted at 0.2 m/s pulls 1.12 of its weight at most, with half of the damping
1.14, with twice as much 1.09. Other numbers of the certificate hardly depend on it: the speed of
the set-down changes by 1 mm/s.
"""

SLING_DAMPING = 300.0
"""Damping of the load about each axis of its lug [N m s/rad]: friction of slings, so that a load
that was turned in them comes to rest. No site enters it. With half of it and with twice as much all
numbers of the certificate of the same lift stay the same.
"""

HANGING_TENSION_RATIO = 0.9
"""The load counts as hanging once the rope carries this share of its weight."""

GOAL_TOLERANCE = 0.01
"""Largest distance from the goal at the end of a lift [m]."""

MAX_FINAL_SPEED = 1e-3
"""Largest speed of the load at the end of a lift [m/s]."""

_DRUM_MASS_RATIO = 5.0
"""Mass of hoist drum and motor at the rope over that of the load, for a crane that gives none."""

_MAX_DAMPING_RATIO = 0.99
"""Largest damping ratio of the bounce that the bound of the pull counts on."""

ROPE_STIFFNESS = 2e7
"""Stiffness EA of a fall of the rope where a caller gives none [N]."""

CREEP_SPEED = 0.1
"""Largest speed at which a load is lifted off or set down where a caller gives none [m/s]."""

_ANY_STIFFNESS = 2e7
"""Stiffness of a rope that hangs slack above a load that stands [N], which decides nothing."""

_LEAST_SUPPORT = 0.01
"""Least distance in plan of the centre of a load that stands from the edges between the corners on
which it stands [m]."""

_RANGE_TOLERANCE = 1e-9
"""Distance by which drives may leave their ranges by rounding [rad or m]."""


def ground_of(
    site: Site,
    points: Sequence[Sequence[float]],
    *,
    near: tuple[np.ndarray, float] | None = None,
    **properties: float,
) -> Ground:
    """Return the ground of a site with its obstacles as supports and walls, in the frame of the
    crane; without zones and what is not convex.

    Args:
        site: The site.
        points: Points of the load, see `Ground`.
        near: Points in the frame of the crane [m], shape (k, 3), and a distance in plan [m]: what
            is farther from all points is left out; None to leave nothing out.
        properties: Friction, restitution and sink, see `Ground`.
    """
    hulls = []
    for solid in site.seen_by_crane():
        if solid.zone:
            continue
        for part in solid.parts:
            if near is None or _is_near(part, *near):
                hulls.append(Hull(part.tolist()))
    return Ground(points, tuple(hulls), height=site.ground - float(site.foot[2]), **properties)


def _is_near(vertices: np.ndarray, places: np.ndarray, distance: float) -> bool:
    """Return whether one of several places lies in the rectangle around vertices, widened by a
    distance [m], all seen in plan.
    """
    low = vertices.min(axis=0)[:2] - distance
    high = vertices.max(axis=0)[:2] + distance
    inside = (low < places[:, :2]) & (places[:, :2] < high)
    return bool(inside.all(axis=1).any())


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
        lug: Height of the lug, where the rope ends, above the centre of the load [m].
    """

    lift: Lift
    crane: Crane
    ground: Ground
    motion: Motion
    controller: Controller
    phases: Mapping[str, float]
    lug: float

    def setpoint(self, t: float) -> Setpoint:
        """Return the setpoint of the drives at a time [s]."""
        position, velocity, acceleration = self.motion(t)
        return Setpoint(position - [0.0, 0.0, self.lug], velocity, acceleration)

    def command(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts of the drives [N m or N], shape (3,)."""
        weight = self.crane.payload_mass * self.crane.gravity
        tension = float(JointForces.of(self.crane).tension(*state))
        hangs = self._is_in_motion(t) or tension > HANGING_TENSION_RATIO * weight
        effort = np.array(self.controller(t, self.seen(state, hangs=hangs), self.motion(t)))
        if not hangs:
            # The controller holds the whole weight, by a negative effort of the hoist. What the
            # rope does not carry is taken off.
            effort += (weight - tension) * self.crane.layout.along("l")
        return effort

    def _is_in_motion(self, t: float) -> bool:
        """Return whether a time [s] is in the planned motion, in which the load hangs even where a
        hoist that brakes takes tension off the rope.
        """
        return self.phases["motion"] <= t < self.phases.get("set-down", math.inf)

    def seen(self, state: State, *, hangs: bool = True) -> State:
        """Return the state of the crane of the plan whose load is where that of this crane is, to
        first order in the angles.

        Args:
            state: State of this crane, shape (n,) or (n, rows) each.
            hangs: Whether the load hangs; else its swing angles and their rates are zero.
        """
        at = self.crane.layout.at
        lug = self.lug
        # A load on a rope l and a sling s, with the angles φ and φ + σ, is at the same place to
        # first order as one on a rope l + s with the angle φ + s/(l + s) σ. The coordinates of a
        # crane of the plan are slew, trolley, two swing angles and cable, in this order, see
        # `cranedyn.model.layout.Layout.tower`.
        share = lug / (state.q[at("l")] + lug)
        seen = []
        for coordinates in state:
            swing = coordinates[at("phi", "theta")]
            sling = coordinates[at("sling_radial", "sling_tangential")]
            angles = swing + share * sling if hangs else np.zeros_like(swing)
            seen.append(
                np.concatenate([coordinates[at("gamma", "x")], angles, coordinates[at("l")]])
            )
        q, v = seen
        # The cable of the plan ends at the centre of the load, that of the simulation at its lug.
        q[self.motion.drives[2]] += lug
        return State(q, v)


def standing_corners(clearance: Clearance, point: np.ndarray, label: str) -> np.ndarray:
    """Return the corners of the load of a site where it would stand on what is below a point, in
    the frame of the site [m], shape (8, 3), without what it sinks into that.

    Args:
        clearance: Crane and site.
        point: The point in the frame of the site [m], shape (2,).
        label: What errors call the point by.

    Raises:
        OutOfReach: If the crane does not reach it.
        NoWay: If the load is no box, or would tip over an edge.
        ModelError: As `from_ground`.
    """
    import shapely  # slow, and few lifts need it

    tower = tower_clearance(clearance, "A load that stands")
    _refuse_unless_a_box(tower.bodies.load)
    hung = _on_rope(tower, _ANY_STIFFNESS, None, None)
    place = tower.highest_place(point, label, PROOF_MARGIN)
    ground = ground_of(
        tower.site, hung.corners, near=(tower.point(place)[None], tower.bodies.spread)
    )
    state = _standing(hung.crane, ground, place, hung.lug)
    in_crane = _corners_at(hung.crane, ground, state.q)
    touches = ground.contacts(hung.crane).depth(in_crane.T)[0] > 0.0
    support = shapely.MultiPoint(in_crane[touches, :2]).convex_hull.buffer(-_LEAST_SUPPORT)
    if not support.contains(shapely.Point(in_crane[:, :2].mean(axis=0))):
        raise NoWay(
            f"At the {label} the load would tip: {int(touches.sum())} of its 8 corners touch what "
            "is below, and its centre is not between them. Move it where it stands on level ground."
        )
    sunk = tower.site.to_site(in_crane)
    return sunk + np.array([0.0, 0.0, ground.sink])


def stands_at(end: np.ndarray | None) -> bool:
    """Return whether a load stands at an end of a lift, which then has two coordinates."""
    return end is not None and len(end) == 2


def not_grounded(lift: Lift, *, certified: bool) -> str:
    """Return why lift-off and set-down of a lift are not simulated, to end a sentence with; empty
    if they are.

    Args:
        lift: The lift.
        certified: Whether its certificate holds.
    """
    if not isinstance(lift.clearance, TowerClearance):
        return "they are simulated for tower cranes only"
    return "" if certified else "the plan has no certificate"


def from_ground(
    lift: Lift,
    *,
    rope_stiffness: float = ROPE_STIFFNESS,
    falls: int | None = None,
    creep: float = CREEP_SPEED,
    sink_rate: float = CREEP_SPEED,
    stands: tuple[bool, bool] = (True, True),
    hook: HookBlock | None = None,
    drum_inertia: float | None = None,
) -> GroundLift:
    """Return a lift that begins on the ground or obstacle below its start and ends on that below
    its goal.

    Args:
        lift: The planned lift; its load is a box.
        rope_stiffness: EA of a fall of the rope [N].
        falls: Number of falls that carry the hook, which stretch in parallel; None for that of the
            site, or else of the crane's description, or else 1.
        creep: Largest hoisting speed of the lift-off [m/s], from `LEAST_HOIST_SPEED` to the largest
            rate of the hoist.
        sink_rate: Largest speed of the set-down [m/s], in the same range.
        stands: Whether the load stands at the start and at the goal; else it hangs there.
        hook: Hook block between rope and load, which stands on the load and whose mass is part of
            that of the crane's load; None for a rope that ends on top of the load, with all mass in
            the load.
        drum_inertia: Mass of hoist drum and motor at the rope [kg]; None for that of the crane, or
            else a multiple of the load.

    Raises:
        OutOfRange: If a number is out of its range, or the hook is as heavy as hook and load.
        NoWay: If the load would stand on or in a mesh that is not convex, or is no box.
        ModelError: If it is no tower crane of this project's kind, or has names of joints or links
            that those of a rope that stretches have.
    """
    clearance = tower_clearance(lift.clearance, "A lift from the ground or to it")
    planned = lift.timed.motion
    number("EA of the rope", rope_stiffness, "N", "> 0")
    fastest = float(lift.limits.rates[lift.crane.layout.drive("l")])
    creep = within("creep speed", creep, LEAST_HOIST_SPEED, fastest, "m/s")
    sink_rate = within("sink rate", sink_rate, LEAST_HOIST_SPEED, fastest, "m/s")
    _refuse_unless_a_box(clearance.bodies.load)
    falls = _falls_of(clearance) if falls is None else whole("number of falls", falls, 1)
    hung = _on_rope(clearance, falls * rope_stiffness, hook, drum_inertia)
    crane = hung.crane
    # Contact is computed only where the load can come near to the ground.
    reach = clearance.bodies.spread + clearance.site.distance
    ends = clearance.point(lift.ends)
    ground = ground_of(clearance.site, hung.corners, near=(ends, reach))

    stands_at_start, stands_at_goal = stands
    phases: dict[str, _Rows] = {}
    if stands_at_start:
        standing_state = _standing(crane, ground, planned(0.0).position, hung.lug)
        # A lift-off is a set-down backward in time.
        raised = _set_down(crane, planned, standing_state, 0, creep).backward()
        phases["lift-off"] = raised
        phases["pause"] = raised.last_repeated(round(PAUSE / planned.period))
    phases["motion"] = _Rows(planned.q, planned.v, planned.a)
    if stands_at_goal:
        standing_state = _standing(crane, ground, planned(planned.arrival).position, hung.lug)
        phases["set-down"] = _set_down(crane, planned, standing_state, -1, sink_rate)

    begins = {}
    row = 0
    for name, rows in phases.items():
        begins[name] = planned.period * row
        row += len(rows.q)
    motion = Motion(
        planned.period,
        np.concatenate([rows.q for rows in phases.values()]),
        np.concatenate([rows.v for rows in phases.values()]),
        np.concatenate([rows.a for rows in phases.values()]),
        planned.drives,
    )
    controller = lqr(lift.crane, motion)
    ground_lift = GroundLift(lift, crane, ground, motion, controller, begins, hung.lug)
    _refuse_meshes(ground_lift, stands)
    return ground_lift


class _Rows(NamedTuple):
    """A part of a motion, a row for each period.

    Attributes:
        q: Coordinates, shape (rows, n).
        v: Their rates, shape (rows, n).
        a: Their accelerations, shape (rows, n).
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray

    def backward(self) -> _Rows:
        """Return the motion backward in time, in which rates have the other sign."""
        return _Rows(self.q[::-1], -self.v[::-1], self.a[::-1])

    def last_repeated(self, count: int) -> _Rows:
        """Return the last row, repeated."""
        return _Rows(*(np.repeat(table[-1:], count, axis=0) for table in self))


def _set_down(
    crane: Crane, planned: Motion, standing_state: State, row: int, speed: float
) -> _Rows:
    """Return the set-down from a row of the planned motion, and a pause after it.

    The hoist pays out what the standing load needs until its rope hangs slack by `SLACK`.

    Args:
        crane: The crane with a rope that stretches.
        planned: The planned motion.
        standing_state: State of that crane in which the load stands below this row.
        row: The row: 0 or -1.
        speed: Speed of the hoist between its ramps [m/s].
    """
    hoist = planned.drives[2]
    ramp = max(1.0, speed / HOIST_ACCELERATION)
    travel = SLACK + float(standing_state.q[crane.layout.index("rope_stretch")])
    # At the speed but for two ramps, each of which costs half of its time: travel / speed + ramp.
    duration = planned.period * math.ceil((travel / speed + ramp) / planned.period)
    t = np.arange(0.0, duration + PAUSE, planned.period)
    q = np.zeros((len(t), planned.q.shape[1]))
    v = np.zeros_like(q)
    a = np.zeros_like(q)
    q[:] = planned.q[row]
    q[:, hoist] += travel * cruise(t, duration, ramp, 0)
    v[:, hoist] += travel * cruise(t, duration, ramp, 1)
    a[:, hoist] += travel * cruise(t, duration, ramp, 2)
    return _Rows(q, v, a)


def _refuse_unless_a_box(load: np.ndarray) -> None:
    """Refuse a load that is no upright box with its centre of gravity above or below its middle:
    it stands on the corners of such a box in the simulation, and is lifted by a lug above that.

    Raises:
        NoWay: With the share of its box that it fills, or the distance of its centre of gravity.
    """
    share = float(ConvexHull(load).volume / np.ptp(load, axis=0).prod())
    if not share >= BOX_SHARE:
        raise NoWay(
            f"A load that stands must be an upright box; this one fills {100.0 * share:.0f} % of "
            "its box. Enter its size, or let it hang at both ends."
        )
    middle = (load.min(axis=0) + load.max(axis=0))[:2] / 2.0
    aside = float(np.linalg.norm(middle))
    if aside > MAX_OFFSET_SHARE * float(np.ptp(load, axis=0)[:2].min()):
        raise NoWay(
            "A load that stands must hang below the middle of its box; the centre of gravity of "
            f"this one is {aside:.2f} m beside it in plan. Let it hang at both ends."
        )


def _refuse_meshes(lift: GroundLift, stands: tuple[bool, bool]) -> None:
    """Refuse a lift whose load would stand on or in a mesh that is not convex.

    Raises:
        NoWay: With the name of the mesh.
    """
    planned = lift.lift.timed.motion
    stands_at_start, stands_at_goal = stands
    times = {}
    if stands_at_start:
        times["start"] = 0.0
    if stands_at_goal:
        times["goal"] = planned.arrival
    for name, t in times.items():
        drives = planned(t).position
        corners = load_corners(lift, _standing(lift.crane, lift.ground, drives, lift.lug).q)
        for mesh in meshes_at(lift.lift.clearance.site, corners):
            raise NoWay(
                f"At the {name} the load would stand on or in {mesh}, a mesh that is not convex, "
                "which cannot be a support: enter what it stands on as boxes or prisms, or the "
                "mesh with hull = true."
            )


def certify_ground_lift(lift: GroundLift) -> tuple[Trajectory, list[Check]]:
    """Simulate a lift from the ground or to it, and check each phase.

    Args:
        lift: The lift.

    Returns:
        The run, and the checks of its phases.

    Raises:
        RunError: If the simulation breaks off.
    """
    run = simulate(
        lift.crane,
        lift.command,
        lift.setpoint,
        start=ground_lift_start(lift),
        duration=lift.motion.arrival,
        control_period=lift.motion.period,
        ground=lift.ground,
    )
    return run, ground_lift_checks(lift, run)


def ground_lift_start(lift: GroundLift) -> State:
    """Return the state in which a lift begins: its load stands below a slack rope, or hangs."""
    crane = lift.crane
    drives = lift.motion(0.0).position
    if "lift-off" in lift.phases:
        return _standing(crane, lift.ground, drives, lift.lug)
    return State(crane.hanging(_below(crane, drives, lift.lug).q), np.zeros(crane.layout.n))


def ground_lift_checks(lift: GroundLift, run: Trajectory) -> list[Check]:
    """Return the checks of the phases of a lift from the ground or to it.

    Args:
        lift: The lift.
        run: Its simulation, from time 0 on; it may go on after the end of the lift.
    """
    phases = _Phases.of(lift, run)
    checks: list[Check] = []
    if "lift-off" in lift.phases:
        checks.append(_lift_off_check(lift, run, phases))
    checks.append(_motion_check(lift, phases))
    checks.append(_range_check(lift))
    checks += _distance_checks(lift, run, phases)
    if "set-down" in lift.phases:
        checks.append(_set_down_check(lift, run, phases))
    return checks


@dataclass(frozen=True, eq=False)
class _Phases:
    """A run of a ground lift as the crane of the plan would see it, and its phases.

    Attributes:
        seen: Coordinates of the crane of the plan, shape (rows, n).
        pull: Tension of the rope over the weight of the load, shape (rows,).
        swing: Angle of the rope from plumb [rad], shape (rows,).
        motion_begin: Row in which the motion of the plan begins.
        motion_end: Row in which it ends.
    """

    seen: np.ndarray
    pull: np.ndarray
    swing: np.ndarray
    motion_begin: int
    motion_end: int

    @classmethod
    def of(cls, lift: GroundLift, run: Trajectory) -> _Phases:
        """Return the phases of a run."""
        crane = lift.crane
        begins = {name: round(t / lift.motion.period) for name, t in lift.phases.items()}
        seen = lift.seen(State(run.q.T, run.v.T)).q.T
        weight = crane.payload_mass * crane.gravity
        return cls(
            seen=seen,
            pull=JointForces.of(crane).tension(run.q.T, run.v.T) / weight,
            swing=lift.lift.clearance.tilt(seen),
            motion_begin=begins["motion"],
            motion_end=begins.get("set-down", len(run) - 1),
        )


def _lift_off_check(lift: GroundLift, run: Trajectory, phases: _Phases) -> Check:
    """Check that the rope pulls no more than the closed form, and the load swings little then."""
    pull = phases.pull
    begin = phases.motion_begin
    allowed = lift.lift.clearance.site.swing
    carries = pull[:begin] >= 1.0
    if not carries.any():
        return Check("Lift-off: the rope never carries the weight of the load.", False)
    lifted = int(np.argmax(carries))
    largest = _largest_pull(lift.crane, lift.motion, slice(lifted, begin), lift.lug)
    bound = f"{largest:.3f} by closed form"
    if (run["phase"][:begin] == OFF_LEAD).any():
        # No pull is less than NaN, so that a lift without a bound fails the check.
        largest = math.nan
        bound = "without a bound: the load slides or leans while the rope pulls"
    return Check(
        f"Lift-off: the rope pulls {pull[:begin].max():.3f} of the weight at most, {bound}; "
        f"hanging, the load swings {1e3 * phases.swing[begin]:.2f} mrad, {1e3 * allowed:.1f} "
        "allowed.",
        bool(pull[:begin].max() <= largest and phases.swing[begin] <= allowed),
    )


def _motion_check(lift: GroundLift, phases: _Phases) -> Check:
    """Check that the load swings no more than allowed and the rope stays taut."""
    rows = slice(phases.motion_begin, phases.motion_end)
    allowed = lift.lift.clearance.site.swing
    largest = phases.swing[rows].max()
    least_pull = phases.pull[rows].min()
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
    lowest = crane.lower[drives] - _RANGE_TOLERANCE
    highest = crane.upper[drives] + _RANGE_TOLERANCE
    inside = (positions >= lowest) & (positions <= highest)
    advice = ""
    if longest > allowed:
        advice = " If the rope of your crane is longer, enter it: values = {hoist_max = ...}."
    return Check(
        f"The cable is {longest:.2f} m long at most, of {allowed:.2f} m; the drives "
        f"{'stay in' if inside.all() else 'leave'} their ranges.{advice}",
        bool(inside.all()),
    )


def _set_down_check(lift: GroundLift, run: Trajectory, phases: _Phases) -> Check:
    """Check that the load is set down gently, at its goal, and stands there below a slack rope."""
    crane = lift.crane
    clearance = lift.lift.clearance
    down = phases.motion_end
    slackened = np.flatnonzero(phases.pull[down:] < HANGING_TENSION_RATIO)
    if not len(slackened):
        return Check("Set-down: the load does not touch what is below it.", False)
    # The first row in which the ground carries a share of the load. Up to there the load sinks as
    # fast as the hoist pays out, but for the bounce of the rope.
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


class _Hanging(NamedTuple):
    """Where all that hangs is in a run.

    Attributes:
        q: Coordinates of the crane of the plan, whose load is where the rope has it, shape (rows,
            n).
        aside: Largest distance of a point that hangs from its place at these coordinates [m], shape
            (rows,).
    """

    q: np.ndarray
    aside: np.ndarray


class _Section(NamedTuple):
    """Successive rows of a run, with the supports that the load stands on in them.

    Attributes:
        rows: Its rows.
        support: The supports, from which no distance is required.
    """

    rows: slice
    support: Support


def _distance_checks(lift: GroundLift, run: Trajectory, phases: _Phases) -> list[Check]:
    """Check that all that hangs keeps its distance from everything, in all phases, but for the
    surfaces that the load stands on before and after the motion; that it does not sink into these;
    and that nothing is left out.
    """
    clearance = lift.lift.clearance
    q, aside = _where_it_hangs(lift, run, phases)
    sections = [_Section(slice(phases.motion_begin, phases.motion_end + 1), NO_SUPPORT)]
    stands: list[tuple[str, Support, np.ndarray]] = []
    ends: list[tuple[str, Support, np.ndarray]] = []
    for name, section in _sections_on_supports(lift, run, phases):
        corners = [load_corners(lift, state) for state in run.q[section.rows]]
        lowest = np.array([corner[:, 2].min() for corner in corners])
        stands.append((name, section.support, lowest))
        # Level, as it is planned to stand: one that tips in the simulation has no support there.
        level = _level_corners(lift, name)
        ends.append((name, support_of(clearance, level), level))
        sections.append(section)

    nearest_of_sections = []
    unproven = []
    covered: Pairs | None = None
    for rows, support in sections:
        beside = clearance.without(support.parts)
        nearest_of_sections.append(beside.nearest(q[rows][beside.nearest_row(q[rows])]))
        failing = unproven_row(beside, q[rows], lift.motion.period, envelope=aside[rows])
        if failing is not None:
            unproven.append(float(run.t[rows][failing]))
        pairs = hanging_pairs(beside) | support.pairs
        # A pair counts as compared if it is in every section.
        covered = pairs if covered is None else covered & pairs
    assert covered is not None  # there is always a motion
    nearest = min(nearest_of_sections)
    proof = "proven between all instants"
    if unproven:
        proof = f"not proven at t = {unproven[0]:.2f} s"

    standing_result = standing_parts(clearance)
    compared = covered | slewing_pairs(clearance) | standing_result.pairs
    return [
        Check(
            "Above its supports nothing that hangs comes nearer to another obstacle than "
            f"{nearest.distance:.2f} m ({nearest.obstacle}), {clearance.site.distance:g} m "
            f"required; {proof}.",
            bool(not unproven and nearest.distance >= clearance.site.distance),
        ),
        contact_check(stands),
        balance_check(clearance, ends, centre_known=clearance.site.details.load.centre is not None),
        _slewing_check(lift, q),
        standing_check(standing_result),
        coverage_check(clearance, compared),
    ]


def _level_corners(lift: GroundLift, name: str) -> np.ndarray:
    """Return the corners of the load as it is planned to stand at the "start" or the "goal", in the
    frame of the crane [m], shape (8, 3).
    """
    t = 0.0 if name == "start" else lift.motion.arrival
    drives = lift.motion(t).position
    return load_corners(lift, _standing(lift.crane, lift.ground, drives, lift.lug).q)


def _where_it_hangs(lift: GroundLift, run: Trajectory, phases: _Phases) -> _Hanging:
    """Return where all that hangs is in a run.

    The coordinates of the crane of the plan put it there to first order in the angles. A bound of
    what they miss where the load turns in its sling is derived below.
    """
    clearance = lift.lift.clearance
    lug = lift.lug
    rope = lift.crane.springs.rope
    assert rope is not None  # see `_on_rope`
    q = phases.seen.copy()
    q[:, lift.motion.drives[2]] += run.q[:, rope.stretch]
    sling = lift.crane.layout.at("sling_radial", "sling_tangential")
    turned = np.abs(run.q[:, sling]).sum(axis=1)
    radius = clearance.bodies.below + float(np.linalg.norm(clearance.bodies.hook.size))
    # A rope l, its stretch δ and a sling s turned by τ at most; A is the attitude of the rope, AB
    # that of the load, and A' the one that is seen for both. With the share w = s/(l + s) of the
    # turn that is seen, A and A' differ by w τ at most, AB and A' by (1 + w) τ.
    #
    # The centre of the load is l + δ along A and s along AB from the pivot, and is seen l + δ + s
    # along A'. It is off by (l + δ) w τ + s (1 + w) τ = s τ (2 + δ/(l + s)) at most, which is less
    # than 3 s τ, since no rope stretches to twice its length. Load and hook, no point of which is
    # farther from the centre than the radius r, are turned about it by (1 + w) τ < 2 τ: 2 r τ.
    return _Hanging(q, aside=(3.0 * lug + 2.0 * radius) * turned)


def _sections_on_supports(
    lift: GroundLift, run: Trajectory, phases: _Phases
) -> Iterator[tuple[str, _Section]]:
    """Yield the sections before and after the motion in which the load stands, lifts off or is set
    down: "start" or "goal" with the section.
    """
    clearance = lift.lift.clearance
    if "lift-off" in lift.phases:
        support = support_of(clearance, load_corners(lift, run.q[0]))
        yield "start", _Section(slice(phases.motion_begin + 1), support)
    if "set-down" in lift.phases:
        support = support_of(clearance, load_corners(lift, run.q[-1]))
        yield "goal", _Section(slice(phases.motion_end, None), support)


def _slewing_check(lift: GroundLift, q: np.ndarray) -> Check:
    """Check that the jib slews in the angles that are proven free, at coordinates of the crane of
    the plan, shape (rows, n).
    """
    slews = q[:, lift.motion.drives[0]]
    free = lift.lift.slews
    if free.low <= slews.min() and slews.max() <= free.high:
        return Check("Slewing: the jib stays in the angles that are proven free.", True)
    return Check("Slewing: the jib leaves the angles that are proven free.", False)


def load_corners(lift: GroundLift, q: np.ndarray) -> np.ndarray:
    """Return the corners of the load at coordinates of the lift's crane, shape (n,), in the frame
    of the crane [m], shape (8, 3).
    """
    return _corners_at(lift.crane, lift.ground, q)


def _corners_at(crane: Crane, ground: Ground, q: np.ndarray) -> np.ndarray:
    """Return the points of the load that touch a ground, at coordinates of the crane [m], shape
    (points, 3).
    """
    points = crane.payload.lever + np.array(ground.points)
    body = crane.payload.body
    position, _ = body_points(crane.model, crane.data, body, points, q, np.zeros_like(q))
    return position.T


def _falls_of(clearance: Clearance) -> int:
    """Return the number of falls that the site enters, or else the description of the crane; 1 if
    neither does.
    """
    if clearance.site.falls is not None:
        return clearance.site.falls
    return int(clearance.crane.record.get("arguments", {}).get("falls", 1))


def drum_inertia_of(clearance: TowerClearance, load: float) -> float:
    """Return the mass of hoist drum and motor at the rope [kg]: that of the crane, or, if its
    description gives none, a multiple of a load [kg].
    """
    crane = clearance.crane
    drum_inertia = crane.model.armature[clearance.joints.hoist] or _DRUM_MASS_RATIO * load
    return float(crane.record.get("arguments", {}).get("drum_inertia", drum_inertia))


class HookBlock(NamedTuple):
    """A hook block with all that stays with it when a load is released, as a homogeneous box.

    Attributes:
        mass: Its mass [kg].
        size: Its sides along the axes of the load [m], shape (3,).
    """

    mass: float
    size: tuple[float, float, float]


class _HungLoad(NamedTuple):
    """A crane with its load on a rope that stretches.

    Attributes:
        crane: The crane.
        corners: Corners of the box of the load from the centre of mass of all that hangs [m].
        lug: Height of the lug above the centre of the box [m].
    """

    crane: Crane
    corners: list[list[float]]
    lug: float


def _on_rope(
    clearance: TowerClearance, ea: float, hook: HookBlock | None, drum_inertia: float | None
) -> _HungLoad:
    """Return the crane with its load, a box, on a lug below a rope that stretches and reaches the
    ground.

    The joint of the hoist gets a new link, from which the rope, the lug, the sling and at last the
    load hang. Rope and sling have the names that they have in the crane of this project.

    Args:
        clearance: Crane and site of the plan.
        ea: EA of all falls of the rope together [N].
        hook: Hook block between rope and load; None for none.
        drum_inertia: Mass of hoist drum and motor at the rope [kg]; None for that of the crane.

    Raises:
        OutOfRange: If the hook is as heavy as hook and load.
        ModelError: If joints or links of the crane have the names of those of a rope.
    """
    crane = clearance.crane
    hoist = clearance.joints.hoist
    robot = ET.fromstring(crane.urdf)
    hook_attitude = _hook_attitude(crane, hoist)
    sides = np.ptp(clearance.bodies.load @ hook_attitude.T, axis=0).tolist()
    if drum_inertia is None:
        drum_inertia = drum_inertia_of(clearance, crane.payload_mass)
    _remove_inertia_of_load(robot, crane, hoist)
    # Cable length that puts the centre of the load on the level of the ground. The load stands on
    # the ground before, so that no lift needs a longer one.
    to_ground = clearance.height - clearance.site.ground + float(clearance.site.foot[2])
    load = _hang_rope_on_hoist(robot, crane, hoist, drum_inertia, to_ground)

    rope = ET.fromstring(
        _ROPE.format(ea=ea, damping=ROPE_DAMPING, sling_damping=SLING_DAMPING, load=load)
    )
    lug_height = sides[2] / 2.0 + (0.0 if hook is None else hook.size[2])
    lug = pin.SE3(np.eye(3), np.array([0.0, 0.0, lug_height]))
    # The axes of rope and sling are those of the world, as in the crane of this project. The turn
    # of the hook is taken back before them, and made again after them for the shapes of the load.
    stretch_joint = _named(rope, "joint", "rope_stretch_joint")
    set_placement(stretch_joint, pin.SE3(hook_attitude.T, np.zeros(3)))
    load_joint = _named(rope, "joint", "load_joint")
    set_placement(load_joint, lug.inverse() * pin.SE3(hook_attitude, np.zeros(3)))
    hung = _inertia_of_all(crane.payload_mass, sides, hook)
    payload_link = _named(rope, "link", "payload_link")
    payload_link.append(inertial_element(lug.actInv(hung)))
    robot.extend(rope)

    record = {**crane.record, "payload": "sling_tangential_joint"}
    record.pop("arguments", None)
    record["urdf"] = ET.tostring(robot, encoding="unicode")
    corners = np.array(box_corners(*sides)) - hung.lever
    return _HungLoad(load_crane(from_record={"crane": record}), corners.tolist(), lug_height)


def _inertia_of_all(mass: float, sides: Sequence[float], hook: HookBlock | None) -> pin.Inertia:
    """Return the inertia of load and hook about the centre of the load.

    Args:
        mass: Mass of load and hook [kg].
        sides: Sides of the load [m].
        hook: The hook, which stands on the load; None for a load alone.

    Raises:
        OutOfRange: If the hook is as heavy as both.
    """
    if hook is None:
        return pin.Inertia.FromBox(mass, *sides)
    number("mass of the hook", hook.mass, "kg", f"0 to {mass:g}")
    load = pin.Inertia.FromBox(mass - hook.mass, *sides)
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, (sides[2] + hook.size[2]) / 2.0]))
    return load + place.act(pin.Inertia.FromBox(hook.mass, *hook.size))


def _named(robot: ET.Element, kind: str, name: str) -> ET.Element:
    """Return the link or joint of a URDF that has a name."""
    return next(element for element in robot.iterfind(kind) if element.get("name") == name)


def _hook_attitude(crane: Crane, hoist: int) -> np.ndarray:
    """Return the attitude of the frame of the hoist joint in the world with all coordinates at
    zero, shape (3, 3).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, np.zeros(crane.model.nq))
    return data.oMi[hoist + 1].rotation


def _remove_inertia_of_load(robot: ET.Element, crane: Crane, hoist: int) -> None:
    """Remove mass and inertia of all links that move with the hoist joint from a URDF: they are
    those of the load, which gets them as a box on its sling.
    """
    moved_links = {frame.name for frame in crane.model.frames if frame.parentJoint == hoist + 1}
    for link in robot.iterfind("link"):
        inertial = link.find("inertial")
        if link.get("name") in moved_links and inertial is not None:
            link.remove(inertial)


def _hang_rope_on_hoist(
    robot: ET.Element, crane: Crane, hoist: int, drum_inertia: float, cable_length: float
) -> str:
    """Let the hoist joint of a URDF carry the link of the rope instead of the load.

    Args:
        robot: The URDF.
        crane: Its crane.
        hoist: Index of the hoist joint among the coordinates.
        drum_inertia: Mass of drum and motor at the rope [kg].
        cable_length: Length that the cable must reach [m].

    Returns:
        Name of the link that the joint carried.
    """
    joint = _named(robot, "joint", crane.model.names[hoist + 1])
    child = joint.find("child")
    limit = joint.find("limit")
    dynamics = joint.find("dynamics")
    assert child is not None and limit is not None  # see check_urdf
    if dynamics is None:
        dynamics = ET.SubElement(joint, "dynamics")
    dynamics.set("armature", repr(drum_inertia))
    limit.set("upper", repr(max(cable_length, float(crane.upper[hoist]))))
    load = child.get("link", "")
    child.set("link", "rope_link")
    return load


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
    <limit lower="-1.5" upper="1.5" effort="1e7" velocity="10"/>
    <dynamics damping="{sling_damping}"/>
  </joint>
  <joint name="sling_tangential_joint" type="revolute">
    <parent link="sling_link"/> <child link="payload_link"/> <axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1e7" velocity="10"/>
    <dynamics damping="{sling_damping}"/>
  </joint>
  <joint name="load_joint" type="fixed">
    <parent link="payload_link"/> <child link="{load}"/>
  </joint>
  <gazebo reference="rope_stretch_joint"><ropeStiffness>{ea}</ropeStiffness></gazebo>
</robot>"""
"""Rope that stretches, and load on a lug below it, in axes of the world."""


def _largest_pull(crane: Crane, motion: Motion, rows: slice, lug: float) -> float:
    """Return an upper bound of the tension over the weight in rows that begin where the load leaves
    the ground, for a hoist that follows its motion and small strains.

    Let T be the tension, m the mass of the load, and a the hoisting acceleration, upwards positive.
    With D = T/m - g - a, the acceleration of the load less that of the hoist, and the rate w at
    which the rope stretches,

        w' = -D,    D' = ω² w - 2 ζ ω D - a'.

    When the load leaves the ground T is its weight, so that D = -a, and w is the hoisting speed.
    The equations are linear, so that D is the sum of two solutions:

    * One begins with D = 0 and this w, and goes on without a'. That is a load picked up at a
      constant speed, whose largest T has a closed form (`theory.pickup_factor`).
    * The other begins with D = -a and w = 0. Its amplitude R = √(D² + ω² w²) changes by
      R' = -(2 ζ ω D² + D a')/R, which is |a'| at most. So R is never more than |a| at first and all
      changes of a since then, added up.

    T/m - g is D + a. The rope gets shorter and so stiffer, which amplifies D by the root of the
    ratio of the lengths at most.

    Args:
        crane: The crane with a rope that stretches.
        motion: Motion of the crane of the plan.
        rows: Its rows.
        lug: Height of the lug above the centre of the load [m].
    """
    rope = crane.springs.rope
    assert rope is not None
    mass = crane.payload_mass
    hoist = motion.drives[2]
    a = -motion.a[rows, hoist]
    lengths = motion.q[rows, hoist] - lug
    omega = theory.rope_bounce(float(rope.stiffness), float(lengths.min()), mass)
    damping_ratio = min(ROPE_DAMPING / (2.0 * mass * omega), _MAX_DAMPING_RATIO)
    picked_up = theory.pickup_factor(
        -float(motion.v[rows, hoist][0]), omega, crane.gravity, damping_ratio
    )
    change = a + np.cumsum(np.abs(np.diff(a, prepend=0.0)))
    stiffening = math.sqrt(float(lengths[0] / lengths.min()))
    return picked_up + stiffening * float(change.max()) / crane.gravity


def _below(crane: Crane, drives: np.ndarray, lug: float) -> State:
    """Return the state in which the load is below the trolley, at a place of the plan."""
    q = np.zeros(crane.layout.n)
    q[crane.layout.drives] = drives - [0.0, 0.0, lug]
    return State(q, 0.0 * q)


def _standing(crane: Crane, ground: Ground, drives: np.ndarray, lug: float) -> State:
    """Return the state in which the load stands below the trolley, at a place of the plan."""
    return standing(crane, ground, _below(crane, drives, lug))
