"""Settings of a run that engine and log share."""

from __future__ import annotations

from dataclasses import dataclass

from cranedyn.clocks import Clocks
from cranedyn.dynamics.converters import Converters
from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.integrators import Integrator
from cranedyn.model.crane import Crane


@dataclass(frozen=True, eq=False)
class Setting:
    """What an engine is made for.

    Attributes:
        crane: The crane.
        clocks: Physics steps and control periods.
        drive: "effort", "motion" or "velocity".
        forces: Whether there are external forces on the points of the crane.
        buffers: Whether buffers end the ranges of the drives.
        integrator: The integrator.
        converters: Frequency converters of drives that take velocities; None for other drives.
    """

    crane: Crane
    clocks: Clocks
    drive: str
    forces: bool
    buffers: bool
    integrator: Integrator
    converters: Converters | None = None

    @property
    def lead(self) -> float:
        """Time by which positions run ahead of velocities [s]."""
        return self.integrator.lead * self.clocks.dt

    @property
    def delay_steps(self) -> int | None:
        """Control periods by which commands are delayed; None without converters."""
        converters, clocks = self.converters, self.clocks
        return None if converters is None else converters.delay_steps(clocks.dt, clocks.period)

    def external(self) -> ExternalForces | None:
        """Return the external forces; None if there can be none."""
        if not (self.forces or self.buffers):
            return None
        return ExternalForces(self.crane, buffers=self.buffers)

    def drives(self, external: ExternalForces | None) -> Drives:
        """Return the drives."""
        if self.converters is not None:
            return VelocityDrives(
                self.crane, external, self.converters, self.clocks.dt, self.delay_steps or 0
            )
        return (EffortDrives if self.drive == "effort" else MotionDrives)(self.crane, external)
