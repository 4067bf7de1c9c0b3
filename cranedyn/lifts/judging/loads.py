"""Loads of a crane during a run: rope, load moment at the slewing ring and along the jib, tower's
foot and its corners, and the margins of the rope from plumb, slack and its hoist's strength.

All of it follows from coordinates, rates and efforts of the recorded rows: these and gravity cause
accelerations, and with them Newton and Euler give what passes through each cut
(`cranedyn.lifts.judging.wrench`). Weights that the model does not know are added where they are
entered: mast, base and ballast by `Base`, jib and counter-jib by `Arm`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.data.time_series import TimeSeries
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.drives import cable_buffers
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.dynamics.validity import hoist_force
from cranedyn.errors import OutOfRange, UnknownColumn
from cranedyn.lifts.judging.wrench import CraneStates, Wrench
from cranedyn.lifts.planning.site import CRANE_HEADING, Arm, Base, crane_to_site
from cranedyn.model.crane import Crane

_UP = np.array([0.0, 0.0, 1.0])
"""Direction against gravity in the world."""

_PRINCIPAL = ("load_moment_Nm", "rope_N", "off_lead_rad", "side_lead_rad")
"""Columns that a figure shows by default."""

_MIN_HORIZONTAL_PART = 1e-9
"""Horizontal part of a unit axis up to which it points nowhere in plan."""


@dataclass(frozen=True, eq=False, repr=False)
class Loads(TimeSeries):
    """Loads of a run, one row for each row of the run.

    Attributes:
        t: Time [s], shape (rows,).
        values: Columns by name, with their units, shape (rows,) each; see `loads`.
        parameters: What they were computed with.
        record: Of the run they are of, see `cranedyn.data.trajectory.Trajectory`.
    """

    t: np.ndarray
    values: Mapping[str, np.ndarray]
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    record: Mapping[str, Any] = field(default_factory=dict)

    def keys(self) -> list[str]:
        """Return the names of the columns."""
        return ["t_s", *self.values]

    def __getitem__(self, column: str) -> np.ndarray:
        """Return a column by its name, shape (rows,).

        Raises:
            UnknownColumn: If there is no such column; it is also a KeyError.
        """
        if column == "t_s":
            return self.t
        if column not in self.values:
            raise UnknownColumn("column", column, self.keys())
        return self.values[column]

    @property
    def principal_keys(self) -> list[str]:
        """Names of the columns that a figure shows by default: load moment, rope and its angles."""
        return [name for name in _PRINCIPAL if name in self.values] or list(self.values)[:3]


def loads(
    crane: Crane,
    run: Trajectory,
    *,
    base: Base | None = None,
    arms: Sequence[Arm] = (),
    heading: float = CRANE_HEADING,
) -> Loads:
    """Return the loads of a recorded run.

    Columns of a crane with a hoist:

    * `rope_N`: tension of the rope.
    * `pull_N`: force with which all that hangs pulls down.
    * `slack_margin`: tension over the weight that hangs; the rope is slack at 0.
    * `snag_margin`: share of the hoist's largest force that the tension leaves.

    With a trolley as well:

    * `off_lead_rad`: angle of the rope from plumb in the plane of the jib, outwards positive.
    * `side_lead_rad`: angle of the rope from plumb across it, positive as positive slew moves it.
    * `side_force_percent`: horizontal force of the rope across the jib, of the weight that hangs.

    With a slew, too:

    * `radius_m`: distance of the trolley from the slew axis.
    * `load_moment_Nm`: pull times radius, which is what a load moment indicator shows.
    * `ring_vertical_N`: force on the slewing ring, downwards positive.
    * `ring_tilting_Nm`: moment in the plane of the jib, jib down positive.
    * `ring_lateral_Nm`: moment about the direction of the jib.
    * `ring_torsion_Nm`: moment about the slew axis.

    Every crane, about the origin of its model, which is the foot of the crane of a site:

    * `foot_vertical_N`: force on the foot, downwards positive; the weight of a base is counted.
    * `foot_x_Nm`, `foot_y_Nm`: moments about X and Y of the crane's frame.
    * `overturning_Nm`: magnitude of both together.
    * `torsion_Nm`: moment about Z.
    * `corner_1_N` to `corner_4_N`: forces of the corners of a base, if there is one, see
      `corner_forces`.

    Args:
        crane: The crane that moved.
        run: What it did.
        base: On what it stands; None if that is not known.
        arms: Jib and counter-jib, as far as the model does not weigh them; for a crane with a
            trolley and a slew.
        heading: Direction of the jib at zero slew against the sides of the base, as of
            `cranedyn.lifts.planning.site.Site` [rad].

    Raises:
        OutOfRange: If the run is of another crane, or a number or a load is not finite.
        MissingRole: If there are arms, and no joint is a trolley.
    """
    run.check_coordinates(crane.layout.columns()["q"])
    buffers = run.parameters.get("validity") == "buffers"
    columns = loads_of_rows(
        crane,
        run.q,
        run.v,
        run.effort,
        run.force,
        base=base,
        arms=arms,
        heading=heading,
        buffers=buffers,
    )
    entered: dict[str, float | str] = {}
    if base is not None:
        entered["base_spacing_m"] = base.spacing
        entered["base_mass_kg"] = base.mass
        entered["heading_rad"] = heading
    for i, arm in enumerate(arms, start=1):
        entered[f"arm_{i}_mass_kg"] = arm.mass
        entered[f"arm_{i}_centre_m"] = arm.centre
    return Loads(run.t, columns, entered, run.record)


def loads_of_rows(
    crane: Crane,
    q: np.ndarray,
    v: np.ndarray,
    effort: np.ndarray,
    force: np.ndarray | None = None,
    *,
    base: Base | None = None,
    arms: Sequence[Arm] = (),
    heading: float = CRANE_HEADING,
    buffers: bool = False,
) -> dict[str, np.ndarray]:
    """Return the columns of `loads` for any rows of states, such as those of a batch.

    Args:
        crane: The crane, with n joints and m drives.
        q: Coordinates [rad or m], shape (..., n).
        v: Their rates, shape (..., n).
        effort: Of the drives [N m or N], shape (..., m).
        force: From outside on the points of the crane in the world [N], shape (..., 3 points).
        base: As of `loads`.
        arms: As of `loads`.
        heading: As of `loads`.
        buffers: Whether buffers end the ranges of the drives.

    Returns:
        Columns by name, shape (...) each.

    Raises:
        OutOfRange: If an array has another shape, or a number or a load is not finite.
        MissingRole: If there are arms, and no joint is a trolley.
    """
    layout = crane.layout
    shape = np.shape(q)[:-1]
    q = _as_rows("q", q, layout.n)
    v = _as_rows("v", v, layout.n)
    effort = _as_rows("effort", effort, layout.m)
    if force is not None:
        force = _as_rows("force", force, 3 * len(crane.points))
    moving = CraneStates.of(crane, q, v, effort, force, buffers=buffers)

    columns: dict[str, np.ndarray] = {}
    arm_weight = crane.gravity * sum(arm.mass for arm in arms)
    arm_moment = crane.gravity * sum(arm.mass * arm.centre for arm in arms)
    if layout.has("hoist"):
        columns |= _of_rope(crane, moving, effort, buffers)
    if layout.has("slew", "trolley", "hoist"):
        columns |= _of_ring(crane, moving, columns["pull_N"], arm_weight, arm_moment)
    foot = moving.through_ground()
    if arms:
        trolley = layout.role("trolley", "A jib that weighs where it lies")
        outward, _ = _jib_directions(moving, trolley)
        # A weight W at r along the jib turns the foot by r × (-W up).
        moment = foot.moment + np.cross(outward, -_UP) * arm_moment
        foot = foot._replace(force=foot.force - _UP * arm_weight, moment=moment)
    base_weight = 0.0 if base is None else base.mass * crane.gravity
    columns |= {
        "foot_vertical_N": -foot.force[:, 2] + base_weight,
        "foot_x_Nm": foot.moment[:, 0],
        "foot_y_Nm": foot.moment[:, 1],
        "overturning_Nm": np.hypot(foot.moment[:, 0], foot.moment[:, 1]),
        "torsion_Nm": foot.moment[:, 2],
    }
    if base is not None:
        corners = corner_forces(base, foot, crane.gravity, heading=heading).T
        columns |= {f"corner_{i}_N": force for i, force in enumerate(corners, start=1)}
    # An overflow would pass for a small load: infinity over infinity, or minus infinity.
    return {
        name: finite(name, values, ("rows",)).reshape(shape) for name, values in columns.items()
    }


def corner_forces(
    base: Base, foot: Wrench, gravity: float, *, heading: float = CRANE_HEADING
) -> np.ndarray:
    """Return the force of each corner of a base on the ground [N], shape (rows, 4), at (+, +),
    (-, +), (-, -), (+, -) of the axes of the site; negative where the corner would lift.

    A stiff base on four equal supports presses by F = V/4 + (M_y x - M_x y)/b² at x, y = ±b/2.

    Args:
        base: The base, whose sides lie along X and Y of the site.
        foot: What passes through the foot of the tower, about the foot and in the axes of the
            crane.
        gravity: Gravity [m/s²].
        heading: Direction of the jib at zero slew, from the site's X towards its Y [rad]; by
            default that at which the axes of the crane are those of the site.

    Raises:
        OutOfRange: If a number is not finite, or gravity not positive.
    """
    number("gravity", gravity, "m/s²", "> 0")
    number("heading", heading, "rad")
    finite("force on the foot", foot.force, ("rows", 3), unit="N")
    finite("moment on the foot", foot.moment, ("rows", 3), unit="N m")
    vertical = -foot.force[:, 2] + base.mass * gravity
    signs = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]  # of x and y
    # The crane may stand turned on its base, so that its axes are not those of the corners.
    moment = foot.moment @ crane_to_site(heading).T
    m_x = moment[:, 0]
    m_y = moment[:, 1]
    # x = ±b/2 over b² is ±1/(2 b).
    tilting = [(m_y * x - m_x * y) / (2.0 * base.spacing) for x, y in signs]
    corners = np.stack([vertical / 4.0 + force for force in tilting], axis=1)
    return finite("force of a corner", corners, ("rows", 4), unit="N")


def jib_moment(crane: Crane, run: Trajectory, stations: np.ndarray) -> np.ndarray:
    """Return the bending moment of the jib in its own plane by trolley and load, jib down positive
    [N m].

    The jib's own weight is not in it: the model does not say where along the jib that lies. Beyond
    the trolley, towards the tip, the moment is zero.

    Args:
        crane: The crane that moved; it must have a trolley.
        run: What it did.
        stations: Distances from the slew axis [m], shape (k,).

    Returns:
        Shape (rows, k).

    Raises:
        MissingRole: If no joint is a trolley.
        OutOfRange: If a station or a moment is not finite.
    """
    stations = finite("stations", stations, ("k",), unit="m")
    trolley = crane.layout.role("trolley", "The moment along the jib")
    buffers = run.parameters.get("validity") == "buffers"
    moving = CraneStates.of(crane, run.q, run.v, run.effort, run.force, buffers=buffers)
    _, aside = _jib_directions(moving, trolley)
    root = moving.through(trolley)
    tilting = _along(root.moment, aside)
    down = -root.force[:, 2]
    ahead = run.q[:, trolley, None] - stations
    moment = np.where(ahead >= 0.0, tilting[:, None] + down[:, None] * ahead, 0.0)
    return finite("moment of the jib", moment, ("rows", "stations"), unit="N m")


def hanging_mass(crane: Crane) -> float:
    """Return the mass that hangs on the rope [kg].

    Raises:
        MissingRole: If no joint is a hoist.
    """
    hoist = crane.layout.role("hoist", "The mass that hangs")
    # Pinocchio counts the world as joint 0, and parents come before their children.
    below = {hoist}
    for i, parent in enumerate(crane.model.parents[1:]):
        if parent - 1 in below:
            below.add(i)
    return float(sum(crane.model.inertias[i + 1].mass for i in below))


def _of_rope(
    crane: Crane, moving: CraneStates, effort: np.ndarray, buffers: bool
) -> dict[str, np.ndarray]:
    """Return the loads of the rope: tension, pull, margins from slack and from the hoist's largest
    force, and, with a trolley, its angles from plumb and its side force.
    """
    layout = crane.layout
    weight = hanging_mass(crane) * crane.gravity
    joint = layout.role("hoist", "The rope")
    pull = moving.through(joint).force
    hoist = hoist_force(crane, effort)
    hoist = hoist + (cable_buffers(crane, moving.q, moving.v) if buffers else 0.0)
    rope_spring = crane.springs.rope
    if rope_spring is not None and rope_spring.inextensible:
        # No law gives the tension of a rope that cannot stretch: it is a constraint force.
        stretch = rope_spring.stretch
        tension = _along(moving.through(stretch).force, moving.axis(stretch))
    else:
        tension = np.broadcast_to(
            rope_tension(layout, JointForces.of(crane), moving.q.T, moving.v.T, hoist),
            len(hoist),
        )
    columns = {"rope_N": tension, "pull_N": -pull[:, 2], "slack_margin": tension / weight}
    drive = layout.drive_of("hoist")
    if drive is not None:
        columns["snag_margin"] = 1.0 - tension / crane.effort_limit[drive]
    if layout.has("trolley"):
        outward, aside = _jib_directions(moving, layout.role("trolley", "The plane of the jib"))
        rope = moving.axis(joint)
        columns["off_lead_rad"] = np.arctan2(_along(rope, outward), -rope[:, 2])
        columns["side_lead_rad"] = np.arctan2(_along(rope, aside), -rope[:, 2])
        columns["side_force_percent"] = 100.0 * _along(pull, aside) / weight
    return columns


def _of_ring(
    crane: Crane, moving: CraneStates, pull: np.ndarray, arm_weight: float, arm_moment: float
) -> dict[str, np.ndarray]:
    """Return the loads of the slewing ring.

    Args:
        crane: The crane.
        moving: Its states.
        pull: Pull of what hangs [N], shape (rows,).
        arm_weight: Weight of jib and counter-jib that the model does not know [N].
        arm_moment: Its moment about the slew axis, jib down positive [N m].
    """
    slew = crane.layout.role("slew", "The slewing ring")
    trolley = crane.layout.role("trolley", "The slewing ring")
    outward, aside = _jib_directions(moving, trolley)
    ring = moving.through(slew)
    radius = _along(moving.origin(trolley) - ring.point, outward)
    return {
        "radius_m": radius,
        "load_moment_Nm": pull * radius,
        "ring_vertical_N": -ring.force[:, 2] + arm_weight,
        "ring_tilting_Nm": _along(ring.moment, aside) + arm_moment,
        "ring_lateral_Nm": _along(ring.moment, outward),
        "ring_torsion_Nm": ring.moment[:, 2],
    }


def _jib_directions(moving: CraneStates, trolley: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors along the jib and aside from it, a quarter turn on in the sense of
    positive slew, both level, shape (rows, 3).
    """
    outward = moving.axis(trolley) * np.array([1.0, 1.0, 0.0])
    length = np.linalg.norm(outward, axis=1)
    if not (length > _MIN_HORIZONTAL_PART).all():
        raise OutOfRange("horizontal part of the trolley's axis", float(length.min()), "> 0")
    outward = outward / length[:, None]
    return outward, np.cross(_UP, outward)


def _along(vector: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the parts of vectors along unit vectors, shape (rows,), of shape (rows, 3) each."""
    return np.einsum("ij,ij->i", vector, direction)


def _as_rows(name: str, table: np.ndarray, width: int) -> np.ndarray:
    """Return a checked table of one row, rows, or rows of many cranes, as rows, shape (k, width).

    Raises:
        OutOfRange: If it has another shape, or a number is not finite.
    """
    shapes = (width,), ("rows", width), ("cranes", "rows", width)
    return finite(name, table, *shapes).reshape(-1, width)
