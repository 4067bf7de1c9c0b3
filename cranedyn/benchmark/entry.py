"""What an entry of the benchmark is, and how one is opened from a file.

An entry is a function that is told the task and returns a controller::

    def controller(briefing):
        goal = briefing.goal.q[briefing.crane.layout.drives]

        def rates(reading):
            return 0.2 * (goal - reading.position)

        return rates

The function is called once for each instance, with a `Briefing`. What it returns is called once in
each control period with a `Reading` and returns the rates of the drives [rad/s or m/s], shape (m,).
An entry that is not made for a kind of task raises `Declined`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from cranedyn.benchmark.sensors import Reading
from cranedyn.benchmark.task import Task
from cranedyn.controllers.velocity_command import as_velocity_command
from cranedyn.data.files import digest
from cranedyn.dynamics.converters import Converters
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName, format_error, quoted
from cranedyn.interfaces import Controller, Reference, State
from cranedyn.interop.controller_file import load_function, open_controller
from cranedyn.model.crane import Crane
from cranedyn.references.limits import Limits
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.simple import hold, shortest, spline

FORMS = "FILE.py:FUNCTION, FILE.json or FILE.mat, or the name of a baseline"
"""Forms in which an entry is named."""

NOT_YET = {
    ".so": "a shared library in C",
    ".dll": "a shared library in C",
    ".fmu": "an FMU",
    ".zip": "a policy of Stable-Baselines3",
    ".onnx": "a policy in ONNX",
}
"""Entries that cannot be entered yet, by the ending of their file."""

BASELINES = Path(__file__).resolve().parent / "baselines.py"
"""File of the baselines, which are entries like all others."""

_SLOWER = 1.5
"""Duration of the motion that `Briefing.motion` plans over the shortest for the drives, so that the
swing it causes is well below its bound. Our choice."""

_MIN_PERIODS = 2
"""Shortest such motion in periods of the load."""

Entry = Callable[[Reading], np.ndarray]
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
            under an operator.
        path: Motion of the drives below which the load shall hang plumb, a function of time [s];
            None for a task without a path.
        tolerance: Distance of the load from its goal up to which it counts as settled [m].
        swing_bound: Largest swing allowed [rad].
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

    @property
    def limits(self) -> Limits:
        """Largest rates and accelerations of the drives, for planning."""
        return Limits(self.converters.rates.tolist(), self.converters.accelerations.tolist())

    def state(self, reading: Reading) -> State:
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
        """Period of the load as a pendulum on the longer of its ropes at start and goal [s]."""
        crane = self.crane
        lengths = []
        for state in (self.start, self.goal):
            if state is not None and crane.winch is not None:
                lengths.append(float(state.q[crane.layout.drives[crane.winch]]))
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

        def rates(reading: Reading) -> np.ndarray:
            return controller(reading.t, self.state(reading), reference(reading.t))

        return rates


def briefing_of(task: Task) -> Briefing:
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
    )


@dataclass(frozen=True)
class EntrySource:
    """Where an entry comes from.

    Attributes:
        name: Its name in tables.
        source: How it is opened: FILE.py:FUNCTION, or a file of matrices.
        file: The file.
    """

    name: str
    source: str
    file: Path

    @property
    def digest(self) -> str:
        """SHA-256 of the file, in hexadecimal digits. Other files that it reads do not count."""
        return digest(self.file)


def find_entry(text: str) -> EntrySource:
    """Return where the entry is that a text names, without opening it.

    Raises:
        DataError: If the text has none of the `FORMS`, or there is no such file.
        UnknownName: If it is a word, but no baseline.
    """
    file, _, function = text.rpartition(":")
    path = Path(text)
    if file.endswith(".py"):
        return _existing(EntrySource(function, text, Path(file)))
    if path.suffix in NOT_YET:
        raise DataError(
            f"{quoted(text)} is {NOT_YET[path.suffix]}, which cannot be entered yet; allowed is "
            f"{FORMS}. A function in Python may call it."
        )
    if path.suffix in (".json", ".mat"):
        return _existing(EntrySource(path.stem, text, path))
    if path.suffix == ".py":
        raise DataError(f"{quoted(text)} names no function; write {path}:FUNCTION.")
    if "/" in text or "." in text:
        raise DataError(f"{quoted(text)} names no entry; allowed is {FORMS}.")
    # Baselines are read here, and not by their names above, since their file imports much.
    from cranedyn.benchmark.baselines import NAMES

    if text not in NAMES:
        raise UnknownName("baseline", text, NAMES, "Your own entry is FILE.py:FUNCTION.")
    return EntrySource(text, f"{BASELINES}:{text}", BASELINES)


def _existing(entry: EntrySource) -> EntrySource:
    """Return an entry whose file is there.

    Raises:
        DataError: If it is not.
    """
    if not entry.file.is_file():
        raise DataError(f"Cannot read {entry.file}: there is no such file.")
    return entry


Opened = Callable[[Briefing], Entry]
"""An opened entry: from what it is told to its controller."""


def open_entry(source: str) -> Opened:
    """Open an entry; a file of Python is run. For the process in which entries run.

    Raises:
        CraneError: If it cannot be opened.
    """
    file, _, function = source.rpartition(":")
    if file.endswith(".py"):
        return _checked(source, load_function(Path(file), function, ("briefing",)))
    matrices = open_controller(source)

    def make(briefing: Briefing) -> Entry:
        made = matrices.make(briefing.crane, briefing.motion, briefing.step)
        return briefing.entry(made.controller, briefing.motion, made.drive)

    return make


def _checked(source: str, function: Callable[..., object]) -> Opened:
    """Return a function of an entry that raises sentences."""

    def make(briefing: Briefing) -> Entry:
        try:
            made = function(briefing)
        except CraneError:
            raise
        except Exception as error:
            raise CraneError(f"{source} failed: {format_error(error)}") from error
        if not callable(made):
            allowed = "a function of a reading that returns rates"
            raise OutOfRange(f"result of {source}", type(made).__name__, allowed)
        return made

    return make
