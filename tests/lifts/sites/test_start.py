"""No crane of a site starts in an obstacle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from cranedyn.errors import DataError
from cranedyn.lifts.planning.solids import Solid, body, box, prism
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from tests.lifts.sites.cases import site_of

pytestmark = pytest.mark.slow


def shell(radius: float) -> Solid:
    """Return a hollow tube around the first tower, which is no convex body."""
    mesh = trimesh.creation.annulus(r_min=radius - 1.0, r_max=radius, height=100.0)
    mesh.apply_translation([0.0, 0.0, 50.0])
    return body("solid", np.array(mesh.vertices), np.array(mesh.faces))


def dented_ball(radius: float) -> Solid:
    """Return a ball about the first tower with a dent, which is no convex body."""
    mesh = trimesh.creation.icosphere(radius=radius)
    vertices = np.array(mesh.vertices)
    vertices[0] *= 0.8
    ball = body("solid", vertices, np.array(mesh.faces))
    assert not ball.parts
    return ball


# The first crane stands at the origin. Its mast is 2 m wide and 38 m high; its jib points along y
# at the start, at a height of 40 m; its load hangs from 30 m of it by a rope of 20 m.
IN_THE_WAY = {
    "around its foot": ("tower", box("solid", [0.0, 0.0], [4.0, 4.0, 9.0], 0.0)),
    "between the chords of its mast": ("tower", box("solid", [0.0, 0.0], [0.5, 0.5, 2.0], 15.0)),
    "a thin plate through its mast": ("tower", box("solid", [0.0, 0.0], [9.0, 9.0, 0.01], 20.0)),
    "all of it": ("tower", box("solid", [0.0, 0.0], [200.0, 40.0, 100.0], -5.0)),
    "a hollow mesh around all": ("tower", dented_ball(150.0)),
    "a wall through its counter-jib": (
        "slewing part",
        box("solid", [0.0, -10.0], [1.0, 1.0, 60.0], 0.0),
    ),
    "a wall through its jib": ("slewing part", box("solid", [0.0, 20.0], [1.0, 1.0, 60.0], 0.0)),
    "a tube through its jib": ("slewing part", shell(20.0)),
    "a thin plate through its rope": ("rope", box("solid", [0.0, 30.0], [5.0, 5.0, 0.01], 28.0)),
    "a post in its load": ("load", box("solid", [0.0, 30.0], [0.1, 0.1, 0.1], 20.0)),
}


@pytest.mark.parametrize("where", IN_THE_WAY)
def test_an_obstacle_where_a_part_of_a_crane_is_at_the_start_is_refused_by_name(where: str) -> None:
    part, solid = IN_THE_WAY[where]
    with pytest.raises(DataError, match=f"At the start the {part} of north is in solid"):
        replace(site_of(), solids=(solid,))


@pytest.mark.parametrize(
    "solid",
    [
        box("slab", [0.0, 0.0], [9.0, 9.0, 1.0], -1.0),
        box("below the jib", [0.0, 15.0], [2.0, 2.0, 30.0], 0.0),
        box("beside the mast", [4.0, 0.0], [1.0, 1.0, 30.0], 0.0),
        prism("zone", np.array([[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0]]), 0.0, 90.0, zone=True),
    ],
    ids=lambda solid: solid.name,
)
def test_a_slab_below_a_foot_what_is_beside_a_crane_and_a_zone_are_allowed(solid: Solid) -> None:
    assert replace(site_of(), solids=(solid,)).solids


def test_parts_of_a_crane_are_where_its_heading_points() -> None:
    # The jib of this one points along -x at the start, and its counter-jib along x.
    site = site_of("luffing_between")
    behind, ahead = (box("solid", [x, 0.0], [1.0, 1.0, 60.0], 0.0) for x in (-37.0, -85.0))
    low = replace(site, stations=site.stations[:1])
    for solid in (behind, ahead):
        with pytest.raises(DataError, match="slewing part of west is in solid"):
            replace(low, solids=(solid,))
    beyond = box("solid", [-50.0 + 35.0, 0.0], [1.0, 1.0, 60.0], 0.0)
    assert replace(low, solids=(beyond,)).solids


def test_a_site_file_with_a_box_over_a_tower_is_refused_with_the_line_of_the_crane(
    tmp_path: Path,
) -> None:
    text = (SITES / "two_towers.toml").read_text("utf-8")
    over = '[[box]]\nname = "shed"\ncentre = [0.0, -55.0]\nsize = [6.0, 6.0, 5.0]\nbase = 30.0\n'
    file = tmp_path / "site.toml"
    file.write_text(f"{text}\n{over}", "utf-8")
    words = r"line \d+, \[crane\] position: At the start the tower of south is in shed"
    with pytest.raises(DataError, match=words):
        read_crane_site(file)
