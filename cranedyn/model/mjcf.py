"""A crane in MuJoCo's format, MJCF, as a URDF of its joints and masses."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError, OutOfRange, printable, quoted
from cranedyn.model.crane import NO_RATE_LIMIT
from cranedyn.model.urdf import are_numbers, inertial_element, numbers_text, set_placement

_READ = ("compiler", "default", "worldbody", "body", "joint", "freejoint", "geom", "inertial")
"""Elements that say where bodies are, how they move and what they weigh."""

_ACTING = ("tendon", "equality")
"""Elements with forces of their own."""

_FILES = ("plane", "hfield", "mesh")
"""Shapes without a mass, or with that of another file."""

_NUMBERS = frozenset(
    "mass density pos quat euler axisangle xyaxes zaxis axis range size fromto damping armature "
    "frictionloss stiffness diaginertia fullinertia".split()
)
"""Attributes that hold numbers: the parser takes a text for zero."""

_ABSENT = ("frictionloss", "stiffness")
"""Properties of joints that are not carried over."""

_LIGHT = {"pos": "0 0 0", "mass": "1e-5", "diaginertia": "1e-9 1e-9 1e-9"}
"""Body between two joints of one body [kg, kg m²]: other programs drop a link without, and
Gazebo one of at most 1e-6 kg."""

_REACH = {"prismatic": 1e3, "revolute": math.pi}
"""Range to either side of a joint without one [m or rad]."""

_EFFORT = 1e6
"""Largest effort of a joint without a limit [N or N m]."""


def read_mjcf(root: ET.Element, path: Path) -> tuple[ET.Element, list[str]]:
    """Return the URDF of an MJCF model: a link for each body that moves, without looks.

    A ball joint becomes two revolute joints, about X and then Y of its body, since a rope does not
    turn its load. The joints of actuators are driven. No other file is read.

    Args:
        root: Root of the MJCF.
        path: File for error messages.

    Returns:
        The URDF, and a note on each assumption.

    Raises:
        OutOfRange: If a number is none, or a joint has friction or a spring.
        ModelError: If Pinocchio cannot read it, or a joint has several degrees of freedom.
    """
    if root.find(".//include") is not None:
        raise ModelError(f"{path} includes other files; merge them into one (mj_saveLastXML).")
    notes = [
        f"What acts by <{tag}> is left out." for tag in _ACTING if len(root.findall(f"{tag}/*"))
    ]
    for element in root.iter():
        for name in _NUMBERS & element.attrib.keys():
            if not are_numbers(element.get(name, "").split()):
                raise OutOfRange(
                    f"{name} of {element.tag} in {path}", repr(element.get(name)), "decimal numbers"
                )
            if name in _ABSENT and float(element.get(name, "")) != 0.0:
                raise OutOfRange(f"{name} of a joint in {path}", element.get(name), "0")
    bodies = ET.Element("mujoco", model=root.get("model", "crane"))
    bodies.extend([_moving(child, notes) for child in root if child.tag in _READ])
    model = _build(bodies, path)
    driven = {
        actuator.get("joint", "") for group in root.iterfind("actuator") for actuator in group
    }
    return _as_urdf(model, driven, notes, path), notes


def _moving(element: ET.Element, notes: list[str]) -> ET.Element:
    """Return an element with the children that matter for the dynamics, and one joint a body."""
    copy = innermost = ET.Element(element.tag, element.attrib)
    for i, joint in enumerate(_single_joints(element, notes)):
        if i:
            ET.SubElement(innermost, "inertial", _LIGHT)
            notes.append(f"A body of {_LIGHT['mass']} kg is above {joint.get('name')}.")
            innermost = ET.SubElement(innermost, "body", name=f"{joint.get('name')}_body")
        innermost.append(joint)
    for child in element:
        if child.tag == "geom" and child.get("type") in _FILES:
            if child.get("type") == "mesh" and "0" not in (child.get("density"), child.get("mass")):
                notes.append(f"The mesh of {quoted(element.get('name', 'world'))} weighs nothing.")
        elif child.tag in _READ and child.tag != "joint":
            innermost.append(_moving(child, notes))
    return copy


def _single_joints(body: ET.Element, notes: list[str]) -> list[ET.Element]:
    """Return the joints of a body in their order, two hinges for a ball."""
    joints = []
    for joint in body.iterfind("joint"):
        if joint.get("type") != "ball":
            joints.append(joint)
            continue
        name = joint.get("name", f"{body.get('name', 'ball')}_joint")
        notes.append(f"The ball joint {quoted(name)} turns about X, then Y, not about Z.")
        for letter, axis in (("x", "1 0 0"), ("y", "0 1 0")):
            attributes = joint.attrib | {"name": f"{name}_{letter}", "type": "hinge", "axis": axis}
            attributes.pop("range", None)
            joints.append(ET.Element("joint", attributes))
    return joints


def _build(bodies: ET.Element, path: Path) -> pin.Model:
    import tempfile  # it takes long, and few runs need it

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "crane.xml"
        ET.ElementTree(bodies).write(file, encoding="unicode")
        try:
            return pin.buildModelFromMJCF(str(file))
        except (ValueError, RuntimeError) as error:
            text = printable(str(error).strip().splitlines()[-1].rstrip("."))
            raise ModelError(f"{path} is not an MJCF that can be loaded: {text}.") from error


def _as_urdf(model: pin.Model, driven: set[str], notes: list[str], path: Path) -> ET.Element:
    """Return a URDF with a link for each joint of a model."""
    robot = ET.Element("robot", name=model.name or "crane")
    ET.SubElement(robot, "link", name="world")
    control = ET.SubElement(robot, "ros2_control", name="drives", type="system")
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for i, name in enumerate(list(model.names)[1:], start=1):
        joint = model.joints[i]
        if (joint.nq, joint.nv) != (1, 1):
            raise ModelError(
                f"{path} has {quoted(name)}, which moves in {joint.nv} directions; allowed are "
                "slide, hinge and ball joints."
            )
        jacobian = pin.getJointJacobian(model, data, i, pin.LOCAL).reshape(6, model.nv)
        linear, angular = jacobian[:3, i - 1], jacobian[3:, i - 1]
        kind, axis = (
            ("revolute", angular) if np.linalg.norm(angular) > 0.5 else ("prismatic", linear)
        )
        element = ET.SubElement(robot, "joint", name=name, type=kind)
        above = model.parents[i]
        ET.SubElement(element, "parent", link=f"{model.names[above]}_link" if above else "world")
        ET.SubElement(element, "child", link=f"{name}_link")
        set_placement(element, model.jointPlacements[i])
        ET.SubElement(element, "axis", xyz=numbers_text(axis))
        _add_limits(element, model, i - 1, name in driven, notes)
        link = ET.SubElement(robot, "link", name=f"{name}_link")
        link.append(inertial_element(model.inertias[i]))
        if name in driven:
            drive = ET.SubElement(control, "joint", name=name)
            ET.SubElement(drive, "command_interface", name="effort")
    return robot


def _add_limits(
    element: ET.Element, model: pin.Model, i: int, driven: bool, notes: list[str]
) -> None:
    name, kind = element.get("name", ""), element.get("type", "")
    low, high = float(model.lowerPositionLimit[i]), float(model.upperPositionLimit[i])
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = -_REACH[kind], _REACH[kind]
        unit = "m" if kind == "prismatic" else "rad"
        notes.append(f"{name} has no range; {low:g} to {high:g} {unit} are taken.")
    effort = float(model.effortLimit[i])
    if driven and not math.isfinite(effort):
        notes.append(f"{name} has no largest effort; {_EFFORT:g} are taken.")
    effort = min(effort, _EFFORT)
    limits = {"lower": low, "upper": high, "effort": effort, "velocity": NO_RATE_LIMIT}
    dynamics = {"damping": float(model.damping[i]), "armature": float(model.armature[i])}
    for tag, numbers in (("limit", limits), ("dynamics", dynamics)):
        ET.SubElement(element, tag, {key: repr(value) for key, value in numbers.items()})
