"""Joints that a user holds fixed: outriggers, a steering, a grapple that stays closed."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from cranedyn.checks import within
from cranedyn.errors import ModelError, UnknownName, quoted
from cranedyn.model.urdf import initial_values, joint_axis, joint_placement, set_placement

Locked = Sequence[str] | Mapping[str, float | str | None]
"""Names of joints, or their coordinates [rad or m] by name: numbers, also as text from a command
line, or None for where a joint starts."""


def lock_joints(robot: ET.Element, locked: Locked, path: Path) -> list[str]:
    """Make joints of a checked URDF fixed ones, in place, with all that mimic them.

    The range of a joint that mimics a locked one is not checked: it is held where its leader puts
    it.

    Args:
        robot: The URDF.
        locked: The joints. A joint without a coordinate is held where it starts: at its initial
            value in ``<ros2_control>``, else at 0 or, where 0 is out of its range, in the middle.
        path: File for error messages.

    Returns:
        A note on each joint.

    Raises:
        UnknownName: If there is no such moving joint.
        ModelError: If a joint mimics another one, which is to be locked instead.
        OutOfRange: If a coordinate is out of the range of its joint.
    """
    moving = {
        joint.get("name", ""): joint
        for joint in robot.iterfind("joint")
        if joint.get("type") in ("revolute", "prismatic", "continuous")
    }
    if isinstance(locked, str):
        locked = [locked]
    coordinates = dict(locked) if isinstance(locked, Mapping) else dict.fromkeys(locked)
    for name in coordinates:
        if name not in moving:
            raise UnknownName("moving joint", name, moving)
        mimic = moving[name].find("mimic")
        if mimic is not None:
            leader = mimic.get("joint", "")
            raise ModelError(
                f"The joint {quoted(name)} in {path} mimics {quoted(leader)}; lock "
                f"{quoted(leader)} instead."
            )
    notes = []
    for name, value in coordinates.items():
        coordinate = _coordinate(robot, moving[name], value)
        notes += _lock(robot, moving, name, coordinate)
    return notes


def _lock(
    robot: ET.Element, moving: Mapping[str, ET.Element], name: str, coordinate: float
) -> list[str]:
    """Fix a joint at a coordinate, and all that mimic it at the coordinates that follow; return
    notes.
    """
    joint = moving[name]
    is_prismatic = joint.get("type") == "prismatic"
    unit = "m" if is_prismatic else "rad"
    notes = [f"{name} is locked at {coordinate:.6g} {unit}."]

    # A fixed joint has no coordinate: its placement takes up the displacement.
    axis = joint_axis(joint)
    moved = coordinate * axis / np.linalg.norm(axis)
    if is_prismatic:
        step = pin.SE3(np.eye(3), moved)
    else:
        step = pin.SE3(pin.exp3(moved), np.zeros(3))
    set_placement(joint, joint_placement(joint) * step)
    joint.set("type", "fixed")
    _forget_motion(robot, joint)
    for follower, element in moving.items():
        mimic = element.find("mimic")
        if mimic is not None and mimic.get("joint") == name:
            ratio = float(mimic.get("multiplier", "1"))
            offset = float(mimic.get("offset", "0"))
            notes += _lock(robot, moving, follower, ratio * coordinate + offset)
    return notes


def _forget_motion(robot: ET.Element, joint: ET.Element) -> None:
    """Remove what a URDF says about the motion of a joint: its axis, limits, damping and mimic, its
    entry in ``<ros2_control>``, and each ``<transmission>`` and ``<gazebo reference>`` that names
    it, with all that is in them.
    """
    name = joint.get("name")
    for child in list(joint):
        if child.tag in ("axis", "limit", "dynamics", "mimic"):
            joint.remove(child)
    for control in robot.iterfind("ros2_control"):
        for entry in control.findall("joint"):
            if entry.get("name") == name:
                control.remove(entry)
    for block in robot.findall("transmission"):
        if any(entry.get("name") == name for entry in block.iterfind("joint")):
            robot.remove(block)
    for block in robot.findall("gazebo"):
        if block.get("reference") == name:
            robot.remove(block)


def _coordinate(robot: ET.Element, joint: ET.Element, value: float | str | None) -> float:
    """Return the coordinate at which a joint is locked."""
    name = joint.get("name", "")
    unit = "m" if joint.get("type") == "prismatic" else "rad"
    limit = joint.find("limit")
    low = -math.inf
    high = math.inf
    if limit is not None and joint.get("type") != "continuous":
        low = float(limit.get("lower", "0"))
        high = float(limit.get("upper", "0"))
    if value is None:
        initial = initial_values(robot).get(name)
        if initial is not None:
            value = initial.text or ""
    if value is None:
        return 0.0 if low <= 0.0 <= high else (low + high) / 2.0
    return within(f"locked {name}", value, low, high, unit)
