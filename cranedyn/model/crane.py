"""The crane: a Pinocchio model, the layout of its joints, and the numbers that Pinocchio does not
act on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.checks import as_array, finite, number, within
from cranedyn.errors import Misshapen, ModelError, UnknownName
from cranedyn.interfaces import State
from cranedyn.model.layout import Layout
from cranedyn.model.shown import ShownCrane
from cranedyn.model.springs import Springs

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], exact by definition (CGPM 1901)."""


_NEWTON, _BALANCED, _PLUMB = 50, 1e-13, 1e-12

_UPRIGHT = float(np.nextafter(np.pi / 2, 0.0))


class Point(NamedTuple):
    """A point of a crane that matters.

    Attributes:
        name: What it is called in columns.
        body: The joint that carries it, by its place among the coordinates.
        lever: Where it is in the frame of that joint [m], shape (3,).
    """

    name: str
    body: int
    lever: np.ndarray


class Rest(NamedTuple):
    """Where the swing joints of a crane hang at rest: `angle + slope @ drives`.

    Both are exactly zero for a load that hangs plumb when its swing joints are at zero.

    Attributes:
        angle: Shape (swings,) [rad].
        slope: By the coordinates of the drives, shape (swings, m) [rad per rad or m].
        hangs: Whether the passive joints have a stable rest near the start; false for a mechanism
            that is no crane, such as a robot with free joints. Angle and slope are zero then.
    """

    angle: np.ndarray
    slope: np.ndarray
    hangs: bool


class _Scratch(threading.local):
    """Scratch memory of Pinocchio: whichever thread asks has its own, made when it first asks."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()

    def __reduce__(self) -> tuple[type[_Scratch], tuple[pin.Model]]:
        return type(self), (self.model,)


@dataclass(frozen=True, eq=False, repr=False)
class Crane(ShownCrane):
    """A crane as loaded, with n joints and m drives: parameters that do not change during a run,
    and that several threads may use at once.

    Attributes:
        layout: Its joints by name.
        written: What gives its plain URDF; ask for `urdf`.
        model: The Pinocchio model; joint i + 1 carries coordinate i.
        damping: Viscous damping of each joint [N m s/rad or N s/m], shape (n,). Pinocchio parses it
            but never applies it.
        springs: What is elastic in it.
        lower, upper: Joint ranges [rad or m], shape (n,).
        effort_limit: Largest effort of the drives [N m or N], shape (m,).
        start: Where the URDF lets the drives start, all else hanging at rest; a mechanism whose
            passive joints do not hang starts with them at zero.
        points: Those on which forces from outside act, the payload first.
        record: All that `cranedyn.model.load.load_crane` needs to make it again, as it is written
            beside a run.
    """

    layout: Layout
    written: Callable[[], str] = field(repr=False)
    model: pin.Model
    damping: np.ndarray
    springs: Springs
    lower: np.ndarray
    upper: np.ndarray
    effort_limit: np.ndarray
    start: State
    points: tuple[Point, ...]
    record: Mapping[str, Any] = field(repr=False)
    _scratch: _Scratch = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Have scratch memory for each thread.

        Raises:
            OutOfRange: If an array has another shape.
        """
        for name, count in (
            ("damping", self.layout.n),
            ("lower", self.layout.n),
            ("upper", self.layout.n),
            ("effort_limit", len(self.layout.drives)),
        ):
            object.__setattr__(self, name, as_array(name, getattr(self, name), (count,)))
        object.__setattr__(self, "_scratch", _Scratch(self.model))

    @property
    def data(self) -> pin.Data:
        """Scratch memory of Pinocchio for `cranedyn.dynamics`, of the thread that asks."""
        return self._scratch.data

    @cached_property
    def urdf(self) -> str:
        """The plain URDF of all that moves, weighs and can be seen; written when it is first asked
        for, since the looks take their time.
        """
        return self.written()

    @property
    def gravity(self) -> float:
        """Gravity [m/s²], acting along -Z of the world."""
        return float(-self.model.gravity.linear[2])

    @property
    def rate_limit(self) -> np.ndarray:
        """Largest rates of the drives [rad/s or m/s], shape (m,); inf where the URDF gives none."""
        own = self.model.velocityLimit[self.layout.drives]
        return np.where(own > 0.0, own, np.inf)

    @property
    def payload(self) -> Point:
        """Centre of mass of the payload."""
        return self.points[0]

    @property
    def payload_mass(self) -> float:
        """Mass of the last body of the chain [kg]."""
        return float(self._inertia(self.payload.body).mass)

    @property
    def payload_inertia(self) -> np.ndarray:
        """Rotational inertia of the payload about its centre of mass, in the frame of its joint [kg
        m²], shape (3, 3).
        """
        return self._inertia(self.payload.body).inertia.copy()

    @property
    def trolley_mass(self) -> float:
        """Mass that the trolley joint carries above the swing pivot [kg]."""
        return float(self._inertia(self.layout.role("trolley", "The mass of the trolley")).mass)

    @property
    def slewing_inertia(self) -> float:
        """Rotational inertia of the upper structure about the slew axis [kg m²], trolley and
        payload not counted.
        """
        return float(self._inertia(self.layout.role("slew", "The slewing inertia")).matrix()[5, 5])

    @property
    def dummy_inertia(self) -> tuple[float, float]:
        """Inertia of the links between the swing joints about the pivot: against radial and against
        tangential swing [kg m²].
        """
        joints = (
            self.layout.role(role, "The inertia of the links between the swing joints")
            for role in ("radial_swing", "tangential_swing")
        )
        outer, inner = (self._inertia(joint).matrix()[3:, 3:] for joint in joints)
        return float(outer[0, 0] + inner[0, 0]), float(inner[1, 1])

    def _inertia(self, joint: int) -> pin.Inertia:
        return self.model.inertias[joint + 1]

    @cached_property
    def swings(self) -> np.ndarray:
        """Which joints are swings, by their places among the coordinates: passive, turning, and
        without a spring.
        """
        joints = enumerate(self.layout.joints)
        return np.array(
            [
                i
                for i, j in joints
                if not j.driven and j.kind == "revolute" and self.springs.stiffness[i] == 0.0
            ],
            dtype=int,
        )

    def swing_angles(self, q: np.ndarray) -> np.ndarray:
        """Return the angles of the swing joints from where they hang [rad], shape (..., swings), of
        coordinates of shape (..., n).

        Raises:
            OutOfRange: If q is not n numbers in each row.
        """
        q = np.asarray(q, dtype=float)
        if q.shape[-1:] != (self.layout.n,):
            shape = f"one of shape (..., {self.layout.n})"
            raise Misshapen("coordinates", f"an array of shape {q.shape}", shape)
        drives = q[..., self.layout.drives]
        return q[..., self.swings] - self.rest.angle - drives @ self.rest.slope.T

    def state(self, **values: float) -> State:
        """A state from named coordinates, at rest where nothing else is said.

        Args:
            values: Any of the symbols of `layout` [rad or m], for a tower crane gamma, x, phi,
                theta, l, and the same with the ending "_dot" [per second]. Coordinates left out are
                those of `start`, rates left out are zero.

        Raises:
            UnknownName: For a name that is none of these.
            OutOfRange: For a value outside the joint's range, a swing of 90° or more among them, or
                one that is not finite.
        """
        layout = self.layout
        q, v = self.start.q.copy(), np.zeros(layout.n)
        for name, value in values.items():
            symbol = name.removesuffix("_dot")
            if symbol not in layout.symbols:
                raise UnknownName(
                    "coordinate", name, [*layout.symbols, *(f"{c}_dot" for c in layout.symbols)]
                )
            i = layout.index(symbol)
            unit = layout.units[i]
            if name == symbol:
                low, high = self.lower[i], self.upper[i]
                if i in self.swings:
                    low, high = max(low, -_UPRIGHT), min(high, _UPRIGHT)
                q[i] = within(f"{name} at the start", value, low, high, unit)
            else:
                v[i] = number(f"{name} at the start", value, f"{unit}/s")
        swinging = any(layout.symbols[i] in values for i in layout.passive)
        return State(q if swinging else self.resting(q), v)

    def resting(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinates of `hanging`, or q itself, shape (n,), for a mechanism whose
        passive joints do not hang, such as a robot with free joints.
        """
        return self.hanging(q) if self.rest.hangs else q

    def hanging(self, q: np.ndarray) -> np.ndarray:
        """Return the coordinates at rest, shape (n,): the drives where q has them, the passive
        joints where gravity and springs balance, by Newton's method from where q has these.

        Raises:
            OutOfRange: If q is not one finite number for each joint.
            ModelError: If there is no such place near q within the ranges.
        """
        free, q = self.layout.passive, finite("coordinates", q, (self.layout.n,)).copy()
        # What rounding leaves of the torques of a load that hangs plumb.
        rounding = 1e-15 * self.gravity * sum(inertia.mass for inertia in self.model.inertias)
        for _ in range(_NEWTON):
            weight = pin.computeGeneralizedGravity(self.model, self.data, q)
            torque = (weight - self.springs.effort(q))[free]
            if np.abs(torque).max(initial=0.0) <= rounding:
                break
            # Down the energy also where it curves the other way, half a radian or metre at most.
            step = _compliance(self._stiffness(q)[np.ix_(free, free)]) @ torque
            largest = float(np.abs(step).max())
            q[free] -= step * min(1.0, 0.5 / max(largest, _BALANCED))
            if largest < _BALANCED:
                break
        else:
            q[free] = np.nan  # it has not settled
        if not ((q >= self.lower) & (q <= self.upper))[free].all():
            raise ModelError(
                "This crane does not hang at rest within the ranges of its joints near "
                f"{q.tolist()}."
            )
        return q

    def _stiffness(self, q: np.ndarray) -> np.ndarray:
        """Second derivatives of the energy of gravity and springs, shape (n, n)."""
        weight = pin.computeGeneralizedGravityDerivatives(self.model, self.data, q)
        return weight + self.springs.tangent(q)

    @cached_property
    def rest(self) -> Rest:
        """Where the swing joints hang, to first order in the places of the drives about `start`."""
        free, drives = self.layout.passive, self.layout.drives
        none = Rest(np.zeros(len(self.swings)), np.zeros((len(self.swings), len(drives))), False)
        try:
            hanging = self.hanging(self.start.q)
        except ModelError:
            return none
        stiffness = self._stiffness(hanging)
        own = stiffness[np.ix_(free, free)]
        curvature = np.linalg.eigvalsh(own)
        if curvature.min(initial=0.0) < -1e-9 * np.abs(curvature).max(initial=0.0):
            return none  # it would fall
        by_drives = -_compliance(own) @ stiffness[np.ix_(free, drives)]
        slope = by_drives[np.isin(free, self.swings)]
        slope[np.abs(slope) < _PLUMB] = 0.0
        angle = hanging[self.swings] - slope @ hanging[drives]
        angle[np.abs(angle) < _PLUMB] = 0.0
        return Rest(angle, slope, True)


def _compliance(stiffness: np.ndarray) -> np.ndarray:
    """Return the inverse of a symmetric stiffness with all its eigenvalues taken as positive, and
    as infinite where nothing pulls, as about a vertical axis.
    """
    values, vectors = np.linalg.eigh(stiffness)
    size = np.abs(values)
    pulls = size > max(1e-12 * size.max(initial=0.0), np.finfo(float).tiny)
    return (vectors[:, pulls] / size[pulls]) @ vectors[:, pulls].T
