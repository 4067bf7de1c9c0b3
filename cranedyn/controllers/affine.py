"""The common form of controllers that are affine in the state, so that a closed loop can be compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from cranedyn.crane import DRIVES


@dataclass(frozen=True, eq=False)
class Affine:
    """command = feed_forward[k] - gain[k] (z - wanted[k]) + integral_gain ∫ (position wanted - position), with z = (coordinates, rates).

    Row k is for control instant k; beyond the end of an array its last row holds. The error at a control instant counts for one control
    period of the run. At the limit a drive integrates back only.

    Attributes:
        feed_forward: Shape (n, 3).
        gain: Shape (n, 3, 10).
        wanted: The motion that it is about, shape (m, 10).
        integral_gain: Of slew, trolley, hoist, per second, shape (3,).
        limit: Largest command with which the integrals grow, shape (3,).
        integral: What has been integrated before, shape (3,).
    """

    feed_forward: np.ndarray
    gain: np.ndarray
    wanted: np.ndarray
    integral_gain: np.ndarray
    limit: np.ndarray
    integral: np.ndarray


@runtime_checkable
class AffineController(Protocol):
    """A controller that can say itself in the common form."""

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """What it does at control instants [s], shape (n,), where a reference wants the drives at positions, shape (n, 3).

        None where it is not affine there.
        """


@runtime_checkable
class Remembering(Protocol):
    """An affine controller that integrates and goes on where it stopped."""

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Take over what was integrated, shape (3,), up to and with a control instant [s]."""


def form(controller: object, times: np.ndarray, positions: np.ndarray) -> Affine | None:
    """The common form of a controller, see `AffineController.affine`; None if it has none, or is a variant that answers calls otherwise."""
    answers = next((kind for kind in type(controller).__mro__ if "__call__" in vars(kind) or "affine" in vars(kind)), object)
    return controller.affine(times, positions) if isinstance(controller, AffineController) and "affine" in vars(answers) else None


def without_integral(feed_forward: np.ndarray, gain: np.ndarray, wanted: np.ndarray) -> Affine:
    """The common form of a controller that does not integrate."""
    return Affine(feed_forward, gain, wanted, np.zeros(3), np.full(3, np.inf), np.zeros(3))


def at_drives(positions: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Coordinates and rates, shape (n, 10), from those of the drives, shape (n, 3) each; zero for the swing."""
    wanted = np.zeros((len(positions), 10))
    wanted[:, DRIVES], wanted[:, 5 + DRIVES] = positions, rates
    return wanted
