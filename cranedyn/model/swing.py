"""Swing for a crane without: two passive joints above the hoist of a URDF whose hook is rigid.

Most public descriptions of cranes hang the hook on a prismatic joint of the trolley. It can be
lifted, but it does not swing. `turn_tower` gives slew and trolley the coordinates of a tower crane,
and `hang_load` puts the pivot, the rope and the load where the hook is.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import ModelError, OutOfRange, UnknownName, quoted
from cranedyn.model.layout import ALIGNED, ROLES, Joint
from cranedyn.model.urdf import (
    inertial_element,
    initial_values,
    joint_axis,
    joint_placement,
    numbers_text,
    set_placement,
)

_SHORTEST = 0.02
"""Shortest rope as a share of the longest, where the range of a hoist reaches above the pivot."""

_AWAY = 0.01
"""Share of a range by which a start is away from its ends."""

_SMALL = 1e-9
"""Offsets below this need no note [m or rad]."""

_LIGHT = {"link_mass": 1e-3, "link_inertia": 1e-6}
"""Mass of a link between the swing joints as a share of the load's, and its inertia [m²] as such a
share: other programs drop a link without."""

_NUMBERS = {
    "length": ("m", "> 0"),
    "mass": ("kg", "> 0"),
    "damping": ("N m s/rad", ">= 0"),
    "link_mass": ("kg", ">= 0"),
    "link_inertia": ("kg m²", ">= 0"),
}
"""Unit and allowed range of the numbers of a `Swing`."""

_TURNED = {"slew": "heading of the jib, 0 along -Y", "trolley": "radius from the slew axis"}


class Swing(NamedTuple):
    """Rope and load of a crane whose URDF has no swing.

    Attributes:
        length: Rope from pivot to hook where the hoist is at its zero [m]; None if the pivot is at
            the height of the link that carries the hoist.
        mass: Load with hook [kg]; None for the mass of the link of the hook.
        damping: Viscous damping of both swing joints [N m s/rad].
        link_mass: Mass of each of the two links between the swing joints, at the pivot [kg]; None
            for a thousandth of the load.
        link_inertia: Their rotational inertia about each axis [kg m²]; None for 1e-6 m² times the
            load.
    """

    length: float | None = None
    mass: float | None = None
    damping: float = 0.0
    link_mass: float | None = None
    link_inertia: float | None = None


def swing_numbers(values: bool | Mapping[str, float]) -> Swing:
    """Return the numbers of a swing, checked; True stands for none.

    Raises:
        UnknownName: If there is no such number.
        OutOfRange: If a length or mass is not positive, or another number is negative.
    """
    numbers: dict[str, float] = {}
    for name, value in () if isinstance(values, bool) else values.items():
        if name not in _NUMBERS:
            raise UnknownName("number of the swing", name, _NUMBERS)
        numbers[name] = number(f"{name} of the swing", value, *_NUMBERS[name])
    return Swing(**numbers)


def turn_tower(
    robot: ET.Element, model: pin.Model, joints: Sequence[Joint], path: Path
) -> tuple[dict[str, str], list[str]]:
    """Give slew and trolley of a URDF the coordinates of a tower crane, in place.

    At zero of the slew the jib points along -Y of the world, and the slew turns about +Z. The
    coordinate of the trolley is the radius of the hook from the slew axis. A crane without a slew
    and a trolley above its hoist is left as it is.

    Args:
        robot: The URDF, checked.
        model: Its Pinocchio model.
        joints: Its moving joints, in the order of the coordinates.
        path: File for error messages.

    Returns:
        The names of the joints by role, and a note on each joint that was turned.

    Raises:
        ModelError: If there is no hoist, see `find_hoist`.
    """
    hoist = find_hoist(model, joints, path)
    chain = [int(i) - 1 for i in model.supports[hoist + 1]][1:-1]
    slews = [i for i in chain if joints[i].kind == "revolute" and _upright(joints[i])]
    prismatic = [i for i in chain if joints[i].kind == "prismatic"]
    trolleys = [i for i in prismatic if math.hypot(*joints[i].axis[:2]) >= ALIGNED]
    if not (slews and trolleys):
        return {}, []
    slew, trolley = slews[0], trolleys[0]
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    arm = data.oMi[hoist + 1].translation - data.oMi[slew + 1].translation
    along = np.array(joints[trolley].axis)
    radius = float(arm @ along)
    aside = float(np.cross(along, arm)[2])
    middle = sum(float(limit[trolley]) for limit in _limits(model)) / 2
    outward = 1.0 if radius + middle >= 0.0 else -1.0
    jib = outward * along
    upward = math.copysign(1.0, joints[slew].axis[2])
    heading = math.remainder(-math.pi / 2 - math.atan2(jib[1], jib[0]), 2 * math.pi)
    names = {"slew": joints[slew].name, "trolley": joints[trolley].name}
    turns = {"slew": (upward, upward * heading), "trolley": (outward, -radius)}
    notes = []
    for role, (sign, zero) in turns.items():
        _turn(robot, names[role], sign, zero)
        if sign < 0.0 or abs(zero) > _SMALL:
            notes.append(f"{_formula(role, names[role], sign, zero)}, the {_TURNED[role]}.")
    if abs(aside) > _SMALL:
        notes.append(f"The hook passes the slew axis at {abs(aside):.3g} m.")
    return names, notes


def find_hoist(model: pin.Model, joints: Sequence[Joint], path: Path) -> int:
    """Return the index of the hoist: the driven prismatic joint along the vertical that carries no
    other moving joint.

    Raises:
        ModelError: If there is none or several, or if a joint is passive: then the load swings.
    """
    for joint in joints:
        if not joint.driven:
            raise ModelError(
                f"{path} has the passive joint {quoted(joint.name)}, so that its load swings; load "
                "it without swing."
            )
    parents = list(model.parents)
    hoists = [
        i
        for i, joint in enumerate(joints)
        if joint.kind == "prismatic" and _upright(joint) and i + 1 not in parents
    ]
    if len(hoists) != 1:
        found = ", ".join(quoted(joints[i].name) for i in hoists) or "none"
        raise ModelError(
            f"{path} needs one hoist to hang a load from, a prismatic joint along the vertical "
            f"that carries no other joint; it has {found}."
        )
    return hoists[0]


def hang_load(
    robot: ET.Element, model: pin.Model, joints: Sequence[Joint], swing: Swing, path: Path
) -> tuple[dict[str, str], list[str]]:
    """Put two passive joints above the hoist of a URDF, in place.

    The radial swing turns about +X of the world and the tangential swing about +Y, with all other
    joints at zero. The hoist below them is the length of the rope, along -Z.

    Args:
        robot: The URDF, checked.
        model: Its Pinocchio model.
        joints: Its moving joints, in the order of the coordinates.
        swing: Rope and load.
        path: File for error messages.

    Returns:
        The names of the joints by role, and a note on each assumption.

    Raises:
        ModelError: If there is no hoist, see `find_hoist`.
        OutOfRange: If the rope has no length in all of the range of the hoist.
    """
    index = find_hoist(model, joints, path)
    name = joints[index].name
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(model.nq))
    element = next(joint for joint in robot.iterfind("joint") if joint.get("name") == name)
    parent = element.find("parent")
    assert parent is not None  # see check_urdf
    carrier = data.oMf[model.getFrameId(parent.get("link", ""))]
    hook = data.oMi[index + 1]
    upward = math.copysign(1.0, joints[index].axis[2])
    length = float(carrier.translation[2] - hook.translation[2])
    notes = []
    rise = 0.0 if swing.length is None else swing.length - length
    length += rise
    height = f"{abs(rise):.3g} m {'above' if rise > 0.0 else 'below'}"
    height = height if abs(rise) > _SMALL else "at the height of"
    notes.append(f"The pivot is {height} {parent.get('link')}.")
    ends = [length - upward * float(limit[index]) for limit in _limits(model)]
    longest = max(ends)
    if longest <= 0.0:
        allowed = "> 0; give its length where the hoist is at zero"
        raise OutOfRange(f"longest rope at {name}", longest, allowed, "m")
    shortest = max(min(ends), _SHORTEST * longest)
    if shortest > min(ends):
        notes.append(f"The shortest rope is {shortest:.3g} m.")
    _turn(robot, name, -upward, upward * length, shortest)
    notes.append(f"{_formula('hoist', name, -upward, upward * length)}, the length of the rope.")
    pivot = pin.SE3(np.eye(3), np.array([*hook.translation[:2], hook.translation[2] + length]))
    child = element.find("child")
    assert child is not None  # see check_urdf
    load = model.inertias[index + 1].mass
    if swing.mass is not None:
        load = swing.mass
        _set_mass(robot, child.get("link", ""), load)
    mass, inertia = (
        share * load if value is None else value
        for value, share in zip((swing.link_mass, swing.link_inertia), _LIGHT.values(), strict=True)
    )
    notes.append(f"Two links of {mass:g} kg and {inertia:g} kg m² are at the pivot.")
    body = _lump(mass, inertia)
    _insert_swing(robot, parent.get("link", ""), carrier.actInv(pivot), swing.damping, body)
    parent.set("link", "swing_tangential_link")
    set_placement(element, pin.SE3(hook.rotation, np.zeros(3)))
    _axis(element).set("xyz", numbers_text(hook.rotation.T @ [0.0, 0.0, -1.0]))
    roles = {role: ROLES[role].joint for role in ("radial_swing", "tangential_swing")}
    return roles | {"hoist": name}, notes


def _formula(role: str, name: str, sign: float, zero: float) -> str:
    """Return the coordinate of a role in terms of that of the file, sign (q - zero)."""
    unit = "rad" if ROLES[role].kind == "revolute" else "m"
    offset = f"{-sign * zero:.6g} {unit} " if zero else ""
    mark = "-" if sign < 0.0 else "+" if zero else ""
    return f"{ROLES[role].symbol} = {offset}{mark}{' ' if offset else ''}{name}"


def _upright(joint: Joint) -> bool:
    return abs(joint.axis[2]) >= ALIGNED


def _limits(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    return model.lowerPositionLimit, model.upperPositionLimit


def _turn(robot: ET.Element, name: str, sign: float, zero: float, least: float = -math.inf) -> None:
    """Replace the coordinate q of a joint by sign (q - zero): placement, axis, limits and start.

    No coordinate below `least` is allowed. A joint starts where the file has it, a hundredth of its
    range away from the ends, since a held drive gives way; or at its zero there if that is well
    within its range.
    """
    element = next(joint for joint in robot.iterfind("joint") if joint.get("name") == name)
    axis = joint_axis(element)
    axis /= np.linalg.norm(axis)
    placement = joint_placement(element)
    if element.get("type") == "prismatic":
        step = pin.SE3(np.eye(3), axis * zero)
    else:
        step = pin.SE3(pin.exp3(axis * zero), np.zeros(3))
    set_placement(element, placement * step)
    _axis(element).set("xyz", numbers_text(sign * axis))
    limit = element.find("limit")
    assert limit is not None  # see check_urdf
    ends = sorted(sign * (float(limit.get(end, 0.0)) - zero) for end in ("lower", "upper"))
    ends[0] = max(ends[0], least)
    limit.set("lower", repr(ends[0]))
    limit.set("upper", repr(ends[1]))
    margin = _AWAY * (ends[1] - ends[0])
    initial = initial_values(robot).get(name)
    if initial is not None:
        start = sign * (float(initial.text or 0.0) - zero)
        initial.text = repr(min(max(start, ends[0] + margin), ends[1] - margin))
    elif ends[0] + margin <= -sign * zero <= ends[1] - margin:
        # It is there, see declare_drives.
        controls = robot.iterfind("ros2_control/joint")
        control = next(entry for entry in controls if entry.get("name") == name)
        state = control.find("state_interface[@name='position']")
        if state is None:
            state = ET.SubElement(control, "state_interface", name="position")
        ET.SubElement(state, "param", name="initial_value").text = repr(-sign * zero)


def _insert_swing(
    robot: ET.Element, parent: str, placement: pin.SE3, damping: float, body: ET.Element
) -> None:
    """Add the two swing joints and their links, each of the same body, below a link."""
    for role, axis in (("radial_swing", "1 0 0"), ("tangential_swing", "0 1 0")):
        name = ROLES[role].joint
        child = name.replace("_joint", "_link")
        joint = ET.SubElement(robot, "joint", name=name, type="revolute")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(joint, "axis", xyz=axis)
        reach = repr(math.pi / 2)
        # as in the tower crane of this project: other programs hold a joint with a velocity of 0
        limits = {"lower": "-" + reach, "upper": reach, "effort": "1e7", "velocity": "10"}
        ET.SubElement(joint, "limit", limits)
        ET.SubElement(joint, "dynamics", damping=repr(damping))
        set_placement(joint, placement)
        ET.SubElement(robot, "link", name=child).append(body)
        parent = child
        placement = pin.SE3.Identity()


def _set_mass(robot: ET.Element, name: str, mass: float) -> None:
    """Set the mass of a link; its inertia changes in the same ratio."""
    link = next(link for link in robot.iterfind("link") if link.get("name") == name)
    inertial = link.find("inertial")
    if inertial is None:
        inertial = _lump(0.0, 0.0)
        link.append(inertial)
    body, tensor = inertial.find("mass"), inertial.find("inertia")
    assert body is not None and tensor is not None  # see check_urdf
    before = float(body.get("value", 0.0))
    for key, value in tensor.attrib.items():
        tensor.set(key, repr(float(value) * mass / before if before else 0.0))
    body.set("value", repr(mass))


def _lump(mass: float, inertia: float) -> ET.Element:
    """Return a body with the same inertia about each axis."""
    return inertial_element(pin.Inertia(mass, np.zeros(3), inertia * np.eye(3)))


def _axis(joint: ET.Element) -> ET.Element:
    axis = joint.find("axis")
    return ET.SubElement(joint, "axis", xyz="1 0 0") if axis is None else axis
