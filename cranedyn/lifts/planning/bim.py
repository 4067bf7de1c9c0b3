"""Obstacles from an IFC file, the format in which building models are exchanged; needs the extra
``bim``.
"""

from __future__ import annotations

import importlib.util
import io
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np

from cranedyn.data.files import open_file
from cranedyn.errors import CraneError, DataError, printable, quoted
from cranedyn.lifts.planning.solids import Solid, body

LARGEST_IFC = 200_000_000
"""Largest size of an IFC file [bytes]."""


def read_ifc(path: Path, *, as_hulls: bool = False) -> list[Solid]:
    """Return every product in an IFC file that has a shape, but for rooms, openings and
    annotations.

    Nothing in the file is run, and no other file is read. A process of its own reads it, so that a
    file at which `ifcopenshell` crashes is refused like others. A product whose surface is not
    closed, as one of thin sheets, stands with its convex hull.

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
    with open_file(path) as file:
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
    if importlib.util.find_spec("ifcopenshell") is None:
        raise CraneError("To read an IFC file install the extra bim: pip install 'cranedyn[bim]'.")
    shapes = _shapes(path)
    if not len(shapes["names"]):
        raise DataError(f"{path} has no product with a shape.")
    # The corners of all products follow each other, and so do their triangles.
    solids = []
    first_corner = 0
    first_face = 0
    for name, corner_count, face_count in zip(
        shapes["names"], shapes["corners"], shapes["faces"], strict=True
    ):
        vertices = shapes["vertices"][first_corner : first_corner + corner_count]
        triangles = shapes["triangles"][first_face : first_face + face_count]
        solids.append(_solid(printable(name), vertices, triangles, as_hulls))
        first_corner += corner_count
        first_face += face_count
    return solids


def _shapes(path: Path) -> dict[str, np.ndarray]:
    """Read the shapes in a process of its own, which `ifcopenshell` may end; see
    `cranedyn.lifts.planning.ifc_shapes.extract_shapes`.

    Raises:
        DataError: If the process ends with an error or a signal, with the last line that it wrote.
    """
    from cranedyn.recording.process import end, guard  # takes a second, for those who have models

    program = Path(__file__).with_name("ifc_shapes.py")
    # -P keeps the folder of the program, with its module names, out of the path of imports.
    command = [sys.executable, "-P", str(program), str(path.absolute())]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        guard(process)
        content, messages = process.communicate()
    finally:
        end(process)
    lines = messages.decode(errors="replace").splitlines()
    last = printable(lines[-1] if lines else "")
    if process.returncode < 0:  # ended by a signal
        name = signal.Signals(-process.returncode).name
        raise DataError(f"Cannot read {path}: ifcopenshell was ended by {name} at {quoted(last)}.")
    if process.returncode:
        raise DataError(f"Cannot read {path}: {last}.")
    with np.load(io.BytesIO(content), allow_pickle=False) as shapes:
        return dict(shapes)


def _solid(name: str, vertices: np.ndarray, triangles: np.ndarray, as_hull: bool) -> Solid:
    """Return a product as a body; with its convex hull, too, where its surface is not closed."""
    try:
        return body(name, vertices, triangles, as_hull=as_hull)
    except DataError:
        return body(name, vertices, triangles, as_hull=True)
