"""Scaled drawings of a planned lift: plan, elevation, sequence and rigging on sheets of paper, and
plan and elevation as DXF files.

Begin with `LiftScene.of`, then `sheets`, and `write_drawings` for the files. `views` makes the two
drawings, which know neither paper nor file formats; `sheet` and `dxf` draw them.
"""

from __future__ import annotations

from pathlib import Path

from cranedyn.lifts.judging.drawings.dxf import NoDxf, write_dxf
from cranedyn.lifts.judging.drawings.rigging_sketch import rigging_sheet
from cranedyn.lifts.judging.drawings.sequence import sequence_sheet, sequence_sheet_count
from cranedyn.lifts.judging.drawings.sheet import (
    DrawingTooLarge,
    LiftSheet,
    TitleBlock,
    drawing_sheet,
)
from cranedyn.lifts.judging.drawings.views import LiftScene

__all__ = [
    "DrawingTooLarge",
    "LiftScene",
    "LiftSheet",
    "NoDxf",
    "sheets",
    "write_drawings",
]


def sheets(scene: LiftScene) -> list[LiftSheet]:
    """Return the sheets of a lift: plan and elevation to scale, the sequence, the rigging.

    Raises:
        DrawingTooLarge: If plan or elevation fits on no A3 sheet.
    """
    analysis = scene.analysis
    of_sequence = sequence_sheet_count(scene)
    count = 3 + of_sequence
    details = analysis.site.details

    def block(number: int) -> TitleBlock:
        return TitleBlock(analysis.site.name, details.job, details.people.prepared, number, count)

    made = [
        drawing_sheet(scene.plan, block(1)),
        drawing_sheet(scene.elevation, block(2)),
    ]
    for page in range(of_sequence):
        made.append(sequence_sheet(scene, page, block(3 + page)))
    made.append(rigging_sheet(analysis.site, block(count)))
    return made


def write_drawings(scene: LiftScene, folder: Path, stem: str = "lift") -> list[Path]:
    """Write plan and elevation as DXF into a folder: ``lift_plan.dxf`` and ``lift_elevation.dxf``.

    Args:
        scene: The lift.
        folder: The folder.
        stem: What the names of the files begin with.

    Raises:
        NoDxf: If ezdxf is not installed.
        DrawingTooLarge: If one fits on no A3 sheet, so that its texts have no size.
        DataError: If a file cannot be written.
    """
    written = []
    for drawing in (scene.plan, scene.elevation):
        written.append(write_dxf(drawing, folder / f"{stem}_{drawing.name}.dxf"))
    return written
