"""A crane as a plant with drive words: ramps, brakes, encoders, load cell, wind, and the rules by
which it stops.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cranedyn.bridges.commissioning import words as w
from cranedyn.clocks import clocks
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.converters import ROUNDING, STEPS, converters
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.dynamics.joint_forces import JointForces, tension_from_hoist_force
from cranedyn.dynamics.pinocchio import holding_effort, point_positions, point_velocities
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.engine import Setting, load_engine
from cranedyn.simulation.log import Log
from cranedyn.simulation.record import RunRecord
from cranedyn.simulation.stepper import check_bounded, initial_state

DT, PERIOD = 5e-4, 5e-3
"""Physics step and cycle of the plant [s]."""

CHECKING, AREA = 20, 4.0
"""Cycles between checks that the model holds; drag coefficient times area of the load [m²]."""

MARGIN, GROUND = 0.05, 0.5
"""Distance that stays to the ends of the ranges [rad or m]; height of the load at which lowering
ends [m], since the served crane has no contact with the ground."""

JUMP, TOLERANCE = 1000, 100
"""Jump of an encoder, and deviation from the speed of its drive in a cycle that is a fault
[counts]."""

SLIP, MOVING, STOPPED = 0.05, 0.02, 0.01
"""Speed of a slipping brake, speed that is a fault with a closed brake, and speed at which a brake
closes, as shares of the largest rate."""


class ServedCrane:
    """Crane with frequency converters, brakes and sensors.

    A drive runs while it is enabled and there is no fault. Its speed command goes through the ramp
    of its ramp word, is cut before the ends of the range, and is followed by the converter. Without
    enable the drive ramps down, and its brake closes at standstill. A fault stops all drives on the
    ramps of the converters. It stays until a reset bit rises while no drive is enabled.

    Attributes:
        crane: The crane.
        image: Commands and readings.
        state: State of the crane.
        fault: Code of the fault, 0 for none.
        events: Times [s] and sentences of what has happened.
        cycles: Number of cycles so far.
    """

    def __init__(
        self, crane: Crane, *, start: State | None = None, duration: float = 3600.0
    ) -> None:
        """Stand at a state, brakes closed.

        Args:
            crane: The crane.
            start: Where it stands; None hangs at rest where the URDF says.
            duration: Longest run [s], a multiple of 5 ms; memory is reserved for it.

        Raises:
            OutOfRange: If the duration is out of range, or the start moves or is no state of this
                crane.
        """
        self._drive = converters(crane)
        clock, rule = clocks(duration, DT, PERIOD), semi_implicit_euler
        setting = Setting.of(crane, clock, self._drive, forces=True, buffers=False, integrator=rule)
        self.crane, self.state = crane, initial_state(crane, start)
        if self.state.v.any():
            raise OutOfRange("rates of the start", self.state.v.tolist(), "0", "/s")
        self.fault, self.cycles, self.events = 0, 0, list[tuple[float, str]]()
        self.image = w.ProcessImage(w.word_map(crane, self._drive))
        self._log = Log(setting, "stop", 0.0, setting.clocks.periods + 1)
        self._record = RunRecord(setting, "compiled", "stop", self)
        layout = self._layout = crane.layout
        self._hoist, self._symbols = layout.drive_of("hoist"), [j.symbol for j in layout.driven]
        self._counts = np.array([w.COUNT[joint.unit] for joint in layout.driven])
        self._lag = self._drive.lags + self._drive.delay + ROUNDING
        holding = holding_effort(crane, self.state.q)
        self._gravity = -np.sign(holding.round(6))
        self._command, self._running = np.zeros(layout.m), np.zeros(layout.m, dtype=bool)
        self._closed, self._ends = ~self._running, np.zeros((2, layout.m), dtype=bool)
        self._encoder = self.state.q[layout.drives] / self._counts
        self._setpoint = self.state.q[layout.drives].copy()
        self._last, self._resetting, self._heard = self.image.commands.copy(), False, 0.0
        self._impossible = set[str]()
        self._publish(self._last, holding)
        self._engine = load_engine("compiled")(setting, self.state)
        # compiles what the first cycle shall not wait for
        self._engine.advance(self._command, np.zeros((len(layout.points), 3)))
        self._engine.reset(self.state)

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.cycles * PERIOD

    def cycle(self) -> None:
        """Take the commands, move the crane by a period, and publish the readings.

        Raises:
            RunError: If the model ceases to hold, or the crane moves beyond all bounds.
        """
        check_bounded(self._layout, self.t, self.state)
        commands, impossible = self.image.accepted(self._last)
        for name in sorted(set(impossible) - self._impossible):
            self.events.append((self.t, f"{name} is no number of its type; the last command holds"))
        self._impossible = set(impossible)
        if commands["inject"] & w.MESSAGES_LOST:
            commands = {**self._last, "inject": commands["inject"]}
        self._switch(commands)
        self._command = self._limited(commands)
        self._setpoint += PERIOD * self._command
        wind = np.array([commands["wind"] * w.WIND, 0.0, 0.0])
        force = np.zeros((len(self._layout.points), 3))
        force[0] = drag_force(AREA, wind - point_velocities(self.crane, self.state)[0])
        self.state = self._engine.advance(self._command, force)
        setpoint = Setpoint(self._setpoint, self._command, np.zeros_like(self._command))
        self._log.append(self._engine.row(setpoint))
        if self.cycles % CHECKING == 0:
            self._log.check()
        self.cycles += 1
        self._publish(commands, self._engine.actuation.effort)

    def _column(self, commands: Mapping[str, int], word: str) -> np.ndarray:
        """Return a command of each drive, shape (m,)."""
        return np.array([commands[f"{symbol}.{word}"] for symbol in self._symbols])

    def _switch(self, commands: dict[str, int]) -> None:
        """Enable and stop the drives, close the brakes, and reset a fault."""
        control = self._column(commands, "control")
        enabled, resetting = control & w.ENABLE > 0, bool((control & w.RESET).any())
        if commands["heartbeat"] != self._last["heartbeat"] or not enabled.any():
            self._heard = self.t
        if self.t - self._heard > w.TIMEOUT:
            self._trip(w.WATCHDOG)
        if self.fault and resetting and not self._resetting and not enabled.any():
            self.fault = 0
            self.events.append((self.t, "fault reset"))
        self._last, self._resetting = commands, resetting
        self._running = enabled & (self.fault == 0)
        still = np.abs(self.state.v[self._layout.drives]) < STOPPED * self._drive.rates
        self._closed = ~self._running & (self._closed | still)

    def _limited(self, commands: Mapping[str, int]) -> np.ndarray:
        """Return the rates that the converters are commanded, shape (m,)."""
        rates, v = self._drive.rates, self.state.v[self._layout.drives]
        share = np.clip(self._column(commands, "speed") / STEPS, -1.0, 1.0)
        ramp = 1e-3 * self._column(commands, "ramp") * (self.fault == 0)
        step = np.full_like(rates, np.inf)
        np.divide(PERIOD * rates, ramp, out=step, where=ramp > 0.0)
        change = np.where(self._running, share * rates, 0.0) - self._command
        command = self._command + np.clip(change, -step, step)
        slipping = self._column(commands, "inject") & w.BRAKE_SLIP > 0
        slipping &= self._closed & (self.fault != w.BRAKE)  # then the converter holds the load
        command[slipping] = (SLIP * self._gravity * rates)[slipping]
        room = self._room() - MARGIN - np.maximum([-v, v], 0.0) * self._lag
        # Half of the acceleration of the ramps is left for their rounding.
        bound = np.sqrt(self._drive.accelerations * np.maximum(room, 0.0))
        self._ends = bound < STOPPED * rates
        return np.clip(command, -bound[0], bound[1])

    def _room(self) -> np.ndarray:
        """Return the way of the drives to their lower and upper ends [rad or m], shape (2, m)."""
        q, drives = self.state.q, self._layout.drives
        room = np.array([q - self.crane.lower, self.crane.upper - q])[:, drives]
        if self._hoist is not None:
            lowering = int(self._gravity[self._hoist] > 0.0), self._hoist
            height = float(point_positions(self.crane, q)[0, 2]) - GROUND
            room[lowering] = min(room[lowering], height)
        return room

    def _publish(self, commands: Mapping[str, int], effort: np.ndarray) -> None:
        """Read the sensors, stop where they show a fault, and publish their readings."""
        (q, v), crane, layout, rates = self.state, self.crane, self._layout, self._drive.rates
        speed, inject = v[layout.drives], self._column(commands, "inject")
        jumped = JUMP * (inject & w.ENCODER_JUMP > 0)
        encoder = np.round(q[layout.drives] / self._counts) + jumped
        off = np.abs(encoder - self._encoder - PERIOD * speed / self._counts) > TOLERANCE
        self._encoder = encoder
        slipping = self._closed & (np.abs(speed) > MOVING * rates)
        for code, wrong in ((w.ENCODER, off), (w.BRAKE, slipping)):
            for drive in np.flatnonzero(wrong):
                self._trip(code, self._symbols[drive])
        if lost := bool(commands["inject"] & w.ROPE_SENSOR_LOST):
            self._trip(w.ROPE_SENSOR)
        angles = zip(crane.swings.tolist(), crane.swing_angles(q) / w.ANGLE, strict=True)
        rope = {f"{layout.symbols[i]}.angle": angle for i, angle in angles}
        if self._hoist is not None:
            force = float(effort[self._hoist])
            tension = tension_from_hoist_force(layout, JointForces.of(crane), q, v, force)
            rope["load"] = tension / crane.gravity
        at_speed = self._running & (np.abs(speed - self._command) < STOPPED * rates)
        bits = [not self.fault, self._running, self.fault > 0, at_speed, self._closed, *self._ends]
        status = np.sum([np.broadcast_to(bit, layout.m) << i for i, bit in enumerate(bits)], axis=0)
        readings = {"cycle": self.cycles & 0xFFFF, "fault": self.fault}
        readings["wind_speed"] = commands["wind"]
        readings |= {name: w.INVALID if lost else round(value) for name, value in rope.items()}
        for i, symbol in enumerate(self._symbols):
            readings[f"{symbol}.status"] = int(status[i])
            readings[f"{symbol}.actual_speed"] = round(speed[i] / rates[i] * STEPS)
            readings[f"{symbol}.encoder"] = int(encoder[i])
        self.image.readings = readings

    def _trip(self, code: int, drive: str = "") -> None:
        """Stop all drives by a fault; the first one stays."""
        if not self.fault:
            self.fault = code
            self.events.append((self.t, f"{drive} {w.FAULTS[code]}".strip()))

    def notes(self) -> dict[str, Any]:
        """Return the events, for the record of the run."""
        return {"events": [[round(t, 6), text] for t, text in self.events]}

    def trajectory(self) -> Trajectory:
        """Return all cycles so far as a trajectory."""
        return self._record.trajectory(self._log, self._engine)
