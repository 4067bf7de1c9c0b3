"""Entries that are FMUs for co-simulation of FMI 2 or 3, run by FMPy.

Inputs and outputs are told by their names, with the symbols of the drives and swings of the crane,
such as x, l and phi. So an FMU that cranedyn has exported of a controller is an entry as it is. For
a drive x, of which an FMU needs not have all:

========================  ==========================================================================
x, x_dot                  measured position and rate; so phi, phi_dot for a swing
x_set, x_dot_set          where a smooth motion of the drives is now, and its rate a period later;
                          under an operator where the drives were sent, and the rate that is asked
                          for
x_goal                    where the drive shall be: goal, point of the path, or as sent
x_operator                rate that the operator asks for
========================  ==========================================================================

Its outputs are one for each drive: rates (x_dot_command), accelerations (x_ddot_command), or
efforts (F_x_command, T_gamma_command), of which rates are made.
"""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.benchmark.entries.targets import Target, Targets
from cranedyn.benchmark.entry import Briefing, Declined, Entry, Opened
from cranedyn.benchmark.sensors import SensorReading
from cranedyn.errors import CraneError, DataError, format_error, quoted
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.signals import input_names, state_names

try:
    import fmpy
    from fmpy.fmi2 import FMU2Slave
    from fmpy.fmi3 import FMU3Slave
except ModuleNotFoundError as error:
    raise CraneError(
        "FMUs need FMPy, which is not installed: pip install 'cranedyn[fmi]'."
    ) from error

_DRIVES = ("velocity", "motion", "effort")
"""Kinds of outputs, in the order in which they are looked for."""

_PROBE = 1e-3
"""Change of an input that shows whether outputs follow at once [SI]."""


def open_source(source: str) -> Opened:
    """Unpack an FMU.

    Raises:
        DataError: If it cannot be read, or is not for co-simulation on this machine.
    """
    path = Path(source).resolve()  # FMPy changes directory before it loads a unit
    folder = tempfile.TemporaryDirectory(prefix="cranedyn-fmu-")
    try:
        description = fmpy.read_model_description(str(path), validate=False)
        fmpy.extract(str(path), unzipdir=folder.name)
    except Exception as error:  # zip, XML and its schema, each with errors of its own
        raise DataError(f"{source} is no FMU: {format_error(error)}") from error
    if description.coSimulation is None:
        raise DataError(f"{source} is not for co-simulation; export it as one.")

    def make(briefing: Briefing) -> Entry:
        # The folder is removed with this function.
        return _unit_entry(source, description, folder.name, briefing)

    return make


class _Unit:
    """An instance of an FMU between its begin and its end.

    Attributes:
        inputs: Names of its inputs.
        outputs: Names of its outputs.
    """

    def __init__(self, source: str, description: Any, folder: str) -> None:
        """Load the library and instantiate the unit.

        Raises:
            CraneError: If that fails, such as of an FMU for another kind of machine.
        """
        variables = description.modelVariables
        self._source = source
        self._reference = {one.name: one.valueReference for one in variables}
        self.inputs = [one.name for one in variables if one.causality == "input"]
        self.outputs = [one.name for one in variables if one.causality == "output"]
        self._is_fmi3 = description.fmiVersion.startswith("3")
        self._time = 0.0
        kind = FMU3Slave if self._is_fmi3 else FMU2Slave
        try:
            self._slave = kind(
                guid=description.guid,
                unzipDirectory=folder,
                modelIdentifier=description.coSimulation.modelIdentifier,
                instanceName="entry",
            )
            self._slave.instantiate()
        except Exception as error:
            raise CraneError(f"{source} cannot be loaded: {format_error(error)}") from error
        # A unit is freed with the entry that has it, when the next instance begins.
        weakref.finalize(self, _free, self._slave)

    def enter_initialization(self) -> None:
        """Begin the initialisation at time 0, in which inputs are set for the first time."""
        if self._is_fmi3:
            self._slave.enterInitializationMode(startTime=0.0)
        else:
            self._slave.setupExperiment(startTime=0.0)
            self._slave.enterInitializationMode()

    def exit_initialization(self) -> None:
        """End the initialisation."""
        self._slave.exitInitializationMode()

    def set(self, names: Sequence[str], values: list[float]) -> None:
        """Set inputs."""
        references = [self._reference[name] for name in names]
        setter = self._slave.setFloat64 if self._is_fmi3 else self._slave.setReal
        setter(references, values)

    def get(self, names: Sequence[str]) -> np.ndarray:
        """Return outputs."""
        references = [self._reference[name] for name in names]
        getter = self._slave.getFloat64 if self._is_fmi3 else self._slave.getReal
        return np.array(getter(references))

    def step(self, period: float) -> None:
        """Advance by a time [s]."""
        self._slave.doStep(currentCommunicationPoint=self._time, communicationStepSize=period)
        self._time += period


def _free(slave: Any) -> None:
    """End an instance of a unit."""
    slave.terminate()
    slave.freeInstance()


def _unit_entry(source: str, description: Any, folder: str, briefing: Briefing) -> Entry:
    """Return an instance of an FMU as an entry.

    Raises:
        Declined: If the FMU has not the outputs for the crane: it was made for another one.
        DataError: If it has inputs that nobody knows.
    """
    unit = _Unit(source, description, folder)
    outputs, drive = _commands(source, unit, briefing)
    signals = _Signals(source, unit.inputs, briefing)
    start = briefing.start
    zero = np.zeros(len(outputs))
    at_rest = Setpoint(start.q[briefing.crane.layout.drives], zero, zero)
    unit.enter_initialization()
    follows = _follows_at_once(unit, outputs, signals.values(0.0, start, at_rest))
    unit.exit_initialization()

    def command(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return what the unit commands; a controller of cranedyn."""
        unit.set(unit.inputs, signals.values(t, state, setpoint))
        if follows:
            commanded = unit.get(outputs)
            unit.step(briefing.period)
            return commanded
        unit.step(briefing.period)
        return unit.get(outputs)

    rates = briefing.entry(command, signals.setpoint, drive)

    def entry(reading: SensorReading) -> np.ndarray:
        signals.take(reading)
        return rates(reading)

    return entry


def _follows_at_once(unit: _Unit, outputs: Sequence[str], values: list[float]) -> bool:
    """Return whether outputs follow the inputs without a step.

    Such outputs are read before a step, which then advances what the unit remembers. Others are
    those of the end of the step. It is tried in the initialisation, where FMI allows it.
    """
    unit.set(unit.inputs, values)
    before = unit.get(outputs)
    unit.set(unit.inputs, [value + _PROBE for value in values])
    after = unit.get(outputs)
    unit.set(unit.inputs, values)
    return bool((before != after).any())


def _commands(source: str, unit: _Unit, briefing: Briefing) -> tuple[list[str], str]:
    """Return the names of the outputs that command the drives, and what they command.

    Raises:
        Declined: If there is none for each drive.
    """
    wanted = []
    for drive in _DRIVES:
        names = []
        for name in input_names(briefing.crane, drive):
            names.append(name if name.endswith("_command") else f"{name}_command")
        wanted += names
        if set(names) <= set(unit.outputs):
            return names, drive
    raise Declined(
        f"{source} has the outputs {', '.join(unit.outputs) or 'none'}; on this crane it needs "
        f"one for each drive, of one kind, of {', '.join(wanted)}."
    )


class _Signals:
    """The values of the inputs of a unit."""

    def __init__(self, source: str, inputs: Sequence[str], briefing: Briefing) -> None:
        """Find what each input is.

        Raises:
            DataError: If the name of one says nothing.
        """
        crane = briefing.crane
        self._briefing = briefing
        self._targets = Targets(briefing)
        drives = [joint.symbol for joint in crane.layout.driven]
        names = {
            "state": state_names(crane),
            "set": [f"{symbol}_set" for symbol in drives],
            "rate": [f"{symbol}_dot_set" for symbol in drives],
            "goal": [f"{symbol}_goal" for symbol in drives],
            "operator": [f"{symbol}_operator" for symbol in drives],
        }
        known = [name for group in names.values() for name in group]
        for name in inputs:
            if name not in known:
                raise DataError(
                    f"{source} has the input {quoted(name)}; on this crane inputs are "
                    f"{', '.join(known)}."
                )
        self._order = [known.index(name) for name in inputs]
        self._operator = np.zeros(len(drives))
        # Until the first reading.
        self._target = Target(briefing.start.q[crane.layout.drives], self._operator)
        self._motion: Callable[[float], Setpoint] | None = None
        if briefing.kind != "operator":
            self._motion = briefing.motion

    def setpoint(self, t: float) -> Setpoint:
        """Return the smooth motion at a time; under an operator where the drives were sent."""
        if self._motion is not None:
            return self._motion(t)
        return Setpoint(self._target.position, self._target.rate, np.zeros_like(self._operator))

    def take(self, reading: SensorReading) -> None:
        """Take a reading, before the values are asked for."""
        self._target = self._targets(reading)
        self._operator = reading.operator

    def values(self, t: float, state: State, setpoint: Setpoint) -> list[float]:
        """Return the values of the inputs at a time, in their order."""
        later = setpoint.velocity
        if self._motion is not None:
            later = self._motion(t + self._briefing.period).velocity
        everything = np.concatenate(
            [*state, setpoint.position, later, self._target.position, self._operator]
        )
        return everything[self._order].tolist()
