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

CYCLES_BETWEEN_CHECKS = 20
"""Number of cycles from one check that the model holds to the next."""

DRAG_AREA = 4.0
"""Drag coefficient times area of the load [m²]."""

RANGE_MARGIN = 0.05
"""Distance that the drives keep from the ends of their ranges [rad or m]."""

MIN_LOAD_HEIGHT = 0.5
"""Height of the load at which lowering ends [m], since the served crane has no contact with the
ground."""

INJECTED_JUMP = 1000
"""Jump of an encoder that is injected [counts]."""

ENCODER_TOLERANCE = 100
"""Largest deviation of the counts of an encoder in a cycle from those that the speed of its drive
explains; a larger one is a fault [counts]."""

SLIP_SPEED_RATIO = 0.05
"""Speed of a drive whose brake slips, over its largest rate."""

MOVING_SPEED_RATIO = 0.02
"""Speed of a drive above which it moves although its brake is closed, a fault, over its largest
rate."""

STANDSTILL_SPEED_RATIO = 0.01
"""Speed of a drive below which its brake closes, over its largest rate; also the deviation from its
command below which it is at speed."""

HOLDING_EFFORT_DIGITS = 6
"""Number of decimals to which holding efforts are rounded [N m or N]: what is left of a drive that
gravity does not move is round-off."""


class ServedCrane:
    """Crane with frequency converters, brakes and sensors.

    A drive runs while it is enabled and there is no fault. Its speed command goes through the ramp
    of its ramp word, is limited so that the drive can stop before the end of its range, and is
    followed by the converter. Without enable the drive ramps down, and its brake closes at
    standstill. A fault stops all drives on the ramps of the converters. It stays until a reset bit
    rises while no drive is enabled.

    Attributes:
        crane: The crane.
        image: Commands and readings, which the servers read and write.
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
        self._converters = converters(crane)
        spec = make_run_spec(
            crane,
            start=start,
            t_start=0.0,
            duration=duration,
            dt=DT,
            control_period=PERIOD,
            drive=self._converters,
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
        self.image = words.ProcessImage(words.word_map(crane, self._converters))
        # It is compiled now, so that the first cycle does not wait for that.
        self._recorded = RecordedCrane(spec, "compiled", controller=self)

        layout = crane.layout
        self._layout = layout
        self._hoist = layout.drive_of("hoist")
        self._symbols = [joint.symbol for joint in layout.driven]
        self._resolution = np.array(
            [words.ENCODER_RESOLUTION[joint.unit] for joint in layout.driven]
        )
        # Time from a command to brake until a drive brakes with the acceleration of its ramp [s].
        self._braking_delay = self._converters.lags + self._converters.delay + ROUNDING
        holding = holding_effort(crane, self.state.q)
        # Sign of the rate with which gravity moves each drive; 0 where it does not move it.
        self._gravity_sense = -np.sign(holding.round(HOLDING_EFFORT_DIGITS))

        drive_positions = self.state.q[layout.drives]
        # Rates that the converters are commanded, and the positions to which these lead.
        self._command = np.zeros(layout.m)
        self._setpoint = drive_positions.copy()
        self._running = np.zeros(layout.m, dtype=bool)
        self._brake_closed = ~self._running
        # Whether each drive is at its lower and at its upper end.
        self._at_end = np.zeros((2, layout.m), dtype=bool)
        self._encoder = drive_positions / self._resolution
        self._last_commands = self.image.commands.copy()
        self._reset_was_set = False
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
        commands, impossible = self.image.valid_commands(self._last_commands)
        # A command that stays impossible is one event, when it begins.
        for name in sorted(set(impossible) - self._impossible):
            self.events.append((self.t, f"{name} is no number of its type; the last command holds"))
        self._impossible = set(impossible)
        if commands["inject"] & words.MESSAGES_LOST_BIT:
            # The inject word itself still arrives, since the loss could not be ended otherwise.
            commands = {**self._last_commands, "inject": commands["inject"]}
        self._switch(commands)
        self._command = self._converter_commands(commands)
        self._setpoint += PERIOD * self._command
        # The wind blows along +X. The payload is the first point of a crane.
        wind = np.array([commands["wind"] * words.WIND_RESOLUTION, 0.0, 0.0])
        force = np.zeros((len(self._layout.points), 3))
        force[0] = drag_force(DRAG_AREA, wind - point_velocities(self.crane, self.state)[0])
        self.state = self._recorded.step(self._command, self._setpoint, force)
        if self.cycles % CYCLES_BETWEEN_CHECKS == 0:
            self._recorded.judge()
        self.cycles += 1
        self._publish(commands, self._recorded.actuation.effort, force)

    def _drive_commands(self, commands: Mapping[str, int], word: str) -> np.ndarray:
        """Return a command of each drive, shape (m,)."""
        return np.array([commands[f"{symbol}.{word}"] for symbol in self._symbols])

    def _switch(self, commands: dict[str, int]) -> None:
        """Enable and stop the drives, close the brakes, and reset a fault."""
        control = self._drive_commands(commands, "control")
        enabled = control & words.ENABLE_BIT > 0
        resetting = bool((control & words.RESET_BIT).any())
        heartbeat_changed = commands["heartbeat"] != self._last_commands["heartbeat"]
        if heartbeat_changed or not enabled.any():
            self._last_heartbeat = self.t
        if self.t - self._last_heartbeat > words.HEARTBEAT_TIMEOUT:
            self._trip(words.WATCHDOG_FAULT)
        # A reset bit must rise: one that stays set would hide the next fault.
        if self.fault and resetting and not self._reset_was_set and not enabled.any():
            self.fault = 0
            self.events.append((self.t, "fault reset"))
        self._last_commands = commands
        self._reset_was_set = resetting
        self._running = enabled & (self.fault == 0)
        still = (
            np.abs(self.state.v[self._layout.drives])
            < STANDSTILL_SPEED_RATIO * self._converters.rates
        )
        self._brake_closed = ~self._running & (self._brake_closed | still)

    def _converter_commands(self, commands: Mapping[str, int]) -> np.ndarray:
        """Return the rates that the converters are commanded [rad/s or m/s], shape (m,).

        They are the ramped commands, or the motion of a brake that slips, limited so that each
        drive can stop before the ends of its range.
        """
        command = self._ramped(commands)
        # A closed brake that slips lets its drive move slowly in the sense of gravity.
        slips = self._drive_commands(commands, "inject") & words.BRAKE_SLIP_BIT > 0
        slips &= self._brake_closed
        # Once the crane has noticed that a brake slips, the converters hold the drives.
        slips &= self.fault != words.BRAKE_FAULT
        command[slips] = (SLIP_SPEED_RATIO * self._gravity_sense * self._converters.rates)[slips]

        # Row 0 is the lower end, row 1 the upper one.
        v = self.state.v[self._layout.drives]
        travel_before_braking = np.maximum([-v, v], 0.0) * self._braking_delay
        room = self._distances_to_ends() - RANGE_MARGIN - travel_before_braking
        # A drive that brakes with the acceleration b stops from the rate √(2 b d) in the distance
        # d. With b half of the acceleration a of the ramps that is √(a d): the other half makes up
        # for the rounding of the ramps by their jerk.
        bound = np.sqrt(self._converters.accelerations * np.maximum(room, 0.0))
        self._at_end = bound < STANDSTILL_SPEED_RATIO * self._converters.rates
        return np.clip(command, -bound[0], bound[1])

    def _ramped(self, commands: Mapping[str, int]) -> np.ndarray:
        """Return the rates on the way to the commanded speeds, by the ramp words, shape (m,).

        The rate of a drive that does not run goes to zero. At a fault the ramp words do not count:
        the ramps of the converters are the steepest.
        """
        rates = self._converters.rates
        share = np.clip(self._drive_commands(commands, "speed") / STEPS, -1.0, 1.0)
        ramp_time = 1e-3 * self._drive_commands(commands, "ramp")
        if self.fault:
            ramp_time = np.zeros_like(ramp_time)
        # A ramp time of 0 leaves the ramp to the converter.
        largest_step = np.full_like(rates, np.inf)
        np.divide(PERIOD * rates, ramp_time, out=largest_step, where=ramp_time > 0.0)
        goal = np.where(self._running, share * rates, 0.0)
        change = goal - self._command
        return self._command + np.clip(change, -largest_step, largest_step)

    def _distances_to_ends(self) -> np.ndarray:
        """Return the distances of the drives to their lower and their upper ends [rad or m], shape
        (2, m).

        The end at which the hoist stops lowering is also `MIN_LOAD_HEIGHT` of the load.
        """
        q = self.state.q
        distances = np.array([q - self.crane.lower, self.crane.upper - q])[:, self._layout.drives]
        if self._hoist is not None:
            # Lowering, which is the sense of gravity, ends at the upper end of the coordinate where
            # that is the length of a rope, and at the lower end where it is a height.
            end = int(self._gravity_sense[self._hoist] > 0.0)
            height = float(point_positions(self.crane, q)[0, 2]) - MIN_LOAD_HEIGHT
            distances[end, self._hoist] = min(distances[end, self._hoist], height)
        return distances

    def _publish(self, commands: Mapping[str, int], effort: np.ndarray, force: np.ndarray) -> None:
        """Read the sensors, stop where they show a fault, and publish their readings.

        Args:
            commands: Commands of this cycle.
            effort: Efforts of the drives [N m or N], shape (m,).
            force: Forces of the wind on the points of the crane in the world [N], shape (points,
                3).
        """
        speed = self.state.v[self._layout.drives]
        self._read_encoders(self._drive_commands(commands, "inject"), speed)
        slipping = self._brake_closed & (
            np.abs(speed) > MOVING_SPEED_RATIO * self._converters.rates
        )
        self._trip_drives(words.BRAKE_FAULT, slipping)
        rope_sensor_lost = bool(commands["inject"] & words.ROPE_SENSOR_LOST_BIT)
        if rope_sensor_lost:
            self._trip(words.ROPE_SENSOR_FAULT)

        readings = {
            # The counter has 16 bits, and begins anew after them.
            "cycle": self.cycles & 0xFFFF,
            "fault": self.fault,
            "wind_speed": commands["wind"],
        }
        for name, value in self._rope_readings(effort, force).items():
            readings[name] = words.LOST_READING if rope_sensor_lost else round(value)
        status = self._status(speed)
        for i, symbol in enumerate(self._symbols):
            readings[f"{symbol}.status"] = int(status[i])
            readings[f"{symbol}.actual_speed"] = round(speed[i] / self._converters.rates[i] * STEPS)
            readings[f"{symbol}.encoder"] = int(self._encoder[i])
        self.image.readings = readings

    def _read_encoders(self, inject: np.ndarray, speed: np.ndarray) -> None:
        """Read the encoders, and stop if the counts of one do not fit the speed of its drive.

        Args:
            inject: Inject words of the drives, shape (m,).
            speed: Rates of the drives [rad/s or m/s], shape (m,).
        """
        position = self.state.q[self._layout.drives]
        jump = np.where(inject & words.ENCODER_JUMP_BIT > 0, INJECTED_JUMP, 0)
        encoder = np.round(position / self._resolution) + jump
        moved = encoder - self._encoder
        is_wrong = np.abs(moved - PERIOD * speed / self._resolution) > ENCODER_TOLERANCE
        self._encoder = encoder
        self._trip_drives(words.ENCODER_FAULT, is_wrong)

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
        angles = self.crane.swing_angles(q) / words.ANGLE_RESOLUTION
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
        """Return the status words of the drives, shape (m,), for their rates [rad/s or m/s].

        A drive is at speed where it follows the rate that its converter is commanded, which is that
        of the ramp, also on the way to the speed of its speed word.
        """
        is_at_speed = (
            np.abs(speed - self._command) < STANDSTILL_SPEED_RATIO * self._converters.rates
        )
        bits = {
            "ready": not self.fault,
            "running": self._running,
            "fault": self.fault > 0,
            "at speed": self._running & is_at_speed,
            "brake closed": self._brake_closed,
            "lower end": self._at_end[0],
            "upper end": self._at_end[1],
        }
        status = np.zeros(self._layout.m, dtype=int)
        for i, name in enumerate(words.STATUS_BITS):
            status |= np.where(bits[name], 1 << i, 0)
        return status

    def _trip_drives(self, code: int, is_wrong: np.ndarray) -> None:
        """Stop all drives if one of them has a fault.

        Args:
            code: Code of the fault.
            is_wrong: Whether each drive has it, shape (m,).
        """
        for drive in np.flatnonzero(is_wrong):
            self._trip(code, self._symbols[drive])

    def _trip(self, code: int, drive: str = "") -> None:
        """Stop all drives because of a fault. A fault that is there already stays."""
        if not self.fault:
            self.fault = code
            self.events.append((self.t, f"{drive} {words.FAULTS[code]}".strip()))

    def notes(self) -> dict[str, Any]:
        """Return the events, for the record of the run."""
        return {"events": [[round(t, 6), text] for t, text in self.events]}

    def trajectory(self) -> Trajectory:
        """Return all cycles so far as a trajectory."""
        return self._recorded.trajectory()
