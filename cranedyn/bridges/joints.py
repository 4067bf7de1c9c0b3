"""Data of a crane for other programs: names of its signals, a controller as tables, joints by name,
and its URDF as XML.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from cranedyn.controllers.affine import Affine, affine_form
from cranedyn.dynamics.pinocchio import full, holding_effort
from cranedyn.errors import DataError, ModelError, OutOfRange, quoted
from cranedyn.interfaces import Controller
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint
from cranedyn.model.urdf import parse_urdf


def state_names(crane: Crane) -> list[str]:
    """Return the names of coordinates and rates, such as x and x_dot, in the order of z."""
    return [*crane.layout.symbols, *(f"{name}_dot" for name in crane.layout.symbols)]


def input_names(crane: Crane, drive: str) -> list[str]:
    """Return the names of the commands: torque T or force F of each drive, such as F_x, with
    "motion" its acceleration, such as x_ddot, or with "velocity" its rate, such as x_dot_command.
    """
    ending = {"motion": "ddot", "velocity": "dot_command"}.get(drive)
    return [
        joint.effort_name if ending is None else f"{joint.symbol}_{ending}"
        for joint in crane.layout.driven
    ]


def finite_form(
    controller: Controller, times: np.ndarray, positions: np.ndarray, width: int, program: str
) -> Affine:
    """Return the affine form of a controller for another program, see `affine_form`.

    Raises:
        DataError: If there is none.
        OutOfRange: If it holds a number that is not finite.
    """
    form = affine_form(controller, times, positions, width)
    if form is None:
        raise DataError(
            f"The controller {type(controller).__name__} is not affine in the state, or has run "
            f"before; {program} runs tables, not Python."
        )
    if lacking := form.lacking():
        name = f"{lacking} of the controller"
        raise OutOfRange(name, "not finite in some row", "finite numbers")
    return form


@dataclass(frozen=True, kw_only=True)
class ExportedJoint(Joint):
    """Joint of a layout with the properties that exporters write.

    Attributes:
        lower, upper: Range [rad or m].
        effort: Largest effort [N m or N].
        start: Coordinate at the start of a run [rad or m].
        holding: Effort of the drive that holds the crane at rest there [N m or N], 0 of a joint
            without a drive.
    """

    lower: float
    upper: float
    effort: float
    start: float
    holding: float


def urdf_element(crane: Crane, *, keep_package_meshes: bool = False) -> ET.Element:
    """Return the crane's URDF as XML, without comments, and without meshes except those of ROS
    packages on demand, its axes of length one: other programs take a very short axis for none.

    Raises:
        ModelError: If it has a rope or two falls, whose stiffness changes with their length.
    """
    robot = parse_urdf(crane.urdf, "the crane")
    for link in robot.iterfind("link"):
        for body in [*link.iterfind("visual"), *link.iterfind("collision")]:
            mesh = body.find("geometry/mesh")
            package_mesh = mesh is not None and mesh.get("filename", "").startswith("package://")
            if mesh is not None and not (keep_package_meshes and package_mesh):
                link.remove(body)  # a file of its own
    for tag, what in (
        ("ropeStiffness", "rope that stretches"),
        ("fallSpacing", "load on two falls"),
    ):
        if next(robot.iter(tag), None) is not None:
            raise ModelError(
                f"The crane has a {what}; no format that is exported knows a stiffness that "
                "changes with the length."
            )
    for axis in robot.iter("axis"):
        if xyz := axis.get("xyz"):
            numbers = vector(xyz).tolist()
            if not math.isclose(length := math.hypot(*numbers), 1.0):
                axis.set("xyz", " ".join(repr(number / length) for number in numbers))
    return robot


def joints(crane: Crane, robot: ET.Element) -> tuple[ExportedJoint, ...]:
    """Return the moving joints of a crane in the order of its coordinates, from its model and its
    URDF.
    """
    elements = {element.get("name", ""): element for element in robot.iterfind("joint")}
    holding = full(crane, holding_effort(crane, crane.start.q))
    exported = []
    for i, joint in enumerate(crane.layout.joints):
        limit = elements[joint.name].find("limit")
        assert limit is not None  # the crane was loaded from this text
        exported.append(
            ExportedJoint(
                **vars(joint),
                lower=float(crane.lower[i]),
                upper=float(crane.upper[i]),
                effort=float(limit.get("effort", "0")),
                start=float(crane.start.q[i]),
                holding=float(holding[i]),
            )
        )
    return tuple(exported)


def ends(joint: ET.Element) -> tuple[str, str]:
    """Return the names of the links that a joint of a URDF connects, parent and child."""
    parent, child = joint.find("parent"), joint.find("child")
    assert parent is not None and child is not None  # the URDF was checked
    return parent.get("link", ""), child.get("link", "")


def vector(text: str) -> np.ndarray:
    """Return the numbers of a text, shape (words,)."""
    return np.array([float(word) for word in text.split()])


def add(parent: ET.Element, tag: str, text: object = None, **attributes: str) -> ET.Element:
    """Append an element with a text and attributes to another one, and return it."""
    element = ET.SubElement(parent, tag, attributes)
    element.text = None if text is None else str(text)
    return element


def xml_bytes(root: ET.Element) -> bytes:
    """Return the text of an XML file, indented."""
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True)


def check_inertias(crane: Crane, robot: ET.Element, program: str) -> None:
    """Check that every moving link has mass and inertia of its own; some engines drop a link
    without them and all that it carries.

    Raises:
        ModelError: If a link has none; the message names it.
    """
    names = {joint.name for joint in crane.layout.joints}
    moving = {ends(joint)[1] for joint in robot.iterfind("joint") if joint.get("name") in names}
    for link in robot.iterfind("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if name not in moving:
            continue
        numbers = [
            float(number)
            for tag, keys in (("mass", ["value"]), ("inertia", ["ixx", "iyy", "izz"]))
            for element in ([] if inertial is None else inertial.iterfind(tag))
            for key in keys
            if (number := element.get(key)) is not None
        ]
        if len(numbers) != 4 or min(numbers) <= 0.0:
            raise ModelError(
                f"The link {quoted(name)} has no mass or no inertia, with which {program} drops "
                "it; allowed are numbers > 0."
            )


def anchor_to_world(robot: ET.Element, program: str) -> ET.Element:
    """Change a URDF so that Gazebo loads all of it: make the link ``world`` its root, and give
    every link fixed to that an inertial.

    Gazebo silently drops a link without an inertial and all that it carries; the values do not
    matter for a fixed link.

    Raises:
        ModelError: If another link than the root has that name, or a joint has an armature, which
            Gazebo does not support.
    """
    for joint in robot.iterfind("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is not None and float(dynamics.get("armature", "0")):
            raise ModelError(
                f"The joint {quoted(joint.get('name', ''))} has an armature, the inertia of its "
                "motor, which Gazebo does not know; allowed is 0."
            )
    children = {ends(joint)[1] for joint in robot.iterfind("joint")}
    links = {link.get("name", ""): link for link in robot.iterfind("link")}
    (root,) = links.keys() - children
    rigid = [ends(joint) for joint in robot.iterfind("joint") if joint.get("type") == "fixed"]
    fixed = {root}
    while further := {child for parent, child in rigid if parent in fixed} - fixed:
        fixed |= further
    if root != "world":
        if "world" in links:
            raise ModelError(
                f"The crane has a link world that is not its root, {quoted(root)}; {program} "
                "hangs a crane on that link."
            )
        robot.insert(0, ET.Element("link", name="world"))
        joint = add(robot, "joint", name="fixed_to_the_world", type="fixed")
        add(joint, "parent", link="world")
        add(joint, "child", link=root)
    for name in fixed - {"world"}:
        if links[name].find("inertial") is None:
            inertial = add(links[name], "inertial")
            add(inertial, "mass", value="1")
            add(inertial, "inertia", ixx="1", iyy="1", izz="1", ixy="0", ixz="0", iyz="0")
    return robot
