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
from cranedyn.data.time_series import ColumnSeries
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.drives import cable_buffers
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.dynamics.validity import hoist_force
from cranedyn.errors import MissingRole, OutOfRange
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.wrench import CraneStates, Wrench
from cranedyn.lifts.planning.boom import boom_of
from cranedyn.lifts.planning.site import CRANE_HEADING, Arm, Base, Runway, crane_to_site
from cranedyn.model.crane import Crane

_UP = np.array([0.0, 0.0, 1.0])
"""Direction against gravity in the world."""

_PRINCIPAL = ("load_moment_Nm", "rope_N", "off_lead_rad", "side_lead_rad")
"""Columns that a figure shows by default."""

_MIN_HORIZONTAL_PART = 1e-9
"""Horizontal part of a unit axis up to which it points nowhere in plan."""


@dataclass(frozen=True, eq=False, repr=False)
class Loads(ColumnSeries):
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
    runway: Runway | None = None,
    heading: float = CRANE_HEADING,
) -> Loads:
    """Return the loads of a recorded run.

    Which joints are its hoist, trolley and slew, see
    `cranedyn.lifts.judging.load_joints.LoadJoints`. Columns of a crane with a hoist:

    * `rope_N`: tension of the rope.
    * `pull_N`: force with which all that hangs pulls down.
    * `slack_margin`: tension over the weight that hangs; the rope is slack at 0.
    * `snag_margin`: share of the hoist's largest force that the tension leaves.

    With a trolley or a slew as well:

    * `off_lead_rad`: angle of the rope from plumb in the plane of jib, boom or bridge, outwards
      positive.
    * `side_lead_rad`: angle of the rope from plumb across it, positive as positive slew moves it.
    * `side_force_percent`: horizontal force of the rope across the jib, of the weight that hangs.

    With a slew, too:

    * `radius_m`: distance of the hook from the slew axis in plan, which is the radius that a load
      chart means. A load that hangs plumb has its pivot at the same radius. One that is swept round
      hangs farther out than its pivot, which the pull of the rope then tilts the crane with.
    * `pivot_radius_m`: distance of the pivot of the rope from the slew axis in plan.
    * `load_moment_Nm`: pull times the radius of the pivot of the rope, which is what a load moment
      indicator shows that knows the geometry of the boom.
    * `ring_vertical_N`: force on the slewing ring, downwards positive.
    * `ring_tilting_Nm`: moment in the plane of the jib, jib down positive.
    * `ring_lateral_Nm`: moment about the direction of the jib.
    * `ring_torsion_Nm`: moment about the slew axis.

    With one drive that luffs a boom:

    * `boom_m`: length of the boom, from its hinge to its head.

    Every crane, about the origin of its model, which is the foot of the crane of a site:

    * `foot_vertical_N`: force on the foot, downwards positive; the weight of a base is counted.
    * `foot_x_Nm`, `foot_y_Nm`: moments about X and Y of the crane's frame.
    * `overturning_Nm`: magnitude of both together.
    * `torsion_Nm`: moment about Z.
    * `wheel_1_N` to `wheel_4_N`: forces of the wheels on rails, if a crane travels on such, see
      `wheel_forces`; `wheel_1_load_N` to `wheel_4_load_N`: what of them the load causes.
    * `corner_1_N` to `corner_4_N`: forces of the corners of a base, if there is one, see
      `corner_forces`.

    Args:
        crane: The crane that moved.
        run: What it did.
        base: On what it stands; None if that is not known.
        arms: Jib and counter-jib, as far as the model does not weigh them; for a crane with a
            trolley and a slew.
        runway: Rails on which it travels; None if that is not known.
        heading: Direction of the jib at zero slew against the sides of the base, as of
            `cranedyn.lifts.planning.site.Site` [rad].

    Raises:
        OutOfRange: If the run is of another crane or on a base that moves, or a number or a load is
            not finite.
        MissingRole: If there are arms, and no joint is a trolley.
    """
    run.check_coordinates(crane.layout.columns()["q"])
    run.check_base_at_rest("the computation of loads")
    buffers = run.parameters.get("validity") == "buffers"
    columns = loads_of_rows(
        crane,
        run.q,
        run.v,
        run.effort,
        run.force,
        base=base,
        arms=arms,
        runway=runway,
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
    runway: Runway | None = None,
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
        runway: As of `loads`.
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
    joints = LoadJoints.of(crane)
    if joints.hoist is not None:
        columns |= _of_rope(crane, joints, moving, effort, buffers)
    if None not in (joints.hoist, joints.slew, joints.pivot):
        columns |= _of_ring(joints, moving, columns["pull_N"], arm_weight, arm_moment)
    columns |= _of_boom(crane, moving)
    foot = moving.through_ground()
    if arms:
        layout.role("trolley", "A jib that weighs where it lies")
        outward, _ = _jib_directions(moving, joints)
        # A weight W at r along the jib turns the foot by r × (-W up).
        moment = foot.moment + np.cross(outward, -_UP) * arm_moment
        foot = foot._replace(force=foot.force - _UP * arm_weight, moment=moment)
    # What is fixed to the ground passes through no joint: a portal whose travel is locked.
    fixed = crane.model.inertias[0]
    if fixed.mass > 0.0:
        weight = -_UP * fixed.mass * crane.gravity
        moment = foot.moment + np.cross(fixed.lever, weight)
        foot = foot._replace(force=foot.force + weight, moment=moment)
    base_weight = 0.0 if base is None else base.mass * crane.gravity
    columns |= {
        "foot_vertical_N": -foot.force[:, 2] + base_weight,
        "foot_x_Nm": foot.moment[:, 0],
        "foot_y_Nm": foot.moment[:, 1],
        "overturning_Nm": np.hypot(foot.moment[:, 0], foot.moment[:, 1]),
        "torsion_Nm": foot.moment[:, 2],
    }
    if base is not None:
        about = foot
        if joints.slew is not None:  # the base is centred below the slew axis
            centre = moving.origin(joints.slew) * np.array([1.0, 1.0, 0.0])
            about = foot._replace(moment=foot.moment - np.cross(centre, foot.force))
        corners = corner_forces(base, about, crane.gravity, heading=heading).T
        columns |= {f"corner_{i}_N": force for i, force in enumerate(corners, start=1)}
    if runway is not None:
        columns |= _of_wheels(crane, joints, moving, runway, columns["pull_N"])
    # An overflow would pass for a small load: infinity over infinity, or minus infinity.
    return {
        name: finite(name, values, ("rows",)).reshape(shape) for name, values in columns.items()
    }


def corner_forces(
    base: Base, foot: Wrench, gravity: float, *, heading: float = CRANE_HEADING
) -> np.ndarray:
    """Return the force of each corner of a base on the ground [N], shape (rows, 4), at (+, +),
    (-, +), (-, -), (+, -) of the axes of the site, or of those of the crane if the base turns with
    it; negative where the corner would lift.

    A stiff base on four equal supports presses by F = V/4 + (M_y x - M_x y)/b² at x, y = ±b/2.

    Args:
        base: The base.
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
    moment = foot.moment
    if not base.turns_with_crane:
        # The crane may stand turned on its base, so that its axes are not those of the corners.
        moment = moment @ crane_to_site(heading).T
    m_x = moment[:, 0]
    m_y = moment[:, 1]
    # x = ±b/2 over b² is ±1/(2 b).
    tilting = [(m_y * x - m_x * y) / (2.0 * base.spacing) for x, y in signs]
    corners = np.stack([vertical / 4.0 + force for force in tilting], axis=1)
    return finite("force of a corner", corners, ("rows", 4), unit="N")


def wheel_forces(
    runway: Runway, vertical: np.ndarray, across: np.ndarray, along: np.ndarray
) -> np.ndarray:
    """Return the force of each wheel on its rail [N], shape (rows, 4): on the first rail the front
    and the rear wheel, then those on the second rail; negative where a wheel would lift.

    A stiff frame on four equal supports presses by F = V (1/4 ± c/(2 s) ± a/(2 w)) with the force
    V at c across from the middle of the rails, which are s apart, and at a ahead of the middle of
    the wheels, which are w apart. Forces of several loads add. What acts on the crane at another
    height than that of the rails is in c and a.

    Args:
        runway: The rails.
        vertical: Force down [N], shape (rows,).
        across: Where it acts across the way of the crane, as `Runway.rails` [m], shape (rows,).
        along: Where it acts along the way from the middle of the wheels [m], shape (rows,).
    """
    first, second = runway.rails
    # Positive towards the first rail.
    aside = (across - (first + second) / 2.0) / (first - second)
    ahead = along / runway.wheel_base
    shares = []
    for rail in (aside, -aside):
        shares += [0.25 + (rail + wheel) / 2.0 for wheel in (ahead, -ahead)]
    return np.stack([vertical * share for share in shares], axis=1)


def _of_wheels(
    crane: Crane, joints: LoadJoints, moving: CraneStates, runway: Runway, pull: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the forces of the wheels, and what of them the load causes.

    Raises:
        MissingRole: If the crane does not travel.
    """
    if joints.travel is None or joints.pivot is None:
        names = [joint.name for joint in crane.layout.joints]
        raise MissingRole("Wheel loads of a runway", "travel", names)
    way = moving.axis(joints.travel)
    left = np.cross(_UP, way)
    frame = moving.through(joints.travel)
    vertical = -frame.force[:, 2]
    # A force V down at r turns by r × (-V up): by -V r·left about the way, by V r·way about left.
    across = _along(frame.point, left) - _along(frame.moment, way) / vertical
    along = _along(frame.moment, left) / vertical
    wheels = wheel_forces(runway, vertical, across, along)
    pivot = moving.origin(joints.pivot)
    of_load = wheel_forces(runway, pull, _along(pivot, left), _along(pivot - frame.point, way))
    columns = {}
    for i in range(4):
        columns[f"wheel_{i + 1}_N"] = wheels[:, i]
        columns[f"wheel_{i + 1}_load_N"] = of_load[:, i]
    return columns


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
    _, aside = _jib_directions(moving, LoadJoints.of(crane))
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
    hoist = LoadJoints.of(crane).hoist
    if hoist is None:
        names = [joint.name for joint in crane.layout.joints]
        raise MissingRole("The mass that hangs", "hoist", names)
    # Pinocchio counts the world as joint 0, and parents come before their children.
    below = {hoist}
    for i, parent in enumerate(crane.model.parents[1:]):
        if parent - 1 in below:
            below.add(i)
    return float(sum(crane.model.inertias[i + 1].mass for i in below))


def _of_rope(
    crane: Crane, joints: LoadJoints, moving: CraneStates, effort: np.ndarray, buffers: bool
) -> dict[str, np.ndarray]:
    """Return the loads of the rope: tension, pull, margins from slack and from the hoist's largest
    force, and, with a trolley, its angles from plumb and its side force.
    """
    layout = crane.layout
    weight = hanging_mass(crane) * crane.gravity
    joint = joints.hoist
    assert joint is not None  # see `loads_of_rows`
    pull = moving.through(joint).force
    hoist = hoist_force(crane, effort)
    hoist = hoist + (cable_buffers(crane, moving.q, moving.v) if buffers else 0.0)
    rope_spring = crane.springs.rope
    if rope_spring is not None and rope_spring.inextensible:
        # No law gives the tension of a rope that cannot stretch: it is a constraint force.
        stretch = rope_spring.stretch
        tension = _along(moving.through(stretch).force, moving.axis(stretch))
    elif not layout.has("hoist"):
        # A rope that neither stretches nor goes slack: what passes through its hoist along it.
        tension = _along(pull, _down_along(moving.axis(joint)))
    else:
        tension = np.broadcast_to(
            rope_tension(layout, JointForces.of(crane), moving.q.T, moving.v.T, hoist),
            len(hoist),
        )
    columns = {"rope_N": tension, "pull_N": -pull[:, 2], "slack_margin": tension / weight}
    if joint in layout.drives:
        drive = layout.drives.tolist().index(joint)
        columns["snag_margin"] = 1.0 - tension / crane.effort_limit[drive]
    if joints.trolley is not None or None not in (joints.slew, joints.pivot):
        outward, aside = _jib_directions(moving, joints)
        rope = _down_along(moving.axis(joint))
        columns["off_lead_rad"] = np.arctan2(_along(rope, outward), -rope[:, 2])
        columns["side_lead_rad"] = np.arctan2(_along(rope, aside), -rope[:, 2])
        columns["side_force_percent"] = 100.0 * _along(pull, aside) / weight
    return columns


def _down_along(axis: np.ndarray) -> np.ndarray:
    """Return unit vectors down along a rope from the axis of its hoist, shape (rows, 3) each."""
    return np.where(axis[:, 2:] > 0.0, -axis, axis)


def _of_ring(
    joints: LoadJoints,
    moving: CraneStates,
    pull: np.ndarray,
    arm_weight: float,
    arm_moment: float,
) -> dict[str, np.ndarray]:
    """Return the loads of the slewing ring.

    Args:
        joints: Joints of the crane, with a slew and a pivot.
        moving: Its states.
        pull: Pull of what hangs [N], shape (rows,).
        arm_weight: Weight of jib and counter-jib that the model does not know [N].
        arm_moment: Its moment about the slew axis, jib down positive [N m].
    """
    assert joints.slew is not None and joints.pivot is not None
    outward, aside = _jib_directions(moving, joints)
    ring = moving.through(joints.slew)
    assert joints.hoist is not None  # its pull is given
    pivot_radius = _distance_in_plan(moving.origin(joints.pivot), ring.point)
    return {
        "radius_m": _distance_in_plan(moving.origin(joints.hoist), ring.point),
        "pivot_radius_m": pivot_radius,
        "load_moment_Nm": pull * pivot_radius,
        "ring_vertical_N": -ring.force[:, 2] + arm_weight,
        "ring_tilting_Nm": _along(ring.moment, aside) + arm_moment,
        "ring_lateral_Nm": _along(ring.moment, outward),
        "ring_torsion_Nm": ring.moment[:, 2],
    }


def _distance_in_plan(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the distances of points from others in plan [m], shape (rows,), of shape (rows, 3)
    each.
    """
    return np.hypot(points[:, 0] - others[:, 0], points[:, 1] - others[:, 1])


def _of_boom(crane: Crane, moving: CraneStates) -> dict[str, np.ndarray]:
    """Return the length of the boom, if the crane has one."""
    boom = boom_of(crane)
    if boom is None:
        return {}
    axis = moving.axis(boom.luff)
    vector = moving.origin(boom.head) - moving.origin(boom.luff)
    across = vector - axis * _along(axis, vector)[:, None]
    return {"boom_m": np.linalg.norm(across, axis=1)}


def _jib_directions(moving: CraneStates, joints: LoadJoints) -> tuple[np.ndarray, np.ndarray]:
    """Return unit vectors along jib, boom or bridge and aside from it, a quarter turn on in the
    sense of positive slew, both level, shape (rows, 3): along the axis of a trolley, or else from
    the slew axis to the pivot of the rope.
    """
    if joints.trolley is not None:
        outward = moving.axis(joints.trolley)
        what = "horizontal part of the trolley's axis"
    else:
        assert joints.slew is not None and joints.pivot is not None
        outward = moving.origin(joints.pivot) - moving.origin(joints.slew)
        what = "distance of the pivot from the slew axis [m]"
    if joints.slew is not None and joints.pivot is not None:
        # The axis of a trolley may point inward.
        to_pivot = moving.origin(joints.pivot) - moving.origin(joints.slew)
        outward = outward * np.where(_along(outward, to_pivot) < 0.0, -1.0, 1.0)[:, None]
    outward = outward * np.array([1.0, 1.0, 0.0])
    length = np.linalg.norm(outward, axis=1)
    if not (length > _MIN_HORIZONTAL_PART).all():
        raise OutOfRange(what, float(length.min()), "> 0")
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
