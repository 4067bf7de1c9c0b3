"""Wind on the load of two cranes, by the faces of the box around it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.disturbances.wind import AIR_DENSITY, Speed
from cranedyn.lifts.tandem.load import TandemLoad

DRAG_COEFFICIENT = 1.2
"""Drag coefficient of a load that nobody entered, as in `cranedyn.lifts.planning.perturbed`."""


class WindOnLoad(NamedTuple):
    """What wind does to a load at an instant.

    Attributes:
        force: Force along the axes of the load [N], shape (3,).
        torque: Torque about its centre of mass, along the same axes [N m], shape (3,).
        power: Power that the wind puts in [W]; negative where the air slows the load down.
    """

    force: np.ndarray
    torque: np.ndarray
    power: float


@dataclass(frozen=True, eq=False)
class LoadWind:
    """A horizontal wind that blows on the faces of a load.

    A face of the area A with the normal n that the wind blows onto is pushed along the wind by

        F = ½ ρ c A |w·n| w

    at its middle, with the velocity w of the air less that of the middle, the density ρ of
    `cranedyn.disturbances.wind.AIR_DENSITY` and the drag coefficient c. The forces of all faces
    together are those of the area that the box turns to the wind, ½ ρ c A_p |w| w.

    Attributes:
        speed: Wind speed over time, see `cranedyn.disturbances.wind`.
        direction: Direction in which it blows, from X of the site towards Y [rad].
        drag: Drag coefficient c.
    """

    speed: Speed
    direction: float
    drag: float = DRAG_COEFFICIENT

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If the direction is not finite, or the drag coefficient negative.
        """
        number("direction of the wind", self.direction, "rad")
        number("drag coefficient of the load", self.drag, "", ">= 0")

    @cached_property
    def unit_vector(self) -> np.ndarray:
        """Direction in which it blows in the frame of the site, shape (3,)."""
        return np.array([math.cos(self.direction), math.sin(self.direction), 0.0])

    def on(self, load: TandemLoad, t: float, rotation: np.ndarray, twist: np.ndarray) -> WindOnLoad:
        """Return what the wind does to a load.

        Args:
            load: The load.
            t: Time [s].
            rotation: Rotation from the axes of the load to those of the site, shape (3, 3).
            twist: Velocity and angular velocity of the load along its own axes, shape (6,).
        """
        air = rotation.T @ (self.speed(t) * self.unit_vector)
        velocity = twist[:3]
        spin = twist[3:]
        relative = air - velocity
        sides = np.asarray(load.size, dtype=float)
        force = np.zeros(3)
        torque = np.zeros(3)
        power = 0.0
        # The wind blows onto one face of each pair.
        for axis in range(3):
            middle = np.zeros(3)
            middle[axis] = -math.copysign(sides[axis] / 2.0, relative[axis])
            of_middle = velocity + np.cross(spin, middle)
            flow = air - of_middle
            area = float(sides.prod()) / float(sides[axis])
            push = 0.5 * AIR_DENSITY * self.drag * area * abs(float(flow[axis])) * flow
            force += push
            torque += np.cross(middle, push)
            power += float(push @ of_middle)
        return WindOnLoad(force, torque, power)
