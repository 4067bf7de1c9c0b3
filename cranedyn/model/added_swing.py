"""A swing for a crane whose file has none: two passive joints above the hoist of a URDF whose hook
is rigid.

Most public descriptions of cranes hang the hook on a prismatic joint of the trolley. It can be
lifted, but it does not swing. `turn_tower` gives slew and trolley the coordinates of a tower crane,
and `hang_load` puts the pivot, the rope and the load where the hook is.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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

_MIN_ROPE_RATIO = 0.02
"""Shortest rope as a share of the longest, where the range of a hoist reaches above the pivot."""

_START_MARGIN = 0.01
"""Share of the range of a joint by which its start keeps away from the ends: a drive that holds its
joint by a controller sags a little, and would leave its range at once."""

_SMALL_OFFSET = 1e-9
"""Largest offset that needs no note [m or rad]."""

_LINK_MASS_RATIO = 1e-3
"""Mass of a link between the swing joints as a share of the load's: other programs drop a link
without a mass."""

_LINK_INERTIA_RATIO = 1e-6
"""Rotational inertia of such a link over the mass of the load [m²]."""

_NUMBERS = {
    "length": ("m", "> 0"),
    "mass": ("kg", "> 0"),
    "damping": ("N m s/rad", ">= 0"),
    "link_mass": ("kg", ">= 0"),
    "link_inertia": ("kg m²", ">= 0"),
}
"""Unit and allowed range of the numbers of a `Swing`."""

_MEANINGS = {"slew": "heading of the jib, 0 along -Y", "trolley": "radius from the slew axis"}
"""What the coordinate of a joint is once `turn_tower` has turned it, by the role of the joint."""


@dataclass(frozen=True)
class _NewCoordinate:
    """Coordinate of a joint, sign (q - zero), in place of the coordinate q of its file.

    Attributes:
        sign: 1.0, or -1.0 where the axis is reversed.
        zero: Value of q where the new coordinate is zero [rad or m].
    """

    sign: float
    zero: float


class Swing(NamedTuple):
    """Rope and load of a crane whose URDF has no swing.

    Attributes:
        length: Rope from pivot to hook where the hoist is at its zero [m]; None if the pivot is at
            the height of the link that carries the hoist.
        mass: All that the hoist carries, load with hook [kg]; its links keep their proportions.
            None for the mass in the file.
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
    """Return the numbers of a swing, checked; those that are not given, all with True, have their
    defaults.

    Raises:
        UnknownName: If there is no such number.
        OutOfRange: If a length or mass is not positive, or another number is negative.
    """
    if isinstance(values, bool):
        return Swing()
    numbers: dict[str, float] = {}
    for name, value in values.items():
        if name not in _NUMBERS:
            raise UnknownName("number of the swing", name, _NUMBERS)
        unit, allowed = _NUMBERS[name]
        numbers[name] = number(f"{name} of the swing", value, unit, allowed)
    return Swing(**numbers)


def turn_tower(
    robot: ET.Element, model: pin.Model, joints: Sequence[Joint], path: Path
) -> tuple[dict[str, str], list[str]]:
    """Give slew and trolley of a URDF the coordinates of a tower crane, in place.

    At zero of the slew the jib points along -Y of the world, and the slew turns about +Z. The
    coordinate of the trolley is the radius of the hook from the slew axis. A crane without a slew
    that carries a trolley above its hoist is left as it is, also one whose trolley carries a
    slewing ring, such as some gantries: its hook has no radius from the slew axis.

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
    # The joints between the world and the hoist, from the ground upwards.
    chain = [int(joint) - 1 for joint in model.supports[hoist + 1]][1:-1]
    slews = [i for i in chain if joints[i].kind == "revolute" and _is_vertical(joints[i])]
    if not slews:
        return {}, []
    slew = slews[0]
    carried = chain[chain.index(slew) + 1 :]
    trolleys = [i for i in carried if joints[i].kind == "prismatic" and _is_horizontal(joints[i])]
    if not trolleys:
        return {}, []
    trolley = trolleys[0]

    # Where the hook is, as seen from the slew axis, with all joints at zero: `radius` along the
    # trolley's axis and `aside` across it.
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    arm = data.oMi[hoist + 1].translation - data.oMi[slew + 1].translation
    trolley_axis = np.array(joints[trolley].axis)
    radius = float(arm @ trolley_axis)
    aside = float(np.cross(trolley_axis, arm)[2])

    # The trolley counts outward, so that the radius is positive in the middle of its range.
    lower = float(model.lowerPositionLimit[trolley])
    upper = float(model.upperPositionLimit[trolley])
    middle = (lower + upper) / 2
    outward = 1.0 if radius + middle >= 0.0 else -1.0

    # The slew is zero where the jib points along -Y, at the angle -π/2 from +X.
    jib = outward * trolley_axis
    upward = math.copysign(1.0, joints[slew].axis[2])
    heading = math.remainder(-math.pi / 2 - math.atan2(jib[1], jib[0]), 2 * math.pi)

    names = {"slew": joints[slew].name, "trolley": joints[trolley].name}
    coordinates = {
        "slew": _NewCoordinate(upward, upward * heading),
        "trolley": _NewCoordinate(outward, -radius),
    }
    notes = []
    for role, coordinate in coordinates.items():
        start_notes = _turn_joint(robot, names[role], coordinate)
        if coordinate.sign < 0.0 or abs(coordinate.zero) > _SMALL_OFFSET:
            notes.append(f"{_formula(role, names[role], coordinate)}, the {_MEANINGS[role]}.")
        notes += start_notes
    if abs(aside) > _SMALL_OFFSET:
        notes.append(f"The hook passes the slew axis at {abs(aside):.3g} m.")
    return names, notes


def find_hoist(model: pin.Model, joints: Sequence[Joint], path: Path) -> int:
    """Return the index of the hoist: the driven prismatic joint along the vertical that carries no
    other moving joint.

    Raises:
        ModelError: If there is none or several; if a joint is passive, since the load swings then;
            or if a joint between the world and the hoist follows another one, since its motion
            would not be counted in the new coordinates.
    """
    for joint in joints:
        if joint.passive:
            raise ModelError(
                f"{path} has the passive joint {quoted(joint.name)}, so that its load swings; load "
                "it without swing."
            )
    parents = list(model.parents)
    hoists = [
        i
        for i, joint in enumerate(joints)
        if joint.driven
        and joint.kind == "prismatic"
        and _is_vertical(joint)
        and i + 1 not in parents
    ]
    if len(hoists) != 1:
        found = ", ".join(quoted(joints[i].name) for i in hoists) or "none"
        raise ModelError(
            f"{path} needs one hoist to hang a load from, a prismatic joint along the vertical "
            f"that carries no other joint; it has {found}."
        )
    for carrier in model.supports[hoists[0] + 1].tolist():
        if carrier > 0 and joints[carrier - 1].follows:
            joint = joints[carrier - 1]
            raise ModelError(
                f"{path} has {quoted(joint.name)} between the world and its hoist, which follows "
                f"{quoted(joint.follows)}; to hang the hook on a rope, hold both by "
                f"locked=[{joint.follows!r}], or --locked."
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
    element = _joint_element(robot, name)
    parent = element.find("parent")
    child = element.find("child")
    assert parent is not None and child is not None  # see check_urdf
    carrier_name = parent.get("link", "")
    carrier = data.oMf[model.getFrameId(carrier_name)]
    hook = data.oMi[index + 1]

    # Rope from the pivot to the hook where the hoist is at its zero: the pivot is at the height of
    # the carrier, or higher by `rise` where the length is given.
    length = float(carrier.translation[2] - hook.translation[2])
    rise = 0.0 if swing.length is None else swing.length - length
    length += rise
    notes = [f"The pivot is {_height_text(rise)} {carrier_name}."]

    upward = math.copysign(1.0, joints[index].axis[2])
    shortest, longest = _rope_range(model, index, length, upward)
    if longest <= 0.0:
        allowed = "> 0; give its length where the hoist is at zero"
        raise OutOfRange(f"longest rope at {name}", longest, allowed, "m")
    if shortest < _MIN_ROPE_RATIO * longest:
        shortest = _MIN_ROPE_RATIO * longest
        notes.append(f"The shortest rope is {shortest:.3g} m.")
    # The rope grows as the hoist goes down: l = length - upward q.
    rope_length = _NewCoordinate(-upward, upward * length)
    start_notes = _turn_joint(robot, name, rope_length, least=shortest)
    notes.append(f"{_formula('hoist', name, rope_length)}, the length of the rope.")
    notes += start_notes

    # The load, and the two links between the swing joints, which are small beside it.
    load = model.inertias[index + 1].mass
    if swing.mass is not None:
        load = swing.mass
        notes += _set_mass(_links_fixed_to(robot, child.get("link", "")), load)
    mass = _LINK_MASS_RATIO * load if swing.link_mass is None else swing.link_mass
    inertia = _LINK_INERTIA_RATIO * load if swing.link_inertia is None else swing.link_inertia
    notes.append(f"Two links of {mass:g} kg and {inertia:g} kg m² are at the pivot.")

    # The swing joints turn about axes of the world: the pivot has its directions.
    pivot = pin.SE3(np.eye(3), np.array([*hook.translation[:2], hook.translation[2] + length]))
    body = _isotropic_body(mass, inertia)
    _insert_swing(robot, carrier_name, carrier.actInv(pivot), swing.damping, body)
    parent.set("link", "swing_tangential_link")
    # The hoist begins at the pivot now, and lowers the hook along -Z of the world.
    set_placement(element, pin.SE3(hook.rotation, np.zeros(3)))
    _axis_element(element).set("xyz", numbers_text(hook.rotation.T @ [0.0, 0.0, -1.0]))
    roles = {role: ROLES[role].joint for role in ("radial_swing", "tangential_swing")}
    return roles | {"hoist": name}, notes


def _height_text(rise: float) -> str:
    """Return how far one thing is above another, for a sentence [m]."""
    if abs(rise) <= _SMALL_OFFSET:
        return "at the height of"
    return f"{abs(rise):.3g} m {'above' if rise > 0.0 else 'below'}"


def _rope_range(model: pin.Model, hoist: int, length: float, upward: float) -> tuple[float, float]:
    """Return the rope at the ends of the range of a hoist, the shorter one first [m].

    Args:
        model: The Pinocchio model.
        hoist: Index of the hoist.
        length: Rope where the hoist is at its zero [m].
        upward: 1.0 if the hoist counts upward, -1.0 if downward.
    """
    at_lower = length - upward * float(model.lowerPositionLimit[hoist])
    at_upper = length - upward * float(model.upperPositionLimit[hoist])
    return min(at_lower, at_upper), max(at_lower, at_upper)


def _formula(role: str, name: str, coordinate: _NewCoordinate) -> str:
    """Return a new coordinate in terms of that of the file, such as "x = 2 m - trolley"."""
    unit = "rad" if ROLES[role].kind == "revolute" else "m"
    symbol = ROLES[role].symbol
    is_reversed = coordinate.sign < 0.0
    if not coordinate.zero:
        return f"{symbol} = {'-' if is_reversed else ''}{name}"
    offset = f"{-coordinate.sign * coordinate.zero:.6g} {unit}"
    return f"{symbol} = {offset} {'-' if is_reversed else '+'} {name}"


def _is_vertical(joint: Joint) -> bool:
    """Return whether the axis of a joint is along the vertical, see `ALIGNED`."""
    return abs(joint.axis[2]) >= ALIGNED


def _is_horizontal(joint: Joint) -> bool:
    """Return whether the axis of a joint is horizontal, see `ALIGNED`."""
    return math.hypot(joint.axis[0], joint.axis[1]) >= ALIGNED


def _joint_element(robot: ET.Element, name: str) -> ET.Element:
    """Return the joint of a name of a URDF."""
    return next(joint for joint in robot.iterfind("joint") if joint.get("name") == name)


def _turn_joint(
    robot: ET.Element, name: str, coordinate: _NewCoordinate, least: float = -math.inf
) -> list[str]:
    """Give a joint of a URDF a new coordinate, in place: placement, axis, limits, start, spring,
    and how other joints follow it. Return the notes of `_turn_start`.

    Args:
        robot: The URDF.
        name: Name of the joint.
        coordinate: The new coordinate.
        least: Least new coordinate that is allowed [rad or m].
    """
    sign = coordinate.sign
    zero = coordinate.zero
    element = _joint_element(robot, name)
    axis = joint_axis(element)
    axis /= np.linalg.norm(axis)
    placement = joint_placement(element)
    if element.get("type") == "prismatic":
        step = pin.SE3(np.eye(3), axis * zero)
    else:
        step = pin.SE3(pin.exp3(axis * zero), np.zeros(3))
    set_placement(element, placement * step)
    _axis_element(element).set("xyz", numbers_text(sign * axis))
    limit = element.find("limit")
    assert limit is not None  # see check_urdf
    lower = sign * (float(limit.get("lower", 0.0)) - zero)
    upper = sign * (float(limit.get("upper", 0.0)) - zero)
    low = max(min(lower, upper), least)
    high = max(lower, upper)
    limit.set("lower", repr(low))
    limit.set("upper", repr(high))
    notes = _turn_start(robot, name, coordinate, low, high)
    _turn_spring(robot, name, coordinate)
    _turn_followers(robot, name, coordinate)
    return notes


def _turn_spring(robot: ET.Element, name: str, coordinate: _NewCoordinate) -> None:
    """Write the rest position of the spring of a joint, if it has one, in its new coordinate."""
    blocks = [block for block in robot.iterfind("gazebo") if block.get("reference") == name]
    with_spring = [block for block in blocks if block.find("springStiffness") is not None]
    if not with_spring:
        return
    references = [block.find("springReference") for block in blocks]
    reference = next((found for found in references if found is not None), None)
    if reference is None:
        reference = ET.SubElement(with_spring[0], "springReference")
        reference.text = "0"
    old = number(f"rest position of the spring of {name}", (reference.text or "").strip())
    reference.text = repr(coordinate.sign * (old - coordinate.zero))


def _turn_followers(robot: ET.Element, name: str, coordinate: _NewCoordinate) -> None:
    """Let the joints that mimic a joint follow its new coordinate as they followed the old one."""
    # The old coordinate is q = sign p + zero with the new one p, so that a follower moves by
    #
    #     r q + c = (r sign) p + (r zero + c).
    for mimic in robot.iterfind("joint/mimic"):
        if mimic.get("joint") != name:
            continue
        ratio = float(mimic.get("multiplier", "1"))
        offset = float(mimic.get("offset", "0"))
        mimic.set("multiplier", repr(ratio * coordinate.sign))
        mimic.set("offset", repr(ratio * coordinate.zero + offset))


def _turn_start(
    robot: ET.Element, name: str, coordinate: _NewCoordinate, low: float, high: float
) -> list[str]:
    """Start a joint of a URDF where it started in its old coordinate, in place.

    A start in the file that is nearer to an end of the range than `_START_MARGIN` of the range is
    moved to that distance. A joint without a start in the file starts at its old zero, if that
    keeps this distance; else where `cranedyn.model.load` starts a joint without one.

    Args:
        robot: The URDF.
        name: Name of the joint.
        coordinate: Its new coordinate.
        low: Lower end of the range of that [rad or m].
        high: Upper end [rad or m].

    Returns:
        A note if a start in the file was moved.

    Raises:
        OutOfRange: If the start in the file is no number.
    """
    margin = _START_MARGIN * (high - low)
    initial = initial_values(robot).get(name)
    if initial is not None:
        old_start = number(f"{name} at the start", (initial.text or "").strip())
        start = coordinate.sign * (old_start - coordinate.zero)
        allowed_start = min(max(start, low + margin), high - margin)
        initial.text = repr(allowed_start)
        if allowed_start == start:
            return []
        return [
            f"{name} starts at {allowed_start:.3g}, since its start in the file, which is "
            f"{start:.3g} here, is less than {margin:.2g} from an end of its range or beyond it."
        ]
    old_zero = -coordinate.sign * coordinate.zero
    if not low + margin <= old_zero <= high - margin:
        return []
    controls = robot.iterfind("ros2_control/joint")
    control = next(entry for entry in controls if entry.get("name") == name)  # see declare_drives
    state = control.find("state_interface[@name='position']")
    if state is None:
        state = ET.SubElement(control, "state_interface", name="position")
    ET.SubElement(state, "param", name="initial_value").text = repr(old_zero)
    return []


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
        # As in the tower crane of this project: other programs hold a joint with a velocity of 0.
        ET.SubElement(
            joint,
            "limit",
            lower=repr(-math.pi / 2),
            upper=repr(math.pi / 2),
            effort="1e7",
            velocity="10",
        )
        ET.SubElement(joint, "dynamics", damping=repr(damping))
        set_placement(joint, placement)
        ET.SubElement(robot, "link", name=child).append(body)
        parent = child
        placement = pin.SE3.Identity()


def _links_fixed_to(robot: ET.Element, name: str) -> list[ET.Element]:
    """Return a link of a URDF, and after it all links that it carries by fixed joints."""
    links = {link.get("name", ""): link for link in robot.iterfind("link")}
    names = [name]
    for parent_name in names:  # the list grows while it is read
        for joint in robot.iterfind("joint[@type='fixed']"):
            parent = joint.find("parent")
            child = joint.find("child")
            assert parent is not None and child is not None  # see check_urdf
            if parent.get("link") == parent_name:
                names.append(child.get("link", ""))
    return [links[name] for name in names]


def _set_mass(links: Sequence[ET.Element], mass: float) -> list[str]:
    """Set the mass of some links together, in place, and return a note if it changed.

    Mass and inertia of each change in the same ratio. Links without any mass become a point mass at
    the centre of the first one.
    """
    if links[0].find("inertial") is None:
        links[0].append(_isotropic_body(0.0, 0.0))
    old_masses = []
    for link in links:
        element = link.find("inertial/mass")
        old_masses.append(0.0 if element is None else float(element.get("value", 0.0)))
    total = sum(old_masses)
    for i, (link, old_mass) in enumerate(zip(links, old_masses, strict=True)):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        mass_element = inertial.find("mass")
        tensor = inertial.find("inertia")
        assert mass_element is not None and tensor is not None  # see check_urdf
        share = old_mass / total if total else float(i == 0)
        mass_element.set("value", repr(share * mass))
        for key, value in tensor.attrib.items():
            tensor.set(key, repr(float(value) * mass / total if total else 0.0))
    if not total:
        return [f"The load is a point of {mass:g} kg: the file gives it no mass."]
    if mass == total:
        return []
    return [
        f"The load has {mass:g} kg in place of the {total:g} kg of the file, and its rotational "
        f"inertias are those of the file times {mass / total:.4g}."
    ]


def _isotropic_body(mass: float, inertia: float) -> ET.Element:
    """Return a body with the same inertia about each axis."""
    return inertial_element(pin.Inertia(mass, np.zeros(3), inertia * np.eye(3)))


def _axis_element(joint: ET.Element) -> ET.Element:
    """Return the axis of a joint; it is added, along X as by default, where there is none."""
    axis = joint.find("axis")
    return ET.SubElement(joint, "axis", xyz="1 0 0") if axis is None else axis
