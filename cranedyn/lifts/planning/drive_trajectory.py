"""Drives over time by a plan: polynomials, the motion of the crane that they cause, and bounds for
a proof.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PPoly

from cranedyn.dynamics.equations_of_motion import prescribed_acceleration
from cranedyn.interfaces import State
from cranedyn.lifts.planning import transcription
from cranedyn.lifts.planning.move import Move, is_at_rest
from cranedyn.references.motion import Motion

SAME_TIME_TOLERANCE = 1e-6
"""Difference up to which two times count as the same [s]."""

_RELATIVE_TOLERANCE = 1e-10
"""Relative tolerance of the integration of the swing."""

_ABSOLUTE_TOLERANCE = 1e-12
"""Absolute tolerance of the integration of the swing [rad or m, per s]."""


class DriveTrajectory:
    """All drives over time by a plan; see `cranedyn.lifts.planning.motion_proof.DriveCurve`.

    Over an interval the acceleration of a drive is constant or, where there is a ramp, linear in
    time, so that its rate and position are polynomials of at most second and third degree.

    Attributes:
        nodes: Times at which its intervals begin and end [s], shape (n + 1,).
        duration: Time at which it ends [s].
    """

    def __init__(self, move: Move, plan: transcription.CollocationPlan) -> None:
        """Integrate the controls of a plan: jerks, or accelerations where there is no ramp."""
        layout = move.crane.layout
        self._move = move
        self.nodes = np.concatenate([[0.0], np.cumsum(plan.durations)])
        self.duration = float(self.nodes[-1])

        # Coefficients of a `PPoly` have the shape (degree + 1, intervals, drives).
        controls = np.zeros((1, len(plan.durations), layout.m))
        controls[0][:, move.moving_drives] = plan.controls
        control = PPoly(controls, self.nodes)
        # With a ramp the drives begin without acceleration.
        self._acceleration = control.antiderivative() if move.has_ramp else control
        self._rate = _beginning_at(self._acceleration.antiderivative(), move.start.v[layout.drives])
        self._position = _beginning_at(self._rate.antiderivative(), move.start.q[layout.drives])

        # Each drive has its largest rates at some of these times.
        turning_points = _zeros_of_acceleration(self._acceleration)
        self._extreme_rate_times = np.unique(np.concatenate([self.nodes, turning_points]))

    def at(self, s: float) -> np.ndarray:
        """Return the positions of the drives at a time [s], shape (m,)."""
        return np.asarray(self._position(s))

    def reach(self, first: float, last: float) -> np.ndarray:
        """Return the largest distance of the drives between two times from their positions in the
        middle, shape (m,): by their largest rates, at an end or where they do not accelerate.
        """
        times = self._extreme_rate_times
        between = times[(times > first) & (times < last)]
        rates = self._rate(np.concatenate([[first, last], between]))
        return np.asarray(np.abs(rates).max(axis=0) * (last - first) / 2.0)

    def motion(self, period: float) -> Motion:
        """Return the motion of all joints in rows a period [s] apart.

        The swing is integrated from the equations of motion under these drives, not taken from the
        plan, whose polynomials obey them at its points only. The last row is the goal, at the first
        instant at or after the end.
        """
        move = self._move
        times = period * np.arange(math.ceil((self.duration - SAME_TIME_TOLERANCE) / period))
        positions = []
        rates = []
        accelerations = []
        swing = np.concatenate(
            [move.start.q[move.crane.layout.passive], move.start.v[move.crane.layout.passive]]
        )
        # The integration begins anew with each interval, since the controls jump between them and a
        # step across a jump would lose its order.
        for k, (first, last) in enumerate(itertools.pairwise(self.nodes)):
            if last <= first:
                continue
            row_times = times[(times >= first) & (times < last)]
            swings = self._integrate_swing(k, swing, row_times)
            swing = swings[-1]
            for t, row_swing in zip(row_times.tolist(), swings[:-1], strict=True):
                state = self._state(k, t, row_swing)
                positions.append(state.q)
                rates.append(state.v)
                accelerations.append(self._joint_accelerations(k, t, row_swing))

        positions.append(move.goal.q)
        rates.append(move.goal.v)
        accelerations.append(self._final_acceleration())
        return Motion(
            period,
            np.array(positions),
            np.array(rates),
            np.array(accelerations),
            move.crane.layout.drives,
        )

    def _integrate_swing(self, k: int, swing: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the passive coordinates and their rates at times in interval k and at its end.

        Args:
            k: The interval.
            swing: Passive coordinates, then their rates, at the beginning of the interval, shape (2
                p,).
            times: Times [s], shape (j,).

        Returns:
            Shape (j + 1, 2 p), the end of the interval last.
        """
        passive = self._move.crane.layout.passive

        def derivative(t: float, y: np.ndarray) -> np.ndarray:
            return np.append(y[len(passive) :], self._joint_accelerations(k, t, y)[passive])

        solution = solve_ivp(
            derivative,
            (self.nodes[k], self.nodes[k + 1]),
            swing,
            method="DOP853",
            t_eval=np.append(times, self.nodes[k + 1]),
            rtol=_RELATIVE_TOLERANCE,
            atol=_ABSOLUTE_TOLERANCE,
        )
        return solution.y.T

    def _state(self, k: int, t: float, swing: np.ndarray) -> State:
        """Return the state of all joints at a time [s] in interval k, with passive coordinates and
        their rates, shape (2 p,).
        """
        layout = self._move.crane.layout
        passive_count = len(layout.passive)
        q = self._move.start.q.copy()
        v = np.zeros(layout.n)
        q[layout.drives] = _value(self._position, k, t - self.nodes[k])
        v[layout.drives] = _value(self._rate, k, t - self.nodes[k])
        q[layout.passive] = swing[:passive_count]
        v[layout.passive] = swing[passive_count:]
        return State(q, v)

    def _joint_accelerations(self, k: int, t: float, swing: np.ndarray) -> np.ndarray:
        """Return the accelerations of all joints, shape (n,); arguments as of `_state`."""
        drives = _value(self._acceleration, k, t - self.nodes[k])
        return prescribed_acceleration(self._move.crane, self._state(k, t, swing), drives)[0]

    def _final_acceleration(self) -> np.ndarray:
        """Return the accelerations of all joints at the goal, where the drives do not accelerate,
        shape (n,): zero where the load hangs at rest.
        """
        crane = self._move.crane
        goal = self._move.goal
        if is_at_rest(crane, goal):
            return np.zeros(crane.layout.n)
        return prescribed_acceleration(crane, goal, np.zeros(crane.layout.m))[0]


def _value(curve: PPoly, k: int, t: float) -> np.ndarray:
    """Return a curve at a time after the beginning of interval k [s], by Horner's rule. A call of
    the curve itself is slower, and this is called in each step of an integration.
    """
    coefficients = curve.c[:, k]  # the highest power first
    value = coefficients[0]
    for coefficient in coefficients[1:]:
        value = value * t + coefficient
    return value


def _beginning_at(curve: PPoly, first: np.ndarray) -> PPoly:
    """Return a curve shifted so that it begins at a value."""
    curve.c[-1] += first - curve(curve.x[0])
    return curve


def _zeros_of_acceleration(acceleration: PPoly) -> np.ndarray:
    """Return the times inside of intervals at which the acceleration of a drive is zero [s]; none
    where accelerations are constant over the intervals.
    """
    is_linear = len(acceleration.c) == 2
    if not is_linear:
        return np.zeros(0)
    slope, value = acceleration.c
    with np.errstate(divide="ignore", invalid="ignore"):
        since_node = -value / slope
    inside = (since_node > 0.0) & (since_node < np.diff(acceleration.x)[:, None])
    return (acceleration.x[:-1, None] + since_node)[inside]
