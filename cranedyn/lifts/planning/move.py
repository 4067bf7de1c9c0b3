"""A move as an optimal control problem on the full model: states, constraints and first plans.

The unknown motion is a plan, see `cranedyn.lifts.planning.transcription`. Its control is the jerk
of the drives that move, or their acceleration where there is no ramp. Its state is given by
`PlanStateLayout`. The swing follows from the accelerations of the drives by `hybrid_dynamics`.

The functions `rnea`, `hybrid_dynamics` and `problem` build expressions in CasADi's symbols; the
others work on numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.interpolate import BPoly

from cranedyn.checks import number
from cranedyn.compiled.plant import rigid_body
from cranedyn.dynamics.bodies import bodies_of_model
from cranedyn.dynamics.equations_of_motion import holding_effort, payload_position
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.dynamics.scalars import array
from cranedyn.interfaces import State
from cranedyn.lifts.planning import transcription
from cranedyn.lifts.planning.curve import interpolate_columns, rest_to_rest_time
from cranedyn.lifts.planning.half_spaces import HalfSpaces
from cranedyn.lifts.planning.transcription import ca
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion

_MIN_TENSION_RATIO = 0.1
"""Least tension of the rope, as a share of the force that holds the load at the start."""

_DRIVE_SCALE = {"revolute": 1.0, "prismatic": 10.0}
"""Scale of the position of a drive in the program [rad or m], by the kind of its joint."""

_PASSIVE_SCALE = 0.1
"""Scale of the passive coordinates and of their rates in the program [rad or m, per s]."""

BALANCE_TOLERANCE = 1e-9
"""Largest distance of a passive coordinate from its equilibrium up to which a state is at rest [rad
or m]."""

_RANGE_MARGIN = 1e-3
"""Margin of drives to the ends of their ranges [rad or m], where start and goal keep it.

Ranges are kept at the points of a plan. Between these, motions curve by 3e-5 m, and a controller
that tracks them adds as much.
"""

_TILT_MARGIN = 0.02
"""Share by which the rope leans less than the site allows, for its motion between the points."""


@dataclass(frozen=True)
class Preference:
    """Weights that decide among motions that are nearly as fast as each other.

    The cost of an instant is the weighted mean of the squares of shares: of each swing in its
    bound, and of each acceleration and jerk of a drive in its limit. It lies between 0 and 1. What
    is minimised is the integral over 1 + `longer` times this cost, so that a move lasts no longer
    than 1 + `longer` times the least time.

    Attributes:
        swing: Weight of each swing.
        acceleration: Weight of each acceleration of a drive.
        jerk: Weight of each jerk of a drive.
        longer: Weight of the cost beside the time, which has the weight 1.
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
        moving_drives: Indices of the m drives that move, among all drives of the crane.
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
    moving_drives: np.ndarray
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
        lower = np.minimum(self.crane.lower + _RANGE_MARGIN, ends.min(axis=0))
        upper = np.maximum(self.crane.upper - _RANGE_MARGIN, ends.max(axis=0))
        return np.array([lower, upper])

    @property
    def joints(self) -> list[int]:
        """Indices of the joints of the drives that move, among the coordinates."""
        return [int(joint) for joint in self.crane.layout.drives[self.moving_drives]]

    @property
    def has_ramp(self) -> bool:
        """Whether accelerations change continuously, by a limited jerk; else they jump."""
        return self.jerk is not None

    @property
    def state_layout(self) -> PlanStateLayout:
        """Order of the numbers in a state of a plan of this move."""
        return PlanStateLayout(
            passive_count=len(self.crane.layout.passive),
            drive_count=len(self.moving_drives),
            has_ramp=self.has_ramp,
        )

    def drive_positions(self, states: np.ndarray) -> np.ndarray:
        """Return the positions of all drives of the crane [rad or m], shape (k, drives), in states
        of a plan, shape (k, nx). Drives that do not move are where they start.
        """
        still = self.start.q[self.crane.layout.drives]
        positions = np.tile(still, (len(states), 1))
        positions[:, self.moving_drives] = states[:, self.state_layout.position]
        return positions


@dataclass(frozen=True)
class PlanStateLayout:
    """Order of the numbers in a state of a plan.

    A state holds, one after another, the p passive coordinates, their rates, and the positions,
    rates and, where there is a ramp, accelerations of the m drives that move. Without a ramp the
    accelerations are the control and no part of the state.

    Attributes:
        passive_count: Number of passive joints, p.
        drive_count: Number of drives that move, m.
        has_ramp: Whether the accelerations are in the state.
    """

    passive_count: int
    drive_count: int
    has_ramp: bool

    @property
    def passive(self) -> slice:
        """Where the passive coordinates are."""
        return slice(0, self.passive_count)

    @property
    def passive_rate(self) -> slice:
        """Where the rates of the passive coordinates are."""
        return slice(self.passive_count, 2 * self.passive_count)

    @property
    def position(self) -> slice:
        """Where the positions of the drives are."""
        first = self.passive_rate.stop
        return slice(first, first + self.drive_count)

    @property
    def rate(self) -> slice:
        """Where the rates of the drives are."""
        first = self.position.stop
        return slice(first, first + self.drive_count)

    @property
    def acceleration(self) -> slice:
        """Where the accelerations of the drives are; empty without a ramp."""
        first = self.rate.stop
        return slice(first, first + self.drive_count if self.has_ramp else first)

    @property
    def size(self) -> int:
        """Length of a state, nx."""
        return self.acceleration.stop

    def pack(
        self,
        passive: np.ndarray,
        passive_rate: np.ndarray,
        position: np.ndarray,
        rate: np.ndarray,
        acceleration: np.ndarray,
    ) -> np.ndarray:
        """Return states, shape (nx,) or (k, nx), of their parts, shape (p,) or (m,), or k rows of
        these. Without a ramp the acceleration is left out.
        """
        parts = [passive, passive_rate, position, rate]
        if self.has_ramp:
            parts.append(acceleration)
        return np.concatenate(parts, axis=-1)


def is_at_rest(crane: Crane, state: State) -> bool:
    """Return whether nothing moves, and gravity and springs balance at the passive joints."""
    off = np.abs(state.q - crane.hanging(state.q)).max(initial=0.0)
    return bool(not state.v.any() and off <= BALANCE_TOLERANCE)


def rnea(model: pin.Model, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
    """Return generalized forces [N m or N], shape (n,), that cause accelerations, on symbols: as
    `pin.rnea` damping and friction not counted, gravity and armature counted.

    Args:
        model: A model whose joints have one coordinate each; the only source of the numbers.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
        a: Their accelerations, shape (n,).
    """
    tree = bodies_of_model(model)
    # The same numbers as Python objects, which symbols can be combined with.
    tree = tree.with_numbers(tree.numbers().tolist())
    angles = _elements(q)
    rates = _elements(v)
    accelerations = _elements(a)
    frames = rigid_body.frames(tree, angles)
    return ca.vertcat(*rigid_body.tree_inverse_dynamics(tree, frames, rates, accelerations))


def _elements(column: ca.SX) -> np.ndarray:
    """Return the elements of a column, structural zeros included, as an array of objects."""
    return array(ca.vertsplit(ca.densify(column)))


def hybrid_dynamics(
    crane: Crane, q: ca.SX, v: ca.SX, drive_acceleration: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return accelerations of all joints when those of the drives are given, and the drive efforts
    that this costs.

    The same as `cranedyn.dynamics.equations_of_motion.prescribed_acceleration`, on symbols, but
    that an elastic rope is always taut.

    Args:
        crane: The crane, with n joints, m of them drives.
        q: Coordinates [rad or m], shape (n,).
        v: Their rates, shape (n,).
        drive_acceleration: Accelerations of the drives, shape (m,).

    Returns:
        Accelerations of all joints, shape (n,), and efforts of the drives, shape (m,).
    """
    layout = crane.layout
    drives = layout.drives.tolist()
    passive = layout.passive.tolist()
    passive_acceleration = ca.SX.sym("free", len(passive))
    a = ca.SX(layout.n, 1)
    a[drives] = drive_acceleration
    a[passive] = passive_acceleration

    # A rope that goes slack would be a choice, at which an expression has no derivative. The plan
    # keeps the rope taut anyway.
    joint_forces = replace(JointForces.of(crane), taut=True)
    joint_effort = joint_forces.effort(_elements(q), _elements(v))
    effort = rnea(crane.model, q, v, a) - ca.vertcat(*joint_effort)

    # The efforts are linear in the accelerations of the passive joints: M a + b, with M the columns
    # of the mass matrix of the passive joints, and b the efforts at a = 0. No drive acts on these
    # joints, so that their rows are zero, and M_pp a = -b_p gives the accelerations.
    mass_columns = ca.jacobian(effort, passive_acceleration)
    remaining_effort = ca.substitute(effort, passive_acceleration, np.zeros(len(passive)))
    solved = -ca.solve(mass_columns[passive, :], remaining_effort[passive])
    a[passive] = solved
    return a, (remaining_effort + mass_columns @ solved)[drives]


@dataclass(frozen=True, eq=False)
class _CraneSymbols:
    """The crane at one point of a plan, as expressions in its state, its control and the gap.

    Attributes:
        x: State, symbols, shape (nx,).
        u: Control, symbols, shape (m,).
        gap: Time to the next point [s], a symbol.
        rate: Rates of the drives that move, shape (m,).
        acceleration: Their accelerations, shape (m,).
        q: All coordinates, shape (n,).
        v: Their rates, shape (n,).
        effort: Efforts of all drives of the crane, shape (drives,).
        state_rate: dx/dt, shape (nx,).
        deviation: Swing angles from those at rest [rad], shape (swings,).
        deviation_rate: Their rates [rad/s], shape (swings,).
    """

    x: ca.SX
    u: ca.SX
    gap: ca.SX
    rate: ca.SX
    acceleration: ca.SX
    q: ca.SX
    v: ca.SX
    effort: ca.SX
    state_rate: ca.SX
    deviation: ca.SX
    deviation_rate: ca.SX


def _ahead(value: ca.SX, rate: ca.SX, gap: ca.SX) -> ca.SX:
    """Return a value f half a gap h ahead on its tangent, f + h/2 f'.

    To second order a quantity is a parabola f between two points. Where it curves upwards, it is
    largest at one of the points. Where it curves downwards, it stays below the tangents at both
    points, f(t) ≤ f_k + (t - t_k) f'_k, and the tangents of a parabola cross in the middle. So it
    keeps a limit between the points if it does at them, and the tangents do half a gap ahead.
    """
    return value + gap / 2.0 * rate


def problem(move: Move, spaces: HalfSpaces | None = None) -> transcription.Problem:
    """Return the optimal control problem of a move.

    The state is ordered as in `PlanStateLayout`. The control is the jerks of the drives that move,
    or their accelerations where there is no ramp.

    Args:
        move: The move.
        spaces: Half spaces that keep crane and obstacles apart; None for no obstacles.
    """
    symbols = _crane_symbols(move)
    shares = _limit_shares(move, symbols)
    margins = _margins(move, symbols, spaces)
    control_limit = move.acceleration if move.jerk is None else move.jerk
    return transcription.Problem(
        x=symbols.x,
        u=symbols.u,
        gap=symbols.gap,
        rates=symbols.state_rate,
        cost=1.0 + move.preference.longer * _cost(move, symbols),
        path=ca.vertcat(shares, margins),
        bounds=_state_bounds(move),
        control_bounds=np.array([-control_limit, control_limit]),
        path_bounds=_path_bounds(shares.numel(), margins.numel()),
        scale=_state_scale(move),
        parameters=None if spaces is None else spaces.symbols,
        values=None if spaces is None else spaces.values,
    )


def _crane_symbols(move: Move) -> _CraneSymbols:
    """Return the crane at one point of a plan, as expressions."""
    crane = move.crane
    layout = crane.layout
    passive = layout.passive.tolist()
    drives = layout.drives.tolist()

    order = move.state_layout
    x = ca.SX.sym("x", order.size)
    u = ca.SX.sym("u", len(move.moving_drives))
    passive_rate = x[order.passive_rate]
    rate = x[order.rate]
    acceleration = x[order.acceleration] if move.has_ramp else u

    q = ca.SX(move.start.q)
    q[passive] = x[order.passive]
    q[move.joints] = x[order.position]
    v = ca.SX(layout.n, 1)
    v[passive] = passive_rate
    v[move.joints] = rate
    drive_acceleration = ca.SX(layout.m, 1)
    drive_acceleration[move.moving_drives.tolist()] = acceleration
    joint_acceleration, effort = hybrid_dynamics(crane, q, v, drive_acceleration)

    # Where springs carry the load, the angles at rest depend on where the drives are.
    swings = np.flatnonzero(_is_swing(crane)).tolist()
    deviation = x[order.passive][swings] - crane.rest.angle - crane.rest.slope @ q[drives]
    deviation_rate = passive_rate[swings] - crane.rest.slope @ v[drives]
    return _CraneSymbols(
        x=x,
        u=u,
        gap=ca.SX.sym("gap"),
        rate=rate,
        acceleration=acceleration,
        q=q,
        v=v,
        effort=effort,
        state_rate=ca.vertcat(
            passive_rate, joint_acceleration[passive], rate, x[order.acceleration], u
        ),
        deviation=deviation,
        deviation_rate=deviation_rate,
    )


def _is_swing(crane: Crane) -> np.ndarray:
    """Return which of the passive joints swing, shape (p,)."""
    return np.isin(crane.layout.passive, crane.swings)


def _rest_moves(crane: Crane) -> bool:
    """Return whether the swing angles at rest are not zero, or depend on the drives."""
    return bool(crane.rest.angle.any() or crane.rest.slope.any())


def _limit_shares(move: Move, symbols: _CraneSymbols) -> ca.SX:
    """Return quantities over their limits, which must stay from -1 to 1."""
    deviation_ahead = _ahead(symbols.deviation, symbols.deviation_rate, symbols.gap)
    shares = [
        deviation_ahead / move.swing,
        symbols.effort / move.crane.effort_limit,
    ]
    # Without a ramp the rates are straight lines between the points, and their bounds suffice.
    if move.has_ramp:
        shares.append(_ahead(symbols.rate, symbols.acceleration, symbols.gap) / move.rate)
    if move.tilt is not None:
        # Only a tower crane has obstacles. At rest its load hangs plumb, so that its deviation is
        # the two swing angles. The root of the sum of their squares is never less than the angle
        # from plumb α, since cos α is the product of their cosines. Squares are bounded, since the
        # root has no derivative where the load hangs plumb.
        largest_square = (move.tilt * (1.0 - _TILT_MARGIN)) ** 2
        shares.append(ca.sumsqr(symbols.deviation) / largest_square)
        shares.append(ca.sumsqr(deviation_ahead) / largest_square)
    if _rest_moves(move.crane):
        # The bound of the swing moves with the drives, so that `_state_bounds` cannot express it.
        shares.append(symbols.deviation / move.swing)
    return ca.vertcat(*shares)


def _margins(move: Move, symbols: _CraneSymbols, spaces: HalfSpaces | None) -> ca.SX:
    """Return quantities that must not be negative: distances to obstacles [m], and the tension of
    the rope beyond the least, as a share of the force that holds the load.
    """
    layout = move.crane.layout
    margins = []
    if spaces is not None:
        margins.append(spaces.margins(symbols.q))
    hoist = layout.drive_of("hoist")
    if hoist is not None:
        # The hoist pulls against the tension, and damping and friction of its joint against the
        # rate of the cable length, see `cranedyn.dynamics.joint_forces.rope_tension`.
        cable = int(layout.drives[hoist])
        resistance = JointForces.of(move.crane).resistance_of(cable, symbols.v[cable])
        tension = resistance - symbols.effort[hoist]
        holding_force = abs(holding_effort(move.crane, move.start.q)[hoist])
        margins.append(tension / holding_force - _MIN_TENSION_RATIO)
    return ca.vertcat(*margins)


def _path_bounds(share_count: int, margin_count: int) -> np.ndarray:
    """Return the bounds of `_limit_shares` and after them `_margins`, shape (2, shares +
    margins).
    """
    ones = np.ones(share_count)
    zeros = np.zeros(margin_count)
    unbounded = np.full(margin_count, np.inf)
    return np.array([np.concatenate([-ones, zeros]), np.concatenate([ones, unbounded])])


def _state_bounds(move: Move) -> np.ndarray:
    """Return the least and the largest state, shape (2, nx): ranges of the joints, bound of the
    swing, and limits of the drives.
    """
    crane = move.crane
    order = move.state_layout
    passive = crane.layout.passive
    lowest, highest = move.ranges

    swing_bound = np.full(order.passive_count, np.inf)
    if not _rest_moves(crane):
        swing_bound[_is_swing(crane)] = move.swing
    any_rate = np.full(order.passive_count, np.inf)
    lower = order.pack(
        passive=np.maximum(-swing_bound, lowest[passive]),
        passive_rate=-any_rate,
        position=lowest[move.joints],
        rate=-move.rate,
        acceleration=-move.acceleration,
    )
    upper = order.pack(
        passive=np.minimum(swing_bound, highest[passive]),
        passive_rate=any_rate,
        position=highest[move.joints],
        rate=move.rate,
        acceleration=move.acceleration,
    )
    return np.array([lower, upper])


def _state_scale(move: Move) -> np.ndarray:
    """Return the size of each number of a state, shape (nx,), by which the program is scaled."""
    order = move.state_layout
    driven = move.crane.layout.driven
    position_scale = [_DRIVE_SCALE[driven[drive].kind] for drive in move.moving_drives]
    passive_scale = np.full(order.passive_count, _PASSIVE_SCALE)
    return order.pack(
        passive=passive_scale,
        passive_rate=passive_scale,
        position=np.array(position_scale),
        rate=move.rate,
        acceleration=move.acceleration,
    )


def _cost(move: Move, symbols: _CraneSymbols) -> ca.SX:
    """Return the cost of an instant, from 0 to 1, see `Preference`."""
    terms = [
        (move.preference.swing, symbols.deviation / move.swing),
        (move.preference.acceleration, symbols.acceleration / move.acceleration),
    ]
    if move.jerk is not None:
        terms.append((move.preference.jerk, symbols.u / move.jerk))
    # The weighted sum of squares where every term is at its limit.
    largest = sum(weight * term.numel() for weight, term in terms)
    squares = [weight * ca.sumsqr(term) for weight, term in terms]
    # It is 0 if only swings have a weight and the crane has none; the cost is then 0, too.
    return ca.sum1(ca.vertcat(*squares)) / (largest or 1.0)


def periods(move: Move) -> tuple[float, float]:
    """Return the longest and the shortest period of the passive joints [s], with the drives at
    rest at start or goal; 0 and infinity without passive joints.
    """
    layout = move.crane.layout
    if not len(layout.passive):
        return 0.0, math.inf
    frequencies = []
    for end in (move.start, move.goal):
        rest = State(move.crane.hanging(end.q), np.zeros(layout.n))
        frequencies.append(free_modes(move.crane, rest).frequencies)
    rates = np.concatenate(frequencies)
    return 2.0 * math.pi / float(rates.min()), 2.0 * math.pi / float(rates.max())


def estimated_duration(move: Move, slowest: float) -> float:
    """Return an estimate of the least duration of a move [s].

    The slowest drive takes a trapezoid of its rate, and the time to change its rate from that of
    the start to that of the goal. The estimate is the longest period at least, since no swing comes
    to rest in much less.

    Args:
        move: The move.
        slowest: Longest period of the passive joints [s].
    """
    crane = move.crane
    distance = np.abs(move.goal.q - move.start.q)[move.joints]
    radii = [
        float(np.hypot(*payload_position(crane, end.q)[:2])) for end in (move.start, move.goal)
    ]
    radius = max(radii)

    # An acceleration a of the pivot makes the rope lean by a/g where the load follows it, which may
    # be the bound of the swing. The pivot of a slewing drive accelerates by its angular
    # acceleration times the radius, here that of the load.
    pivot_acceleration = crane.gravity * move.swing
    gentle = []
    for drive in move.moving_drives:
        joint = crane.layout.driven[drive]
        if joint.role == "hoist":
            gentle.append(math.inf)
        elif joint.kind == "revolute":
            gentle.append(pivot_acceleration / radius)
        else:
            gentle.append(pivot_acceleration)
    acceleration = np.minimum(move.acceleration, gentle)

    trapezoids = rest_to_rest_time(distance, move.rate, acceleration)
    rate_changes = np.abs(move.goal.v - move.start.v)[move.joints] / acceleration
    return max(slowest, float((trapezoids + rate_changes).max()))


def straight_plan(move: Move, duration: float, count: int) -> transcription.CollocationPlan:
    """Return a first plan of a duration [s] over a count of equal intervals.

    The drives follow polynomials of fifth degree, with the positions and rates of start and goal
    and without acceleration there. The swing is interpolated linearly between start and goal.
    """
    durations = np.full(count, duration / count)
    times = transcription.times(durations)
    drive_ends = []
    for end in (move.start, move.goal):
        rate = end.v[move.joints]
        drive_ends.append([end.q[move.joints], rate, np.zeros_like(rate)])
    curve = BPoly.from_derivatives([0.0, duration], np.array(drive_ends))

    passive = move.crane.layout.passive
    share = (times / duration)[:, None]
    return _plan(
        move,
        durations,
        passive=(1.0 - share) * move.start.q[passive] + share * move.goal.q[passive],
        passive_rate=(1.0 - share) * move.start.v[passive] + share * move.goal.v[passive],
        position=curve(times, 0),
        rate=curve(times, 1),
        acceleration=curve(times, 2),
    )


def plan_of_motion(move: Move, motion: Motion, count: int) -> transcription.CollocationPlan:
    """Return a motion from the start to the goal of a move as a plan of a count of equal intervals.

    The first and the last state are exactly start and goal, without acceleration.
    """
    durations = np.full(count, motion.arrival / count)
    times = transcription.times(durations)
    row_times = motion.period * np.arange(len(motion.q))
    q = interpolate_columns(times, row_times, motion.q)
    v = interpolate_columns(times, row_times, motion.v)
    a = interpolate_columns(times, row_times, motion.a)
    for row, end in ((0, move.start), (-1, move.goal)):
        q[row] = end.q
        v[row] = end.v
        a[row] = 0.0

    passive = move.crane.layout.passive
    return _plan(
        move,
        durations,
        passive=q[:, passive],
        passive_rate=v[:, passive],
        position=q[:, move.joints],
        rate=v[:, move.joints],
        acceleration=a[:, move.joints],
    )


def _plan(
    move: Move,
    durations: np.ndarray,
    *,
    passive: np.ndarray,
    passive_rate: np.ndarray,
    position: np.ndarray,
    rate: np.ndarray,
    acceleration: np.ndarray,
) -> transcription.CollocationPlan:
    """Return a plan with one step for each interval, from the parts of its states.

    The control of an interval is the mean jerk over it, or the mean acceleration without a ramp.
    """
    states = move.state_layout.pack(passive, passive_rate, position, rate, acceleration)
    # The last Radau point of an interval is its end.
    at_interval_ends = slice(None, None, transcription.RADAU_POINT_COUNT)
    integral = acceleration if move.has_ramp else rate
    controls = np.diff(integral[at_interval_ends], axis=0) / durations[:, None]
    return transcription.CollocationPlan(durations, controls, states)
