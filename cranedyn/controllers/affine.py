"""The common form of controllers that are affine in the state, so that a closed loop can be
compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, cast, runtime_checkable

import numpy as np

from cranedyn.checks import as_array, read_only
from cranedyn.errors import Misshapen
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Affine:
    """command = feed_forward[k] - gain[k] (z - setpoint[k]) + integral_gain ∫ (target - position),
    with z = (coordinates, rates).

    Row k is for control instant k; beyond the end of an array its last row holds. The error at a
    control instant counts for one control period of the run. At the limit a drive integrates back
    only.

    Attributes:
        feed_forward: Shape (rows, m), of as many rows as the controller was asked for at most.
        gain: Shape (rows, m, 2 n).
        setpoint: The motion that it is about, shape (rows, 2 n), of as many rows as it likes.
        target: Where the integrals take the drives, shape (rows, m), of as many rows as it likes.
        integral_gain: Of the drives, per second, shape (m,).
        limit: Largest command with which the integrals grow, shape (m,).
        integral: What has been integrated before, shape (m,).
    """

    feed_forward: np.ndarray
    gain: np.ndarray
    setpoint: np.ndarray
    target: np.ndarray
    integral_gain: np.ndarray
    limit: np.ndarray
    integral: np.ndarray

    def lacking(self) -> str:
        """The first part with a number that is not finite, empty if there is none; a limit may be
        infinite.
        """
        names = ("feed_forward", "gain", "setpoint", "target", "integral_gain", "integral")
        return next((name for name in names if not np.isfinite(getattr(self, name)).all()), "")

    def fitting(self, whose: str, instants: int, drives: int, width: int) -> Affine:
        """The same, if it is made of arrays as it should be, for so many control instants, drives,
        and coordinates and rates together.

        Raises:
            Misshapen: If it is not: which of them, of whose form; or if a limit is no number.
        """

        def part(name: str, *shape: int | str) -> np.ndarray:
            found = as_array(f"{name} in the common form of {whose}", getattr(self, name), shape)
            if isinstance(shape[0], str) and not 0 < len(found) <= instants:
                raise Misshapen(
                    f"{name} in the common form of {whose}",
                    f"an array of {len(found)} rows",
                    f"one of 1 to {instants}",
                )
            return found

        feed_forward, setpoint = (
            part("feed_forward", "rows", drives),
            part("setpoint", "rows", width),
        )
        gain = part("gain", len(feed_forward), drives, width)
        limit = part("limit", drives)
        if np.isnan(limit).any():
            raise Misshapen(
                f"limit in the common form of {whose}",
                "an array that holds nan",
                "numbers, inf for none",
            )
        return Affine(
            feed_forward,
            gain,
            setpoint,
            part("target", "rows", drives),
            part("integral_gain", drives),
            limit,
            part("integral", drives),
        )


@runtime_checkable
class AffineController(Protocol):
    """A controller that can say itself in the common form."""

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """What it does at control instants [s], shape (n,), the setpoint of the drives at
        positions, shape (rows, m).

        None where it is not affine there.
        """


@runtime_checkable
class Remembering(Protocol):
    """An affine controller that integrates and goes on where it stopped."""

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Take over what was integrated, shape (m,), up to and with a control instant [s]."""


def form(controller: object, times: np.ndarray, positions: np.ndarray, width: int) -> Affine | None:
    """The common form of a controller, see `AffineController.affine`; None if it has none, or is a
    variant that answers calls otherwise.

    Args:
        controller: The controller.
        times: Control instants [s].
        positions: Setpoints of the drives there, shape (rows, m).
        width: Number of coordinates and rates together, 2 n.

    Raises:
        Misshapen: If it is not made of arrays as it should be.
    """
    answers = next(
        (
            kind
            for kind in type(controller).__mro__
            if "__call__" in vars(kind) or "affine" in vars(kind)
        ),
        object,
    )
    if not callable(vars(answers).get("affine")):
        return None
    answer, whose = (
        cast(AffineController, controller).affine(read_only(times), read_only(positions)),
        type(controller).__name__,
    )
    if answer is not None and not isinstance(answer, Affine):
        raise Misshapen(
            f"the common form of {whose}",
            type(answer).__name__,
            "an Affine, or None where it is not affine",
        )
    return None if answer is None else answer.fitting(whose, len(times), positions.shape[1], width)


def without_integral(feed_forward: np.ndarray, gain: np.ndarray, setpoint: np.ndarray) -> Affine:
    """The common form of a controller that does not integrate."""
    none = np.zeros(feed_forward.shape[1])
    most = np.full_like(none, np.inf)
    return Affine(feed_forward, gain, setpoint, none[None], none, most, none)


def at_drives(crane: Crane, positions: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Coordinates and rates, shape (rows, 2 n), from those of the drives, shape (rows, m) each;
    zero for the passive joints.
    """
    layout = crane.layout
    setpoint = np.zeros((len(positions), 2 * layout.n))
    setpoint[:, layout.drives], setpoint[:, layout.n + layout.drives] = positions, rates
    return setpoint
