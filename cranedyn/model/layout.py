"""The joints of a crane by name: which of them a drive moves, which hang free, and which part each
plays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from cranedyn.checks import as_array, number, read_only
from cranedyn.errors import MissingRole, ModelError, OutOfRange, UnknownName
from cranedyn.interfaces import State

_COUNTS = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six"}


class Role(NamedTuple):
    """A part that a joint of a tower crane plays, and what it must be for it.

    Attributes:
        symbol: Of its coordinate.
        kind: "revolute" or "prismatic".
        axis: In the world when every coordinate is zero.
        joint: Name by which the joint is known to play this part if nothing else is said.
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
"""The parts of a tower crane in chain order. A joint of any other name has its own name as its
symbol."""


@dataclass(frozen=True)
class Joint:
    """A joint that moves, with one coordinate.

    Attributes:
        name: In the URDF.
        symbol: Of its coordinate, in tables, columns and code.
        unit: Of its coordinate, "rad" or "m".
        kind: "revolute" or "prismatic".
        axis: In the world when every coordinate is zero, three numbers.
        driven: Whether a drive moves it; else it is passive.
        role: Which part of a tower crane it plays, see `ROLES`; empty for none.
    """

    name: str
    symbol: str
    unit: str
    kind: str
    axis: tuple[float, float, float]
    driven: bool
    role: str = ""

    @property
    def effort_unit(self) -> str:
        """Unit of its generalized force, "N m" or "N"."""
        return "N m" if self.kind == "revolute" else "N"

    @property
    def effort_name(self) -> str:
        """Of its generalized force: torque T or force F, such as F_x."""
        return f"{'T' if self.kind == 'revolute' else 'F'}_{self.symbol}"

    @property
    def effort_column(self) -> str:
        """Name of the column of what acts, in a record."""
        return f"{self.effort_name}_{self.effort_unit.replace(' ', '')}"

    @property
    def columns(self) -> tuple[str, str]:
        """Names of the columns of its coordinate and of its rate, in a record."""
        return f"{self.symbol}_{self.unit}", f"{self.symbol}_dot_{self.unit}_s"

    @property
    def setpoint_column(self) -> str:
        """Name of the column of where its drive should be, in a record."""
        return f"{self.symbol}_setpoint_{self.unit}"


@dataclass(frozen=True)
class Layout:
    """What a crane is made of: n joints, m of them driven, and the points that forces act on.

    Attributes:
        joints: In the order of the coordinates, parents before children.
        points: Names of the points that matter, the payload first.
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
        """Where the drives stand among the coordinates, shape (m,)."""
        return self._where(lambda joint: joint.driven)

    @cached_property
    def passive(self) -> np.ndarray:
        """Where the passive joints stand among the coordinates, shape (n - m,)."""
        return self._where(lambda joint: not joint.driven)

    @cached_property
    def measured(self) -> np.ndarray:
        """Where positions and rates of the drives stand in z = (coordinates, rates), shape (2
        m,).
        """
        return np.concatenate([self.drives, self.n + self.drives])

    @cached_property
    def symbols(self) -> tuple[str, ...]:
        """Of the coordinates."""
        return tuple(joint.symbol for joint in self.joints)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Of the coordinates."""
        return tuple(joint.unit for joint in self.joints)

    @cached_property
    def driven(self) -> tuple[Joint, ...]:
        """The joints that drives move."""
        return tuple(joint for joint in self.joints if joint.driven)

    @cached_property
    def drives_in_words(self) -> str:
        """What is needed where one number for each drive is, for a sentence."""
        names = ", ".join(joint.role or joint.symbol for joint in self.driven)
        return f"{_COUNTS.get(self.m, self.m)} number{'s' if self.m > 1 else ''}: {names}"

    def index(self, symbol: str) -> int:
        """Where a coordinate stands.

        Raises:
            UnknownName: If there is none of that symbol.
        """
        if symbol not in self.symbols:
            raise UnknownName("coordinate", symbol, self.symbols)
        return self.symbols.index(symbol)

    def at(self, *symbols: str) -> list[int]:
        """Where some coordinates stand.

        Raises:
            UnknownName: If there is none of a symbol.
        """
        return [self.index(symbol) for symbol in symbols]

    def drive(self, symbol: str) -> int:
        """Where a drive stands among the drives.

        Raises:
            UnknownName: If there is none of that symbol.
        """
        symbols = [joint.symbol for joint in self.driven]
        if symbol not in symbols:
            raise UnknownName("drive", symbol, symbols)
        return symbols.index(symbol)

    def drive_of(self, role: str) -> int | None:
        """Where the drive in a role stands among the drives; None if there is none."""
        return next((i for i, joint in enumerate(self.driven) if joint.role == role), None)

    def along(self, drive: str) -> np.ndarray:
        """Unit vector of one drive, shape (m,).

        Raises:
            UnknownName: If there is none of that symbol.
        """
        return np.eye(self.m)[self.drive(drive)]

    def for_drives(
        self, what: str, values: Any, per: str | None = "", allowed: str = "any"
    ) -> np.ndarray:
        """One finite number for each drive, shape (m,).

        Args:
            what: What the numbers are, to begin a sentence with.
            values: The numbers.
            per: What follows the unit of the coordinate, for example "/s"; None where the numbers
                are efforts.
            allowed: As `cranedyn.checks.number`.

        Raises:
            OutOfRange: If there are not m numbers, or one is not allowed.
        """
        if np.shape(values) != (self.m,):
            raise OutOfRange(what, values, self.drives_in_words)
        units = [joint.effort_unit if per is None else joint.unit + per for joint in self.driven]
        each = zip(self.driven, values, units, strict=True)
        return np.array(
            [
                number(f"{what} of {joint.symbol}", value, unit, allowed)
                for joint, value, unit in each
            ]
        )

    def as_state(self, name: str, state: State) -> State:
        """Return a read-only copy of a state of such a crane.

        Args:
            name: Name of the state for the error message.
            state: Coordinates and rates, shape (n,) each.

        Raises:
            OutOfRange: If there is not one finite coordinate and one finite rate for each joint.
        """
        q, v = (
            as_array(f"{kind} at the {name}", part, ("n",))
            for kind, part in zip(("coordinates", "rates"), state, strict=True)
        )
        if q.shape != (self.n,) or v.shape != (self.n,):
            given = f"a state of {q.size} coordinates and {v.size} rates"
            raise OutOfRange(name, given, f"{self.n} of each: {', '.join(self.symbols)}")
        for joint, position, rate in zip(self.joints, q.tolist(), v.tolist(), strict=True):
            number(f"{joint.symbol} at the {name}", position, joint.unit)
            number(f"{joint.symbol}_dot at the {name}", rate, f"{joint.unit}/s")
        return State(read_only(q.copy()), read_only(v.copy()))

    def has(self, *roles: str) -> bool:
        """Whether there are joints that play all of these parts."""
        return {*roles} <= {joint.role for joint in self.joints}

    def role(self, role: str, user: str) -> int:
        """Where the joint that plays a part stands among the coordinates.

        Args:
            role: One of `ROLES`.
            user: What needs it, to begin a sentence with.

        Raises:
            MissingRole: If no joint plays it.
        """
        for i, joint in enumerate(self.joints):
            if joint.role == role:
                return i
        raise MissingRole(user, role, [joint.name for joint in self.joints])

    def tower(self, user: str) -> tuple[int, ...]:
        """Where slew, trolley, radial swing, tangential swing and hoist of a tower crane stand
        among the coordinates.

        Args:
            user: What is made for a tower crane, to begin a sentence with.

        Raises:
            MissingRole: If no joint plays one of these parts.
            ModelError: If there are joints that play none of them, these follow each other in
                another order, or drives move others.
        """
        found = tuple(self.role(role, user) for role in ROLES)
        if further := [joint.name for joint in self.joints if not joint.role]:
            raise ModelError(
                f"{user} is made for a tower crane of five joints; this one also moves in "
                f"{', '.join(further)}."
            )
        if found != tuple(range(len(ROLES))):
            shown = ", ".join(joint.role for joint in self.joints)
            raise ModelError(
                f"{user} is made for {', '.join(ROLES)} in this order; this crane has {shown}."
            )
        if (driven := [joint.role for joint in self.driven]) != ["slew", "trolley", "hoist"]:
            raise ModelError(
                f"{user} is made for drives of slew, trolley and hoist; in this one they move "
                f"{', '.join(driven)}."
            )
        return found

    def columns(self) -> dict[str, tuple[str, ...]]:
        """Names of the columns of a record by quantity, with units."""
        q, v = zip(*(joint.columns for joint in self.joints), strict=True)
        return {
            "t": ("t_s",),
            "q": q,
            "v": v,
            "setpoint": tuple(joint.setpoint_column for joint in self.driven),
            "command": tuple(
                f"{joint.effort_name}_command_{joint.effort_unit.replace(' ', '')}"
                for joint in self.driven
            ),
            "effort": tuple(joint.effort_column for joint in self.driven),
            "energy": ("energy_J",),
            "work": tuple(f"W_{joint.symbol}_J" for joint in self.driven),
            "dissipated": ("dissipated_J",),
            "force": tuple(f"{point}_force_{axis}_N" for point in self.points for axis in "xyz"),
            "outside": ("W_force_J", "W_buffers_J"),
            "valid": ("valid",),
        }

    def _where(self, condition: Callable[[Joint], bool]) -> np.ndarray:
        found = np.array([i for i, joint in enumerate(self.joints) if condition(joint)], dtype=int)
        found.flags.writeable = False
        return found


def symbol_of(name: str, role: str) -> str:
    """The symbol of a joint's coordinate: that of its role, else its name without the ending
    "_joint".
    """
    return ROLES[role].symbol if role else name.removesuffix("_joint")


def roles_of(names: Iterable[str], given: Mapping[str, str] | None) -> dict[str, str]:
    """Which part each joint plays, by the name of the joint.

    Args:
        names: The joints that move.
        given: Names of joints by role; None for those that the names themselves say.

    Raises:
        UnknownName: If there is no such role or no such joint.
        ModelError: If one joint is to play two parts.
    """
    there = list(names)
    if given is None:
        return {role.joint: part for part, role in ROLES.items() if role.joint in there}
    found: dict[str, str] = {}
    for part, joint in given.items():
        if part not in ROLES:
            raise UnknownName("role", part, ROLES)
        if joint not in there:
            raise UnknownName("moving joint", joint, there)
        if joint in found:
            raise ModelError(
                f"The joint {joint} is given two roles, {found[joint]} and {part}; allowed is one."
            )
        found[joint] = part
    return found
