"""Meshes of a URDF: which files its visuals name, by yourdfpy, and the triangles in them."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cranedyn.data.files import read_bytes
from cranedyn.errors import DataError, quoted

_KINDS = ("stl", "obj", "ply", "dae", "glb")
_LARGEST = 20_000_000


class Mesh(NamedTuple):
    """Triangles in the frame of a link.

    Attributes:
        vertices: [m], shape (n, 3).
        triangles: Three vertices each, shape (triangles, 3).
        normals: At the vertices, shape (n, 3).
        colour: Red, green, blue and alpha, 0 to 1.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray
    colour: tuple[float, ...]


def meshes(urdf: str, folder: Path) -> Iterator[tuple[str, Mesh]]:
    """The meshes of a plain URDF, each with the name of its link.

    Args:
        urdf: The URDF, its numbers and names checked.
        folder: Where their files lie; a name that leads out of it is refused. Of
            ``package://NAME/FILE`` it is FILE.

    Raises:
        DataError: If a file is not there, is none of these kinds or larger than 20 MB, or cannot be
            read as a mesh.
    """
    import yourdfpy  # takes a second, for those who have meshes

    robot = yourdfpy.URDF.load(
        io.BytesIO(urdf.encode()), load_meshes=False, build_scene_graph=False
    ).robot
    colours = {material.name: material.color for material in robot.materials or ()}
    for link in robot.links:
        for visual in link.visuals:
            if (named := visual.geometry.mesh) is not None:
                yield link.name, _mesh(visual, named, colours, folder)


def _mesh(visual: Any, named: Any, colours: dict[str, Any], folder: Path) -> Mesh:
    import trimesh

    path = _path(named.filename, folder)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in _KINDS:
        raise DataError(
            f"The mesh {quoted(named.filename)} is of the kind {quoted(kind)}; drawn are "
            f"{', '.join(_KINDS)}."
        )
    try:
        body: Any = trimesh.load(
            io.BytesIO(read_bytes(path, _LARGEST)),
            file_type=kind,
            force="mesh",
            skip_materials=True,
        )
        body.apply_transform(
            np.diag([*np.broadcast_to(1.0 if named.scale is None else named.scale, 3), 1.0])
        )
        body.apply_transform(np.eye(4) if visual.origin is None else visual.origin)
        found = np.array(body.vertices), np.array(body.faces), np.array(body.vertex_normals)
    except DataError:
        raise
    except Exception as error:  # whatever a parser of strangers' meshes raises
        raise DataError(
            f"The mesh {quoted(named.filename)} cannot be read: {type(error).__name__}."
        ) from error
    if not (len(found[1]) and all(np.isfinite(part).all() for part in found)):
        raise DataError(
            f"The mesh {quoted(named.filename)} holds no triangles, or numbers that are none."
        )
    return Mesh(*found, _colour(visual.material, colours))


def _path(name: str, folder: Path) -> Path:
    within = re.sub(r"^package://[^/]*/|^file://", "", name)
    path = (folder / within).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise DataError(
            f"The mesh {quoted(name)} is outside of the folder {folder}; meshes are read from "
            "there alone."
        )
    return path


def _colour(material: Any, colours: dict[str, Any]) -> tuple[float, ...]:
    color = None if material is None else material.color or colours.get(material.name)
    return (0.5, 0.5, 0.5, 1.0) if color is None else tuple(map(float, color.rgba))
