"""The physical limit of a move: the least time in which it can be made at all.

It is the duration of the motion of least time under the rates, accelerations and jerks of the
converters, the efforts of the drives and the bound of the swing, by optimal control on the full
model (`cranedyn.lifts.planning.optimal`). Its load comes to rest at the goal; `least_time` returns
when it has come within the tolerance for good, as the settling time of an entry is counted.

It is a local optimum, for the nominal crane, without the delay and lag of the drives, and with each
swing angle bounded instead of both together. So no entry is expected to reach it, but nothing
proves that none can.
"""

from __future__ import annotations

import numpy as np

from cranedyn.analysis.swing import settling_time
from cranedyn.benchmark.task import CraneTask
from cranedyn.dynamics.bodies import point_paths
from cranedyn.errors import OutOfRange
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion

AGREEMENT = 0.06
"""Difference up to which a computed least time is that of a file [s]: three control periods. The
optimiser ends at a relative error, and settling is counted in whole periods."""

_SWINGS_OF_ONE_ROPE = 2
"""Number of swings of a load on one rope; with hook and sling there are more."""

_EASIER_RAMPS = (0.0, 1.0)
"""Ramps [s] with which the motion of a load with hook and sling is sought first, each search
beginning with the motion of the one before. With the ramp of its drives alone, the optimiser ends
at its largest number of iterations; without a ramp there are far fewer intervals, and with a long
one the accelerations are continuous as well."""


def least_time(task: CraneTask) -> float:
    """Return the time at which the load of the motion of least time has come within the tolerance
    of the goal for good [s].

    Raises:
        OutOfRange: If the task has no goal.
        CraneError: If the optimiser does not converge, or the extra `optimal` is not installed.
    """
    motion = least_time_motion(task)
    load = point_paths(task.crane(), motion.q)[:, 0]
    distance = np.linalg.norm(load - load[-1], axis=1)
    times = motion.period * np.arange(len(motion.q))
    return float(settling_time(times, distance, task.tolerance))


def least_time_motion(task: CraneTask) -> Motion:
    """Return the motion of least time of a move, from rest to rest.

    Raises:
        OutOfRange: If the task has no goal.
        CraneError: If the optimiser does not converge, or the extra `optimal` is not installed.
    """
    from cranedyn.lifts.planning.optimal import optimal

    goal = task.goal_state()
    if goal is None:
        raise OutOfRange("task", task.name, "one with a goal")
    crane = task.crane()
    converters = task.converters()
    # The optimiser has one ramp for all drives; with the shortest none is held back.
    ramps = [float((converters.accelerations / converters.jerks).min())]
    if len(crane.swings) > _SWINGS_OF_ONE_ROPE:
        ramps = [*_EASIER_RAMPS, *ramps]
    motion = None
    for ramp in ramps:
        motion = optimal(
            crane,
            task.start_state(),
            goal,
            Limits(converters.rates.tolist(), converters.accelerations.tolist()),
            swing=task.swing_bound,
            ramp=ramp,
            period=task.period,
            begin=motion,
        )
    assert motion is not None
    return motion
