"""Small sites that the tests of planning share, and what was planned on them, once."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.lifts.planning.certificate import Certificate, certify
from cranedyn.lifts.planning.clearance import Clearance
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.lift import Lift, plan_lift
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.solids import box
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits

LIMITS = Limits((0.0838, 1.583, 1.0), (0.02, 0.4, 0.4))
RATES = np.array(LIMITS.rates)
HEIGHT = 28.0


@cache
def crane() -> Crane:
    return load_crane()


def corners(*size: float) -> np.ndarray:
    signs = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return np.array(signs) * np.array(size) / 2.0


LOAD = corners(1.0, 1.0, 1.0)


def site(*solids: Any, **changes: Any) -> Site:
    """A lift of a cubic metre along the +X side of the crane, from y = -12 to y = 12 m."""
    given = {
        "load": LOAD,
        "start": np.array([6.0, -12.0, 4.0]),
        "goal": np.array([6.0, 12.0, 4.0]),
        **changes,
    }
    return Site("test", solids, **given)


WALL = box("wall", (14.0, 0.0), (14.0, 1.0, 8.0), 0.0)
"""Across the way, over which the load has to go."""


@cache
def clearance(*solids: Any, **changes: Any) -> TowerClearance:
    return TowerClearance(crane(), site(*solids, **changes))


def load_corners(asked: Clearance, q: np.ndarray) -> np.ndarray:
    """Where Pinocchio has the corners of the load, in the frame of the crane [m]."""
    data = crane().model.createData()
    pin.forwardKinematics(crane().model, data, q)
    return asked.bodies.load @ data.oMi[5].rotation.T + data.oMi[5].translation


@cache
def lift() -> Lift:
    return plan_lift(site(WALL), LIMITS, crane=crane())


@cache
def certificate() -> Certificate:
    return certify(lift())


def with_wall(by: float) -> Clearance:
    """The site of the lift with its wall higher by so much [m]."""
    return clearance_of(crane(), site(box("wall", (14.0, 0.0), (14.0, 1.0, 8.0 + by), 0.0)))
