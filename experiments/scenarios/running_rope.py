"""A load on a rope with mass that is wound up: small swings by the equation of a moving string.

It is a check of the crane's bodies and joints, and independent of them: material points of the rope
move along it, and new ones come in, or leave, at the pivot. It is written for a single fall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import roots_legendre

_POWERS = 4
"""Number of shape functions ξᵏ, of the place ξ along the rope."""

_POINTS = 12
"""Points of the Gauss-Legendre rule along the rope: exact up to degree 23, where the
integrands have at most degree 8."""


class CableMotion(NamedTuple):
    """Cable length at a time, and its derivatives.

    Attributes:
        length: Cable length [m].
        rate: Its rate [m/s], positive where the rope is paid out.
        acceleration: Its second derivative [m/s²].
    """

    length: float
    rate: float
    acceleration: float


@dataclass(frozen=True)
class RunningRope:
    """A rope with a point load at its end.

    Attributes:
        mass: Mass of a metre [kg/m].
        load: Mass of the load [kg].
    """

    mass: float
    load: float

    def angles(
        self,
        motion: Callable[[float], CableMotion],
        angle: float,
        times: np.ndarray,
        gravity: float,
    ) -> np.ndarray:
        """Return the angle of the line from a pivot at rest to the load [rad], shape (rows,).

        At the place ξ = s/l along the rope, 0 at the pivot and 1 at the load, the displacement is
        w = Σ qₖ ξᵏ with k = 1, 2, ..., so that the pivot is at rest. All of the rope moves along
        itself at l', so that a material point changes its place at the rate ξ' = (1 - ξ) l'/l, and
        ξ'' = (1 - ξ) (l''/l - 2 l'²/l²). Its acceleration across is the total derivative

            D²w = Σ (qₖ'' ξᵏ + 2 qₖ' k ξᵏ⁻¹ ξ' + qₖ (k (k - 1) ξᵏ⁻² ξ'² + k ξᵏ⁻¹ ξ'')).

        Below ξ hang the load and the rest of the rope, which accelerate at l'': the tension is
        T = (M + μ l (1 - ξ)) (g - l''). The principle of virtual work with δw = ξʲ gives

            ∫ μ D²w ξʲ l dξ + M (Σ qₖ'') + ∫ (T/l) (∂w/∂ξ) j ξʲ⁻¹ dξ = 0.

        Args:
            motion: Cable length over time.
            angle: Angle of the straight rope at the start, where it is at rest, l' = 0, too [rad].
            times: Times [s], increasing from 0.
            gravity: Gravity [m/s²].
        """
        place, weight = roots_legendre(_POINTS)
        place = 0.5 * (place + 1.0)
        weight = 0.5 * weight
        powers = np.arange(1, _POWERS + 1)
        shape = place[:, None] ** powers
        slope = powers * place[:, None] ** (powers - 1)
        bend = powers * (powers - 1) * place[:, None] ** np.maximum(powers - 2, 0)
        of_rope = (shape * weight[:, None]).T @ shape
        # At the load each power is 1.
        of_load = self.load * np.ones((_POWERS, _POWERS))

        def derivative(t: float, state: np.ndarray) -> np.ndarray:
            q = state[:_POWERS]
            rate = state[_POWERS:]
            length, speed, acceleration = motion(t)
            passing = (1.0 - place) * speed / length
            passing_rate = (1.0 - place) * (acceleration / length - 2.0 * (speed / length) ** 2)
            convected = 2.0 * (slope @ rate) * passing
            convected += (bend @ q) * passing**2 + (slope @ q) * passing_rate
            tension = (self.load + self.mass * length * (1.0 - place)) * (gravity - acceleration)
            force = -self.mass * length * shape.T @ (weight * convected)
            force -= slope.T @ (weight * tension * (slope @ q)) / length
            inertia = self.mass * length * of_rope + of_load
            return np.concatenate([rate, np.linalg.solve(inertia, force)])

        start = np.zeros(2 * _POWERS)
        start[0] = angle * motion(0.0).length
        solution = solve_ivp(
            derivative,
            (0.0, float(times[-1])),
            start,
            method="LSODA",
            t_eval=times,
            rtol=1e-7,
            atol=1e-11,
        )
        lengths = np.array([motion(t).length for t in times])
        return solution.y[:_POWERS].sum(axis=0) / lengths
