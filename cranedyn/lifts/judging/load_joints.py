"""The joints of a crane at which its loads are told: hoist, slew, trolley, and the pivot of the
rope.

A tower crane of this project names them by their roles. Those of another crane follow from what
its joints do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.model.crane import Crane
from cranedyn.model.layout import ALIGNED, LEVEL


@dataclass(frozen=True)
class LoadJoints:
    """Joints of a crane, by their indices among the coordinates; None where it has no such joint.

    Attributes:
        hoist: The joint that sets the length of the rope.
        slew: The joint that turns the crane about the vertical.
        trolley: The joint that slides the pivot of the rope along a level jib or bridge.
        travel: The drive next to the ground, if it slides level and carries another drive: the one
            by which the crane runs on rails.
        pivot: The joint whose origin is where the rope begins: the first swing, or the trolley of a
            crane whose load does not swing.
    """

    hoist: int | None
    slew: int | None
    trolley: int | None
    travel: int | None
    pivot: int | None

    @property
    def has_boom(self) -> bool:
        """Whether the crane slews and has no trolley: its rope hangs from the head of a boom."""
        return self.slew is not None and self.trolley is None

    @classmethod
    def of(cls, crane: Crane) -> LoadJoints:
        """Return those of a crane.

        The slew is the drive nearest to the ground that turns the pivot about the vertical. Without
        a joint of that role, the trolley is the one nearest to the load that slides the pivot
        level, other than the one by which the crane travels.
        """
        layout = crane.layout
        of_role = {joint.role: i for i, joint in enumerate(layout.joints) if joint.role}
        hoist = of_role.get("hoist")
        if hoist is None and crane.winch is not None:
            hoist = int(layout.drives[crane.winch])
        first_swing = int(crane.swings[0]) if len(crane.swings) else None
        slew = None
        trolley = of_role.get("trolley")
        travel = None
        carriers = _drives_above(crane, first_swing)
        for joint in carriers:
            axis = _axis_at_start(crane, joint)
            turns = layout.joints[joint].kind == "revolute"
            if turns and abs(axis[2]) >= ALIGNED:
                slew = joint  # the last one is nearest to the ground
            if turns or abs(axis[2]) > LEVEL or joint == trolley:
                continue
            stands = int(crane.model.parents[joint + 1]) == 0
            if stands and len(carriers) > 1:
                travel = joint
            elif trolley is None:
                trolley = joint
        if slew is None:
            slew = of_role.get("slew")
        pivot = trolley if first_swing is None else first_swing
        return cls(hoist, slew, trolley, travel, pivot)


def _drives_above(crane: Crane, joint: int | None) -> list[int]:
    """Return the drives that carry a joint, the one nearest to it first."""
    if joint is None:
        return []
    drives = set(crane.layout.drives.tolist())
    # Coordinate i belongs to joint i + 1 of Pinocchio, whose joint 0 is the world.
    carriers = [support - 1 for support in crane.model.supports[joint + 1].tolist()]
    return [carrier for carrier in reversed(carriers) if carrier in drives]


def _axis_at_start(crane: Crane, joint: int) -> np.ndarray:
    """Return the axis of a joint in the world where the crane starts, shape (3,)."""
    data = crane.model.createData()
    pin.forwardKinematics(crane.model, data, crane.start.q)
    # Axes of the layout are those with all coordinates at zero.
    at_zero = crane.model.createData()
    pin.forwardKinematics(crane.model, at_zero, np.zeros(crane.layout.n))
    axis = np.array(crane.layout.joints[joint].axis)
    return data.oMi[joint + 1].rotation @ at_zero.oMi[joint + 1].rotation.T @ axis
