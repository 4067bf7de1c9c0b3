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
from cranedyn.clocks import Clocked
from cranedyn.dynamics.equations_of_motion import inverse_dynamics
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.estimation.load_filter import GYROSCOPE, LoadFilter, Sensors
from cranedyn.estimation.observer import check_next_call, initial_std_of
from cranedyn.estimation.sensor_model import noise_of, standard_deviations
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.layout import ROLES
from cranedyn.references.motion import Motion, motion_efforts

SMALL_DISTURBANCE = {
    ("revolute", True): 2e-4,
    ("prismatic", True): 0.02,
    ("revolute", False): 3e-3,
    ("prismatic", False): 3e-3,
}
"""Standard deviations of accelerations that the model lacks [rad/s² or m/s²], by the keys of
`cranedyn.estimation.observer.DISTURBANCE`; ours. They are smaller: the length of the cable shows in
the frequency of the swing alone, which larger disturbances would hide."""

LOAD_STD = 0.5
"""Standard deviation of the load at the start, as a share of the planned load; ours."""

CABLE_STD = 0.1
"""Standard deviation of the cable at the start, as a share of its length, once as an offset and
once as a share of the reading; ours."""

_DIFFERENCE_STEP = 0.02
"""Step of the differences [s], at which truncation and rounding are alike for swings of seconds."""


class CableFamily:
    """The same move on cables of three lengths, and a parabola through the three motions.

    The parabola gives the motion on any cable near the planned one without planning it again.

    Attributes:
        spread: Difference of the outer two lengths from the planned one [m].
    """

    def __init__(
        self, shorter: Motion, planned: Motion, longer: Motion, spread: float, hoist: int
    ) -> None:
        """Lay the parabola.

        Args:
            shorter: The motion on a cable shorter by the spread.
            planned: The planned motion.
            longer: The motion on a cable longer by the spread.
            spread: Difference of the lengths [m].
            hoist: Index of the hoist among the coordinates.
        """
        self.spread = spread
        self._hoist = hoist
        below = _stacked(shorter)
        plan = _stacked(planned)
        above = _stacked(longer)
        # The derivatives by the length of the cable, from central differences.
        first = (above - below) / (2.0 * spread)
        second = (above - 2.0 * plan + below) / (spread**2)
        # Rows 0 to 2 hold q, v and a as planned, 3 to 5 their first derivatives, 6 to 8 their
        # second ones; shape (rows, 9, n).
        self._table = np.concatenate([plan, first, second], axis=1)

    def planned(self, k: int) -> np.ndarray:
        """Return q, v and a of the planned motion at a row, shape (3, n)."""
        return self._at(k)[:3]

    def row(self, k: int, offset: float, share: float) -> np.ndarray:
        """Return q, v and a on a cable of length (1 + share) reading + offset, at a row, shape (3,
        n); the chain rule covers a length that changes on the way.
        """
        # On a cable longer by d(t) the coordinates are q(t, d) = q + q' d + q'' d²/2, with q' and
        # q'' as functions of time. Differentiated once and twice by time:
        #   v + q' ḋ + v' d + q'' d ḋ + v'' d²/2
        #   a + q' d̈ + 2 v' ḋ + a' d + q'' (ḋ² + d d̈) + 2 v'' d ḋ + a'' d²/2
        table = self._at(k)
        share_of_length, d_rate, d_acceleration = (share * table[:3, self._hoist]).tolist()
        d = share_of_length + offset

        # d²/2 and its derivatives by time.
        half_square = d**2 / 2.0
        half_square_rate = d_rate * d
        half_square_acceleration = d_acceleration * d + d_rate**2

        # Factors of q, v and a, of their first and of their second derivatives by the length.
        position = [1.0, 0.0, 0.0]
        position += [d, 0.0, 0.0]
        position += [half_square, 0.0, 0.0]
        velocity = [0.0, 1.0, 0.0]
        velocity += [d_rate, d, 0.0]
        velocity += [half_square_rate, half_square, 0.0]
        acceleration = [0.0, 0.0, 1.0]
        acceleration += [d_acceleration, 2.0 * d_rate, d]
        acceleration += [half_square_acceleration, 2.0 * d_rate * d, half_square]
        return [position, velocity, acceleration] @ table

    def _at(self, k: int) -> np.ndarray:
        """Return the table at a row of the motion, shape (9, n); beyond its end the last row."""
        return self._table[min(k, len(self._table) - 1)]


def _stacked(motion: Motion) -> np.ndarray:
    """Return q, v and a of a motion, shape (rows, 3, n)."""
    return np.stack([motion.q, motion.v, motion.a], axis=1)


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
    # Efforts since the time of the last measurement.
    _commands: deque[np.ndarray] = field(default_factory=deque, init=False)

    def begin_run(self, t: float, control_period: float) -> None:
        """Begin the run of the controller, see `cranedyn.clocks.Clocked`."""
        if isinstance(self.controller, Clocked):
            self.controller.begin_run(t, control_period)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return commands of the drives [N m or N], shape (m,); only the measured part of the state
        is used.

        Raises:
            CraneError: If it is not called once in each control period.
        """
        if self.estimate is None:
            self.filter.correct(state)
        else:
            check_next_call(t, self._t, self.period)
            if len(self._commands) > self.delay:
                self.filter.step(self._commands.popleft(), state)
        # The filter stands at the time of the last measurement; the efforts since then take it to
        # the present.
        estimate = self.filter.state
        for effort in self._commands:
            estimate = self.filter.advanced(estimate, effort, self.period)
        self.estimate = estimate
        self._t = t
        row = min(max(round(t / self.period), 0), len(self.efforts) - 1)
        planned = self.family.planned(row)
        cable = self.filter.cable
        adapted = self.family.row(row, cable.offset, cable.share)
        equivalent = State(*(np.array(estimate) - adapted[:2] + planned[:2]))
        command = np.asarray(self.controller(t, equivalent, setpoint), dtype=float)
        command = command + self._motion_effort(adapted) - self.efforts[row]
        self._commands.append(command.clip(-self.effort_limit, self.effort_limit))
        return command

    def _motion_effort(self, row: np.ndarray) -> np.ndarray:
        """Return the drive efforts that coordinates, rates and accelerations, shape (3, n), need
        with the estimated load [N m or N], shape (m,).
        """
        crane = self.filter.crane
        q, v, a = row
        joint = JointForces.of(crane).effort(q, v)
        needed = inverse_dynamics(crane.model, crane.data, q, v, a, joint)
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
            for `SMALL_DISTURBANCE`.
        noise: Standard deviations of measured coordinates [rad or m] and rates [per second], shape
            (2 n,); None for `cranedyn.estimation.sensor_model.noise_of`.
        delay: Delay of the measurements [control periods].
        start: Expected start; None for the start of the motion, with the load plumb.

    Raises:
        MissingRole: If no joint is a hoist.
        OutOfRange: If a standard deviation or the delay is out of range.
    """
    check_choice("sensors", sensors, Sensors)
    delay = whole("delay of the observer", delay, 0, "control periods")
    layout = crane.layout
    hoist = layout.role("hoist", "An observer of the load")
    motion.check_fits("motion", layout)
    length = float(motion.q[0, hoist])
    offset_std = number("cable_std", cable_std, "", ">= 0") * abs(length)
    if disturbance is None:
        disturbance = [SMALL_DISTURBANCE[joint.kind, joint.driven] for joint in layout.joints]
    disturbance = standard_deviations("disturbance of the observer", disturbance, layout.n)
    noise_covariance = _noise_covariance(crane, sensors, noise)
    first = State(motion.q[0], motion.v[0]) if start is None else layout.as_state("start", start)
    load_filter = LoadFilter(
        crane,
        motion.period,
        sensors,
        # As planned: 1/load is 1, offset and share of the cable are 0.
        mean=np.concatenate([*first, [1.0, 0.0, 0.0]]),
        covariance=_initial_covariance(crane, length, load_std, offset_std),
        disturbance=disturbance,
        noise=noise_covariance,
    )
    return LoadEstimateController(
        controller=controller,
        filter=load_filter,
        family=_family(crane, motion, offset_std or 1.0),
        efforts=motion_efforts(crane, motion),
        effort_limit=crane.effort_limit,
        period=motion.period,
        delay=delay,
    )


def _noise_covariance(
    crane: Crane, sensors: Sensors, noise: Sequence[float] | np.ndarray | None
) -> np.ndarray:
    """Return the covariance of the measurements, shape (measured, measured): the drives, then the
    angles of the swings or the rates of a gyroscope, if there are such sensors.
    """
    if noise is None:
        noise = noise_of(crane)
    noise_std = standard_deviations("noise of the observer", noise, 2 * crane.layout.n, "> 0")
    swings = crane.swings if sensors == "swing" else crane.swings[:0]
    measured = np.concatenate([crane.layout.measured, swings])
    deviations = noise_std[measured].tolist()
    if sensors == "imu":
        deviations += [GYROSCOPE] * 3
    return np.diag(np.square(deviations))


def _initial_covariance(
    crane: Crane, length: float, load_std: float, offset_std: float
) -> np.ndarray:
    """Return the covariance of coordinates, rates, 1/load, offset and share of the cable at the
    start, shape (2 n + 3, 2 n + 3).

    Args:
        crane: The planned crane.
        length: Length of the cable that is read at the start [m].
        load_std: Standard deviation of the load over the planned one.
        offset_std: Standard deviation of the cable's offset [m]; that of its share is as many times
            less as the cable is long.
    """
    hoist = crane.layout.role("hoist", "An observer of the load")
    share_std = offset_std / abs(length) if length else 0.0
    load_std = number("load_std", load_std, "", ">= 0")
    deviations = [*initial_std_of(crane), load_std, offset_std, share_std]
    covariance = np.diag(np.square(deviations))

    # The reading is known, so that the cable l = reading + share reading + offset is as uncertain
    # as share and offset, and correlated with both.
    by_cable = np.array([1.0, length])
    with_cable = covariance[-2:, -2:] @ by_cable
    covariance[hoist, hoist] += by_cable @ with_cable
    covariance[hoist, -2:] = with_cable
    covariance[-2:, hoist] = with_cable
    return covariance


def _family(crane: Crane, motion: Motion, spread: float) -> CableFamily:
    """Return a motion and the same on cables shorter and longer by a spread [m].

    For a crane that is no tower crane only the hoist differs in them, and the controller has to
    damp the different swing.
    """
    hoist = crane.layout.role("hoist", "An observer of the load")
    is_tower_crane = {joint.role for joint in crane.layout.joints} == set(ROLES)

    def on_cable(by: float) -> Motion:
        """Return the motion on a cable longer by a length [m]."""
        if is_tower_crane:
            return with_longer_cable(crane, motion, by)
        q = motion.q.copy()
        q[:, hoist] += by
        return Motion(motion.period, q, motion.v, motion.a, motion.drives)

    return CableFamily(on_cable(-spread), motion, on_cable(spread), spread, hoist)


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

    def changes(q: np.ndarray) -> np.ndarray:
        """Return by how much coordinates change on the longer cable, shape (rows, n)."""
        result = np.zeros_like(q)
        result[:, columns] = _longer_cable_changes(q[:, columns], by)
        return result

    # Differences along q + s v + s² a/2 about each row need no neighbouring rows.
    step = _DIFFERENCE_STEP
    change = changes(motion.q)
    before = changes(motion.q - step * motion.v + step**2 / 2.0 * motion.a)
    after = changes(motion.q + step * motion.v + step**2 / 2.0 * motion.a)
    return Motion(
        motion.period,
        motion.q + change,
        motion.v + (after - before) / (2.0 * step),
        motion.a + (after - 2.0 * change + before) / step**2,
        motion.drives,
    )


def _longer_cable_changes(q: np.ndarray, by: float) -> np.ndarray:
    """Return the changes of γ, x, φ, θ, l [rad or m], shape (rows, 5), by which the payload hangs
    lower by `by` [m] on a rope of the same direction.

    The horizontal axes are those along the jib, outwards, and across it. The rope, from the payload
    up, has the components sin φ cos θ along, sin θ across, and cos φ cos θ up. The pivot keeps its
    height, so that the rope grows by `by` / up and the pivot moves by the horizontal part of that.
    Jib and trolley follow it, and the swing angles are those of the same rope seen from the turned
    jib.
    """
    gamma, x, phi, theta, _ = q.T
    outward_axis = np.stack([np.sin(gamma), -np.cos(gamma)], axis=1)
    across_axis = np.stack([np.cos(gamma), np.sin(gamma)], axis=1)
    outward = np.sin(phi) * np.cos(theta)
    across = np.sin(theta)
    up = np.cos(phi) * np.cos(theta)
    rope = outward[:, None] * outward_axis + across[:, None] * across_axis
    pivot = x[:, None] * outward_axis + (by / up)[:, None] * rope
    turn = np.arctan2((pivot * across_axis).sum(axis=1), (pivot * outward_axis).sum(axis=1))
    cosine = np.cos(turn)
    sine = np.sin(turn)
    return np.stack(
        [
            turn,
            np.hypot(*pivot.T) - x,
            np.arctan2(outward * cosine + across * sine, up) - phi,
            np.arcsin(across * cosine - outward * sine) - theta,
            by / up,
        ],
        axis=1,
    )
