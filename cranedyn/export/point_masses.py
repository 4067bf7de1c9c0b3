"""Hook blocks that are points in the crane, as bodies for other programs.

In cranedyn a hook block may be a mass without an inertia, and a link between two axes of one body
may have no mass. Other programs drop such links, and all that they carry.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from cranedyn.errors import quoted
from cranedyn.export.crane_data import ends, link_inertia
from cranedyn.model.crane import Crane
from cranedyn.model.urdf import inertial_element, joint_placement

STEEL_DENSITY = 7850.0
"""Density of a hook block [kg/m³]: that of structural steel (EN 1993-1-1, 3.2.6)."""

PART_SHARE = 0.01
"""Share of the mass of a hook block that goes to a link without mass at the same place, as in the
tower crane of this project whose hook block has an inertia."""


def ball_radius(mass: float) -> float:
    """Return the radius of a solid ball of steel of a mass [m]."""
    return math.cbrt(3.0 * mass / (4.0 * math.pi * STEEL_DENSITY))


def ball_inertia(mass: float) -> float:
    """Return the moment of inertia of a solid ball of steel about each axis, 2/5 m r² [kg m²]."""
    return 0.4 * mass * ball_radius(mass) ** 2


def give_bodies_to_points(
    crane: Crane, robot: ET.Element, *, share_masses: bool = True
) -> list[str]:
    """Give an inertia to the point masses of a URDF that carry other moving links, such as a hook
    block, and a part of them to links without mass at the same place, in place.

    * A link with a mass and no inertia becomes a solid ball of steel of this mass. A load that is a
      point stays one: its inertia is up to the user.
    * A link without a mass gets the share `PART_SHARE` of the mass of a link from which only joints
      that rotate about its centre of mass separate it, also as a ball. Both move together as
      before. The link gives up as much inertia as its part has, so that their sum stays.

    Args:
        crane: The crane.
        robot: Its URDF.
        share_masses: Whether links without mass get a part; False for a program that needs none
            there.

    Returns:
        A sentence on each link that was changed, for the reader of the export.
    """
    moving_names = {joint.name for joint in crane.layout.joints}
    joints = list(robot.iterfind("joint"))
    carrying = {ends(joint)[0] for joint in joints}
    moving_joints = [joint for joint in joints if joint.get("name") in moving_names]
    moving = {ends(joint)[1] for joint in moving_joints}
    # Only links that move give a part of their mass: that of others is of no account.
    links = {}
    for link in robot.iterfind("link"):
        if link.get("name") in moving:
            links[link.get("name", "")] = link
    notes = []
    for name, link in links.items():
        inertia = link_inertia(link)
        if name in carrying and inertia.mass > 0.0 and not np.any(inertia.inertia):
            moment = ball_inertia(inertia.mass)
            _set_inertia(link, pin.Inertia(inertia.mass, inertia.lever, moment * np.eye(3)))
            notes.append(
                f"The link {quoted(name)} of {inertia.mass:g} kg is a point in the crane. Here it "
                f"is a solid ball of steel ({STEEL_DENSITY:g} kg/m³) with the radius "
                f"{ball_radius(inertia.mass):.4g} m and the moment of inertia {moment:.4g} kg m² "
                "about each axis."
            )
    if share_masses:
        for joint in moving_joints:
            notes += _share_mass(joint, links)
    return notes


def _share_mass(joint: ET.Element, links: Mapping[str, ET.Element]) -> list[str]:
    """Give a part of the mass of one link at a joint to the other one, if that has none and moves
    with the centre of mass of the first; return a sentence on it.

    Args:
        joint: The joint.
        links: Moving links by their names.
    """
    parent, child = ends(joint)
    if parent not in links:
        return []
    rotates = joint.get("type") in ("revolute", "continuous")
    if not rotates or np.any(joint_placement(joint).translation):
        return []
    for massless, donor in ((parent, child), (child, parent)):
        whole = link_inertia(links[donor])
        if link_inertia(links[massless]).mass > 0.0 or not whole.mass > 0.0:
            continue
        part_mass = PART_SHARE * whole.mass
        part_moment = ball_inertia(part_mass) * np.eye(3)
        rest_moment = whole.inertia - part_moment
        if np.any(whole.lever) or np.linalg.eigvalsh(rest_moment)[0] <= 0.0:
            continue
        _set_inertia(links[massless], pin.Inertia(part_mass, np.zeros(3), part_moment))
        _set_inertia(links[donor], pin.Inertia(whole.mass - part_mass, np.zeros(3), rest_moment))
        return [
            f"The link {quoted(massless)} has no mass in the crane. Here it has {part_mass:g} kg "
            f"of the mass of the link {quoted(donor)}, at the same place."
        ]
    return []


def _set_inertia(link: ET.Element, inertia: pin.Inertia) -> None:
    """Replace mass, centre of mass and inertia of a link, in place."""
    present = link.find("inertial")
    if present is not None:
        link.remove(present)
    link.insert(0, inertial_element(inertia))
