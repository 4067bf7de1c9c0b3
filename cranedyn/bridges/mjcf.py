"""MuJoCo: the crane as an MJCF file, with damping, springs, limits, actuators of the drives,
visuals, and its start as a keyframe.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.bridges.joints import (
    add,
    check_inertias,
    ends,
    joints,
    urdf_element,
    vector,
    xml_bytes,
)
from cranedyn.bridges.target import new_file
from cranedyn.checks import number
from cranedyn.data.files import with_ending
from cranedyn.errors import ModelError, quoted
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options

TARGET = "FILE"
EXAMPLE = "crane.xml"


def export(file: str | Path, crane: Crane, *, dt: float = 5e-4) -> Path:
    """Write a crane as an MJCF file.

    Its step is that of `simulate`: semi-implicit Euler with damping at the rates before the step.
    Each drive is a motor that takes its effort [N m or N] as control, within the drive's limits;
    passive joints have none. Joint ranges act where a joint leaves them. The keyframe ``start`` is
    where the crane starts, with the efforts that hold it there; MuJoCo's own zero lies outside of
    the ranges.

    Args:
        file: New file, ending in .xml.
        crane: The crane.
        dt: Physics step [s].

    Raises:
        DataError: If the ending is not .xml, or the file exists or cannot be written.
        ModelError: If the crane has a moving link without mass or inertia, a shape without size, a
            mesh, or a rope that stretches.
        OutOfRange: If the step is not positive.
    """
    file = with_ending(file, ".xml")
    crane.require_independent_joints("The export to MuJoCo")
    robot = urdf_element(crane)
    check_inertias(crane, robot, "MuJoCo")
    text = xml_bytes(mjcf(crane, robot, number("dt", dt, "s", "> 0")))
    with new_file(file) as draft:
        draft.write_bytes(text)
    return file


def mjcf(crane: Crane, robot: ET.Element, dt: float) -> ET.Element:
    """Return the crane as MJCF, from its URDF as XML; physics step in s."""
    root = ET.Element("mujoco", model=robot.get("name", "crane"))
    # angles in radians, roll pitch yaw about fixed axes; what has no inertial has no mass
    add(
        root, "compiler", angle="radian", eulerseq="XYZ", inertiafromgeom="false", autolimits="true"
    )
    gravity = f"0 0 {-crane.gravity!r}"
    option = add(root, "option", timestep=repr(dt), gravity=gravity, integrator="Euler")
    add(option, "flag", eulerdamp="disable")
    colours = {
        m.get("name", ""): c.get("rgba", "")
        for m in robot.iterfind("material")
        for c in m.iterfind("color")
    }
    moving = joints(crane, robot)
    _Tree(crane, robot, colours).grow(add(root, "worldbody"))
    actuators = add(root, "actuator")
    for joint in moving:
        if joint.driven:
            name, limits = joint.name.removesuffix("_joint"), f"{-joint.effort!r} {joint.effort!r}"
            add(actuators, "motor", name=name, joint=joint.name, ctrlrange=limits)
    start = " ".join(repr(joint.start) for joint in moving)
    holding = " ".join(repr(joint.holding) for joint in moving if joint.driven)
    add(add(root, "keyframe"), "key", name="start", qpos=start, ctrl=holding)
    return root


class _Tree:
    """Links and joints of a URDF as nested bodies."""

    def __init__(self, crane: Crane, robot: ET.Element, colours: Mapping[str, str]) -> None:
        self.links = {link.get("name", ""): link for link in robot.iterfind("link")}
        self.moving = {joint.name: i for i, joint in enumerate(crane.layout.joints)}
        self.crane, self.colours = crane, colours
        self.children: dict[str, list[tuple[str, ET.Element]]] = {}
        below = set()
        for joint in robot.iterfind("joint"):
            parent, child = ends(joint)
            self.children.setdefault(parent, []).append((child, joint))
            below.add(child)
        (self.root,) = self.links.keys() - below

    def grow(self, world: ET.Element) -> None:
        """Attach the root, or the children of a root of the name world, to the world."""
        body = world if self.root == "world" else add(world, "body", name=self.root)
        self._fill(body, self.root)

    def _fill(self, body: ET.Element, link: str) -> None:
        for visual in self.links[link].iterfind("visual"):
            self._geom(body, visual, link)
        for child, joint in self.children.get(link, []):
            inner = add(body, "body", name=child, **_pose(joint))
            if (i := self.moving.get(joint.get("name", ""))) is not None:
                inner.append(_joint(self.crane, i, joint.find("axis")))
            if (inertial := self.links[child].find("inertial")) is not None:
                inner.append(_inertial(inertial))
            self._fill(inner, child)

    def _geom(self, body: ET.Element, visual: ET.Element, link: str) -> None:
        for shape in visual.iterfind("geometry/*"):
            if shape.tag == "box":
                size = (vector(shape.get("size", "")) / 2.0).tolist()
            else:
                size = [float(shape.get("radius", "0"))]
                if shape.tag == "cylinder":
                    size.append(float(shape.get("length", "0")) / 2.0)
            if not min(size) > 0.0:
                raise ModelError(
                    f"A {shape.tag} of the link {quoted(link)} has no size, with which MuJoCo "
                    "takes no file; allowed are numbers > 0."
                )
            geom = add(body, "geom", type=shape.tag, size=" ".join(map(repr, size)))
            geom.attrib |= {"contype": "0", "conaffinity": "0", "group": "2", **_pose(visual)}
            material = visual.find("material")
            if material is not None:
                colour = material.find("color")
                named = self.colours.get(material.get("name", ""), "")
                if rgba := named if colour is None else colour.get("rgba", ""):
                    geom.set("rgba", rgba)


def _pose(element: ET.Element) -> dict[str, str]:
    """Return the pose of a URDF element's origin."""
    origin = element.find("origin")
    pose = {} if origin is None else {"pos": origin.get("xyz", ""), "euler": origin.get("rpy", "")}
    return {name: " ".join(text.split()) for name, text in pose.items() if text}


def _joint(crane: Crane, i: int, axis: ET.Element | None) -> ET.Element:
    """Return the joint of a coordinate, about or along an axis of the URDF."""
    joint, springs = crane.layout.joints[i], crane.springs
    kind = "hinge" if joint.unit == "rad" else "slide"
    element = ET.Element("joint", name=joint.name, type=kind)
    element.set("axis", "1 0 0" if axis is None else axis.get("xyz", "1 0 0"))
    element.set("range", f"{float(crane.lower[i])!r} {float(crane.upper[i])!r}")
    numbers = {"damping": crane.damping[i], "armature": crane.model.armature[i]}
    if springs.stiffness[i]:
        numbers |= {"stiffness": springs.stiffness[i], "springref": springs.rest[i]}
    for name, amount in numbers.items():
        element.set(name, repr(float(amount)))
    return element


def _inertial(inertial: ET.Element) -> ET.Element:
    """Return mass and inertia; a rotated inertia is expressed in the body's axes, since MJCF takes
    a full inertia in these only.
    """
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None and inertia is not None  # the URDF was checked
    pose = _pose(inertial)
    keys = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    tensor = np.array([[float(inertia.get(key, "0")) for key in row] for row in keys])
    if rpy := pose.pop("euler", ""):
        turn = pin.rpy.rpyToMatrix(vector(rpy))
        tensor = turn @ tensor @ turn.T
    diagonal = not np.any(tensor - np.diag(np.diag(tensor)))
    components = np.diag(tensor) if diagonal else tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    name = "diaginertia" if diagonal else "fullinertia"
    entries = {
        "pos": pose.get("pos", "0 0 0"),
        "mass": mass.get("value", ""),
        name: " ".join(map(repr, components.tolist())),
    }
    return ET.Element("inertial", entries)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument("--dt", type=float, default=5e-4, metavar="DT", help="physics step [s]")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    return export(options.target, crane_from_options(options), dt=options.dt)
