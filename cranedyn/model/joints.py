"""Joints of a loaded model: axes, drives, roles, payload, and points on which forces act."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.checks import number
from cranedyn.errors import ModelError, OutOfRange, UnknownName, quoted
from cranedyn.model.crane import NO_RATE_LIMIT, Point
from cranedyn.model.layout import ALIGNED, ROLES, Joint
from cranedyn.model.mimics import Mimic

UNLIMITED_TURN = 31.4159
"""How far a turning joint without limits may turn to either side [rad]: five turns, as the slew of
the tower crane."""

UNLIMITED_SLIDE = 1e3
"""How far a sliding joint may go on a side on which its file states no end [m], far longer than any
crane."""

UNKNOWN_EFFORT = 1e6
"""Effort limit of a drive whose file states none, or 0 [N or N m], as of the drives of the tower
crane."""

_MAX_NAMED_JOINTS = 20
"""Number of joints that an error message names."""

_MIN_ANGULAR_RATE = 1e-9
"""Angular rate of a body per unit of a coordinate from which on its joint turns: that of a revolute
joint is 1 rad per rad, that of a prismatic one is round-off."""

MAX_MOVING_JOINTS = 128
"""Largest number of joints that move. Pinocchio's data grow with the cube of it: with 400 joints
they take 4 GB, with 900 they end the process."""


def complete_limits(robot: ET.Element, driven: Sequence[str] | None) -> list[str]:
    """Give the joints of a checked URDF the limits that programs for CAD leave out, in place.

    A continuous joint becomes a revolute one. A velocity limit of 0 becomes `NO_RATE_LIMIT`, since
    other programs keep such a joint from moving. An effort limit of 0 of a drive becomes
    `UNKNOWN_EFFORT`, since such a drive could do nothing.

    Args:
        robot: The URDF.
        driven: Names of the driven joints; None for those that the URDF declares, all if it
            declares none.

    Returns:
        A note on each limit that was set.
    """
    drives = set(driven or ()) or _declared_drives(robot)[0]
    notes = []
    for joint in robot.iterfind("joint"):
        name = joint.get("name", "")
        limit = joint.find("limit")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            if limit is None:
                limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
            limit.set("lower", str(-UNLIMITED_TURN))
            limit.set("upper", str(UNLIMITED_TURN))
            notes.append(f"{name} is continuous, read as revolute up to ±{UNLIMITED_TURN} rad.")
        if limit is None or joint.get("type") not in ("revolute", "prismatic"):
            continue
        if float(limit.get("velocity", "0")) == 0.0:
            limit.set("velocity", str(NO_RATE_LIMIT))
            notes.append(f"velocity limit 0 of {name} read as none.")
        if float(limit.get("effort", "0")) == 0.0 and (name in drives or not drives):
            limit.set("effort", str(UNKNOWN_EFFORT))
            unit = "N" if joint.get("type") == "prismatic" else "N m"
            notes.append(f"effort limit 0 of {name} read as unknown: {UNKNOWN_EFFORT:g} {unit}.")
    return notes


def joint_names(model: pin.Model) -> list[str]:
    """Return the names of the moving joints in the order of the coordinates."""
    return list(model.names)[1:]


def check_joints(model: pin.Model, path: Path) -> None:
    """Check that a model has joints, not too many, each with one coordinate.

    Raises:
        ModelError: If it does not.
    """
    names = joint_names(model)
    if not names:
        raise ModelError(f"{path} has no joint that moves.")
    count = len(names)
    if count > MAX_MOVING_JOINTS:
        raise ModelError(f"{path} has {count} joints that move; allowed are {MAX_MOVING_JOINTS}.")
    for i, name in enumerate(names, start=1):
        if model.joints[i].nq != 1 or model.joints[i].nv != 1:
            raise ModelError(
                f"{path} has a {quoted(name)} without limits or with several axes; it must be "
                "revolute, continuous or prismatic."
            )


def read_armature(robot: ET.Element, names: Sequence[str]) -> np.ndarray:
    """Return the inertia of motor and gear of each joint, as seen by that joint [kg m² or kg],
    shape (n,); 0 where the file states none. No parser of URDF reads it.

    Raises:
        OutOfRange: If an armature is not finite or negative.
    """
    armature = np.zeros(len(names))
    for joint in robot.iterfind("joint"):
        name = joint.get("name", "")
        dynamics = joint.find("dynamics")
        if dynamics is None or name not in names:
            continue
        text = dynamics.get("armature")
        if text:
            armature[names.index(name)] = number(f"armature of {name}", text, "kg m² or kg", ">= 0")
    return armature


def payload_index(model: pin.Model, name: str | None, path: Path) -> int:
    """Return the index of the joint that carries the payload: the joint of a name, or the only one
    that carries no other joint.

    Raises:
        UnknownName: If there is no such joint.
        OutOfRange: If the name is not a text, such as a mass in its place.
        ModelError: If no name is given and several joints carry no other.
    """
    names = joint_names(model)
    if name is not None:
        if not isinstance(name, str):
            raise OutOfRange("payload", name, "the name of a joint; its mass is payload_mass")
        if name not in names:
            raise UnknownName("moving joint", name, names)
        return names.index(name)
    parents = list(model.parents)[1:]
    leaves = [i for i in range(len(names)) if i + 1 not in parents]
    if len(leaves) > 1:
        raise ModelError(
            f"{path} is a tree that ends in {', '.join(quoted(names[i]) for i in leaves)}; say "
            "which joint carries the payload by load_crane(payload=...), or --payload, and hold "
            "those that do not matter by locked=[...], or --locked."
        )
    return leaves[0]


def has_drives(robot: ET.Element) -> bool:
    """Return whether a URDF declares which joints are driven."""
    return bool(_declared_drives(robot)[0])


def _declared_drives(robot: ET.Element) -> tuple[set[str], str]:
    """Return the names of the driven joints and the element that declares them."""
    controlled = {
        joint.get("name", "")
        for joint in robot.iterfind("ros2_control/joint")
        if joint.find("command_interface") is not None
    }
    if controlled:
        return controlled, "<ros2_control>"
    transmitted = {joint.get("name", "") for joint in robot.iterfind("transmission/joint")}
    return transmitted, "<transmission>"


def declare_drives(robot: ET.Element, driven: Sequence[str]) -> None:
    """Add a ``<ros2_control>`` with a command interface for each driven joint, in place; for a URDF
    that has no command interface.
    """
    control = ET.SubElement(robot, "ros2_control", name="crane", type="system")
    hardware = ET.SubElement(control, "hardware")
    ET.SubElement(hardware, "plugin").text = "mock_components/GenericSystem"
    for name in driven:
        joint = ET.SubElement(control, "joint", name=name)
        ET.SubElement(joint, "command_interface", name="effort")
        ET.SubElement(joint, "state_interface", name="position")


def driven_joints(
    robot: ET.Element,
    names: Sequence[str],
    driven: Sequence[str] | None,
    path: Path,
    mimics: Mapping[str, Mimic],
) -> set[str]:
    """Return the names of the driven joints, from ``<ros2_control>``, else from ``<transmission>``
    (ROS 1), or as given. Followers that the file lists among them are left out: their leaders are
    driven.

    Raises:
        UnknownName: If there is no joint of a given name.
        ModelError: If no joint is driven, or a joint of ``<ros2_control>`` does not move or
            contradicts the names given.
    """
    declared, source = _declared_drives(robot)
    declared -= mimics.keys()
    for name in driven or ():
        if name in mimics:
            raise ModelError(
                f"{path} has {quoted(name)}, which mimics {quoted(mimics[name].leader)} and has no "
                "drive of its own; leave it out of the driven joints."
            )
    if driven is not None and source == "<transmission>":
        # A transmission tells how a drive is geared, and is weaker evidence of what is driven than
        # a command interface: what the caller gives takes its place.
        declared = set()
    if driven is not None and declared and declared != set(driven):
        raise ModelError(
            f"{path} says by {source} that drives move "
            f"{', '.join(map(quoted, sorted(declared)))}, the argument says {', '.join(driven)}; "
            "leave one out."
        )
    for name in sorted(declared):
        if name not in names:
            raise ModelError(
                f"{path} names {quoted(name)} as a driven joint in {source}; the joints that "
                f"move are {', '.join(map(quoted, names))}."
            )
    for name in driven or ():
        if name not in names:
            raise UnknownName("moving joint", name, names)
    if not (declared or driven):
        raise ModelError(
            f"{path} does not say which joints are driven, by <ros2_control>, <transmission> or an "
            "actuator; say it by load_crane(driven=[...]), or --driven. Its joints are "
            f"{_listed(names)}. If the hook hangs on a rigid joint, swing=True, or --swing, puts a "
            "rope above it."
        )
    return declared or set(driven or ())


def _listed(names: Sequence[str]) -> str:
    """Return the first names of joints, and how many more there are, for an error message."""
    listed = ", ".join(map(quoted, names[:_MAX_NAMED_JOINTS]))
    if len(names) > _MAX_NAMED_JOINTS:
        listed += f" and {len(names) - _MAX_NAMED_JOINTS} more"
    return listed


def joint_roles(
    joints: Sequence[Joint], given: Mapping[str, str] | None, is_chain: bool
) -> dict[str, str]:
    """Return the role of each joint by its name.

    Args:
        joints: The joints, without roles.
        given: Names of joints by role; None for those that names and motions show, see
            `_default_roles`.
        is_chain: Whether each joint carries the next one and no other.

    Raises:
        UnknownName: If there is no such role or no such joint.
        ModelError: If one joint has two roles.
    """
    names = [joint.name for joint in joints]
    if given is None:
        return _default_roles(joints, is_chain)
    roles: dict[str, str] = {}
    for role, joint in given.items():
        if role not in ROLES:
            raise UnknownName("role", role, ROLES)
        if joint not in names:
            raise UnknownName("moving joint", joint, names)
        if joint in roles:
            raise ModelError(
                f"The joint {joint} is given two roles, {roles[joint]} and {role}; allowed is one."
            )
        roles[joint] = role
    return roles


def _default_roles(joints: Sequence[Joint], is_chain: bool) -> dict[str, str]:
    """Return the role of each joint by its name where the user gives none.

    These are, in this order:

    1. Where joints have all five default names of `ROLES`: the roles of these names. Whether they
       also move so is checked by `check_roles`.
    2. In a chain of five joints that move as the five roles do in their order: these roles,
       whatever the names of the joints.
    3. In any other crane: the role of each joint that has a default name and moves as its role.
    """
    names = [joint.name for joint in joints]
    named = {role.joint: name for name, role in ROLES.items() if role.joint in names}
    if len(named) == len(ROLES):
        return named
    if is_chain and len(joints) == len(ROLES):
        if all(_plays(joint, role) for joint, role in zip(joints, ROLES, strict=True)):
            return dict(zip(names, ROLES, strict=True))
    roles = {}
    for joint in joints:
        role = named.get(joint.name)
        if role is not None and _fits(joint, role):
            roles[joint.name] = role
    return roles


def _plays(joint: Joint, role: str) -> bool:
    """Return whether a joint moves as that of a role: along its axis, and driven if no swing."""
    is_swing = role.endswith("_swing")
    return _fits(joint, role) and joint.driven != is_swing


def read_joints(
    model: pin.Model,
    driven: set[str],
    given: Mapping[str, str] | None,
    path: Path,
    mimics: Mapping[str, Mimic],
) -> tuple[Joint, ...]:
    """Return the joints in the order of the coordinates.

    The symbol of a joint is the symbol of its role, or its name without the ending "_joint".

    Args:
        model: The model.
        driven: Names of the driven joints.
        given: Names of joints by role, see `joint_roles`.
        path: File for error messages.
        mimics: How joints follow others, by name.

    Raises:
        UnknownName: As `joint_roles`.
        ModelError: As `joint_roles`, or if two joints have the same symbol.
    """
    joints = []
    data = model.createData()
    names = joint_names(model)
    n = len(names)
    # The column of a joint in its own Jacobian at zero is its motion in the world per unit of its
    # coordinate: the axis, linear for a prismatic joint and angular for a revolute one.
    pin.computeJointJacobians(model, data, np.zeros(n))
    for i, name in enumerate(names):
        # Pinocchio gives a matrix of one column without its second dimension.
        jacobian = pin.getJointJacobian(model, data, i + 1, pin.LOCAL_WORLD_ALIGNED).reshape(6, n)
        linear = jacobian[:3, i]
        angular = jacobian[3:, i]
        prismatic = bool(np.linalg.norm(angular) < _MIN_ANGULAR_RATE)
        joints.append(
            Joint(
                name=name,
                symbol=name.removesuffix("_joint"),
                unit="m" if prismatic else "rad",
                kind="prismatic" if prismatic else "revolute",
                axis=tuple((linear if prismatic else angular).tolist()),
                driven=name in driven,
                follows=mimics[name].leader if name in mimics else "",
            )
        )
    is_chain = list(model.parents)[1:] == list(range(n))
    for name, role in joint_roles(joints, given, is_chain).items():
        i = names.index(name)
        joints[i] = replace(joints[i], role=role, symbol=ROLES[role].symbol)
    symbols = [joint.symbol for joint in joints]
    if len(set(symbols)) < n:
        raise ModelError(
            f"{path} has joints of the same symbol among {', '.join(map(quoted, symbols))}; give "
            "them other names."
        )
    return tuple(joints)


def _fits(joint: Joint, role: str) -> bool:
    """Return whether a joint has the kind and, within a milliradian, the axis of a role."""
    aligned = np.dot(joint.axis, ROLES[role].axis) >= ALIGNED
    return joint.kind == ROLES[role].kind and bool(aligned)


def check_roles(joints: Sequence[Joint], path: Path) -> None:
    """Check that kind and axis of each joint fit its role.

    Raises:
        ModelError: If one does not.
    """
    for joint in joints:
        if not joint.role:
            continue
        role = ROLES[joint.role]
        if joint.kind != role.kind:
            raise ModelError(f"{path} has a {joint.kind} {joint.name}; it must be {role.kind}.")
        if not _fits(joint, joint.role):
            axis = [round(component, 6) for component in joint.axis]
            raise ModelError(
                f"{path} has {joint.name} along {axis} of the world; it must be {list(role.axis)}."
            )


def force_points(
    model: pin.Model, joints: Sequence[Joint], payload: int, elastic: np.ndarray
) -> tuple[Point, ...]:
    """Return the points on which external forces act.

    They are the payload, the pivot of the load where a passive revolute joint carries it, and the
    hook where joints that are no part of the rope are between hoist and payload, such as those of a
    sling.

    Args:
        model: The Pinocchio model.
        joints: Its moving joints, in the order of the coordinates.
        payload: Index of the joint that carries the payload.
        elastic: Whether each joint is held by a spring, see `Springs.elastic`, shape (n,).
    """
    # Joints between the world and the payload, in this order. Coordinate i belongs to joint i + 1
    # of Pinocchio, whose joint 0 is the world.
    chain = [joint - 1 for joint in model.supports[payload + 1].tolist() if joint > 0]
    points = [_centre_of_mass("payload", model, payload)]
    pivot = _pivot(joints, chain, elastic)
    if pivot is not None:
        name = "trolley" if any(joint.role == "trolley" for joint in joints) else "pivot"
        points.append(Point(name, pivot, np.zeros(3)))
    hook = _hook(joints, chain)
    if hook is not None and hook != payload:
        points.append(_centre_of_mass("hook", model, hook))
    return tuple(points)


def _pivot(joints: Sequence[Joint], chain: Sequence[int], elastic: np.ndarray) -> int | None:
    """Return the index of the joint about which the load swings; None if no joint does.

    It is the first passive revolute joint of the chain to the payload without a spring: those with
    a spring are elastic parts of tower or jib, such as the twist of the tower. Where all have a
    spring it is the first of them.
    """
    revolute = [i for i in chain if joints[i].passive and joints[i].kind == "revolute"]
    swings = [i for i in revolute if not elastic[i]]
    candidates = swings or revolute
    return candidates[0] if candidates else None


def _hook(joints: Sequence[Joint], chain: Sequence[int]) -> int | None:
    """Return the index of the last joint of the rope in the chain to the payload; None without a
    hoist.

    It is the hoist, or the joint below it that is the stretch of the rope or its yaw on two falls.
    """
    for place, joint in enumerate(chain):
        if joints[joint].role != "hoist":
            continue
        if place + 1 < len(chain):
            below = joints[chain[place + 1]]
            if not below.driven and abs(below.axis[2]) >= ALIGNED:
                return chain[place + 1]
        return joint
    return None


def _centre_of_mass(name: str, model: pin.Model, joint: int) -> Point:
    """Return the centre of mass of the body that a joint carries as a point of a name."""
    return Point(name, joint, model.inertias[joint + 1].lever.copy())
