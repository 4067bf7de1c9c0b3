"""Springs in the joints: read from a URDF, and their efforts and energy on any kind of number."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import number
from cranedyn.errors import ModelError, UnknownName
from cranedyn.model.layout import Layout

_TAGS = ("springStiffness", "springReference", "ropeStiffness")


class Rope(NamedTuple):
    """An elastic rope: its stiffness is EA/l over the present cable length l, so that its strain
    energy is EA s²/(2 l).

    Attributes:
        stretch: Index of the passive coordinate that is its stretch s.
        length: Index of the coordinate that is the cable length l.
        stiffness: EA, Young's modulus times the cross-section [N].
    """

    stretch: int
    length: int
    stiffness: Any


@dataclass(frozen=True, eq=False)
class Springs:
    """A linear spring in each joint, and an elastic rope.

    Attributes:
        stiffness: Stiffness of each joint [N m/rad or N/m], shape (n,); 0 for none.
        rest: Coordinates at which the springs are slack [rad or m], shape (n,).
        rope: The rope; None if it does not stretch.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    rope: Rope | None = None

    @cached_property
    def any(self) -> bool:
        """Whether there is any spring."""
        return self.rope is not None or bool(np.any(self.stiffness != 0.0))

    def effort(self, q: np.ndarray) -> np.ndarray:
        """Return the efforts on the joints at coordinates q [N m or N], shape (n,): the negative
        gradient of the energy.
        """
        effort = -(self.stiffness * (q - self.rest))
        if self.rope is not None:
            stretch, length, stiffness = self.rope
            strain = q[stretch] / q[length]
            effort[stretch] = effort[stretch] - stiffness * strain
            effort[length] = effort[length] + 0.5 * stiffness * strain * strain
        return effort

    def energy(self, q: np.ndarray) -> Any:
        """Return the energy stored at coordinates q [J], a number for shape (n,) and shape (rows,)
        for shape (n, rows).
        """
        offset = q - (self.rest if np.ndim(q) == 1 else self.rest[:, None])
        energy = 0.5 * (self.stiffness @ (offset * offset))
        if self.rope is not None:
            stretch, length, stiffness = self.rope
            energy = energy + 0.5 * stiffness * q[stretch] * q[stretch] / q[length]
        return energy

    def tangent(self, q: np.ndarray) -> np.ndarray:
        """Return the second derivatives of the energy at q [N m/rad, N/m, ...], shape (n, n)."""
        tangent = np.diag(np.asarray(self.stiffness, dtype=float))
        if self.rope is not None:
            s, length, stiffness = self.rope
            strain, per_length = q[s] / q[length], stiffness / q[length]
            tangent[s, s] += per_length
            tangent[length, length] += per_length * strain * strain
            tangent[s, length] -= per_length * strain
            tangent[length, s] -= per_length * strain
        return tangent


def read_springs(robot: ET.Element, layout: Layout, path: Path) -> Springs:
    """Read springs from a URDF.

    Springs stand in the tags of Gazebo, ``<springStiffness>`` and ``<springReference>``. The rope
    is in a tag of this project, ``<ropeStiffness>``: EA [N], at the joint that is the stretch of
    the rope, whose length is the joint in the role hoist.

    Raises:
        UnknownName: If a spring is at no moving joint.
        ModelError: If a tag is given twice, or the stretch of the rope is no passive prismatic
            joint.
        OutOfRange: If a number is not finite, or a stiffness negative.
    """
    stiffness, rest_angles, rope = np.zeros(layout.n), np.zeros(layout.n), None
    names = [joint.name for joint in layout.joints]
    elements = [
        (block.get("reference", ""), tag)
        for block in robot.iterfind("gazebo")
        for tag in block
        if tag.tag in _TAGS
    ]
    counts = Counter((name, tag.tag) for name, tag in elements)
    for name, tag in elements:
        if name not in names:
            raise UnknownName("moving joint", name, names)
        if counts[name, tag.tag] > 1:
            raise ModelError(f"{path} gives {tag.tag} of {name} twice; allowed is once.")
        i, text = names.index(name), (tag.text or "").strip()
        joint = layout.joints[i]
        if tag.tag == "springStiffness":
            unit = "N m/rad" if joint.kind == "revolute" else "N/m"
            stiffness[i] = number(f"spring stiffness of {name}", text, unit, ">= 0")
        elif tag.tag == "springReference":
            rest_angles[i] = number(f"rest position of the spring of {name}", text, joint.unit)
        elif joint.driven or joint.kind != "prismatic":
            raise ModelError(
                f"{path} gives the rope's stretch to {name}; it must be a passive prismatic joint."
            )
        else:
            length = layout.role("hoist", "A rope that stretches")
            rope = Rope(i, length, number(f"EA of the rope at {name}", text, "N", "> 0"))
    return Springs(stiffness, rest_angles, rope)
