"""Drawings of a lift are true to scale, and hold the site where it is."""

from __future__ import annotations

import itertools
import math
import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shapely

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.lifts.judging.drawings import LiftScene, NoDxf, sheets, write_drawings
from cranedyn.lifts.judging.drawings.drawing import Arc, Dimension, Drawing, Label, Polyline
from cranedyn.lifts.judging.drawings.labels import place_texts, text_width
from cranedyn.lifts.judging.drawings.outlines import crane_shapes
from cranedyn.lifts.judging.drawings.rigging_sketch import rigging_sheet, rigging_stack
from cranedyn.lifts.judging.drawings.sheet import (
    MARGIN,
    DrawingTooLarge,
    TitleBlock,
    choose_layout,
)
from cranedyn.lifts.judging.drawings.swept import throw_distance
from cranedyn.lifts.judging.drawings.views import (
    MAX_NAMED,
    _outlines,
    across_runway,
    elevation_sketch,
    elevation_view,
    plan_view,
    plane_at,
    standing_outlines,
)
from cranedyn.lifts.judging.lift_tables import tables
from cranedyn.lifts.judging.numbered_positions import end_names
from cranedyn.lifts.judging.plan_record import PlanMark
from cranedyn.lifts.judging.report_page import SHEET_FOOT, _sheets_or_reason, lift_html
from cranedyn.lifts.judging.sequence import motion_steps
from cranedyn.lifts.planning.crane_bodies import collision_bodies
from cranedyn.lifts.planning.plan_details import (
    GroundDetails,
    Job,
    LoadDetails,
    PlanDetails,
    Slings,
    Spreader,
)
from cranedyn.lifts.planning.rigging import rigging_height, sling_height
from cranedyn.lifts.planning.site_file import SITES, read_site
from cranedyn.lifts.planning.solids import box, prism
from cranedyn.model.load import load_crane
from tests.lifts.judging.test_judgement import small
from tests.lifts.planning.sites import WALL
from tests.lifts.planning.test_any_crane import clearance

pytestmark = pytest.mark.slow

SVG = "{http://www.w3.org/2000/svg}"


@cache
def scene() -> LiftScene:
    """The lift over a wall, which stands from 7 to 21 m in X and 1 m wide at Y = 0."""
    return LiftScene.of(small())


@cache
def plan() -> Drawing:
    return plan_view(scene())


@cache
def elevation() -> Drawing:
    return elevation_view(scene())


def lines_on(drawing: Drawing, layer: str) -> list[np.ndarray]:
    return [
        np.array(p.points)
        for p in drawing.primitives
        if isinstance(p, Polyline) and p.layer == layer
    ]


def test_the_plan_has_the_wall_where_it_stands_and_says_its_name() -> None:
    (wall,) = lines_on(plan(), "obstacles")
    np.testing.assert_allclose(wall.min(axis=0), [7.0, -0.5], atol=1e-9)
    np.testing.assert_allclose(wall.max(axis=0), [21.0, 0.5], atol=1e-9)
    texts = [p.text for p in plan().primitives if isinstance(p, Label)]
    assert "wall, top +8.0 m" in texts


def test_the_elevation_has_the_wall_from_its_least_to_its_largest_radius_under_the_jib() -> None:
    (wall,) = lines_on(elevation(), "obstacles")
    least, bottom = wall.min(axis=0)
    largest, top = wall.max(axis=0)
    assert least == pytest.approx(7.0)  # the middle of its near side, in the direction of X
    assert (bottom, top) == (0.0, 8.0)
    # The tip of the jib, 23.5 m from the axis, passes over all of it.
    assert largest == pytest.approx(math.hypot(21.0, 0.5), abs=1e-6)


def test_tower_and_base_are_as_wide_in_the_elevation_as_entered() -> None:
    """The jib points to (6, -12) at the pick-up, over no side of the base, which is 4.5 m wide."""
    found = scene()
    lift = found.analysis.certificate.lift
    on_base = replace(lift.clearance, site=found.analysis.site)
    places = [position.place for position in found.positions]
    found = replace(found, shapes=[crane_shapes(on_base, place) for place in places])
    outlines = standing_outlines(found)
    assert np.ptp(outlines[-1][:, 0]) == pytest.approx(4.5)
    for flat, body in zip(outlines, found.shapes[0].standing, strict=True):
        # A square body has one width, which is that of its sides in plan.
        sides = np.ptp(body[:, :2], axis=0)
        assert np.ptp(flat[:, 0]) == pytest.approx(sides.min(), abs=1e-6)


def test_mast_and_foot_are_as_wide_as_entered() -> None:
    crane = load_crane(mast_height=40.0, mast_width=1.6, foot_width=4.0)
    tower, foot = sorted(collision_bodies(crane).mast, key=lambda body: -body[:, 2].max())
    assert np.ptp(tower[tower[:, 2] > 20.0][:, 0]) == pytest.approx(1.6, rel=0.25)  # legs have 0.16
    assert np.ptp(np.concatenate([tower, foot])[:, 0]) == pytest.approx(4.0, abs=1e-6)
    drawn = collision_bodies(load_crane(mast_height=40.0)).mast
    assert np.ptp(np.concatenate(drawn)[:, 0]) == pytest.approx(6.0, abs=1e-6)


def test_dimensions_say_the_distances_that_they_are_drawn_over() -> None:
    drawn = [p for d in (plan(), elevation()) for p in d.primitives if isinstance(p, Dimension)]
    assert len(drawn) >= 5
    for dimension in drawn:
        (number,) = re.findall(r"[\d.]+(?= m)", dimension.text)[:1]
        length = math.dist(dimension.start, dimension.end)
        assert float(number) == pytest.approx(length, abs=5.1e-3), dimension.text
    radii = [p for p in plan().primitives if isinstance(p, Dimension)]
    assert radii[0].text == f"R {math.hypot(6.0, 12.0):.2f} m, pick-up"


def test_the_slewing_range_and_the_reach_are_those_of_the_drives() -> None:
    arcs = [p for p in plan().primitives if isinstance(p, Arc)]
    circles = [p for p in arcs if p.is_circle]
    crane = scene().clearance.crane
    trolley = int(scene().clearance.drive_joints[1])
    assert max(p.radius for p in circles) == pytest.approx(float(crane.upper[trolley]))
    (used,) = [p for p in arcs if not p.is_circle]
    # From (6, -12) to (6, 12) seen from the slew axis.
    assert used.end - used.start == pytest.approx(2.0 * math.atan2(12.0, 6.0), abs=2e-3)


def test_the_envelope_holds_all_footprints_and_the_exclusion_zone_holds_the_envelope() -> None:
    swept = scene().swept
    lift = scene().analysis.certificate.lift
    assert swept.exclusion.buffer(1e-6).contains(swept.envelope)
    for row in range(0, len(lift.timed.places), 37):
        load = crane_shapes(lift.clearance, lift.timed.places[row]).load
        corners = shapely.MultiPoint(load[:, :2])
        assert swept.envelope.buffer(-0.2).contains(corners)


def test_a_part_flies_as_far_as_a_projectile_that_is_stepped() -> None:
    speed = 1.7
    upward = 0.8
    height = 21.0
    gravity = 9.81
    dt = 1e-5
    t = 0.0
    z = height
    rate = upward
    while z > 0.0:
        rate -= gravity * dt
        z += rate * dt
        t += dt
    # One step of the simulation, and its error of the first order.
    assert float(throw_distance(speed, upward, height, gravity)) == pytest.approx(
        speed * t, abs=1e-4
    )
    assert float(throw_distance(2.0, 0.0, 5.0, 10.0)) == pytest.approx(2.0)


def test_a_sheet_is_as_large_as_its_paper_and_a_metre_on_it_as_long_as_the_scale_says() -> None:
    made = sheets(scene())
    names = [sheet.name for sheet in made]
    assert names[:3] == ["plan", "elevation", "sequence-1"] and names[-1] == "rigging"
    layout = choose_layout(plan())
    root = ET.fromstring(made[0].svg)
    assert root.get("width") == f"{made[0].width_mm:g}mm"
    assert root.get("viewBox") == f"0 0 {made[0].width_mm:g} {made[0].height_mm:g}"
    colour = "#6b6353"
    (wall,) = [e for e in root.iter(f"{SVG}polygon") if e.get("stroke") == colour]
    points = np.array([pair.split(",") for pair in (wall.get("points") or "").split()], float)
    on_paper = np.ptp(points, axis=0)
    np.testing.assert_allclose(on_paper, np.array([14.0, 1.0]) * 1e3 / layout.scale, atol=2e-3)
    for sheet in made:
        for text in ET.fromstring(sheet.svg).iter(f"{SVG}text"):
            assert float(text.get("font-size") or 0.0) >= 2.5, text.text


def test_texts_cover_no_other_text() -> None:
    scale = choose_layout(plan()).scale
    placed = place_texts(plan(), scale)
    assert len(placed) >= 6
    boxes = []
    for text in placed:
        width = 5.8 if text.in_circle else text_width(text.text)
        height = 5.8 if text.in_circle else 4.0
        x, y = np.array(text.centre) * 1e3 / scale
        boxes.append(shapely.box(x - width / 2, y - height / 2, x + width / 2, y + height / 2))
    for i, first in enumerate(boxes):
        for second in boxes[i + 1 :]:
            assert not first.overlaps(second)


def test_texts_stand_on_no_dimension_line_but_their_own() -> None:
    """Two heights beside each other: the text of each is wider than the way between their lines."""
    heights = [
        Dimension("dimensions", (x, 0.0), (x, 10.0), f"a height that is told at {x:g}")
        for x in (20.0, 21.0)
    ]
    name = Label("obstacles", (20.5, 5.0), "a name between both")
    drawing = Drawing("plan", "Plan", (*heights, name), (0.0, 0.0), (40.0, 20.0))
    for text in place_texts(drawing, 200.0):
        half = 1e-3 * 200.0 * text_width(text.text) / 2.0
        for x in (20.0, 21.0):
            if not text.text.endswith(f"{x:g}"):
                assert abs(text.centre[0] - x) >= half, text


def test_a_zone_without_a_top_ends_with_what_is_drawn_beside_it() -> None:
    zone = replace(box("street", (12.0, 5.0), (4.0, 2.0, 10_000.0), 0.0), zone=True)
    site = replace(small().site, solids=(*small().site.solids, zone))
    drawn = elevation_view(LiftScene.of(replace(small(), site=site)))
    top = max(float(points[:, 1].max()) for points in lines_on(drawn, "zones"))
    assert top == pytest.approx(elevation().high[1] - 2.0, abs=4.0)
    assert drawn.high[1] == pytest.approx(elevation().high[1])


def test_positions_of_one_height_share_its_dimension() -> None:
    texts = [p.text for p in elevation().primitives if isinstance(p, Dimension)]
    heights = [text for text in texts if text.startswith("hook +")]
    assert len(heights) == 2 and heights[0].endswith(f" m at 1 and {len(scene().positions)}")


def test_a_drawing_that_fits_on_no_paper_is_refused_with_its_size() -> None:
    with pytest.raises(DrawingTooLarge, match="5000 m by 10 m"):
        choose_layout(replace(plan(), low=(0.0, 0.0), high=(5000.0, 10.0)))


def test_a_report_without_drawings_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cranedyn.lifts.judging.drawings.sheet.SCALES", (1,))
    drawn, not_drawn = _sheets_or_reason(scene())
    assert drawn == []
    assert "There are no drawings. The plan is" in not_drawn[0]


def test_each_sheet_has_room_for_the_digest_and_the_number_of_its_page() -> None:
    """A browser writes both into the margin at the foot of a page, which a sheet of its own size
    has, too; nothing of the drawing is below its frame there.
    """
    found = scene()
    mark = PlanMark("ab" * 32, 1, "lift.json")
    page = lift_html(found, [], tables(found.analysis), [], plan=mark)
    assert '@bottom-left { content: "Record, revision 1 · digest abababababab"' in page
    made = sheets(found)
    assert 0.0 < SHEET_FOOT < MARGIN
    for sheet in made:
        rule = page[page.index(f"@page sheet-{sheet.name} {{") :]
        assert f"margin: 0 0 {SHEET_FOOT}mm;" in rule[: rule.index("@bottom-left")]
        assert f"height: {sheet.height_mm - SHEET_FOOT}mm; overflow: hidden" in page
        assert f"width: {sheet.width_mm}mm; height: {sheet.height_mm - SHEET_FOOT}mm" in page


def test_what_the_exclusion_zone_goes_through_is_named() -> None:
    """The wall is under the path; a shed far from it is not in the zone."""
    found = scene()
    far = box("shed", (-40.0, -40.0), (2.0, 2.0, 2.0), 0.0)
    site = replace(found.analysis.site, solids=(*found.analysis.site.solids, far))
    found = replace(found, analysis=replace(found.analysis, site=site))
    assert "wall" in found.in_exclusion_zone and "shed" not in found.in_exclusion_zone


def test_north_is_where_the_bearing_of_the_y_axis_has_it() -> None:
    analysis = small()
    # Y points east, so that north is to the left of it: towards -X.
    details = PlanDetails(ground=GroundDetails(north=math.pi / 2.0))
    site = replace(analysis.site, details=details)
    turned = plan_view(replace(scene(), analysis=replace(analysis, site=site)))
    assert turned.north == pytest.approx(math.pi)
    assert plan().north is None
    assert any("North was not entered" in note for note in plan().notes)


def test_a_site_file_enters_north_in_degrees(tmp_path: Path) -> None:
    text = (SITES / "open_yard.toml").read_text(encoding="utf-8")
    assert read_site("open_yard").details.ground.north is None
    path = tmp_path / "turned.toml"
    path.write_text(text.replace("[ground]", "[ground]\nnorth = 90.0"), encoding="utf-8")
    assert read_site(path).details.ground.north == pytest.approx(math.pi / 2.0)


def test_dxf_files_hold_each_obstacle_at_its_coordinates(tmp_path: Path) -> None:
    ezdxf = pytest.importorskip("ezdxf", reason="extra dxf (ezdxf) is not installed")
    plan_file, elevation_file = write_drawings(scene(), tmp_path)
    assert (plan_file.name, elevation_file.name) == ("lift_plan.dxf", "lift_elevation.dxf")
    for file in (plan_file, elevation_file):
        document = ezdxf.readfile(file)
        auditor = document.audit()
        assert not auditor.errors and not auditor.fixes
        assert document.header["$INSUNITS"] == 6  # metres
    space = ezdxf.readfile(plan_file).modelspace()
    (wall,) = space.query('LWPOLYLINE[layer=="obstacles"]')
    corners = np.array([point[:2] for point in wall.get_points()])
    expected = np.unique(WALL.vertices[:, :2], axis=0)
    np.testing.assert_allclose(np.unique(corners, axis=0), expected, atol=1e-9)
    names = [text.dxf.text for text in space.query('TEXT[layer=="obstacles"]')]
    assert names == ["wall, top +8.0 m"]
    measured = [dim.get_measurement() for dim in space.query("DIMENSION")]
    assert measured[0] == pytest.approx(math.hypot(6.0, 12.0), abs=1e-6)


def test_without_ezdxf_there_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ezdxf", None)
    with pytest.raises(NoDxf, match="pip install"):
        write_drawings(scene(), tmp_path)
    assert not list(tmp_path.iterdir())


def test_the_steps_of_the_sequence_add_up_to_the_lift() -> None:
    steps = motion_steps(scene().analysis, scene().positions)
    assert [step.last for step in steps] == list(range(2, len(scene().positions) + 1))
    for before, after in itertools.pairwise(steps):
        assert before.ends == after.begins
    text = " ".join(sentence for step in steps for sentence in step.movements)
    # From Y = -12 to Y = 12 on the +X side: counter-clockwise, to the left.
    turned = sum(int(found) for found in re.findall(r"Slew (\d+)° to the left", text))
    assert "to the right" not in text
    assert turned == pytest.approx(math.degrees(2.0 * math.atan2(12.0, 6.0)), abs=len(steps))


def test_the_cross_section_of_a_bridge_is_the_plane_of_its_trolley() -> None:
    np.testing.assert_allclose(np.abs(across_runway(clearance("overhead"))), [0.0, 1.0], atol=1e-9)


def test_each_rope_of_a_sketch_hangs_from_the_crane_at_its_position() -> None:
    """The trolley of the crane is elsewhere at each of both positions."""
    made = scene()
    for index in range(len(made.positions) - 1):
        sketch = elevation_sketch(made, index).primitives
        for i in (index, index + 1):
            plane = plane_at(made, i)
            moving = _outlines("crane", [plane.flat(body) for body in made.shapes[i].moving])
            for outline in moving:
                assert outline in sketch


def test_headroom_is_told_only_where_all_of_it_was_entered() -> None:
    points = ((-1.0, -0.5, 0.75), (1.2, -0.5, 0.75), (1.0, 0.5, 0.75), (-1.0, 0.5, 0.75))
    angle = math.radians(30.0)
    details = PlanDetails(load=LoadDetails(lifting_points=points), slings=Slings(angle=angle))
    # By the farthest of the points, as the headroom of the checks is.
    assert sling_height(details) == pytest.approx(math.hypot(1.2, 0.5) / math.tan(angle))
    assert rigging_height(details) == sling_height(details)
    longer = replace(details, slings=Slings(angle=angle, length=4.0))
    assert sling_height(longer) == pytest.approx(4.0 * math.cos(angle))
    site = replace(small().site, details=longer)
    assert rigging_stack(site).headroom is None
    known = replace(longer, hook_block_height=1.2, spreader=Spreader(height=0.4))
    # The load is a cube of a metre, its lifting points 0.75 m above its middle.
    headroom = rigging_stack(replace(site, details=known)).headroom
    assert headroom == pytest.approx(1.2 + 0.4 + 4.0 * math.cos(angle) + 1.25)


def test_the_sketch_of_the_rigging_has_the_whole_load_also_above_its_lifting_points() -> None:
    """A load of 2 m, lifted by points 0.3 m above its middle, of which it rises 0.7 m above."""
    points = ((-0.4, 0.0, 0.3), (0.4, 0.0, 0.3))
    details = PlanDetails(
        load=LoadDetails(lifting_points=points, centre=(0.2, 0.0, -0.1)),
        slings=Slings(angle=math.radians(20.0), length=3.0),
    )
    corners = np.array(list(itertools.product((-0.5, 0.5), (-1.0, 1.0), (-1.0, 1.0))))
    site = replace(small().site, load=corners, details=details)
    sheet = rigging_sheet(site, TitleBlock("site", Job(), None, 1, 1))
    page = ET.fromstring(sheet.svg)
    (load,) = (box for box in page.iter(f"{SVG}rect") if box.get("fill") == "#f0a04b")
    left, top, width, height = (float(load.get(key)) for key in ("x", "y", "width", "height"))
    assert height == pytest.approx(2.0 * width, abs=0.01)
    middle = (left + width / 2.0, top + height / 2.0)
    circles = [(float(c.get("cx")), float(c.get("cy")), c) for c in page.iter(f"{SVG}circle")]
    places = [((x - middle[0]) / width, (middle[1] - y) / width) for x, y, _ in circles]
    for expected in ((-0.4, 0.3), (0.4, 0.3), (0.2, -0.1)):
        assert any(np.allclose(place, expected, atol=1e-3) for place in places), expected
    texts = " ".join(text.text or "" for text in page.iter(f"{SVG}text"))
    assert "of which 1.30 m below" in texts


def test_a_zone_and_a_name_that_is_markup_are_drawn_as_what_they_are() -> None:
    analysis = small()
    solids = (
        box("<b>shed</b> & co", (10.0, 15.0), (4.0, 4.0, 3.0), 0.0),
        prism("street", np.array([[-5.0, 5.0], [0.0, 5.0], [0.0, 9.0]]), 0.0, 6.0, zone=True),
    )
    site = replace(analysis.site, solids=solids)
    first = sheets(LiftScene.of(replace(analysis, site=site)))[0]
    texts = [text.text for text in ET.fromstring(first.svg).iter(f"{SVG}text")]
    assert "<b>shed</b> & co, top +3.0 m" in texts
    assert "street, keep out below 6.0 m" in texts


def test_the_hook_is_above_the_load_by_what_the_rigging_says() -> None:
    """Legs of 3 m at 30° from the vertical put it 3 cos 30° above the top of the load; without
    slings it is where the distances are computed with a hook.
    """
    bare = scene()
    slings = Slings(number=4, length=3.0, angle=math.radians(30.0))
    site = replace(small().site, details=PlanDetails(slings=slings))
    slung = LiftScene.of(replace(small(), site=site))
    for i, shape in enumerate(slung.shapes):
        top = float(shape.load[:, 2].max()) - site.ground
        assert slung.hook_height(i) == pytest.approx(top + 3.0 * math.cos(math.radians(30.0)))
        assert bare.hook_height(i) == pytest.approx(float(shape.hook[:, 2].min()) - site.ground)
    texts = [item.text for item in elevation_view(slung).primitives if isinstance(item, Dimension)]
    assert f"hook +{slung.hook_height(0):.2f} m at 1 and 3" in texts


def test_the_ends_of_a_lift_are_named_by_whether_the_load_stands_there() -> None:
    def lift(*phases: str, standing: bool = True) -> Any:
        place = np.array([6.0, -14.0]) if standing else np.array([6.0, -14.0, 3.0])
        site = SimpleNamespace(start=place, goal=np.array([13.0, 9.0]))
        grounded = SimpleNamespace(lift=SimpleNamespace(phases=phases)) if phases else None
        return SimpleNamespace(grounded=grounded, site=site)

    assert end_names(small()) == ("pick-up", "set-down")
    assert end_names(lift("lift-off", "motion", "set-down")) == ("lifted off", "above set-down")
    hangs = lift("motion", "set-down", standing=False)
    assert end_names(hangs) == ("pick-up", "above set-down")
    # Where lift-off and set-down are not simulated, the motion begins and ends above both.
    assert end_names(lift()) == ("above pick-up", "above set-down")


def test_a_roof_of_triangles_is_in_the_elevation_also_where_its_walls_are_not() -> None:
    """A slab from 1 to 1.2 m that is wider than all that jib and load pass over: of its surface
    only level triangles are below them.
    """
    slab = replace(box("slab", (0.0, 0.0), (200.0, 200.0, 0.2), 1.0), parts=())
    site = replace(small().site, solids=(slab,))
    with_slab = LiftScene.of(replace(small(), site=site))
    ((*outlines, name),) = with_slab.solids_in_elevation
    assert isinstance(name, Label) and name.text == "slab"
    heights = np.concatenate([np.array(outline.points)[:, 1] for outline in outlines])
    assert heights.min() == pytest.approx(1.0) and 1.2 <= heights.max() <= 1.26


def test_of_many_obstacles_the_nearest_and_the_zones_are_named_and_all_are_drawn() -> None:
    analysis = small()
    far = [box(f"part {i}", (40.0 + 3.0 * i, 40.0), (1.0, 1.0, 3.0), 0.0) for i in range(20)]
    zone = prism("street", np.array([[-5.0, 45.0], [0.0, 45.0], [0.0, 49.0]]), 0.0, 6.0, zone=True)
    site = replace(analysis.site, solids=(*far, zone, *analysis.site.solids))
    scene = LiftScene.of(replace(analysis, site=site))
    known = {solid.name for solid in analysis.site.solids}
    assert known <= scene.named and "street" in scene.named
    assert len(scene.named) == MAX_NAMED + 1
    drawing = plan_view(scene)
    texts = [one.text for one in drawing.primitives if isinstance(one, Label)]
    assert sum(text.startswith("part ") for text in texts) == MAX_NAMED - len(known)
    outlines = [one for one in drawing.primitives if isinstance(one, Polyline)]
    assert sum(one.layer == "obstacles" for one in outlines) >= 20 + len(known)
    assert any("more are drawn" in note for note in drawing.notes)
