"""A planned lift, simulated under its controller with its swing, and checked against its site.

The certificate trusts nothing of the plan but the motion that it asks for: distances are measured
again, with the load where the simulation has it, and between the rows they are proven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.assumptions import Assumption
from cranedyn.controllers.integral import HOIST_INTEGRAL, HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import EngineName
from cranedyn.planning.clearance import Clearance, Nearest
from cranedyn.planning.coverage import coverage_check, hanging_pairs, slewing_pairs
from cranedyn.planning.lift import Lift
from cranedyn.planning.plan_assumptions import plan_assumptions
from cranedyn.planning.proof import SlewRange, slew_range, unproven_row
from cranedyn.planning.remeasure import second_look
from cranedyn.planning.site import Site
from cranedyn.planning.standing import standing_check, standing_parts
from cranedyn.simulation.simulate import simulate
from cranedyn.verdict import Check, Verdict, overall

AFTER = 5.0
"""Time that a lift is watched after its arrival [s]."""

ARRIVAL_SWING = 0.05e-3
"""Largest amplitude of the swing at the arrival [rad]."""

_MEASURED = 0.2
"""Time between measurements of the distances to all obstacles [s]."""

ARRIVAL_OFFSET = 0.01
"""Largest distance of the load from its goal at the end [m]."""

_SWUNG = 0.5
"""Time between the instants of the motion at which the load is swung to all sides [s]."""

_BEYOND = 0.5
"""Distance beyond the required or claimed one up to which a second look measures [m]."""

_SECOND_TOLERANCE = 2e-3
"""Tolerance of the comparison with the second look [m]: the motion is proven without its rows'
deviation from a circle of the swing, a thousandth of the envelope, and distances are less by
`cranedyn.planning.clearance.ROUNDING`.
"""

_TOO_FAST = 1.005
"""Share of a rate that a drive may reach while the controller corrects it."""


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
    largest = float(crane.effort_limit[crane.layout.drive("l")])
    return HoistIntegral(crane, lqr(crane, lift.timed.motion, dt=dt), HOIST_INTEGRAL, largest)


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
    clearance = lift.clearance if clearance is None else clearance
    controller = controller_of(lift, dt=dt) if controller is None else controller
    motion, (start, goal) = lift.timed.motion, lift.states()
    run = simulate(
        lift.crane,
        replace(controller, integral=0.0),
        motion,
        start=start,
        duration=motion.arrival + motion.period * math.ceil(AFTER / motion.period),
        dt=dt,
        control_period=motion.period,
        engine=engine,
    )
    # Measured, then proven, then judged.
    k = clearance.nearest_row(run.q)
    nearest, nearest_t = clearance.nearest(run.q[k]), float(run.t[k])
    stride = max(1, round(_MEASURED / motion.period))
    rows = np.unique(np.append(np.arange(0, len(run), stride), len(run) - 1))
    pairs = [clearance.distances(run.q[row], jib=False) for row in rows]
    distances = {name: np.array([row[name].distance for row in pairs]) for name in pairs[0]}
    end, planned = clearance.point(np.array([run.q[-1], goal.q])[:, clearance.drive_joints])
    offset = float(np.linalg.norm(end - planned))
    peak_swing = float(clearance.tilt(run.q).max())
    residual_swing = _swing_at(lift, run, motion.arrival)
    rates = np.abs(run.v[:, clearance.drive_joints]).max(axis=0) / np.array(lift.limits.rates)
    rate, cut = float(rates.max()), bool((run.command != run.effort).any())
    slew = run.q[:, clearance.joints.slew]
    row = unproven_row(clearance, run.q, motion.period)
    unproven_t = None if row is None else float(run.t[row])
    free = slew_range(clearance, float(slew[0]), float(slew.min()), float(slew.max()))
    standing = standing_parts(clearance)
    covered = hanging_pairs(clearance) | slewing_pairs(clearance) | standing.pairs
    checks = [
        _distance_check(clearance.site, nearest, nearest_t, unproven_t),
        _second_look_check(clearance, lift, run.q[rows], nearest),
        _slewing_check(clearance.site, slew, free),
        standing_check(standing),
        Check(
            f"The load swings {1000 * peak_swing:.1f} mrad at most, "
            f"{1000 * clearance.site.swing:.1f} allowed.",
            peak_swing <= clearance.site.swing,
        ),
        Check(
            f"At the arrival it swings {1e3 * residual_swing:.4f} mrad, {1e3 * ARRIVAL_SWING:g} "
            f"allowed; it ends {1000.0 * offset:.1f} mm from its goal, "
            f"{1000.0 * ARRIVAL_OFFSET:g} allowed.",
            residual_swing <= ARRIVAL_SWING and offset <= ARRIVAL_OFFSET,
        ),
        Check(
            f"Rates are {100 * rate:.1f} % of their limits at most; efforts are "
            f"{'cut' if cut else 'never cut'}.",
            rate <= _TOO_FAST and not cut,
        ),
        coverage_check(clearance.site, covered),
    ]
    return Certificate(
        replace(lift, clearance=clearance),
        run,
        run.t[rows],
        distances,
        nearest,
        nearest_t,
        residual_swing,
        checks,
    )


def _second_look_check(
    clearance: Clearance, lift: Lift, measured_rows: np.ndarray, nearest: Nearest
) -> Check:
    """Check that distances measured in another way contradict neither the least distance nor that
    the load may swing anywhere in its envelope, see `cranedyn.planning.remeasure`.

    Args:
        clearance: Crane and site.
        lift: The lift, whose motion is proven with the envelope about it.
        measured_rows: Coordinates of the simulated run, shape (m, n).
        nearest: The least distance that is claimed of the run.
    """
    site, motion = clearance.site, lift.timed.motion
    stride = max(1, round(_SWUNG / motion.period))
    hanging = second_look(site, clearance.crane, measured_rows, nearest.distance + _BEYOND)
    swung = second_look(
        site, clearance.crane, motion.q[::stride], site.distance + _BEYOND, swing=site.swing
    )
    claimed = nearest.distance - _SECOND_TOLERANCE <= hanging.distance
    keeps = all(found.distance >= site.distance - _SECOND_TOLERANCE for found in (hanging, swung))

    def shown(found: Nearest) -> str:
        if not found.body:
            return f"more than {found.distance:.2f} m"
        return f"{found.distance:.2f} m ({found.body} and {found.obstacle})"

    return Check(
        f"Measured a second time, by points of load and rope: {shown(hanging)}, and swung by "
        f"{math.degrees(site.swing):.2g}° to all sides {shown(swung)}; {site.distance:g} m "
        "required.",
        claimed and keeps,
    )


def _swing_at(lift: Lift, run: Trajectory, t: float) -> float:
    """Return the amplitude of the swing at a time [s]; in [rad]."""
    row, layout = int(np.searchsorted(run.t, t - 1e-9)), lift.crane.layout
    q, v = (columns[row : row + 1, layout.passive] for columns in (run.q, run.v))
    length = float(run.q[row, lift.clearance.joints.hoist])
    return float(swing_amplitude(q, v, length, lift.crane.gravity)[0])


def _distance_check(
    site: Site, nearest: Nearest, nearest_t: float, unproven_t: float | None
) -> Check:
    proof = "proven between all instants"
    if unproven_t is not None:
        proof = f"not proven at t = {unproven_t:.2f} s"
    return Check(
        f"Nothing that hangs comes nearer than {site.distance:g} m: least is "
        f"{nearest.distance:.2f} m, {nearest.body} and {nearest.obstacle} at "
        f"t = {nearest_t:.1f} s; {proof}.",
        unproven_t is None and nearest.distance >= site.distance,
    )


def _slewing_check(site: Site, slew: np.ndarray, free: SlewRange) -> Check:
    low, high = slew.min(), slew.max()
    if low == high or (free.low <= low and high <= free.high and free.low < free.high):
        turns = f"jib and counter-jib turn freely, with {site.distance:g} m at least"
        return Check(f"Slewing: {turns}.", True)
    return Check(f"Slewing: the jib comes too near to {free.below or free.above}.", False)
