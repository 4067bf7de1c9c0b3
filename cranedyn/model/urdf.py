"""A URDF as XML: checked element by element before anything is built from it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import ModelError, OutOfRange, printable, quoted

_MAX_DEPTH = 50
"""Deepest nesting of the elements of a file."""

_MAX_ELEMENTS = 2000
"""Largest number of links and joints of a file."""

_MAX_NUMBER = 1e30
"""Largest number in a file: products of several of them are still finite."""

_MAX_NAMED_ROOTS = 5
"""Number of links without a joint that an error message names."""

NEGATIVE_MOMENT = 1e-9
"""How far the least principal moment may be below zero by round-off, as a share of the largest."""

_MOMENT_SUM_RATIO = 0.99
"""Least ratio of the sum of the two smaller principal moments to the largest one. It is 1 for a
plate, here less since files round moments to three digits."""

_DECIMAL = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""A decimal number, not nan or inf."""

_NUMBER_COUNTS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": {"ixx": 1, "iyy": 1, "izz": 1, "ixy": 1, "ixz": 1, "iyz": 1},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "dynamics": {"damping": 1, "friction": 1, "armature": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "color": {"rgba": 4},
    "mimic": {"multiplier": 1, "offset": 1},
}
"""Count of numbers in each attribute that holds numbers, by the tag of its element."""

_NAME_ATTRIBUTES = ("name", "type", "link", "joint")
"""Attributes that are names."""

_REQUIRED_NUMBERS = {
    "mass": ("value",),
    "inertia": ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "limit": ("effort", "velocity"),
}
"""Attributes of numbers that an element must have, by its tag."""

_JOINT_TYPES = ("revolute", "prismatic", "fixed", "continuous", "floating", "planar")
"""Types of joints in a URDF."""

_LIMITED_JOINT_TYPES = ("revolute", "prismatic")
"""Types of joints that need limits."""

_DYNAMIC_CHILDREN = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}
"""Children of elements that matter for the dynamics, by the tag of the element."""


class _GuardedBuilder(ET.TreeBuilder):
    """Builder that refuses document types, which define entities, and great depth: both let a small
    file take much memory or time.
    """

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type."""
        raise ModelError("it has a document type (<!DOCTYPE); leave it out")

    def start(self, tag: str, attributes: dict[str, str]) -> ET.Element:  # type: ignore[override]
        """Open an element, unless it is nested too deep."""
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ModelError(f"its elements are nested deeper than {_MAX_DEPTH}")
        return super().start(tag, attributes)

    def end(self, tag: str) -> ET.Element:
        """Close an element."""
        self._depth -= 1
        return super().end(tag)


def parse_urdf(text: str, source: object) -> ET.Element:
    """Return the root of an XML text; no entity is expanded and no other file is read.

    Args:
        text: The text.
        source: Name of the text for error messages.

    Raises:
        ModelError: If it is not XML, has a document type, or is nested too deep.
    """
    try:
        return ET.fromstring(text, ET.XMLParser(target=_GuardedBuilder()))
    except (ET.ParseError, ValueError) as error:
        raise ModelError(f"{source} is not XML: {error}.") from error
    except ModelError as error:
        raise ModelError(f"{source} cannot be loaded: {error}.") from None


def check_urdf(robot: ET.Element, source: object) -> None:
    """Check links, joints and materials of a URDF.

    Parsers of URDF silently drop an element with an unreadable number, and take the first of two.

    Raises:
        ModelError: If xacro directives are left, a name cannot be printed, an element is duplicate
            or incomplete, a joint mimics one that does not move, or itself through others, or links
            and joints are no tree.
        OutOfRange: If a number is not a decimal number, exceeds 1e30, a friction is negative, or no
            body has the mass and inertia of a link.
    """
    for element in robot.iter():
        _check_expanded(element, source)
    for child in robot:
        if child.tag in ("link", "joint", "material"):
            for element in child.iter():
                _check_element(element, f"{child.tag} {quoted(child.get('name', ''))} in {source}")
    _check_tree(robot, source)
    _check_mimics(robot, source)
    for link in robot.iterfind("link/inertial/.."):
        _check_inertial(link, f"link {quoted(link.get('name', ''))} in {source}")


def _check_expanded(element: ET.Element, source: object) -> None:
    """Check that an element holds no directive or expression of xacro."""
    has_directive = "xacro" in element.tag
    for text in (element.tag, *element.attrib.values()):
        if "${" in text or "$(" in text:
            has_directive = True
    if has_directive:
        raise ModelError(
            f"{source} holds xacro directives; if you trust the file name it .xacro, else ask for "
            "a plain URDF."
        )


def _check_inertial(link: ET.Element, context: str) -> None:
    """Check that a body can have the mass and inertia of a link."""
    mass = link.find("inertial/mass")
    tensor = link.find("inertial/inertia")
    assert mass is not None and tensor is not None  # see _check_element
    number(f"mass of {context}", mass.get("value"), "kg", ">= 0")
    moments = np.linalg.eigvalsh(_inertia_tensor(tensor))

    # With x, y, z along the principal axes, ∫y²+z² dm, ∫z²+x² dm and ∫x²+y² dm are the moments: no
    # body has a negative one, and none exceeds the sum of the other two.
    is_positive = moments[0] >= -NEGATIVE_MOMENT * moments[2]
    fits_others = moments[0] + moments[1] >= _MOMENT_SUM_RATIO * moments[2]
    if not (is_positive and fits_others):
        raise OutOfRange(
            f"principal moments of inertia of {context}",
            ", ".join(f"{moment:.6g}" for moment in moments),
            "positive semidefinite, the largest at most the sum of the others, as of every body; "
            "correct <inertia>",
            "kg m²",
        )


def _inertia_tensor(element: ET.Element) -> np.ndarray:
    """Return the tensor of an element ``<inertia>``, which states one half of it [kg m²], shape
    (3, 3).
    """
    tensor = np.zeros((3, 3))
    for i, first in enumerate("xyz"):
        for j, second in enumerate("xyz"):
            attribute = "i" + "".join(sorted(first + second))  # a file states ixy, never iyx
            tensor[i, j] = float(element.get(attribute, 0))
    return tensor


def _check_tree(robot: ET.Element, source: object) -> None:
    """Check that names of links and joints are unique, and that they form one tree."""
    links = _elements_by_name(robot, "link", source)
    joints = _elements_by_name(robot, "joint", source)
    if not links:
        raise ModelError(f"{source} is not a URDF that can be loaded: it has no link.")
    count = len(links) + len(joints)
    if count > _MAX_ELEMENTS:
        raise ModelError(f"{source} has {count} links and joints; allowed are {_MAX_ELEMENTS}.")
    parents: dict[str, str] = {}
    for name, joint in joints.items():
        context = f"joint {quoted(name)} in {source}"
        child = _connected_link(joint, "child", links, context)
        parent = _connected_link(joint, "parent", links, context)
        if child in parents:
            raise ModelError(
                f"{source} has two joints with the child link {child!r}; allowed is one."
            )
        parents[child] = parent
    link_on_cycle = _name_on_cycle(parents)
    if link_on_cycle is not None:
        raise ModelError(
            f"{source} has joints that form a cycle through link {link_on_cycle!r}; a crane "
            "is a tree."
        )
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        raise ModelError(
            f"{source} has {len(roots)} links that hang on no joint: "
            f"{', '.join(map(quoted, roots[:_MAX_NAMED_ROOTS]))}; allowed is one."
        )


def _check_mimics(robot: ET.Element, source: object) -> None:
    """Check that each joint that mimics another one, directly or through others, follows a joint
    that mimics none.
    """
    joints = {joint.get("name", ""): joint for joint in robot.iterfind("joint")}
    leaders = {}
    for name, joint in joints.items():
        mimic = joint.find("mimic")
        if mimic is None:
            continue
        leader = mimic.get("joint", "")
        leader_type = joints[leader].get("type") if leader in joints else None
        leader_moves = leader_type in ("revolute", "prismatic", "continuous")
        if joint.get("type") != "fixed" and not leader_moves:
            raise ModelError(
                f"The joint {quoted(name)} in {source} mimics {quoted(leader)}, which is no joint "
                "that moves."
            )
        leaders[name] = leader
    follower = _name_on_cycle(leaders)
    if follower is not None:
        raise ModelError(
            f"The joint {quoted(follower)} in {source} mimics itself, through others; one of them "
            "must mimic no other."
        )


def _name_on_cycle(next_names: Mapping[str, str]) -> str | None:
    """Return a name from which a chain of next names leads back to it; None if all chains end.

    Args:
        next_names: The next name by name; a chain ends at a name that has none.
    """
    for name in next_names:
        # A chain that ends has taken no more steps than there are names; one that has not ended by
        # then is on a cycle.
        reached = name
        for _ in next_names:
            reached = next_names.get(reached, reached)
        if reached in next_names:
            return reached
    return None


def _elements_by_name(robot: ET.Element, tag: str, source: object) -> dict[str, ET.Element]:
    """Return all links or all joints by name."""
    elements: dict[str, ET.Element] = {}
    for element in robot.iterfind(tag):
        name = element.get("name")
        if not name:
            raise ModelError(f"{source} has a {tag} without a name.")
        if name in elements:
            raise ModelError(f"{source} has two {tag}s with the name {name!r}; allowed is one.")
        elements[name] = element
    return elements


def _connected_link(
    joint: ET.Element, tag: str, links: Mapping[str, ET.Element], context: str
) -> str:
    """Return the name of the parent or child link of a joint, whichever the tag is."""
    element = joint.find(tag)
    link = None if element is None else element.get("link")
    if link is None:
        raise ModelError(f"The {context} needs a {tag} link.")
    if link not in links:
        raise ModelError(
            f"The {context} has the {tag} link {link!r}, which is not there; add <link "
            f'name="{printable(link)}"/>, or correct the name.'
        )
    return link


def _check_element(element: ET.Element, context: str) -> None:
    """Check names, children and numbers of an element of a link, a joint or a material."""
    for attribute in _NAME_ATTRIBUTES:
        text = element.get(attribute, "")
        if not text.isprintable():
            raise ModelError(
                f"The {attribute} {quoted(text)} in {context} holds characters that cannot be "
                "printed."
            )
    tags = Counter(child.tag for child in element if child.tag not in ("visual", "collision"))
    for tag, count in tags.items():
        if count > 1:
            raise ModelError(
                f"There are {count} elements {quoted(tag)} in one {quoted(element.tag)} of "
                f"{context}; allowed is one."
            )
    if element.tag == "inertial" and not {"mass", "inertia"} <= tags.keys():
        raise ModelError(f"The inertial of {context} needs a mass and an inertia.")
    if element.tag == "joint":
        _check_joint(element, context)
    for attribute, count in _NUMBER_COUNTS.get(element.tag, {}).items():
        _check_numbers(element, attribute, count, context)
    if element.tag == "dynamics":
        number(f"dry friction of {context}", element.get("friction", "0"), allowed=">= 0")


def _check_numbers(element: ET.Element, attribute: str, count: int, context: str) -> None:
    """Check that an attribute holds so many numbers, or is left out where it may be."""
    text = element.get(attribute)
    if text is None:
        if attribute not in _REQUIRED_NUMBERS.get(element.tag, ()):
            return
        text = ""
    texts = text.split()
    if len(texts) != count or not are_numbers(texts):
        kind = "a decimal number" if count == 1 else f"{count} decimal numbers"
        raise OutOfRange(
            f"{attribute} of {element.tag} in {context}",
            repr(text),
            f"{kind} up to {_MAX_NUMBER:g}",
        )


def _check_joint(joint: ET.Element, context: str) -> None:
    """Check the type of a joint, that it has limits if it needs them, and that its ``<dynamics>``
    states a damping or a friction.
    """
    kind = joint.get("type", "")
    if kind not in _JOINT_TYPES:
        raise ModelError(
            f"The {context} is of type {kind!r}; allowed are {', '.join(_JOINT_TYPES)}."
        )
    if kind in _LIMITED_JOINT_TYPES and joint.find("limit") is None:
        raise ModelError(
            f"The {context} is {kind} and has no limit; give it a <limit> with lower, upper, "
            "effort and velocity."
        )
    dynamics = joint.find("dynamics")
    if dynamics is not None and not {"damping", "friction"} & {*dynamics.keys()}:
        raise ModelError(f"The dynamics of {context} needs a damping or a friction.")


def are_numbers(texts: list[str]) -> bool:
    """Return whether all texts are decimal numbers up to 1e30."""
    return all(_DECIMAL.fullmatch(text) and abs(float(text)) <= _MAX_NUMBER for text in texts)


def skeleton(robot: ET.Element) -> str:
    """Return links, inertials and joints of a URDF as a URDF of its own.

    It names no file and holds nothing that was not checked, so that any parser may read it.
    """
    root = ET.Element("robot", name=printable(robot.get("name", "")))
    # Lists here and below, not generators: `Element.extend` turns whatever a generator raises, such
    # as KeyboardInterrupt, into a TypeError.
    root.extend([_filtered(child) for child in robot if child.tag in ("link", "joint")])
    return ET.tostring(root, encoding="unicode")


def without_visuals(robot: ET.Element) -> str:
    """Return a URDF without its visuals: `skeleton` with ``<ros2_control>`` (drives and starts) and
    ``<gazebo>`` (springs). Drives of a ``<transmission>`` are lost, and are recorded by name.
    """
    root = ET.fromstring(skeleton(robot))
    root.extend([deepcopy(child) for child in robot if child.tag in ("gazebo", "ros2_control")])
    return ET.tostring(root, encoding="unicode")


def _filtered(element: ET.Element) -> ET.Element:
    """Return an element with the names, numbers and children that matter for the dynamics."""
    copy = ET.Element(element.tag)
    for attribute in _NAME_ATTRIBUTES:
        text = element.get(attribute)
        if text is not None:
            copy.set(attribute, text)
    for attribute in _NUMBER_COUNTS.get(element.tag, {}):
        text = element.get(attribute)
        if text is not None:
            copy.set(attribute, " ".join(text.split()))
    tags = _DYNAMIC_CHILDREN.get(element.tag, ())
    copy.extend([_filtered(child) for child in element if child.tag in tags])
    return copy


def numbers_text(vector: np.ndarray) -> str:
    """Return the numbers of a vector as an attribute of a URDF, to the bit."""
    # `repr` gives the shortest text that is read back as the same double.
    return " ".join(repr(float(component)) for component in vector)


def joint_placement(joint: ET.Element) -> pin.SE3:
    """Return the placement of a joint in its parent link."""
    origin = joint.find("origin")
    numbers = {} if origin is None else origin.attrib
    position = _vector(numbers.get("xyz", "0 0 0"))
    angles = _vector(numbers.get("rpy", "0 0 0"))
    return pin.SE3(pin.rpy.rpyToMatrix(angles), position)


def joint_axis(joint: ET.Element) -> np.ndarray:
    """Return the axis of a joint as its file states it, of any length, shape (3,)."""
    axis = joint.find("axis")
    return _vector("1 0 0" if axis is None else axis.get("xyz", "1 0 0"))


def _vector(text: str) -> np.ndarray:
    """Return the numbers of an attribute."""
    return np.array([float(component) for component in text.split()])


def initial_values(robot: ET.Element) -> dict[str, ET.Element]:
    """Return the elements that state where joints start, by the names of the joints; the last one
    counts where a file has several.
    """
    values = {}
    for joint in robot.iterfind("ros2_control/joint"):
        for value in joint.iterfind(
            "state_interface[@name='position']/param[@name='initial_value']"
        ):
            values[joint.get("name", "")] = value
    return values


def set_placement(joint: ET.Element, placement: pin.SE3) -> None:
    """Set the placement of a joint in its parent link."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    origin.set("xyz", numbers_text(placement.translation))
    origin.set("rpy", numbers_text(pin.rpy.matrixToRpy(placement.rotation)))


def inertial_element(inertia: pin.Inertia) -> ET.Element:
    """Return mass, centre and inertia of a link."""
    inertial = ET.Element("inertial")
    tensor = inertia.inertia
    ET.SubElement(inertial, "origin", xyz=numbers_text(inertia.lever), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=repr(float(inertia.mass)))
    moments = {
        "ixx": repr(float(tensor[0, 0])),
        "iyy": repr(float(tensor[1, 1])),
        "izz": repr(float(tensor[2, 2])),
        "ixy": repr(float(tensor[0, 1])),
        "ixz": repr(float(tensor[0, 2])),
        "iyz": repr(float(tensor[1, 2])),
    }
    ET.SubElement(inertial, "inertia", moments)
    return inertial
