"""The text of a crane as XML: checked word by word before anything is built from it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter

from cranedyn.errors import ModelError, OutOfRange

_DEEPEST, _MOST_PARTS, _LARGEST = 50, 2000, 1e30
_DECIMAL = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)

_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), 1),
    "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
    "dynamics": {"damping": 1, "friction": 1},
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "color": {"rgba": 4},
}
"""How many numbers stand in which attribute of which element."""

_COMPLETE = ("mass", "inertia", "box", "cylinder", "sphere")
"""Elements that need all of their attributes."""

_SKELETON = {
    "link": ("inertial",),
    "inertial": ("origin", "mass", "inertia"),
    "joint": ("parent", "child", "origin", "axis", "limit", "dynamics"),
}
"""Which children of an element count for the dynamics."""


class _Guarded(ET.TreeBuilder):
    """Refuses what makes a small file large or a parser slow, before it is expanded: document types, which define entities, and depth."""

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
    """Return if links, joints and materials of a URDF are complete, nothing in them stands twice, and every number is one.

    Parsers of URDF drop an element with an unreadable number, take the first of two, ignore friction, and carry on.

    Raises:
        ModelError: If something is left to expand, an element is double or incomplete, or a joint mimics another.
        OutOfRange: If a number is not a decimal number, is beyond 1e30 whatever its unit, or a friction is not zero.
    """
    for part in robot.iter():
        if "xacro" in part.tag or any(mark in value for value in part.attrib.values() for mark in ("${", "$(")):
            raise ModelError(f"{source} holds xacro directives; if you trust the file name it .xacro, else ask for a plain URDF.")
    for part in robot:
        if part.tag in ("link", "joint", "material"):
            for element in part.iter():
                _check_element(element, f"{part.tag} {part.get('name', '')} in {source}")
    _check_tree(robot, source)


def _check_tree(robot: ET.Element, source: object) -> None:
    """Whoever follows joints from link to link must come to an end."""
    parts = len(robot.findall("link")) + len(robot.findall("joint"))
    if parts > _MOST_PARTS:
        raise ModelError(f"{source} has {parts} links and joints; allowed are {_MOST_PARTS}.")
    parents: dict[str, str] = {}
    for joint in robot.iterfind("joint"):
        child, parent = (end.get("link", "") if (end := joint.find(tag)) is not None else "" for tag in ("child", "parent"))
        if child in parents:
            raise ModelError(f"{source} has two joints with the child link {child!r}; allowed is one.")
        parents[child] = parent
    for link in parents:
        above = link
        for _ in parents:
            above = parents.get(above, above)
        if above in parents:
            raise ModelError(f"{source} has joints that lead in a circle through link {above!r}; a crane is a tree.")


def _check_element(element: ET.Element, where: str) -> None:
    tags = Counter(child.tag for child in element if child.tag not in ("visual", "collision"))
    for tag, count in tags.items():
        if count > 1:
            raise ModelError(f"There are {count} elements {tag} in one {element.tag} of {where}; allowed is one.")
    if element.tag == "inertial" and not {"mass", "inertia"} <= tags.keys():
        raise ModelError(f"The inertial of {where} needs a mass and an inertia.")
    if element.tag == "mimic":
        raise ModelError(f"The {where} mimics another; a crane moves in all of its joints.")
    for name, count in _NUMBERS.get(element.tag, {}).items():
        text = element.get(name, "" if element.tag in _COMPLETE else None)
        if text is not None and not _are_numbers(text.split(), count):
            allowed = f"{'a decimal number' if count == 1 else f'{count} decimal numbers'} up to {_LARGEST:g}"
            raise OutOfRange(f"{name} of {element.tag} in {where}", repr(text), allowed)
    if element.tag == "dynamics" and float(element.get("friction", "0")) != 0.0:
        raise OutOfRange(f"friction of {where}", element.get("friction"), "0, since only viscous damping acts")


def _are_numbers(words: list[str], count: int) -> bool:
    return len(words) == count and all(_DECIMAL.fullmatch(word) and abs(float(word)) <= _LARGEST for word in words)


def skeleton(robot: ET.Element) -> str:
    """What moves and weighs as a URDF of its own: links, their inertials, and joints.

    It names no file and holds nothing that was not checked, so that it is safe to hand on.
    """
    bare = ET.Element("robot", name=robot.get("name", ""))
    bare.extend(_kept(part) for part in robot if part.tag in ("link", "joint"))
    return ET.tostring(bare, encoding="unicode")


def _kept(element: ET.Element) -> ET.Element:
    numbers = _NUMBERS.get(element.tag, {})
    kept = ET.Element(element.tag, {name: text for name in ("name", "type", "link") if (text := element.get(name)) is not None})
    kept.attrib |= {name: " ".join(text.split()) for name in numbers if (text := element.get(name)) is not None}
    kept.extend(_kept(child) for child in element if child.tag in _SKELETON.get(element.tag, ()))
    return kept
