"""What a reference says."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cranedyn.arrays import shaped
from cranedyn.errors import Misshapen, UnknownName


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


def tabulated(reference: Reference, times: np.ndarray) -> Wanted:
    """What a reference wants at many times [s], shape (n, 3) each; by its own `at` if it has one, which takes all at once.

    Raises:
        Misshapen: If that answers with anything else.
    """
    at_once = getattr(reference, "at", None)
    if at_once is not None:
        return _whole(at_once(times), len(times))
    rows = [reference(t) for t in times.tolist()]
    return Wanted(*(np.array(column, dtype=float) for column in zip(*rows, strict=True)))


def _whole(answer: object, rows: int) -> Wanted:
    if not isinstance(answer, Wanted):
        raise Misshapen("what the reference wants at many times", type(answer).__name__, "a Wanted: position, velocity, acceleration")
    parts = zip(Wanted._fields, answer, strict=True)
    return Wanted(*(shaped(f"{name} that the reference wants at {rows} times", part, (rows, 3)) for name, part in parts))


class Tabulating(ABC):
    """A reference that is written down for many times at once."""

    @abstractmethod
    def at(self, times: np.ndarray) -> Wanted:
        """What is wanted at many times [s], shape (n, 3) each."""

    def __call__(self, t: float) -> Wanted:
        """What is wanted at a time [s]."""
        return Wanted(*(part[0] for part in self.at(np.array([t]))))


_DRIVES = ("gamma", "x", "l")


def along(drive: str) -> np.ndarray:
    """Unit vector of one drive among slew "gamma", trolley "x" and hoist "l", shape (3,).

    Raises:
        UnknownName: For another name.
    """
    if drive not in _DRIVES:
        raise UnknownName("drive", drive, _DRIVES)
    return np.eye(3)[_DRIVES.index(drive)]
