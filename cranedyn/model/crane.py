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

from cranedyn.arguments import checked
from cranedyn.arrays import finite, shaped
from cranedyn.errors import ModelError, UnknownName, number, within
from cranedyn.interfaces import State
from cranedyn.model.layout import Layout
from cranedyn.model.shown import ShownCrane
from cranedyn.model.springs import Springs

STANDARD_GRAVITY = 9.80665
"""Standard gravity [m/s²], exact by definition (CGPM 1901)."""


_NEWTON, _BALANCED = 50, 1e-13

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


class _Scratch(threading.local):
    """Scratch memory of Pinocchio: whichever thread asks has its own, made when it first asks."""

    def __init__(self, model: pin.Model) -> None:
        self.model, self.data = model, model.createData()

    def __reduce__(self) -> tuple[type[_Scratch], tuple[pin.Model]]:
        return type(self), (self.model,)


@checked
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
        start: Where the URDF lets the drives start, all else hanging at rest.
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
            shaped(name, getattr(self, name), (count,))
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
        hangs = self.springs.any and not any(layout.symbols[i] in values for i in layout.passive)
        return State(self.hanging(q) if hangs else q, v)

    def hanging(self, q: np.ndarray) -> np.ndarray:
        """Coordinates at rest, shape (n,): the drives where q has them, the passive joints where
        gravity and springs balance, by Newton.

        Raises:
            OutOfRange: If q is not one finite number for each joint.
            ModelError: If there is no such place near q within the ranges.
        """
        free, q = self.layout.passive, finite("coordinates", q, (self.layout.n,)).copy()
        data = self.model.createData()
        for _ in range(_NEWTON):
            open_ = (pin.computeGeneralizedGravity(self.model, data, q) - self.springs.effort(q))[
                free
            ]
            slope = pin.computeGeneralizedGravityDerivatives(
                self.model, data, q
            ) + self.springs.tangent(q)
            step = np.linalg.lstsq(slope[np.ix_(free, free)], open_, rcond=None)[0]
            q[free] -= step
            if np.abs(step).max(initial=0.0) < _BALANCED:
                break
        if not (
            np.abs(step).max(initial=0.0) < 1e-9
            and (q >= self.lower).all()
            and (q <= self.upper).all()
        ):
            raise ModelError(
                "This crane does not hang at rest within the ranges of its joints near "
                f"{q.tolist()}."
            )
        return q
