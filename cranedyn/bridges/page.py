"""A page in which one drives the crane: compiled to WebAssembly, in one file that needs no network.

The physics is that of `simulate` with frequency converters (``drive="velocity"``), from the same
trace as the compiled engine. What assists the operator is designed here and evaluated in the page.
"""

from __future__ import annotations

import argparse
import base64
import json
import math
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cranedyn.bridges.exercises import SWING, exercises, lift_exercise
from cranedyn.bridges.target import check_free, new_file
from cranedyn.controllers.lqr import effort_weight_of, lqr
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.dynamics.converters import HEADROOM, Converters, converters
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.dynamics.pinocchio import holding_effort, linearise
from cranedyn.errors import DataError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.options import crane_from_options
from cranedyn.planning.site import Site
from cranedyn.planning.site_file import read_site
from cranedyn.planning.solids import Solid
from cranedyn.plotting.style import COLOURS
from cranedyn.recording.shapes import Shape, shapes
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion

TARGET = "FILE"
EXAMPLE = "crane.html"

PERIOD, DT = 5e-3, 5e-4
"""Control period and physics step [s], those of `simulate`."""

YIELDING = 0.2
"""Share of critical damping that drives which yield give the swing."""

SOFTER = 100.0
"""Weight of efforts over that of `lqr`: stiffer gains ask for more than the ramps of drives give,
and the loop oscillates."""

DRAG = 1.2
"""Drag coefficient of the load as a box."""

_TEMPLATES = Path(__file__).with_name("templates") / "page"
_RADII, _LENGTHS = 6, 8
"""Rows of the table of gains."""


@dataclass(frozen=True)
class Slider:
    """A number of the crane that can be changed while it moves.

    Attributes:
        name: Name.
        label: What it is.
        unit: Its unit.
        least, most: Range.
        value: Value at the start.
    """

    name: str
    label: str
    unit: str
    least: float
    most: float
    value: float


def export(file: str | Path, crane: Crane, *, site: Site | None = None) -> Path:
    """Write a page in which one drives a crane by keyboard, gamepad or mouse.

    Args:
        file: New file, ending in .html.
        crane: The crane, loaded with the values of the site where there is one.
        site: Obstacles about the crane; None for none.

    Raises:
        DataError: If the ending is not .html, or the file exists or cannot be written.
        OutOfRange: If a drive has no velocity limit above 0.
        ModelError: If the code would not do what Pinocchio does.
    """
    file = Path(file)
    if file.suffix != ".html":
        raise DataError(f"Cannot write {file}: the ending of a page must be .html.")
    check_free(file)
    text = page_html(crane, site)
    with new_file(file) as draft:
        draft.write_text(text, "utf-8")
    return file


def page_html(crane: Crane, site: Site | None = None) -> str:
    """Return the page as HTML, see `export`."""
    data = json.dumps(page_data(crane, site), separators=(",", ":"), allow_nan=False)
    parts = {
        "style": _template("style.css"),
        "data": data.replace("<", "\\u003c"),
        "kernel": "\n".join(
            _template(f"{name}.js") for name in ("kinematics", "kernel", "assist", "run", "worker")
        ),
        "page": "\n".join(
            _template(f"{name}.js") for name in ("kinematics", "scene", "input", "page")
        ),
    }
    text = _template("page.html")
    for name, part in parts.items():
        text = text.replace(f"{{{{{name}}}}}", part)
    return text


def _template(name: str) -> str:
    return (_TEMPLATES / name).read_text("utf-8")


def page_data(crane: Crane, site: Site | None = None) -> dict[str, Any]:
    """Return all that the page needs of a crane and its site, for JSON."""
    layout, drives = crane.layout, converters(crane)
    sliders, cranes, responses = _variations(crane, drives)
    turn, foot = (np.eye(3), np.zeros(3)) if site is None else _frame(site)
    obstacles = [] if site is None else [solid.moved(turn, foot) for solid in site.solids]
    area = DRAG * _frontal_area(crane)
    return {
        "title": _title(crane) if site is None else site.name,
        "crane": _crane_data(crane, drives),
        "assist": _assist_data(crane, drives),
        "assistances": _assistances(crane),
        "kernel": _kernel_data(crane, drives, sliders, cranes, responses),
        "sliders": [asdict(slider) for slider in (*sliders, *_WIND)],
        "drag": 0.5 * AIR_DENSITY * area,
        "site": None if site is None else {"name": site.name, "solids": _solids_data(obstacles)},
        "parts": [part for solid in obstacles for part in _parts(solid)],
        "tasks": list(_tasks(crane, drives, site)),
        "colours": {name: COLOURS.get(name, "#8A8A8A") for name in (*layout.symbols, "setpoint")},
        "control_period": PERIOD,
    }


_WIND = (
    Slider("wind_speed", "wind", "m/s", 0.0, 25.0, 0.0),
    Slider("wind_direction", "blows towards", "°", -180.0, 180.0, 0.0),
)


def _variations(
    crane: Crane, drives: Converters
) -> tuple[list[Slider], list[Crane], list[np.ndarray]]:
    """Return sliders, and for each the crane and the parameters of its converters at one unit more
    than usual.
    """
    usual = np.concatenate(drives.response)
    mass = crane.payload_mass
    sliders = [Slider("payload_mass", "load", "kg", 0.25 * mass, 3.0 * mass, mass)]
    cranes, responses = [_heavier(crane, 1.0 + 1.0 / mass)], [usual]
    damping = float(crane.damping[crane.swings].mean()) if len(crane.swings) else 0.0
    most = max(10.0 * damping, 0.1 * math.sqrt(crane.gravity) * mass * _cable(crane) ** 1.5)
    sliders.append(Slider("damping", "damping of the swing", "N m s/rad", 0.0, most, damping))
    more = crane.damping.copy()
    more[crane.swings] += 1.0
    cranes.append(replace(crane, damping=more))
    responses.append(usual)
    sliders.append(Slider("ramp", "acceleration of the drives", "%", 25.0, 200.0, 100.0))
    steeper = replace(drives, accelerations=1.01 * drives.accelerations, jerks=1.01 * drives.jerks)
    cranes.append(crane)
    responses.append(np.concatenate(steeper.response))
    return sliders, cranes, responses


def _heavier(crane: Crane, factor: float) -> Crane:
    """Return a crane with a load of the same shape whose mass is a multiple."""
    model, joint = crane.model.copy(), crane.payload.body + 1
    load = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(factor * load.mass, load.lever, factor * load.inertia)
    return replace(crane, model=model)


def _usual_rates(drives: Converters) -> np.ndarray:
    """Return the rates at full stick: those of the drives less what they have in reserve."""
    return drives.rates / HEADROOM


def _cable(crane: Crane) -> float:
    """Return the length of the cable at the start [m]; 1 for a crane without hoist."""
    layout = crane.layout
    return float(crane.start.q[layout.role("hoist", "")]) if layout.has("hoist") else 1.0


def _crane_data(crane: Crane, drives: Converters) -> dict[str, Any]:
    layout, model = crane.layout, crane.model
    joints = []
    for i, joint in enumerate(layout.joints):
        placement = model.jointPlacements[i + 1]
        joints.append(
            {
                "symbol": joint.symbol,
                "name": joint.name,
                "unit": joint.unit,
                "kind": joint.kind,
                "parent": int(model.parents[i + 1]) - 1,
                "axis": _axis(model, i),
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
    hoist = layout.drive_of("hoist")
    rope = None
    if hoist is not None and crane.springs.rope is None:
        rope = {"hoist": hoist, "damping": float(crane.damping[layout.drives[hoist]])}
    return {
        "joints": joints,
        "drives": layout.drives.tolist(),
        "rates": _usual_rates(drives).tolist(),
        "accelerations": drives.accelerations.tolist(),
        "efforts": [_finite(limit) for limit in crane.effort_limit],
        "start": crane.start.q.tolist(),
        "shapes": list(_shape_data(crane)),
        "points": [
            {"joint": crane.points[i].body, "point": crane.points[i].lever.tolist()} for i in order
        ],
        "order": order,
        "swings": crane.swings.tolist(),
        "rest": rest.tolist(),
        "damping": crane.damping.tolist(),
        "load": _load_box(crane).tolist(),
        "rope": rope,
        "lead": semi_implicit_euler.lead * DT,
        "columns": {name: list(columns) for name, columns in layout.columns().items()},
        "gravity": crane.gravity,
        "period": _swing_period(crane, crane.start.q),
        "ground": 0.0,
    }


def _axis(model: pin.Model, joint: int) -> list[float]:
    """Return the axis of a joint in its own frame."""
    data, q = model.createData(), pin.neutral(model)
    pin.computeJointJacobians(model, data, q)
    motion = pin.getJointJacobian(model, data, joint + 1, pin.ReferenceFrame.LOCAL)[:, joint]
    linear, angular = np.split(motion, 2)
    return (linear if np.any(linear) else angular).tolist()


def _finite(number: float) -> float:
    return float(np.clip(number, -1e9, 1e9))


def _shape_data(crane: Crane) -> Iterator[dict[str, Any]]:
    """Yield the visuals of all links in the frames of the joints that carry them."""
    model = crane.model
    for link, visuals in shapes(crane.urdf).items():
        frame = model.frames[model.getFrameId(link)]
        joint = int(frame.parentJoint) - 1
        for shape in visuals:
            own = pin.SE3(Rotation.from_euler("xyz", shape.rpy).as_matrix(), np.array(shape.centre))
            placed = frame.placement * own
            yield {
                "joint": joint,
                "kind": shape.kind,
                "size": [float(edge) for edge in shape.size],
                "rotation": placed.rotation.ravel().tolist(),
                "translation": placed.translation.tolist(),
                "colour": [float(c) for c in shape.colour],
                "payload": joint == crane.payload.body,
            }


def _load_shapes(crane: Crane) -> Iterator[tuple[Shape, pin.SE3]]:
    model = crane.model
    for link, visuals in shapes(crane.urdf).items():
        frame = model.frames[model.getFrameId(link)]
        if int(frame.parentJoint) - 1 == crane.payload.body:
            for shape in visuals:
                yield shape, frame.placement


def _load_box(crane: Crane) -> np.ndarray:
    """Return the corners of the box about the load in the frame of its joint [m], shape (8, 3):
    three neighbours of the fourth first.
    """
    points = [placement.act(p) for s, placement in _load_shapes(crane) for p in s.hull_points()]
    low, high = crane.payload.lever - 0.5, crane.payload.lever + 0.5
    if points:
        low, high = np.min(points, axis=0), np.max(points, axis=0)
    corners = [
        [1, 0, 0],
        [0, 1, 0],
        [0, 0, 1],
        [0, 0, 0],
        [1, 1, 0],
        [1, 0, 1],
        [0, 1, 1],
        [1, 1, 1],
    ]
    return low + np.array(corners) * (high - low)


def _frontal_area(crane: Crane) -> float:
    """Return the mean area of the vertical sides of the load [m²]."""
    box = _load_box(crane)
    wide, deep, tall = np.ptp(box, axis=0).tolist()
    return 0.5 * (wide + deep) * tall


# --- assistances ----------------------------------------------------------------------------------

_ASSISTANCES = {
    "none": ("Off", "The drives follow the sticks by their ramps."),
    "shaped": ("Shaped", "Half of each command comes half a swing period later (ZV shaper)."),
    "yielding": ("Yielding", "Slew and trolley give way to the load, which damps its swing."),
    "lqr": ("LQR", "Feedback of the whole state holds the load on the motion of the sticks."),
    "predictive": ("Predictive", "An optimisation drives the load to the goal that is clicked."),
}


def _assistances(crane: Crane) -> list[dict[str, str]]:
    """Return the assistances that a crane can have."""
    known = set(_ASSISTANCES)
    if not len(crane.swings):
        known &= {"none"}
    if not _is_tower(crane):
        known -= {"yielding"}
    if crane.springs.any:
        known -= {"predictive"}
    return [
        {"name": name, "label": label, "text": text}
        for name, (label, text) in _ASSISTANCES.items()
        if name in known
    ]


def _is_tower(crane: Crane) -> bool:
    roles = ("slew", "trolley", "radial_swing", "tangential_swing", "hoist")
    return crane.layout.has(*roles) and crane.layout.n == len(roles)


def _assist_data(crane: Crane, drives: Converters) -> dict[str, Any]:
    layout, response = (
        crane.layout,
        drives.lags + drives.delay + drives.accelerations / drives.jerks,
    )
    hoist = layout.drive_of("hoist")
    lengths = _rows(crane, "hoist", _LENGTHS)
    data: dict[str, Any] = {
        "rates": _usual_rates(drives).tolist(),
        "accelerations": drives.accelerations.tolist(),
        "reaction": (2.0 * response).tolist(),  # twice, or the end would be overshot
        "joints": layout.drives.tolist(),
        "hoist": -1 if hoist is None else hoist,
        "swing": {
            "lengths": lengths,
            "periods": [_swing_period(crane, _at(crane, hoist=length)) for length in lengths],
        },
    }
    if _is_tower(crane):
        _, x, phi, theta, length = layout.tower("Drives that yield to the swing")
        data["yielding"] = {
            "x": x,
            "phi": phi,
            "theta": theta,
            "l": length,
            "slew": layout.drive_of("slew"),
            "trolley": layout.drive_of("trolley"),
            "ratio": YIELDING,
            "gravity": crane.gravity,
        }
    if len(crane.swings):
        data["lqr"] = _lqr_data(crane, drives, lengths)
    return data


def _rows(crane: Crane, role: str, count: int) -> list[float]:
    """Return coordinates over the range of a role's joint; one where there is none."""
    layout = crane.layout
    if not layout.has(role):
        return [0.0]
    joint = layout.role(role, "")
    return np.linspace(crane.lower[joint], crane.upper[joint], count).tolist()


def _at(crane: Crane, **coordinates: float) -> np.ndarray:
    """Return coordinates at rest, with those of some roles given."""
    q = crane.start.q.copy()
    for role, value in coordinates.items():
        if crane.layout.has(role):
            q[crane.layout.role(role, "")] = value
    return crane.resting(q)


def _swing_period(crane: Crane, q: np.ndarray) -> float:
    """Return the period of the slowest swing with the drives locked [s]; 1 if nothing swings."""
    if not len(crane.swings):
        return 1.0
    passive = crane.layout.passive
    mass = pin.crba(crane.model, crane.data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    by_state = linearise(crane, State(q, np.zeros(len(q))), holding_effort(crane, q))[0]
    stiffness = -(mass @ by_state[:, : len(q)])[np.ix_(passive, passive)]
    squares = np.linalg.eigvals(np.linalg.solve(mass[np.ix_(passive, passive)], stiffness)).real
    slowest = squares[squares > 1e-6 * squares.max()].min()
    return float(2.0 * math.pi / math.sqrt(slowest))


def _lqr_data(crane: Crane, drives: Converters, lengths: Sequence[float]) -> dict[str, Any]:
    """Return gains from state to rates over radius and cable length."""
    layout, radii = crane.layout, _rows(crane, "trolley", _RADII)
    weight, gains = SOFTER * effort_weight_of(crane), []
    for radius in radii:
        for length in lengths:
            q = _at(crane, trolley=radius, hoist=length)
            still = np.zeros((1, layout.n))
            motion = Motion(PERIOD, q[None], still, still, layout.drives)
            efforts = lqr(crane, motion, effort_weight=weight)
            rates: Any = as_velocity_command(
                crane, efforts, drive="effort", converters=drives, control_period=PERIOD
            )
            gains.append(rates.gain[-1].ravel().tolist())
    return {
        "x": layout.role("trolley", "") if layout.has("trolley") else -1,
        "l": layout.role("hoist", "") if layout.has("hoist") else -1,
        "radii": radii,
        "lengths": list(lengths),
        "gains": gains,
        "rest": crane.resting(crane.start.q).tolist(),
    }


# --- code -----------------------------------------------------------------------------------------


def _kernel_data(
    crane: Crane,
    drives: Converters,
    sliders: Sequence[Slider],
    cranes: Sequence[Crane],
    responses: Sequence[np.ndarray],
) -> dict[str, Any]:
    """Return the code as WebAssembly, with the layout of its memory."""
    from cranedyn.compiled.horizon.receding import receding
    from cranedyn.compiled.kernel import Recipe, build_module
    from cranedyn.compiled.layout import SLOTS, size, slices
    from cranedyn.compiled.verify import compile_kernel
    from cranedyn.compiled.webassembly import webassembly  # other exporters need no llvmlite

    recipe = Recipe(
        lanes=1,
        drive="velocity",
        integrator=semi_implicit_euler,
        buffers=False,
        integral=False,
        offset=False,
        forces=True,
        shared=(True, True, True),
        log=True,
        summary=True,
        delay_steps=drives.delay_steps(DT, PERIOD),
    )
    usual = np.concatenate(drives.response)
    kernel, numbers = compile_kernel([crane, *cranes], recipe, np.array([usual, *responses]))
    source = kernel.source
    modules = {"plain": build_module(source)}
    data: dict[str, Any] = {}
    if any(entry["name"] == "predictive" for entry in _assistances(crane)):
        limits = Limits(_usual_rates(drives).tolist(), drives.accelerations.tolist())
        controller = receding(crane, limits, drive="velocity", converters=drives)
        programme = controller.programme
        modules["predictive"] = build_module(
            source._replace(recipe=replace(recipe, programme=programme))
        )
        data["horizon"] = _packed(controller.memory(1).tobytes())
        data["counts"] = programme.offsets(1).counts
    buffers = {
        "state": source.sizes.state,
        "gain_table": source.sizes.gain_table,
        "setpoint_table": source.sizes.setpoint_table,
        "force": source.sizes.force,
        "log": source.sizes.row,
        "summary": source.sizes.summary,
    }
    return data | {
        "modules": {name: _packed(webassembly(module)) for name, module in modules.items()},
        "slots": SLOTS,
        "sections": {
            name: {key: [part.start, part.stop] for key, part in slices(sections).items()}
            for name, sections in buffers.items()
        },
        "sizes": {name: size(sections) for name, sections in buffers.items()},
        "numbers": numbers[0].tolist(),
        "variations": {
            slider.name: (row - numbers[0]).tolist()
            for slider, row in zip(sliders, numbers[1:], strict=True)
        },
        "state": np.concatenate(crane.start).tolist(),
        "drives": crane.layout.drives.tolist(),
        "dt": DT,
        "period": PERIOD,
        "steps": round(PERIOD / DT),
    }


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


# --- site -----------------------------------------------------------------------------------------


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


def _tasks(crane: Crane, drives: Converters, site: Site | None) -> Iterator[dict[str, Any]]:
    """Yield the exercises: those for a tower crane, or on a site its lift."""
    if not _is_tower(crane):
        return
    limits = Limits(_usual_rates(drives).tolist(), drives.accelerations.tolist())
    if site is None:
        given = list(exercises(crane, limits))
        turn, foot = np.eye(3), np.zeros(3)
    else:
        lift = lift_exercise(crane, limits, site)
        given = [] if lift is None else [lift]
        turn, foot = _frame(site)
    for exercise in given:
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
            "parts": [part for solid in solids for part in _parts(solid)],
            "solids": _solids_data(solids),
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
        directions *= np.where(_first_nonzero(directions) < 0.0, -1.0, 1.0)[:, None]
        yield {
            "name": solid.name,
            "corners": corners[hull.vertices].tolist(),
            "faces": [[*normal, -offset] for *normal, offset in faces.tolist()],
            "edges": np.unique(directions.round(9), axis=0).tolist(),
        }


def _first_nonzero(rows: np.ndarray) -> np.ndarray:
    """Return the first number of each row that is not zero."""
    return rows[np.arange(len(rows)), (np.abs(rows) > 1e-9).argmax(axis=1)]


def _title(crane: Crane) -> str:
    return crane.model.name.replace("_", " ")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments beside the file and the crane."""
    parser.add_argument(
        "--site", metavar="FILE", default=None, help="obstacles about the crane, a .toml file"
    )


def run(options: argparse.Namespace) -> Path:
    """Write what the command line describes, and return its path."""
    site = None if options.site is None else read_site(options.site)
    if site is not None:
        options.values = [*(f"{k}:={v}" for k, v in site.crane.items()), *options.values]
    return export(options.target, crane_from_options(options), site=site)
