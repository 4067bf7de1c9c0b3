"""A planned lift, simulated under its controller with its swing, and checked against its site.

The certificate trusts nothing of the plan but the motion that it asks for: distances are measured
again, with the load where the simulation has it, and between the rows they are proven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.assumptions import Assumption
from cranedyn.controllers.integral import HOIST_INTEGRAL, HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import EngineName
from cranedyn.lifts.planning.clearance import Clearance, Nearest
from cranedyn.lifts.planning.coverage import coverage_check, hanging_pairs, slewing_pairs
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.motion_proof import slew_range, unproven_row
from cranedyn.lifts.planning.plan_assumptions import plan_assumptions, winch_of
from cranedyn.lifts.planning.remeasure import second_look
from cranedyn.lifts.planning.standing import standing_check, standing_parts
from cranedyn.lifts.planning.timing import STEP
from cranedyn.lifts.planning.tower_clearance import TowerClearance
from cranedyn.simulation.simulate import simulate
from cranedyn.verdict import Check, Verdict, overall

AFTER = 5.0
"""Time that a lift is watched after its arrival [s]."""

ARRIVAL_SWING = 0.05e-3
"""Largest amplitude of the swing at the arrival [rad]."""

_MEASURING_INTERVAL = 0.2
"""Time between measurements of the distances to all obstacles [s]."""

ARRIVAL_OFFSET = 0.01
"""Largest distance of the load from its goal at the end [m]."""

_SWINGING_INTERVAL = 0.5
"""Time between the instants of the motion at which the load is swung to all sides [s]."""

_SECOND_LOOK_RANGE = 0.5
"""Distance beyond the required or claimed one up to which a second look measures [m]."""

_SECOND_TOLERANCE = 2e-3
"""Tolerance of the comparison with the second look [m]: twenty times the rounding error of
distances (`cranedyn.lifts.planning.clearance.ROUNDING`), and little beside a required distance.

The swing needs none. A second look adds it to the two angles of the rope, which turns that by no
more than the swing itself, so that no point leaves the envelope that is proven.
"""

_MAX_RATE_SHARE = 1.005
"""Largest share of a rate that a drive may reach while the controller corrects it."""

_BEYOND = 1e-9
"""Angle beyond the slew angles of a run up to which the jib must be free [rad]."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """A simulated lift and its checks.

    Attributes:
        lift: The planned lift.
        run: The simulated run.
        t: Times at which distances were measured [s], shape (m,).
        distances: Distance of all that hangs from each obstacle at these times [m], by name of the
            obstacle, shape (m,) each.
        nearest: Least distance of all that hangs, with its body and obstacle; zones count where
            something is in them.
        nearest_t: Time of the least distance [s].
        residual_swing: Amplitude of the swing at the arrival [rad].
        checks: All requirements.
    """

    lift: Lift
    run: Trajectory
    t: np.ndarray
    distances: dict[str, np.ndarray]
    nearest: Nearest
    nearest_t: float
    residual_swing: float
    checks: Sequence[Check]

    @property
    def holds(self) -> bool:
        """Whether all checks hold; one that was not judged does not."""
        return overall(self.checks) is Verdict.HOLDS

    @property
    def assumptions(self) -> list[Assumption]:
        """What the certificate rests on, with where each value is from."""
        lift = self.lift
        return plan_assumptions(lift.clearance.site, lift.crane, lift.limits)


def controller_of(lift: Lift, *, dt: float = 5e-4) -> HoistIntegral:
    """Return a new controller for a lift: a full-model LQR about its motion, with an integrator on
    the hoist.
    """
    crane = lift.crane
    max_force = float(crane.effort_limit[winch_of(crane)])
    return HoistIntegral(crane, _tracking(lift, dt), HOIST_INTEGRAL, max_force)


_tracking_of_lifts = WeakKeyDictionary[Lift, dict[float, Tracking]]()
"""The LQRs that were designed for a lift, by the step of the simulation [s]. A report asks for that
of a lift at many places, and the design takes as long as hundreds of simulated lifts. The keys are
weak: an LQR goes with its lift."""


def _tracking(lift: Lift, dt: float) -> Tracking:
    """Return the full-model LQR about the motion of a lift. It has no memory, so that all
    controllers of the lift share it.
    """
    designed = _tracking_of_lifts.setdefault(lift, {})
    if dt not in designed:
        designed[dt] = lqr(lift.crane, lift.timed.motion, dt=dt)
    return designed[dt]


def certify(
    lift: Lift,
    clearance: Clearance | None = None,
    *,
    controller: HoistIntegral | None = None,
    dt: float = 5e-4,
    engine: EngineName = "compiled",
) -> Certificate:
    """Simulate a lift and check it against its site.

    Args:
        lift: The lift.
        clearance: Crane and site to check it against; None for those it was planned for.
        controller: Controller of the lift, see `controller_of`.
        dt: Physics step [s].
        engine: Engine that computes a step.

    Raises:
        RunError: If the simulation breaks off.
    """
    if clearance is None:
        clearance = lift.clearance
    if controller is None:
        controller = controller_of(lift, dt=dt)
    motion = lift.timed.motion
    run = _simulated(lift, controller, dt, engine)
    measured = _measured(clearance, run, motion.period)
    residual_swing = _swing_at(lift, run, motion.arrival)
    standing = standing_parts(clearance)
    covered = hanging_pairs(clearance) | slewing_pairs(clearance) | standing.pairs
    slewing = []
    if isinstance(clearance, TowerClearance):  # others prove the jib together with what hangs
        slewing.append(_slewing_check(clearance, run.q[:, clearance.joints.slew]))
    checks = [
        _distance_check(clearance, run, motion.period, measured),
        _second_look_check(clearance, lift, run.q[measured.rows], measured.nearest),
        *slewing,
        standing_check(standing),
        _swing_check(clearance, run),
        _arrival_check(clearance, lift, run, residual_swing),
        _drives_check(clearance, lift, run),
        coverage_check(clearance, covered),
    ]
    return Certificate(
        lift=replace(lift, clearance=clearance),
        run=run,
        t=run.t[measured.rows],
        distances=measured.distances,
        nearest=measured.nearest,
        nearest_t=measured.nearest_t,
        residual_swing=residual_swing,
        checks=checks,
    )


def _simulated(lift: Lift, controller: HoistIntegral, dt: float, engine: EngineName) -> Trajectory:
    """Return a run of a lift under a controller, until `AFTER` its arrival."""
    motion = lift.timed.motion
    start, _ = lift.states()
    periods_after = math.ceil(AFTER / motion.period)
    return simulate(
        lift.crane,
        replace(controller, integral=0.0),  # it may have been used before
        motion,
        start=start,
        duration=motion.arrival + motion.period * periods_after,
        dt=dt,
        control_period=motion.period,
        engine=engine,
    )


@dataclass(frozen=True, eq=False)
class _Measured:
    """Distances of a run, measured where the simulation has the load.

    Attributes:
        nearest: Least distance of all that hangs, with its body and obstacle.
        nearest_t: Its time [s].
        rows: Rows of the run at which distances to all obstacles were measured, shape (m,).
        distances: Distance from each obstacle in these rows [m], by name, shape (m,) each.
    """

    nearest: Nearest
    nearest_t: float
    rows: np.ndarray
    distances: dict[str, np.ndarray]


def _measured(clearance: Clearance, run: Trajectory, period: float) -> _Measured:
    """Return the distances of a run with a time between its rows [s]."""
    nearest_row = clearance.nearest_row(run.q)
    stride = max(1, round(_MEASURING_INTERVAL / period))
    last_row = len(run) - 1
    rows = np.unique(np.append(np.arange(0, len(run), stride), last_row))
    nearest_by_obstacle = [clearance.distances(run.q[row], jib=False) for row in rows]
    distances = {}
    for name in nearest_by_obstacle[0]:
        of_rows = [of_row[name].distance for of_row in nearest_by_obstacle]
        distances[name] = np.array(of_rows)
    return _Measured(
        nearest=clearance.nearest(run.q[nearest_row]),
        nearest_t=float(run.t[nearest_row]),
        rows=rows,
        distances=distances,
    )


def _second_look_check(
    clearance: Clearance, lift: Lift, measured_rows: np.ndarray, nearest: Nearest
) -> Check:
    """Check that distances measured in another way, see `cranedyn.lifts.planning.remeasure`, do not
    contradict what is claimed: the least distance of the run, and that the load keeps the required
    distance wherever it swings in its envelope.

    Args:
        clearance: Crane and site.
        lift: The lift, whose motion is proven with the envelope about it.
        measured_rows: Coordinates of the simulated run, shape (m, n).
        nearest: The least distance that is claimed of the run.
    """
    site = clearance.site
    hanging = second_look(
        site, clearance.crane, measured_rows, nearest.distance + _SECOND_LOOK_RANGE
    )
    stride = max(1, round(_SWINGING_INTERVAL / STEP))
    # The envelope is about a plumb rope above the planned places: those of the load, or in least
    # time those of the drives, where the load swings within it.
    plumb = clearance.q(lift.timed.places[::stride])
    swung = second_look(
        site,
        clearance.crane,
        plumb,
        site.distance + _SECOND_LOOK_RANGE,
        swing=site.swing,
    )
    # Points can only overestimate a distance: one below what is claimed contradicts the claim.
    agrees = nearest.distance - _SECOND_TOLERANCE <= hanging.distance
    keeps = all(found.distance >= site.distance - _SECOND_TOLERANCE for found in (hanging, swung))

    def shown(found: Nearest) -> str:
        if not found.body:
            return f"more than {found.distance:.2f} m"
        return f"{found.distance:.2f} m ({found.body} and {found.obstacle})"

    return Check(
        f"Measured a second time, by points of load and rope: {shown(hanging)}, and swung by "
        f"{math.degrees(site.swing):.2g}° from plumb to all sides {shown(swung)}; "
        f"{site.distance:g} m required.",
        agrees and keeps,
    )


def _swing_at(lift: Lift, run: Trajectory, t: float) -> float:
    """Return the amplitude of the swing [rad] of a run at a time [s]."""
    row = int(np.searchsorted(run.t, t - 1e-9))  # the row of that time, in spite of rounding
    angles, rates = lift.clearance.swing(run.q[row : row + 1, :], run.v[row : row + 1, :])
    length = float(lift.clearance.cable(run.q[row]))
    return float(swing_amplitude(angles, rates, length, lift.crane.gravity)[0])


def _distance_check(
    clearance: Clearance, run: Trajectory, period: float, measured: _Measured
) -> Check:
    """Check that all that hangs keeps the required distance, in the measured rows and, by a proof,
    between them.

    Args:
        clearance: Crane and site.
        run: The simulated run.
        period: Time between its rows [s].
        measured: Its distances.
    """
    required = clearance.site.distance
    nearest = measured.nearest
    what = "Nothing that hangs" if clearance.jib_apart else "Nothing that moves"
    unproven = unproven_row(clearance, run.q, period)
    proof = "proven between all instants"
    if unproven is not None:
        proof = f"not proven at t = {float(run.t[unproven]):.2f} s"
    return Check(
        f"{what} comes nearer than {required:g} m: least is "
        f"{nearest.distance:.2f} m, {nearest.body} and {nearest.obstacle} at "
        f"t = {measured.nearest_t:.1f} s; {proof}.",
        unproven is None and nearest.distance >= required,
    )


def _slewing_check(clearance: TowerClearance, slew: np.ndarray) -> Check:
    """Check that jib and counter-jib keep the required distance at all slew angles of a run [rad],
    shape (rows,).
    """
    low = float(slew.min())
    high = float(slew.max())
    # A little farther than the run turns, so that a jib that stands still is looked at, too.
    free = slew_range(clearance, float(slew[0]), low - _BEYOND, high + _BEYOND)
    # An empty range says that the jib is too close where it starts.
    if free.low <= low and high <= free.high and free.low < free.high:
        turns = f"jib and counter-jib turn freely, with {clearance.site.distance:g} m at least"
        return Check(f"Slewing: {turns}.", True)
    return Check(f"Slewing: the jib comes too near to {free.below or free.above}.", False)


def _swing_check(clearance: Clearance, run: Trajectory) -> Check:
    """Check that the rope never leans more than the site allows."""
    peak_swing = float(clearance.tilt(run.q).max())
    return Check(
        f"The load swings {1000 * peak_swing:.1f} mrad at most, "
        f"{1000 * clearance.site.swing:.1f} allowed.",
        peak_swing <= clearance.site.swing,
    )


def _arrival_check(
    clearance: Clearance, lift: Lift, run: Trajectory, residual_swing: float
) -> Check:
    """Check that the load arrives at its goal, and that its residual swing, an amplitude [rad], is
    small.

    Where it arrives is where it hangs plumb below the drives in the last row. How far it swings
    about that is the other requirement.
    """
    _, goal = lift.states()
    places = np.array([run.q[-1], goal.q])[:, clearance.drive_joints]
    end, planned_end = clearance.point(places)
    offset = float(np.linalg.norm(end - planned_end))
    return Check(
        f"At the arrival it swings {1e3 * residual_swing:.4f} mrad, {1e3 * ARRIVAL_SWING:g} "
        f"allowed; it ends {1000.0 * offset:.1f} mm from its goal, "
        f"{1000.0 * ARRIVAL_OFFSET:g} allowed.",
        residual_swing <= ARRIVAL_SWING and offset <= ARRIVAL_OFFSET,
    )


def _drives_check(clearance: Clearance, lift: Lift, run: Trajectory) -> Check:
    """Check that the drives can do what the controller commands: their rates keep their limits, and
    no effort is cut.
    """
    shares = np.abs(run.v[:, clearance.drive_joints]).max(axis=0) / np.array(lift.limits.rates)
    share = float(shares.max())
    is_cut = bool((run.command != run.effort).any())
    return Check(
        f"Rates are {100 * share:.1f} % of their limits at most; efforts are "
        f"{'cut' if is_cut else 'never cut'}.",
        share <= _MAX_RATE_SHARE and not is_cut,
    )
