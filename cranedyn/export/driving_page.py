"""A page in which one drives the crane: compiled to WebAssembly, in one file that needs no network.

The physics is that of `simulate` with frequency converters (``drive="velocity"``), from the same
trace as the compiled engine. The assistances of the operator are designed in Python, see
`browser_crane`, and evaluated in the page.

`page_data` collects all numbers that the page needs, and `page_html` puts them with the scripts of
``templates/page`` into one HTML file. There ``run.js`` steps the crane in a worker, ``scene.js``
draws it, and ``page.js`` connects both with the operator; ``types.d.ts`` has the types of the data.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from markupsafe import Markup
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cranedyn.command import command_line, open_line, side_thread
from cranedyn.data.files import with_ending
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.dynamics.bodies import bodies_of_model
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.equations_of_motion import payload_position
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.errors import DataError
from cranedyn.export.browser_crane import (
    DT,
    PERIOD,
    Slider,
    assist_data,
    assistances,
    is_tower,
    kernel_data,
    own_data,
    swing_period,
    usual_limits,
    variations,
)
from cranedyn.export.exercises import (
    SWING,
    Exercise,
    exercises,
    lift_exercise,
    simple_exercises,
)
from cranedyn.export.target import check_free, name_default_rates, new_file
from cranedyn.interfaces import Controller
from cranedyn.lifts.judging.chart import RatedLoads, read_chart
from cranedyn.lifts.planning.lift import refuse_contradictions
from cranedyn.lifts.planning.site import DescribedCrane, Site
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.lifts.planning.solids import Solid
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options, crane_words
from cranedyn.plotting.html import render
from cranedyn.plotting.style import distinct_colours
from cranedyn.recording.shapes import Shape, rope_line, shapes

TARGET = "FILE"
"""What the command line calls the target of the export."""

EXAMPLE = "crane.html"
"""Example of a target, for the help of the command line."""

DRAG = 1.2
"""Drag coefficient of the load as a box."""

UNKNOWN_LOAD = 1.0
"""Edge of the cube that stands for a load whose size nothing says [m]."""

SHORT_ROPE = 5.0
"""Distance from pivot to load below which that cube is smaller in proportion [m]."""

LOAD_COLOUR = (0.95, 0.17, 0.02, 1.0)
"""Colour of a load whose colour nothing says, red, green, blue and alpha: that of the crane of this
project."""

MAX_TRIANGLES = 15_000
"""Largest number of triangles of all meshes together, so that a page has less than 1 MB."""

FINEST_CELL = 1e-3
"""Edge of the smallest cells in which corners of meshes are merged [m]."""

UNBOUNDED = 1e9
"""Number that stands for infinity in the data of a page, since JSON has none."""

_TEMPLATES = Path(__file__).with_name("templates") / "page"
"""Folder of the page's HTML, style and scripts."""


class Visual(NamedTuple):
    """A shape that moves with a joint.

    Attributes:
        joint: Index of the joint; -1 for the world.
        shape: The shape, about the origin and along the axes of its own frame.
        placement: Placement of that frame in the frame of the joint.
    """

    joint: int
    shape: Shape
    placement: pin.SE3


def export(
    file: str | Path,
    crane: Crane,
    *,
    site: Site | None = None,
    chart: RatedLoads | None = None,
    meshes: str | Path | None = None,
    controller: Controller | None = None,
) -> Path:
    """Write a page in which one drives a crane by keyboard, gamepad or mouse.

    Args:
        file: New file, ending in .html.
        crane: The crane, loaded with the values of the site where there is one.
        site: Obstacles about the crane; None for none.
        chart: Rated loads of a tower crane; None for none.
        meshes: Folder of the mesh files of the crane; None draws sticks in their places.
        controller: A linear controller of your own, which the operator can choose as the
            assistance *Own*; None for none. It commands rates (``drive="velocity"``) with the
            control period of the page, about the setpoint of the run, which are positions to which
            the sticks lead.

    Raises:
        DataError: If the ending is not .html, the file exists or cannot be written, a mesh cannot
            be read, or a page cannot run the controller.
        MissingRole: If there is a chart, and the crane does not slew.
        ModelError: If the code would not do what Pinocchio does.
    """
    file = with_ending(file, ".html")
    check_free(file)
    text = page_html(crane, site, chart, meshes, controller)
    with new_file(file) as draft:
        draft.write_text(text, "utf-8")
    return file


def page_html(
    crane: Crane,
    site: Site | None = None,
    chart: RatedLoads | None = None,
    meshes: str | Path | None = None,
    controller: Controller | None = None,
) -> str:
    """Return the page as HTML, see `page_data` for the arguments and errors."""
    content = page_data(crane, site, chart, meshes, controller)
    data = json.dumps(content, separators=(",", ":"), allow_nan=False)
    # A script element ends at the first "</script", also where that stands in a text of the JSON.
    return render(
        _TEMPLATES / "page.html",
        page_style=_source("style.css"),
        data=Markup(data.replace("<", "\\u003c")),
        kernel=_source("kinematics.js", "kernel.js", "assist.js", "run.js", "worker.js"),
        script=_source("kinematics.js", "scene.js", "input.js", "page.js"),
    )


def _source(*names: str) -> Markup:
    """Return files of the page's own style and scripts one after the other, as they are."""
    return Markup("\n".join((_TEMPLATES / name).read_text("utf-8") for name in names))


def page_data(
    crane: Crane,
    site: Site | None = None,
    chart: RatedLoads | None = None,
    meshes: str | Path | None = None,
    controller: Controller | None = None,
) -> dict[str, Any]:
    """Return all that the page needs of a crane and its site, for JSON.

    Args:
        crane: The crane.
        site: Obstacles about it; None for none.
        chart: Rated loads; None for none.
        meshes: Folder of its mesh files; None for sticks.
        controller: A linear controller of the user's own, see `export`; None for none.

    Raises:
        MissingRole, DataError, ModelError: As `export`.
    """
    layout = crane.layout
    drives = converters(crane)
    if chart is not None:
        layout.role("slew", "A load chart")
    own = None if controller is None else own_data(crane, drives, controller)
    variants = variations(crane, drives)
    # Both take many seconds. LLVM releases the lock of the interpreter while it compiles, so the
    # exercises are planned meanwhile.
    with side_thread(kernel_data, crane, drives, variants) as kernel:
        planned = _exercises(crane, drives, site)
    rotation = np.eye(3)
    translation = np.zeros(3)
    obstacles = []
    load = None
    if site is not None:
        # Obstacles and goals are told in the frame of the crane.
        rotation, translation = _site_to_crane(site)
        obstacles = [solid.moved(rotation, translation) for solid in site.solids]
        load = site.load
        if planned:
            crane = replace(crane, start=planned[0].start)
    visuals = list(_visuals(crane, load, meshes))
    box = _load_box(crane, load, visuals)
    crane_data = _crane_data(crane, drives)
    crane_data["load"] = box.tolist()
    crane_data["shapes"] = list(_shape_data(crane, visuals))
    sliders = [*(slider for slider, *_ in variants), *_cable_slider(crane), *_WIND]
    chart_data = None
    if chart is not None:
        chart_data = {
            "least": chart.least,
            "radii": chart.radii.tolist(),
            "rated": chart.rated.tolist(),
        }
    return {
        "title": crane.model.name.replace("_", " ") if site is None else site.name,
        "crane": crane_data,
        "assist": assist_data(crane, drives) | ({} if own is None else {"own": own}),
        "assistances": assistances(crane, has_own=own is not None),
        "kernel": kernel.result() | {"state": np.concatenate(crane.start).tolist()},
        "sliders": [asdict(slider) for slider in sliders],
        "chart": chart_data,
        "drag": _drag_factor(box),
        "site": None if site is None else {"name": site.name, "solids": _solids_data(obstacles)},
        "parts": _parts_of_all(obstacles),
        "tasks": list(_tasks(planned, rotation, translation)),
        "colours": distinct_colours([*layout.symbols, "setpoint"]),
        "control_period": PERIOD,
    }


def _drag_factor(box: np.ndarray) -> float:
    """Return the drag of a box, divided by the square of the speed of the wind [N s²/m²]: ρ C A/2.

    The load turns on its rope, so the area A is the mean of those of two neighbouring sides.
    """
    wide, deep, tall = np.ptp(box, axis=0).tolist()
    return 0.25 * AIR_DENSITY * DRAG * (wide + deep) * tall


_WIND = (
    Slider("wind_speed", "wind", "m/s", 0.0, 25.0, 0.0),
    Slider("wind_direction", "blows towards", "°", -180.0, 180.0, 0.0),
)
"""Sliders of the wind."""


def _cable_slider(crane: Crane) -> list[Slider]:
    """Return a slider for the length of the cable, none if there is no hoist."""
    if not crane.layout.has("hoist"):
        return []
    i = crane.layout.role("hoist", "")
    shortest = float(crane.lower[i])
    longest = float(crane.upper[i])
    return [Slider("cable", "cable", "m", shortest, longest, float(crane.start.q[i]))]


def _crane_data(crane: Crane, drives: Converters) -> dict[str, Any]:
    """Return what the page needs to know of the crane itself: joints, limits, points and damping.

    Joints are numbered as the coordinates are, from 0, and -1 stands for the world. The keys are
    those of `CraneData` in ``run.js``.
    """
    layout = crane.layout
    limits = usual_limits(drives)
    # The page draws the rope through its points from the pivot down. The payload, which is the
    # first point of a crane, is then the last one.
    order = [*range(1, len(crane.points)), 0]
    rest = np.zeros(layout.n)
    rest[crane.swings] = crane.rest.angle
    points = []
    for i in order:
        points.append({"joint": crane.points[i].body, "point": crane.points[i].lever.tolist()})
    return {
        "joints": _joints_data(crane),
        "drives": layout.drives.tolist(),
        "rates": list(limits.rates),
        "accelerations": list(limits.accelerations),
        "efforts": [_finite(limit) for limit in crane.effort_limit],
        "start": crane.start.q.tolist(),
        "points": points,
        "order": order,
        "swings": crane.swings.tolist(),
        "rest": rest.tolist(),
        "rest_slope": crane.rest.slope.tolist(),
        "damping": crane.damping.tolist(),
        "friction": _friction_data(crane),
        "rope": _rope_data(crane),
        "lead": semi_implicit_euler.lead * DT,
        "columns": {name: list(columns) for name, columns in layout.columns().items()},
        "record": crane.record,
        "gravity": crane.gravity,
        "period": swing_period(crane, crane.start.q),
        "ground": 0.0,
    }


def _joints_data(crane: Crane) -> list[dict[str, Any]]:
    """Return names, places, axes and ranges of the joints."""
    model = crane.model
    tree = bodies_of_model(model)
    data = []
    for i, joint in enumerate(crane.layout.joints):
        # Joint 0 of Pinocchio is the world.
        placement = model.jointPlacements[i + 1]
        data.append(
            {
                "symbol": joint.symbol,
                "name": joint.name,
                "unit": joint.unit,
                "kind": joint.kind,
                "parent": int(model.parents[i + 1]) - 1,
                # Either the axis of the rotation or that of the translation is zero.
                "axis": tree.axis[i].sum(axis=0).tolist(),
                "rotation": placement.rotation.ravel().tolist(),
                "translation": placement.translation.tolist(),
                "lower": _finite(crane.lower[i]),
                "upper": _finite(crane.upper[i]),
                "driven": joint.driven,
                "role": joint.role,
            }
        )
    return data


def _rope_data(crane: Crane) -> dict[str, Any] | None:
    """Return the drive from whose effort the page takes the force of the rope, and the sign of the
    coordinate in which it lowers the load.

    None if there is no such drive, or if the rope stretches, so that its force is that of a spring.
    """
    hoist = crane.layout.drive_of("hoist")
    if hoist is None:
        hoist = crane.winch
    if hoist is None or crane.springs.rope is not None:
        return None
    return {"hoist": hoist, "sign": _lengthening(crane, int(crane.layout.drives[hoist]))}


def _friction_data(crane: Crane) -> list[dict[str, float] | None]:
    """Return the dry friction of each joint, None where it has none."""
    data: list[dict[str, float] | None] = [None] * crane.layout.n
    friction = crane.friction
    if friction is not None:
        for i, effort, width in zip(friction.joints, friction.effort, friction.width, strict=True):
            data[i] = {"effort": float(effort), "width": float(width)}
    return data


def _lengthening(crane: Crane, hoist: int) -> float:
    """Return 1 if the rope grows longer as the coordinate of its drive grows, else -1."""
    q = crane.resting(crane.start.q)
    # A step of a millimetre, back instead of on where the drive stands at its upper end.
    step = 1e-3 if q[hoist] + 1e-3 <= crane.upper[hoist] else -1e-3
    moved = q.copy()
    moved[hoist] += step
    before = payload_position(crane, q)[2]
    after = payload_position(crane, moved)[2]
    return 1.0 if (before - after) / step >= 0.0 else -1.0


def _finite(number: float) -> float:
    """Return a number clipped to `UNBOUNDED`."""
    return float(np.clip(number, -UNBOUNDED, UNBOUNDED))


def _visuals(crane: Crane, load: np.ndarray | None, meshes: str | Path | None) -> Iterator[Visual]:
    """Yield the visuals of all links.

    Args:
        crane: The crane.
        load: Corners of the load of a site about its centre [m], shape (8, 3). The largest box of
            the payload in the URDF is drawn with its size and place. None draws the payload of the
            URDF.
        meshes: Folder of its mesh files; None for sticks.
    """
    payload = crane.payload.body
    described = _described_visuals(crane, meshes)
    if not any(visual.joint == payload for visual in described):
        # Nothing of the load is described: a cube stands for it, as in a recording.
        box = _load_box(crane, load, [])
        edges = np.ptp(box, axis=0).tolist()
        placement = pin.SE3(np.eye(3), box.mean(axis=0))
        yield Visual(payload, Shape("box", tuple(edges), colour=LOAD_COLOUR), placement)

    boxes = [v.shape for v in described if v.joint == payload and v.shape.kind == "box"]
    largest_box = max(boxes, key=lambda shape: math.prod(shape.size), default=None)
    for visual in described:
        if load is not None and visual.shape is largest_box:
            centre = crane.payload.lever + (load.min(axis=0) + load.max(axis=0)) / 2.0
            size = tuple(np.ptp(load, axis=0).tolist())
            placement = pin.SE3(np.eye(3), centre)
            yield Visual(payload, replace(visual.shape, size=size), placement)
        else:
            yield visual


def _described_visuals(crane: Crane, meshes: str | Path | None) -> list[Visual]:
    """Return the visuals that the URDF describes. The placement of each shape in its link becomes a
    part of the placement of the visual.
    """
    model = crane.model
    described = []
    for link, link_shapes in shapes(crane.urdf, meshes).items():
        frame = model.frames[model.getFrameId(link)]
        for shape in link_shapes:
            rotation = Rotation.from_euler("xyz", shape.rpy).as_matrix()
            in_link = pin.SE3(rotation, np.array(shape.centre))
            if shape.mesh is not None:
                # The corners of a mesh are in the frame of the link, along its axes, and the centre
                # is that of the mesh; so only the translation is taken out of them.
                shape.mesh.apply_translation(-in_link.translation)
            centred = replace(shape, centre=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))
            joint = int(frame.parentJoint) - 1
            described.append(Visual(joint, centred, frame.placement * in_link))
    return described


def _shape_data(crane: Crane, visuals: Sequence[Visual]) -> Iterator[dict[str, Any]]:
    """Yield the visuals for JSON, with the surfaces of meshes."""
    surfaces = _surfaces([v.shape.mesh for v in visuals if v.shape.kind == "mesh"])
    for joint, shape, placement in visuals:
        surface = next(surfaces) if shape.kind == "mesh" else {}
        yield surface | {
            "joint": joint,
            "kind": shape.kind,
            "size": [float(edge) for edge in shape.size],
            "rotation": placement.rotation.ravel().tolist(),
            "translation": placement.translation.tolist(),
            "colour": [float(c) for c in shape.colour],
            "payload": joint == crane.payload.body,
        }


def _surfaces(meshes: Sequence[Any]) -> Iterator[dict[str, list[float]]]:
    """Yield corners [m] and triangles of meshes, with no more than `MAX_TRIANGLES` in all.

    Corners in the same cell of a grid are merged. The cells have the smallest edge of 1, 2, 4, ...
    mm with which the meshes have few enough triangles.
    """
    original_count = sum(len(mesh.faces) for mesh in meshes)
    cell = FINEST_CELL
    while True:
        surfaces = [_clustered(mesh, cell) for mesh in meshes]
        count = sum(len(triangles) for _, triangles in surfaces)
        if count <= MAX_TRIANGLES:
            break
        cell *= 2.0
    if cell > FINEST_CELL:
        print(
            f"Meshes: {count} of {original_count} triangles are drawn, exact to "
            f"{1000 * cell:g} mm.",
            file=sys.stderr,
        )
    for corners, triangles in surfaces:
        yield {
            "vertices": corners.round(4).ravel().tolist(),
            "triangles": triangles.ravel().tolist(),
        }


def _clustered(mesh: Any, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners, shape (n, 3), and triangles, shape (m, 3), with one corner in each cell [m].

    Triangles that shrink to a line or a point are left out, and of triangles that come to have the
    same corners all but the first.
    """
    cells, cell_of_vertex = np.unique(np.rint(mesh.vertices / cell), axis=0, return_inverse=True)
    triangles = cell_of_vertex.ravel()[mesh.faces]
    has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    triangles = triangles[has_area]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return cells * cell, triangles[first]


def _load_box(crane: Crane, load: np.ndarray | None, visuals: Sequence[Visual]) -> np.ndarray:
    """Return the corners of the box about the load in the frame of its joint [m], shape (8, 3).

    The fourth corner is the lowest along all axes, and the first three are its neighbours along X,
    Y and Z: the page takes the edges of the box from these four. The eighth is opposite the fourth.

    Args:
        crane: The crane.
        load: Corners of the load about its centre [m], shape (8, 3); None for the box about its
            visuals.
        visuals: The visuals; if none is of the load, a cube stands for it.
    """
    if load is not None:
        low = crane.payload.lever + load.min(axis=0)
        high = crane.payload.lever + load.max(axis=0)
    else:
        points = []
        for joint, shape, placement in visuals:
            if joint == crane.payload.body:
                points.append(shape.hull_points() @ placement.rotation.T + placement.translation)
        if points:
            low = np.vstack(points).min(axis=0)
            high = np.vstack(points).max(axis=0)
        else:
            half = UNKNOWN_LOAD / 2.0 * min(1.0, _rope_length(crane) / SHORT_ROPE)
            low = crane.payload.lever - half
            high = crane.payload.lever + half
    lower_corners = np.vstack([np.eye(3), np.zeros(3)])
    upper_corners = 1.0 - lower_corners
    return low + np.vstack([lower_corners, upper_corners]) * (high - low)


def _rope_length(crane: Crane) -> float:
    """Return the distance from the first pivot to the load at the start [m]."""
    pivot, *_, load = rope_line(crane, crane.resting(crane.start.q)[None])[0]
    return float(np.linalg.norm(load - pivot))


def _site_to_crane(site: Site) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation, shape (3, 3), and translation [m], shape (3,), from the frame of a site to
    that of its crane.

    At slew angle 0 the jib points along -Y of the crane, and along the heading in the site. So the
    crane is turned by heading + π/2 in the site.
    """
    rotation = Rotation.from_euler("z", -(site.heading + math.pi / 2.0)).as_matrix()
    return rotation, -rotation @ site.foot


def _solids_data(solids: Sequence[Solid]) -> list[dict[str, Any]]:
    """Return the surfaces of obstacles for JSON, corners rounded to a tenth of a millimetre."""
    data = []
    for solid in solids:
        data.append(
            {
                "name": solid.name,
                "zone": solid.zone,
                "vertices": solid.vertices.round(4).ravel().tolist(),
                "triangles": solid.triangles.ravel().tolist(),
            }
        )
    return data


def _exercises(crane: Crane, drives: Converters, site: Site | None) -> list[Exercise]:
    """Return the exercises; on a site only the lift of a tower crane."""
    if not is_tower(crane):
        return list(simple_exercises(crane)) if site is None else []
    limits = usual_limits(drives)
    if site is None:
        return list(exercises(crane, limits))
    lift = lift_exercise(crane, limits, site)
    return [] if lift is None else [lift]


def _tasks(
    exercises: Sequence[Exercise], rotation: np.ndarray, translation: np.ndarray
) -> Iterator[dict[str, Any]]:
    """Yield exercises for JSON.

    Args:
        exercises: The exercises, in the frame of the site.
        rotation: Rotation into the frame of the crane, shape (3, 3).
        translation: Translation into the frame of the crane [m], shape (3,).
    """
    for exercise in exercises:
        solids = [solid.moved(rotation, translation) for solid in exercise.solids]
        goal = exercise.goal
        yield {
            "name": exercise.name,
            "title": exercise.title,
            "text": exercise.text,
            "state": np.concatenate(exercise.start).tolist(),
            "goal": None if goal is None else (rotation @ goal + translation).tolist(),
            "radius": exercise.radius,
            "swing": SWING,
            "blind": exercise.blind,
            "parts": _parts_of_all(solids) or None,
            "solids": _solids_data(solids) or None,
            "best": None if exercise.best is None else asdict(exercise.best),
            "no_best": exercise.no_best,
        }


def _parts_of_all(solids: Sequence[Solid]) -> list[dict[str, Any]]:
    """Return the convex bodies of all obstacles for JSON."""
    parts: list[dict[str, Any]] = []
    for solid in solids:
        parts += _parts(solid)
    return parts


def _parts(solid: Solid) -> Iterator[dict[str, Any]]:
    """Yield the convex bodies of an obstacle; that of a mere surface of triangles is its hull.

    The page checks by separating axes whether the box of the load hits one: two convex bodies are
    apart if their projections are on the normal of a face, or on the cross product of an edge of
    each. Opposite directions of edges give the same axes, so a direction is listed once.
    """
    for corners in solid.parts or (solid.vertices,):
        hull = ConvexHull(corners)
        # Triangles of one face share its plane n·x + d = 0, up to round-off. The page takes the
        # offset of a face as n·x = -d.
        planes = np.unique(np.round(hull.equations, 9), axis=0)
        faces = []
        for *normal, offset in planes.tolist():
            faces.append([*normal, -offset])
        yield {
            "name": solid.name,
            "corners": corners[hull.vertices].tolist(),
            "faces": faces,
            "edges": _edge_directions(corners, hull.simplices).tolist(),
        }


def _edge_directions(corners: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the unit vectors along all edges of triangles, each once, shape (k, 3).

    Args:
        corners: Corners [m], shape (n, 3).
        triangles: Indices of the corners, shape (m, 3).
    """
    edges = []
    for triangle in triangles:
        for a, b in zip(triangle, np.roll(triangle, 1), strict=True):
            edges.append(corners[b] - corners[a])
    directions = np.array([edge / np.linalg.norm(edge) for edge in edges])
    # A direction is turned so that its first component that is not zero is positive: opposite ones
    # become the same.
    first = (np.abs(directions) > 1e-9).argmax(axis=1)[:, None]
    is_negative = np.take_along_axis(directions, first, axis=1) < 0.0
    directions *= np.where(is_negative, -1.0, 1.0)
    return np.unique(directions.round(9), axis=0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument("--site", metavar="FILE", help="obstacles about the crane, a .toml file")
    text = "its load chart, a .toml file or the name of an example; that of the site"
    parser.add_argument("--chart", metavar="FILE", help=text)
    parser.add_argument("--meshes", metavar="FOLDER", help="of its mesh files; else sticks")


def _chart_of(options: argparse.Namespace, site: Site | None) -> RatedLoads | None:
    """Return the rated loads of the crane: by the chart of the command line, or else by that of the
    site, on the falls that the site enters.

    Raises:
        DataError: If the file is no chart.
        UnknownName: If no chart has the name, or the chart lacks the falls of the site.
        NotCovered: If the chart has loads by the length of the boom, and not for that of the site.
    """
    chart = options.chart
    # The chart of a site is that of its own crane; another crane needs one of its own.
    is_crane_of_site = options.urdf is None and options.machine is None
    if chart is None and site is not None and is_crane_of_site:
        chart = site.chart
    if chart is None:
        return None
    if site is None:
        return read_chart(chart).on()
    return read_chart(chart).on(site.falls, site.boom)


def _name_crane_of_site(options: argparse.Namespace, described: DescribedCrane) -> None:
    """Let the options name the crane that a site describes, as those of the command line would.

    Raises:
        DataError: If they name a crane, too.
    """
    for name in ("urdf", "machine"):
        if getattr(options, name) is not None:
            raise DataError(f"The site says which crane it is ([crane]); leave --{name} out.")
    options.machine = described.machine
    if described.urdf is not None:
        options.urdf = str(described.urdf)
    if described.driven:
        options.driven = list(described.driven)
    if described.locked:
        options.locked = []
        for name, coordinate in described.locked.items():
            options.locked.append(name if coordinate is None else f"{name}={coordinate!r}")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    print("Compiling the crane and planning exercises, up to half a minute ...", file=sys.stderr)
    site = None if options.site is None else read_site(options.site)
    chart = _chart_of(options, site)
    if site is not None and site.description is not None:
        _name_crane_of_site(options, site.description)
    has_arguments = options.urdf is None or Path(options.urdf).suffix == ".xacro"
    if site is not None and has_arguments:
        # Of two values of one argument the last one holds: that of the command line.
        values_of_site = [f"{name}:={value}" for name, value in site.crane.items()]
        options.values = [*values_of_site, *options.values]
    crane = crane_from_options(options)
    name_default_rates(crane)
    if chart is not None and options.chart is None and not crane.layout.has("slew"):
        print("The chart of the site is left out: the page shows those of tower cranes only.")
        chart = None
    if site is not None:
        refuse_contradictions(site, crane)
    return export(options.target, crane, site=site, chart=chart, meshes=options.meshes)


def next_commands(options: argparse.Namespace) -> list[str]:
    """Return command lines that work with what `run` has written."""
    saved = command_line("cranedyn", "view", "drive.csv", *crane_words(options, gravity=False))
    return [open_line(options.target), f"{saved}  # once the page has saved a run"]
