"""Plan and elevation of a lift, from the shapes that its distances are computed from, so that the
drawings show what was judged.

Points are in the frame of the site [m]; in an elevation, to the right and upwards in its plane.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
import shapely

from cranedyn.lifts.judging.analysis import LiftAnalysis
from cranedyn.lifts.judging.drawings.drawing import (
    Arc,
    Dimension,
    Drawing,
    Label,
    Layer,
    Point,
    Polyline,
    Primitive,
    as_point,
    polyline,
)
from cranedyn.lifts.judging.drawings.outlines import (
    CraneShapes,
    crane_shapes,
    hull_of,
    outlines_of,
    rings_of,
)
from cranedyn.lifts.judging.drawings.swept import (
    SweptAreas,
    sampled_rows,
    swept_areas,
    unit_in_plan,
)
from cranedyn.lifts.judging.hook_radius import hook_radius
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.numbered_positions import (
    LoadsAtRest,
    Position,
    loads_at_rest,
    numbered_positions,
)
from cranedyn.lifts.planning.clearance import Clearance, NearestPoints
from cranedyn.lifts.planning.plan_assumptions import in_words
from cranedyn.lifts.planning.rigging import attachment_height, rigging_height
from cranedyn.lifts.planning.solids import Solid

_EDGE = 2.0
"""Distance that is shown around crane, path and obstacles [m]."""

_BEYOND_REACH = 15.0
"""Distance beyond the reach of the crane up to which obstacles are shown whole [m]."""

_DIMENSION_SPACING = 0.05
"""Distance between dimension lines over the height of what is drawn."""

_REACH_SAMPLES = 61
"""Positions of the drive that carries the rope in and out, from which its reach is taken."""

_LEAST_THICKNESS = 0.05
"""Least height at which a part of an obstacle is drawn in an elevation [m]."""

_LEAST_AREA = 1e-4
"""Area of an obstacle in the exclusion zone up to which it only touches the zone [m²]."""

_UNBOUNDED_TOP = 1000.0
"""Height from which on the top of a zone is not told [m]: it is higher than any crane."""

_FAR = 1e4
"""Beyond all that is drawn [m]."""

MAX_NAMED = 12
"""Most obstacles beside zones whose names are on a drawing."""


@dataclass(frozen=True, eq=False)
class LiftScene:
    """What both views show, computed once.

    Attributes:
        analysis: The lift.
        positions: The numbered positions.
        shapes: Crane and load at each of them.
        swept: What the lift sweeps in plan.
        nearest: Nearest points of what hangs and the nearest obstacle; None if there are none, or
            they are of the crane itself.
        stands: Where the load stands before and after.
    """

    analysis: LiftAnalysis
    positions: list[Position]
    shapes: list[CraneShapes]
    swept: SweptAreas
    nearest: NearestPoints | None
    stands: LoadsAtRest

    @classmethod
    def of(cls, analysis: LiftAnalysis) -> LiftScene:
        """Compute what is shown of a lift."""
        lift = analysis.certificate.lift
        positions = numbered_positions(analysis)
        shapes = [crane_shapes(lift.clearance, position.place) for position in positions]
        return cls(
            analysis,
            positions,
            shapes,
            swept_areas(lift),
            _nearest_points(analysis),
            loads_at_rest(analysis),
        )

    @cached_property
    def plan(self) -> Drawing:
        """The plan."""
        return plan_view(self)

    @cached_property
    def elevation(self) -> Drawing:
        """The elevation."""
        return elevation_view(self)

    @cached_property
    def solids_in_plan(self) -> list[list[Primitive]]:
        """The outlines of each obstacle in plan, and last its name."""
        site = self.analysis.site
        return [_plan_of_solid(solid, site.ground) for solid in site.solids]

    @cached_property
    def solids_in_elevation(self) -> list[list[Primitive]]:
        """The outlines of each obstacle in the elevation, and last its name; nothing of one that is
        not shown there.
        """
        return [_elevation_of_solid(self, solid) for solid in self.analysis.site.solids]

    @cached_property
    def named(self) -> frozenset[str]:
        """The obstacles whose names are drawn: the zones, and of the others those that come nearest
        to what hangs, at most `MAX_NAMED`. A building model has hundreds of parts.
        """
        solids = self.analysis.site.solids
        zones = {solid.name for solid in solids if solid.zone}
        distances = self.analysis.certificate.distances
        nearest = sorted(
            (solid.name for solid in solids if not solid.zone),
            key=lambda name: float(distances[name].min()) if name in distances else math.inf,
        )
        return frozenset(zones | {*nearest[:MAX_NAMED]})

    @cached_property
    def in_exclusion_zone(self) -> tuple[str, ...]:
        """Names of the obstacles and zones that the exclusion zone goes through in plan: people or
        services may be in them.
        """
        names = []
        for solid in self.analysis.site.solids:
            area = _shadow(solid, np.eye(3)[:2])
            if area.intersection(self.swept.exclusion).area > _LEAST_AREA:
                names.append(solid.name)
        return tuple(names)

    def with_names(self, solids: Sequence[Sequence[Primitive]]) -> list[Primitive]:
        """Return the outlines of all obstacles, with the names of those in `named`.

        Args:
            solids: `solids_in_plan` or `solids_in_elevation`.
        """
        primitives: list[Primitive] = []
        for solid, outlines in zip(self.analysis.site.solids, solids, strict=True):
            primitives += outlines if solid.name in self.named else outlines[:-1]
        return primitives

    @property
    def clearance(self) -> Clearance:
        """Crane and site."""
        return self.analysis.certificate.lift.clearance

    @property
    def centres(self) -> np.ndarray:
        """Centres of the load along the planned motion in the frame of the site, shape (k, 3)."""
        lift = self.analysis.certificate.lift
        places = lift.timed.places[sampled_rows(lift)]
        return self.analysis.site.to_site(lift.clearance.point(places))

    def centres_between(self, index: int) -> np.ndarray:
        """Return the centres of the load from a position to the next one, shape (k, 3)."""
        lift = self.analysis.certificate.lift
        first = self.positions[index].row
        last = self.positions[index + 1].row
        places = lift.timed.places[first : last + 1]
        return self.analysis.site.to_site(lift.clearance.point(places))

    def radius(self, index: int) -> float | None:
        """Return the distance in plan of the load from the slew axis at a position [m]; None for a
        crane that does not turn.
        """
        return hook_radius(self.clearance, self.positions[index].place)

    def hook_height(self, index: int) -> float:
        """Return the height of the saddle of the hook above the ground at a position [m]: from the
        lifting points upwards by the rigging as entered, or else the underside of the hook that the
        distances are computed with.
        """
        ground = self.analysis.site.ground
        details = self.analysis.site.details
        rigging = rigging_height(details)
        if rigging is None:
            return float(self.shapes[index].hook[:, 2].min()) - ground
        attached = attachment_height(details, self.clearance.bodies.load)
        return float(self.positions[index].centre[2]) + attached + rigging - ground

    @cached_property
    def top(self) -> float:
        """Height up to which the crane and all obstacles but zones reach [m]."""
        bodies = [*self.shapes[0].standing, *self.shapes[0].moving]
        bodies += [solid.vertices for solid in self.analysis.site.solids if not solid.zone]
        return max(float(body[:, 2].max()) for body in bodies)

    @property
    def highest(self) -> int:
        """Index of the position at which the load is highest."""
        return int(np.argmax([position.centre[2] for position in self.positions]))

    @property
    def farthest(self) -> int | None:
        """Index of the position at which the load is farthest out; None for a crane that does not
        turn.
        """
        radii = [self.radius(i) for i in range(len(self.positions))]
        known = [radius for radius in radii if radius is not None]
        return int(np.argmax(known)) if known else None


def _nearest_points(analysis: LiftAnalysis) -> NearestPoints | None:
    """Return the nearest points of the certified pair of bodies, in the frame of the crane."""
    certificate = analysis.certificate
    clearance = certificate.lift.clearance
    row = int(np.abs(certificate.run.t - certificate.nearest_t).argmin())
    q = certificate.run.q[row]
    pairs = []
    for pair in clearance.nearest_points(q, math.inf):
        distance = pair.margin + pair.required
        # The certificate has the distance to 1 mm; a pair beside it may be of the same body.
        is_the_pair = abs(distance - certificate.nearest.distance) < 1e-3
        if pair.body == certificate.nearest.body and is_the_pair:
            pairs.append(pair)
    return min(pairs, key=lambda pair: pair.margin) if pairs else None


# --- plan -----------------------------------------------------------------------------------------


def plan_view(scene: LiftScene) -> Drawing:
    """Return the plan of a lift in the coordinates of the site."""
    site = scene.analysis.site
    primitives: list[Primitive] = []
    primitives += scene.with_names(scene.solids_in_plan)
    primitives += _area("exclusion", scene.swept.exclusion)
    primitives += _area("envelope", scene.swept.envelope)
    primitives += _slewing(scene)
    primitives += _crane_in_plan(scene)
    primitives.append(polyline("path", scene.centres))
    for i, position in enumerate(scene.positions):
        load = hull_of(scene.shapes[i].load[:, :2])
        primitives += _area("load", load)
        primitives.append(Label("load", as_point(position.centre), str(position.number), True))
    primitives += _plan_dimensions(scene)
    low, high = _plan_frame(scene, primitives)
    north = None
    if site.details.ground.north is not None:
        # The bearing of the Y axis turns clockwise from north, angles of a drawing turn back.
        north = math.pi / 2.0 + site.details.ground.north
    return Drawing(
        "plan",
        "Plan",
        tuple(primitives),
        low,
        high,
        north,
        notes=(*_position_notes(scene), *_plan_notes(scene)),
    )


def _plan_of_solid(solid: Solid, ground: float) -> list[Primitive]:
    """Return the outline of an obstacle in plan with its name and how high it reaches."""
    layer: Layer = "zones" if solid.zone else "obstacles"
    area = _shadow(solid, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    drawn = _area(layer, area)
    top = float(solid.vertices[:, 2].max()) - ground
    bottom = float(solid.vertices[:, 2].min()) - ground
    text = solid.name
    if solid.zone:
        text += ", keep out"
        text += f" below {top:.1f} m" if top < _UNBOUNDED_TOP else ""
    else:
        text += f", top +{top:.1f} m"
    if bottom > 0.05:
        text += f", from +{bottom:.1f} m"
    return [*drawn, Label(layer, as_point(_inside(area)), text)]


def _inside(area: shapely.Geometry) -> np.ndarray:
    """Return a point inside of an area, shape (2,)."""
    point = area.representative_point()
    return np.array([point.x, point.y])


def _shadow(solid: Solid, axes: np.ndarray) -> shapely.Geometry:
    """Return what is seen of a solid along the normal of two axes, as an area.

    Args:
        solid: The solid.
        axes: Axes to the right and upwards, shape (2, 3).
    """
    if solid.parts:
        return shapely.union_all([hull_of(corners @ axes.T) for corners in solid.parts])
    flat = (solid.vertices @ axes.T)[solid.triangles]
    triangles = shapely.polygons(flat)
    seen = triangles[shapely.area(triangles) > 1e-9]
    return shapely.union_all(seen, grid_size=1e-6)


def _area(layer: Layer, area: shapely.Geometry) -> list[Primitive]:
    """Return the closed lines around an area."""
    simple = area.simplify(0.01)
    return [polyline(layer, ring, closed=True) for ring in rings_of(simple)]


def _outlines(layer: Layer, bodies: list[np.ndarray]) -> list[Primitive]:
    """Return the closed lines around bodies of the crane, points in a view of shape (n, 2) each."""
    return [polyline(layer, ring, closed=True) for ring in outlines_of(bodies)]


def _slewing(scene: LiftScene) -> list[Primitive]:
    """Return the circles of the reach about the slew axis, and the sector that the lift slews
    through; nothing for a crane that does not turn.
    """
    axis = scene.shapes[0].axis
    bearings = scene.swept.bearings
    if axis is None or bearings is None:
        return []
    centre = as_point(axis)
    least, largest = reach_of(scene)
    first = float(bearings.min())
    last = float(bearings.max())
    drawn: list[Primitive] = []
    for radius in (least, largest):
        if radius > 0.1:
            drawn.append(Arc("reach", centre, radius))
    if last - first > math.radians(0.5):
        drawn.append(Arc("path", centre, 0.35 * largest, first, last))
        for bearing in (first, last):
            end = axis[:2] + largest * np.array([math.cos(bearing), math.sin(bearing)])
            drawn.append(polyline("reach", np.array([axis[:2], end])))
        middle = (first + last) / 2.0
        at = axis[:2] + 0.35 * largest * np.array([math.cos(middle), math.sin(middle)])
        drawn.append(Label("path", as_point(at), f"slews {math.degrees(last - first):.0f}°"))
    bearing = first - math.radians(12.0)
    at = axis[:2] + largest * np.array([math.cos(bearing), math.sin(bearing)])
    drawn.append(Label("reach", as_point(at), f"reach {largest:.1f} m"))
    return drawn


def reach_of(scene: LiftScene) -> tuple[float, float]:
    """Return the least and the largest distance in plan of the load from the slew axis [m], by the
    range of the drive that carries the rope in and out.
    """
    clearance = scene.clearance
    turning = clearance.turning
    assert turning is not None
    axis = scene.shapes[0].axis
    assert axis is not None
    # Two drives carry the upper end of the rope: one turns it, the other moves it in and out. One
    # that slides and stands before the slew moves the slew axis itself, and no radius.
    other = 1 - turning
    joint = clearance.drive_joints[other]
    places = np.tile(scene.positions[0].place, (_REACH_SAMPLES, 1))
    if clearance.crane.layout.driven[other].kind == "revolute" or turning == 0:
        low = float(clearance.crane.lower[joint])
        high = float(clearance.crane.upper[joint])
        places[:, other] = np.linspace(low, high, _REACH_SAMPLES)
    centres = clearance.site.to_site(clearance.point(places))
    radii = np.linalg.norm((centres - axis)[:, :2], axis=1)
    return float(radii.min()), float(radii.max())


def _crane_in_plan(scene: LiftScene) -> list[Primitive]:
    """Return the outlines of the crane at the pick-up, and of what moves at the set-down."""
    first = scene.shapes[0]
    last = scene.shapes[-1]
    drawn: list[Primitive] = []
    drawn += _outlines("crane later", [body[:, :2] for body in last.moving])
    for bodies in (first.standing, first.moving):
        drawn += _outlines("crane", [body[:, :2] for body in bodies])
    if first.axis is not None:
        drawn.append(Label("crane", as_point(first.axis), "slew axis"))
    return drawn


def _plan_dimensions(scene: LiftScene) -> list[Primitive]:
    """Return radii, or the ways of bridge and trolley, and the least distance."""
    drawn: list[Primitive] = []
    if scene.farthest is not None:
        told = {i: scene.positions[i].name for i in (0, len(scene.positions) - 1)}
        told.setdefault(scene.farthest, "farthest")
        for i, name in sorted(told.items()):
            axis = scene.shapes[i].axis
            assert axis is not None
            start = as_point(axis)
            text = f"R {scene.radius(i):.2f} m, {name}"
            drawn.append(Dimension("dimensions", start, as_point(scene.shapes[i].centre), text))
    else:
        drawn += _way_dimensions(scene)
    if scene.nearest is not None:
        on_body, on_obstacle = _on_site(scene, scene.nearest)
        start, end = as_point(on_body), as_point(on_obstacle)
        drawn.append(Polyline("dimensions", (start, end)))
        middle = ((start[0] + end[0]) / 2.0, (start[1] + end[1]) / 2.0)
        drawn.append(Label("dimensions", middle, _nearest_text(scene)))
    return drawn


def _way_dimensions(scene: LiftScene) -> list[Primitive]:
    """Return the ways along both axes of the site from pick-up to set-down."""
    start = as_point(scene.positions[0].centre)
    end = as_point(scene.positions[-1].centre)
    corner = (end[0], start[1])
    along = abs(end[0] - start[0])
    across = abs(end[1] - start[1])
    drawn: list[Primitive] = []
    if along > 0.05:
        drawn.append(Dimension("dimensions", start, corner, f"{along:.2f} m"))
    if across > 0.05:
        drawn.append(Dimension("dimensions", corner, end, f"{across:.2f} m"))
    return drawn


def _on_site(scene: LiftScene, pair: NearestPoints) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest points on body and obstacle in the frame of the site [m]."""
    to_site = scene.analysis.site.to_site
    return to_site(pair.on_body), to_site(pair.on_obstacle)


def _nearest_text(scene: LiftScene) -> str:
    """Return the least distance of the certificate in words."""
    nearest = scene.analysis.certificate.nearest
    return f"least {nearest.distance:.2f} m, {nearest.body} to {nearest.obstacle}"


def _position_notes(scene: LiftScene) -> list[str]:
    """Return a line for each position: what it is, radius or coordinates, heights."""
    ground = scene.analysis.site.ground
    lines = []
    for i, position in enumerate(scene.positions):
        radius = scene.radius(i)
        x, y, _ = position.centre
        where = f"x {x:.1f}, y {y:.1f} m" if radius is None else f"R {radius:.1f} m"
        under = float(scene.shapes[i].load[:, 2].min()) - ground
        lines.append(
            f"{position.number} {position.name}: {where}, hook +{scene.hook_height(i):.1f} m, "
            f"load's underside +{under:.1f} m"
        )
    for load, i in zip(scene.stands, (0, len(scene.positions) - 1), strict=True):
        if load is not None:
            number = scene.positions[i].number
            line = (
                f"{load.name}, below {number}: R {scene.radius(i):.1f} m, the load stands, "
                f"underside {_height(load.underside - ground)}"
            )
            lines.insert(0 if i == 0 else len(lines), line)
    return lines


def _height(value: float) -> str:
    """Return a height above ground to read [m]; what rounds to zero has no minus."""
    return f"{round(value, 1) + 0.0:+.1f} m"


def _plan_notes(scene: LiftScene) -> list[str]:
    """Return sentences that say what the lines of the plan are."""
    site = scene.analysis.site
    notes = [
        f"Envelope (dashed): load and hook with up to {math.degrees(site.swing):.1f}° of swing.",
        "Exclusion zone (red): the envelope, and as far as a part that comes off may fly, up to "
        f"{scene.swept.farthest_throw:.1f} m, without bouncing, rolling or wind. Whether that is "
        "enough is not judged.",
    ]
    if scene.nearest is not None:
        notes.append("The least distance is one in space; its line is what is seen of it.")
    unnamed = len(site.solids) - len(scene.named)
    if unnamed:
        notes.append(
            f"Named are the zones and the {MAX_NAMED} obstacles nearest to what hangs; {unnamed} "
            "more are drawn."
        )
    entered = site.details.exclusion
    notes.append(f"How it is kept clear: {(entered or 'not entered').rstrip('.')}.")
    if site.details.ground.north is None:
        notes.append("North was not entered; the arrows are the axes of the site.")
    return notes


def _plan_frame(scene: LiftScene, primitives: list[Primitive]) -> tuple[Point, Point]:
    """Return the corners of the area that is shown: all that is drawn, but of obstacles only as far
    as a little beyond the reach.
    """
    _, largest = scene.clearance.reach
    centre = scene.positions[0].centre if scene.shapes[0].axis is None else scene.shapes[0].axis
    limit = _BEYOND_REACH + largest
    return frame_of(primitives, as_point(centre), limit)


def frame_of(primitives: list[Primitive], centre: Point, limit: float) -> tuple[Point, Point]:
    """Return the corners of a box around lines, those of obstacles and zones only as far as a limit
    from a centre [m]. Circles of the reach are cut off by it.
    """
    points = []
    for primitive in primitives:
        if isinstance(primitive, Dimension):
            points.append(np.array(primitive.line))
            continue
        if not isinstance(primitive, Polyline) or primitive.layer in ("reach", "ground"):
            continue
        corners = np.array(primitive.points)
        if primitive.layer in ("obstacles", "zones"):
            corners = np.clip(corners, np.array(centre) - limit, np.array(centre) + limit)
        points.append(corners)
    around = np.concatenate(points)
    return as_point(around.min(axis=0) - _EDGE), as_point(around.max(axis=0) + _EDGE)


def plan_sketch(scene: LiftScene, index: int) -> Drawing:
    """Return a sketch in plan of the step from a position to the next one."""
    primitives: list[Primitive] = []
    for outlines in scene.solids_in_plan:
        primitives += outlines[:-1]  # without its name
    shape = scene.shapes[index + 1]
    for bodies in (shape.standing, shape.moving):
        primitives += _outlines("crane", [body[:, :2] for body in bodies])
    primitives.append(polyline("path", scene.centres_between(index)))
    for i in (index, index + 1):
        primitives += _area("load", hull_of(scene.shapes[i].load[:, :2]))
        position = scene.positions[i]
        primitives.append(Label("load", as_point(position.centre), str(position.number), True))
    low, high = _plan_frame(scene, primitives)
    return Drawing("plan sketch", "Plan", tuple(primitives), low, high)


# --- elevation ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ElevationPlane:
    """A vertical plane at a position.

    Attributes:
        origin: The point of the site from which the way to the right counts [m], shape (3,).
        right: Direction to the right in plan, a unit vector of the site, shape (2,).
    """

    origin: np.ndarray
    right: np.ndarray

    def flat(self, points: np.ndarray) -> np.ndarray:
        """Return points of the site [m], shape (n, 3), in the plane, shape (n, 2)."""
        along = (points - self.origin)[..., :2] @ self.right
        return np.stack([along, points[..., 2]], axis=-1)


def plane_at(scene: LiftScene, index: int) -> ElevationPlane:
    """Return the plane of the elevation at a position: that of the jib for a crane that turns, and
    the vertical plane of the last drive before the hoist, such as a trolley, for another one.
    """
    shape = scene.shapes[index]
    if shape.axis is not None:
        return ElevationPlane(shape.axis, unit_in_plan(shape.centre - shape.axis))
    return ElevationPlane(scene.analysis.site.foot, across_runway(scene.clearance))


def standing_outlines(scene: LiftScene) -> list[np.ndarray]:
    """Return the bodies that stand of the crane as an elevation shows them, shape (n, 2) each: of a
    crane that turns square on, along that of their own axes which is nearest to the plane of the
    first position. A square tower or base would look up to √2 times as wide in the plane of a jib
    that points over its corner, and that plane is another one for each position.
    """
    shape = scene.shapes[0]
    plane = plane_at(scene, 0)
    site = scene.analysis.site
    if shape.axis is None:
        return [plane.flat(body) for body in shape.standing]
    of_crane = _square_on(plane, site.crane_to_site[:2, :2])
    of_base = of_crane
    if site.base is not None and not site.base.turns_with_crane:
        of_base = _square_on(plane, np.eye(2))
    flat = [of_crane.flat(body) for body in shape.standing]
    if site.base is not None:
        flat[-1] = of_base.flat(shape.standing[-1])  # see `crane_shapes`
    return flat


def _square_on(plane: ElevationPlane, axes: np.ndarray) -> ElevationPlane:
    """Return the plane along that of two axes in plan which is nearest to a plane.

    Args:
        plane: The plane.
        axes: The axes as columns, unit vectors of the site, shape (2, 2).
    """
    along = plane.right @ axes
    nearest = int(np.abs(along).argmax())
    sign = 1.0 if along[nearest] >= 0.0 else -1.0
    return ElevationPlane(plane.origin, sign * axes[:, nearest])


def across_runway(clearance: Clearance) -> np.ndarray:
    """Return the direction in plan in which the second drive moves the load of a crane that does
    not turn, as a unit vector of the site, shape (2,).
    """
    carriers = clearance.drive_joints[:2]
    middle = (clearance.crane.lower[carriers] + clearance.crane.upper[carriers]) / 2.0
    place = np.array([*middle, clearance.shortest_cable])
    moved = place + np.array([0.0, 0.01, 0.0])
    first, second = clearance.site.to_site(clearance.point(np.array([place, moved])))
    right = unit_in_plan(second - first)
    # To the right is towards +X of the site, or else towards +Y.
    leading = right[0] if abs(right[0]) > 1e-6 else right[1]
    return right if leading > 0.0 else -right


def elevation_view(scene: LiftScene) -> Drawing:
    """Return the elevation of a lift, heights in those of the site.

    For a crane that turns, each position is turned about the slew axis into one plane, with what
    jib and load pass over, so that radii and heights are true. For another one it is the cross
    section of its runway, on which all is projected.
    """
    site = scene.analysis.site
    turns = scene.swept.passed is not None
    primitives: list[Primitive] = []
    primitives += scene.with_names(scene.solids_in_elevation)
    primitives += _crane_in_elevation(scene)
    primitives.append(polyline("path", _flat_path(scene)))
    for load, index in zip(scene.stands, (0, len(scene.positions) - 1), strict=True):
        if load is not None:
            flat = plane_at(scene, index).flat(load.corners)
            primitives += _area("load", hull_of(flat))
            primitives.append(Label("load", as_point(flat.mean(axis=0)), load.name))
    for i, position in enumerate(scene.positions):
        plane = plane_at(scene, i)
        shape = scene.shapes[i]
        primitives += _area("load", hull_of(plane.flat(shape.load)))
        primitives += _area("load", hull_of(plane.flat(shape.hook)))
        primitives.append(_rope(plane, shape))
        centre = as_point(plane.flat(position.centre))
        primitives.append(Label("load", centre, str(position.number), True))
    primitives += _elevation_dimensions(scene, primitives)

    low, high = _frame_with_ground(scene, primitives)
    primitives.append(
        Label("ground", (low[0] + 3.0, site.ground - 0.5 * _EDGE), f"ground {site.ground:+.1f} m")
    )
    arm = "boom" if LoadJoints.of(scene.analysis.crane).has_boom else "jib"
    title = f"Elevation in the plane of the {arm}" if turns else "Elevation, cross section"
    axes = ("radius", "height") if turns else ("across", "height")
    notes = (*_position_notes(scene), *_elevation_notes(arm, turns=turns))
    return Drawing("elevation", title, tuple(primitives), low, high, None, axes, notes)


def elevation_sketch(scene: LiftScene, index: int) -> Drawing:
    """Return a sketch in elevation of the step from a position to the next one."""
    primitives: list[Primitive] = []
    for outlines in scene.solids_in_elevation:
        primitives += outlines[:-1]  # without its name
    primitives += _outlines("crane", standing_outlines(scene))
    for i in (index, index + 1):
        plane = plane_at(scene, i)
        shape = scene.shapes[i]
        # At both ends, since a boom that luffs is elsewhere at each, and its rope hangs from it.
        primitives += _outlines("crane", [plane.flat(body) for body in shape.moving])
        primitives += _area("load", hull_of(plane.flat(shape.load)))
        primitives.append(_rope(plane, shape))
        centre = as_point(plane.flat(shape.centre))
        primitives.append(Label("load", centre, str(scene.positions[i].number), True))
    low, high = _frame_with_ground(scene, primitives)
    return Drawing("elevation sketch", "Elevation", tuple(primitives), low, high)


def _rope(plane: ElevationPlane, shape: CraneShapes) -> Polyline:
    """Return the rope from its upper end to the top of the hook, straight below it."""
    rope = np.array([shape.pivot, [*shape.pivot[:2], shape.hook[:, 2].max()]])
    return polyline("load", plane.flat(rope))


def _frame_with_ground(scene: LiftScene, primitives: list[Primitive]) -> tuple[Point, Point]:
    """Put the ground below lines, and return the corners of the area around them that is shown."""
    ground = scene.analysis.site.ground
    reach = scene.clearance.reach[1]
    low, high = frame_of(primitives, (0.0, ground), _BEYOND_REACH + reach)
    low = (low[0], min(low[1], ground - _EDGE))
    line = np.array([[low[0], ground], [high[0], ground]])
    primitives.insert(0, polyline("ground", line))
    return low, high


def _elevation_notes(arm: str, *, turns: bool) -> list[str]:
    """Return sentences that say how the elevation is projected."""
    if turns:
        return [
            "All positions are turned about the slew axis into one plane. Of the obstacles those "
            f"parts are drawn that {arm} or load pass over or come near to, as boxes from their "
            "least to their largest radius there. What stands elsewhere, or behind the crane, is "
            "on the plan only. What stands of the crane is drawn square on; its widths are those "
            "of the model."
        ]
    return ["All is projected along the runway, also what stands before or behind the load."]


def _flat_path(scene: LiftScene) -> np.ndarray:
    """Return the way of the load's centre in the elevation [m], shape (k, 2)."""
    if scene.swept.turned_path is None:
        return plane_at(scene, 0).flat(scene.centres)
    return scene.swept.turned_path


def _elevation_of_solid(scene: LiftScene, solid: Solid) -> list[Primitive]:
    """Return an obstacle in the elevation with its name; nothing if a crane that turns does not
    pass near it.
    """
    layer: Layer = "zones" if solid.zone else "obstacles"
    if scene.swept.passed is None:
        right = plane_at(scene, 0)
        axes = np.array([[*right.right, 0.0], [0.0, 0.0, 1.0]])
        area = _shadow(solid, axes)
        area = shapely.affinity.translate(area, -float(right.origin[:2] @ right.right), 0.0)
    else:
        area = _turned_into_plane(scene, solid)
    if solid.zone:
        # One without a top would make all else small.
        area = area.intersection(shapely.box(-_FAR, -_FAR, _FAR, scene.top))
    if area.is_empty:
        return []
    return [*_area(layer, area), Label(layer, as_point(_inside(area)), solid.name)]


def _turned_into_plane(scene: LiftScene, solid: Solid) -> shapely.Geometry:
    """Return what jib and load pass over of a solid, turned about the slew axis: of each convex
    part, or triangle, a box from its least to its largest radius there, as high as the part.
    """
    axis = scene.shapes[0].axis
    passed = scene.swept.passed
    assert axis is not None and passed is not None
    foot = shapely.Point(axis[:2])
    parts = solid.parts or tuple(solid.vertices[triangle] for triangle in solid.triangles)
    boxes = []
    for corners in parts:
        under = hull_of(corners[:, :2]).intersection(passed)
        if under.is_empty:
            continue
        largest = float(np.linalg.norm(shapely.get_coordinates(under) - axis[:2], axis=1).max())
        least = float(under.distance(foot))
        low, high = float(corners[:, 2].min()), float(corners[:, 2].max())
        # A level triangle of a roof is seen as a line, whatever the walls below it.
        high = max(high, low + _LEAST_THICKNESS)
        if largest - least > 1e-3:
            boxes.append(shapely.box(least, low, largest, high))
    return shapely.union_all(boxes)


def _crane_in_elevation(scene: LiftScene) -> list[Primitive]:
    """Return the outline of the crane at the pick-up, and at the set-down where it differs."""
    first = scene.shapes[0]
    last = scene.shapes[-1]
    plane = plane_at(scene, 0)
    last_plane = plane_at(scene, len(scene.shapes) - 1)
    drawn = _outlines("crane later", [last_plane.flat(body) for body in last.moving])
    drawn += _outlines("crane", [plane.flat(body) for body in first.moving])
    drawn += _outlines("crane", standing_outlines(scene))
    return drawn


def _elevation_dimensions(scene: LiftScene, drawn_before: list[Primitive]) -> list[Primitive]:
    """Return hook heights, the length of the jib or boom, and the least distance."""
    ground = scene.analysis.site.ground
    drawn: list[Primitive] = []
    # Heights stand to the right of all that is drawn, one beside the other, the lowest first;
    # positions with the same height share one.
    low, high = frame_of(drawn_before, (0.0, ground), _BEYOND_REACH + scene.clearance.reach[1])
    spacing = _DIMENSION_SPACING * (high[1] - low[1])
    told: dict[str, list[int]] = {}
    for i in sorted({0, scene.highest, len(scene.positions) - 1}, key=scene.hook_height):
        told.setdefault(f"{scene.hook_height(i):.2f}", []).append(i)
    for k, (height, indices) in enumerate(told.items()):
        first = indices[0]
        plane = plane_at(scene, first)
        along = float(plane.flat(scene.shapes[first].hook)[:, 0].min())
        numbers = in_words([str(scene.positions[i].number) for i in sorted(indices)])
        drawn.append(
            Dimension(
                "dimensions",
                (along, ground),
                (along, ground + scene.hook_height(first)),
                f"hook +{height} m at {numbers}",
                offset=-(high[0] + k * spacing - along),
            )
        )
    drawn += _jib_dimension(scene)
    if scene.nearest is not None:
        # In the plane of the numbered position that is nearest in time.
        t = scene.analysis.certificate.nearest_t
        index = int(np.argmin([abs(position.t - t) for position in scene.positions]))
        on_body, on_obstacle = _on_site(scene, scene.nearest)
        plane = plane_at(scene, index)
        start, end = as_point(plane.flat(on_body)), as_point(plane.flat(on_obstacle))
        drawn.append(Polyline("dimensions", (start, end)))
        drawn.append(Label("dimensions", start, _nearest_text(scene)))
    return drawn


def _jib_dimension(scene: LiftScene) -> list[Primitive]:
    """Return the length of a jib from the slew axis to its tip, or of a boom from its joint to the
    upper end of the rope; of a crane on two rails their distance, where it is entered.
    """
    site = scene.analysis.site
    shape = scene.shapes[0]
    plane = plane_at(scene, 0)
    clearance = scene.clearance
    entered = site.details.crane.jib_length
    if shape.axis is None:
        return _span_dimension(scene)
    other = 1 - (clearance.turning or 0)
    if clearance.crane.layout.driven[other].kind == "revolute":
        foot = _joint_origin(clearance, scene.positions[0].place, other)
        length = float(np.linalg.norm(shape.pivot - foot))
        start, end = as_point(plane.flat(foot)), as_point(plane.flat(shape.pivot))
        text = f"boom {length:.2f} m, joint to rope"
    else:
        corners = plane.flat(np.concatenate(list(shape.moving)))
        tip = float(corners[:, 0].max())
        top = float(corners[:, 1].max())
        start, end = (0.0, top), (tip, top)
        text = f"jib {tip:.2f} m from the slew axis, as modelled"
    if entered is not None:
        text += f"; entered {entered:.2f} m"
    return [Dimension("dimensions", start, end, text, offset=1.5)]


def _span_dimension(scene: LiftScene) -> list[Primitive]:
    """Return the distance of both rails of a runway; nothing if none was entered."""
    site = scene.analysis.site
    if site.runway is None:
        return []
    plane = plane_at(scene, 0)
    joint = int(scene.clearance.drive_joints[0])
    travel = np.array(scene.clearance.crane.layout.joints[joint].axis)
    left = np.array([-travel[1], travel[0], 0.0])
    rails = site.to_site(np.array([left * rail for rail in site.runway.rails]))
    height = float(max(body[:, 2].max() for body in scene.shapes[0].moving))
    low, high = sorted(plane.flat(rails)[:, 0].tolist())
    span = high - low
    text = f"rails {span:.2f} m"
    return [Dimension("dimensions", (low, height), (high, height), text, offset=1.5)]


def _joint_origin(clearance: Clearance, place: np.ndarray, drive: int) -> np.ndarray:
    """Return the origin of the joint of a drive at a place, in the frame of the site [m]."""
    data = clearance.crane.model.createData()
    pin.forwardKinematics(clearance.crane.model, data, clearance.q(place))
    joint = int(clearance.drive_joints[drive])
    return clearance.site.to_site(data.oMi[joint + 1].translation)
