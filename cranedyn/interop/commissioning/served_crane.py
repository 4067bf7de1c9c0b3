"""A crane as a plant with drive words: ramps, brakes, encoders, load cell, wind, and the rules by
which it stops.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.wind import drag_force
from cranedyn.dynamics.converters import ROUNDING, STEPS, converters
from cranedyn.dynamics.equations_of_motion import (
    constraint_tension,
    holding_effort,
    point_positions,
    point_velocities,
)
from cranedyn.dynamics.integrators import semi_implicit_euler
from cranedyn.dynamics.joint_forces import JointForces, rope_tension
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import State
from cranedyn.interop.commissioning import words
from cranedyn.model.crane import Crane
from cranedyn.simulation.run_spec import make_run_spec
from cranedyn.simulation.stepper import RecordedCrane

DT = 5e-4
"""Physics step of the plant [s]."""

PERIOD = 5e-3
"""Cycle of the plant [s]."""

CHECKING = 20
"""Cycles between checks that the model holds."""

AREA = 4.0
"""Drag coefficient times area of the load [m²]."""

MARGIN = 0.05
"""Distance that stays to the ends of the ranges [rad or m]."""

GROUND = 0.5
"""Height of the load at which lowering ends [m], since the served crane has no contact with the
ground."""

JUMP = 1000
"""Jump of an encoder that is injected [counts]."""

TOLERANCE = 100
"""Deviation of an encoder from the speed of its drive in a cycle that is a fault [counts]."""

SLIP = 0.05
"""Speed of a slipping brake, as a share of the largest rate."""

MOVING = 0.02
"""Speed that is a fault with a closed brake, as a share of the largest rate."""

STOPPED = 0.01
"""Speed at which a brake closes, and deviation with which a drive is at speed, as shares of the
largest rate."""

HOLDING_EFFORT_DIGITS = 6
"""Number of decimals of a holding effort that count [N m or N]; what is left of a drive that
gravity does not move is round-off."""


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
        spec = make_run_spec(
            crane,
            start=start,
            t_start=0.0,
            duration=duration,
            dt=DT,
            control_period=PERIOD,
            drive=self._drive,
            integrator=semi_implicit_euler,
            validity="stop",
            disturbance=None,
            ground=None,
            has_forces=True,
        )
        self.crane = crane
        self.state = spec.start
        if self.state.v.any():
            raise OutOfRange("rates of the start", self.state.v.tolist(), "0", "/s")
        self.fault = 0
        self.cycles = 0
        self.events: list[tuple[float, str]] = []
        self.image = words.ProcessImage(words.word_map(crane, self._drive))
        # It is compiled now, so that the first cycle does not wait for that.
        self._recorded = RecordedCrane(spec, "compiled", controller=self)

        layout = crane.layout
        self._layout = layout
        self._hoist = layout.drive_of("hoist")
        self._symbols = [joint.symbol for joint in layout.driven]
        self._counts = np.array([words.COUNT[joint.unit] for joint in layout.driven])
        # Time from a command until a drive brakes with the acceleration of its ramp [s].
        self._lag = self._drive.lags + self._drive.delay + ROUNDING
        holding = holding_effort(crane, self.state.q)
        # Sense in which gravity moves each drive; 0 where it does not.
        self._gravity_sense = -np.sign(holding.round(HOLDING_EFFORT_DIGITS))

        drive_positions = self.state.q[layout.drives]
        # Rates that the converters are commanded, and where these lead the drives.
        self._command = np.zeros(layout.m)
        self._setpoint = drive_positions.copy()
        self._running = np.zeros(layout.m, dtype=bool)
        self._closed = ~self._running
        # Whether each drive is at its lower and at its upper end.
        self._at_end = np.zeros((2, layout.m), dtype=bool)
        self._encoder = drive_positions / self._counts
        self._last_commands = self.image.commands.copy()
        self._resetting = False
        # Time of the last new heartbeat, or at which no drive was enabled [s].
        self._last_heartbeat = 0.0
        self._impossible: set[str] = set()
        self._publish(self._last_commands, holding, np.zeros((len(layout.points), 3)))

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return self.cycles * PERIOD

    def cycle(self) -> None:
        """Take the commands, move the crane by a period, and publish the readings.

        Raises:
            RunError: If the model ceases to hold, or the crane moves beyond all bounds.
        """
        commands, impossible = self.image.accepted(self._last_commands)
        # An event is told once, when it begins.
        for name in sorted(set(impossible) - self._impossible):
            self.events.append((self.t, f"{name} is no number of its type; the last command holds"))
        self._impossible = set(impossible)
        if commands["inject"] & words.MESSAGES_LOST:
            # What is injected still arrives, or it could not be ended.
            commands = {**self._last_commands, "inject": commands["inject"]}
        self._switch(commands)
        self._command = self._limited(commands)
        self._setpoint += PERIOD * self._command
        # The wind blows along +X. The payload is the first point of a crane.
        wind = np.array([commands["wind"] * words.WIND, 0.0, 0.0])
        force = np.zeros((len(self._layout.points), 3))
        force[0] = drag_force(AREA, wind - point_velocities(self.crane, self.state)[0])
        self.state = self._recorded.step(self._command, self._setpoint, force)
        if self.cycles % CHECKING == 0:
            self._recorded.judge()
        self.cycles += 1
        self._publish(commands, self._recorded.actuation.effort, force)

    def _column(self, commands: Mapping[str, int], word: str) -> np.ndarray:
        """Return a command of each drive, shape (m,)."""
        return np.array([commands[f"{symbol}.{word}"] for symbol in self._symbols])

    def _switch(self, commands: dict[str, int]) -> None:
        """Enable and stop the drives, close the brakes, and reset a fault."""
        control = self._column(commands, "control")
        enabled = control & words.ENABLE > 0
        resetting = bool((control & words.RESET).any())
        heartbeat_changed = commands["heartbeat"] != self._last_commands["heartbeat"]
        if heartbeat_changed or not enabled.any():
            self._last_heartbeat = self.t
        if self.t - self._last_heartbeat > words.TIMEOUT:
            self._trip(words.WATCHDOG)
        # A reset bit must rise: one that stays set would hide the next fault.
        if self.fault and resetting and not self._resetting and not enabled.any():
            self.fault = 0
            self.events.append((self.t, "fault reset"))
        self._last_commands = commands
        self._resetting = resetting
        self._running = enabled & (self.fault == 0)
        still = np.abs(self.state.v[self._layout.drives]) < STOPPED * self._drive.rates
        self._closed = ~self._running & (self._closed | still)

    def _limited(self, commands: Mapping[str, int]) -> np.ndarray:
        """Return the rates that the converters are commanded [rad/s or m/s], shape (m,)."""
        command = self._ramped(commands)
        # A brake that slips lets its drive move slowly in the sense of gravity.
        slips = self._column(commands, "inject") & words.BRAKE_SLIP > 0
        slips &= self._closed
        # A crane that has seen its brake slip is held by the converter.
        slips &= self.fault != words.BRAKE
        command[slips] = (SLIP * self._gravity_sense * self._drive.rates)[slips]

        # Row 0 is the lower end, row 1 the upper one.
        v = self.state.v[self._layout.drives]
        travel_before_braking = np.maximum([-v, v], 0.0) * self._lag
        room = self._room() - MARGIN - travel_before_braking
        # A drive stops from the rate √(2 b d) in the distance d. With b half of the acceleration a
        # of the ramps it is √(a d): the other half is left for their rounding.
        bound = np.sqrt(self._drive.accelerations * np.maximum(room, 0.0))
        self._at_end = bound < STOPPED * self._drive.rates
        return np.clip(command, -bound[0], bound[1])

    def _ramped(self, commands: Mapping[str, int]) -> np.ndarray:
        """Return the commands led to the speeds that are commanded by the ramp words, shape (m,).

        A drive that does not run is led to zero. At a fault ramp words do not count: the ramps of
        the converters are the steepest.
        """
        rates = self._drive.rates
        share = np.clip(self._column(commands, "speed") / STEPS, -1.0, 1.0)
        ramp_time = 1e-3 * self._column(commands, "ramp")
        if self.fault:
            ramp_time = np.zeros_like(ramp_time)
        # A ramp time of 0 leaves the ramp to the converter.
        largest_step = np.full_like(rates, np.inf)
        np.divide(PERIOD * rates, ramp_time, out=largest_step, where=ramp_time > 0.0)
        goal = np.where(self._running, share * rates, 0.0)
        change = goal - self._command
        return self._command + np.clip(change, -largest_step, largest_step)

    def _room(self) -> np.ndarray:
        """Return the distance of the drives from their lower and upper ends [rad or m], shape (2,
        m). That of the hoist also ends above the ground.
        """
        q = self.state.q
        room = np.array([q - self.crane.lower, self.crane.upper - q])[:, self._layout.drives]
        if self._hoist is not None:
            # Gravity lowers towards the upper end of a rope, and to the lower end of a height.
            end = int(self._gravity_sense[self._hoist] > 0.0)
            height = float(point_positions(self.crane, q)[0, 2]) - GROUND
            room[end, self._hoist] = min(room[end, self._hoist], height)
        return room

    def _publish(self, commands: Mapping[str, int], effort: np.ndarray, force: np.ndarray) -> None:
        """Read the sensors, stop where they show a fault, and publish their readings.

        Args:
            commands: Commands of this cycle.
            effort: Efforts of the drives [N m or N], shape (m,).
            force: Forces of the wind on the points of the crane in the world [N], shape (points,
                3).
        """
        speed = self.state.v[self._layout.drives]
        self._read_encoders(self._column(commands, "inject"), speed)
        slipping = self._closed & (np.abs(speed) > MOVING * self._drive.rates)
        self._trip_drives(words.BRAKE, slipping)
        rope_sensor_lost = bool(commands["inject"] & words.ROPE_SENSOR_LOST)
        if rope_sensor_lost:
            self._trip(words.ROPE_SENSOR)

        readings = {
            # A counter of 16 bits begins anew.
            "cycle": self.cycles & 0xFFFF,
            "fault": self.fault,
            "wind_speed": commands["wind"],
        }
        for name, value in self._rope_readings(effort, force).items():
            readings[name] = words.INVALID if rope_sensor_lost else round(value)
        status = self._status(speed)
        for i, symbol in enumerate(self._symbols):
            readings[f"{symbol}.status"] = int(status[i])
            readings[f"{symbol}.actual_speed"] = round(speed[i] / self._drive.rates[i] * STEPS)
            readings[f"{symbol}.encoder"] = int(self._encoder[i])
        self.image.readings = readings

    def _read_encoders(self, inject: np.ndarray, speed: np.ndarray) -> None:
        """Read the encoders, and stop where one does not fit the speed of its drive.

        Args:
            inject: Inject words of the drives, shape (m,).
            speed: Rates of the drives [rad/s or m/s], shape (m,).
        """
        position = self.state.q[self._layout.drives]
        jump = np.where(inject & words.ENCODER_JUMP > 0, JUMP, 0)
        encoder = np.round(position / self._counts) + jump
        moved = encoder - self._encoder
        is_wrong = np.abs(moved - PERIOD * speed / self._counts) > TOLERANCE
        self._encoder = encoder
        self._trip_drives(words.ENCODER, is_wrong)

    def _rope_readings(self, effort: np.ndarray, wind_force: np.ndarray) -> dict[str, float]:
        """Return what the sensors of the rope read, by name: angles and load [counts].

        Args:
            effort: Efforts of the drives [N m or N], shape (m,).
            wind_force: Forces of the wind on the points of the crane in the world [N], shape
                (points, 3).
        """
        q, v = self.state
        layout = self._layout
        readings = {}
        angles = self.crane.swing_angles(q) / words.ANGLE
        for i, angle in zip(self.crane.swings.tolist(), angles, strict=True):
            readings[f"{layout.symbols[i]}.angle"] = angle
        if self._hoist is not None:
            hoist_force = float(effort[self._hoist])
            tension = rope_tension(layout, JointForces.of(self.crane), q, v, hoist_force)
            if tension is None:  # an inextensible rope
                tension = constraint_tension(self.crane, self.state, effort, wind_force)
            readings["load"] = tension / self.crane.gravity
        return readings

    def _status(self, speed: np.ndarray) -> np.ndarray:
        """Return the status words of the drives, shape (m,), for their rates [rad/s or m/s]."""
        is_at_speed = np.abs(speed - self._command) < STOPPED * self._drive.rates
        bits = {
            "ready": not self.fault,
            "running": self._running,
            "fault": self.fault > 0,
            "at speed": self._running & is_at_speed,
            "brake closed": self._closed,
            "lower end": self._at_end[0],
            "upper end": self._at_end[1],
        }
        status = np.zeros(self._layout.m, dtype=int)
        for i, name in enumerate(words.STATUS):
            status |= np.where(bits[name], 1 << i, 0)
        return status

    def _trip_drives(self, code: int, is_wrong: np.ndarray) -> None:
        """Stop all drives where a fault is at one of them, shape (m,)."""
        for drive in np.flatnonzero(is_wrong):
            self._trip(code, self._symbols[drive])

    def _trip(self, code: int, drive: str = "") -> None:
        """Stop all drives by a fault; the first one stays."""
        if not self.fault:
            self.fault = code
            self.events.append((self.t, f"{drive} {words.FAULTS[code]}".strip()))

    def notes(self) -> dict[str, Any]:
        """Return the events, for the record of the run."""
        return {"events": [[round(t, 6), text] for t, text in self.events]}

    def trajectory(self) -> Trajectory:
        """Return all cycles so far as a trajectory."""
        return self._recorded.trajectory()
