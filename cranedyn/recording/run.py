"""What a recording is made of, and how its parts are named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from cranedyn.checks import finite
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import Crane
from cranedyn.plotting.style import run_colour
from cranedyn.recording.scenery import Scenery

TIMELINE = "sim_time"
"""The one clock of a recording."""

SCENE = "Crane"
"""Name of the view that shows all of the scene."""


@dataclass(frozen=True, eq=False)
class Run:
    """One crane and what happened to it.

    Attributes:
        name: What the run is called; no two runs of a recording share a name.
        crane: The crane.
        trajectory: What it did.
        offset: Where its foot stands in the scene [m]; cranes with the same offset are drawn into
            each other.
        meshes: Folder in which the files of the meshes of its URDF lie, and which none of them
            leaves; None draws no meshes.
        colour: Hex colour of its payload, path and curves; empty for the next one of
            `cranedyn.plotting.style`.
        scenery: What stands about it; None for nothing.
    """

    name: str
    crane: Crane
    trajectory: Trajectory
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    meshes: Path | None = None
    colour: str = ""
    scenery: Scenery | None = None

    def __post_init__(self) -> None:
        """Have a name that can be written and an offset of three finite numbers."""
        finite("offset of a run", self.offset, (3,), unit="m")
        object.__setattr__(self, "name", utf8(self.name))

    def entity(self, *parts: str) -> str:
        """Path of an entity of this run."""
        return rr.new_entity_path([self.name, *parts])

    def frame(self, name: str) -> str:
        """Name of a coordinate frame of this run, from the name of a link."""
        return f"{self.name}: {name}"


def utf8(text: str) -> str:
    """A text with what UTF-8 cannot write escaped, as in names of files that are not text."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def colours(runs: Sequence[Run]) -> list[str]:
    """The hex colour of each run."""
    return [run.colour or run_colour(i) for i, run in enumerate(runs)]


def clock(t: np.ndarray) -> list[rr.TimeColumn]:
    """Times [s] on the clock of a recording, to the nearest nanosecond (Rerun itself would cut the
    rest off).
    """
    return [rr.TimeColumn(TIMELINE, duration=np.round(1e9 * t).astype("timedelta64[ns]"))]
