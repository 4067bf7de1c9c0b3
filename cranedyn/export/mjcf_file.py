"""MuJoCo: the crane as an MJCF file, with damping, springs, limits, actuators of the drives,
visuals, and its start as a keyframe.
"""

from __future__ import annotations

import argparse
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.command import command_line
from cranedyn.data.files import with_ending
from cranedyn.errors import ModelError, quoted
from cranedyn.export.crane_data import (
    LIGHT_BODY_MASS,
    LengthSpring,
    add,
    check_inertias,
    ends,
    frozen_spring,
    joints,
    link_inertia,
    make_light,
    massless_links,
    remove_length_tags,
    urdf_element,
    vector,
    xml_bytes,
)
from cranedyn.export.point_masses import give_bodies_to_points
from cranedyn.export.target import new_file
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.model.urdf import joint_axis, joint_placement, numbers_text

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "crane.xml"
"""Example of a target, for the help of the command line."""

SLACK_LENGTH = 1e3
"""Length by which a rope may be slack in MuJoCo [m]: further than any hoist reaches."""

STOP_IMPEDANCE = 0.9999
"""Impedance of the limit that holds an inextensible rope in MuJoCo; 0.9999 is the largest that it
takes."""

STOP_DAMPING_RATIO = 2.0
"""Damping ratio of that limit."""

_FULL_INERTIA = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
"""Rows and columns of the components of a full inertia in MJCF: xx, yy, zz, xy, xz, yz."""


def export(file: str | Path, crane: Crane, *, dt: float = 5e-4) -> Path:
    """Write a crane as an MJCF file.

    A rope that stretches is a tendon that pulls and does not push, and two falls are a spring
    against the yaw, both with the stiffness of the length at the start; the text ``validity`` in
    the file says where that holds, and the number ``stiffness_times_length`` is what to divide by
    the present length for the stiffness there. A rope that goes slack and does not stretch is a
    tendon of limited length.

    Links without mass between two joints become one body with both joints; those with a visual are
    light bodies. A hook block that is a point becomes a solid ball of steel. The text ``notes``
    says what was changed. The number ``JOINT_rate_limit`` is the largest rate of a drive that has
    one; MuJoCo itself limits no rates.

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
        ModelError: If the crane has a moving link without mass or inertia that carries no other, or
            a shape without size.
        OutOfRange: If the step is not positive.
    """
    file = with_ending(file, ".xml")
    crane.require_independent_joints("The export to MuJoCo")
    number("dt", dt, "s", "> 0")
    robot = urdf_element(crane)
    notes = give_bodies_to_points(crane, robot, share_masses=False)
    notes += _give_light_bodies(crane, robot)
    check_inertias(crane, robot, "MuJoCo", merged=_merged_links(crane, robot))
    root = mjcf(crane, robot, dt)
    if notes:
        add(_section(root, "custom"), "text", name="notes", data=" ".join(notes))
    text = xml_bytes(root)
    with new_file(file) as draft:
        draft.write_bytes(text)
    return file


def mjcf(crane: Crane, robot: ET.Element, dt: float) -> ET.Element:
    """Return the crane as MJCF.

    Args:
        crane: The crane.
        robot: Its URDF, see `crane_data.urdf_element`; the tags of a rope or of two falls are
            removed from it.
        dt: Physics step [s].

    Raises:
        ModelError: As `export`.
    """
    root = ET.Element("mujoco", model=robot.get("name", "crane"))
    # As in a URDF, roll, pitch and yaw are about fixed axes, and a link without an inertial has no
    # mass, whatever its looks.
    add(
        root, "compiler", angle="radian", eulerseq="XYZ", inertiafromgeom="false", autolimits="true"
    )
    gravity = f"0 0 {-crane.gravity!r}"
    option = add(root, "option", timestep=repr(dt), gravity=gravity, integrator="Euler")
    # Damping acts at the rates before the step, as in `simulate`.
    add(option, "flag", eulerdamp="disable")
    colours = {}
    for material in robot.iterfind("material"):
        for colour in material.iterfind("color"):
            colours[material.get("name", "")] = colour.get("rgba", "")
    moving = joints(crane, robot)
    remove_length_tags(robot)
    _Tree(crane, robot, colours).grow(add(root, "worldbody"))
    actuators = add(root, "actuator")
    for joint in moving:
        if joint.driven:
            name = joint.name.removesuffix("_joint")
            limits = f"{-joint.effort!r} {joint.effort!r}"
            add(actuators, "motor", name=name, joint=joint.name, ctrlrange=limits)
    rope = crane.springs.rope
    if rope is not None and rope.inextensible:
        _add_inextensible_rope(root, crane.layout.joints[rope.stretch].name, dt)
    else:
        _add_length_spring(root, frozen_spring(crane, "MuJoCo"))
    _add_rate_limits(root, crane)
    start = " ".join(repr(joint.start) for joint in moving)
    holding = " ".join(repr(joint.holding) for joint in moving if joint.driven)
    add(add(root, "keyframe"), "key", name="start", qpos=start, ctrl=holding)
    return root


def _section(root: ET.Element, tag: str) -> ET.Element:
    """Return a section of a model; it is appended if the model has none yet."""
    present = root.find(tag)
    return add(root, tag) if present is None else present


def _joint_element(root: ET.Element, name: str) -> ET.Element:
    """Return the joint of a name in a model."""
    (joint,) = (joint for joint in root.iter("joint") if joint.get("name") == name)
    return joint


def _add_length_spring(root: ET.Element, spring: LengthSpring | None) -> None:
    """Append the spring of a rope or of two falls to a model, and where it holds."""
    if spring is None:
        return
    custom = _section(root, "custom")
    add(custom, "text", name="validity", data=spring.validity)
    add(custom, "numeric", name="stiffness_times_length", data=repr(spring.times_length))
    if not spring.pulls_only:
        joint = _joint_element(root, spring.joint)
        joint.attrib |= {"stiffness": repr(spring.stiffness), "springref": "0"}
        return
    # The length of the tendon is the stretch of the rope. Between the two ends of ``springlength``
    # there is no force: the tendon pulls above 0, and does not push below.
    tendon = add(
        add(root, "tendon"),
        "fixed",
        name="rope",
        stiffness=repr(spring.stiffness),
        springlength=f"{-SLACK_LENGTH!r} 0",
    )
    add(tendon, "joint", joint=spring.joint, coef="1")


def _add_inextensible_rope(root: ET.Element, stretch: str, dt: float) -> None:
    """Append an inextensible rope to a model: a tendon whose length, the stretch, is limited at 0;
    and how exactly MuJoCo keeps that.

    Args:
        root: The model.
        stretch: Name of the joint that is the stretch of the rope.
        dt: Physics step [s].
    """
    # MuJoCo keeps a limit as a damped spring of its own, with a time constant of two steps at
    # least. Critically damped, its discrete steps throw a falling load back.
    time_constant = 2.0 * dt
    tendon = add(
        add(root, "tendon"),
        "fixed",
        name="rope",
        range=f"{-SLACK_LENGTH!r} 0",
        solreflimit=f"{time_constant!r} {STOP_DAMPING_RATIO!r}",
        solimplimit=f"{STOP_IMPEDANCE!r} {STOP_IMPEDANCE!r} 0.001 0.5 2",
    )
    add(tendon, "joint", joint=stretch, coef="1")
    # At the depth r the limit accelerates the load by -d² k r + (1 - d) g, with the impedance d and
    # k = 1/(d T ζ)² (MuJoCo, Computation, Constraint model): at rest r = (1 - d) T² ζ² g, as far
    # as MuJoCo's estimate of the inertia there is right.
    depth_over_gravity = (1.0 - STOP_IMPEDANCE) * (time_constant * STOP_DAMPING_RATIO) ** 2
    validity = (
        "The rope does not stretch and may go slack. MuJoCo holds it by a soft limit of its "
        f"stretch, into which a hanging load sinks by about {depth_over_gravity:.1g} s² times "
        "gravity, and which stops a falling load within some steps."
    )
    add(_section(root, "custom"), "text", name="validity", data=validity)


def _add_rate_limits(root: ET.Element, crane: Crane) -> None:
    """Append the rate limits of the drives as custom numbers, which MuJoCo keeps."""
    for joint, limit in zip(crane.layout.driven, crane.rate_limit.tolist(), strict=True):
        if math.isfinite(limit):
            custom = _section(root, "custom")
            add(custom, "numeric", name=f"{joint.name}_rate_limit", data=repr(limit))


def _give_light_bodies(crane: Crane, robot: ET.Element) -> list[str]:
    """Give a small mass to the links without mass that carry others and are not merged with the
    next, since they have a visual or an inertia, in place; return a sentence on each.
    """
    merged = _merged_links(crane, robot)
    moving_names = {joint.name for joint in crane.layout.joints}
    joints_of_robot = list(robot.iterfind("joint"))
    carrying = {ends(joint)[0] for joint in joints_of_robot}
    moving = {ends(joint)[1] for joint in joints_of_robot if joint.get("name") in moving_names}
    notes = []
    for link in robot.iterfind("link"):
        name = link.get("name", "")
        if name in (carrying & moving) - merged and link_inertia(link).mass == 0.0:
            make_light(link)
            notes.append(
                f"The link {quoted(name)} has no mass in the crane; here it has "
                f"{LIGHT_BODY_MASS:g} kg."
            )
    return notes


def _merged_links(crane: Crane, robot: ET.Element) -> frozenset[str]:
    """Return the names of the links that are written as one body with the link that they carry:
    those that move, have no mass and no visual, and carry exactly one other link.
    """
    moving_joints = {joint.name for joint in crane.layout.joints}
    moving_links = set()
    parents = []
    for joint in robot.iterfind("joint"):
        parent, child = ends(joint)
        parents.append(parent)
        if joint.get("name") in moving_joints:
            moving_links.add(child)
    bare = {link.get("name", "") for link in robot.iterfind("link") if link.find("visual") is None}
    candidates = massless_links(robot) & moving_links & bare
    return frozenset(name for name in candidates if parents.count(name) == 1)


@dataclass(frozen=True)
class _PendingJoint:
    """A joint above a link without mass, to be written in the body of the next link.

    Attributes:
        index: Index of its coordinate.
        anchor: Its origin in the frame of that body [m].
        direction: Its axis in that frame.
    """

    index: int
    anchor: np.ndarray
    direction: np.ndarray


class _Tree:
    """Links and joints of a URDF as nested bodies of MJCF.

    Attributes:
        crane: The crane.
        links: Links of the URDF by their names.
        moving: Index of the coordinate of each moving joint, by the name of the joint.
        colours: Colours of the materials of the URDF by their names.
        merged: Names of the links that become one body with the link that they carry.
        children: Links that each link carries, by its name, each with the joint between them.
        root: Name of the link that no other carries.
    """

    def __init__(self, crane: Crane, robot: ET.Element, colours: Mapping[str, str]) -> None:
        self.links = {link.get("name", ""): link for link in robot.iterfind("link")}
        self.moving = {joint.name: i for i, joint in enumerate(crane.layout.joints)}
        self.crane = crane
        self.colours = colours
        self.merged = _merged_links(crane, robot)
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
        """Append the shapes of a link, and the bodies that it carries, to its body."""
        for visual in self.links[link].iterfind("visual"):
            self._geom(body, visual, link)
        for child, joint in self.children.get(link, []):
            self._add_body(body, child, joint)

    def _add_body(self, body: ET.Element, child: str, joint: ET.Element) -> None:
        """Append the body of a link to that of its parent.

        MuJoCo takes no moving body without mass. The joints above such links are written in the
        next body with a mass instead: the joints of one body act in their order, and position and
        axis of each are expressed in the frame of that body.

        Args:
            body: Body of the parent.
            child: Name of the link.
            joint: Joint between the two.
        """
        pending: list[_PendingJoint] = []
        placement = pin.SE3.Identity()
        while child in self.merged:
            step = joint_placement(joint)
            pending = _expressed_in(pending, step)
            index = self.moving[joint.get("name", "")]
            pending.append(_PendingJoint(index, np.zeros(3), joint_axis(joint)))
            placement = placement * step
            ((child, joint),) = self.children[child]
        inner = add(body, "body", name=child)
        if pending:
            step = joint_placement(joint)
            placement = placement * step
            x, y, z, w = pin.Quaternion(placement.rotation).coeffs().tolist()
            inner.set("pos", numbers_text(placement.translation))
            inner.set("quat", f"{w!r} {x!r} {y!r} {z!r}")
            for above in _expressed_in(pending, step):
                element = _joint(self.crane, above.index, None)
                element.set("axis", numbers_text(above.direction))
                element.set("pos", numbers_text(above.anchor))
                inner.append(element)
        else:
            inner.attrib |= _pose(joint)
        coordinate = self.moving.get(joint.get("name", ""))
        if coordinate is not None:
            inner.append(_joint(self.crane, coordinate, joint.find("axis")))
        inertial = self.links[child].find("inertial")
        if inertial is not None:
            inner.append(_inertial(inertial))
        self._fill(inner, child)

    def _geom(self, body: ET.Element, visual: ET.Element, link: str) -> None:
        """Append the shape of a visual to a body.

        Raises:
            ModelError: If the shape has no size.
        """
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
            # A shape for display only: it collides with nothing. Group 2 is that of visuals.
            geom.attrib |= {"contype": "0", "conaffinity": "0", "group": "2", **_pose(visual)}
            rgba = self._colour(visual.find("material"))
            if rgba:
                geom.set("rgba", rgba)

    def _colour(self, material: ET.Element | None) -> str:
        """Return the colour of a material, its own or that of its name; empty for none."""
        if material is None:
            return ""
        colour = material.find("color")
        if colour is None:
            return self.colours.get(material.get("name", ""), "")
        return colour.get("rgba", "")


def _pose(element: ET.Element) -> dict[str, str]:
    """Return the origin of a URDF element as attributes of MJCF, as far as it has them."""
    origin = element.find("origin")
    if origin is None:
        return {}
    pose = {}
    for name, key in (("pos", "xyz"), ("euler", "rpy")):
        text = origin.get(key, "")
        if text:
            pose[name] = " ".join(text.split())
    return pose


def _expressed_in(pending: Sequence[_PendingJoint], step: pin.SE3) -> list[_PendingJoint]:
    """Return joints with origin and axis in another frame.

    Args:
        pending: The joints.
        step: Placement of that frame in the frame of their origins and axes.
    """
    expressed = []
    for joint in pending:
        anchor = step.actInv(joint.anchor)
        direction = step.rotation.T @ joint.direction
        expressed.append(_PendingJoint(joint.index, anchor, direction))
    return expressed


def _joint(crane: Crane, i: int, axis: ET.Element | None) -> ET.Element:
    """Return the joint of coordinate i, with its axis in the URDF; None stands for the X axis."""
    joint = crane.layout.joints[i]
    springs = crane.springs
    kind = "hinge" if joint.unit == "rad" else "slide"
    element = ET.Element("joint", name=joint.name, type=kind)
    element.set("axis", "1 0 0" if axis is None else axis.get("xyz", "1 0 0"))
    element.set("range", f"{float(crane.lower[i])!r} {float(crane.upper[i])!r}")
    numbers = {"damping": crane.damping[i], "armature": crane.model.armature[i]}
    if springs.stiffness[i]:
        numbers |= {"stiffness": springs.stiffness[i], "springref": springs.rest[i]}
    if crane.friction is not None and i in crane.friction.joints:
        numbers["frictionloss"] = crane.friction.effort[crane.friction.joints.index(i)]
    for name, amount in numbers.items():
        element.set(name, repr(float(amount)))
    return element


def _inertial(inertial: ET.Element) -> ET.Element:
    """Return mass and inertia of a body from those of a URDF link.

    A rotated inertia R I Rᵀ is expressed in the axes of the body, since MJCF takes a full inertia
    in these only.
    """
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    assert mass is not None and inertia is not None  # the URDF was checked
    pose = _pose(inertial)
    keys = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    tensor = np.array([[float(inertia.get(key, "0")) for key in row] for row in keys])
    rpy = pose.pop("euler", "")
    if rpy:
        rotation = pin.rpy.rpyToMatrix(vector(rpy))
        tensor = rotation @ tensor @ rotation.T
    is_diagonal = not np.any(tensor - np.diag(np.diag(tensor)))
    if is_diagonal:
        name = "diaginertia"
        components = np.diag(tensor)
    else:
        name = "fullinertia"
        components = tensor[_FULL_INERTIA]
    entries = {
        "pos": pose.get("pos", "0 0 0"),
        "mass": mass.get("value", ""),
        name: " ".join(repr(component) for component in components.tolist()),
    }
    return ET.Element("inertial", entries)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument("--dt", type=float, default=5e-4, metavar="DT", help="physics step [s]")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    return export(options.target, crane_from_options(options), dt=options.dt)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    return [
        command_line("python", "-m", "mujoco.viewer", f"--mjcf={options.target}"),
        command_line("cranedyn", "describe", "--urdf", options.target),
    ]
