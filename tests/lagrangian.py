"""The crane by hand: kinetic and potential energy on paper, differentiated by complex steps;
without URDF and without Pinocchio.

In the frame that turns with the jib the payload stands at radius x - l cos θ sin φ, aside by -l sin
θ, and l cos θ cos φ below the pivot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_STEP = 1e-30


@dataclass(frozen=True)
class Lagrangian:
    """Numbers of the crane [kg, kg m², m, m/s²], at the defaults that the article publishes."""

    gravity: float
    load: float = 1000.0
    load_inertia: float = 400.0
    trolley: float = 500.0
    trolley_inertia: float = 50.0
    link: float = 50.0
    link_inertia: float = 50.0
    slewing_inertia: float = 1.0e6
    height: float = 28.0

    def payload(self, q: np.ndarray) -> np.ndarray:
        """Position in the world, jib along -Y at zero slew."""
        gamma, x, phi, theta, length = q
        radius = x - length * np.cos(theta) * np.sin(phi)
        aside = -length * np.sin(theta)
        return np.array(
            [
                radius * np.sin(gamma) + aside * np.cos(gamma),
                -radius * np.cos(gamma) + aside * np.sin(gamma),
                self.height - length * np.cos(theta) * np.cos(phi),
            ]
        )

    def kinetic(self, q: np.ndarray, v: np.ndarray) -> complex:
        """T(q, v)."""
        _, x, phi, theta, length = q
        slew, x_dot, phi_dot, theta_dot, length_dot = v
        sp = np.sin(phi)
        cp = np.cos(phi)
        st = np.sin(theta)
        ct = np.cos(theta)
        radius = x - length * ct * sp
        aside = -length * st
        radial = (
            x_dot - length_dot * ct * sp + length * theta_dot * st * sp - length * phi_dot * ct * cp
        )
        sideways = -length_dot * st - length * theta_dot * ct
        upward = -length_dot * ct * cp + length * theta_dot * st * cp + length * phi_dot * ct * sp
        load = (radial - aside * slew) ** 2 + (sideways + radius * slew) ** 2 + upward**2
        outer = slew**2 + phi_dot**2
        inner = outer + theta_dot**2 + 2.0 * slew * theta_dot * sp
        return 0.5 * (
            self.load * load
            + (self.load_inertia + self.link_inertia) * inner
            + self.link_inertia * outer
            + (self.trolley + 2.0 * self.link) * (x_dot**2 + (x * slew) ** 2)
            + (self.slewing_inertia + self.trolley_inertia) * slew**2
        )

    def potential(self, q: np.ndarray) -> complex:
        """V(q): of the payload alone, because nothing else moves up or down."""
        return self.load * self.gravity * self.payload(q)[2]

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M of T = v·M v/2, shape (5, 5), by polarisation."""
        e = np.eye(5)
        single = [self.kinetic(q, row) for row in e]
        return np.array(
            [
                [self.kinetic(q, e[i] + e[j]) - single[i] - single[j] for j in range(5)]
                for i in range(5)
            ]
        )

    def forces(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Generalized forces d/dt ∂T/∂v - ∂T/∂q + ∂V/∂q that this motion needs, shape (5,); exact
        to rounding.
        """
        bend = (self.mass_matrix(q + 1j * _STEP * v) @ v).imag / _STEP
        slope = [
            (self.kinetic(q + 1j * _STEP * e, v) - self.potential(q + 1j * _STEP * e)).imag / _STEP
            for e in np.eye(5)
        ]
        return self.mass_matrix(q).real @ a + bend - np.array(slope)

    def payload_acceleration(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """p̈ in the world, shape (3,); central differences of the complex-step velocity, O(step²) =
        1e-8 relative.
        """

        def velocity(t: float) -> np.ndarray:
            return self.payload(q + t * v + 0.5 * t**2 * a + 1j * _STEP * (v + t * a)).imag / _STEP

        return (velocity(1e-4) - velocity(-1e-4)) / 2e-4
