"""What a reference says."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cranedyn.errors import UnknownName


class Wanted(NamedTuple):
    """Where slew, trolley and hoist should be and how they should move.

    Attributes:
        position: Slew [rad], trolley radius [m], cable length [m], shape (3,).
        velocity: Their rates, shape (3,).
        acceleration: Their accelerations, shape (3,).
    """

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


Reference = Callable[[float], Wanted]
"""From time [s] to what is wanted then."""

def positions(reference: Reference, times: np.ndarray) -> np.ndarray:
    """Where a reference wants slew, trolley and hoist at times [s], shape (n, 3); its own `positions` does it at once if it has one."""
    at_once = getattr(reference, "positions", None)
    return np.array([reference(t).position for t in times.tolist()]) if at_once is None else at_once(times)


_DRIVES = ("gamma", "x", "l")


def along(drive: str) -> np.ndarray:
    """Unit vector of one drive among slew "gamma", trolley "x" and hoist "l", shape (3,).

    Raises:
        UnknownName: For another name.
    """
    if drive not in _DRIVES:
        raise UnknownName("drive", drive, _DRIVES)
    return np.eye(3)[_DRIVES.index(drive)]
