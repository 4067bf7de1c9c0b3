"""Accelerations that take motion-controlled drives along a reference."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cranedyn.crane import DRIVES, State
from cranedyn.references import Reference, Wanted


def follow(reference: Reference, control_period: float = 5e-3) -> Callable[[float, State, Wanted], np.ndarray]:
    """Reach the reference's velocity at every control instant; for `simulate(..., drive="motion")`.

    Args:
        reference: The reference to follow, looked up one control period ahead.
        control_period: Time between control instants [s], the same as in `simulate`.
    """

    def controller(t: float, state: State, wanted: Wanted) -> np.ndarray:
        return (reference(t + control_period).velocity - state.v[DRIVES]) / control_period

    return controller
