"""Cranes and runs from which oracles are read."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from cranedyn.controllers import follow
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Controller, EngineName, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import POINT

G = 9.81
"""Gravity of all oracles [m/s²]."""

MASS = 1000.0
"""Mass of the load of all oracles [kg]."""

SUBSTEPS = 5
"""Physics steps in a control period."""

SPARSE_SUBSTEPS = 50
"""The same where nothing is commanded and only the end of a run is read."""

Build = Callable[..., Crane]
"""Makes a crane from numbers of its xacro file."""

LARGE = {
    "slewing_inertia": 2e5,
    "trolley_min": 0,
    "trolley_max": 52,
    "hoist_max": 48,
    "mast_height": 50,
    "pivot_height": 52,
    "total_height": 58,
}
"""Ranges as long as those of a real crane [m], and a slewing inertia [kg m²] that is small enough
for the load to turn the structure."""


@cache
def point_crane(**values: object) -> Crane:
    """Return a large crane with a point load, in the gravity of the oracles; loaded once."""
    return load_crane(gravity=G, **{**POINT, **LARGE, **values})


class Bench(NamedTuple):
    """Makes the cranes and runs that oracles are read from.

    Attributes:
        build: Makes a crane from numbers of its xacro file.
        engine: Engine that computes a step. Ground and ropes that may go slack are computed by the
            compiled engine also where this is "pinocchio".
    """

    build: Build
    engine: EngineName = "pinocchio"

    def run(
        self,
        crane: Crane,
        start: State,
        duration: float,
        dt: float,
        controller: Controller | None = None,
        *,
        substeps: int = SUBSTEPS,
        **options: Any,
    ) -> Trajectory:
        """Run a crane.

        The run goes on where the rope would push or a drive leaves its range: closed forms know of
        neither.

        Args:
            crane: The crane.
            start: Where it starts.
            duration: Duration [s].
            dt: Step [s].
            controller: Controller; None for `zero_command`.
            substeps: Physics steps in a control period.
            **options: Further options of `simulate`; drives are in prescribed motion by default.
        """
        return simulate(
            crane,
            controller or zero_command(crane),
            start=start,
            duration=duration,
            dt=dt,
            control_period=substeps * dt,
            engine=None if self.engine == "pinocchio" else self.engine,
            **{"drive": "motion", "validity": "mark", **options},
        )

    def moved(
        self,
        crane: Crane,
        start: State,
        reference: Reference,
        duration: float,
        dt: float,
        *,
        substeps: int = SUBSTEPS,
    ) -> Trajectory:
        """Run a crane whose drives follow a reference; the arguments are those of `run`."""
        drives = follow(crane, reference, substeps * dt)
        return self.run(crane, start, duration, dt, drives, substeps=substeps)
