"""The joints of a crane by name: driven or passive, and their roles in a tower crane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array, number, read_only
from cranedyn.data.columns import trajectory_columns
from cranedyn.errors import MissingRole, ModelError, OutOfRange, UnknownName
from cranedyn.interfaces import State

_COUNT_WORDS = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}
"""Small numbers in words, for error messages."""

ALIGNED = math.cos(1e-3)
"""Cosine of 1 mrad, the largest angle at which an axis still counts as along a direction."""

LEVEL = 1e-3
"""Vertical part of a unit axis up to which it counts as level: the same angle."""


class Role(NamedTuple):
    """Role of a joint in a tower crane, and the joint that fits it.

    Attributes:
        symbol: Symbol of the coordinate.
        kind: "revolute" or "prismatic".
        axis: Axis in the world frame at zero of every coordinate.
        joint: Name of the joint that has this role by default.
    """

    symbol: str
    kind: str
    axis: tuple[int, int, int]
    joint: str


ROLES = {
    "slew": Role("gamma", "revolute", (0, 0, 1), "yaw_joint"),
    "trolley": Role("x", "prismatic", (0, -1, 0), "trolley_joint"),
    "radial_swing": Role("phi", "revolute", (1, 0, 0), "swing_radial_joint"),
    "tangential_swing": Role("theta", "revolute", (0, 1, 0), "swing_tangential_joint"),
    "hoist": Role("l", "prismatic", (0, 0, -1), "hoist_joint"),
}
"""Roles in a tower crane in chain order. The symbol of a joint without a role is its name without
the ending "_joint"."""


@dataclass(frozen=True)
class Joint:
    """A moving joint with one coordinate.

    Attributes:
        name: Name in the URDF.
        symbol: Symbol of the coordinate in tables, columns and code.
        unit: Unit of the coordinate, "rad" or "m".
        kind: "revolute" or "prismatic".
        axis: Axis in the world frame at zero of every coordinate, three numbers.
        driven: Whether a drive moves it; otherwise it is passive or follows another joint.
        role: Role in a tower crane, see `ROLES`; empty for none.
        follows: Name of the joint that it mimics; empty for a joint that follows no other.
    """

    name: str
    symbol: str
    unit: str
    kind: str
    axis: tuple[float, float, float]
    driven: bool
    role: str = ""
    follows: str = ""

    @property
    def passive(self) -> bool:
        """Whether it moves freely: no drive moves it, and it follows no other joint."""
        return not (self.driven or self.follows)

    @property
    def effort_unit(self) -> str:
        """Unit of the generalized force, "N m" or "N"."""
        return "N m" if self.kind == "revolute" else "N"

    @property
    def effort_name(self) -> str:
        """Name of the generalized force: torque T or force F, such as F_x."""
        letter = "T" if self.kind == "revolute" else "F"
        return f"{letter}_{self.symbol}"

    @property
    def effort_column(self) -> str:
        """Name of the column of the effort that acts."""
        return f"{self.effort_name}_{self.effort_unit.replace(' ', '')}"

    @property
    def columns(self) -> tuple[str, str]:
        """Names of the columns of coordinate and rate."""
        return f"{self.symbol}_{self.unit}", f"{self.symbol}_dot_{self.unit}_s"

    @property
    def setpoint_column(self) -> str:
        """Name of the column of the setpoint."""
        return f"{self.symbol}_setpoint_{self.unit}"


@dataclass(frozen=True)
class Layout:
    """Joints of a crane, n in all and m of them driven, and points on which forces act.

    Attributes:
        joints: Joints in the order of the coordinates, parents before children.
        points: Names of the points, the payload first.
    """

    joints: tuple[Joint, ...]
    points: tuple[str, ...]

    @cached_property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.joints)

    @cached_property
    def m(self) -> int:
        """Number of drives."""
        return len(self.drives)

    @cached_property
    def drives(self) -> np.ndarray:
        """Indices of the driven coordinates, shape (m,)."""
        return self._indices([joint.driven for joint in self.joints])

    @cached_property
    def passive(self) -> np.ndarray:
        """Indices of the passive coordinates, shape (n - m,) unless joints follow others."""
        return self._indices([joint.passive for joint in self.joints])

    @cached_property
    def independent(self) -> np.ndarray:
        """Indices of the coordinates of joints that follow no other, drives and passive ones."""
        return self._indices([not joint.follows for joint in self.joints])

    @cached_property
    def measured(self) -> np.ndarray:
        """Indices in z = (coordinates, rates) of the coordinate and the rate of each drive, which
        the sensors of the drives measure; shape (2 m,).
        """
        return np.concatenate([self.drives, self.n + self.drives])

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the coordinates."""
        return tuple(joint.symbol for joint in self.joints)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates."""
        return tuple(joint.unit for joint in self.joints)

    @cached_property
    def driven(self) -> tuple[Joint, ...]:
        """Joints that drives move."""
        return tuple(joint for joint in self.joints if joint.driven)

    @cached_property
    def drives_in_words(self) -> str:
        """Text for error messages, such as "three numbers: slew, trolley, hoist"."""
        names = ", ".join(joint.role or joint.symbol for joint in self.driven)
        count = _COUNT_WORDS.get(self.m, str(self.m))
        return f"{count} number{'s' if self.m > 1 else ''}: {names}"

    def index(self, symbol: str) -> int:
        """Return the index of a coordinate.

        Raises:
            UnknownName: If there is no coordinate of this symbol.
        """
        if symbol not in self.symbols:
            raise UnknownName("coordinate", symbol, self.symbols)
        return self.symbols.index(symbol)

    def at(self, *symbols: str) -> list[int]:
        """Return the indices of coordinates.

        Raises:
            UnknownName: If there is no coordinate of a symbol.
        """
        return [self.index(symbol) for symbol in symbols]

    def drive(self, symbol: str) -> int:
        """Return the index of a drive among the drives.

        Raises:
            UnknownName: If there is no drive of this symbol.
        """
        symbols = [joint.symbol for joint in self.driven]
        if symbol not in symbols:
            raise UnknownName("drive", symbol, symbols)
        return symbols.index(symbol)

    def drive_of(self, role: str) -> int | None:
        """Return the index of the drive in a role among the drives, None if there is none."""
        for i, joint in enumerate(self.driven):
            if joint.role == role:
                return i
        return None

    def along(self, drive: str) -> np.ndarray:
        """Return the unit vector of a drive, shape (m,).

        Raises:
            UnknownName: If there is no drive of this symbol.
        """
        return np.eye(self.m)[self.drive(drive)]

    def for_drives(
        self, name: str, values: Any, per: str | None = "", allowed: str = "any"
    ) -> np.ndarray:
        """Return one finite number for each drive, shape (m,).

        Args:
            name: Name of the numbers, to begin an error message with.
            values: The numbers.
            per: What follows the unit of the coordinate, for example "/s"; None where the numbers
                are efforts.
            allowed: Allowed range, as in `cranedyn.checks.number`.

        Raises:
            OutOfRange: If there are not m numbers, or one is not allowed.
        """
        if np.shape(values) != (self.m,):
            raise OutOfRange(name, values, self.drives_in_words)
        checked = []
        for joint, value in zip(self.driven, values, strict=True):
            unit = joint.effort_unit if per is None else joint.unit + per
            checked.append(number(f"{name} of {joint.symbol}", value, unit, allowed))
        return np.array(checked)

    def as_state(self, name: str, state: State) -> State:
        """Return a read-only copy of a state.

        Args:
            name: Name of the state for error messages.
            state: Coordinates and rates, shape (n,) each.

        Raises:
            OutOfRange: If there is not one finite coordinate and one finite rate for each joint.
        """
        if len(state) != 2:
            raise OutOfRange(name, f"{len(state)} arrays", "two: coordinates and rates")
        coordinates, rates = state
        q = as_array(f"coordinates at the {name}", coordinates, ("n",))
        v = as_array(f"rates at the {name}", rates, ("n",))
        if q.shape != (self.n,) or v.shape != (self.n,):
            sizes = f"a state of {q.size} coordinates and {v.size} rates"
            raise OutOfRange(name, sizes, f"{self.n} of each: {', '.join(self.symbols)}")
        # Each state that a caller gives passes here. A sum is finite only if all its terms are, and
        # is one operation; only if it is not are they looked at one by one. (A sum of large finite
        # terms may be infinite, too; then all of them pass.)
        if not math.isfinite(q.sum() + v.sum()):
            for i, joint in enumerate(self.joints):
                number(f"{joint.symbol} at the {name}", float(q[i]), joint.unit)
                number(f"{joint.symbol}_dot at the {name}", float(v[i]), f"{joint.unit}/s")
        return State(read_only(q.copy()), read_only(v.copy()))

    def coordinates_text(self, q: np.ndarray) -> str:
        """Return coordinates with their symbols and units in words, for sentences."""
        pairs = zip(self.joints, q.tolist(), strict=True)
        return ", ".join(f"{joint.symbol} = {value:.6g} {joint.unit}" for joint, value in pairs)

    def has(self, *roles: str) -> bool:
        """Return whether there are joints in all of these roles."""
        present = {joint.role for joint in self.joints}
        return present.issuperset(roles)

    def role(self, role: str, user: str) -> int:
        """Return the index of the joint in a role among the coordinates.

        Args:
            role: One of `ROLES`.
            user: What needs the joint, to begin an error message with.

        Raises:
            MissingRole: If no joint has this role.
        """
        for i, joint in enumerate(self.joints):
            if joint.role == role:
                return i
        raise MissingRole(user, role, [joint.name for joint in self.joints])

    def tower(self, user: str) -> tuple[int, ...]:
        """Return the indices of slew, trolley, radial swing, tangential swing and hoist of a tower
        crane of five joints.

        Args:
            user: What needs a tower crane, to begin an error message with.

        Raises:
            MissingRole: If no joint has one of these roles.
            ModelError: If there are further joints, their order along the chain is another, or
                other joints than slew, trolley and hoist are driven.
        """
        indices = tuple(self.role(role, user) for role in ROLES)
        roles = [joint.role for joint in self.joints]
        further = [joint.name for joint in self.joints if not joint.role]
        if further:
            raise ModelError(
                f"{user} is made for a tower crane of five joints; this one also moves in "
                f"{', '.join(further)}."
            )
        if roles != list(ROLES):
            raise ModelError(
                f"{user} is made for {', '.join(ROLES)} in this order; this crane has "
                f"{', '.join(roles)}."
            )
        driven = [joint.role for joint in self.driven]
        if driven != ["slew", "trolley", "hoist"]:
            raise ModelError(
                f"{user} is made for drives of slew, trolley and hoist; in this one they move "
                f"{', '.join(driven)}."
            )
        return indices

    def columns(self, *, rope: bool = False, base: bool = False) -> dict[str, tuple[str, ...]]:
        """Return the names of the columns of a trajectory by quantity, with units.

        Args:
            rope: Whether the rope may go slack.
            base: Whether the base on which the crane stands moves.
        """
        units = dict(zip(self.symbols, self.units, strict=True))
        drives = [joint.symbol for joint in self.driven]
        return trajectory_columns(units, drives, self.points, rope=rope, base=base)

    @staticmethod
    def _indices(belongs: Sequence[bool]) -> np.ndarray:
        """Return the indices of the coordinates that belong to a group, read-only.

        Args:
            belongs: Whether each coordinate belongs to it, n booleans.
        """
        return read_only(np.flatnonzero(np.array(belongs, dtype=bool)))
