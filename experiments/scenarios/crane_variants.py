"""The cranes: each the tower crane with an argument more, or a xacro of its own."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits

OVERHEAD = XACRO.with_name("overhead_crane.urdf.xacro")
"""The xacro of the overhead crane."""

POINT: dict[str, Any] = dict.fromkeys(
    ("payload_inertia", "dummy_mass", "dummy_inertia", "damp_swing"), 0.0
)
"""A point load on a massless, frictionless rope, in either xacro."""


@dataclass(frozen=True)
class CraneVariant:
    """A crane that is not the tower crane of five joints.

    Attributes:
        name: Name in tables.
        values: Numbers of the xacro that make it.
        overhead: Whether the xacro is that of the overhead crane.
        rates: Largest rates of its drives [rad/s or m/s].
        accelerations: Largest accelerations of its drives [rad/s² or m/s²].
    """

    name: str
    values: dict[str, Any] = field(hash=False)
    overhead: bool = False
    rates: tuple[float, ...] = (0.1, 1.0, 0.5)
    accelerations: tuple[float, ...] = (0.05, 0.5, 0.3)

    def crane(self, **values: Any) -> Crane:
        """Return the crane with some more numbers changed."""
        return load_crane(OVERHEAD if self.overhead else None, **{**self.values, **values})

    @property
    def limits(self) -> Limits:
        """Limits of rates and accelerations of its drives."""
        return Limits(self.rates, self.accelerations)


HOOK = CraneVariant(
    "hook and slung load",
    {"hook_mass": 300.0, "payload_mass": 2000.0, "sling_length": 5.0, **POINT},
)
ROPE = CraneVariant("rope that stretches", {"rope_stiffness": 3e6})
TWIST = CraneVariant("tower that twists", {"tower_twist_stiffness": 2e7})
BEND = CraneVariant("tower that bends", {"tower_bend_stiffness": 1e8})
JIB = CraneVariant("jib that bends", {"jib_bend_stiffness": 4e7})
BRIDGE = CraneVariant(
    "overhead crane", {}, overhead=True, rates=(1.6, 0.8, 0.4), accelerations=(0.3, 0.3, 0.2)
)
CRANE_VARIANTS = (HOOK, ROPE, TWIST, BEND, JIB, BRIDGE)
"""All cranes of the catalogue."""


@cache
def variant_crane(variant: CraneVariant) -> Crane:
    """Return the crane of the catalogue, loaded once."""
    return variant.crane()


def moved(crane: Crane, **offsets: float) -> State:
    """Return the state of a crane at its start, with some joints moved.

    Args:
        crane: The crane.
        **offsets: Distance [rad or m] by which a joint is moved, by its symbol; or its rate
            [rad/s or m/s], by the symbol with "_dot".
    """
    q = crane.start.q.copy()
    v = crane.start.v.copy()
    for name, offset in offsets.items():
        symbol = name.removesuffix("_dot")
        if symbol == name:
            q[crane.layout.index(symbol)] += offset
        else:
            v[crane.layout.index(symbol)] += offset
    return State(q, v)


def rest_at(crane: Crane, **positions: float) -> State:
    """Return the crane hanging at rest with drives at other positions, by their symbols."""
    q = crane.start.q.copy()
    for symbol, position in positions.items():
        q[crane.layout.index(symbol)] = position
    return State(crane.hanging(q), 0.0 * q)


def at_start(crane: Crane, symbol: str) -> float:
    """Return where a joint stands at the start [m or rad]."""
    return float(crane.start.q[crane.layout.index(symbol)])


def rope_stiffness(crane: Crane) -> float:
    """Return EA of the rope of a crane that has one [N]."""
    assert crane.springs.rope is not None
    return float(crane.springs.rope.stiffness)
