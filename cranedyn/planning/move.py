"""A move as an optimal control problem on the full model: states, constraints and first plans."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import BPoly

from cranedyn.checks import number
from cranedyn.dynamics.bodies import bodies
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.dynamics.pinocchio import holding_effort, payload_position
from cranedyn.dynamics.scalars import array
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.planning import transcription
from cranedyn.planning.curve import interpolate_columns, rest_to_rest_time
from cranedyn.planning.half_spaces import HalfSpaces
from cranedyn.planning.transcription import ca
from cranedyn.plant import rigid_body
from cranedyn.references.motion import Motion

_TAUT = 0.1
"""Least tension of the rope, as a share of the payload's weight."""

_SIZE = {"revolute": 1.0, "prismatic": 10.0}
"""Scale of the position of a drive [rad or m], by its kind."""

PLUMB = 1e-9
"""Largest distance from equilibrium of an elastic crane at rest [rad or m]."""

_INSIDE = 1e-3
"""Margin of drives to the ends of their ranges [rad or m], where start and goal keep it: ranges are
kept at points of a plan, and between these motions curve by 3e-5 m; a controller adds as much."""

_WITHIN = 0.02
"""Share by which the rope leans less than the site allows, for its motion between points."""


@dataclass(frozen=True)
class Preference:
    """Weights that decide among motions that are nearly as fast as each other.

    The cost of an instant is the weighted mean of squares, each of a share: every swing of its
    bound, every acceleration and jerk of a drive of its limit. It lies between 0 and 1, so that a
    move lasts no longer than the least time and the share `longer` of it.

    Attributes:
        swing: Weight of each swing.
        acceleration: Weight of each acceleration of a drive.
        jerk: Weight of each jerk of a drive.
        longer: Weight of the cost, as a share of the least time.
    """

    swing: float = 1.0
    acceleration: float = 1e-2
    jerk: float = 9e-4
    longer: float = 1e-3

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If a weight is negative or all are zero, or the share is not from 0 to 0.1.
        """
        for name in ("swing", "acceleration", "jerk"):
            number(f"weight of the {name}", getattr(self, name), "", ">= 0")
        number("sum of the weights", self.swing + self.acceleration + self.jerk, "", "> 0")
        number("longer", self.longer, "", "0 to 0.1")


USUAL = Preference()
"""Little swing for up to a thousandth of the time; quiet drives where it makes no difference."""


@dataclass(frozen=True, eq=False)
class Move:
    """A move of a crane under limits.

    Attributes:
        crane: The crane.
        start: First state.
        goal: Last state.
        drives: Indices of the drives that move, among the drives.
        rate: Limits of their rates, shape (m,).
        acceleration: Limits of their accelerations, shape (m,).
        jerk: Limits of their jerks, shape (m,); None for drives whose acceleration may jump.
        swing: Bound of each swing [rad].
        preference: Weights of the cost.
        tilt: Bound of the angle of the rope from plumb [rad]; None for none.
        given_ranges: Least and largest coordinates, shape (2, n); None for those of the crane.
    """

    crane: Crane
    start: State
    goal: State
    drives: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray | None
    swing: float
    preference: Preference
    tilt: float | None = None
    given_ranges: np.ndarray | None = None

    @property
    def ranges(self) -> np.ndarray:
        """Least and largest coordinates, shape (2, n)."""
        if self.given_ranges is not None:
            return self.given_ranges
        ends = np.array([self.start.q, self.goal.q])
        lower = np.minimum(self.crane.lower + _INSIDE, ends.min(axis=0))
        upper = np.maximum(self.crane.upper - _INSIDE, ends.max(axis=0))
        return np.array([lower, upper])

    @property
    def joints(self) -> list[int]:
        """Indices of the joints of the drives that move, among the coordinates."""
        return [int(joint) for joint in self.crane.layout.drives[self.drives]]

    def drives_of(self, states: np.ndarray) -> np.ndarray:
        """Return the positions of all drives, shape (n, drives), in states of a plan."""
        layout, m = self.crane.layout, len(self.drives)
        positions = np.tile(self.start.q[layout.drives], (len(states), 1))
        first = 2 * len(layout.passive)
        positions[:, self.drives] = states[:, first : first + m]
        return positions


def is_at_rest(crane: Crane, state: State) -> bool:
    """Return whether nothing moves, and gravity and springs balance at the passive joints."""
    off = np.abs(state.q - crane.hanging(state.q)).max(initial=0.0)
    return bool(not state.v.any() and off <= PLUMB)


def rnea(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Return generalized forces [N m or N], shape (n,), that cause accelerations, on symbols: as
    `pin.rnea` damping and friction not counted, gravity and armature counted.

    Args:
        model: A model whose joints have one coordinate each; the only source of the numbers.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
        a: Their accelerations, shape (n,).
    """
    tree = bodies(model)
    tree = tree.with_numbers(tree.numbers().tolist())
    angles, rates, accelerations = (array(ca.vertsplit(ca.densify(column))) for column in (q, v, a))
    frames = rigid_body.frames(tree, angles)
    return ca.vertcat(*rigid_body.tree_inverse_dynamics(tree, frames, rates, accelerations))


def hybrid_dynamics(
    crane: Crane, q: ca.SX, v: ca.SX, drive_acceleration: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return accelerations of all joints when those of the drives are given, and the drive efforts
    that this costs.

    The same as `cranedyn.dynamics.pinocchio.prescribed_acceleration`, on symbols: shapes (n,),
    (n,), (m,) to (n,) and (m,). An elastic rope is taut.
    """
    drives, passive = crane.layout.drives.tolist(), crane.layout.passive.tolist()
    a, free = ca.SX(crane.layout.n, 1), ca.SX.sym("free", len(passive))
    a[drives], a[passive] = drive_acceleration, free
    angles, rates = (array(ca.vertsplit(ca.densify(column))) for column in (q, v))
    joint = replace(JointForces.of(crane), taut=True)
    force = rnea(crane.model, q, v, a) - ca.vertcat(*joint.effort(angles, rates))
    mass, force = ca.jacobian(force, free), ca.substitute(force, free, np.zeros(len(passive)))
    solved = -ca.solve(mass[passive, :], force[passive])
    a[passive] = solved
    return a, (force + mass @ solved)[drives]


def problem(move: Move, spaces: HalfSpaces | None = None) -> transcription.Problem:
    """Return the problem of a move.

    State: passive joints, their rates, then positions, rates and, where there is a ramp,
    accelerations of the drives that move. Control: jerks of these drives, or their accelerations.
    """
    crane, layout = move.crane, move.crane.layout
    ramp, passive = move.jerk is not None, layout.passive.tolist()
    m, p = len(move.drives), len(passive)
    sizes = [p, p, m, m, m][: 5 if ramp else 4]
    x, u, gap = ca.SX.sym("x", sum(sizes)), ca.SX.sym("u", m), ca.SX.sym("gap")
    free, free_rate, position, rate, *drive_acceleration = ca.vertsplit(
        x, np.cumsum([0, *sizes]).tolist()
    )
    acceleration = drive_acceleration[0] if ramp else u
    q, v, a = ca.SX(move.start.q), ca.SX(layout.n, 1), ca.SX(layout.m, 1)
    q[passive], q[move.joints] = free, position
    v[passive], v[move.joints] = free_rate, rate
    a[move.drives.tolist()] = acceleration
    full, effort = hybrid_dynamics(crane, q, v, a)
    swings = np.isin(layout.passive, crane.swings)
    angle, angle_rate = (column[np.flatnonzero(swings).tolist()] for column in (free, free_rate))
    moved, moving = (column[layout.drives.tolist()] for column in (q, v))
    angle = angle - crane.rest.angle - crane.rest.slope @ moved
    angle_rate = angle_rate - crane.rest.slope @ moving
    # Between two points a parabola stays below the higher of them or the crossing of its tangents,
    # half a gap ahead.
    ahead = angle + gap / 2.0 * angle_rate
    share_terms = [ahead / move.swing, effort / crane.effort_limit]
    if ramp:  # else rates are straight lines between points
        share_terms.append((rate + gap / 2.0 * acceleration) / move.rate)
    if move.tilt is not None:
        largest = (move.tilt * (1.0 - _WITHIN)) ** 2
        share_terms += [ca.sumsqr(angles) / largest for angles in (angle, ahead)]
    lower, upper = move.ranges
    bound, any_rate = np.full(p, np.inf), np.full(p, np.inf)
    bound[swings] = move.swing
    if crane.rest.angle.any() or crane.rest.slope.any():
        bound[swings] = np.inf  # the bound moves with the drives
        share_terms.append(angle / move.swing)
    shares, hoist = ca.vertcat(*share_terms), layout.drive_of("hoist")
    nonnegative = [] if spaces is None else [spaces.margins(q)]
    if hoist is not None:
        cable = int(layout.drives[hoist])
        holding = abs(holding_effort(crane, move.start.q)[hoist])
        opposing = JointForces.of(crane).resistance_of(cable, v[cable])
        nonnegative.append((opposing - effort[hoist]) / holding - _TAUT)
    margins = ca.vertcat(*nonnegative)
    kinds = [move.rate, move.acceleration][: len(sizes) - 3]
    negative = [-limits for limits in kinds]
    low = [np.maximum(-bound, lower[passive]), -any_rate, lower[move.joints], *negative]
    high = [np.minimum(bound, upper[passive]), any_rate, upper[move.joints], *kinds]
    control = move.acceleration if move.jerk is None else move.jerk
    ones, none = np.ones(shares.numel()), np.zeros(margins.numel())
    path_bounds = [np.concatenate([-ones, none]), np.concatenate([ones, none + np.inf])]
    drive_scale = [_SIZE[layout.driven[drive].kind] for drive in move.drives]
    return transcription.Problem(
        x=x,
        u=u,
        gap=gap,
        rates=ca.vertcat(free_rate, full[passive], rate, *drive_acceleration, u),
        cost=1.0 + move.preference.longer * _cost(move, angle, acceleration, u),
        path=ca.vertcat(shares, margins),
        bounds=np.array([np.concatenate(low), np.concatenate(high)]),
        control_bounds=np.array([-control, control]),
        path_bounds=np.array(path_bounds),
        scale=np.concatenate([np.full(2 * p, 0.1), drive_scale, *kinds]),
        parameters=None if spaces is None else spaces.symbols,
        values=None if spaces is None else spaces.values,
    )


def _cost(move: Move, angle: ca.SX, acceleration: ca.SX, u: ca.SX) -> ca.SX:
    """Return the cost of an instant, from 0 to 1, see `Preference`."""
    terms = [
        (move.preference.swing, angle / move.swing),
        (move.preference.acceleration, acceleration / move.acceleration),
    ]
    if move.jerk is not None:
        terms.append((move.preference.jerk, u / move.jerk))
    largest = sum(weight * term.numel() for weight, term in terms)
    squares = [weight * ca.sumsqr(term) for weight, term in terms]
    return ca.sum1(ca.vertcat(*squares)) / (largest or 1.0)


def periods(move: Move) -> tuple[float, float]:
    """Return the longest and the shortest period of the passive joints with the drives at rest, at
    either end [s].
    """
    if not len(move.crane.layout.passive):
        return 0.0, math.inf
    still = np.zeros(move.crane.layout.n)
    rests = (State(move.crane.hanging(end.q), still) for end in (move.start, move.goal))
    rates = np.concatenate([free_modes(move.crane, state).frequencies for state in rests])
    return 2.0 * math.pi / float(rates.min()), 2.0 * math.pi / float(rates.max())


def estimated_duration(move: Move, slowest: float) -> float:
    """Return an estimate of the least time [s]: trapezoids of the rates, slow enough for the swing;
    the longest period at least.
    """
    crane, layout = move.crane, move.crane.layout
    reach = max(
        float(np.hypot(*payload_position(crane, end.q)[:2])) for end in (move.start, move.goal)
    )
    distance = np.abs(move.goal.q - move.start.q)[move.joints]
    gentle = crane.gravity * move.swing
    joints = [layout.driven[drive] for drive in move.drives]
    swing_limits = [
        math.inf if joint.role == "hoist" else gentle / (reach if joint.kind == "revolute" else 1.0)
        for joint in joints
    ]
    acceleration = np.minimum(move.acceleration, swing_limits)
    trapezoids = rest_to_rest_time(distance, move.rate, acceleration)
    changes = np.abs(move.goal.v - move.start.v)[move.joints] / acceleration
    return max(slowest, float((trapezoids + changes).max()))


def straight_plan(move: Move, duration: float, count: int) -> transcription.CollocationPlan:
    """Return a polynomial of the drives over a count of intervals, with the swing interpolated
    between start and goal.
    """
    durations = np.full(count, duration / count)
    times = transcription.times(durations)
    start, goal = move.start, move.goal
    joints, passive = move.joints, move.crane.layout.passive
    ends = [[end.q[joints], end.v[joints], 0.0 * end.v[joints]] for end in (start, goal)]
    curve = BPoly.from_derivatives([0.0, duration], np.array(ends))
    s = (times / duration)[:, None]
    swing = [
        (1.0 - s) * first[passive] + s * last[passive]
        for first, last in ((start.q, goal.q), (start.v, goal.v))
    ]
    return _plan(move, durations, swing, [curve(times, order) for order in range(3)])


def plan_of_motion(move: Move, motion: Motion, count: int) -> transcription.CollocationPlan:
    """Return a motion from the start to the goal of a move as a plan of a count of intervals."""
    durations = np.full(count, motion.arrival / count)
    times = transcription.times(durations)
    rows = motion.period * np.arange(len(motion.q))
    tables = [interpolate_columns(times, rows, table) for table in (motion.q, motion.v, motion.a)]
    none = 0.0 * move.start.q
    ends = zip((*move.start, none), (*move.goal, none), strict=True)
    for table, (first, last) in zip(tables, ends, strict=True):
        table[0], table[-1] = first, last
    swing = [table[:, move.crane.layout.passive] for table in tables[:2]]
    return _plan(move, durations, swing, [table[:, move.joints] for table in tables])


def _plan(
    move: Move, durations: np.ndarray, swing: list[np.ndarray], drives: list[np.ndarray]
) -> transcription.CollocationPlan:
    """Return a plan of passive joints and drives, with their rates and accelerations."""
    ends = drives[2][::3] if move.jerk is not None else drives[1][::3]
    controls = np.diff(ends, axis=0) / durations[:, None]
    derivatives = drives if move.jerk is not None else drives[:2]
    return transcription.CollocationPlan(durations, controls, np.hstack([*swing, *derivatives]))
