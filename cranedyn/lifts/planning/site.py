"""A site: where the crane stands, what stands about it, what it lifts, and from where to where; and
weights of the crane's structure that a URDF need not have: base, jib, counter-jib.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cranedyn.checks import ShortRepr, number, within
from cranedyn.errors import DataError, quoted
from cranedyn.lifts.planning.plan_details import PlanDetails
from cranedyn.lifts.planning.solids import Solid, rotation_z
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.model.machines import read_machine
from cranedyn.references.limits import Limits


class SiteDrive(NamedTuple):
    """A drive of a crane that lifts on a site.

    Attributes:
        name: Its name: the role of its joint, such as "slew", or else the symbol of that.
        turns: Whether it turns what it moves; its numbers in a file are then in degrees.
    """

    name: str
    turns: bool


TOWER_DRIVES = (
    SiteDrive("slew", turns=True),
    SiteDrive("trolley", turns=False),
    SiteDrive("hoist", turns=False),
)
"""Drives of a tower crane, in the order of numbers in the file of its site."""

DISTANCE = 0.5
"""Required distance of a site that does not give one [m]."""

SWING = math.radians(2.0)
"""Largest swing of the load of a site that does not give one [rad]."""

MIN_SWING = 1e-4
"""Least swing that a site may allow [rad], 0.006°. A load whose rope may not lean at all cannot be
accelerated, and a plan that neared it would last for ever."""

MAX_SWING = 0.5
"""Largest swing that a site may allow [rad], 28.6°."""

CRANE_HEADING = -math.pi / 2.0
"""Heading of a crane whose axes are those of the site [rad]: in the frame of a crane the jib points
along -Y at zero slew."""

BASE_HEIGHT = 0.3
"""Height of the beams of a base above the foot [m]. A site enters their length, which is the
spacing of the corners, and no height; that of a usual foundation cross is about this.
"""

GROUND = "ground"
"""Name of the ground among the obstacles of a lift."""

MAST = "own mast"
"""Name of the crane's own mast among the obstacles of what hangs."""

OWN_BASE = "own base"
"""Name of the crane's own base among the obstacles of what hangs."""

OWN_UPPER = "own upper structure"
"""Name of what slews with the jib and lies below the trolley, such as a slewing column and a cab,
among the obstacles of load and hook."""

OWN_STRUCTURE = "own structure"
"""Name of what stands of a crane that is no tower crane, such as the columns and rails of a runway,
among the obstacles of what hangs."""

RESERVED_NAMES = frozenset({GROUND, MAST, OWN_BASE, OWN_UPPER, OWN_STRUCTURE})
"""Names that no obstacle may have: a proof would take one for the other."""

HANGING = ("hook", "rope", "load")
"""Bodies that hang and swing."""

BELOW_UPPER = ("hook", "load")
"""Bodies that keep from what slews below the trolley of a tower crane, such as the slewing column.
The rope does not need to: it hangs from the trolley, which rolls beside these parts, above hook and
load."""


def crane_to_site(heading: float) -> np.ndarray:
    """Return the rotation matrix from the axes of a crane to those of its site, shape (3, 3).

    Args:
        heading: Direction of the jib at zero slew, from the site's X towards its Y [rad].
    """
    return rotation_z(heading - CRANE_HEADING)


@dataclass(frozen=True)
class DescribedCrane:
    """Which crane stands on a site, where it is not the tower crane of this project.

    Attributes:
        kind: Name of a crane of this project, see `KINDS`; None for another one.
        file: Its description, a plain URDF, MJCF or SDF; None for another one.
        machine: Name of a machine of the library, see `cranedyn.model.machines`; None for none.
        driven: Names of its driven joints, for a description that does not say it.
        locked: Names of joints that are held where they start, or their coordinates [rad or m] by
            name.
    """

    kind: str | None = None
    file: Path | None = None
    machine: str | None = None
    driven: tuple[str, ...] = ()
    locked: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def is_tower(self) -> bool:
        """Whether it is the tower crane of this project, or a machine that is given as one."""
        if self.driven or self.locked:
            return False
        if self.machine is not None:
            return read_machine(self.machine).urdf is None
        return self.kind == "tower"

    @property
    def urdf(self) -> Path | None:
        """The file that describes it; None for the tower crane, and for a machine."""
        if self.kind in (None, "tower"):
            return self.file
        return XACRO.parent / f"{self.kind}_crane.urdf.xacro"

    def load(self, values: Mapping[str, object], gravity: float | None = None) -> Crane:
        """Load the crane.

        Args:
            values: Values of its arguments that differ from its defaults, by name; a file has none.
            gravity: Gravity [m/s²]; None for that of the file, or standard gravity.

        Raises:
            CraneError: As `cranedyn.model.load.load_crane`.
        """
        return load_crane(
            self.urdf,
            machine=self.machine,
            gravity=gravity,
            driven=self.driven or None,
            locked=self.locked,
            values=values,
        )


KINDS = ("tower", "luffing", "overhead", "mobile")
"""Names of the kinds of cranes that come with this project."""


@dataclass(frozen=True)
class Base:
    """A square base on which a crane stands by four corners, centred below the slew axis: that of a
    tower with its sides along X and Y of the site, or outriggers with their sides along those of
    the crane.

    Attributes:
        spacing: Distance between neighbouring corners [m].
        mass: Mass of base, ballast and mast, as far as the crane's model lacks it [kg]. Its centre
            of mass is above the middle of the square.
        permitted: Largest force that the ground may bear under a corner [N]; None if unknown.
        turns_with_crane: Whether the sides lie along the axes of the crane, however it stands on
            the site, as those of outriggers do.

    Raises:
        OutOfRange: If the spacing or the permitted force is not positive, or the mass negative.
    """

    spacing: float
    mass: float
    permitted: float | None = None
    turns_with_crane: bool = False

    def __post_init__(self) -> None:
        """Check the numbers."""
        number("spacing of the corners", self.spacing, "m", "> 0")
        number("mass of the base", self.mass, "kg", ">= 0")
        if self.permitted is not None:
            number("permitted force of a corner", self.permitted, "N", "> 0")


@dataclass(frozen=True)
class Runway:
    """Two rails on which a crane travels, each of them under two wheels or groups of wheels.

    Attributes:
        rails: Where both rails are across the way of the crane, in its own frame, a quarter turn
            to the left of its positive direction [m].
        wheel_base: Distance between the wheels of a rail [m]; the origin of the joint that travels
            is in the middle of them, at the height of the rails.
        permitted: Largest force that a wheel may exert on its rail [N]; None if unknown.

    Raises:
        OutOfRange: If both rails are one, or the other numbers are not positive.
    """

    rails: tuple[float, float]
    wheel_base: float
    permitted: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        first, second = self.rails
        number("distance of the rails", abs(second - first), "m", "> 0")
        number("wheel base", self.wheel_base, "m", "> 0")
        if self.permitted is not None:
            number("permitted force of a wheel", self.permitted, "N", "> 0")


@dataclass(frozen=True)
class Arm:
    """Jib or counter-jib, as a weight at its centre of mass.

    Its weight is added to the loads of the slewing ring and the foot; the weight of the upper
    structure that the crane's model has on the slew axis is in them anyway. Its inertia is part of
    the crane's `slewing_inertia`.

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


@dataclass(frozen=True, eq=False, repr=False)
class Site(ShortRepr):
    """A site, in a frame of its own: metres, Z up.

    Attributes:
        name: Its name.
        solids: Obstacles, and zones to keep out of.
        ground: Height of the ground [m].
        foot: Foot of the crane's mast [m], shape (3,).
        heading: Direction of the jib at zero slew, from X towards Y [rad].
        crane: Values of the crane that differ from its defaults, by name; the mass of the load with
            its rigging, the efforts of the drives and the length of the counter-jib are among them,
            where they are entered.
        load: Corners of the load about its centre [m], shape (n, 3); X is across the jib, Y points
            along the jib to the mast, Z up; None for the load that the crane's model has.
        start, goal: Centre of the load at the start and at the end [m], shape (3,), or shape (2,)
            where it stands on what is below; None if unknown.
        distance: Required distance between all that moves and every obstacle [m].
        swing: Largest angle of the rope from plumb that is allowed [rad], more than 0: a load that
            moves swings.
        description: Which crane it is; None for the tower crane of this project.
        drives: Drives of the crane, in the order of `limits`.
        limits: Limits of the drives; None if unknown.
        base: Base of the crane; None if unknown.
        arms: Jib and counter-jib as weights; empty if unknown.
        runway: Rails on which the crane travels; None if unknown, or it does not travel.
        rigging: Masses of "hook", "slings" and "spreader" [kg], part of the mass of the crane's
            load. A hook or slings that are left out are unknown, so that a judgement is not
            complete; they are 0 where the load's mass contains them.
        gust: Gust that the lift must bear [m/s]; None if unknown.
        gust_swing: Largest angle of the rope from plumb in gusts [rad]; None if unknown.
        risk: Largest probability that a perturbed lift comes closer than required; None if unknown.
        spread: How far lifts may differ from the plan, by the names of the attributes of
            `cranedyn.lifts.planning.perturbed.Spread`; empty for its defaults.
        chart: File of the crane's load chart, or the name of one that is shipped; None if unknown.
        falls: Number of falls that carry the hook; None if unknown.
        details: What a lift plan says beside the motion, such as job, people and slings.
        telescope: Name of the joint that telescopes the boom, which is held during a lift; empty
            if no joint does.
        boom: Length of that boom from its hinge to its head [m]; None if no joint telescopes it.
        counterweight: Counterweight of the crane, which its load chart may ask for [kg]; None if
            it is not entered.
        entered: Fields that somebody entered, such as "[lift] swing". A value that equals the
            default of this program counts as entered only if it is listed here.
        estimated: Those of them that hold an estimate.
        unusual: Sentences about values that are unusual, see
            `cranedyn.lifts.planning.plausibility`.
    """

    name: str
    solids: tuple[Solid, ...]
    ground: float = 0.0
    foot: np.ndarray = field(default_factory=lambda: np.zeros(3))
    heading: float = CRANE_HEADING
    crane: Mapping[str, float] = field(default_factory=dict)
    load: np.ndarray | None = None
    start: np.ndarray | None = None
    goal: np.ndarray | None = None
    distance: float = DISTANCE
    swing: float = SWING
    description: DescribedCrane | None = None
    drives: tuple[SiteDrive, ...] = TOWER_DRIVES
    limits: Limits | None = None
    base: Base | None = None
    arms: tuple[Arm, ...] = ()
    runway: Runway | None = None
    rigging: Mapping[str, float] = field(default_factory=dict)
    gust: float | None = None
    gust_swing: float | None = None
    risk: float | None = None
    spread: Mapping[str, float] = field(default_factory=dict)
    chart: Path | str | None = None
    falls: int | None = None
    details: PlanDetails = field(default_factory=PlanDetails)
    telescope: str = ""
    boom: float | None = None
    counterweight: float | None = None
    entered: frozenset[str] = frozenset()
    estimated: frozenset[str] = frozenset()
    unusual: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the numbers and names.

        Raises:
            DataError: If two solids have one name, or one has a name of `RESERVED_NAMES`.
            OutOfRange: If a number is not finite, the distance not positive, or the swing not
                above 0 and up to `MAX_SWING`.
        """
        number("height of the ground", self.ground, "m")
        number("required distance", self.distance, "m", "> 0")
        within("swing of the load", self.swing, MIN_SWING, MAX_SWING, "rad")
        for solid in self.solids:
            if solid.name in RESERVED_NAMES or solid.name.startswith("own "):
                raise DataError(
                    f"An obstacle is called {quoted(solid.name)}, as the program calls a part of "
                    "its own; give it another name."
                )
        for name, count in Counter(solid.name for solid in self.solids).items():
            if count > 1:
                raise DataError(
                    f"{count} obstacles are called {quoted(name)}; each needs a name of its own."
                )

    @property
    def is_tower(self) -> bool:
        """Whether the site lifts by the tower crane of this project: [crane] names no other one."""
        return self.description is None or self.description.is_tower

    @property
    def crane_to_site(self) -> np.ndarray:
        """Rotation matrix from the axes of the crane to those of the site, shape (3, 3)."""
        return crane_to_site(self.heading)

    @property
    def base_corners(self) -> np.ndarray:
        """Corners of the box around the base in the frame of the crane [m], shape (8, 3). Sides
        that lie along the axes of the site are turned in the frame of the crane.
        """
        assert self.base is not None
        half = self.base.spacing / 2.0
        sides = (-half, half)
        corners = list(itertools.product(sides, sides, (0.0, BASE_HEIGHT)))
        points = np.array(corners)
        return points if self.base.turns_with_crane else points @ self.crane_to_site

    def to_crane(self, points: np.ndarray) -> np.ndarray:
        """Return points of the site [m], shape (..., 3), in the frame of the crane."""
        return (np.asarray(points) - self.foot) @ self.crane_to_site

    def to_site(self, points: np.ndarray) -> np.ndarray:
        """Return points in the frame of the crane [m], shape (..., 3), in that of the site."""
        return np.asarray(points) @ self.crane_to_site.T + self.foot

    def seen_by_crane(self) -> list[Solid]:
        """Return the solids in the frame of the crane."""
        rotation = self.crane_to_site.T
        translation = -self.foot @ self.crane_to_site
        return [solid.moved(rotation, translation) for solid in self.solids]
