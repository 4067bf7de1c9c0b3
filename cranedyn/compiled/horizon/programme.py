"""Parameters of a predictive controller, and the layout of its memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cranedyn.compiled.horizon.memory import HorizonShape
from cranedyn.model.layout import Layout
from cranedyn.plant.plant import Plant, Topology, plant


@dataclass(frozen=True)
class Programme:
    """Parameters of a predictive controller that its code depends on.

    Attributes:
        topology: Topology of its crane model.
        numbers: Parameters of its crane model, see `cranedyn.plant.plant.numbers`.
        drive: Kind of command, "effort", "motion" or "velocity".
        stages: Number of stages of the horizon.
        length: Length of a stage [s].
        period: Control period [s].
        ratio: Control periods from one optimisation to the next.
        rows: Rows of the path that it tracks; 0 for the present setpoint.
        share: Share of the error of the disturbance estimate that is corrected at each instant.
        swing_share: Share of the error of the filtered swing that is corrected.
        rate_share: Share of the error of planned rates that is corrected, for velocity commands.
        swing: Largest angle of each swing joint from its rest [rad].
        taut: Least tension of the rope [N].
        errors: Errors of coordinates and rates of each joint with equal weight; empty for explicit
            weights.
        payload_errors: Errors of the payload's position [m] and rate [m/s] with equal weight.
        lead: Lead of the command of each drive [s], for velocity commands; else empty.
        width: Lanes of vectors, see `HorizonShape`.
    """

    topology: Topology
    numbers: tuple[float, ...]
    drive: str
    stages: int
    length: float
    period: float
    ratio: int
    rows: int
    share: float
    swing_share: float
    rate_share: float
    swing: float
    taut: float
    errors: tuple[float, ...]
    payload_errors: tuple[float, ...]
    lead: tuple[float, ...] = ()
    width: int = 8

    def shape(self, lanes: int) -> HorizonShape:
        """Return the dimensions of the optimisation for a crane in each lane."""
        layout = self.topology.layout
        return HorizonShape(2 * layout.n, layout.m, self.stages, self.width, lanes)

    def offsets(self, lanes: int) -> MemoryOffsets:
        """Return the offsets of the sections in the memory of a group of lanes."""
        shape = self.shape(lanes)
        counts = [
            lanes * (shape.states + 1) + 1,
            2,
            lanes * lane_memory(self.topology.layout)["begun"].stop,
            lanes * (shape.stages + 1) * shape.lanes,
            max(self.rows, lanes) * shape.states,
            lanes * shape.size,
        ]
        return MemoryOffsets(0, *np.cumsum([-(-count // 8) * 8 for count in counts]).tolist())

    @property
    def plant(self) -> Plant:
        """Model of the crane, commanded by accelerations."""
        return self.driven("motion")

    def driven(self, drive: str) -> Plant:
        """Return the model of the crane, commanded by accelerations, "motion", or efforts,
        "effort".
        """
        return plant(self.topology, list(self.numbers), drive, False)

    @property
    def hop(self) -> int:
        """Rows of the path from one stage to the next."""
        return round(self.length / self.period) if self.rows else 0


class MemoryOffsets(NamedTuple):
    """Offsets of the sections in the memory of a group of lanes [doubles].

    Attributes:
        query: See `cranedyn.compiled.horizon.planning`.
        counts: Whole numbers: control instants up to now, and up to the start of the run.
        lanes: Memory of each lane, see `lane_memory`.
        plans: Plan of each lane.
        path: Rows of the path, or the goal of each lane.
        work: Memory of the optimisation.
        size: Total size.
    """

    query: int
    counts: int
    lanes: int
    plans: int
    path: int
    work: int
    size: int


def lane_memory(layout: Layout) -> dict[str, range]:
    """Return the slots of each lane's memory by name.

    They are the accelerations held, the estimated disturbances of the drives, the expected rates,
    the filtered swing of the instant before and its rates, the last plausible coordinates and
    rates, the number of implausible readings, the last of these, and 1 after the first instant.
    """
    n, m = layout.n, layout.m
    sizes = {"held": m, "estimate": m, "expected": m, "swing": 2 * (n - m)}
    sizes |= {"read": 2 * n, "refusals": 1, "refused": 2 * n, "begun": 1}
    ends = zip(sizes, np.cumsum(list(sizes.values())).tolist(), strict=True)
    return {name: range(end - sizes[name], end) for name, end in ends}
