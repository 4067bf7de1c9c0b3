"""The boxes, cylinders and spheres of a URDF, many to an entity: tens of kilobytes, where an entity
for each takes 1.7 megabytes.

Meshes, one to an entity, only where a folder is given in which their files lie.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from cranedyn.recording.meshes import Mesh, meshes

_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}


@dataclass(frozen=True)
class Shape:
    """One visual of a link.

    Attributes:
        kind: "box", "cylinder", "sphere" or "mesh".
        size: Three edges, or radius and length, or radius [m]; of a mesh the edges of the box about
            it.
        centre: In the frame of the link [m].
        rpy: Roll, pitch and yaw in that frame [rad].
        colour: Red, green, blue and alpha, 0 to 1.
        mesh: Its triangles, if it is one.
    """

    kind: str
    size: tuple[float, ...]
    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)
    colour: tuple[float, ...] = (0.5, 0.5, 0.5, 1.0)
    mesh: Mesh | None = None


def shapes(urdf: str, folder: Path | None = None) -> dict[str, list[Shape]]:
    """The visuals of each link of a plain URDF, by name of the link; with meshes if there is a
    folder for them.

    Raises:
        DataError: If a mesh cannot be drawn, see `cranedyn.recording.meshes.meshes`.
    """
    robot = ET.fromstring(urdf)
    colours = {
        m.get("name"): color.get("rgba", "")
        for m in robot.iter("material")
        if (color := m.find("color")) is not None
    }
    found = {
        link.get("name", ""): [
            shape for visual in link.iterfind("visual") if (shape := _shape(visual, colours))
        ]
        for link in robot.iterfind("link")
    }
    if folder is not None and robot.find("link/visual/geometry/mesh") is not None:
        for name, mesh in meshes(urdf, folder):
            low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
            found[name].append(
                Shape(
                    "mesh",
                    (*(high - low),),
                    (*((low + high) / 2.0),),
                    colour=mesh.colour,
                    mesh=mesh,
                )
            )
    return found


def log_shapes(
    recording: rr.RecordingStream,
    path: str,
    frame: str,
    of_link: list[Shape],
    fill_mode: str = "solid",
) -> None:
    """Draw shapes in a frame, one entity below the path for each kind of shape.

    Args:
        recording: Where to.
        path: The entity.
        frame: The coordinate frame of the link.
        of_link: The shapes.
        fill_mode: "solid", or another way in which Rerun draws a body.
    """
    for i, shape in enumerate(shape for shape in of_link if shape.mesh is not None):
        vertices, triangles, normals, _ = shape.mesh  # type: ignore[misc]
        triangulated = rr.Mesh3D(
            vertex_positions=vertices,
            triangle_indices=triangles,
            vertex_normals=normals,
            albedo_factor=[round(255 * c) for c in shape.colour],
        )
        recording.log(f"{path}/mesh/{i}", rr.CoordinateFrame(frame), triangulated, static=True)
    of_link = [shape for shape in of_link if shape.mesh is None]
    for kind in dict.fromkeys(shape.kind for shape in of_link):
        some = [shape for shape in of_link if shape.kind == kind]
        size = np.array([shape.size for shape in some])
        common: dict[str, Any] = {
            "centers": np.array([shape.centre for shape in some]),
            "quaternions": Rotation.from_euler("xyz", [shape.rpy for shape in some]).as_quat(),
            "colors": np.array([shape.colour for shape in some]),
            "fill_mode": fill_mode,
        }
        body: rr.AsComponents
        if kind == "box":
            body = rr.Boxes3D(sizes=size, **common)
        elif kind == "cylinder":
            body = rr.Cylinders3D(radii=size[:, 0], lengths=size[:, 1], **common)
        else:
            body = rr.Ellipsoids3D(radii=size[:, 0], **common)
        recording.log(f"{path}/{kind}", rr.CoordinateFrame(frame), body, static=True)


def _shape(visual: ET.Element, colours: dict[str | None, str]) -> Shape | None:
    geometry, origin, material = (
        visual.find("geometry/*"),
        visual.find("origin"),
        visual.find("material"),
    )
    if geometry is None or geometry.tag not in _SIZES:
        return None
    given: dict[str, Any] = {}
    if origin is not None:
        given |= {
            "centre": _floats(origin.get("xyz", "0 0 0")),
            "rpy": _floats(origin.get("rpy", "0 0 0")),
        }
    if material is not None:
        color = material.find("color")
        rgba = colours.get(material.get("name"), "") if color is None else color.get("rgba", "")
        given |= {"colour": _floats(rgba)} if rgba else {}
    return Shape(
        geometry.tag,
        _floats(" ".join(geometry.get(name, "") for name in _SIZES[geometry.tag])),
        **given,
    )


def _floats(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())
