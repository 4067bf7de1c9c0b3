"""Site files: examples that can be read, and what is wrong in one said with its line and field; IFC
models of our own making.
"""

from __future__ import annotations

import importlib.util
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from cranedyn.errors import CraneError, DataError, OutOfRange
from cranedyn.lifts.planning import bim
from cranedyn.lifts.planning.bim import read_ifc
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.crane_bodies import shape_corners
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.site import Arm, Base
from cranedyn.lifts.planning.site_file import EXAMPLES, read_site
from tests.lifts.planning.sites import corners, crane, site


def _is_there(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ValueError:
        return False


NEEDS_BIM = pytest.mark.skipif(not _is_there("ifcopenshell"), reason="needs the extra bim")

WHOLE = """name = "yard"
[crane]
heading = 90.0
[ground]
height = 1.0
[load]
size = [1.0, 2.0, 3.0]
[lift]
from = [1.0, 2.0, 3.0]
[[box]]
name = "a"
centre = [5.0, 6.0]
size = [1.0, 2.0, 3.0]
[[box]]
name = "b"
centre = [9.0, 6.0]
size = [1.0, 2.0, 3.0]
yaw = 90.0
"""


ENTERED = """
[ground]
height = 0.0
[load]
size = [1.0, 1.0, 1.0]
mass = 870.0
[rigging]
hook = 100.0
slings = 30.0
[drives]
rates = [4.5, 1.5, 1.0]
accelerations = [0.9, 0.4, 0.3]
efforts = [2e5, 1e4, 5e4]
[base]
spacing = 6.0
mass = 8e4
permitted = 350.0
[jib]
mass = 2000.0
centre = 10.0
[counter_jib]
length = 8.0
mass = 3000.0
centre = 6.0
"""


@pytest.mark.slow
def test_what_only_the_people_on_the_site_know_is_entered_in_tables_of_its_own(
    tmp_path: Path,
) -> None:
    (tmp_path / "site.toml").write_text(ENTERED)
    here = read_site(tmp_path / "site.toml")
    assert here.rigging == {"hook": 100.0, "slings": 30.0}
    crane = crane_of(here)
    assert crane.payload_mass == 1000.0
    assert crane.effort_limit.tolist() == [2e5, 1e4, 5e4]
    assert here.limits is not None
    assert here.limits.rates == (math.radians(4.5), 1.5, 1.0)
    assert here.limits.accelerations == (math.radians(0.9), 0.4, 0.3)
    assert here.base == Base(6.0, 8e4, 350e3)
    assert here.arms == (Arm(2000.0, 10.0), Arm(3000.0, -6.0))
    behind = max(points[:, 1].max() for _, points in shape_corners(crane))
    assert 8.0 <= behind < 8.1  # the jib points along -Y


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("accelerations = [0.9, 0.4, 0.3]\n", "", "[drives] accelerations: it is missing."),
        ("mass = 870.0\n", "", "[load] mass: it is missing; hook and slings are counted besides."),
        ("hook = 100.0", "hok = 100.0", "[rigging] hok"),
        (
            "[load]",
            "[crane]\nvalues = {payload_mass = 5.0}\n[load]",
            "[load] mass: the same value is entered twice: here, and as payload_mass = 5 in",
        ),
        ("efforts = [2e5", "efforts = [-2e5", "one of efforts is -200000.0 N m; allowed is > 0"),
        ("rates = [4.5", "rates = [0.0", "one of rates is 0.0 degrees/s; allowed is > 0"),
        ("rates = [4.5, ", "rates = [", "allowed is 3 numbers [degrees/s, m/s, m/s]"),
        ("[rigging]", "[lift]\nswing = 0\n[rigging]", "swing is 0 degrees; allowed is 0.01 to"),
        ("[rigging]", "[uncertainty]\ndelay = 20\n[rigging]", "delay is 20 s; allowed is 0 to 1"),
        ("centre = 10.0\n", "", "[jib] centre: it is missing."),
    ],
)
def test_what_is_entered_wrongly_or_twice_is_refused_with_its_table_and_field(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    assert old in ENTERED
    (tmp_path / "site.toml").write_text(ENTERED.replace(old, new))
    with pytest.raises(DataError, match=re.escape(words)):
        read_site(tmp_path / "site.toml")


@pytest.mark.parametrize("swing", [0.0, -0.01, 0.6, math.nan])
def test_a_load_that_may_not_swing_at_all_is_refused(swing: float) -> None:
    with pytest.raises(OutOfRange, match=r"swing of the load is .* rad"):
        site(swing=swing)


def test_a_number_that_the_site_gives_cannot_be_given_besides(tmp_path: Path) -> None:
    (tmp_path / "site.toml").write_text(ENTERED)
    with pytest.raises(DataError, match="counter_jib is given by the site, too; leave one out"):
        crane_of(read_site(tmp_path / "site.toml"), counter_jib=9.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_are_read_by_name_and_their_lifts_begin_and_end_free(name: str) -> None:
    here = read_site(name)
    assert here.start is not None
    assert here.goal is not None
    asked = clearance_of(crane_of(here), here)
    assert min(asked.swing_margin(asked.place(point)) for point in (here.start, here.goal)) > 0.05


@pytest.mark.slow
def test_a_site_is_what_its_file_says(tmp_path: Path) -> None:
    (tmp_path / "yard.toml").write_text(WHOLE)
    here = read_site(tmp_path / "yard.toml")
    assert (here.name, here.ground, here.goal) == ("yard", 1.0, None)
    assert here.foot.tolist() == [0.0, 0.0, 1.0]
    assert here.heading == pytest.approx(np.pi / 2)
    a, b = here.solids
    assert a.vertices.min(axis=0).tolist() == [4.5, 5.0, 1.0]
    assert a.vertices.max(axis=0).tolist() == [5.5, 7.0, 4.0]
    np.testing.assert_allclose(np.ptp(b.vertices, axis=0), [2.0, 1.0, 3.0])
    assert here.start is not None
    assert here.start.tolist() == [1.0, 2.0, 3.0]
    (tmp_path / "yard.toml").write_text(
        WHOLE.replace("[1.0, 2.0, 3.0]\n[[box]]", "[1.0, 2.0]\n[[box]]", 1)
    )
    standing = read_site(tmp_path / "yard.toml").start
    assert standing is not None
    assert standing.tolist() == [1.0, 2.0]
    assert here.load is not None
    assert np.ptp(here.load, axis=0).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("[ground]\nheight = 1.0\n", "", "[site] ground: there is none; a site needs a table"),
        ("height = 1.0", "height = nan", "line 5, [ground] height: height is nan m; allowed is a"),
        ("height = 1.0", 'height = "low"', "height: height is low; allowed is a number [m]"),
        ("[5.0, 6.0]", "[5.0]", "line 12, [box] centre: centre is '[5.0]'; allowed is 2 numbers"),
        ("height = 1.0", "height = 1,5", "(at line 5, column 11). Use a decimal point: 1.5."),
        ("centre = [9.0", "center = [9.0", "line 16, [box] center: There is no field 'center'"),
        ("3.0]\nyaw", "0.0]\nyaw", "line 17, [box] size: one of size is 0.0 m; allowed is > 0"),
        ("size = [1.0, 2.0, 3.0]\nyaw", "yaw", "line 14, [box] size: it is missing"),
        ('name = "b"', 'name = "a"', "line 15, [box] name: two obstacles are called a"),
        ("heading = 90.0", "heading = true", "line 3, [crane] heading: heading is"),
        ("[[box]]", "[[bok]]", "line 10, [site] bok: There is no table 'bok'"),
        ("heading = 90.0", "heading = ", "is not TOML: Invalid value (at line 3"),
        ("heading = 90.0", "values = {mass = 1e999}", "line 3, [crane] values: mass is inf"),
        ("heading = 90.0", 'chart = "mct99"', "line 3, [crane] chart: mct99 is neither a file"),
        ("from = [1.0, 2.0, 3.0]", "distance = -1.0", "line 9, [lift] distance: distance is -1.0"),
    ],
)
def test_what_is_wrong_in_a_site_is_said_with_its_line_and_field(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    file = tmp_path / "yard.toml"
    file.write_text(WHOLE.replace(old, new))
    with pytest.raises(DataError) as refusal:
        read_site(file)
    assert str(refusal.value).startswith(str(file))
    assert sentence in str(refusal.value)


FAR = """ply
format ascii 1.0
element vertex 3
property double x
property double y
property double z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2147483648
3 0 2 1
"""
"""A triangle of which a corner has a number too large for its type."""


MESH = '[[mesh]]\nname = "m"\n'
PRISM = '[[prism]]\nname = "p"\n'


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        (MESH + 'file = "open.stl"', "line 21, [mesh] name: the mesh is not closed: some edge has"),
        (MESH + 'file = "../cube.stl"', "line 22, [mesh] file: ../cube.stl lies outside of the"),
        (MESH + 'file = "broken.stl"', "broken.stl: it holds no mesh"),
        (MESH + 'file = "plane.obj"\nhull = true', "plane.obj: it holds no mesh of triangles"),
        (MESH + 'file = "far.ply"', "far.ply: it holds no mesh"),
        (MESH + 'file = "cube.exe"', "a mesh ends in .stl, .ply, .off, .obj"),
        (
            PRISM + "outline = [[0, 0], [2, 2], [2, 0], [0, 2]]\nheight = 1.0",
            "line 21, [prism] name: an outline must enclose an area and not cross itself.",
        ),
        (PRISM + "outline = [[0, 0], [2, 2]]\nheight = 1.0", "line 22, [prism] outline: outline"),
        (
            PRISM + "outline = [[0, 0], [2, 0], [2, 2]]\nheight = 1e-10",
            "line 21, [prism] name: height is 1e-10 m; allowed is >= 1e-06",
        ),
        (
            '[[box]]\nname = "c"\ncentre = [9.0, 6.0]\nsize = [1e9, 1.0, 1.0]',
            "[box] name: a corner lies at -5e+08 m; allowed are -1e+07 to 1e+07 m, in metres.",
        ),
        ('[[ifc]]\nfile = "cube.stl"', "an IFC file ends in .ifc"),
        ('[[ifc]]\nfile = "not.ifc"', "it does not begin as an IFC file does"),
        pytest.param('[[ifc]]\nfile = "cut.ifc"', "it is no whole IFC file", marks=NEEDS_BIM),
        ('[[ifc]]\nfile = "huge.ifc"', "it has 1000 MB; allowed are 200 MB"),
        ('[[neighbour]]\nname = "n"\nvalues = {masst = 1}', "There is no argument 'masst'"),
    ],
)
def test_meshes_models_and_neighbours_that_are_none_are_refused(
    tmp_path: Path, entry: str, sentence: str, recwarn: pytest.WarningsRecorder
) -> None:
    cube = trimesh.creation.box([1.0, 1.0, 1.0])
    (tmp_path / "cube.stl").write_bytes(cube.export(file_type="stl"))
    (tmp_path / "open.stl").write_bytes(
        trimesh.Trimesh(cube.vertices, cube.faces[:-1]).export(file_type="stl")
    )
    (tmp_path / "broken.stl").write_bytes(b"solid of nothing")
    (tmp_path / "plane.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\nf 1 3 2\n")
    (tmp_path / "far.ply").write_text(FAR)
    (tmp_path / "not.ifc").write_text("hello")
    (tmp_path / "cut.ifc").write_text("ISO-10303-21;\nHEADER;\nFILE_DESC")
    with open(tmp_path / "huge.ifc", "wb") as file:
        file.write(b"ISO-10303-21;")
        file.truncate(1_000_000_000)
    path = tmp_path / "yard.toml"
    path.write_text(WHOLE + "\n" + entry)
    with pytest.raises(CraneError) as refusal:
        read_site(path)
    assert sentence in str(refusal.value)
    assert not recwarn.list


def test_a_mesh_behind_a_link_out_of_the_folder_of_the_site_is_refused(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    folder = tmp_path / "site"
    outside.mkdir(), folder.mkdir()
    content = trimesh.creation.box([1.0, 1.0, 1.0]).export(file_type="stl")
    (outside / "cube.stl").write_bytes(content)
    (folder / "within.stl").write_bytes(content)
    for link, to in (
        ("link.stl", outside / "cube.stl"),
        ("folder", outside),
        ("circle.stl", folder / "circle.stl"),
        ("inner.stl", folder / "within.stl"),
    ):
        (folder / link).symlink_to(to)
    (tmp_path / "there").symlink_to(folder)  # the folder itself may be reached by a link
    entry = '[[mesh]]\nname = "m"\nfile = "{}"\n'
    (folder / "yard.toml").write_text(WHOLE + entry.format("inner.stl"))
    assert read_site(tmp_path / "there" / "yard.toml").solids[-1].name == "m"
    for name in ("link.stl", "folder/cube.stl", "circle.stl"):
        (folder / "yard.toml").write_text(WHOLE + entry.format(name))
        with pytest.raises(DataError, match=r"line 2\d, .*(outside of the folder|symbolic links)"):
            read_site(folder / "yard.toml")


def test_a_mesh_stands_where_it_is_put_and_its_hull_is_asked_for(tmp_path: Path) -> None:
    outline = shapely.Polygon([(0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)])
    bracket = trimesh.creation.extrude_polygon(outline, 2.0)
    (tmp_path / "l.stl").write_bytes(bracket.export(file_type="stl"))
    entry = '[[mesh]]\nname = "{0}"\nfile = "l.stl"\nscale = 2.0\nhull = {0}\n'
    entry += "position = [10.0, 0.0, 1.0]\n"
    entries = entry.format("false") + entry.format("true")
    (tmp_path / "yard.toml").write_text(WHOLE + entries)
    exact, as_hull = read_site(tmp_path / "yard.toml").solids[-2:]
    assert (len(exact.parts), len(as_hull.parts)) == (0, 1)
    np.testing.assert_allclose(exact.vertices.max(axis=0), [18.0, 8.0, 5.0])
    assert exact.surface_encloses(np.array([11.0, 7.0, 3.0]))
    assert not exact.surface_encloses(np.array([14.0, 5.0, 3.0]))


@pytest.mark.slow
def test_a_neighbour_stands_turned_where_the_site_says_with_its_rope_down(tmp_path: Path) -> None:
    entry = (
        '[[neighbour]]\nname = "n"\nposition = [40.0, 0.0, 1.0]\nheading = 180.0\ntrolley = '
        "20.0\ncable = 20.0\n"
    )
    (tmp_path / "yard.toml").write_text(WHOLE + entry)
    points = np.vstack(read_site(tmp_path / "yard.toml").solids[-1].parts)
    assert points[:, 0].min() == pytest.approx(40.0 - 23.5, abs=0.2)  # the jib's end
    assert points[:, 2].max() == pytest.approx(1.0 + 33.45, abs=0.3)
    load = points[(np.abs(points[:, 0] - 20.0) < 1.0) & (np.abs(points[:, 2] - 9.0) < 1.0)]
    assert len(load) >= 8  # the load hangs 20 m below the pivot at 28 m


# --- IFC ------------------------------------------------------------------------------------------


def model(path: Path) -> Path:
    """A slab of 10 by 8 m, 0.3 m thick, with an opening of 2 by 2 m and a column on it."""
    pytest.importorskip("ifcopenshell", reason="needs the extra bim")
    import ifcopenshell.api.context
    import ifcopenshell.api.feature
    import ifcopenshell.api.geometry
    import ifcopenshell.api.project
    import ifcopenshell.api.root
    import ifcopenshell.api.unit

    file = ifcopenshell.api.project.create_file()
    ifcopenshell.api.root.create_entity(file, ifc_class="IfcProject", name="test")
    ifcopenshell.api.unit.assign_unit(file, length={"is_metric": True, "raw": "METERS"})
    whole = ifcopenshell.api.context.add_context(file, context_type="Model")
    body = {"context_identifier": "Body", "target_view": "MODEL_VIEW", "parent": whole}
    shown = ifcopenshell.api.context.add_context(file, context_type="Model", **body)

    def block(
        kind: str, name: str, corner: tuple[float, float, float], size: tuple[float, float, float]
    ) -> object:
        product = ifcopenshell.api.root.create_entity(file, ifc_class=kind, name=name)
        matrix = np.eye(4)
        matrix[:3, 3] = corner
        ifcopenshell.api.geometry.edit_object_placement(file, product=product, matrix=matrix)
        points = [(0.0, 0.0), (size[0], 0.0), (size[0], size[1]), (0.0, size[1])]
        outline = file.createIfcPolyline(
            [file.createIfcCartesianPoint(point) for point in [*points, points[0]]]
        )
        profile = file.createIfcArbitraryClosedProfileDef("AREA", None, outline)
        shape = ifcopenshell.api.geometry.add_profile_representation(
            file, context=shown, profile=profile, depth=size[2]
        )
        ifcopenshell.api.geometry.assign_representation(file, product=product, representation=shape)
        return product

    slab = block("IfcSlab", "deck", (5.0, -4.0, 3.0), (10.0, 8.0, 0.3))
    opening = block("IfcOpeningElement", "hole", (9.0, -1.0, 2.0), (2.0, 2.0, 2.0))
    ifcopenshell.api.feature.add_feature(file, feature=opening, element=slab)
    block("IfcColumn", "column", (6.0, 0.0, 3.3), (0.4, 0.4, 3.0))
    file.write(str(path))
    return path


def test_products_of_an_ifc_model_stand_where_they_are_with_openings_cut_out(
    tmp_path: Path,
) -> None:
    solids = {
        solid.name.partition(" ")[0]: solid for solid in read_ifc(model(tmp_path / "model.ifc"))
    }
    assert set(solids) == {"deck", "column"}
    np.testing.assert_allclose(solids["column"].vertices.min(axis=0), [6.0, 0.0, 3.3], atol=1e-6)
    np.testing.assert_allclose(solids["deck"].vertices.max(axis=0), [15.0, 4.0, 3.3], atol=1e-6)
    assert solids["deck"].surface_encloses(np.array([6.0, 2.0, 3.1]))
    assert not solids["deck"].surface_encloses(np.array([10.0, 0.0, 3.1]))


def test_a_model_without_shapes_is_refused(tmp_path: Path) -> None:
    text = model(tmp_path / "model.ifc").read_text()
    (tmp_path / "bare.ifc").write_text(re.sub(r"#\d+=IFC(SLAB|COLUMN)\(.*\n", "", text))
    with pytest.raises(DataError, match=r"bare.ifc has no product with a shape"):
        read_ifc(tmp_path / "bare.ifc")


def test_a_model_at_which_ifcopenshell_crashes_is_refused_with_the_product(tmp_path: Path) -> None:
    text = model(tmp_path / "model.ifc").read_text()
    extrusion = re.search(r"#(\d+)=IFCEXTRUDEDAREASOLID\(#(\d+),#(\d+)", text)
    assert extrusion is not None
    voids = re.search(r"(IFCRELVOIDSELEMENT\(.*,)#\d+\);", text)
    assert voids is not None  # what cuts the opening becomes an axis
    (tmp_path / "wrong.ifc").write_text(text.replace(voids[0], f"{voids[1]}#{extrusion[3]});"))
    with pytest.raises(DataError, match=r"wrong.ifc: ifcopenshell was ended by SIG\w+ at 'deck #"):
        read_ifc(tmp_path / "wrong.ifc")


def test_a_small_load_passes_through_the_opening_of_a_deck_but_not_of_its_hull(
    tmp_path: Path,
) -> None:
    path = model(tmp_path / "model.ifc")
    rooms = []
    for as_hulls in (False, True):
        here = site(
            *read_ifc(path, as_hulls=as_hulls),
            load=corners(0.4, 0.4, 0.4),
            distance=0.1,
            swing=1e-3,
        )
        asked = clearance_of(crane(), here)
        rooms.append(asked.margin(asked.q(asked.place(np.array([10.0, 0.0, 3.1])))))
    assert rooms[0] > 0.0 > rooms[1]


def test_without_ifcopenshell_a_sentence_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "ifcopenshell", None)
    (tmp_path / "model.ifc").write_text("ISO-10303-21;")
    with pytest.raises(CraneError, match=r"install the extra bim: pip install 'cranedyn\[bim\]'"):
        bim.read_ifc(tmp_path / "model.ifc")
