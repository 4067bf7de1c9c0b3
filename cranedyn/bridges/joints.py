"""What other people's tools ask of a crane: its joints by name, with limits, damping and springs, and its text as XML."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from argparse import Namespace
from typing import NamedTuple

from cranedyn.errors import ModelError, number, quoted
from cranedyn.model.crane import Crane
from cranedyn.model.description import parse_values
from cranedyn.model.load import load_crane
from cranedyn.model.urdf import parse


def loaded(options: Namespace) -> Crane:
    """The crane that the command line describes."""
    return load_crane(options.urdf, gravity=options.gravity, **parse_values(options.values))  # type: ignore[arg-type]


class Joint(NamedTuple):
    """A joint that moves.

    Attributes:
        name: In the URDF.
        symbol: Of its coordinate.
        unit: "rad" or "m".
        driven: Whether a drive moves it.
        child: The link that it carries.
        axis: In its own frame, as the URDF says.
        lower, upper: Its range [rad or m].
        effort: Largest effort [N m or N].
        velocity: Largest velocity [per second].
        damping: Viscous [N m s/rad or N s/m].
        stiffness: Of its spring [N m/rad or N/m], 0 for none.
        rest: Where the spring is at rest [rad or m].
        start: Where it stands when a run starts [rad or m].
    """

    name: str
    symbol: str
    unit: str
    driven: bool
    child: str
    axis: str
    lower: float
    upper: float
    effort: float
    velocity: float
    damping: float
    stiffness: float
    rest: float
    start: float

    @property
    def effort_column(self) -> str:
        """Name of the column of its effort."""
        return f"T_{self.symbol}_Nm" if self.unit == "rad" else f"F_{self.symbol}_N"

    @property
    def columns(self) -> tuple[str, str]:
        """Names of the columns of its coordinate and of its rate."""
        return f"{self.symbol}_{self.unit}", f"{self.symbol}_dot_{self.unit}_s"


def described(crane: Crane) -> ET.Element:
    """The crane's plain URDF as XML, without comments.

    Raises:
        ModelError: If it has meshes, which are files of their own, or a rope whose stiffness changes with its length.
    """
    robot = parse(crane.urdf, "the crane")
    for mesh in robot.iter("mesh"):
        raise ModelError(f"The crane has the mesh {quoted(mesh.get('filename', ''))}; exports carry primitives only.")
    for _ in robot.iter("ropeStiffness"):
        raise ModelError("The crane has a rope that stretches; no format that is exported knows a stiffness that changes with the length.")
    return robot


def joints(crane: Crane, robot: ET.Element) -> tuple[Joint, ...]:
    """The moving joints of a crane in the order of its coordinates, from its model and its text."""
    elements = {element.get("name", ""): element for element in robot.iterfind("joint")}
    found = []
    for i, joint in enumerate(crane.layout.joints):
        name = joint.name
        child, axis, limit = (elements[name].find(tag) for tag in ("child", "axis", "limit"))
        assert child is not None and limit is not None  # the crane was loaded from this text
        found.append(
            Joint(
                name,
                joint.symbol,
                joint.unit,
                joint.driven,
                child.get("link", ""),
                "1 0 0" if axis is None else axis.get("xyz", "1 0 0"),
                float(crane.lower[i]),
                float(crane.upper[i]),
                float(limit.get("effort", "0")),
                float(limit.get("velocity", "0")),
                float(crane.damping[i]),
                _tag(robot, name, "springStiffness"),
                _tag(robot, name, "springReference"),
                float(crane.start.q[i]),
            )
        )
    return tuple(found)


def _tag(robot: ET.Element, joint: str, tag: str) -> float:
    """A number that the URDF gives a joint in a tag of Gazebo's, 0 if it does not."""
    texts = (one.findtext(tag) for one in robot.iterfind("gazebo") if one.get("reference") == joint)
    return number(f"{tag} of {quoted(joint)}", next((text for text in texts if text is not None), 0.0))


def check_heavy(crane: Crane, robot: ET.Element, door: str) -> None:
    """Return if every link that moves has mass and inertia of its own, without which some engines drop it and all that it carries.

    Raises:
        ModelError: If one has not: which.
    """
    moving = {joint.child for joint in joints(crane, robot)}
    for link in robot.iterfind("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if name not in moving:
            continue
        masses = [] if inertial is None else [*inertial.iterfind("mass"), *inertial.iterfind("inertia")]
        numbers = [float(part.get(key, "0")) for part in masses for key in ("value", "ixx", "iyy", "izz") if part.get(key) is not None]
        if len(numbers) != 4 or min(numbers) <= 0.0:
            raise ModelError(f"The link {quoted(name)} has no mass or no inertia, with which {door} drops it; allowed are numbers > 0.")


def grounded(robot: ET.Element, door: str) -> ET.Element:
    """A URDF, changed so that Gazebo takes all of it: its root is the link ``world``, and what is fixed to that has an inertial.

    Without an inertial Gazebo leaves out a link and all that it carries, silently; of a link that cannot move any will do.

    Raises:
        ModelError: If another link than the root has that name.
    """
    ends = [(joint.get("type"), _end(joint, "parent"), _end(joint, "child")) for joint in robot.iterfind("joint")]
    links = {link.get("name", ""): link for link in robot.iterfind("link")}
    (root,) = links.keys() - {child for *_, child in ends}
    still = {root}
    while more := {child for kind, parent, child in ends if parent in still and kind == "fixed"} - still:
        still |= more
    if root != "world":
        if "world" in links:
            raise ModelError(f"The crane has a link world that is not its root, {quoted(root)}; {door} hangs a crane on that link.")
        robot.insert(0, ET.Element("link", name="world"))
        joint = ET.SubElement(robot, "joint", name="fixed_to_the_world", type="fixed")
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=root)
    for name in still - {"world"}:
        if links[name].find("inertial") is None:
            inertial = ET.SubElement(links[name], "inertial")
            ET.SubElement(inertial, "mass", value="1")
            ET.SubElement(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    return robot


def _end(joint: ET.Element, tag: str) -> str:
    """The link at an end of a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")
