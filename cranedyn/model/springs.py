"""Springs in the joints: what they exert and store, on any kind of number."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np


class Rope(NamedTuple):
    """A rope that stretches: its stiffness is EA/l over the present cable length l, so that its
    strain energy is EA s²/(2 l).

    Attributes:
        stretch: The passive joint that is its stretch s, by its place among the coordinates.
        length: The joint that is the cable length l, likewise.
        stiffness: EA, Young's modulus times the cross-section [N].
    """

    stretch: int
    length: int
    stiffness: Any


@dataclass(frozen=True, eq=False)
class Springs:
    """A linear spring in each joint, and a rope that stretches.

    Attributes:
        stiffness: Of each joint [N m/rad or N/m], shape (n,); 0 for none.
        rest: Where it is at rest [rad or m], shape (n,).
        rope: The rope; None if it does not stretch.
    """

    stiffness: np.ndarray
    rest: np.ndarray
    rope: Rope | None = None

    @cached_property
    def any(self) -> bool:
        """Whether there is a spring at all."""
        return self.rope is not None or bool(np.any(self.stiffness != 0.0))

    def effort(self, q: np.ndarray) -> np.ndarray:
        """What they exert on the joints at coordinates q [N m or N], shape (n,): the energy's
        gradient, downwards.
        """
        found = -(self.stiffness * (q - self.rest))
        if self.rope is not None:
            stretch, length, stiffness = self.rope
            strain = q[stretch] / q[length]
            found[stretch] = found[stretch] - stiffness * strain
            found[length] = found[length] + 0.5 * stiffness * strain * strain
        return found

    def energy(self, q: np.ndarray) -> Any:
        """What they store at coordinates q [J], shape (n,) or (n, rows) for many at once."""
        away = q - (self.rest if np.ndim(q) == 1 else self.rest[:, None])
        stored = 0.5 * (self.stiffness @ (away * away))
        if self.rope is not None:
            stretch, length, stiffness = self.rope
            stored = stored + 0.5 * stiffness * q[stretch] * q[stretch] / q[length]
        return stored

    def tangent(self, q: np.ndarray) -> np.ndarray:
        """Second derivatives of the energy [N m/rad, N/m, ...], shape (n, n): how the effort falls
        as the coordinates grow.
        """
        found = np.diag(np.asarray(self.stiffness, dtype=float))
        if self.rope is not None:
            s, length, stiffness = self.rope
            strain, each = q[s] / q[length], stiffness / q[length]
            found[s, s] += each
            found[length, length] += each * strain * strain
            found[s, length] -= each * strain
            found[length, s] -= each * strain
        return found
