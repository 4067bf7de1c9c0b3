"""What an entry measures: the readings of an instance, and the sensors that make them of the true
state.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cranedyn.benchmark.task import Instance
from cranedyn.estimation.sensor_model import noise_of
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

_NOISE_ROWS = 256
"""Readings whose noise is drawn at once."""


class SensorReading(NamedTuple):
    """What an entry gets in each control period, for m drives and s swing angles.

    Attributes:
        t: Time since the start [s].
        position: Measured positions of the drives [rad or m], shape (m,).
        rate: Measured rates of the drives [rad/s or m/s], shape (m,).
        swing: Measured swing angles from rest [rad], shape (s,).
        swing_rate: Measured rates of the swing angles [rad/s], shape (s,).
        operator: Rates that the operator asks for now [rad/s or m/s], shape (m,); zero in a task
            without an operator.
    """

    t: float
    position: np.ndarray
    rate: np.ndarray
    swing: np.ndarray
    swing_rate: np.ndarray
    operator: np.ndarray


class SensorChain:
    """The sensors of one instance; they remember readings, so each run needs new ones.

    A reading is the true state, plus the error of the zeros, plus white noise, rounded to the
    resolution of the sensors, and late. In an outage the last reading before it stays.
    """

    def __init__(self, instance: Instance, crane: Crane) -> None:
        """Take the sensors of an instance.

        Args:
            instance: The instance.
            crane: The crane that moves.
        """
        task = instance.task
        values = instance.values
        layout = crane.layout
        self._crane = crane
        self._task = task
        self._rng = np.random.default_rng(instance.noise_seed)
        deviations = task.sensors.noise * values["noise_factor"] * noise_of(crane)
        coordinate_noise, rate_noise = deviations.reshape(2, -1)
        drives = layout.drives
        self._noise = np.concatenate(
            [
                coordinate_noise[drives],
                rate_noise[drives],
                coordinate_noise[crane.swings],
                rate_noise[crane.swings],
            ]
        )
        self._noise_rows: Iterator[np.ndarray] = iter(())
        m = len(drives)
        s = len(crane.swings)
        # Where position, rate, swing and swing rate stand among the measured numbers.
        self._places = consecutive_slices([m, m, s, s])
        # The drum does not know of a rope that is longer than assumed.
        self._zero = -instance.drive_offset(crane)
        self._bias = values["swing_bias"]
        self._no_operator = np.zeros(m)
        delay = task.sensors.delay + round(values["more_delay"])
        self._readings: deque[SensorReading] = deque(maxlen=delay + 1)
        self._outage_begins = values["outage_at"]
        self._outage_ends = values["outage_at"] + values["outage"]

    def read(self, t: float, state: State) -> SensorReading:
        """Return the reading at a time [s], of which the operator's part is not measured, and so
        neither late nor noisy.
        """
        is_out = self._outage_begins <= t < self._outage_ends
        if not (is_out and self._readings):
            self._readings.append(self._measured(t, state))
        # With so many readings at most, the first one is as old as the delay says.
        oldest = self._readings[0]
        if not self._task.joystick:
            return oldest._replace(t=t)
        return oldest._replace(t=t, operator=self._task.operator_rates(t))

    def _measured(self, t: float, state: State) -> SensorReading:
        """Return the reading without delay and outage."""
        crane = self._crane
        drives = crane.layout.drives
        rates = state.v[drives]
        exact = np.concatenate(
            [
                state.q[drives] + self._zero,
                rates,
                crane.swing_angles(state.q) + self._bias,
                state.v[crane.swings] - crane.rest.slope @ rates,
            ]
        )
        noisy = exact + self._noise_row()
        position, rate, swing, swing_rate = [noisy[place] for place in self._places]
        return SensorReading(
            t=t,
            position=_rounded(position, self._task.sensors.position_step),
            rate=rate,
            swing=_rounded(swing, self._task.sensors.swing_step),
            swing_rate=swing_rate,
            operator=self._no_operator,
        )

    def _noise_row(self) -> np.ndarray:
        """Return the noise of the next reading. It is drawn for many readings at once, which takes
        less time and gives the same numbers.
        """
        row = next(self._noise_rows, None)
        if row is None:
            shape = (_NOISE_ROWS, len(self._noise))
            self._noise_rows = iter(self._noise * self._rng.standard_normal(shape))
            row = next(self._noise_rows)
        return row


def consecutive_slices(sizes: Sequence[int], begin: int = 0) -> list[slice]:
    """Return where parts of an array stand that follow one another.

    Args:
        sizes: Sizes of the parts.
        begin: Index at which the first one begins.
    """
    ends = np.cumsum([begin, *sizes]).tolist()
    return [slice(first, end) for first, end in itertools.pairwise(ends)]


def _rounded(values: np.ndarray, resolution: float) -> np.ndarray:
    """Return values rounded to multiples of a resolution; 0 for no rounding."""
    return values if resolution == 0.0 else resolution * np.rint(values / resolution)
