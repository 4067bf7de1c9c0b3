"""Adaptation of a controller to unknown loads and cables.

The controller gets the state of the crane for which it was designed; the additional efforts that
the real crane needs are added to its command.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from cranedyn.checks import ShortRepr, check_choice, number, whole
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import inverse_dynamics
from cranedyn.estimation.load_filter import GYROSCOPE, LoadFilter, Sensors
from cranedyn.estimation.observer import check_next_call, initial_std_of
from cranedyn.estimation.sensor_model import noise_of, standard_deviations
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ROLES
from cranedyn.references.motion import Motion, motion_efforts

CALM = {
    ("revolute", True): 2e-4,
    ("prismatic", True): 0.02,
    ("revolute", False): 3e-3,
    ("prismatic", False): 3e-3,
}
"""Standard deviations of accelerations that the model lacks [rad/s² or m/s²], by the keys of
`cranedyn.estimation.observer.DISTURBANCE`; ours. They are smaller: the length of the cable shows in
the frequency of the swing alone, which larger disturbances would hide."""

LOAD_STD, CABLE_STD = 0.5, 0.1
"""Standard deviations at the start, ours: half of the load; a tenth of the cable, once as an offset
and once as a share of the reading."""

_ASIDE = 0.02
"""Step of the differences [s], at which truncation and rounding are alike for swings of seconds."""


class CableFamily:
    """The same move on cables of three lengths, and a parabola through the three motions.

    Attributes:
        spread: Difference of the outer two lengths from the planned one [m].
    """

    def __init__(self, motions: Sequence[Motion], spread: float, hoist: int) -> None:
        shorter, plan, longer = (np.stack([m.q, m.v, m.a], axis=1) for m in motions)
        self.spread, self._hoist = spread, hoist
        first = (longer - shorter) / (2.0 * spread)
        second = (longer - 2.0 * plan + shorter) / (spread**2)
        # q, v and a as planned, their first and their second derivatives, a row for each
        self._table = np.concatenate([plan, first, second], axis=1)

    def planned(self, k: int) -> np.ndarray:
        """Return q, v and a of the planned motion at a row, shape (3, n)."""
        return self._at(k)[:3]

    def row(self, k: int, offset: float, share: float) -> np.ndarray:
        """Return q, v and a on a cable of length (1 + share) reading + offset, at a row, shape (3,
        n); the chain rule covers a length that changes on the way.
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
        return by_cable @ table

    def _at(self, k: int) -> np.ndarray:
        return self._table[min(k, len(self._table) - 1)]


@dataclass(eq=False, repr=False)
class LoadEstimateController(ShortRepr):
    """A controller behind a filter that estimates state, load and cable. It remembers: make a new
    one for each run.

    From the estimated state is subtracted how the motion on the estimated cable differs from the
    planned one; the controller gets the result. To its command are added the efforts that the
    estimated load needs more, by inverse dynamics. So it may be any controller about the motion
    that was designed for the planned crane.

    Attributes:
        controller: The controller designed for the planned crane.
        filter: Estimate of state, load and cable.
        family: The motion on other cables.
        efforts: Efforts of the planned motion, shape (rows, m).
        effort_limit: Largest efforts of the drives [N m or N], shape (m,).
        period: Time between control instants [s].
        delay: Delay of the measurements [control periods].
        estimate: The last estimate of the state, None before the first call.
    """

    controller: Controller
    filter: LoadFilter
    family: CableFamily
    efforts: np.ndarray
    effort_limit: np.ndarray
    period: float
    delay: int = 0
    estimate: State | None = field(default=None, init=False)
    _t: float = field(default=0.0, init=False)
    _since: deque[np.ndarray] = field(default_factory=deque, init=False)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return commands of the drives, shape (m,); only the measured part of the state is used.

        Raises:
            CraneError: If it is not called once in each control period.
        """
        if self.estimate is None:
            self.filter.correct(state)
        else:
            check_next_call(t, self._t, self.period)
            if len(self._since) > self.delay:
                self.filter.step(self._since.popleft(), state)
        now = self.filter.state
        for effort in self._since:
            now = self.filter.advanced(now, effort, self.period)
        self.estimate, self._t = now, t
        row = min(max(round(t / self.period), 0), len(self.efforts) - 1)
        planned, adapted = self.family.planned(row), self.family.row(row, *self.filter.cable)
        equivalent = State(*(np.array(now) - adapted[:2] + planned[:2]))
        command = np.asarray(self.controller(t, equivalent, setpoint), dtype=float)
        command = command + self._cost(adapted) - self.efforts[row]
        self._since.append(command.clip(-self.effort_limit, self.effort_limit))
        return command

    def _cost(self, row: np.ndarray) -> np.ndarray:
        """Return the drive efforts that a motion costs with the estimated load, shape (m,)."""
        crane = self.filter.crane
        joint = JointForces.of(crane).effort(*row[:2])
        needed = inverse_dynamics(crane.model, crane.data, row[0], row[1], row[2], joint)
        return needed[crane.layout.drives]


def with_load_estimate(
    controller: Controller,
    crane: Crane,
    motion: Motion,
    *,
    sensors: Sensors = "drives",
    load_std: float = LOAD_STD,
    cable_std: float = CABLE_STD,
    disturbance: Sequence[float] | np.ndarray | None = None,
    noise: Sequence[float] | np.ndarray | None = None,
    delay: int = 0,
    start: State | None = None,
) -> LoadEstimateController:
    """Return a controller that adapts one made for another load and cable; make one for each run.

    Args:
        controller: The controller, designed for `crane` and `motion`; its commands are efforts.
        crane: The planned crane; it must have a hoist.
        motion: The planned motion; its period is the control period.
        sensors: "drives" for encoders of the drives alone; "swing" adds the angles of the swings;
            "imu" adds the rates of a gyroscope on the load. An accelerometer on the load would not
            measure the swing: it measures the pull of the rope, whatever the swing.
        load_std: Standard deviation of the load over the planned one.
        cable_std: Standard deviation of the cable over its length at the start, once as an offset
            and once as a share of the reading; 0 for a cable of exactly the length that is read.
        disturbance: Standard deviations of the accelerations that the model lacks, shape (n,); None
            for `CALM`.
        noise: Standard deviations of measured coordinates [rad or m] and rates [per second], shape
            (2 n,); None for `cranedyn.estimation.sensor_model.noise_of`.
        delay: Delay of the measurements [control periods].
        start: Expected start; None for the start of the motion, with the load plumb.

    Raises:
        MissingRole: If no joint is a hoist.
        OutOfRange: If a standard deviation or the delay is out of range.
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
    errors = standard_deviations("disturbance of the observer", disturbance, n)
    noise_std = standard_deviations(
        "noise of the observer", noise_of(crane) if noise is None else noise, 2 * n, "> 0"
    )
    covariance = np.diag(
        np.square([*initial_std_of(crane), number("load_std", load_std, "", ">= 0"), offset, share])
    )
    by_cable = np.array([1.0, length])
    unknown = covariance[-2:, -2:] @ by_cable
    covariance[hoist, hoist] += by_cable @ unknown
    covariance[hoist, -2:] = covariance[-2:, hoist] = unknown
    extra = crane.swings if sensors == "swing" else crane.swings[:0]
    measured = np.concatenate([layout.measured, extra])
    deviations = [*noise_std[measured], *([GYROSCOPE] * 3 if sensors == "imu" else [])]
    begins = State(motion.q[0], motion.v[0]) if start is None else layout.as_state("start", start)
    mean = np.concatenate([*begins, [1.0, 0.0, 0.0]])
    spread = np.diag(np.square(deviations))
    believed = LoadFilter(crane, motion.period, sensors, mean, covariance, errors, spread)
    family, efforts = _family(crane, motion, offset or 1.0), motion_efforts(crane, motion)
    return LoadEstimateController(
        controller, believed, family, efforts, crane.effort_limit, motion.period, late
    )


def _family(crane: Crane, motion: Motion, spread: float) -> CableFamily:
    """Return the motion on a cable shorter and longer by a spread [m]; for a crane that is no tower
    crane the hoist alone differs, and the controller answers for the different swing.
    """
    hoist = crane.layout.role("hoist", "An observer of the load")

    def on_cable(by: float) -> Motion:
        if {joint.role for joint in crane.layout.joints} == set(ROLES):
            return with_longer_cable(crane, motion, by)
        q = motion.q.copy()
        q[:, hoist] += by
        return Motion(motion.period, q, motion.v, motion.a, motion.drives)

    return CableFamily([on_cable(-spread), motion, on_cable(spread)], spread, hoist)


def with_longer_cable(crane: Crane, motion: Motion, by: float) -> Motion:
    """Return a motion of a tower crane whose payload follows the same path lower down, on a longer
    cable.

    The rope points along p̈ + g ẑ (see `cranedyn.references.flat`), which a constant drop of the
    payload does not change: the swing in the world stays the same, and the pivot moves out along
    the rope. The share I/(m l²) of rotational inertia is neglected.

    Args:
        crane: A tower crane.
        motion: The motion.
        by: Additional length of the cable at rest [m].

    Raises:
        MissingRole: If it is not a tower crane.
        OutOfRange: If `by` is not finite, or makes the cable shorter than nothing.
    """
    slew, trolley, radial, tangential, hoist = crane.layout.tower("A motion on another cable")
    motion.check_fits("motion", crane.layout)
    shortest = float(motion.q[:, hoist].min()) + number("by", by, "m")
    number("length of the shortest cable", shortest, "m", "> 0")
    columns = [slew, trolley, radial, tangential, hoist]

    def beyond(q: np.ndarray) -> np.ndarray:
        changes = np.zeros_like(q)
        changes[:, columns] = _beyond(q[:, columns], by)
        return changes

    # Differences along q + s v + s² a/2 about each row need no neighbouring rows.
    change, change_before, change_after = (
        beyond(motion.q + s * motion.v + s**2 / 2.0 * motion.a) for s in (0.0, -_ASIDE, _ASIDE)
    )
    return Motion(
        motion.period,
        motion.q + change,
        motion.v + (change_after - change_before) / (2.0 * _ASIDE),
        motion.a + (change_after - 2.0 * change + change_before) / _ASIDE**2,
        motion.drives,
    )


def _beyond(q: np.ndarray, by: float) -> np.ndarray:
    """Return the changes of γ, x, φ, θ, l [rad or m], shape (rows, 5)."""
    gamma, x, phi, theta, _ = q.T
    along = np.stack([np.sin(gamma), -np.cos(gamma)], axis=1)
    across = np.stack([np.cos(gamma), np.sin(gamma)], axis=1)
    outward, sideward, up = np.sin(phi) * np.cos(theta), np.sin(theta), np.cos(phi) * np.cos(theta)
    rope = outward[:, None] * along + sideward[:, None] * across
    pivot = x[:, None] * along + (by / up)[:, None] * rope
    turned = np.arctan2((pivot * across).sum(axis=1), (pivot * along).sum(axis=1))
    cosine, sine = np.cos(turned), np.sin(turned)
    return np.stack(
        [
            turned,
            np.hypot(*pivot.T) - x,
            np.arctan2(outward * cosine + sideward * sine, up) - phi,
            np.arcsin(sideward * cosine - outward * sine) - theta,
            by / up,
        ],
        axis=1,
    )
