"""What a trained policy observes and does, which is the same for each crane.

It is that of the environments of `cranedyn.interop.gymnasium` with the drives of the task, so that
a policy that was trained there, see `training_environment`, can be entered as it is. For m drives
and s swing angles the observation has 3 m + 2 s numbers:

1. of each drive the distance to its target, over what it covers in 10 s at its largest rate, or
   over its range if that is shorter;
2. of each drive its position in its range, from -1 to 1. A range of more than 50 m, or of more than
   half a turn, to either side of where the crane is described to start is cut there;
3. of each drive its rate over its largest rate;
4. of each swing its angle from rest over the largest swing allowed;
5. of each swing its rate over the largest one of a pendulum that swings so far.

Numbers beyond 1 are cut where the environment bounds them. An action has m numbers from -1 to 1,
shares of the largest rates of the drives, which brake before the ends of their ranges.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.benchmark.entries.targets import Targets
from cranedyn.benchmark.entry import Briefing, Declined, briefing_of
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.benchmark.task import select_tasks
from cranedyn.errors import CraneError, ModelError, OutOfRange
from cranedyn.interop.task import DT, Rules, SwingTask

if TYPE_CHECKING:
    from cranedyn.interop.gymnasium import CraneEnv

_MAX_SWING_LIMIT = math.pi / 4.0
"""Largest swing at which the environments end an episode [rad]."""


class Observer:
    """Observes the readings of an instance, and turns actions into rates.

    Attributes:
        names: Names of the observations in their order.
        drives: Number of the drives, m.
    """

    def __init__(self, briefing: Briefing) -> None:
        """Prepare for an instance.

        Raises:
            Declined: If the load of the crane does not hang from its drives.
        """
        rules = Rules(
            converters=briefing.converters,
            swing=0.0,
            swing_limit=_swing_limit(briefing),
        )
        try:
            self._task = SwingTask(briefing.crane, 1, rules, briefing.period, DT, threads=1)
        except ModelError as error:
            raise Declined(str(error)) from error
        self._briefing = briefing
        self._targets = Targets(briefing)
        self._state = np.zeros((2 * briefing.crane.layout.n, 1))
        self._kinds = np.zeros(1, dtype=int)
        # The place of the load at its goal counts for rewards only.
        self._nowhere = np.zeros((3, 1))
        self.names = self._task.view.names
        self.drives = briefing.crane.layout.m

    def observe(self, reading: SensorReading) -> np.ndarray:
        """Return the observation at a reading in single precision, shape (3 m + 2 s,); to be called
        once for each one, in their order.
        """
        target = self._targets(reading)
        self._state[:, 0] = np.concatenate(self._briefing.state(reading))
        observations = np.empty((1, len(self.names)), dtype=np.float32)
        goal = target.position[:, None]
        self._task.view.measure(self._state, goal, self._nowhere, self._kinds, observations)
        return observations[0]

    def rates(self, action: np.ndarray) -> np.ndarray:
        """Return the rates for an action at the last reading, shape (m,). What of an action is
        beyond -1 to 1 is cut off.

        Raises:
            CraneError: If it is not one finite number for each drive.
        """
        values = np.asarray(action, dtype=float).reshape(-1)
        if values.shape != (self.drives,):
            raise CraneError(
                f"The policy returned {values.size} numbers; needed are {self.drives}, one for "
                "each drive."
            )
        if not np.isfinite(values).all():
            raise CraneError(f"The policy returned {values.tolist()}; needed are finite numbers.")
        shares = np.clip(values, -1.0, 1.0)[:, None]
        return self._task.commands(shares, self._state, self._kinds)[:, 0]


def _swing_limit(briefing: Briefing) -> float:
    """Return the swing that is observed as 1, in training and in the benchmark alike [rad]."""
    return min(briefing.swing_bound, _MAX_SWING_LIMIT)


def check_sizes(source: str, observer: Observer, inputs: int, outputs: int | None = None) -> None:
    """Check that a policy is of the size of a crane.

    Args:
        source: How the policy was named.
        observer: What it would observe.
        inputs: Numbers that it takes.
        outputs: Numbers that it returns; None if that is not known.

    Raises:
        Declined: If it takes or returns other numbers: it was made for another kind of crane.
    """
    expected = len(observer.names)
    if inputs != expected or outputs not in (None, observer.drives):
        raise Declined(
            f"{source} takes {inputs} numbers and returns {'?' if outputs is None else outputs}; "
            f"on this crane an observation has {expected} and an action {observer.drives}."
        )


def training_environment(task: str, *, swing: float = 0.0) -> CraneEnv:
    """Return an environment of Gymnasium on the crane of a task, with the observations and actions
    of a policy in the benchmark. Starts and goals are drawn at random in each episode.

    Args:
        task: Name of the task, such as "inteco/move".
        swing: Largest swing at the start [rad].

    Raises:
        UnknownName: If there is no such task.
        OutOfRange: If several tasks have this name, or the swing is beyond that allowed.
    """
    from cranedyn.interop.gymnasium import CraneEnv

    found = select_tasks([task])
    if len(found) != 1:
        raise OutOfRange("task", task, "the name of one task, such as inteco/move")
    briefing = briefing_of(found[0])
    return CraneEnv(
        crane=briefing.crane,
        control_period=briefing.period,
        converters=briefing.converters,
        swing=swing,
        swing_limit=_swing_limit(briefing),
        tolerance=briefing.tolerance,
    )
