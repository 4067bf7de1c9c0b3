"""Weights of a crane's structure that a site enters and a URDF need not have: base, jib,
counter-jib.
"""

from __future__ import annotations

from dataclasses import dataclass

from cranedyn.checks import number


@dataclass(frozen=True)
class Base:
    """A square base on which a tower stands by four corners, its sides along the world's X and Y.

    Attributes:
        spacing: Distance between neighbouring corners [m].
        mass: Mass of base, ballast and mast, as far as the crane's model lacks it [kg], above the
            middle.
        permitted: Largest force that the ground may bear under a corner [N]; None if unknown.

    Raises:
        OutOfRange: If the spacing or the permitted force is not positive, or the mass negative.
    """

    spacing: float
    mass: float
    permitted: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("spacing of the corners", self.spacing, "m", "> 0")
        number("mass of the base", self.mass, "kg", ">= 0")
        if self.permitted is not None:
            number("permitted force of a corner", self.permitted, "N", "> 0")


@dataclass(frozen=True)
class Arm:
    """Jib or counter-jib, as a weight at its centre of mass.

    Its weight is added to the loads of the slewing ring and the foot, besides the upper structure
    that the crane's model has on the slew axis. Its inertia is part of the crane's
    `slewing_inertia`.

    Attributes:
        mass: Mass [kg].
        centre: Centre of mass, from the slew axis along the jib, negative behind it [m].

    Raises:
        OutOfRange: If the mass is negative, or a number is not finite.
    """

    mass: float
    centre: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("mass of an arm", self.mass, "kg", ">= 0")
        number("centre of an arm", self.centre, "m")
