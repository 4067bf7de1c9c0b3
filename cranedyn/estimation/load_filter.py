"""An extended Kalman filter for the state of a crane, the mass of its load, and the difference of
its cable from the reading of the hoist's encoder.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.equations_of_motion import by_state_and_force, over_all_joints
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.scalars import clipped
from cranedyn.estimation.observer import corrected_covariance, kalman_gain, process_noise
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.springs import Springs

Sensors = Literal["drives", "swing", "imu"]
"""Sensors: encoders of the drives alone; with the angles of the swings; or with the rates of a
gyroscope on the load."""

GYROSCOPE = 3e-3
"""Standard deviation of a gyroscope on the load [rad/s], that of the rate of a swing in
`cranedyn.estimation.sensor_model`."""

MIN_LOAD_RATIO = 0.02
"""Least estimate of the load over the planned load; a smaller one is cut to it."""

MAX_LOAD_RATIO = 50.0
"""Largest estimate of the load over the planned load; a larger one is cut to it."""

_DRIFT = np.array([1e-3, 1e-3, 1e-5])
"""Random walk of inverse load, cable offset [m] and cable share, per square root of a second; ours.
It keeps their gains above zero."""

# Where the last three unknowns stand in w.
_INVERSE_LOAD = -3
_OFFSET = -2
_SHARE = -1


class CableError(NamedTuple):
    """By how much the length of a cable differs from its reading: l = (1 + share) reading + offset.

    Attributes:
        offset: Offset [m].
        share: Share of the reading.
    """

    offset: float
    share: float


class FilterSource(NamedTuple):
    """What a filter was made from, besides its first mean and covariance.

    Attributes:
        crane: The planned crane.
        period: Time between control instants [s].
        sensors: The sensors.
        disturbance: Standard deviations of the accelerations that the model lacks [rad/s² or
            m/s²], shape (n,).
        noise: Covariance of the measurements, shape (measured, measured).
    """

    crane: Crane
    period: float
    sensors: Sensors
    disturbance: np.ndarray
    noise: np.ndarray


class LoadFilter:
    """The filter. Its unknowns are stacked as w = (coordinates, rates, 1/load, offset, share),
    shape (2 n + 3,).

    The mass of the load is `load` times the planned one; its inverse is estimated, because the
    acceleration that an effort of the hoist causes is linear in it, so that one step corrects a
    wrong estimate (Newton: l̈ = F/m + g). The cable is l = (1 + share) reading +
    offset. The mean is predicted by RK4 on the full model, the covariance by its derivatives
    (Jazwinski 1970, Stochastic Processes and Filtering Theory, §8.3), and kept in Joseph's form.
    Both are written for any kind of number, see `cranedyn.compiled.load_filter_code`.

    Attributes:
        source: What the filter was made from.
        crane: The crane with the estimated load.
        mean: Estimate of w, shape (2 n + 3,).
        covariance: Covariance of its error, shape (2 n + 3, 2 n + 3).
        sensors: The sensors.
    """

    def __init__(
        self,
        crane: Crane,
        period: float,
        sensors: Sensors,
        mean: np.ndarray,
        covariance: np.ndarray,
        disturbance: np.ndarray,
        noise: np.ndarray,
    ) -> None:
        """Make a filter with a first estimate.

        Args:
            crane: The planned crane.
            period: Time between control instants [s].
            sensors: The sensors.
            mean: First estimate of w, shape (2 n + 3,).
            covariance: Covariance of its error, shape (2 n + 3, 2 n + 3).
            disturbance: See `FilterSource`.
            noise: See `FilterSource`.
        """
        # The import takes tenths of a second, which no control period has: so it is done here.
        import_module("scipy.linalg.lapack")
        crane.require_independent_joints("An observer of the load")
        self.source = FilterSource(crane, period, sensors, disturbance, noise)
        self.crane = replace(crane, model=crane.model.copy())
        self.mean = mean
        self.covariance = covariance
        self.sensors = sensors
        self._period = period
        self._noise = noise
        self._n = crane.layout.n
        self._joint = JointForces.of(crane)
        self._data = self.crane.model.createData()
        self._hoist = crane.layout.role("hoist", "An observer of the load")
        self._body = crane.payload.body + 1
        # A view into the model: to set its mass is to set that of the crane.
        self._load = self.crane.model.inertias[self._body]
        self._planned = self._load.mass
        # The ten inertial parameters of the planned load as a point. Its rotational inertia is not
        # scaled with the mass, so that it must not appear in the derivative by the load.
        point_load = pin.Inertia(self._planned, self._load.lever, np.zeros((3, 3)))
        self._point_load = point_load.toDynamicParameters()
        self._identity = np.eye(2 * self._n + 3)
        self._added = _added_covariance(disturbance, period)
        swings = crane.swings if sensors == "swing" else crane.swings[:0]
        self._direct = np.concatenate([crane.layout.measured, swings])
        self._believe()

    @property
    def state(self) -> State:
        """Coordinates and rates, shape (n,) each, with the length of the cable, not its reading."""
        return State(*self.mean[: 2 * self._n].reshape(2, -1).copy())

    @property
    def load(self) -> float:
        """Mass of the load over the planned one."""
        return float(1.0 / self.mean[_INVERSE_LOAD])

    @property
    def cable(self) -> CableError:
        """By how much the cable differs from its reading."""
        return CableError(float(self.mean[_OFFSET]), float(self.mean[_SHARE]))

    def step(self, effort: np.ndarray, reading: State) -> None:
        """Predict one control period under efforts [N m or N], shape (m,), then correct by the
        reading at its end.
        """
        self.predict(effort)
        self.correct(reading)

    def predict(self, effort: np.ndarray) -> None:
        """Predict mean and covariance over one control period under efforts of the drives [N m or
        N], shape (m,).
        """
        n = self._n
        h = self._period
        before = self.state
        by_state, by_load = self._linearised(before, effort)

        # The error e of w moves by ė = F e. Its blocks: the coordinates move with the rates, the
        # rates with the derivatives of the accelerations, the last three unknowns stay. Over one
        # period exp(h F) ≈ I + h F + (h F)²/2.
        step = 0.0 * self._identity
        step[:n, n : 2 * n] = h * self._identity[:n, :n]
        step[n : 2 * n, : 2 * n] = h * by_state
        step[n : 2 * n, _INVERSE_LOAD] = h * by_load
        transition = self._identity + step + step @ step / 2.0
        self.mean = np.concatenate([*self.advanced(before, effort, h), self.mean[_INVERSE_LOAD:]])
        self.covariance = transition @ self.covariance @ transition.T + self._added

    def advanced(self, state: State, effort: np.ndarray, time: float) -> State:
        """Return the state after a time [s] under efforts [N m or N], shape (m,), by one step of
        RK4 with the estimated load.
        """
        tau = over_all_joints(self.crane, effort)

        # The rule works in units of its step: rates u = time v, accelerations time² a.
        def acceleration(q: np.ndarray, u: np.ndarray) -> np.ndarray:
            v = u / time
            return time * time * self._acceleration(q, v, tau + self._joint.effort(q, v))

        q, u = rk4.rule(acceleration, np.add, np.add, state.q, time * state.v, 1)
        return State(q, u / time)

    def correct(self, reading: State) -> None:
        """Correct mean and covariance by a reading; only the measured part of it is used."""
        expected, slopes = self._expected(self.mean)
        innovation = self._measured(reading) - expected
        cross = slopes @ self.covariance
        gain = kalman_gain(cross, cross @ slopes.T + self._noise)
        self.mean = self.mean + gain @ innovation
        self.mean[_INVERSE_LOAD] = clipped(
            self.mean[_INVERSE_LOAD], 1.0 / MAX_LOAD_RATIO, 1.0 / MIN_LOAD_RATIO
        )
        self.covariance = corrected_covariance(self.covariance, slopes, gain, self._noise)
        self._believe()

    def _measured(self, reading: State) -> np.ndarray:
        """Return what the sensors measure of a reading: coordinates and rates of the drives,
        angles of the swings, rates at the gyroscope, as far as there are such sensors.
        """
        direct = np.concatenate(reading)[self._direct]
        rates = self._turning(reading)[0] if self.sensors == "imu" else direct[:0]
        return np.concatenate([direct, rates])

    def _expected(self, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the expected measurements, shape (measured,), and their derivatives by w, shape
        (measured, 2 n + 3).
        """
        n = self._n
        hoist = self._hoist
        offset = mean[_OFFSET]
        scale = 1.0 + mean[_SHARE]
        values = mean[: 2 * n].copy()
        slopes = self._identity[: 2 * n].copy()

        # The encoder of the hoist reads (l - offset) / scale, and the rate l̇ / scale. The
        # derivative of either by the scale is minus the reading over the scale.
        values[hoist] -= offset
        slopes[hoist, _OFFSET] = -1.0
        encoder = slice(hoist, None, n)  # position of the hoist, and its rate n further on
        values[encoder] /= scale
        slopes[encoder] /= scale
        slopes[encoder, _SHARE] = -values[encoder] / scale
        if self.sensors != "imu":
            return values[self._direct], slopes[self._direct]
        state = State(*mean[: 2 * n].reshape(2, -1))
        gyroscope, gyroscope_by_state = self._turning(state)
        # Neither load nor cable changes how a rate of the load is measured.
        gyroscope_slopes = np.hstack([gyroscope_by_state, self._identity[:3, 2 * n :]])
        return (
            np.concatenate([values[self._direct], gyroscope]),
            np.vstack([slopes[self._direct], gyroscope_slopes]),
        )

    def _acceleration(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the accelerations under generalized forces with the estimated load."""
        return pin.aba(self.crane.model, self._data, q, v, tau)

    def _linearised(self, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the accelerations by the state, shape (n, 2 n), and by 1/load,
        shape (n,).

        With M a = τ - b the derivative by the load μ is -M⁻¹ times that of M a + b at constant a.
        This is linear in the mass of the load, so that its derivative is what the planned load
        alone costs at these accelerations; dμ/d(1/μ) = -μ² makes it one by 1/μ.
        """
        by_state, inverse_mass = by_state_and_force(self.crane, state, effort)
        crane = self.crane
        parameters = slice(10 * self._body - 10, 10 * self._body)  # of the load, ten for each body
        regressor = pin.computeJointTorqueRegressor(crane.model, self._data, *state, crane.data.ddq)
        cost = regressor[:, parameters] @ self._point_load
        falls = crane.springs.bifilar
        if falls is not None:
            # Two falls twist back by the weight that they carry, which is linear in the load, too.
            pull = self._planned * crane.gravity * (0.5 * falls.spacing) ** 2
            none = np.zeros(self._n)
            cost -= Springs(none, none, bifilar=falls._replace(stiffness=pull)).effort(state.q)
        return by_state, inverse_mass @ cost / self.mean[_INVERSE_LOAD] ** 2

    def _turning(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the angular velocity of the load in its own frame, which a gyroscope measures
        [rad/s], shape (3,), and its derivatives by the state, shape (3, 2 n).
        """
        model = self.crane.model
        data = self._data
        pin.computeForwardKinematicsDerivatives(model, data, *state, np.zeros(self._n))
        frame = pin.ReferenceFrame.LOCAL
        by_q, by_v = pin.getJointVelocityDerivatives(model, data, self._body, frame)
        return np.array(data.v[self._body].angular), np.hstack([by_q[3:], by_v[3:]])

    def _believe(self) -> None:
        """Give the load of the crane the mass that is estimated; its rotational inertia stays."""
        self._load.mass = self._planned / self.mean[_INVERSE_LOAD]
        if self.crane.springs.bifilar is not None:
            # The stiffness of two falls follows from the weight that they carry: a copy of the
            # crane computes it again.
            self.crane = replace(self.crane)
            self._joint = JointForces.of(self.crane)


def _added_covariance(disturbance: np.ndarray, period: float) -> np.ndarray:
    """Return the covariance that one control period [s] adds, shape (2 n + 3, 2 n + 3): that of the
    accelerations that the model lacks, and the random walk `_DRIFT` of load and cable.
    """
    states = 2 * len(disturbance)
    added = np.zeros((states + 3, states + 3))
    added[:states, :states] = process_noise(disturbance, period)
    added[states:, states:] = np.diag(_DRIFT) ** 2 * period
    return added
