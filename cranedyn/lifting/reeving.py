"""Reeving of a hoist: from the tension of all falls to the pull of the line and the torque of the
drum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cranedyn import theory
from cranedyn.checks import finite, number, whole
from cranedyn.data.trajectory import Trajectory
from cranedyn.lifting.loads import loads
from cranedyn.model.crane import Crane


@dataclass(frozen=True)
class Reeving:
    """Reeving of a hoist.

    Attributes:
        falls: Number of falls that carry the hook.
        efficiency: Efficiency of a sheave.
        drum_radius: Radius of the drum at the rope's axis [m].

    Raises:
        OutOfRange: If the falls are no whole number, or a number is out of its range.
    """

    falls: int
    efficiency: float = 0.98
    drum_radius: float = 0.2

    def __post_init__(self) -> None:
        """Check the numbers."""
        whole("number of falls", self.falls, 1)
        number("efficiency of a sheave", self.efficiency, "", "0.5 to 1")
        number("radius of the drum", self.drum_radius, "m", "> 0")

    def line_pull(self, tension: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """Return the pull of the line on the drum [N], shape (rows,).

        Args:
            tension: Tension of all falls together [N], shape (rows,).
            rate: Rate of the cable length [m/s], shape (rows,): sheaves resist hoisting, < 0, and
                hold back in lowering, > 0; at rest all falls pull alike.

        Raises:
            OutOfRange: If a number is not finite.
        """
        tension, rate = finite("tension", tension, ("rows",)), finite("rate", rate, ("rows",))
        hoisting, lowering = (
            theory.reeving_efficiency(self.falls, eta)
            for eta in (self.efficiency, 1.0 / self.efficiency)
        )
        share = np.where(rate < 0.0, hoisting, np.where(rate > 0.0, lowering, 1.0))
        return tension / (self.falls * share)

    def columns(self, crane: Crane, run: Trajectory) -> dict[str, np.ndarray]:
        """Return `line_N`, the pull of the line, `drum_Nm`, the torque on the drum, and
        `line_m_s`, the speed of the line, hoisting positive, of a run, shape (rows,) each.

        Raises:
            MissingRole: If no joint of the crane is a hoist.
            OutOfRange: If the run is of another crane.
        """
        hoist = crane.layout.role("hoist", "The pull of the line")
        rate = run.v[:, hoist]
        line = self.line_pull(loads(crane, run)["rope_N"], rate)
        return {"line_N": line, "drum_Nm": self.drum_radius * line, "line_m_s": -self.falls * rate}

    def capacity(self, line_pull: float, gravity: float) -> float:
        """Return the load that a largest pull of the line hoists [kg], by which a chart ends."""
        return (
            line_pull
            * self.falls
            * theory.reeving_efficiency(self.falls, self.efficiency)
            / gravity
        )
