"""The load of two cranes, and the ropes on which it hangs.

The frame of the load has its origin at the centre of mass and its axes along the principal axes of
inertia, X from the first lug towards the second in the plan of most lifts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import finite, number

LUGS = 2
"""Number of lugs, one for the rope of each crane."""


@dataclass(frozen=True, eq=False)
class TandemLoad:
    """A rigid load with two lugs.

    Attributes:
        mass: Its mass, with all that hangs below the ropes [kg].
        size: Sides of the box around it along its axes [m].
        lugs: Places of the lugs from the centre of mass [m], shape (2, 3).
        inertia: Principal moments of inertia about the centre of mass [kg m²]; None for those of a
            homogeneous box.
        damping: Damping of its rotation, such as by the air [N m s/rad].
    """

    mass: float
    size: Sequence[float]
    lugs: Sequence[Sequence[float]]
    inertia: Sequence[float] | None = None
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If a number is not finite, mass, a side or a moment of inertia is not
                positive, the damping is negative, or there are not two lugs.
        """
        number("mass of the load", self.mass, "kg", "> 0")
        for side in finite("size of the load", self.size, (3,), unit="m"):
            number("side of the load", side, "m", "> 0")
        finite("lugs of the load", self.lugs, (LUGS, 3), unit="m")
        if self.inertia is not None:
            for moment in finite("inertia of the load", self.inertia, (3,), unit="kg m²"):
                number("moment of inertia of the load", moment, "kg m²", "> 0")
        number("damping of the load", self.damping, "N m s/rad", ">= 0")

    @property
    def moments(self) -> np.ndarray:
        """Principal moments of inertia about the centre of mass [kg m²], shape (3,)."""
        if self.inertia is not None:
            return np.array(self.inertia, dtype=float)
        # A homogeneous box with the sides a, b, c has m (b² + c²)/12 about the side a.
        squares = np.array(self.size, dtype=float) ** 2
        return self.mass * (squares.sum() - squares) / 12.0

    def model(self, gravity: float) -> pin.Model:
        """Return the load as a model of Pinocchio: one free body.

        Args:
            gravity: Gravity [m/s²].
        """
        model = pin.Model()
        body = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "load")
        inertia = pin.Inertia(self.mass, np.zeros(3), np.diag(self.moments))
        model.appendBodyToJoint(body, inertia, pin.SE3.Identity())
        model.gravity.linear = np.array([0.0, 0.0, -gravity])
        return model


class RopeForce(NamedTuple):
    """What a rope does at an instant.

    Attributes:
        tension: Its tension [N], 0 where it is slack.
        elastic_energy: Energy that its stretch holds [J].
        loss: Power that its damping dissipates [W].
        input: Power that the crane puts into rope and load, by its pivot and its winch [W].
        force: Force on the load at the lug, in the world [N], shape (3,).
        direction: Unit vector from the lug to the pivot, shape (3,).
    """

    tension: float
    elastic_energy: float
    loss: float
    input: float
    force: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True)
class TandemRope:
    """A rope from the pivot of a crane to a lug; it pulls and does not push, and has no mass.

    Attributes:
        stiffness: E A, with all falls together [N].
        damping: Force by the rate of the stretch while the rope is taut [N s/m].
    """

    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If the stiffness is not positive, the damping negative, or one not finite.
        """
        number("stiffness of a rope", self.stiffness, "N", "> 0")
        number("damping of a rope", self.damping, "N s/m", ">= 0")

    def force(
        self,
        pivot: np.ndarray,
        pivot_velocity: np.ndarray,
        lug: np.ndarray,
        lug_velocity: np.ndarray,
        length: float,
        length_rate: float,
    ) -> RopeForce:
        """Return what the rope does.

        With the unstretched length L, the distance d of lug and pivot and the strain
        ε = (d - L)/L, the tension is T = E A ε + c (ḋ - L̇), where that is positive; a damped rope
        that is about to go slack does not push. The energy of the stretch is U = E A L ε²/2. What
        the crane puts in follows from the balance of energy, U̇ = E A ε ḋ - E A (ε + ε²/2) L̇: the
        force T on the pivot times its velocity along the rope, less (E A (ε + ε²/2) + c (ḋ - L̇)) L̇
        by the winch.

        Args:
            pivot: Place of the pivot in the world [m], shape (3,).
            pivot_velocity: Its velocity [m/s], shape (3,).
            lug: Place of the lug [m], shape (3,).
            lug_velocity: Its velocity [m/s], shape (3,).
            length: Unstretched length of the rope [m].
            length_rate: Its rate [m/s].
        """
        offset = pivot - lug
        distance = math.sqrt(float(offset @ offset))
        direction = offset / distance
        strain = (distance - length) / length
        if strain <= 0.0:
            return RopeForce(0.0, 0.0, 0.0, 0.0, np.zeros(3), direction)
        stretch_rate = float(direction @ (pivot_velocity - lug_velocity)) - length_rate
        spring = self.stiffness * strain
        tension = max(0.0, spring + self.damping * stretch_rate)
        damper = tension - spring
        winch = (spring * (1.0 + strain / 2.0) + damper) * length_rate
        return RopeForce(
            tension=tension,
            elastic_energy=0.5 * self.stiffness * length * strain**2,
            loss=damper * stretch_rate,
            input=tension * float(direction @ pivot_velocity) - winch,
            force=tension * direction,
            direction=direction,
        )
