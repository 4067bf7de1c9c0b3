"""A controller for loads and cables that nobody told it: it is shown the crane that it was made
for, and what the real one needs besides is added to its command.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from cranedyn.checks import ShortRepr, check_choice, number, whole
from cranedyn.clocks import SAME_PERIOD
from cranedyn.controllers.load_filter import GYROSCOPE, LoadFilter, Sensors
from cranedyn.controllers.observer import initial_std_of
from cranedyn.controllers.sensed import noise_of
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import inverse_dynamics
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ROLES
from cranedyn.references.longer import longer
from cranedyn.references.motion import Motion, motion_efforts

CALM = {
    ("revolute", True): 2e-4,
    ("prismatic", True): 0.02,
    ("revolute", False): 3e-3,
    ("prismatic", False): 3e-3,
}
"""Standard deviations of accelerations that the model does not know [rad/s² or m/s²], as
`cranedyn.controllers.observer.DISTURBANCE`, ours: less, because the length of the cable is in how
fast the load swings, which can be seen only where little else moves it."""

LOAD_STD, CABLE_STD = 0.5, 0.1
"""What is not known at the start, ours: half of the load; a tenth of the cable, once as an offset
and once as a share of what is read."""


class Row(NamedTuple):
    """A motion at an instant: coordinates, rates and accelerations, shape (n,) each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class Family:
    """The same move on cables that are longer than planned by so much: three motions, and a
    parabola through them.

    Attributes:
        spread: By how much the cables of the outer two differ from the plan [m].
    """

    def __init__(self, motions: Sequence[Motion], spread: float, hoist: int) -> None:
        less, plan, more = (np.stack([m.q, m.v, m.a], axis=1) for m in motions)
        self.spread, self._hoist = spread, hoist
        first, second = (more - less) / (2.0 * spread), (more - 2.0 * plan + less) / (spread**2)
        # q, v and a as planned, their first and their second derivatives, a row for each
        self._table = np.concatenate([plan, first, second], axis=1)

    def planned(self, k: int) -> Row:
        """The motion as planned, at a row."""
        return Row(*self._at(k)[:3])

    def row(self, k: int, offset: float, share: float) -> Row:
        """The motion on a cable of l = (1 + share) reading + offset, at a row; by the chain rule
        where the length beyond the plan changes on the way.
        """
        table = self._at(k)
        length, rate, acceleration = (share * table[:3, self._hoist]).tolist()
        beyond = length + offset
        half, turned = beyond**2 / 2.0, acceleration * beyond + rate**2
        by_cable = [
            [1.0, 0.0, 0.0, beyond, 0.0, 0.0, half, 0.0, 0.0],
            [0.0, 1.0, 0.0, rate, beyond, 0.0, rate * beyond, half, 0.0],
            [0.0, 0.0, 1.0, acceleration, 2.0 * rate, beyond, turned, 2.0 * rate * beyond, half],
        ]
        return Row(*(by_cable @ table))

    def _at(self, k: int) -> np.ndarray:
        return self._table[min(k, len(self._table) - 1)]


@dataclass(eq=False, repr=False)
class Adapted(ShortRepr):
    """A controller behind a filter that estimates state, load and cable. It remembers: make a new
    one for each run.

    The controller is shown the state less what the motion on the cable believed in differs from
    the planned one, and to its command is added what the motion costs more with the load believed
    in, by inverse dynamics. So it may be any controller about the motion, made for the crane as
    planned.

    Attributes:
        controller: What it does with the crane it was made for.
        filter: What is known of state, load and cable.
        family: The motion on other cables.
        efforts: That the motion as planned costs, shape (rows, m).
        effort_limit: What the drives give at most [N m or N], shape (m,).
        period: Time between control instants [s].
        delay: How many control periods the measurements are late.
        estimate: The state as last estimated, None before the first call.
    """

    controller: Controller
    filter: LoadFilter
    family: Family
    efforts: np.ndarray
    effort_limit: np.ndarray
    period: float
    delay: int = 0
    estimate: State | None = field(default=None, init=False)
    _t: float = field(default=0.0, init=False)
    _since: deque[np.ndarray] = field(default_factory=deque, init=False)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """What the drives are commanded, shape (m,); of the state it looks at what is measured.

        Raises:
            CraneError: If it is not called once in each control period.
        """
        if self.estimate is None:
            self.filter.correct(state)
        else:
            self._expect(t)
            if len(self._since) > self.delay:
                self.filter.predict(self._since.popleft())
                self.filter.correct(state)
        now = self.filter.state
        for effort in self._since:
            now = self.filter.advanced(now, effort, self.period)
        self.estimate, self._t = now, t
        row = min(max(round(t / self.period), 0), len(self.efforts) - 1)
        planned, adapted = self.family.planned(row), self.family.row(row, *self.filter.cable)
        shown = State(now.q - adapted.q + planned.q, now.v - adapted.v + planned.v)
        command = np.asarray(self.controller(t, shown, setpoint), dtype=float)
        command = command + self._cost(adapted) - self.efforts[row]
        self._since.append(command.clip(-self.effort_limit, self.effort_limit))
        return command

    def _cost(self, row: Row) -> np.ndarray:
        """Efforts of the drives that a motion costs with the load believed in, shape (m,)."""
        crane = self.filter.crane
        joint = JointForces.of(crane).effort(row.q, row.v)
        needed = inverse_dynamics(crane.model, crane.data, *row, joint)
        return needed[crane.layout.drives]

    def _expect(self, t: float) -> None:
        if abs(t - self._t - self.period) > SAME_PERIOD * self.period:
            raise CraneError(
                f"This observer has seen t = {self._t:g} s and is asked for t = {t:g} s; it needs "
                f"a call every {self.period:g} s, and a new one for each run."
            )


def adapted(
    controller: Controller,
    crane: Crane,
    motion: Motion,
    *,
    motion_of: Callable[[float], Motion] | None = None,
    sensors: Sensors = "drives",
    load_std: float = LOAD_STD,
    cable_std: float = CABLE_STD,
    disturbance: Sequence[float] | np.ndarray | None = None,
    noise: Sequence[float] | np.ndarray | None = None,
    delay: int = 0,
    start: State | None = None,
) -> Adapted:
    """Let a controller made for one load and cable work with others that it does not know; one for
    each run.

    Args:
        controller: The controller, made for `crane` and `motion`; its command are efforts.
        crane: The crane as planned for; it must have a hoist.
        motion: The motion as planned; its period is the control period.
        motion_of: The same move on a cable that is longer by so much [m] at every reading of the
            hoist. None for `cranedyn.references.longer`; of a crane that is no tower crane for the
            planned one with all else as it is, which leaves it to the controller that the load
            then swings otherwise.
        sensors: What is measured: "drives", the encoders of the drives alone; "swing", besides
            them the angles of the swings; "imu", besides them the rates of a gyroscope on the
            load. An accelerometer there would say nothing of the swing: what a load on a rope
            feels is the pull of its rope, whatever the swing.
        load_std: Standard deviation of the load over the one planned.
        cable_std: The same of the cable over its length at the start, once as an offset and once
            as a share of what is read; 0 for a cable that is as it is read.
        disturbance: Standard deviations of the accelerations that the model does not know, shape
            (n,); None for `CALM`.
        noise: Standard deviations of coordinates [rad or m] and rates [per second] as measured,
            shape (2 n,); None for `cranedyn.controllers.sensed.noise_of`.
        delay: How many control periods the measurements are late.
        start: Where it is believed to start; None for where the motion is, the load plumb.

    Raises:
        MissingRole: If no joint is a hoist.
        OutOfRange: If a standard deviation or the delay is none, or a motion has other rows than
            planned.
    """
    check_choice("sensors", sensors, Sensors)
    late = whole("delay of the observer", delay, 0, "control periods")
    layout, hoist = crane.layout, crane.layout.role("hoist", "An observer of the load")
    motion.check_fits("motion", layout)
    n = layout.n
    length = float(motion.q[0, hoist])
    offset = number("cable_std", cable_std, "", ">= 0") * abs(length)
    share = offset / abs(length) if length else 0.0
    if disturbance is None:
        disturbance = [CALM[joint.kind, joint.driven] for joint in layout.joints]
    errors = _numbers("disturbance of the observer", disturbance, n, ">= 0")
    seen = _numbers(
        "noise of the observer", noise_of(crane) if noise is None else noise, 2 * n, "> 0"
    )
    begins = State(motion.q[0], motion.v[0]) if start is None else layout.as_state("start", start)
    covariance = np.diag(
        np.square([*initial_std_of(crane), number("load_std", load_std, "", ">= 0"), offset, share])
    )
    by_cable = np.array([1.0, length])
    unknown = covariance[-2:, -2:] @ by_cable
    covariance[hoist, hoist] += by_cable @ unknown
    covariance[hoist, -2:] = covariance[-2:, hoist] = unknown
    extra = crane.swings if sensors == "swing" else crane.swings[:0]
    measured = np.concatenate([layout.measured, extra])
    deviations = [*seen[measured], *([GYROSCOPE] * 3 if sensors == "imu" else [])]
    believed = LoadFilter(
        crane,
        motion.period,
        sensors,
        np.concatenate([*begins, [1.0, 0.0, 0.0]]),
        covariance,
        errors,
        np.diag(np.square(deviations)),
    )
    return Adapted(
        controller,
        believed,
        _family(crane, motion, motion_of, offset or 1.0),
        motion_efforts(crane, motion),
        crane.effort_limit,
        motion.period,
        late,
    )


def _family(
    crane: Crane, motion: Motion, motion_of: Callable[[float], Motion] | None, spread: float
) -> Family:
    hoist = crane.layout.role("hoist", "An observer of the load")

    def on_cable(by: float) -> Motion:
        if motion_of is not None:
            return motion_of(by)
        if {joint.role for joint in crane.layout.joints} == set(ROLES):
            return longer(crane, motion, by)
        q = motion.q.copy()
        q[:, hoist] += by
        return Motion(motion.period, q, motion.v, motion.a, motion.drives)

    outer = [on_cable(by) for by in (-spread, spread)]
    for other in outer:
        other.check_fits("motion on another cable", crane.layout)
        if other.q.shape != motion.q.shape or other.period != motion.period:
            raise OutOfRange(
                "motion on another cable",
                f"one of {len(other.q)} rows every {other.period:g} s",
                f"one of {len(motion.q)} rows every {motion.period:g} s, as planned",
            )
    return Family([outer[0], motion, outer[1]], spread, hoist)


def _numbers(
    name: str, given: Sequence[float] | np.ndarray, count: int, allowed: str
) -> np.ndarray:
    parts = np.asarray(given, dtype=object).ravel()
    if len(parts) != count:
        raise OutOfRange(name, given, f"{count} standard deviations")
    return np.array([number(name, part, allowed=allowed) for part in parts])
