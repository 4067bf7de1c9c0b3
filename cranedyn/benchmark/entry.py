"""What an entry of the benchmark is: a function that is told the task and returns a controller.

An entry is a function that is told the task and returns a controller::

    def controller(briefing):
        goal = briefing.goal.q[briefing.crane.layout.drives]

        def rates(reading):
            return 0.2 * (goal - reading.position)

        return rates

The function is called once for each instance, with a `Briefing`. What it returns is called once in
each control period with a `SensorReading` and returns the rates of the drives [rad/s or m/s], shape
(m,). An entry that is not made for a kind of task raises `Declined`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cranedyn.benchmark.sensors import SensorReading
from cranedyn.benchmark.task import CraneTask, Sea
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.converters import Converters
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.simple import hold, shortest, spline

_SLOWER = 1.5
"""Duration of the motion that `Briefing.motion` plans over the shortest for the drives, so that the
swing it causes is well below its bound. Our choice."""

_MIN_PERIODS = 2
"""Shortest such motion in periods of the load."""

Entry = Callable[[SensorReading], np.ndarray]
"""A controller of the benchmark: from a reading to the rates of the drives, shape (m,)."""


class Declined(CraneError):
    """An entry does not take part in a task. The task then has a dash, and no failure."""


@dataclass(frozen=True, eq=False)
class Briefing:
    """What an entry is told of an instance: the task on the nominal crane.

    Attributes:
        task: Name of the task, such as "overhead/move".
        kind: "move", "path", "wind", "operator", "unknown" or "sensors".
        crane: The crane as planned for. The one that moves may differ.
        converters: Frequency converters of its drives, with their largest rates, accelerations and
            jerks.
        period: Control period [s].
        step: Physics step of the simulation [s].
        duration: Length of the instance [s].
        start: State at the start, at rest.
        goal: State at the goal, at rest with the load plumb; the start in a task in wind, and None
            on a path and under an operator.
        path: Motion of the drives below which the load shall hang plumb, a function of time [s];
            None for a task without a path.
        tolerance: Distance of the load from its goal up to which it counts as settled [m].
        swing_bound: Largest swing allowed [rad].
        sea: The sea in which the crane stands on a ship, and how the ship answers it; None on land.
            The motion of the ship is not measured: encoders of drives and swing, start, goal and
            path are all relative to the deck, which tilts.
    """

    task: str
    kind: str
    crane: Crane
    converters: Converters
    period: float
    step: float
    duration: float
    start: State
    goal: State | None
    path: Reference | None
    tolerance: float
    swing_bound: float
    sea: Sea | None = None

    @property
    def limits(self) -> Limits:
        """Largest rates and accelerations of the drives, for planning."""
        return Limits(self.converters.rates.tolist(), self.converters.accelerations.tolist())

    def state(self, reading: SensorReading) -> State:
        """Return a reading as a state of the crane, for controllers of cranedyn. Passive joints
        that are not measured are at rest.
        """
        crane = self.crane
        drives = crane.layout.drives
        q = self.start.q.copy()
        v = np.zeros_like(q)
        q[drives] = reading.position
        v[drives] = reading.rate
        rest = crane.rest.angle + crane.rest.slope @ reading.position
        q[crane.swings] = reading.swing + rest
        v[crane.swings] = reading.swing_rate + crane.rest.slope @ reading.rate
        return State(q, v)

    @cached_property
    def motion(self) -> Motion:
        """A motion of the whole crane that does what the task asks for, at a moderate speed, with
        the load plumb below the drives: to the goal, along the path, or a rest.

        Raises:
            Declined: Under an operator, whose commands nobody knows in advance.
        """
        crane = self.crane
        if self.kind == "operator":
            raise Declined("There is no planned motion under an operator.")
        if self.path is not None:
            reference = self.path
            duration = self.duration
        elif self.kind == "wind":
            reference = hold(crane, self.start)
            duration = self.period
        else:
            duration = self.moderate_duration
            reference = self.spline_to_goal(duration)
        return hanging_reference(crane, reference, duration, self.period)

    @cached_property
    def moderate_duration(self) -> float:
        """Duration of a smooth move to the goal that asks the drives for two thirds of their rates,
        and lasts two periods of the load at least, a multiple of the control period [s].
        """
        assert self.goal is not None
        drives = self.crane.layout.drives
        (fastest,) = shortest(
            self.crane,
            self.start,
            [self.goal.q[drives].tolist()],
            rates=self.converters.rates.tolist(),
            accelerations=self.converters.accelerations.tolist(),
        )
        duration = max(_SLOWER * fastest, _MIN_PERIODS * self.swing_period)
        return self.period * float(np.ceil(duration / self.period - 1e-9))

    @cached_property
    def swing_period(self) -> float:
        """Period of the load as a pendulum on the longer of its ropes at start and goal, with hook
        and sling if there are any [s].
        """
        crane = self.crane
        lengths = []
        for state in (self.start, self.goal):
            if state is not None:
                load, pivot = point_paths(crane, state.q[None])[0, :2]
                lengths.append(float(np.linalg.norm(load - pivot)))
        return 2.0 * np.pi * float(np.sqrt(max(lengths) / crane.gravity))

    def spline_to_goal(self, duration: float) -> Reference:
        """Return a smooth motion of the drives to the goal in a duration [s]."""
        assert self.goal is not None
        goal = self.goal.q[self.crane.layout.drives].tolist()
        return spline(self.crane, self.start, [goal], [duration])

    def entry(self, controller: Controller, reference: Reference, drive: str = "velocity") -> Entry:
        """Return a controller of cranedyn as an entry.

        Args:
            controller: From time, state and setpoint to commands of the drives. One that is clocked
                is begun.
            reference: From time to the setpoint.
            drive: What it commands: "velocity", or "effort" or "motion", of which rates are made,
                see `cranedyn.controllers.velocity_command`.
        """
        if drive != "velocity":
            controller = as_velocity_command(
                self.crane,
                controller,
                drive="effort" if drive == "effort" else "motion",
                converters=self.converters,
                control_period=self.period,
            )
        if hasattr(controller, "begin_run"):
            controller.begin_run(0.0, self.period)

        def rates(reading: SensorReading) -> np.ndarray:
            return controller(reading.t, self.state(reading), reference(reading.t))

        return rates


def briefing_of(task: CraneTask) -> Briefing:
    """Return what an entry is told of a task."""
    start = task.start_state()
    return Briefing(
        task=task.name,
        kind=task.kind,
        crane=task.crane(),
        converters=task.converters(),
        period=task.period,
        step=task.step,
        duration=task.duration,
        start=start,
        goal=start if task.kind == "wind" else task.goal_state(),
        path=task.path(),
        tolerance=task.tolerance,
        swing_bound=task.swing_bound,
        sea=task.sea,
    )


Opened = Callable[[Briefing], Entry]
"""An opened entry: from what it is told to its controller."""
