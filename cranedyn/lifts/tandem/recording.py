"""A tandem lift in 3D: both cranes, their ropes and the load, beside tensions and attitude."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cranedyn.lifts.tandem.clearance import rope_ends
from cranedyn.lifts.tandem.simulation import TandemRun
from cranedyn.recording.contents import Obstacle
from cranedyn.recording.postures import MovingBox, MovingLine, PosedCrane, record_postures


def record_tandem(path: str | Path, run: TandemRun, *, title: str = "Tandem lift") -> Path:
    """Write a run with the obstacles of its site as a recording for the viewer.

    The hooks of the cranes and the loads that their descriptions show are left out: instead a line
    goes from each pivot to its lug.

    Args:
        path: The file, ending in ``.rrd``.
        run: The run.
        title: Heading of the recording.

    Raises:
        DataError: If the file cannot be written.
        CraneError: If Rerun is switched off in the environment.
    """
    cranes = []
    ropes = []
    for i, station in enumerate(run.lift.stations):
        q, _ = station.plumb(run.drive_positions(i))
        cranes.append(
            PosedCrane(
                name=station.name,
                crane=station.crane,
                q=q,
                foot=np.asarray(station.foot, dtype=float),
                turn=station.turn,
                hidden=("hook_link", "payload_link"),
            )
        )
        ropes.append(MovingLine(f"rope of {station.name}", rope_ends(run, i)))
    size = np.array(run.lift.load.size, dtype=float)
    beam = MovingBox("load", size, run.centres, run.rotations)
    tensions = {name: run[f"{name}_tension_N"] for name in run.lift.names}
    angles = {name: np.degrees(run[f"{name}_rad"]) for name in ("roll", "pitch")}
    return record_postures(
        path,
        run.t,
        cranes,
        [beam],
        ropes,
        obstacles=[
            Obstacle(solid.name, solid.vertices, solid.triangles, solid.zone)
            for solid in run.lift.site.solids
        ],
        curves={"Tension of the ropes [N]": tensions, "Tilt of the load [°]": angles},
        title=title,
        text="Lines from the jibs to the load: the ropes. Grid: 5 m.",
    )
