"""A tour whose legs are planned as motions of all five joints: what tracking controllers and shaped
drives go by.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cranedyn.checks import number
from cranedyn.clocks import intervals
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.planning.itinerary import Leg, Stage, Timetable, leg_target
from cranedyn.references.motion import Motion


@dataclass(frozen=True, eq=False)
class Tour(Timetable):
    """A reference that repeats a motion for ever.

    Attributes:
        motion: One cycle of it.
    """

    motion: Motion

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint of the drives at a time [s]."""
        return self.motion(t % self.duration)

    def at(self, times: np.ndarray) -> Setpoint:
        """Return setpoints at many times [s], shape (n, m) each."""
        return self.motion.at(times % self.duration)


def tour(
    crane: Crane, legs: Sequence[Leg], plan: Callable[[State, State], Motion], *, dwell: float
) -> Tour:
    """Plan a tour leg by leg, from where the crane starts and back.

    Args:
        crane: The crane.
        legs: Where to go; the last must lead back to the start.
        plan: The motion from one rest to another.
        dwell: How long to stand still after each leg [s].

    Raises:
        OutOfRange: For a target out of the crane's ranges, a negative dwell, no leg at all, or a
            tour that does not end where it began.
    """
    number("dwell", dwell, "s", ">= 0")
    stages: list[Stage] = []
    samples: list[np.ndarray] = []
    state, row, period, drives = crane.start, 0, 0.0, crane.layout.drives
    for leg in legs:
        target = leg_target(crane, leg, state.q[drives])
        goal = crane.state(
            **{
                joint.symbol: float(aim)
                for joint, aim in zip(crane.layout.driven, target, strict=True)
            }
        )
        motion = plan(state, goal)
        motion.check_fits("motion that was planned", crane.layout)
        period, rows, still = (
            motion.period,
            len(motion.q) - 1,
            intervals("dwell", dwell, motion.period) if dwell > 0.0 else 0,
        )
        standing = np.stack([goal.q, goal.v, goal.v])[:, None]
        samples += [
            np.stack([motion.q, motion.v, motion.a])[:, :-1],
            np.repeat(standing, still, axis=1),
        ]
        begin, arrival, end = (period * k for k in (row, row + rows, row + rows + still))
        stages.append(Stage(leg, state.q[drives], goal.q[drives], begin, arrival, end))
        state, row = goal, row + rows + still
    if not stages:
        raise OutOfRange("tour", "empty", "one leg at least")
    if not np.allclose(state.q, crane.start.q):
        raise OutOfRange(
            "end of the tour",
            state.q[drives].tolist(),
            f"where it began, {crane.start.q[drives].tolist()}",
            "rad or m",
        )
    q, v, a = np.concatenate([*samples, np.stack([state.q, state.v, state.v])[:, None]], axis=1)
    return Tour(tuple(stages), Motion(period, q, v, a, drives))
