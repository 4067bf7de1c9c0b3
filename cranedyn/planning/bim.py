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
from cranedyn.planning.solids import Solid, body

LARGEST_IFC = 200_000_000
"""Most bytes of an IFC file."""


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
    vertices, triangles = (
        np.split(shapes[of], np.cumsum(shapes[counts])[:-1])
        for of, counts in (("vertices", "corners"), ("triangles", "faces"))
    )
    return [
        _solid(printable(name), corners, faces, as_hulls)
        for name, corners, faces in zip(shapes["names"], vertices, triangles, strict=True)
    ]


def _shapes(path: Path) -> dict[str, np.ndarray]:
    """Read the shapes in a process of its own, which `ifcopenshell` may end."""
    from cranedyn.recording.process import end, guard  # takes a second, for those who have models

    program, pipe = Path(__file__).with_name("ifc_shapes.py"), subprocess.PIPE
    command = [sys.executable, "-P", str(program), str(path.absolute())]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe)
    try:
        guard(process)
        content, messages = process.communicate()
    finally:
        end(process)
    last = printable((messages.decode(errors="replace").splitlines() or [""])[-1])
    if process.returncode < 0:
        name = signal.Signals(-process.returncode).name
        raise DataError(f"Cannot read {path}: ifcopenshell was ended by {name} at {quoted(last)}.")
    if process.returncode:
        raise DataError(f"Cannot read {path}: {last}.")
    with np.load(io.BytesIO(content), allow_pickle=False) as shapes:
        return dict(shapes)


def _solid(name: str, vertices: np.ndarray, triangles: np.ndarray, as_hull: bool) -> Solid:
    try:
        return body(name, vertices, triangles, as_hull=as_hull)
    except DataError:
        return body(name, vertices, triangles, as_hull=True)
