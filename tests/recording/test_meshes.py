"""Meshes of a URDF in a recording: their place, and the folder that limits what is read."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh
from numpy.testing import assert_allclose

from cranedyn.controllers.hold import zero_command
from cranedyn.errors import DataError
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.dashboard import extent
from cranedyn.recording.recorder import describe_runs as markdown
from cranedyn.recording.shapes import Shape, shapes
from cranedyn.simulation.simulate import simulate

EDGES = (1.0, 2.0, 4.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a box as a mesh in a subfolder, and a mesh outside of it."""
    top = tmp_path_factory.mktemp("site")
    parts = top / "crane" / "parts"
    parts.mkdir(parents=True)
    for kind in ("stl", "obj"):
        trimesh.creation.box(EDGES).export(parts / f"beam.{kind}")
    (top / "secret.stl").write_bytes((parts / "beam.stl").read_bytes())
    (parts / "link.stl").symlink_to(top / "secret.stl")
    (parts / "broken.stl").write_text("solid nothing")
    (parts / "beam.sh").write_text("echo")
    return top / "crane"


def _urdf(name: str) -> str:
    visual = (
        '<visual><origin xyz="0 0 -3" rpy="0 1.5707963267948966 0"/><geometry><mesh '
        f'filename="{name}" scale="2 2 2"/></geometry><material name="paint"/></visual>'
    )
    paint = '<material name="paint"><color rgba="1 0 0 1"/></material>'
    return (
        describe(visuals=False)
        .replace('<link name="hook_link">', f'<link name="hook_link">{visual}')
        .replace('<link name="world"/>', f'{paint}<link name="world"/>')
    )


def _hook(name: str, folder: Path) -> list[Shape]:
    return shapes(_urdf(name), folder)["hook_link"]


PREFIXES = ("", "package://anything/", "file://")


@pytest.mark.parametrize("name", [*(f"{p}parts/beam.stl" for p in PREFIXES), "parts/beam.obj"])
def test_a_mesh_has_the_place_size_and_colour_of_its_visual(folder: Path, name: str) -> None:
    (shape,) = _hook(name, folder)
    assert shape.mesh is not None and shape.colour == (1.0, 0.0, 0.0, 1.0)
    # The rotation by 90° about Y exchanges X and Z. STL has float32.
    assert_allclose(shape.size, [2 * EDGES[2], 2 * EDGES[1], 2 * EDGES[0]], atol=1e-6)
    assert_allclose(shape.centre, [0.0, 0.0, -3.0], atol=1e-6)
    assert_allclose(shape.mesh.vertices.max(axis=0), [4.0, 2.0, -2.0], atol=1e-6)
    lengths = (shape.mesh.vertex_normals**2).sum(axis=1)
    assert_allclose(lengths, 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../secret.stl", "is outside of the folder .*; meshes are read from there alone"),
        ("/etc/passwd", "is outside of the folder"),
        ("package://x/../../secret.stl", "is outside of the folder"),
        ("parts/link.stl", "is outside of the folder"),
        ("parts/none.stl", "Cannot read .*none.stl"),
        ("parts/beam.sh", "is of the kind sh; allowed are stl, obj, ply, dae, glb"),
        ("parts/broken.stl", "broken.stl cannot be read|has no triangles"),
    ],
)
def test_a_mesh_that_cannot_be_drawn_is_refused(folder: Path, name: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        _hook(name, folder)


@pytest.mark.slow
def test_meshes_are_drawn_only_with_a_folder_and_the_text_says_so(
    folder: Path, tmp_path: Path
) -> None:
    path = folder / "crane.urdf"
    path.write_text(_urdf("parts/beam.stl"))
    crane = load_crane(path)
    run = simulate(crane, zero_command(crane), duration=0.1, drive="motion")
    bare = Run("bare", crane, run)
    drawn = Run("drawn", crane, run, meshes=folder)
    for each, has_mesh in ((bare, False), (drawn, True)):
        content = record(tmp_path / "a.rrd", [each], title="t").read_bytes()
        assert (b"Mesh3D:vertex_positions" in content) == has_mesh
        assert ("Meshes of the URDF are not drawn." in markdown([each], "t", "")) != has_mesh
    assert extent(drawn)[0, 2] < extent(bare)[0, 2]  # the beam reaches below the payload
