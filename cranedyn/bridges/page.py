"""A page in which one drives the crane: compiled to WebAssembly, in one file that needs no network.

The physics is that of `simulate` with frequency converters (``drive="velocity"``), from the same
trace as the compiled engine. What assists the operator is designed here and evaluated in the page.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from markupsafe import Markup
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cranedyn.bridges.browser_crane import (
    DT,
    PERIOD,
    Slider,
    assist_data,
    assistances,
    is_tower,
    kernel_data,
    swing_period,
    usual_limits,
    variations,
)
from cranedyn.bridges.exercises import SWING, Exercise, exercises, lift_exercise
from cranedyn.bridges.target import check_free, name_default_rates, new_file
from cranedyn.data.files import with_ending
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.dynamics.bodies import bodies
from cranedyn.dynamics.converters import Converters, converters
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.dynamics.pinocchio import payload_position
from cranedyn.lifting.chart import Falls, read_chart
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.planning.lift import refuse_contradictions
from cranedyn.planning.site import Site
from cranedyn.planning.site_file import read_site
from cranedyn.planning.solids import Solid
from cranedyn.plotting.html import render
from cranedyn.plotting.style import distinct_colours
from cranedyn.recording.shapes import Shape, rope_line, shapes

TARGET = "FILE"
EXAMPLE = "crane.html"

DRAG = 1.2
"""Drag coefficient of the load as a box."""

UNKNOWN_LOAD = 1.0
"""Edge of the cube that stands for a load whose size nothing says [m]."""

SHORT_ROPE = 5.0
"""Distance from pivot to load below which that cube is smaller in proportion [m]."""

LOAD = (0.95, 0.17, 0.02, 1.0)
"""Colour of a load whose colour nothing says: that of the crane of this project."""

TRIANGLES = 15_000
"""Most triangles of all meshes together, so that a page has less than 1 MB."""

_TEMPLATES = Path(__file__).with_name("templates") / "page"


class Visual(NamedTuple):
    """A shape, its joint, -1 for the world, and its placement in the joint's frame."""

    joint: int
    shape: Shape
    placement: pin.SE3


def export(
    file: str | Path,
    crane: Crane,
    *,
    site: Site | None = None,
    chart: Falls | None = None,
    meshes: str | Path | None = None,
) -> Path:
    """Write a page in which one drives a crane by keyboard, gamepad or mouse.

    Args:
        file: New file, ending in .html.
        crane: The crane, loaded with the values of the site where there is one.
        site: Obstacles about the crane; None for none.
        chart: Rated loads of a tower crane; None for none.
        meshes: Folder of the mesh files of the crane; None draws sticks in their places.

    Raises:
        DataError: If the ending is not .html, the file exists or cannot be written, or a mesh
            cannot be read.
        MissingRole: If there is a chart, and the crane does not slew.
        ModelError: If the code would not do what Pinocchio does.
    """
    file = with_ending(file, ".html")
    check_free(file)
    text = page_html(crane, site, chart, meshes)
    with new_file(file) as draft:
        draft.write_text(text, "utf-8")
    return file


def page_html(crane: Crane, *options: Any) -> str:
    """Return the page as HTML, see `page_data`."""
    data = json.dumps(page_data(crane, *options), separators=(",", ":"), allow_nan=False)
    # JSON in a script element ends at the first "</script", whatever is escaped otherwise.
    return render(
        _TEMPLATES / "page.html",
        page_style=_source("style.css"),
        data=Markup(data.replace("<", "\\u003c")),
        kernel=_source("kinematics.js", "kernel.js", "assist.js", "run.js", "worker.js"),
        script=_source("kinematics.js", "scene.js", "input.js", "page.js"),
    )


def _source(*names: str) -> Markup:
    """Return files of the page's own style and scripts, which are put into it as they are."""
    return Markup("\n".join((_TEMPLATES / name).read_text("utf-8") for name in names))


def page_data(
    crane: Crane,
    site: Site | None = None,
    chart: Falls | None = None,
    meshes: str | Path | None = None,
) -> dict[str, Any]:
    """Return all that the page needs of a crane and its site, for JSON."""
    layout, drives = crane.layout, converters(crane)
    if chart is not None:
        layout.role("slew", "A load chart")
    variants = variations(crane, drives)
    with ThreadPoolExecutor(1) as thread:  # LLVM leaves Python to the planner
        kernel = thread.submit(kernel_data, crane, drives, variants)
        planned = _exercises(crane, drives, site)
    if site is not None and planned:
        crane = replace(crane, start=planned[0].start)
    turn, foot = (np.eye(3), np.zeros(3)) if site is None else _frame(site)
    obstacles = [] if site is None else [solid.moved(turn, foot) for solid in site.solids]
    load = None if site is None else site.load
    sliders = [*(slider for slider, *_ in variants), *_cable(crane), *_WIND]
    visuals = list(_visuals(crane, load, meshes))
    box = _load_box(crane, load, visuals)
    wide, deep, tall = np.ptp(box, axis=0).tolist()
    return {
        "title": crane.model.name.replace("_", " ") if site is None else site.name,
        "crane": _crane_data(crane, drives)
        | {"load": box.tolist(), "shapes": list(_shape_data(crane, visuals))},
        "assist": assist_data(crane, drives),
        "assistances": assistances(crane),
        "kernel": kernel.result() | {"state": np.concatenate(crane.start).tolist()},
        "sliders": [asdict(slider) for slider in sliders],
        "chart": chart
        and {"least": chart.least, "radii": chart.radii.tolist(), "rated": chart.rated.tolist()},
        "drag": 0.25 * AIR_DENSITY * DRAG * (wide + deep) * tall,
        "site": None if site is None else {"name": site.name, "solids": _solids_data(obstacles)},
        "parts": [part for solid in obstacles for part in _parts(solid)],
        "tasks": list(_tasks(planned, turn, foot)),
        "colours": distinct_colours([*layout.symbols, "setpoint"]),
        "control_period": PERIOD,
    }


_WIND = (
    Slider("wind_speed", "wind", "m/s", 0.0, 25.0, 0.0),
    Slider("wind_direction", "blows towards", "°", -180.0, 180.0, 0.0),
)


def _cable(crane: Crane) -> Iterator[Slider]:
    """Yield a slider for the length of the cable, if there is a hoist."""
    if crane.layout.has("hoist"):
        i = crane.layout.role("hoist", "")
        ends = float(crane.lower[i]), float(crane.upper[i])
        yield Slider("cable", "cable", "m", *ends, float(crane.start.q[i]))


def _crane_data(crane: Crane, drives: Converters) -> dict[str, Any]:
    layout, model, tree = crane.layout, crane.model, bodies(crane.model)
    joints, limits = [], usual_limits(drives)
    for i, joint in enumerate(layout.joints):
        placement = model.jointPlacements[i + 1]
        joints.append(
            {
                "symbol": joint.symbol,
                "name": joint.name,
                "unit": joint.unit,
                "kind": joint.kind,
                "parent": int(model.parents[i + 1]) - 1,
                "axis": tree.axis[i].sum(axis=0).tolist(),
                "rotation": placement.rotation.ravel().tolist(),
                "translation": placement.translation.tolist(),
                "lower": _finite(crane.lower[i]),
                "upper": _finite(crane.upper[i]),
                "driven": joint.driven,
                "role": joint.role,
            }
        )
    order = [*range(1, len(crane.points)), 0]
    rest = np.zeros(layout.n)
    rest[crane.swings] = crane.rest.angle
    hoist = crane.winch if layout.drive_of("hoist") is None else layout.drive_of("hoist")
    rope = None
    if hoist is not None and crane.springs.rope is None:
        rope = {"hoist": hoist, "sign": _lengthening(crane, int(layout.drives[hoist]))}
    friction: list[dict[str, float] | None] = [None] * layout.n
    if crane.friction is not None:
        dry = crane.friction
        for i, effort, width in zip(dry.joints, dry.effort, dry.width, strict=True):
            friction[i] = {"effort": float(effort), "width": float(width)}
    return {
        "joints": joints,
        "drives": layout.drives.tolist(),
        "rates": list(limits.rates),
        "accelerations": list(limits.accelerations),
        "efforts": [_finite(limit) for limit in crane.effort_limit],
        "start": crane.start.q.tolist(),
        "points": [
            {"joint": crane.points[i].body, "point": crane.points[i].lever.tolist()} for i in order
        ],
        "order": order,
        "swings": crane.swings.tolist(),
        "rest": rest.tolist(),
        "damping": crane.damping.tolist(),
        "friction": friction,
        "rope": rope,
        "lead": semi_implicit_euler.lead * DT,
        "columns": {name: list(columns) for name, columns in layout.columns().items()},
        "record": crane.record,
        "gravity": crane.gravity,
        "period": swing_period(crane, crane.start.q),
        "ground": 0.0,
    }


def _lengthening(crane: Crane, hoist: int) -> float:
    """Return 1 if the rope grows longer as the coordinate of its drive grows, else -1."""
    q = crane.resting(crane.start.q)
    step = 1e-3 if q[hoist] + 1e-3 <= crane.upper[hoist] else -1e-3
    moved = q.copy()
    moved[hoist] += step
    before, after = (payload_position(crane, state)[2] for state in (q, moved))
    return 1.0 if (before - after) / step >= 0.0 else -1.0


def _finite(number: float) -> float:
    return float(np.clip(number, -1e9, 1e9))


def _visuals(crane: Crane, load: np.ndarray | None, meshes: str | Path | None) -> Iterator[Visual]:
    """Yield the visuals of all links; the largest box of the load has the corners that are given,
    if any are.
    """
    model = crane.model
    placed = []
    for link, visuals in shapes(crane.urdf, meshes).items():
        frame = model.frames[model.getFrameId(link)]
        for shape in visuals:
            own = pin.SE3(Rotation.from_euler("xyz", shape.rpy).as_matrix(), np.array(shape.centre))
            if shape.mesh is not None:
                shape.mesh.apply_translation(-own.translation)
            shape = replace(shape, centre=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0))
            placed.append(Visual(int(frame.parentJoint) - 1, shape, frame.placement * own))
    boxes = [s for i, s, _ in placed if i == crane.payload.body and s.kind == "box"]
    largest = max(boxes, key=lambda shape: math.prod(shape.size), default=None)
    if not any(joint == crane.payload.body for joint, _, _ in placed):
        # Nothing of the load is described: a cube stands for it, as in a recording.
        edges = np.ptp(_load_box(crane, load, []), axis=0).tolist()
        centre = _load_box(crane, load, []).mean(axis=0)
        yield Visual(
            crane.payload.body, Shape("box", tuple(edges), colour=LOAD), pin.SE3(np.eye(3), centre)
        )
    for joint, shape, placement in placed:
        if load is not None and shape is largest:
            centre = crane.payload.lever + (load.min(axis=0) + load.max(axis=0)) / 2.0
            placement = pin.SE3(np.eye(3), centre)
            shape = replace(shape, size=tuple(np.ptp(load, axis=0).tolist()))
        yield Visual(joint, shape, placement)


def _shape_data(crane: Crane, visuals: Sequence[Visual]) -> Iterator[dict[str, Any]]:
    meshes = _surfaces([shape.mesh for _, shape, _ in visuals if shape.kind == "mesh"])
    for joint, shape, placement in visuals:
        surface = next(meshes) if shape.kind == "mesh" else {}
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
    """Yield corners [m] and triangles of meshes: corners are put together in the smallest cells, of
    1, 2, 4 ... mm, with which all meshes have no more than `TRIANGLES`.
    """
    cell, before = 1e-3, sum(len(mesh.faces) for mesh in meshes)
    while True:
        surfaces = [_clustered(mesh, cell) for mesh in meshes]
        count = sum(len(triangles) for _, triangles in surfaces)
        if count <= TRIANGLES:
            break
        cell *= 2.0
    if cell > 1e-3:
        exact = f"exact to {1000 * cell:g} mm"
        print(f"Meshes: {count} of {before} triangles are drawn, {exact}.", file=sys.stderr)
    for corners, triangles in surfaces:
        flat = corners.round(4).ravel().tolist(), triangles.ravel().tolist()
        yield dict(zip(("vertices", "triangles"), flat, strict=True))


def _clustered(mesh: Any, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Return corners, shape (n, 3), and triangles, shape (m, 3), with one corner in each cell."""
    cells, row = np.unique(np.rint(mesh.vertices / cell), axis=0, return_inverse=True)
    triangles = row.ravel()[mesh.faces]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    return cells * cell, triangles[first]


def _load_box(crane: Crane, load: np.ndarray | None, visuals: Sequence[Visual]) -> np.ndarray:
    """Return the corners of the box about the load in the frame of its joint [m], shape (8, 3):
    three neighbours of the fourth first. Corners of the load about its centre may be given.
    """
    half = UNKNOWN_LOAD / 2.0 * min(1.0, _rope_length(crane) / SHORT_ROPE)
    low, high = crane.payload.lever - half, crane.payload.lever + half
    if load is None:
        points = [
            shape.hull_points() @ placement.rotation.T + placement.translation
            for joint, shape, placement in visuals
            if joint == crane.payload.body
        ]
        if points:
            low, high = np.vstack(points).min(axis=0), np.vstack(points).max(axis=0)
    else:
        low, high = crane.payload.lever + load.min(axis=0), crane.payload.lever + load.max(axis=0)
    neighbours = np.vstack([np.eye(3), np.zeros(3)])
    return low + np.vstack([neighbours, 1.0 - neighbours]) * (high - low)


def _rope_length(crane: Crane) -> float:
    """Return the distance from the first pivot to the load at the start [m]."""
    pivot, *_, load = rope_line(crane, crane.resting(crane.start.q)[None])[0]
    return float(np.linalg.norm(load - pivot))


def _frame(site: Site) -> tuple[np.ndarray, np.ndarray]:
    """Return rotation and translation [m] from the frame of a site to that of its crane."""
    turn = Rotation.from_euler("z", -(site.heading + math.pi / 2.0)).as_matrix()
    return turn, -turn @ site.foot


def _solids_data(solids: Sequence[Solid]) -> list[dict[str, Any]]:
    return [
        {
            "name": solid.name,
            "zone": solid.zone,
            "vertices": solid.vertices.round(4).ravel().tolist(),
            "triangles": solid.triangles.ravel().tolist(),
        }
        for solid in solids
    ]


def _exercises(crane: Crane, drives: Converters, site: Site | None) -> list[Exercise]:
    """Return the exercises for a tower crane; on a site only its lift."""
    if not is_tower(crane):
        return []
    limits = usual_limits(drives)
    if site is None:
        return list(exercises(crane, limits))
    lift = lift_exercise(crane, limits, site)
    return [] if lift is None else [lift]


def _tasks(
    exercises: Sequence[Exercise], turn: np.ndarray, foot: np.ndarray
) -> Iterator[dict[str, Any]]:
    """Yield exercises in the frame of the crane."""
    for exercise in exercises:
        solids = [solid.moved(turn, foot) for solid in exercise.solids]
        goal = exercise.goal
        yield {
            "name": exercise.name,
            "title": exercise.title,
            "text": exercise.text,
            "state": np.concatenate(exercise.start).tolist(),
            "goal": None if goal is None else (turn @ goal + foot).tolist(),
            "radius": exercise.radius,
            "swing": SWING,
            "blind": exercise.blind,
            "parts": [part for solid in solids for part in _parts(solid)] or None,
            "solids": _solids_data(solids) or None,
            "best": None if exercise.best is None else asdict(exercise.best),
        }


def _parts(solid: Solid) -> Iterator[dict[str, Any]]:
    """Yield the convex bodies of an obstacle; of a surface of triangles its convex hull."""
    for corners in solid.parts or (solid.vertices,):
        hull = ConvexHull(corners)
        faces = np.unique(np.round(hull.equations, 9), axis=0)
        edges = [
            corners[b] - corners[a]
            for triangle in hull.simplices
            for a, b in zip(triangle, np.roll(triangle, 1), strict=True)
        ]
        directions = np.array([edge / np.linalg.norm(edge) for edge in edges])
        first = (np.abs(directions) > 1e-9).argmax(axis=1)[:, None]  # that is not zero
        directions *= np.where(np.take_along_axis(directions, first, axis=1) < 0.0, -1.0, 1.0)
        yield {
            "name": solid.name,
            "corners": corners[hull.vertices].tolist(),
            "faces": [[*normal, -offset] for *normal, offset in faces.tolist()],
            "edges": np.unique(directions.round(9), axis=0).tolist(),
        }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument("--site", metavar="FILE", help="obstacles about the crane, a .toml file")
    parser.add_argument("--chart", metavar="FILE", help="its load chart, a .toml file")
    parser.add_argument("--meshes", metavar="FOLDER", help="of its mesh files; else sticks")


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    print("Compiling the crane and planning exercises, up to half a minute ...", file=sys.stderr)
    site = None if options.site is None else read_site(options.site)
    has_arguments = options.urdf is None or Path(options.urdf).suffix == ".xacro"
    if site is not None and has_arguments:
        options.values = [*(f"{k}:={v}" for k, v in site.crane.items()), *options.values]
    chart = None if options.chart is None else read_chart(options.chart).on()
    crane = crane_from_options(options)
    name_default_rates(crane)
    if site is not None:
        refuse_contradictions(site, crane)
    return export(options.target, crane, site=site, chart=chart, meshes=options.meshes)
