"""How much of their limits the drives use in a motion, and the shortest duration at which they use
them fully.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from cranedyn.checks import number
from cranedyn.dynamics.converters import RATES
from cranedyn.errors import OutOfRange
from cranedyn.model.crane import Crane
from cranedyn.references.motion import Motion, motion_efforts

_MIN_DURATION = 0.25
"""Shortest duration of a move that is tried [s]."""

_MAX_DURATION = 3600.0
"""Longest duration of a move that is tried [s]."""

_DURATION_TOLERANCE = 1e-3
"""Accuracy of a shortest duration [s]."""

_FARTHEST_EXCESS = 1e3
"""Excess over the limits that stands for any larger one, since a root finder needs finite
numbers."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the drives that a plan keeps besides the crane's own of effort and rate.

    A crane has no limit of acceleration of its own; its rate limits can be narrowed here, not
    widened.

    Attributes:
        rates: Largest rates of the drives [rad/s or m/s], shape (m,).
        accelerations: Largest accelerations of the drives [rad/s² or m/s²], shape (m,).
    """

    rates: Sequence[float]
    accelerations: Sequence[float]

    def __post_init__(self) -> None:
        """Check the numbers and make tuples of them."""
        rates = self._checked("rate", self.rates, "per s")
        accelerations = self._checked("acceleration", self.accelerations, "per s²")
        object.__setattr__(self, "rates", rates)
        object.__setattr__(self, "accelerations", accelerations)

    def _checked(self, kind: str, values: Sequence[float], unit: str) -> tuple[float, ...]:
        """Return limits of a kind if they are positive, as many as there are rates.

        Raises:
            OutOfRange: If they are not.
        """
        if np.ndim(values) != 1 or np.shape(values) != np.shape(self.rates):
            raise OutOfRange(f"{kind} limits", values, "one number for each drive", unit)
        return tuple(number(f"{kind} limit", value, unit, "> 0") for value in values)

    def for_crane(self, crane: Crane) -> Limits:
        """Return the limits with no rate above the crane's own.

        Raises:
            OutOfRange: If there is not one number for each drive of the crane.
        """
        layout = crane.layout
        rates = layout.for_drives("rate limit", self.rates, "/s", "> 0")
        accelerations = layout.for_drives("acceleration limit", self.accelerations, "/s²", "> 0")
        return Limits(np.minimum(rates, crane.rate_limit).tolist(), accelerations.tolist())


LARGE_CRANE = Limits((*RATES.values(),), (0.02, 0.4, 0.4))
"""Rates of a large tower crane, see `cranedyn.dynamics.converters.RATES`; accelerations ours."""


def use(crane: Crane, motion: Motion, limits: Limits) -> dict[str, float]:
    """Return the largest share of each limit that a motion uses, by the name of the limit; 1 is
    all of it.

    Raises:
        OutOfRange: If the motion is of another crane, there is not one limit for each drive, or a
            share is not a number: a maximum of shares would pass over it.
    """
    layout = crane.layout
    bounds = limits.for_crane(crane)
    motion.check_fits("motion", layout)
    largest_shares = {
        "rate": np.abs(motion.v[:, layout.drives]).max(axis=0) / bounds.rates,
        "acceleration": np.abs(motion.a[:, layout.drives]).max(axis=0) / bounds.accelerations,
        "effort": np.abs(motion_efforts(crane, motion)).max(axis=0) / crane.effort_limit,
    }
    shares = {}
    for kind, shares_of_drives in largest_shares.items():
        for joint, share in zip(layout.driven, shares_of_drives.tolist(), strict=True):
            name = f"{kind} of the {joint.role or joint.symbol}"
            if math.isnan(share):
                raise OutOfRange(name, share, "a number")
            shares[name] = share
    return shares


def fastest(crane: Crane, plan: Callable[[float], Motion], limits: Limits) -> float:
    """Return the shortest duration [s] at which a plan keeps the limits, to a thousandth of a
    second; a quarter of a second at least.

    Args:
        crane: The crane.
        plan: The motion for a duration [s].
        limits: The limits.

    Raises:
        OutOfRange: If no duration up to an hour keeps them.
    """

    def excess(duration: float) -> float:
        """Return by how much the most used limit is exceeded, negative if none is."""
        try:
            return max(use(crane, plan(duration), limits).values()) - 1.0
        except OutOfRange:
            return np.inf

    # The duration is doubled until it keeps the limits. The shortest one lies between the last two.
    low = _MIN_DURATION
    high = 2.0 * low
    if excess(low) <= 0.0:
        return low
    largest_excess = excess(high)
    while largest_excess > 0.0:
        low = high
        high = 2.0 * high
        if high > _MAX_DURATION:
            allowed = (
                f"such that some duration up to {_MAX_DURATION:g} s keeps them, not "
                f"{largest_excess:g} beyond"
            )
            raise OutOfRange("limits of the drives", limits, allowed)
        largest_excess = excess(high)
    root = scipy.optimize.brentq(
        lambda duration: min(excess(duration), _FARTHEST_EXCESS),
        low,
        high,
        xtol=_DURATION_TOLERANCE,
    )
    # The root is found within the tolerance: so much more is on the safe side of it.
    return float(root) + _DURATION_TOLERANCE
