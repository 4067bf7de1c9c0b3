"""The text of a crane as XML: checked word by word before anything is built from it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy

import numpy as np

from cranedyn.checks import number
from cranedyn.errors import ModelError, OutOfRange, printable, quoted

_DEEPEST, _MOST_PARTS, _LARGEST = 50, 2000, 1e30
_ROUNDED, _FLAT = 1e-9, 0.99
"""By which share of the largest principal moment the least may be below zero: round-off; and what
share of it the others must have together: all of it in a plate, each rounded to three digits."""

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
}
"""How many numbers stand in which attribute of which element."""

_NAMES = ("name", "type", "link")
"""Attributes that name something."""

_NEEDED = {
    name: tuple(_NUMBERS[name]) for name in ("mass", "inertia", "box", "cylinder", "sphere")
} | {"limit": ("effort", "velocity")}
"""Attributes that an element must have."""

_TYPES = ("revolute", "prismatic", "fixed", "continuous", "floating", "planar")
"""How a joint may move, the first two within limits."""

_SKELETON = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics"),
}
"""Which children of an element count for the dynamics."""


class _Guarded(ET.TreeBuilder):
    """Refuses what makes a small file large or a parser slow, before it is expanded: document
    types, which define entities, and depth.
    """

    def __init__(self) -> None:
        super().__init__()
        self._depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ModelError("it has a document type (<!DOCTYPE); leave it out")

    def start(self, tag: str, attributes: dict[str, str]) -> ET.Element:  # type: ignore[override]
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ModelError(f"its elements are nested deeper than {_DEEPEST}")
        return super().start(tag, attributes)

    def end(self, tag: str) -> ET.Element:
        self._depth -= 1
        return super().end(tag)


def parse(text: str, source: object) -> ET.Element:
    """The root of an XML text; no entity is expanded and nothing outside of the text is read.

    Args:
        text: The text.
        source: What to call it in an error.

    Raises:
        ModelError: If it is not XML, has a document type, or is nested too deep.
    """
    try:
        return ET.fromstring(text, ET.XMLParser(target=_Guarded()))
    except (ET.ParseError, ValueError) as error:
        raise ModelError(f"{source} is not XML: {error}.") from error
    except ModelError as error:
        raise ModelError(f"{source} cannot be loaded: {error}.") from None


def check(robot: ET.Element, source: object) -> None:
    """Return if links, joints and materials of a URDF are complete, nothing in them stands twice,
    and every number is one.

    Parsers of URDF drop an element with an unreadable number, take the first of two, ignore
    friction, and carry on, or print on their own what is wrong with the tree of links and joints.

    Raises:
        ModelError: If something is left to expand, a name cannot be printed, an element is double
            or incomplete, a joint mimics another, or links and joints are no tree.
        OutOfRange: If a number is not a decimal number, is beyond 1e30 whatever its unit, a
            friction is not zero, or no body has the mass and inertia of a link.
    """
    for part in robot.iter():
        if "xacro" in part.tag or any(
            mark in value for value in part.attrib.values() for mark in ("${", "$(")
        ):
            raise ModelError(
                f"{source} holds xacro directives; if you trust the file name it .xacro, else ask "
                "for a plain URDF."
            )
    for part in robot:
        if part.tag in ("link", "joint", "material"):
            for element in part.iter():
                _check_element(element, f"{part.tag} {quoted(part.get('name', ''))} in {source}")
    _check_tree(robot, source)
    for link in robot.iterfind("link/inertial/.."):
        _check_inertial(link, f"link {quoted(link.get('name', ''))} in {source}")


def _check_inertial(link: ET.Element, where: str) -> None:
    """Check that a body can have the mass and inertia of a link: by each principal moment it is an
    integral of squares of two coordinates, so that none is more than the sum of the other two.
    """
    mass, tensor = link.find("inertial/mass"), link.find("inertial/inertia")
    assert mass is not None and tensor is not None  # see _check_element
    number(f"mass of {where}", mass.get("value"), "kg", ">= 0")
    moments = np.linalg.eigvalsh(
        [[float(tensor.get("i" + "".join(sorted(a + b)), 0)) for b in "xyz"] for a in "xyz"]
    )
    if not (moments[0] >= -_ROUNDED * moments[2] and moments[0] + moments[1] >= _FLAT * moments[2]):
        raise OutOfRange(
            f"principal moments of inertia of {where}",
            ", ".join(f"{moment:.6g}" for moment in moments),
            "positive semidefinite, the largest at most the sum of the others",
            "kg m²",
        )


def _check_tree(robot: ET.Element, source: object) -> None:
    """Links and joints must have names of their own and make one tree."""
    links, joints = (_named(robot, tag, source) for tag in ("link", "joint"))
    if not links:
        raise ModelError(f"{source} is not a URDF that can be loaded: it has no link.")
    if len(links) + len(joints) > _MOST_PARTS:
        raise ModelError(
            f"{source} has {len(links) + len(joints)} links and joints; allowed are {_MOST_PARTS}."
        )
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
    for link in parents:
        above = link
        for _ in parents:
            above = parents.get(above, above)
        if above in parents:
            raise ModelError(
                f"{source} has joints that lead in a circle through link {above!r}; a crane is a "
                "tree."
            )
    if len(roots := [link for link in links if link not in parents]) > 1:
        raise ModelError(
            f"{source} has {len(roots)} links that hang on no joint: "
            f"{', '.join(map(quoted, roots[:5]))}; allowed is one."
        )


def _named(robot: ET.Element, tag: str, source: object) -> dict[str, ET.Element]:
    """All links or all joints by name."""
    found: dict[str, ET.Element] = {}
    for part in robot.iterfind(tag):
        if not (name := part.get("name")):
            raise ModelError(f"{source} has a {tag} without a name.")
        if name in found:
            raise ModelError(f"{source} has two {tag}s with the name {name!r}; allowed is one.")
        found[name] = part
    return found


def _end(joint: ET.Element, tag: str, links: Mapping[str, ET.Element], where: str) -> str:
    """The link at an end of a joint."""
    ends = joint.findall(tag)
    if not ends or (link := ends[0].get("link")) is None:
        raise ModelError(f"The {where} needs a {tag} link.")
    if link not in links:
        raise ModelError(f"The {where} has the {tag} link {link!r}, which is not there.")
    return link


def _check_element(element: ET.Element, where: str) -> None:
    for name in _NAMES:
        if not (word := element.get(name, "")).isprintable():
            raise ModelError(
                f"The {name} {quoted(word)} in {where} holds characters that cannot be printed."
            )
    tags = Counter(child.tag for child in element if child.tag not in ("visual", "collision"))
    for tag, count in tags.items():
        if count > 1:
            raise ModelError(
                f"There are {count} elements {quoted(tag)} in one {quoted(element.tag)} of "
                f"{where}; allowed is one."
            )
    if element.tag == "inertial" and not {"mass", "inertia"} <= tags.keys():
        raise ModelError(f"The inertial of {where} needs a mass and an inertia.")
    if element.tag == "joint":
        _check_joint(element, where)
    if element.tag == "mimic":
        raise ModelError(f"The {where} mimics another; a crane moves in all of its joints.")
    for name, count in _NUMBERS.get(element.tag, {}).items():
        text = element.get(name, "" if name in _NEEDED.get(element.tag, ()) else None)
        if text is not None and not _are_numbers(text.split(), count):
            allowed = (
                f"{'a decimal number' if count == 1 else f'{count} decimal numbers'} up to "
                f"{_LARGEST:g}"
            )
            raise OutOfRange(f"{name} of {element.tag} in {where}", repr(text), allowed)
    if element.tag == "dynamics" and float(element.get("friction", "0")) != 0.0:
        raise OutOfRange(
            f"friction of {where}", element.get("friction"), "0, since only viscous damping acts"
        )


def _check_joint(joint: ET.Element, where: str) -> None:
    kind = joint.get("type", "")
    if kind not in _TYPES:
        raise ModelError(f"The {where} is of type {kind!r}; allowed are {', '.join(_TYPES)}.")
    if kind in _TYPES[:2] and joint.find("limit") is None:
        raise ModelError(f"The {where} is {kind} and has no limit.")
    dynamics = joint.find("dynamics")
    if dynamics is not None and not {*dynamics.keys()} & {"damping", "friction"}:
        raise ModelError(f"The dynamics of {where} needs a damping.")


def _are_numbers(words: list[str], count: int) -> bool:
    return len(words) == count and all(
        _DECIMAL.fullmatch(word) and abs(float(word)) <= _LARGEST for word in words
    )


def skeleton(robot: ET.Element) -> str:
    """What moves and weighs as a URDF of its own: links, their inertials, and joints.

    It names no file and holds nothing that was not checked, so that it is safe to hand on.
    """
    bare = ET.Element("robot", name=printable(robot.get("name", "")))
    # A list: Ctrl-C in a generator is a TypeError.
    bare.extend([_kept(part) for part in robot if part.tag in ("link", "joint")])
    return ET.tostring(bare, encoding="unicode")


def bare(robot: ET.Element) -> str:
    """The same with what names drives, starts and springs: all of a URDF but its looks."""
    whole = ET.fromstring(skeleton(robot))
    whole.extend([deepcopy(part) for part in robot if part.tag in ("gazebo", "ros2_control")])
    return ET.tostring(whole, encoding="unicode")


def _kept(element: ET.Element) -> ET.Element:
    numbers = _NUMBERS.get(element.tag, {})
    kept = ET.Element(
        element.tag, {name: text for name in _NAMES if (text := element.get(name)) is not None}
    )
    kept.attrib |= {
        name: " ".join(text.split()) for name in numbers if (text := element.get(name)) is not None
    }
    wanted = _SKELETON.get(element.tag, ())
    # a list, since an interruption in the midst of a generator becomes a TypeError there
    kept.extend([_kept(child) for child in element if child.tag in wanted])
    return kept
