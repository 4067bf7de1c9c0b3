"""What a planned lift is really like: simulated under its controller, with the swing it has, held
against everything that is asked of it.

The certificate trusts nothing of the plan but the motion that it asks for: distances are measured
again, with the load where the simulation has it, and between the instants they are proven.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cranedyn.analysis.swing import swing_amplitude
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.lqr import lqr
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import EngineName
from cranedyn.planning.clearance import Clearance, Nearest
from cranedyn.planning.lift import Lift
from cranedyn.planning.proof import slew_range, unproven_row
from cranedyn.simulation.simulate import simulate

HOIST_INTEGRAL = 4.0e3
"""Gain of the integrator on the hoist beside the LQR [N/(m s)]."""

AFTER = 5.0
"""For how long a lift is watched after its arrival [s]."""

ARRIVAL_SWING = 0.05e-3
"""Largest amplitude of the swing at the arrival [rad]."""

_SHOWN = 0.2
_TOO_FAST = 1.005
"""By how much a drive may exceed a rate while the controller corrects it: half a percent."""


class Check(NamedTuple):
    """Something that is asked of a lift, in a sentence with its numbers, and whether it holds; None
    where that cannot be judged, since nobody entered what decides it.
    """

    sentence: str
    holds: bool | None


@dataclass(frozen=True, eq=False)
class Certificate:
    """What a lift is held against.

    Attributes:
        lift: What was planned.
        run: What was simulated.
        t: Times at which distances were measured [s], shape (m,).
        distances: How near anything that hangs comes to each obstacle then [m], by its name, shape
            (m,) each.
        nearest: The least distance of all that hangs, of which body from what; zones count where
            something is in them.
        at: When that is [s].
        left: Amplitude of the swing at the arrival [rad].
        checks: All that is asked.
    """

    lift: Lift
    run: Trajectory
    t: np.ndarray
    distances: dict[str, np.ndarray]
    nearest: Nearest
    at: float
    left: float
    checks: Sequence[Check]

    @property
    def holds(self) -> bool:
        """Whether all of it holds; a lift of which it does not is none."""
        return all(check.holds for check in self.checks)


def controller_of(lift: Lift, *, dt: float = 5e-4) -> HoistIntegral:
    """What makes a lift: a full-model LQR about its motion, with an integrator on the hoist; a new
    one for each run.
    """
    crane = lift.crane
    return HoistIntegral(
        crane,
        lqr(crane, lift.timed.motion, dt=dt),
        HOIST_INTEGRAL,
        float(crane.effort_limit[crane.layout.drive("l")]),
    )


def certify(
    lift: Lift,
    clearance: Clearance | None = None,
    *,
    controller: HoistIntegral | None = None,
    dt: float = 5e-4,
    engine: EngineName = "compiled",
) -> Certificate:
    """Simulate a lift and hold it against its site.

    Args:
        lift: The lift.
        clearance: Crane and site to hold it against; None for those it was planned for.
        controller: What makes it, see `controller_of`.
        dt: Physics step [s].
        engine: What computes a step.

    Raises:
        RunError: If the simulation breaks off.
    """
    against = lift.clearance if clearance is None else clearance
    made = replace(controller_of(lift, dt=dt) if controller is None else controller, integral=0.0)
    motion, (start, goal) = lift.timed.motion, lift.states()
    duration = motion.arrival + motion.period * math.ceil(AFTER / motion.period)
    run = simulate(
        lift.crane,
        made,
        motion,
        start=start,
        duration=duration,
        dt=dt,
        control_period=motion.period,
        engine=engine,
    )
    rows = np.unique(
        np.append(np.arange(0, len(run), max(1, round(_SHOWN / motion.period))), len(run) - 1)
    )
    found = [against.distances(run.q[k], jib=False) for k in rows]
    names = list(found[0])
    distances = {name: np.array([one[name].distance for one in found]) for name in names}
    k = _least_row(against, run)
    nearest, at, left = against.nearest(run.q[k]), float(run.t[k]), _left(lift, run)
    checks = _checks(against, lift, run, goal.q, nearest, at, left)
    return Certificate(lift, run, run.t[rows], distances, nearest, at, left, checks)


def _least_row(clearance: Clearance, run: Trajectory) -> int:
    """Return the row in which anything that hangs is nearest to anything: every fourth is looked
    at, then all beside the nearest of these.
    """

    def least(rows: range) -> int:
        return min(rows, key=lambda k: clearance.least(run.q[k]))

    about = least(range(0, len(run), 4))
    return least(range(max(about - 3, 0), min(about + 4, len(run))))


def _left(lift: Lift, run: Trajectory) -> float:
    """Amplitude of the swing at the arrival [rad]."""
    crane, there = lift.crane, run.since(lift.timed.motion.arrival - 1e-9)
    passive, length = crane.layout.passive, float(there.q[0, lift.clearance.joints.hoist])
    return float(
        swing_amplitude(there.q[:1, passive], there.v[:1, passive], length, crane.gravity)[0]
    )


def _checks(
    clearance: Clearance,
    lift: Lift,
    run: Trajectory,
    goal: np.ndarray,
    nearest: Nearest,
    at: float,
    swing: float,
) -> list[Check]:
    site, motion = clearance.site, lift.timed.motion
    unproven = unproven_row(clearance, run.q, motion.period)
    slew, place = run.q[:, clearance.joints.slew], clearance.place_of
    turns = slew_range(clearance, float(slew[0]), float(slew.min()), float(slew.max()))
    turned = (
        turns.low <= slew.min() and slew.max() <= turns.high and turns.low < turns.high
    ) or bool(np.ptp(slew) == 0.0)
    after = run.since(motion.arrival - 1e-9)
    peak = float(clearance.tilt(run.q).max())
    rates = np.abs(run.v[:, place]).max(axis=0) / np.array(lift.limits.rates)
    cut = bool((run.command != run.effort).any())
    off = 1000.0 * float(
        np.linalg.norm(clearance.point(after.q[-1, place]) - clearance.point(goal[place]))
    )
    proof = (
        "proven between all instants"
        if unproven is None
        else f"not proven at t = {run.t[unproven]:.2f} s"
    )
    jib = (
        f"jib and counter-jib turn freely, with {site.distance:g} m at least"
        if turned
        else f"the jib comes too near to {turns.below or turns.above}"
    )
    return [
        Check(
            f"Nothing that hangs comes nearer than {site.distance:g} m: least is "
            f"{nearest.distance:.2f} m, {nearest.body} and {nearest.obstacle} at t = {at:.1f} s; "
            f"{proof}.",
            unproven is None and nearest.distance >= site.distance,
        ),
        Check(f"Slewing: {jib}.", bool(turned)),
        Check(
            f"The load swings {1000 * peak:.1f} mrad at most, {1000 * site.swing:.1f} allowed.",
            peak <= site.swing,
        ),
        Check(
            f"At the arrival it swings {1e3 * swing:.4f} mrad, {1e3 * ARRIVAL_SWING:g} allowed; it "
            f"ends {off:.1f} mm from its goal.",
            swing <= ARRIVAL_SWING,
        ),
        Check(
            f"Rates are {100 * rates.max():.1f} % of their limits at most; efforts are "
            f"{'cut' if cut else 'never cut'}.",
            bool(rates.max() <= _TOO_FAST) and not cut,
        ),
    ]
