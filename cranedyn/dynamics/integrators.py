"""The stepping rule.

Time is counted in steps: with u = dt v and dt² a in place of v and a, the step size drops out of
the loop. `in_steps` turns a model to these units; forces scale like dt², damping coefficients like
dt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin

Acceleration = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From coordinates q and increments u = dt v [per step] to dt² a [per step²]."""

Add = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""What is after a step, from what is before it and its rate."""

Rule = Callable[
    [Acceleration, Add, Add, np.ndarray, np.ndarray, int], tuple[np.ndarray, np.ndarray]
]
"""From acceleration, what a step makes of rates, what it makes of coordinates, coordinates, rates
and a number of steps to coordinates and rates after them. In any kind of number and any unit of
time: the plain loop and compiled code go by the same."""


@dataclass(frozen=True)
class Integrator:
    """A stepping rule.

    Attributes:
        name: What it is called.
        rule: The rule.
        lead: By how many steps its positions run ahead of its velocities.
        smooth: Whether its order needs a motion without kinks, such as buffers make.
    """

    name: str
    rule: Rule
    lead: float
    smooth: bool = False

    def advance(
        self, acceleration: Acceleration, model: pin.Model, q: np.ndarray, u: np.ndarray, steps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take steps with a Pinocchio model, time counted in steps.

        Args:
            acceleration: Acceleration as a function of q and u.
            model: The model, for adding an increment to coordinates that are not a vector space.
            q: Coordinates, shape (nq,).
            u: Increments per step, dt v, shape (nv,).
            steps: How many steps to take.

        Returns:
            q and u after these steps, new arrays.
        """
        further = partial(pin.integrate, model)
        # where coordinates are a vector space this is a sum, and a quicker one of a few numbers
        # than NumPy's
        faster: Add = further if model.nq == model.nv else np.add
        return self.rule(acceleration, faster, further, q, u, steps)


def in_steps(model: pin.Model, dt: float) -> pin.Model:
    """A copy of a model that counts time in steps of `dt` [s]."""
    scaled = model.copy()
    scaled.gravity.linear = dt * dt * model.gravity.linear
    return scaled


def _semi_implicit_euler(
    acceleration: Acceleration, speed_up: Add, move: Add, q: np.ndarray, v: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(steps):
        v = speed_up(v, acceleration(q, v))
        q = move(q, v)
    return q, v


semi_implicit_euler = Integrator("semi-implicit Euler", _semi_implicit_euler, lead=0.5)
"""Velocities first, then positions with the new velocities, on any Pinocchio model.

Order 1. Where forces depend on position alone and the mass matrix is constant, as in the swing of a
load on locked drives in one plane, it is symplectic: the energy error stays bounded, halves with
the step, and does not drift. Where inertia depends on the posture, as in a robot's arm, the energy
may drift, at a rate that halves with the step. A frequency ω is met with a relative period error of
-(ω dt)²/24, because velocities are those of half a step earlier.
"""


def _rk4(
    acceleration: Acceleration, speed_up: Add, move: Add, q: np.ndarray, v: np.ndarray, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(steps):
        a1 = acceleration(q, v)
        v2 = speed_up(v, 0.5 * a1)
        a2 = acceleration(move(q, 0.5 * v), v2)
        v3 = speed_up(v, 0.5 * a2)
        a3 = acceleration(move(q, 0.5 * v2), v3)
        v4 = speed_up(v, a3)
        a4 = acceleration(move(q, v3), v4)
        q = move(q, (v + 2.0 * (v2 + v3) + v4) / 6.0)
        v = speed_up(v, (a1 + 2.0 * (a2 + a3) + a4) / 6.0)
    return q, v


rk4 = Integrator("RK4", _rk4, lead=0.0, smooth=True)
"""The classical rule of order 4 (Kutta 1901), four accelerations a step; for cranes, whose
coordinates are a vector space.

Made for one step per control period, over which commands are constant: the motion within is smooth,
unless a drive reaches the end of its range (see `cranedyn.simulation.engine`).
"""
