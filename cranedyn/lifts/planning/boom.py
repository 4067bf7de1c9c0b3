"""Booms: the joint in which a boom luffs, the drive that telescopes it, and its length.

The length of a boom is that of makers' load charts: from the hinge, about which it luffs, to the
head, where the rope begins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.errors import ModelError, OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.model.layout import LEVEL

_MIN_REACH = 1e-9
"""Least change of a boom's length by one metre of its telescope [m]; below it does not extend."""


class Boom(NamedTuple):
    """Joints of a boom, by their indices among the coordinates.

    Attributes:
        luff: The drive that turns it about a level axis.
        telescope: The drive that extends it; None for a boom of one length.
        head: The joint whose origin is where the rope begins: the first swing.
    """

    luff: int
    telescope: int | None
    head: int


def boom_of(crane: Crane) -> Boom | None:
    """Return the boom of a crane; None if it has none: no drive, or more than one, turns the upper
    end of the rope about a level axis. A knuckle boom, with two such drives, has no one length.
    """
    if not len(crane.swings):
        return None
    layout = crane.layout
    head = int(crane.swings[0])
    drives = set(layout.drives.tolist())
    # Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
    carriers = [support - 1 for support in crane.model.supports[head + 1].tolist()]
    carriers = [joint for joint in carriers if joint in drives]
    # Axes of the layout are those with all coordinates at zero. What stands below a boom turns
    # about the vertical, which leaves a level axis level.
    luffing = [
        joint
        for joint in carriers
        if layout.joints[joint].kind == "revolute" and abs(layout.joints[joint].axis[2]) <= LEVEL
    ]
    if len(luffing) != 1:
        return None
    (luff,) = luffing
    beyond = carriers[carriers.index(luff) + 1 :]
    sliding = [joint for joint in beyond if layout.joints[joint].kind == "prismatic"]
    return Boom(luff, sliding[0] if len(sliding) == 1 else None, head)


def boom_vector(crane: Crane, boom: Boom, q: np.ndarray) -> np.ndarray:
    """Return the vector from the hinge of a boom to its head across the axis of the hinge [m], in
    the frame of the crane, shape (3,), at coordinates of shape (n,).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    hinge = data.oMi[boom.luff + 1]
    at_zero = crane.model.createData()
    pin.forwardKinematics(crane.model, at_zero, np.zeros(crane.layout.n))
    turned = hinge.rotation @ at_zero.oMi[boom.luff + 1].rotation.T
    axis = turned @ np.array(crane.layout.joints[boom.luff].axis)
    vector = data.oMi[boom.head + 1].translation - hinge.translation
    return vector - (vector @ axis) * axis


def boom_ends(crane: Crane, boom: Boom, q: np.ndarray) -> np.ndarray:
    """Return the hinge and the head of a boom in the frame of the crane [m], shape (2, 3), at
    coordinates of shape (n,).
    """
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, q)
    joints = (boom.luff + 1, boom.head + 1)
    return np.array([data.oMi[joint].translation for joint in joints])


def boom_length(crane: Crane, q: np.ndarray) -> float | None:
    """Return the length of the boom of a crane [m] at coordinates of shape (n,); None if it has no
    boom.
    """
    boom = boom_of(crane)
    return None if boom is None else float(np.linalg.norm(boom_vector(crane, boom, q)))


def telescope_at(crane: Crane, length: float) -> tuple[str, float]:
    """Return the name of the joint that telescopes the boom of a crane, and its coordinate [m] at
    which the boom has a length [m].

    Raises:
        ModelError: If the crane has no boom that telescopes.
        OutOfRange: If the boom cannot have this length.
    """
    boom = boom_of(crane)
    if boom is None or boom.telescope is None:
        raise ModelError(
            f"The crane {crane.model.name} has no boom that telescopes: it needs one drive that "
            "luffs it and one that slides beyond that one. Leave the length of the boom out."
        )
    joint = boom.telescope
    low = float(crane.lower[joint])
    high = float(crane.upper[joint])
    # The vector from hinge to head is a straight line of the coordinate of the telescope.
    first = boom_vector(crane, boom, _extended(crane, joint, low))
    last = boom_vector(crane, boom, _extended(crane, joint, high))
    shortest, longest = sorted((float(np.linalg.norm(first)), float(np.linalg.norm(last))))
    if not shortest - _MIN_REACH <= length <= longest + _MIN_REACH:
        raise OutOfRange(
            "length of the boom", f"{length:g}", f"{shortest:.6g} to {longest:.6g}", "m"
        )
    # With the share s of the way from first to last: |first + s step|² = length².
    step = last - first
    a = float(step @ step)
    b = float(first @ step)
    c = float(first @ first) - length**2
    root = math.sqrt(max(b * b - a * c, 0.0))
    shares = [(-b + root) / a, (-b - root) / a]
    share = min(shares, key=lambda share: abs(share - 0.5))  # the one within the range
    share = min(max(share, 0.0), 1.0)
    return crane.layout.joints[joint].name, low + share * (high - low)


def _extended(crane: Crane, joint: int, coordinate: float) -> np.ndarray:
    """Return the coordinates at the start of a crane, shape (n,), but for a joint and those that
    follow it.
    """
    q = crane.start.q.copy()
    q[joint] = coordinate
    return q if crane.coupling is None else crane.coupling.complete(q)
