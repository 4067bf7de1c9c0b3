"""Obstacles from an IFC file, the format in which building models are exchanged; needs the extra
``bim``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.data.files import opened
from cranedyn.errors import CraneError, DataError, printable
from cranedyn.planning.solids import Solid, body

LARGEST_IFC = 200_000_000
"""Most bytes of an IFC file."""

_AIR = ("IfcSpace", "IfcOpeningElement", "IfcAnnotation", "IfcGrid")
_MOST_PRODUCTS = 5000


def read_ifc(path: Path, *, as_hulls: bool = False) -> list[Solid]:
    """Every product in an IFC file that has a shape, but for rooms, openings and annotations.

    Nothing in the file is run, and no other file is read. A product whose surface is not closed, as
    one of thin sheets, stands with its convex hull.

    Args:
        path: The file, ending in ``.ifc``.
        as_hulls: Whether all products stand with their convex hulls, which is faster and never
            smaller.

    Raises:
        CraneError: If `ifcopenshell` is not installed.
        DataError: If the file cannot be read, is too large, or has no product with a shape.
    """
    if path.suffix.lower() != ".ifc":
        raise DataError(f"Cannot read {path}: an IFC file ends in .ifc.")
    with opened(path) as file:
        size = path.stat().st_size
        start = file.read(64)
    if size > LARGEST_IFC:
        raise DataError(
            f"Cannot read {path}: it has {size / 1e6:.0f} MB; allowed are {LARGEST_IFC / 1e6:.0f} "
            "MB."
        )
    if not start.lstrip().startswith(b"ISO-10303-21"):
        raise DataError(
            f"Cannot read {path}: it does not begin as an IFC file does, with ISO-10303-21."
        )
    try:
        import ifcopenshell
        import ifcopenshell.geom
    except ImportError as error:
        raise CraneError(
            "To read an IFC file install the extra bim: pip install 'cranedyn[bim]'."
        ) from error
    try:
        solids = list(_solids(ifcopenshell, ifcopenshell.open(str(path)), as_hulls))
    except (KeyboardInterrupt, CraneError):
        raise
    except Exception as error:  # whatever a parser of a stranger's bytes raises
        raise DataError(
            f"Cannot read {path}: it is no whole IFC file ({printable(error)})."
        ) from error
    if not solids:
        raise DataError(f"{path} has no product with a shape.")
    return solids


def _solids(ifcopenshell: Any, model: Any, as_hulls: bool) -> Iterator[Solid]:
    settings = ifcopenshell.geom.settings()
    settings.set("use-world-coords", True)
    shown = [
        product
        for product in model.by_type("IfcProduct")
        if product.Representation and not any(map(product.is_a, _AIR))
    ]
    if len(shown) > _MOST_PRODUCTS:
        raise DataError(
            f"An IFC file has {len(shown)} products with shapes; allowed are {_MOST_PRODUCTS}."
        )
    for product in shown:
        shape = ifcopenshell.geom.create_shape(settings, product).geometry
        vertices, triangles = (
            np.array(shape.verts).reshape(-1, 3),
            np.array(shape.faces, dtype=int).reshape(-1, 3),
        )
        if not len(triangles):
            continue
        name = f"{printable(product.Name or product.is_a())} #{product.id()}"
        try:
            yield body(name, vertices, triangles, as_hull=as_hulls)
        except DataError:
            yield body(name, vertices, triangles, as_hull=True)
