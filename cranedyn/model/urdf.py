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
"""Most links and joints of a file."""

_MAX_NUMBER = 1e30
"""Largest number in a file: products of several of them are still finite."""

NEGATIVE_MOMENT = 1e-9
"""How far the least principal moment may be below zero by round-off, as a share of the largest."""

_FLAT = 0.99
"""What the two smaller principal moments add up to at least, as a share of the largest: all of it
for a plate, here with moments rounded to three digits."""

_DECIMAL = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1, "armature": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "color": {"rgba": 4},
    "mimic": {"multiplier": 1, "offset": 1},
}
"""Count of numbers in each attribute of each element."""

_NAMES = ("name", "type", "link", "joint")
"""Attributes that are names."""

_NEEDED = {
    name: tuple(_NUMBERS[name]) for name in ("mass", "inertia", "box", "cylinder", "sphere")
} | {"limit": ("effort", "velocity")}
"""Required attributes of elements."""

_TYPES = ("revolute", "prismatic", "fixed", "continuous", "floating", "planar")
"""Types of joints, the first two with limits."""

_SKELETON = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
}
"""Children of elements that matter for the dynamics."""


class _Guarded(ET.TreeBuilder):
    """Builder that refuses document types, which define entities, and great depth: both let a small
    file take much memory or time.
    """

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ModelError("it has a document type (<!DOCTYPE); leave it out")

    def start(self, tag: str, attributes: dict[str, str]) -> ET.Element:  # type: ignore[override]
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ModelError(f"its elements are nested deeper than {_MAX_DEPTH}")
        return super().start(tag, attributes)

    def end(self, tag: str) -> ET.Element:
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
        return ET.fromstring(text, ET.XMLParser(target=_Guarded()))
    except (ET.ParseError, ValueError) as error:
        raise ModelError(f"{source} is not XML: {error}.") from error
    except ModelError as error:
        raise ModelError(f"{source} cannot be loaded: {error}.") from None


def check_urdf(robot: ET.Element, source: object) -> None:
    """Check links, joints and materials of a URDF.

    Parsers of URDF silently drop an element with an unreadable number, and take the first of two.

    Raises:
        ModelError: If xacro directives are left, a name cannot be printed, an element is duplicate
            or incomplete, a joint mimics none that moves, or links and joints are no tree.
        OutOfRange: If a number is not a decimal number, exceeds 1e30, a friction is negative, or no
            body has the mass and inertia of a link.
    """
    for element in robot.iter():
        texts = [element.tag, *element.attrib.values()]
        if "xacro" in element.tag or any(mark in text for text in texts for mark in ("${", "$(")):
            raise ModelError(
                f"{source} holds xacro directives; if you trust the file name it .xacro, else ask "
                "for a plain URDF."
            )
    for child in robot:
        if child.tag in ("link", "joint", "material"):
            for element in child.iter():
                _check_element(element, f"{child.tag} {quoted(child.get('name', ''))} in {source}")
    _check_tree(robot, source)
    _check_mimics(robot, source)
    for link in robot.iterfind("link/inertial/.."):
        _check_inertial(link, f"link {quoted(link.get('name', ''))} in {source}")


def _check_inertial(link: ET.Element, context: str) -> None:
    """Check that a body can have the mass and inertia of a link: a principal moment is an integral
    of squares of two coordinates, so that none exceeds the sum of the other two.
    """
    mass, tensor = link.find("inertial/mass"), link.find("inertial/inertia")
    assert mass is not None and tensor is not None  # see _check_element
    number(f"mass of {context}", mass.get("value"), "kg", ">= 0")
    moments = np.linalg.eigvalsh(
        [[float(tensor.get("i" + "".join(sorted(a + b)), 0)) for b in "xyz"] for a in "xyz"]
    )
    if not (
        moments[0] >= -NEGATIVE_MOMENT * moments[2]
        and moments[0] + moments[1] >= _FLAT * moments[2]
    ):
        raise OutOfRange(
            f"principal moments of inertia of {context}",
            ", ".join(f"{moment:.6g}" for moment in moments),
            "positive semidefinite, the largest at most the sum of the others, as of every body; "
            "correct <inertia>",
            "kg m²",
        )


def _check_tree(robot: ET.Element, source: object) -> None:
    """Check that names of links and joints are unique, and that they form one tree."""
    links, joints = (_named(robot, tag, source) for tag in ("link", "joint"))
    if not links:
        raise ModelError(f"{source} is not a URDF that can be loaded: it has no link.")
    if (count := len(links) + len(joints)) > _MAX_ELEMENTS:
        raise ModelError(f"{source} has {count} links and joints; allowed are {_MAX_ELEMENTS}.")
    parents: dict[str, str] = {}
    for name, joint in joints.items():
        child, parent = (
            _end(joint, tag, links, f"joint {quoted(name)} in {source}")
            for tag in ("child", "parent")
        )
        if child in parents:
            raise ModelError(
                f"{source} has two joints with the child link {child!r}; allowed is one."
            )
        parents[child] = parent
    if (link := _on_a_circle(parents)) is not None:
        raise ModelError(
            f"{source} has joints that lead in a circle through link {link!r}; a crane is a tree."
        )
    if len(roots := [link for link in links if link not in parents]) > 1:
        raise ModelError(
            f"{source} has {len(roots)} links that hang on no joint: "
            f"{', '.join(map(quoted, roots[:5]))}; allowed is one."
        )


def _check_mimics(robot: ET.Element, source: object) -> None:
    """Check that each joint that mimics another one leads to a joint that moves by itself."""
    joints = {joint.get("name", ""): joint for joint in robot.iterfind("joint")}
    leaders = {}
    for name, joint in joints.items():
        if (mimic := joint.find("mimic")) is None:
            continue
        leader = mimic.get("joint", "")
        kind = joints[leader].get("type") if leader in joints else None
        if joint.get("type") != "fixed" and kind not in ("revolute", "prismatic", "continuous"):
            raise ModelError(
                f"The joint {quoted(name)} in {source} mimics {quoted(leader)}, which is no joint "
                "that moves."
            )
        leaders[name] = leader
    if (follower := _on_a_circle(leaders)) is not None:
        raise ModelError(
            f"The joint {quoted(follower)} in {source} mimics itself, through others; one of them "
            "must move by itself."
        )


def _on_a_circle(next_of: Mapping[str, str]) -> str | None:
    """Return a name from which the next ones lead back to it, None if all chains end."""
    for name in next_of:
        for _ in next_of:
            name = next_of.get(name, name)
        if name in next_of:
            return name
    return None


def _named(robot: ET.Element, tag: str, source: object) -> dict[str, ET.Element]:
    """Return all links or all joints by name."""
    elements: dict[str, ET.Element] = {}
    for element in robot.iterfind(tag):
        if not (name := element.get("name")):
            raise ModelError(f"{source} has a {tag} without a name.")
        if name in elements:
            raise ModelError(f"{source} has two {tag}s with the name {name!r}; allowed is one.")
        elements[name] = element
    return elements


def _end(joint: ET.Element, tag: str, links: Mapping[str, ET.Element], context: str) -> str:
    """Return the parent or child link of a joint."""
    ends = joint.findall(tag)
    if not ends or (link := ends[0].get("link")) is None:
        raise ModelError(f"The {context} needs a {tag} link.")
    if link not in links:
        raise ModelError(
            f"The {context} has the {tag} link {link!r}, which is not there; add <link "
            f'name="{printable(link)}"/>, or correct the name.'
        )
    return link


def _check_element(element: ET.Element, context: str) -> None:
    for name in _NAMES:
        if not (text := element.get(name, "")).isprintable():
            raise ModelError(
                f"The {name} {quoted(text)} in {context} holds characters that cannot be printed."
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
    for name, count in _NUMBERS.get(element.tag, {}).items():
        default = "" if name in _NEEDED.get(element.tag, ()) else None
        numbers = element.get(name, default)
        texts = None if numbers is None else numbers.split()
        if texts is not None and not (len(texts) == count and are_numbers(texts)):
            allowed = (
                f"{'a decimal number' if count == 1 else f'{count} decimal numbers'} up to "
                f"{_MAX_NUMBER:g}"
            )
            raise OutOfRange(f"{name} of {element.tag} in {context}", repr(numbers), allowed)
    if element.tag == "dynamics":
        number(f"dry friction of {context}", element.get("friction", "0"), allowed=">= 0")


def _check_joint(joint: ET.Element, context: str) -> None:
    kind = joint.get("type", "")
    if kind not in _TYPES:
        raise ModelError(f"The {context} is of type {kind!r}; allowed are {', '.join(_TYPES)}.")
    if kind in _TYPES[:2] and joint.find("limit") is None:
        raise ModelError(
            f"The {context} is {kind} and has no limit; give it a <limit> with lower, upper, "
            "effort and velocity."
        )
    dynamics = joint.find("dynamics")
    if dynamics is not None and not {*dynamics.keys()} & {"damping", "friction"}:
        raise ModelError(f"The dynamics of {context} needs a damping.")


def are_numbers(texts: list[str]) -> bool:
    """Return whether all texts are decimal numbers up to 1e30."""
    return all(_DECIMAL.fullmatch(text) and abs(float(text)) <= _MAX_NUMBER for text in texts)


def skeleton(robot: ET.Element) -> str:
    """Return links, inertials and joints of a URDF as a URDF of its own.

    It names no file and holds nothing that was not checked, so that any parser may read it.
    """
    root = ET.Element("robot", name=printable(robot.get("name", "")))
    # Lists here and below: Ctrl-C in a generator would become a TypeError.
    root.extend([_filtered(child) for child in robot if child.tag in ("link", "joint")])
    return ET.tostring(root, encoding="unicode")


def bare(robot: ET.Element) -> str:
    """Return all of a URDF but its looks: `skeleton` with drives, starts and springs."""
    root = ET.fromstring(skeleton(robot))
    root.extend([deepcopy(child) for child in robot if child.tag in ("gazebo", "ros2_control")])
    return ET.tostring(root, encoding="unicode")


def _filtered(element: ET.Element) -> ET.Element:
    """Return an element with the names, numbers and children that matter for the dynamics."""
    copy = ET.Element(element.tag)
    for key in (*_NAMES, *_NUMBERS.get(element.tag, {})):
        if (text := element.get(key)) is not None:
            copy.set(key, text if key in _NAMES else " ".join(text.split()))
    children = _SKELETON.get(element.tag, ())
    copy.extend([_filtered(child) for child in element if child.tag in children])
    return copy


def numbers_text(vector: np.ndarray) -> str:
    """Return the numbers of a vector as an attribute of a URDF, to the bit."""
    return " ".join(repr(float(component)) for component in vector)


def joint_placement(joint: ET.Element) -> pin.SE3:
    """Return the placement of a joint in its parent link."""
    origin = joint.find("origin")
    texts = {} if origin is None else origin.attrib
    xyz, rpy = (
        np.array([float(number) for number in texts.get(key, "0 0 0").split()])
        for key in ("xyz", "rpy")
    )
    return pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz)


def joint_axis(joint: ET.Element) -> np.ndarray:
    """Return the axis of a joint as its file says it, of any length, shape (3,)."""
    axis = joint.find("axis")
    text = "1 0 0" if axis is None else axis.get("xyz", "1 0 0")
    return np.array([float(number) for number in text.split()])


def initial_values(robot: ET.Element) -> dict[str, ET.Element]:
    """Return the elements that say where joints start, by the names of the joints; the last one
    counts where a file has several.
    """
    return {
        joint.get("name", ""): value
        for joint in robot.iterfind("ros2_control/joint")
        for value in joint.iterfind(
            "state_interface[@name='position']/param[@name='initial_value']"
        )
    }


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
        f"i{a}{b}": repr(float(tensor["xyz".index(a), "xyz".index(b)]))
        for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
    }
    ET.SubElement(inertial, "inertia", moments)
    return inertial
