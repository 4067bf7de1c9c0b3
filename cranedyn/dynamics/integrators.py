"""Integrators: rules that step coordinates and rates by a time step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

Acceleration = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function of coordinates q and rates v that returns accelerations."""

Add = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function of a quantity and its rate that returns the quantity one time step later."""

Rule = Callable[
    [Acceleration, Add, Add, np.ndarray, np.ndarray, int], tuple[np.ndarray, np.ndarray]
]
"""Function that takes steps. Its arguments are the acceleration, the step of rates, the step of
coordinates, q, v and the number of steps; it returns q and v after these steps.

A rule only adds and multiplies, so that the plain loop and compiled code use the same one.
"""


@dataclass(frozen=True)
class Integrator:
    """A rule that steps coordinates and rates.

    Attributes:
        name: Name in records and tables.
        rule: The rule.
        lead: Number of steps by which positions run ahead of velocities.
        smooth: Whether the rule keeps its order only on a smooth motion. A motion into a buffer, or
            through a change of phase of a rope, has kinks.
    """

    name: str
    rule: Rule
    lead: float
    smooth: bool = False

    def advance(
        self,
        acceleration: Acceleration,
        model: pin.Model,
        q: np.ndarray,
        v: np.ndarray,
        dt: float | np.ndarray,
        steps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Take steps with a Pinocchio model.

        Args:
            acceleration: Accelerations as a function of q and v.
            model: The model, whose coordinates need not be a vector space.
            q: Coordinates, shape (nq,).
            v: Rates, shape (nv,).
            dt: Time step [s]. An array with the same step for each coordinate, shape (nv,), is
                faster.
            steps: Number of steps.

        Returns:
            q and v after these steps, new arrays.
        """
        integrate = pin.integrate
        return self.rule(
            acceleration,
            lambda rates, acceleration: rates + dt * acceleration,
            lambda coordinates, rates: integrate(model, coordinates, dt * rates),
            q,
            v,
            steps,
        )


def _semi_implicit_euler(
    acceleration: Acceleration,
    step_rates: Add,
    step_coordinates: Add,
    q: np.ndarray,
    v: np.ndarray,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    for _ in range(steps):
        v = step_rates(v, acceleration(q, v))
        q = step_coordinates(q, v)
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
    acceleration: Acceleration,
    step_rates: Add,
    step_coordinates: Add,
    q: np.ndarray,
    v: np.ndarray,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    # The four stages of q' = v, v' = a(q, v): the rates of stage i are vi, its accelerations ai.
    for _ in range(steps):
        a1 = acceleration(q, v)
        v2 = step_rates(v, 0.5 * a1)
        a2 = acceleration(step_coordinates(q, 0.5 * v), v2)
        v3 = step_rates(v, 0.5 * a2)
        a3 = acceleration(step_coordinates(q, 0.5 * v2), v3)
        v4 = step_rates(v, a3)
        a4 = acceleration(step_coordinates(q, v3), v4)
        q = step_coordinates(q, (v + 2.0 * (v2 + v3) + v4) / 6.0)
        v = step_rates(v, (a1 + 2.0 * (a2 + a3) + a4) / 6.0)
    return q, v


rk4 = Integrator("RK4", _rk4, lead=0.0, smooth=True)
"""The classical rule of order 4 (Kutta 1901), four accelerations a step; for cranes, whose
coordinates are a vector space.

Made for one step per control period, over which commands are constant: the motion within is smooth,
unless a drive reaches the end of its range (see `cranedyn.simulation.pinocchio_engine`).
"""
