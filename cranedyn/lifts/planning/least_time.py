"""A planned lift in least time: the fastest motion between the same obstacles, by optimal control.

A plan by `cranedyn.lifts.planning.timing` keeps to its path, and averages its law of time so that
the load hardly swings, which makes it last longer. The motion of least time does neither: drives
are at their limits all the time, and the load swings as far as the site allows until it comes to
rest at the end.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cranedyn.lifts.planning.curve import interpolate_columns
from cranedyn.lifts.planning.lift import Lift
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.lifts.planning.timing import RAMP, STEP, TimedMotion, limit_shares

INTERVAL = 0.5
"""Longest interval of constant jerk [s]."""


def in_least_time(lift: Lift) -> Lift:
    """Return a lift with the motion of least time near its planned one, with which the search
    begins. The new motion is proven as the planned one is.

    It leaves the path of the planned lift. `Lift.path` and `TimedMotion.bound` of the result are
    still those of the planned lift, which the new motion may beat. `TimedMotion.places` are where
    its drives are, at equal steps of time.

    Raises:
        Unproven: If no motion found is proven.
        CraneError: If IPOPT does not converge, or the extra `optimal` is not installed.
    """
    clearance = lift.clearance
    planned = lift.timed
    motion = optimal(
        lift.crane,
        *lift.states(),
        lift.limits,
        ramp=RAMP,
        interval=INTERVAL,
        period=planned.motion.period,
        clearance=clearance,
        begin=planned.motion,
    )
    # Places of the drives at equal steps of about `STEP`, as a timed path has them.
    row_times = motion.period * np.arange(len(motion.q))
    count = max(2, round(motion.arrival / STEP) + 1)
    times = np.linspace(0.0, motion.arrival, count)
    drive_positions = interpolate_columns(times, row_times, motion.q[:, clearance.drive_joints])
    shares = limit_shares(clearance, motion, lift.limits)
    return replace(lift, timed=TimedMotion(drive_positions, motion, planned.bound, shares))
