"""Data of a crane for other programs: names of its signals, a controller as tables, joints by name,
and its URDF as XML.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.clocks import at_begin_of_run, intervals
from cranedyn.controllers.affine import Affine, ControllerStates, affine_form
from cranedyn.dynamics.cylinders import TAG as CYLINDER_TAG
from cranedyn.dynamics.equations_of_motion import holding_effort, over_all_joints
from cranedyn.errors import DataError, ModelError, OutOfRange, quoted
from cranedyn.interfaces import Controller
from cranedyn.model.crane import Crane
from cranedyn.model.layout import Joint
from cranedyn.model.urdf import inertial_element, joint_placement, parse_urdf

_PACKAGE_FILE = re.compile(r"package://([A-Za-z][A-Za-z0-9_-]*)/")
"""Address of a file in a ROS package."""

_GAZEBO_DYNAMICS = frozenset(
    {"static", "gravity", "turnGravityOff", "kinematic", "dampingFactor", "velocity_decay"}
)
"""Tags in <gazebo> that make a link stand still, weigh nothing or move in a viscous medium."""

GAZEBO_LEAST_MASS = 1e-6
"""Mass up to which Gazebo drops a link and all that it carries without a message [kg].

It is what libsdformat, with which Gazebo reads a URDF, does in version 12.
"""

LIGHT_BODY_MASS = 10.0 * GAZEBO_LEAST_MASS
"""Mass that is given to a massless body between two axes for other programs [kg]."""

LIGHT_BODY_INERTIA = 1e-9
"""Moment of inertia about each axis that is given to such a body [kg m²]."""

_MASS_ARGUMENTS = {
    "hook_link": "hook_mass and hook_inertia",
    "sling_link": "hook_mass and hook_inertia",
    "falls_link": "hook_mass and hook_inertia",
    "swing_r_link": "dummy_mass and dummy_inertia",
    "swing_t_link": "dummy_mass and dummy_inertia",
    "trolley_link": "trolley_inertia",
    "payload_link": "payload_inertia",
}
"""Arguments of the cranes of this project that give a link mass and inertia, by the link."""

_ARMATURE_ARGUMENTS = {
    "hoist_joint": "rope_stiffness 0, a rope that does not stretch,",
    "yaw_joint": "tower_twist_stiffness 0, a tower that does not twist,",
}
"""Values of arguments of the tower crane of this project with which a joint has no armature, by the
joint."""


def finite_form(
    controller: Controller,
    times: np.ndarray,
    positions: np.ndarray,
    width: int,
    period: float,
    program: str,
) -> Affine:
    """Return the affine form of a controller for another program, see `affine_form`.

    Args:
        controller: The controller; it stays as it is.
        times: Control instants [s], shape (rows,).
        positions: Setpoint of the drives at these [rad or m], shape (rows, m).
        width: Number of coordinates and rates, 2 n.
        period: Control period with which the program runs it [s].
        program: The program, for the error message.

    Raises:
        DataError: If the controller has no affine form.
        OutOfRange: If the form holds a number that is not finite, or the controller is for another
            control period.
    """
    controller = at_begin_of_run(controller, 0.0, period)
    form = affine_form(controller, times, positions, width)
    if form is None:
        raise DataError(
            f"The controller {type(controller).__name__} is not affine in the state, or has run "
            f"before; {program} runs tables, not Python."
        )
    lacking = form.not_finite_field()
    if lacking:
        name = f"{lacking} of the controller"
        raise OutOfRange(name, "not finite in some row", "finite numbers")
    return form


@dataclass(frozen=True, eq=False)
class LinearLaw:
    """A controller that is linear and the same at all times: with the deviation y of the state from
    the setpoint, command = feed_forward - gain y + c x, see `ControllerStates`.

    Attributes:
        feed_forward: Command at the setpoint, shape (m,).
        gain: Shape (m, 2 n).
        setpoint: The setpoint where the drives are to be where they are at the start of the crane,
            shape (2 n,).
        shift: Derivative of the setpoint by the positions where the drives are to be, shape
            (2 n, m); zero for a controller about a rest of its own.
        states: Its states; none of them for a gain.
    """

    feed_forward: np.ndarray
    gain: np.ndarray
    setpoint: np.ndarray
    shift: np.ndarray
    states: ControllerStates


def linear_law(
    crane: Crane, controller: Controller, period: float, duration: float, program: str
) -> LinearLaw:
    """Return a controller as a linear law, for another program.

    Args:
        crane: The crane.
        controller: The controller; it stays as it is.
        period: Control period with which the program runs it [s].
        duration: Time over which it must stay the same [s].
        program: The program, for the error message.

    Raises:
        DataError: If it is not linear and the same at all times.
        OutOfRange: If the duration is out of range, or the controller is for another period.
    """
    layout = crane.layout
    times = period * np.arange(intervals("duration", duration, period) + 1)
    name = type(controller).__name__

    def form_at(positions: np.ndarray, instants: int = len(times)) -> Affine:
        """Return the form for a setpoint of the drives that stays at these positions."""
        rows = np.tile(positions, (instants, 1))
        return finite_form(controller, times[:instants], rows, 2 * layout.n, period, program)

    start = crane.start.q[layout.drives]
    form = form_at(start)
    if form.integral_gain.any():
        raise DataError(
            f"{name} has integrals that stop at the limits of the drives, which no matrices say; "
            "linear_controller makes an integrator with anti-windup of matrices."
        )
    for field in ("feed_forward", "gain", "setpoint"):
        rows = getattr(form, field)
        if (rows != rows[0]).any():
            raise DataError(
                f"{name} changes over time, such as one along a motion; {program} takes a "
                "controller about a rest."
            )
    columns = []
    for move in np.eye(layout.m):
        columns.append(form_at(start + move, instants=1).setpoint[0] - form.setpoint[0])
    shift = np.array(columns).T
    # At positions that all differ, a form that is not linear in them is another one than the shift
    # says.
    positions = np.random.default_rng(0).uniform(1.0, 2.0, layout.m)
    elsewhere = form_at(start + positions, instants=1)
    is_shifted = (
        np.array_equal(elsewhere.gain[0], form.gain[0])
        and np.array_equal(elsewhere.feed_forward[0], form.feed_forward[0])
        and np.allclose(elsewhere.setpoint[0] - form.setpoint[0], shift @ positions, atol=1e-9)
    )
    if not is_shifted:
        raise DataError(
            f"{name} depends on the setpoint of the drives otherwise than by its distance, which "
            "no matrices say."
        )
    states = form.states
    if states is None:
        states = ControllerStates(
            a=np.zeros((0, 0)),
            b=np.zeros((0, 2 * layout.n)),
            c=np.zeros((layout.m, 0)),
            anti_windup=np.zeros((0, layout.m)),
            limit=np.full(layout.m, np.inf),
            initial=np.zeros(0),
        )
    return LinearLaw(form.feed_forward[0], form.gain[0], form.setpoint[0], shift, states)


@dataclass(frozen=True, kw_only=True)
class ExportedJoint(Joint):
    """Joint of a layout with the properties that exporters write.

    Attributes:
        lower: Lower end of its range [rad or m].
        upper: Upper end of its range [rad or m].
        effort: Largest effort [N m or N].
        start: Coordinate at the start of a run [rad or m].
        holding: Effort of its drive that holds the crane at rest there [N m or N]; 0 for a joint
            without a drive.
    """

    lower: float
    upper: float
    effort: float
    start: float
    holding: float


def urdf_element(crane: Crane, *, keep_package_meshes: bool = False) -> ET.Element:
    """Return the crane's URDF as XML, as other programs take it.

    Comments are left out, and so are meshes and textures, which are files of their own that an
    export does not carry. Axes have length one: other programs take a very short axis for none.

    Args:
        crane: The crane.
        keep_package_meshes: Whether meshes and textures in ROS packages stay, for a program that
            finds them there.
    """
    robot = parse_urdf(crane.urdf, "the crane")
    for link in robot.iterfind("link"):
        for body in [*link.iterfind("visual"), *link.iterfind("collision")]:
            mesh = body.find("geometry/mesh")
            if mesh is not None and not (keep_package_meshes and package_of(mesh)):
                link.remove(body)
    for material in robot.iter("material"):
        for texture in material.findall("texture"):
            if not (keep_package_meshes and package_of(texture)):
                material.remove(texture)
    for axis in robot.iter("axis"):
        xyz = axis.get("xyz")
        if xyz:
            numbers = vector(xyz).tolist()
            length = math.hypot(*numbers)
            if not math.isclose(length, 1.0):
                axis.set("xyz", " ".join(repr(number / length) for number in numbers))
    return robot


def package_of(element: ET.Element) -> str:
    """Return the ROS package in which the file of a mesh or texture is, empty if in none."""
    match = _PACKAGE_FILE.match(element.get("filename", ""))
    return match[1] if match else ""


def remove_control(robot: ET.Element) -> list[str]:
    """Remove from a URDF, in place, what controls or holds the crane in other programs.

    An exported crane is moved by the interfaces that the exporter writes. A plugin of its own file
    would act beside them, or fail, since the file of its settings is on the machine on which the
    URDF was written. Tags that make a link move otherwise than in this project, such as without
    gravity, are removed, too, and cylinders, which only this project reads.

    Returns:
        A sentence on each element that was removed, for the reader of the export.
    """
    notes = []
    for element in robot.findall("ros2_control"):
        robot.remove(element)
        notes += _control_notes(element)
    for element in robot.findall("transmission"):
        robot.remove(element)
        notes.append(f"The transmission {quoted(element.get('name', ''))} is replaced.")
    for block in robot.findall("gazebo"):
        for child in list(block):
            name = child.get("name") or child.get("filename") or (child.text or "").strip()
            where = block.get("reference", "the crane")
            if child.tag == "plugin":
                notes.append(f"The plugin {quoted(name)} is left out.")
            elif child.tag == CYLINDER_TAG:
                notes.append(f"The cylinder of {quoted(where)} is left out: its drive acts there.")
            elif child.tag in _GAZEBO_DYNAMICS:
                notes.append(f"<{child.tag}> {quoted(name)} of {quoted(where)} is left out.")
            else:
                continue
            block.remove(child)
        if len(block) == 0:
            robot.remove(block)
    return notes


def _control_notes(control: ET.Element) -> list[str]:
    """Return sentences on the hardware of a ``<ros2_control>`` that is replaced, and on its command
    interfaces other than effort.
    """
    notes = []
    for plugin in control.iterfind("hardware/plugin"):
        hardware = quoted((plugin.text or "").strip())
        notes.append(f"The hardware {hardware} of <ros2_control> is replaced.")
    for joint in control.iterfind("joint"):
        interfaces = [element.get("name", "") for element in joint.iterfind("command_interface")]
        others = [quoted(name) for name in interfaces if name != "effort"]
        if others:
            name = quoted(joint.get("name", ""))
            notes.append(
                f"{name} takes efforts here; its command interface {', '.join(others)} is replaced."
            )
    return notes


def mesh_notes(crane: Crane, robot: ET.Element) -> list[str]:
    """Return a sentence on the meshes of a crane that the URDF of an export does not have."""
    before = len(parse_urdf(crane.urdf, "the crane").findall(".//mesh"))
    left_out = before - len(robot.findall(".//mesh"))
    if not left_out:
        return []
    return [f"Visuals and collisions with a mesh are left out: {left_out} in all."]


@dataclass(frozen=True)
class LengthSpring:
    """A spring whose true stiffness changes with the length of the rope, frozen at one length.

    Attributes:
        joint: Name of the joint in which it acts.
        length_joint: Name of the joint that is the length of the rope.
        stiffness: Stiffness at that length [N/m or N m/rad].
        length: The length [m].
        times_length: Stiffness times length, which is the same at every length: EA of a rope [N],
            W a² of two falls [N m²/rad].
        pulls_only: Whether it pulls and does not push, as a rope.
        validity: Where this stiffness holds, in whole sentences, for the reader of the export.
    """

    joint: str
    length_joint: str
    stiffness: float
    length: float
    times_length: float
    pulls_only: bool
    validity: str


def remove_length_tags(robot: ET.Element) -> None:
    """Remove the tags of a rope, of two falls and of cylinders from a URDF, in place: only
    cranedyn reads them.
    """
    tags = ("ropeStiffness", "fallSpacing", CYLINDER_TAG)
    for block in robot.findall("gazebo"):
        for child in [child for child in block if child.tag in tags]:
            block.remove(child)
        if len(block) == 0:
            robot.remove(block)


def frozen_spring(crane: Crane, program: str) -> LengthSpring | None:
    """Return a spring with the stiffness that the rope, or the two falls, have at the start.

    No format that is exported knows a stiffness that changes with the length of the rope.

    Args:
        crane: The crane.
        program: Program for which it is exported, for the error message.

    Returns:
        The spring; None if there is neither a rope that stretches nor a load on two falls.

    Raises:
        ModelError: If the rope does not stretch but goes slack.
    """
    rope = crane.springs.rope
    falls = crane.springs.bifilar
    names = [joint.name for joint in crane.layout.joints]
    if rope is not None:
        if rope.inextensible:
            raise ModelError(
                f"The crane has a rope that goes slack and does not stretch, which {program} does "
                "not know; give it a stiffness (rope_stiffness > 0, EA in N) or leave it out "
                "(rope_stiffness 0)."
            )
        # A rope of the length l with the tensile stiffness EA is a spring of the stiffness EA/l.
        length_joint = rope.length
        joint = names[rope.stretch]
        times_length = float(rope.stiffness)
        law = "The rope has the stiffness EA/l = {:.9g} N/m"
        consequences = (
            "There the stretch of a load that hangs is wrong by the same factor, and the period of "
            "its bouncing by the root of it; the swing hardly changes. The force EA (s/l)²/2 of a "
            "stretched rope on the hoist, with the stretch s, is neglected."
        )
    elif falls is not None:
        # Two falls at the distances a above and below, which carry the weight W, turn a load that
        # has yawed by ψ back with the torque W a²/l sin ψ.
        length_joint = falls.length
        joint = names[falls.yaw]
        times_length = float(falls.stiffness)
        law = "The two falls have the yaw stiffness W a²/l = {:.9g} N m/rad"
        consequences = (
            "There the period of the yaw is wrong by the root of that factor. The torque is linear "
            "in the yaw ψ instead of proportional to sin ψ, 1 % too large at 14 degrees, and the "
            "lift of the load by its yaw is neglected."
        )
    else:
        return None
    length = float(crane.start.q[length_joint])
    stiffness = times_length / length
    validity = (
        f"{law.format(stiffness)} of the length l = {length:.9g} m at the start. At another length "
        f"l the true stiffness is {length:.9g} m/l times that. {consequences}"
    )
    return LengthSpring(
        joint=joint,
        length_joint=names[length_joint],
        stiffness=stiffness,
        length=length,
        times_length=times_length,
        pulls_only=rope is not None,
        validity=validity,
    )


def write_length_spring(crane: Crane, robot: ET.Element) -> list[str]:
    """Replace the tags of a rope or of two falls in a URDF by the spring of `frozen_spring` in the
    tags of Gazebo, in place.

    Returns:
        Where the spring holds, a sentence or more; nothing if there is none.

    Raises:
        ModelError: As `frozen_spring`.
    """
    spring = frozen_spring(crane, "Gazebo")
    remove_length_tags(robot)
    if spring is None:
        return []
    block = add(robot, "gazebo", reference=spring.joint)
    add(block, "springStiffness", repr(spring.stiffness))
    add(block, "springReference", "0")
    notes = [spring.validity]
    if spring.pulls_only:
        notes.append("The spring also pushes, so it holds only while the rope is taut.")
    return notes


def readme(name: str, crane: Crane, notes: Sequence[str]) -> str:
    """Return the README of an exported folder.

    Args:
        name: Its title.
        crane: The crane. What was assumed or turned when it was loaded is listed, since the
            exported joints count as those of the crane do, and not as those of its own file.
        notes: What the export replaced or left out, a sentence each.
    """
    listed = "".join(f"* {note}\n" for note in notes)
    if not notes:
        listed = "* Nothing was replaced or left out.\n"
    text = (
        f"# {name}\n\nA crane, written by cranedyn. What differs from the file of the crane, and "
        f"where it holds:\n\n{listed}"
    )
    sentences = "".join(f"* {each}\n" for each in (*crane.swing_directions, *crane.assumptions))
    if sentences:
        text += (
            "\n## Joints\n\nThe joints have the zeros, signs and ranges of the crane as it was "
            "loaded. A joint that is named in these sentences is that of the file that was read:"
            f"\n\n{sentences}"
        )
    return text


def joints(crane: Crane, robot: ET.Element) -> tuple[ExportedJoint, ...]:
    """Return the moving joints of a crane in the order of its coordinates, from its model and its
    URDF.
    """
    elements = {element.get("name", ""): element for element in robot.iterfind("joint")}
    holding = over_all_joints(crane, holding_effort(crane, crane.start.q))
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
    parent = joint.find("parent")
    child = joint.find("child")
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


def check_inertias(
    crane: Crane,
    robot: ET.Element,
    program: str,
    *,
    merged: frozenset[str] = frozenset(),
    least_mass: float = 0.0,
) -> None:
    """Check that every moving link has mass and inertia of its own, since some programs drop a link
    without them and all that it carries.

    Args:
        crane: The crane.
        robot: Its URDF.
        program: Program for which it is exported, for the error message.
        merged: Links that need none, since the exporter writes them as one body with the next.
        least_mass: Mass up to which the program drops a link [kg].

    Raises:
        OutOfRange: If a link is too light for the program.
        ModelError: If a link has none; the message names it, and the argument that gives it one.
    """
    names = {joint.name for joint in crane.layout.joints}
    moving = {ends(joint)[1] for joint in robot.iterfind("joint") if joint.get("name") in names}
    for link in robot.iterfind("link"):
        name = link.get("name", "")
        if name not in moving or name in merged:
            continue
        numbers = _mass_and_moments(link)
        is_complete = len(numbers) == 4
        if is_complete and 0.0 < numbers[0] <= least_mass:
            raise OutOfRange(
                f"mass of the link {quoted(name)}",
                numbers[0],
                f"> {least_mass:g}: {program} drops a lighter link and all that it carries",
                "kg",
            )
        if not is_complete or min(numbers) <= 0.0:
            advice = ""
            if "arguments" in crane.record and name in _MASS_ARGUMENTS:
                advice = f", by {_MASS_ARGUMENTS[name]}"
            raise ModelError(
                f"The link {quoted(name)} has no mass or no inertia, with which {program} drops "
                f"it; allowed are numbers > 0{advice}."
            )


def give_light_bodies(crane: Crane, robot: ET.Element) -> None:
    """Give a small mass and inertia to links that carry others and have none, in place: programs
    that read a URDF would drop all that they carry.

    Such links stand between two axes of one body. In a crane of this project, arguments give them
    a mass, which `check_inertias` asks for; only a crane from elsewhere is changed.
    """
    if "arguments" in crane.record:
        return
    carrying = {ends(joint)[0] for joint in robot.iterfind("joint")}
    for link in robot.iterfind("link"):
        if link.get("name") in carrying - {"world"} and link.find("inertial") is None:
            make_light(link)


def make_light(link: ET.Element) -> None:
    """Give a link without mass the small mass of a light body, and add its small inertia to what
    the link has, in place.
    """
    inertia = link_inertia(link)
    present = link.find("inertial")
    if present is not None:
        link.remove(present)
    tensor = inertia.inertia + LIGHT_BODY_INERTIA * np.eye(3)
    link.append(inertial_element(pin.Inertia(LIGHT_BODY_MASS, np.zeros(3), tensor)))


def link_inertia(link: ET.Element) -> pin.Inertia:
    """Return mass [kg], centre of mass [m] and moments of inertia [kg m²] of a link, in its frame;
    zeros for what the URDF does not state.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return pin.Inertia.Zero()
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    tensor = np.zeros((3, 3))
    if inertia is not None:
        for i, row in enumerate("xyz"):
            for j, column in enumerate("xyz"):
                name = "i" + "".join(sorted(row + column))
                tensor[i, j] = float(inertia.get(name, "0"))
    placement = joint_placement(inertial)
    rotation = placement.rotation
    return pin.Inertia(
        0.0 if mass is None else float(mass.get("value", "0")),
        placement.translation,
        rotation @ tensor @ rotation.T,
    )


def massless_links(robot: ET.Element) -> frozenset[str]:
    """Return the names of the links that have no mass and no inertia."""
    names = []
    for link in robot.iterfind("link"):
        if not any(_mass_and_moments(link)):
            names.append(link.get("name", ""))
    return frozenset(names)


def _mass_and_moments(link: ET.Element) -> list[float]:
    """Return the mass [kg] and the three moments of inertia [kg m²] of a link, as far as the URDF
    has them: four numbers if it has all.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return []
    numbers = []
    for tag, keys in (("mass", ["value"]), ("inertia", ["ixx", "iyy", "izz"])):
        for element in inertial.iterfind(tag):
            for key in keys:
                text = element.get(key)
                if text is not None:
                    numbers.append(float(text))
    return numbers


def anchor_to_world(crane: Crane, robot: ET.Element, program: str) -> ET.Element:
    """Change a URDF, in place, so that Gazebo loads all of it and the crane stands fast.

    The link ``world`` becomes its root, to which Gazebo fixes a model. Every link that is fixed to
    it gets an inertial, since Gazebo silently drops a link without one and all that it carries; for
    a link that does not move any numbers do.

    Args:
        crane: The crane.
        robot: Its URDF.
        program: Program for which it is exported, for the error message.

    Returns:
        The same URDF.

    Raises:
        ModelError: If another link than the root has that name, or a joint has an armature, which
            Gazebo does not support.
    """
    _check_armatures(crane, robot)
    children = {ends(joint)[1] for joint in robot.iterfind("joint")}
    links = {link.get("name", ""): link for link in robot.iterfind("link")}
    (root,) = links.keys() - children
    fixed = _links_fixed_to(root, robot)
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


def _check_armatures(crane: Crane, robot: ET.Element) -> None:
    """Check that no joint has an armature.

    Raises:
        ModelError: If one has.
    """
    for joint in robot.iterfind("joint"):
        dynamics = joint.find("dynamics")
        if dynamics is None or not float(dynamics.get("armature", "0")):
            continue
        name = joint.get("name", "")
        advice = ""
        if "arguments" in crane.record and name in _ARMATURE_ARGUMENTS:
            advice = f", which {_ARMATURE_ARGUMENTS[name]} gives"
        raise ModelError(
            f"The joint {quoted(name)} has an armature, the inertia of its motor, which Gazebo "
            f"does not know; allowed is 0{advice}."
        )


def _links_fixed_to(root: str, robot: ET.Element) -> set[str]:
    """Return the names of a link and of all that fixed joints connect to it."""
    rigid = [ends(joint) for joint in robot.iterfind("joint") if joint.get("type") == "fixed"]
    fixed = {root}
    while True:
        further = {child for parent, child in rigid if parent in fixed} - fixed
        if not further:
            return fixed
        fixed |= further
