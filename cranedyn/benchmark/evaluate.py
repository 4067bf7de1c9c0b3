"""Run instances of tasks and measure what came of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cranedyn.analysis.swing import settling_time
from cranedyn.benchmark.entry import Declined
from cranedyn.benchmark.entry_process import EntryFailed, EntryLimits, EntryProcess
from cranedyn.benchmark.entry_source import EntrySource
from cranedyn.benchmark.sensors import SensorChain
from cranedyn.benchmark.task import MOVES, CraneTask, Instance, instances
from cranedyn.command import interrupted
from cranedyn.compiled.verify import code_shared_with
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import cosine_gust, steady, wind
from cranedyn.dynamics.bodies import point_paths
from cranedyn.errors import RunError
from cranedyn.interfaces import Disturbance, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.references.tabulated import tabulated
from cranedyn.simulation.simulate import simulate

Status = Literal["passed", "failed", "declined"]

METRICS = ("settled_s", "swing_rad", "error_m", "rms_error_m", "work_J", "stray")
"""Names of what is measured of a run:

settled_s: time until the load stays within the tolerance of where it shall be, counted from
    `CraneTask.counts_from` [s]; missing if it does not.
swing_rad: largest swing [rad].
error_m, rms_error_m: largest distance of the load from where it should be, and its root mean square
    [m]; on a path and in wind only.
work_J: mechanical work that the drives put in, without what they took back [J].
stray: largest distance of a drive from where the operator sent it [rad or m]; under an operator.
"""


@dataclass(frozen=True)
class Variant:
    """How runs are computed; another one than usual shows whether a ranking depends on it.

    Attributes:
        engine: Engine of the simulation, see `cranedyn.simulation.simulate.simulate`.
        substeps: Number of physics steps in each one of the task: 2 for half of the step.
    """

    engine: str = "compiled"
    substeps: int = 1


USUAL = Variant()
"""How results are computed that are compared and verified."""


@dataclass(frozen=True)
class InstanceResult:
    """What came of an instance.

    Attributes:
        task: Name of the task.
        index: Index of the instance.
        status: "passed", "failed", or "declined" if the entry does not take part in the task.
        reason: Why it failed or was declined, a sentence; empty if it passed.
        metrics: What was measured, by the names of `METRICS`; empty if the run broke off.
        command_us: Median and largest processor time of a command [µs], by the clock of the entry's
            process; empty if there was none.
    """

    task: str
    index: int
    status: Status
    reason: str = ""
    metrics: Mapping[str, float] = field(default_factory=dict)
    command_us: tuple[float, ...] = ()


@dataclass(frozen=True)
class TaskEvaluation:
    """What came of the instances of a task.

    Attributes:
        results: The results.
        files: SHA-256 of the files that the entry has used so far, by name, see
            `cranedyn.benchmark.entry_files`.
        changed: Names of files that changed while it ran.
    """

    results: Sequence[InstanceResult]
    files: Mapping[str, str]
    changed: frozenset[str]


class Evaluator:
    """Runs an entry in the instances of tasks, one after another, in one process of the entry."""

    def __init__(self, source: EntrySource, limits: EntryLimits) -> None:
        """Name the entry; its process starts with the first instance.

        Args:
            source: The entry.
            limits: What it may use.
        """
        self._process = EntryProcess(source, limits)

    def evaluate(
        self,
        task: CraneTask,
        *,
        seeds: str,
        indices: Sequence[int] | None = None,
        variant: Variant = USUAL,
    ) -> TaskEvaluation:
        """Return the results in the instances of a task.

        Args:
            task: The task.
            seeds: Name of the seeds, see `cranedyn.benchmark.task.instances`.
            indices: Indices of the instances to run; None for all.
            variant: How the runs are computed.
        """
        process = self._process
        results = []
        for instance in instances(task, seeds):
            if indices is None or instance.index in indices:
                results.append(run_instance(instance, process, variant))
        return TaskEvaluation(results, dict(process.files), frozenset(process.changed))

    def close(self) -> None:
        """End the process of the entry."""
        self._process.close()


class _Commands:
    """The entry behind its sensors, as a controller of a simulation.

    Attributes:
        seconds: Processor time of each command [s].
        failure: Why the entry failed; None if it did not.
    """

    def __init__(self, process: EntryProcess, sensors: SensorChain) -> None:
        self._process = process
        self._sensors = sensors
        self.seconds: list[float] = []
        self.failure: EntryFailed | None = None

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the rates that the entry commands, shape (m,)."""
        try:
            command, seconds = self._process.command(self._sensors.read(t, state))
        except EntryFailed as failure:
            self.failure = failure
            raise
        # A program elsewhere has no clock of ours.
        if not math.isnan(seconds):
            self.seconds.append(seconds)
        return command


def run_instance(
    instance: Instance, process: EntryProcess, variant: Variant = USUAL
) -> InstanceResult:
    """Run an instance and return its result.

    Args:
        instance: The instance.
        process: The process of the entry.
        variant: How the run is computed.

    Raises:
        RunError: If the user interrupts the run.
    """
    task = instance.task
    crane = task.crane(instance.values["payload_factor"])
    commands = _Commands(process, SensorChain(instance, crane))
    failure = ""
    run = None
    try:
        process.begin(task)
        run = _simulated(instance, crane, commands, variant)
    except Declined as declined:
        return InstanceResult(task.name, instance.index, "declined", str(declined))
    except EntryFailed as failed:
        failure = str(failed)
    except RunError as error:
        if interrupted(error):
            raise  # by the user, who does not wait for the others
        # An entry cannot go on where the model ceases to hold, as the hint of the error proposes.
        failure = str(commands.failure or error).partition('; validity="mark"')[0]
    finally:
        process.end_instance()
    taken: tuple[float, ...] = ()
    if commands.seconds:
        microseconds = 1e6 * np.array(commands.seconds)
        taken = float(np.median(microseconds)), float(microseconds.max())
    if run is None:
        return InstanceResult(task.name, instance.index, "failed", failure, {}, taken)
    metrics = measured(instance, crane, run)
    reason = violation(task, metrics)
    status: Status = "failed" if reason else "passed"
    return InstanceResult(task.name, instance.index, status, reason, metrics, taken)


def _simulated(
    instance: Instance, crane: Crane, commands: _Commands, variant: Variant
) -> Trajectory:
    """Return the run of an instance.

    Raises:
        RunError: If it breaks off: the model ceases to hold, as where a joint leaves its range, or
            the entry fails.
        EntryFailed: If the entry fails at its first command.
    """
    task = instance.task
    # To compile code for the load and the lags of each instance takes longer than to run it.
    with code_shared_with(task.crane(), task.converters()):
        return simulate(
            crane,
            commands,
            start=_start(instance, crane),
            duration=task.duration,
            dt=task.step / variant.substeps,
            control_period=task.period,
            drive=task.converters(instance.values["lag_factor"]),
            disturbance=_disturbance(instance, crane),
            base=instance.base_motion(),
            engine=variant.engine,
        )


def _start(instance: Instance, crane: Crane) -> State:
    """Return the state at the start: where the sensors of the drives say that it is, with the swing
    of the instance.
    """
    planned = instance.task.start_state()
    q = planned.q.copy()
    q[crane.layout.drives] += instance.drive_offset(crane)
    q[crane.swings] += instance.values["start_swing"] * np.array(instance.swing_signs)
    return State(q, planned.v.copy())


def _disturbance(instance: Instance, crane: Crane) -> Disturbance | None:
    """Return the wind of an instance; None for still air."""
    gusts = instance.task.gusts
    if gusts is None:
        return None
    speed = steady(0.0)
    for i in range(gusts.repeats):
        begin = gusts.at + i * gusts.lasts
        rise = gusts.speed * instance.values["gust_factor"]
        speed = cosine_gust(speed, rise, at=begin, lasts=gusts.lasts)
    direction = gusts.direction + instance.values["gust_direction"]
    return wind(crane, speed, direction=direction, payload_area=gusts.area)


def measured(instance: Instance, crane: Crane, run: Trajectory) -> dict[str, float]:
    """Return what is measured of a run, by the names of `METRICS`.

    Args:
        instance: The instance.
        crane: The crane that moved.
        run: Its true motion, to the end of the task.
    """
    task = instance.task
    load = point_paths(crane, run.q)[:, 0]
    target = _target(instance, crane, run)
    distance = np.linalg.norm(load - target, axis=1)
    swing = np.linalg.norm(crane.swing_angles(run.q), axis=1)
    metrics = {
        "swing_rad": float(swing.max()),
        "work_J": float(np.maximum(np.diff(run.work, axis=0), 0.0).sum()),
    }
    begin = task.counts_from
    # A row whose time rounding puts just before the begin belongs to it.
    counted = run.t >= begin - 1e-9
    settled = settling_time(run.t[counted] - begin, distance[counted], task.tolerance)
    if settled <= run.t[-1] - begin - task.hold:
        metrics["settled_s"] = max(float(settled), 0.0)
    if task.kind in ("path", "wind"):
        metrics["error_m"] = float(distance.max())
        metrics["rms_error_m"] = float(np.sqrt(np.mean(distance**2)))
    if task.kind == "operator":
        drives = crane.layout.drives
        intended = task.start_state().q[drives] + operator_travel(task)
        reached = run.q[-1, drives] - instance.drive_offset(crane)
        metrics["stray"] = float(np.abs(reached - intended).max())
    return metrics


def operator_travel(task: CraneTask) -> np.ndarray:
    """Return how far the operator sends each drive [rad or m], shape (m,): the integral of the
    rates that are asked for.
    """
    travel = np.zeros(task.crane().layout.m)
    for row, following in zip(task.joystick[:-1], task.joystick[1:], strict=True):
        travel += (following[0] - row[0]) * np.array(row[1:])
    return travel * task.converters().rates


def _target(instance: Instance, crane: Crane, run: Trajectory) -> np.ndarray:
    """Return where the load should be in each row of a run [m], shape (rows, 3).

    That is below the drives where their sensors say that they are at the goal, or on the path, with
    the rope as long as it is. Under an operator it is below the drives at the end of the run.
    """
    task = instance.task
    drives = crane.layout.drives
    if task.kind == "operator":
        places = run.q[-1:, drives]
    else:
        path = task.path()
        if path is not None:
            places = tabulated(path, run.t, crane.layout.m).position
        else:
            goal = task.goal_state() if task.kind in MOVES else task.start_state()
            assert goal is not None
            places = goal.q[None, drives]
        places = places + instance.drive_offset(crane)
    q = np.tile(task.start_state().q, (len(places), 1))
    q[:, drives] = places
    q[:, crane.swings] = crane.rest.angle + places @ crane.rest.slope.T
    target = point_paths(crane, q)[:, 0]
    return np.broadcast_to(target, (len(run.t), 3))


def violation(task: CraneTask, metrics: Mapping[str, float]) -> str:
    """Return the first bound of a task that a run did not keep, as a sentence; empty if it kept
    all.
    """
    swing = metrics["swing_rad"]
    if swing > task.swing_bound:
        return f"The load swung by {swing:.3g} rad; allowed is {task.swing_bound:g} rad."
    error = metrics.get("error_m", 0.0)
    if task.corridor is not None and error > task.corridor:
        return f"The load was {error:.3g} m from its place; allowed is {task.corridor:g} m."
    stray = metrics.get("stray", 0.0)
    if task.stray is not None and stray > task.stray:
        return (
            f"A drive ended {stray:.3g} (rad or m) from where the operator sent it; allowed is "
            f"{task.stray:g}."
        )
    if "settled_s" not in metrics:
        return (
            f"The load did not stay within {task.tolerance:g} m of its place for the last "
            f"{task.hold:g} s."
        )
    return ""
