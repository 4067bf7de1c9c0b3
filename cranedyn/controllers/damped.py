"""Velocity commands with damping of the swing: the drives yield to the load."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cranedyn.arguments import checked
from cranedyn.crane import DRIVES, Crane, State
from cranedyn.errors import number
from cranedyn.references import Reference, Wanted
from cranedyn.references.limits import Limits


@checked
def damped(
    crane: Crane,
    reference: Reference,
    *,
    ratio: float = 0.2,
    recovery: float = 0.0,
    limits: Limits,
    control_period: float = 5e-3,
) -> Callable[[float, State, Wanted], np.ndarray]:
    """Reach the reference's velocity less what damps the swing, for `simulate(..., drive="motion")`.

    With a pivot that moves at its commanded velocity less 2 ζ ω l φ the small swing obeys φ̈ + 2 ζ ω φ̇ + ω² φ = ẍ/l, ω² = g/l. The
    position drifts by the integral of the correction, unless it is taken back.

    Args:
        crane: The crane.
        reference: Its velocity is the command, looked up one control period ahead.
        ratio: ζ, the share of critical damping that the swing gets.
        recovery: Share of the distance from the reference's position that is taken back per second [1/s].
        limits: What the drives can do; the command is kept within.
        control_period: Time between control instants [s], the same as in `simulate`.

    Raises:
        OutOfRange: If the ratio is not between 0 and 1, or the recovery negative.
    """
    zeta = number("damping ratio", ratio, "", "0 to 1")
    pull = number("recovery", recovery, "1/s", ">= 0")
    number("control_period", control_period, "s", "> 0")
    fastest, most = np.asarray(limits.rates), np.asarray(limits.accelerations)

    def controller(t: float, state: State, wanted: Wanted) -> np.ndarray:
        _, x, phi, theta, length = state.q
        yielding = 2.0 * zeta * np.sqrt(crane.gravity * length) * np.array([theta / x, phi, 0.0])
        back = pull * (wanted.position - state.q[DRIVES])
        velocity = np.clip(reference(t + control_period).velocity + back - yielding, -fastest, fastest)
        return np.clip((velocity - state.v[DRIVES]) / control_period, -most, most)

    return controller
