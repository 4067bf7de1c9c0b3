"""Drives over time by a plan: polynomials, the motion of the crane that they cause, and bounds for
a proof.
"""

from __future__ import annotations

import itertools
import math
from functools import reduce

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import PPoly

from cranedyn.dynamics.pinocchio import prescribed_acceleration
from cranedyn.interfaces import State
from cranedyn.planning import transcription
from cranedyn.planning.move import Move, is_at_rest
from cranedyn.references.motion import Motion

SOON = 1e-6
"""Difference below which times count as the same [s]."""


class DriveTrajectory:
    """All drives over time by a plan; see `cranedyn.planning.proof.DriveCurve`.

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
        controls = np.zeros((1, len(plan.durations), layout.m))
        controls[0][:, move.drives] = plan.controls
        control = PPoly(controls, self.nodes)
        self._acceleration = control if move.jerk is None else control.antiderivative()
        self._rate = _from(self._acceleration.antiderivative(), move.start.v[layout.drives])
        self._place = _from(self._rate.antiderivative(), move.start.q[layout.drives])
        self._fastest = np.unique(np.concatenate([self.nodes, _turns(self._acceleration)]))

    def at(self, s: float) -> np.ndarray:
        """Return the positions of the drives at a time [s], shape (m,)."""
        return np.asarray(self._place(s))

    def reach(self, first: float, last: float) -> np.ndarray:
        """Return the largest distance of the drives between two times from their positions in the
        middle, shape (m,): by their largest rates, at an end or where they do not accelerate.
        """
        between = self._fastest[(self._fastest > first) & (self._fastest < last)]
        rates = self._rate(np.concatenate([[first, last], between]))
        return np.asarray(np.abs(rates).max(axis=0) * (last - first) / 2.0)

    def motion(self, period: float) -> Motion:
        """Return the motion of all joints in rows a period [s] apart, the swing by integrating the
        equations of motion; the last row is the goal, at the first instant at or after the end.
        """
        move, layout = self._move, self._move.crane.layout
        passive, nodes = layout.passive, self.nodes

        def state(t: float, y: np.ndarray, k: int) -> State:
            q, v = move.start.q.copy(), np.zeros(layout.n)
            q[layout.drives] = _value(self._place, k, t - nodes[k])
            v[layout.drives] = _value(self._rate, k, t - nodes[k])
            q[passive], v[passive] = y[: len(passive)], y[len(passive) :]
            return State(q, v)

        def accelerations(t: float, y: np.ndarray, k: int) -> np.ndarray:
            drives = _value(self._acceleration, k, t - nodes[k])
            return prescribed_acceleration(move.crane, state(t, y, k), drives)[0]

        def flow(t: float, y: np.ndarray, k: int) -> np.ndarray:
            return np.append(y[len(passive) :], accelerations(t, y, k)[passive])

        times = period * np.arange(math.ceil((self.duration - SOON) / period))
        y = np.concatenate([move.start.q[passive], move.start.v[passive]])
        rows, goal = [], move.goal
        # Interval by interval, since the controls jump between.
        for k, (first, last) in enumerate(itertools.pairwise(nodes)):
            if last <= first:
                continue
            inside = times[(times >= first) & (times < last)]
            options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "args": (k,)}
            *swings, y = solve_ivp(
                flow, (first, last), y, t_eval=np.append(inside, last), **options
            ).y.T
            for t, swing in zip(inside.tolist(), swings, strict=True):
                rows.append((*state(t, swing, k), accelerations(t, swing, k)))
        still, end = np.zeros(layout.m), np.zeros(layout.n)
        if not is_at_rest(move.crane, goal):
            end = prescribed_acceleration(move.crane, goal, still)[0]
        rows.append((goal.q, goal.v, end))
        q, v, a = (np.array(column) for column in zip(*rows, strict=True))
        return Motion(period, q, v, a, layout.drives)


def _value(curve: PPoly, k: int, t: float) -> np.ndarray:
    """Return a curve at a time after the beginning of interval k [s], faster than SciPy."""
    return reduce(lambda value, coefficient: value * t + coefficient, curve.c[:, k])


def _from(curve: PPoly, first: np.ndarray) -> PPoly:
    """Return a curve shifted so that it begins at a value."""
    curve.c[-1] += first - curve(curve.x[0])
    return curve


def _turns(acceleration: PPoly) -> np.ndarray:
    """Return the times at which the acceleration of a drive, linear over each interval, is zero
    [s].
    """
    if len(acceleration.c) < 2:
        return np.zeros(0)
    slope, value = acceleration.c
    with np.errstate(divide="ignore", invalid="ignore"):
        since = -value / slope
    inside = (since > 0.0) & (since < np.diff(acceleration.x)[:, None])
    return (acceleration.x[:-1, None] + since)[inside]
