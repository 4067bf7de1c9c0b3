"""The cranes of the matrix."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from tests.helpers import ROOT

EXAMPLES = ROOT / "examples"
FOREIGN = EXAMPLES / "cranes"


def _gantry() -> Crane:
    return load_crane(FOREIGN / "gantry.urdf", driven=["gantry_joint", "crab_joint", "rope_joint"])


def _wall() -> Crane:
    return load_crane(EXAMPLES / "wall_crane.urdf", driven=["bracket", "carriage", "winch"])


def _jib() -> Crane:
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    return load_crane(FOREIGN / "jib_crane.xml")


CRANES: dict[str, Callable[[], Crane]] = {
    "tower": load_crane,
    "hook": lambda: load_crane(hook_mass=300.0, payload_mass=2000.0, sling_length=5.0),
    "elastic rope": lambda: load_crane(rope_stiffness=3e6, rope_damping=1e4),
    "two falls": lambda: load_crane(fall_spacing=1.0),
    "heavy rope": lambda: load_crane(rope_mass=1.3, falls=4, payload_inertia=0.0),
    "luffing": lambda: load_crane(XACRO.with_name("luffing_crane.urdf.xacro")),
    "overhead": lambda: load_crane(XACRO.with_name("overhead_crane.urdf.xacro")),
    "mobile": lambda: load_crane(XACRO.with_name("mobile_crane.urdf.xacro")),
    "wall": _wall,
    "INTECO": lambda: load_crane(machine="inteco_3dcrane"),
    "gantry": _gantry,
    "knuckle boom": lambda: load_crane(FOREIGN / "knuckle_boom.urdf"),
    "portal": lambda: load_crane(EXAMPLES / "portal_crane.urdf"),
    "MJCF": _jib,
}
"""How each crane is loaded, by the name that the page has for it."""


@cache
def crane_named(name: str) -> Crane:
    """Return a crane, loaded once."""
    return CRANES[name]()
