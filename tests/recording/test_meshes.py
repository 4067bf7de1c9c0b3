"""Meshes of a URDF in a recording: triangles where the URDF puts them, files from one folder
alone.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from cranedyn.errors import DataError
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.extent import extent
from cranedyn.recording.meshes import meshes
from cranedyn.recording.record import describe as words
from cranedyn.recording.shapes import shapes
from cranedyn.simulation.simulate import simulate
from experiments.oracles.reading import locked

EDGES = (1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a box as a mesh in a folder of its own, and a secret beside."""
    top = tmp_path_factory.mktemp("site")
    (top / "crane" / "parts").mkdir(parents=True)
    for kind in ("stl", "obj"):
        trimesh.creation.box(EDGES).export(top / "crane" / "parts" / f"beam.{kind}")
    (top / "secret.stl").write_bytes((top / "crane" / "parts" / "beam.stl").read_bytes())
    (top / "crane" / "parts" / "broken.stl").write_text("solid nothing")
    (top / "crane" / "parts" / "beam.sh").write_text("echo")
    return top / "crane"


def _urdf(name: str, more: str = "") -> str:
    visual = (
        '<visual><origin xyz="0 0 -3" rpy="0 1.5707963267948966 0"/><geometry><mesh '
        f'filename="{name}" {more}/></geometry>'
    )
    text = describe(visuals=False).replace(
        '<link name="hook_link">',
        f'<link name="hook_link">{visual}<material name="paint"/></visual>',
    )
    return text.replace(
        '<link name="world"/>',
        '<material name="paint"><color rgba="1 0 0 1"/></material><link name="world"/>',
    )


@pytest.mark.parametrize(
    "name",
    [
        "parts/beam.stl",
        "package://anything/parts/beam.stl",
        "parts/beam.obj",
        "file://parts/beam.stl",
    ],
)
def test_a_mesh_stands_where_its_urdf_puts_it(folder: Path, name: str) -> None:
    ((link, mesh),) = meshes(_urdf(name, 'scale="2 2 2"'), folder)
    assert link == "hook_link"
    assert mesh.colour == (1.0, 0.0, 0.0, 1.0)
    # turned by 90° about Y: what was along Z lies along X
    low, high = (
        np.array([-EDGES[2], -EDGES[1], -3.0 - EDGES[0]]),
        np.array([EDGES[2], EDGES[1], -3.0 + EDGES[0]]),
    )
    # STL is float32.
    assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [low, high], atol=1e-6)
    (shape,) = shapes(_urdf(name, 'scale="2 2 2"'), folder)["hook_link"]
    assert_allclose([shape.size, shape.centre], [high - low, (high + low) / 2.0], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("../secret.stl", "is outside of the folder .*; meshes are read from there alone"),
        ("/etc/passwd", "is outside of the folder"),
        ("package://x/../../secret.stl", "is outside of the folder"),
        ("parts/none.stl", "Cannot read .*none.stl"),
        ("parts/beam.sh", "is of the kind sh; drawn are stl, obj, ply, dae, glb"),
        ("parts/broken.stl", "broken.stl cannot be read|holds no triangles"),
    ],
)
def test_a_mesh_that_cannot_be_drawn_is_a_sentence(folder: Path, name: str, words: str) -> None:
    with pytest.raises(DataError, match=words):
        list(meshes(_urdf(name), folder))


def test_a_link_out_of_the_folder_is_not_followed(folder: Path) -> None:
    (folder / "parts" / "link.stl").symlink_to(folder.parent / "secret.stl")
    with pytest.raises(DataError, match="is outside of the folder"):
        list(meshes(_urdf("parts/link.stl"), folder))


def test_meshes_are_drawn_where_a_folder_is_given_and_else_said_not_to_be(
    folder: Path, tmp_path: Path
) -> None:
    path = folder / "crane.urdf"
    path.write_text(_urdf("parts/beam.stl"))
    crane = load_crane(path)
    run = simulate(crane, locked(crane), duration=0.1, drive="motion")
    bare, drawn = Run("bare", crane, run), Run("drawn", crane, run, meshes=folder)
    assert "Meshes of the URDF are not drawn." in words([bare], "t", "")
    assert "not drawn" not in words([drawn], "t", "")
    sizes = {
        each.name: record(tmp_path / f"{each.name}.rrd", [each], title="t").read_bytes()
        for each in (bare, drawn)
    }
    assert b"Mesh3D:vertex_positions" in sizes["drawn"]
    assert b"Mesh3D:vertex_positions" not in sizes["bare"]
    assert extent(drawn)[0, 2] < extent(bare)[0, 2]  # the beam reaches below the payload's centre
