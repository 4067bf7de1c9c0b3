"""Motions of the tower crane that observers and MPC are tried along."""

from __future__ import annotations

from functools import cache

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers import lqr
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Setpoint
from cranedyn.model.crane import Crane
from cranedyn.references import Motion, flat
from tests.helpers import G, crane

PERIOD = 5e-3
STILL = Setpoint(np.zeros(3), np.zeros(3), np.zeros(3))
REST = {"x": 10.0, "l": 15.0}


def at_rest(crane: Crane, **coordinates: float) -> Motion:
    """Return a motion that stands still, by default at `REST`."""
    still = np.zeros((1, crane.layout.n))
    q = crane.state(**(coordinates or REST)).q
    return Motion(PERIOD, q[None], still, still, crane.layout.drives)


@cache
def combined(crane: Crane, beyond: float = 0.0) -> Motion:
    """Return slew, trolley and hoist together, in 20 s, on a cable longer by a length [m]."""
    start = crane.state(x=10.0, l=15.0 + beyond)
    return flat(crane, start, crane.state(gamma=0.6, x=20.0, l=10.0 + beyond), 20.0)


@cache
def tracked() -> Tracking:
    """Return the LQR about the combined move, which remembers nothing."""
    return lqr(crane(), combined(crane()))


def residual(run: Trajectory) -> float:
    """Return the amplitude of the swing at the end [rad]."""
    return float(swing_amplitude(run.q[-1:, 2:4], run.v[-1:, 2:4], run.q[-1:, 4], G)[0])
