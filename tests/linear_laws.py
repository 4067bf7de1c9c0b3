"""Linear controllers with states, on the usual crane."""

from __future__ import annotations

from typing import Any

import numpy as np

from cranedyn.controllers import linear_controller
from cranedyn.controllers.linear import LinearController
from cranedyn.interfaces import Drive
from cranedyn.model.signals import state_names
from tests.helpers import crane

PERIOD = 1e-2
"""Control period of these controllers [s]."""

CRANE = crane()
REST = CRANE.state(x=12.0, l=15.0)
"""Where they hold it."""

INTEGRATOR: dict[str, Any] = {
    "a": [[1.0]],
    "b": [[-PERIOD]],
    "c": [[4e3]],
    "d": [[-3e4]],
    "inputs": ["x"],
    "outputs": ["F_x"],
    "period": PERIOD,
}
"""A trolley with proportional and integral control."""


def integrating(gain: float = 4e3, **how: Any) -> LinearController:
    """A trolley with proportional and integral control; gain of the integral in N/(m s)."""
    return linear_controller(CRANE, **{"about": REST} | INTEGRATOR | {"c": [[gain]]} | how)


def filtered(drive: Drive = "effort", **how: Any) -> LinearController:
    """Gains that hold each drive, behind a low-pass of its position and a resonator of the swing:
    five states, of which each drive sees some.
    """
    scale = np.ones(3)
    if drive == "effort":
        scale = np.diag(CRANE.mass_matrix(REST.q))[CRANE.layout.drives]
    stiffness, damping = (1.0, 0.0) if drive == "velocity" else (4.0, 4.0)
    inputs = state_names(CRANE)
    drives = CRANE.layout.drives
    a = np.zeros((5, 5))
    b = np.zeros((5, 10))
    c = np.zeros((3, 5))
    d = np.zeros((3, 10))
    turn = 0.8 * PERIOD
    a[3:, 3:] = 0.995 * np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    b[3, CRANE.layout.index("phi")] = PERIOD
    c[1, 3] = -0.3 * scale[1]  # yields to the swing
    for i, joint in enumerate(drives):
        a[i, i] = 0.9
        b[i, joint] = 0.1
        c[i, i] = -0.5 * stiffness * scale[i]
        d[i, joint] = -0.5 * stiffness * scale[i]
        d[i, 5 + joint] = -damping * scale[i]
    how = {"about": REST, "inputs": inputs, "period": PERIOD, "drive": drive} | how
    return linear_controller(CRANE, a, b, c, d, **how)
