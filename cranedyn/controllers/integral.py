"""An integrator on the hoist, by which a load of another mass than assumed ends at its goal all the
same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from cranedyn.checks import ShortRepr, number
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.affine import Affine
from cranedyn.controllers.tracking import Tracking
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.crane import Crane

HOIST_INTEGRAL = 4.0e3
"""k_i of the hoist beside the LQR [N/(m s)], ours: 2.5 s with the LQR's k_p of about 1e4 N/m."""


@dataclass(eq=False, repr=False)
class HoistIntegral(ShortRepr):
    """A tracking controller whose hoist has an integrator besides; at the limit of the drive it
    integrates back only (anti-windup).

    It remembers: make a new one for each run. Asked again for the same time it answers without
    integrating again. An error counts for the time since the controller was last asked; at the
    first control instant, or where time restarts, for one control period.

    Attributes:
        crane: The crane, which must have a hoist.
        tracking: What it does without the integrator.
        integral_gain: k_i of the hoist [N/(m s)].
        limit: Largest hoist force [N].
        integral: What has been integrated so far [m s].
    """

    crane: Crane
    tracking: Tracking
    integral_gain: float
    limit: float
    integral: float = field(default=0.0)
    _t: float = field(default=-math.inf, init=False)
    _elapsed: float = field(init=False)
    _joint: int = field(init=False)
    _drive: int = field(init=False)

    def __post_init__(self) -> None:
        """Check the numbers. Until a run says otherwise, a call is expected for each row of the
        table.
        """
        number("integral gain of the hoist", self.integral_gain, "N/(m s)")
        number("integral of the hoist", self.integral, "m s")
        self._elapsed = self.tracking.period
        layout = self.crane.layout
        drive = layout.drive_of("hoist")
        if drive is None:
            drive = self.crane.winch
        if drive is None:
            # Refuses with the names of the joints.
            drive = layout.role("hoist", "An integrator on the hoist")
        self._drive = drive
        self._joint = int(layout.drives[drive])

    def begin_run(self, t: float, control_period: float) -> None:
        """See `cranedyn.clocks.Clocked`."""
        self._elapsed = control_period
        # The first error of the run counts for one control period.
        if t > self._t:
            self._t = t - control_period

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return efforts [N m or N], shape (m,)."""
        effort = self.tracking(t, state, setpoint)
        error = float(setpoint.position[self._drive] - state.q[self._joint])
        if t != self._t:
            self._integrate(t, error, float(effort[self._drive]))
        effort[self._drive] += self.integral_gain * self.integral
        return effort

    def _integrate(self, t: float, error: float, effort: float) -> None:
        """Count an error of the hoist for the time since the controller was last asked.

        Args:
            t: Time [s].
            error: Setpoint less position of the hoist [m].
            effort: Effort of the hoist without the integrator [N].
        """
        # At the first instant, or where time restarts, the time that was counted last counts again.
        # So does one that differs by the rounding of a clock only.
        since = t - self._t
        is_usual = math.isclose(since, self._elapsed, rel_tol=SAME_PERIOD)
        if 0.0 < since < math.inf and not is_usual:
            self._elapsed = since
        self._t = t

        # Anti-windup: at the limit an error counts only where it takes the command back.
        integral = self.integral + error * self._elapsed
        total = effort + self.integral_gain * integral
        if abs(total) <= self.limit or error * total < 0.0:
            self.integral = integral

    def affine(self, times: np.ndarray, positions: np.ndarray) -> Affine | None:
        """Return the affine form, see `cranedyn.controllers.affine`; None if the controller was
        called for the first of these times before.
        """
        if times[0] <= self._t:
            return None
        hoist = np.eye(self.crane.layout.m)[self._drive]
        return replace(
            self.tracking.affine(times, positions),
            target=positions,
            integral_gain=self.integral_gain * hoist,
            limit=np.where(hoist > 0.0, self.limit, math.inf),
            integral=self.integral * hoist,
        )

    def resume(self, t: float, integral: np.ndarray) -> None:
        """Continue from an integral, shape (m,), that includes a control instant [s]."""
        self.integral = float(integral[self._drive])
        self._t = t
