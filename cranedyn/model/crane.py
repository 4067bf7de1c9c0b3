"""The crane: a Pinocchio model whose joints are known by name, split into driven and passive."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.arguments import checked
from cranedyn.arrays import shaped
from cranedyn.errors import UnknownName, number, within
from cranedyn.interfaces import COORDINATES, UNITS, State
from cranedyn.model.shown import ShownCrane

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], exact by definition (CGPM 1901)."""


DRIVES = np.array([0, 1, 4])
"""Where slew, trolley and hoist stand among the coordinates."""

PASSIVE = np.array([2, 3])
"""Where radial and tangential swing stand among the coordinates."""


_UPRIGHT = float(np.nextafter(np.pi / 2, 0.0))


class _Joint(NamedTuple):
    name: str
    kind: str
    axis: tuple[int, int, int]


JOINTS = (
    _Joint("yaw_joint", "revolute", (0, 0, 1)),
    _Joint("trolley_joint", "prismatic", (0, -1, 0)),
    _Joint("swing_radial_joint", "revolute", (1, 0, 0)),
    _Joint("swing_tangential_joint", "revolute", (0, 1, 0)),
    _Joint("hoist_joint", "prismatic", (0, 0, -1)),
)
"""The joints behind the coordinates: name, type, and axis in the world when every coordinate is zero."""


class _Scratch(threading.local):
    """Scratch memory of Pinocchio: whichever thread asks has its own, made when it first asks."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()

    def __reduce__(self) -> tuple[type[_Scratch], tuple[pin.Model]]:
        return type(self), (self.model,)


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Crane(ShownCrane):
    """A crane as loaded: parameters that do not change during a run, and that several threads may use at once.

    Attributes:
        written: What gives its plain URDF; ask for `urdf`.
        model: The Pinocchio model; joint i + 1 carries coordinate i.
        damping: Viscous damping of each joint [N m s/rad or N s/m], shape (5,). Pinocchio parses it but never applies it.
        lower, upper: Joint ranges [rad or m], shape (5,).
        effort_limit: Largest effort of the drives slew [N m], trolley [N], hoist [N], shape (3,).
        start: Where the URDF lets the drives start, hanging at rest.
    """

    written: Callable[[], str] = field(repr=False)
    model: pin.Model
    damping: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    start: State
    _scratch: _Scratch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Have scratch memory for each thread.

        Raises:
            OutOfRange: If an array has another shape.
        """
        for name, count in (("damping", 5), ("lower", 5), ("upper", 5), ("effort_limit", 3)):
            shaped(name, getattr(self, name), (count,))
        object.__setattr__(self, "_scratch", _Scratch(self.model))

    @property
    def data(self) -> pin.Data:
        """Scratch memory of Pinocchio for `cranedyn.dynamics.pinocchio`, that of the calling thread."""
        return self._scratch.data

    @cached_property
    def urdf(self) -> str:
        """The plain URDF of all that moves, weighs and can be seen; written when it is first asked for, since the looks take their time."""
        return self.written()

    @property
    def gravity(self) -> float:
        """Gravity [m/s²], acting along -Z of the world."""
        return float(-self.model.gravity.linear[2])

    @property
    def payload_mass(self) -> float:
        """Mass that hangs on the hoist joint [kg]."""
        return float(self.model.inertias[5].mass)

    @property
    def trolley_mass(self) -> float:
        """Mass that the trolley joint carries above the swing pivot [kg]."""
        return float(self.model.inertias[2].mass)

    @property
    def slewing_inertia(self) -> float:
        """Rotational inertia of the upper structure about the slew axis [kg m²], trolley and payload not counted."""
        return float(self.model.inertias[1].matrix()[5, 5])

    @property
    def payload_inertia(self) -> float:
        """Rotational inertia of the payload about its own X axis [kg m²]."""
        return float(self.model.inertias[5].inertia[0, 0])

    @property
    def dummy_inertia(self) -> tuple[float, float]:
        """Inertia of the links between the swing joints about the pivot: against radial and against tangential swing [kg m²]."""
        outer, inner = (self.model.inertias[i].matrix()[3:, 3:] for i in (3, 4))
        return float(outer[0, 0] + inner[0, 0]), float(inner[1, 1])

    def state(self, **values: float) -> State:
        """A state from named coordinates, at rest where nothing else is said.

        Args:
            values: Any of gamma, x, phi, theta, l [rad or m] and gamma_dot, x_dot, phi_dot, theta_dot, l_dot [per second].
                Coordinates left out are those of `start`, rates left out are zero.

        Raises:
            UnknownName: For a name that is none of these.
            OutOfRange: For a value outside the joint's range, a swing of 90° or more among them, or one that is not finite.
        """
        q, v = self.start.q.copy(), np.zeros(5)
        for name, value in values.items():
            coordinate = name.removesuffix("_dot")
            if coordinate not in COORDINATES:
                raise UnknownName("coordinate", name, [*COORDINATES, *(f"{c}_dot" for c in COORDINATES)])
            i = COORDINATES.index(coordinate)
            if name == coordinate:
                low, high = self.lower[i], self.upper[i]
                if i in PASSIVE:
                    low, high = max(low, -_UPRIGHT), min(high, _UPRIGHT)
                q[i] = within(f"{name} at the start", value, low, high, UNITS[i])
            else:
                v[i] = number(f"{name} at the start", value, f"{UNITS[i]}/s")
        return State(q, v)
