"""What a crane feels of the motion of its base, sampled for the physics steps of a run.

Both engines read the motion here, at the same times: every half physics step, see
`cranedyn.dynamics.root_motion.interpolated_root`. So they compute the same, whatever the function
of the base costs, which is called for many times at once.
"""

from __future__ import annotations

import numpy as np

from cranedyn.dynamics.root_motion import SAMPLES_PER_STEP
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.simulation.run_spec import RunSpec

_PERIODS_AT_ONCE = 100
"""Control periods whose samples are computed together: one call of the function of a base costs as
much as that of some dozen times."""

_MAX_STEPS_AT_ONCE = 10_000
"""Physics steps of these periods together at most, unless one period has more."""

_MAX_STEPS_PER_PERIOD = 10_000_000
"""Physics steps of a control period at most: their samples take 1.4 GB."""


class BaseSamples:
    """Samples of the motion of the base, control period by control period."""

    def __init__(self, spec: RunSpec) -> None:
        """Begin without samples.

        Args:
            spec: A run with a base.

        Raises:
            OutOfRange: If the samples of one control period would take too much memory.
        """
        assert spec.base is not None
        steps = spec.clocks.steps
        if steps > _MAX_STEPS_PER_PERIOD:
            allowed = f"{_MAX_STEPS_PER_PERIOD} or less on a base that moves"
            raise OutOfRange("physics steps in a control period", steps, allowed)
        self._periods_at_once = max(1, min(_PERIODS_AT_ONCE, _MAX_STEPS_AT_ONCE // steps))
        self._base = spec.base
        self._spec = spec
        self._gravity = spec.crane.model.gravity.linear.copy()
        self._first_kept = 0
        self._kept_periods = 0
        self._kept = np.zeros((0, 0))

    def of_periods(self, first: int, periods: int) -> np.ndarray:
        """Return the samples of some control periods, a row for each half physics step with both
        ends, shape (2 · steps · periods + 1, 9).

        Args:
            first: Control instant at which the first period begins.
            periods: Number of periods; with 0 it is the sample of the instant alone.

        Raises:
            OutOfRange: If the motion is not known then, or a number is not finite.
            CraneError: If the function of the base raises an error.
        """
        clocks = self._spec.clocks
        half_step = clocks.dt / SAMPLES_PER_STEP
        count = SAMPLES_PER_STEP * clocks.steps * periods + 1
        # From one origin, so that a sample is the same, but for round-off, whichever periods it is
        # asked for with.
        before = SAMPLES_PER_STEP * clocks.steps * first
        times = self._spec.t_start + half_step * np.arange(before, before + count)
        return self._base.frames(times).root_numbers(self._gravity)

    def of_period(self, instant: int) -> np.ndarray:
        """Return the samples of the control period that begins at an instant, shape (2 · steps + 1,
        9), read-only. The errors are those of `of_periods`.
        """
        place = instant - self._first_kept
        if not 0 <= place < self._kept_periods:
            # The motion may be known no longer than the run lasts, and a stepper has no end.
            remaining = (self._base.last - self._spec.time(instant)) / self._spec.clocks.period
            self._read(instant, max(1, int(min(self._periods_at_once, remaining))))
            place = 0
        rows_per_period = SAMPLES_PER_STEP * self._spec.clocks.steps
        first_row = place * rows_per_period
        return self._kept[first_row : first_row + rows_per_period + 1]

    def _read(self, instant: int, periods: int) -> None:
        """Compute and keep the samples of some periods from an instant on; of one alone if the
        function of the base fails further on, so that the run goes on until then.
        """
        try:
            samples = self.of_periods(instant, periods)
        except CraneError:
            periods = 1
            samples = self.of_periods(instant, periods)
        samples.flags.writeable = False
        self._first_kept = instant
        self._kept_periods = periods
        self._kept = samples

    def of_instant(self, instant: int) -> np.ndarray:
        """Return the sample of a control instant, shape (9,). The errors are those of
        `of_periods`.
        """
        place = instant - self._first_kept
        if 0 <= place <= self._kept_periods and self._kept_periods:
            return self._kept[SAMPLES_PER_STEP * self._spec.clocks.steps * place]
        if self._base.last - self._spec.time(instant) >= self._spec.clocks.period:
            return self.of_period(instant)[0]
        return self.of_periods(instant, 0)[0]

    def rotation(self, instant: int) -> np.ndarray:
        """Return the attitude of the base at an instant, from its axes to those of the world, shape
        (3, 3).
        """
        return self._base.frames_at(self._spec.time(instant)).rotation[0]
