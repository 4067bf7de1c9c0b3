"""A drawing as a DXF file for a CAD program, in metres and on layers by name."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from cranedyn.data.files import atomic_write
from cranedyn.errors import CraneError
from cranedyn.lifts.judging.drawings.drawing import Arc, Dimension, Drawing, Label, Layer, Polyline
from cranedyn.lifts.judging.drawings.labels import CIRCLE_RADIUS, FONT_SIZE, PlacedText, place_texts
from cranedyn.lifts.judging.drawings.sheet import STYLES, choose_layout

_CAPITALS = 0.716
"""Height of capitals over the size of letters. DXF measures texts by their capitals."""

_METRES = 6
"""How DXF files say that their unit is the metre ($INSUNITS)."""


class NoDxf(CraneError):
    """The package that writes DXF files is not installed."""


def write_dxf(drawing: Drawing, path: Path) -> Path:
    """Write a drawing as a DXF file whose texts are as large as on its sheet.

    Raises:
        NoDxf: If ezdxf is not installed.
        DrawingTooLarge: If it fits on no sheet.
        DataError: If the file cannot be written.
    """
    try:
        import ezdxf
    except ModuleNotFoundError:
        raise NoDxf(
            f"{path.name} was not written, since ezdxf is not installed: pip install "
            "'cranedyn[dxf]'."
        ) from None

    scale = choose_layout(drawing).scale
    metres = 1e-3 * scale  # on site, for a millimetre on paper
    document = _document(ezdxf, metres)
    space = document.modelspace()
    for primitive in drawing.primitives:
        if isinstance(primitive, Dimension):
            _add_dimension(space, primitive, metres)
        elif not isinstance(primitive, Label):
            _add_lines(space, primitive)
    for placed in place_texts(drawing, scale):
        # The text of a dimension is part of it.
        if placed.layer != "dimensions" or placed.text not in _dimension_texts(drawing):
            _add_text(space, placed, metres)
    with atomic_write(path) as draft:
        document.saveas(draft)
    return path


def _document(ezdxf: Any, metres: float) -> Any:
    """Return an empty document in metres with all layers; `metres` are on site for a millimetre on
    paper.
    """
    document = ezdxf.new("R2010", setup=True)
    document.units = _METRES
    document.header["$LTSCALE"] = 5.0 * metres
    for layer, stroke in STYLES.items():
        entry = document.layers.add(layer)
        entry.rgb = _rgb(stroke.colour)
        # Widths of lines are in hundredths of a millimetre, of which DXF knows some.
        entry.dxf.lineweight = 50 if stroke.width >= 0.45 else 25
        if stroke.dashes:
            entry.dxf.linetype = "DASHED"
    return document


def _add_lines(space: Any, primitive: Polyline | Arc) -> None:
    """Add lines, an arc or a circle."""
    attributes = {"layer": primitive.layer}
    if isinstance(primitive, Polyline):
        space.add_lwpolyline(primitive.points, close=primitive.closed, dxfattribs=attributes)
    elif primitive.is_circle:
        space.add_circle(primitive.centre, primitive.radius, dxfattribs=attributes)
    else:
        start, end = math.degrees(primitive.start), math.degrees(primitive.end)
        space.add_arc(primitive.centre, primitive.radius, start, end, dxfattribs=attributes)


def _dimension_texts(drawing: Drawing) -> set[str]:
    """Return the texts of all dimensions."""
    return {p.text for p in drawing.primitives if isinstance(p, Dimension)}


def _add_dimension(space: Any, dimension: Dimension, metres: float) -> None:
    """Add a dimension with its value; `metres` are on site for a millimetre on paper."""
    style = {
        "dimtxt": _CAPITALS * FONT_SIZE * metres,
        "dimasz": 2.2 * metres,
        "dimexo": 0.5 * metres,
        "dimexe": 1.0 * metres,
        "dimgap": 0.8 * metres,
    }
    added = space.add_aligned_dim(
        p1=dimension.start,
        p2=dimension.end,
        distance=dimension.offset,
        text=dimension.text,
        override=style,
        dxfattribs={"layer": "dimensions"},
    )
    added.render()


def _add_text(space: Any, placed: PlacedText, metres: float) -> None:
    """Add a text, its circle and its leader; `metres` are on site for a millimetre on paper."""
    from ezdxf.enums import TextEntityAlignment

    attributes: dict[str, Layer] = {"layer": placed.layer}
    if placed.leader is not None:
        space.add_line(*placed.leader, dxfattribs=attributes)
    if placed.in_circle:
        space.add_circle(placed.centre, CIRCLE_RADIUS * metres, dxfattribs=attributes)
    height = _CAPITALS * FONT_SIZE * metres
    text = space.add_text(placed.text, height=height, dxfattribs=attributes)
    text.set_placement(placed.centre, align=TextEntityAlignment.MIDDLE_CENTER)


def _rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of a colour such as "#0b5cad", from 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
