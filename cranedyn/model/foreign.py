"""A description in another format than URDF, as a URDF and beside it what a URDF cannot state."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field


@dataclass(frozen=True, eq=False)
class ForeignModel:
    """A model of another format, converted.

    Attributes:
        robot: The URDF, drives in its element ``<ros2_control>`` and springs in ``<gazebo>``.
        gravity: Gravity along -Z that the file states [m/s²]; None if it states none.
        notes: A sentence on everything that was assumed, or left out without changing the motion.
    """

    robot: ET.Element
    gravity: float | None = None
    notes: list[str] = field(default_factory=list)
