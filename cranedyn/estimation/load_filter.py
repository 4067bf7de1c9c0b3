"""An extended Kalman filter for the state of a crane, the mass of its load, and the difference of
its cable from the reading of the hoist's encoder.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from typing import Literal

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import by_state_and_force, full
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

LIGHTEST, HEAVIEST = 0.02, 50.0
"""Range of the load over the planned load, to which the estimate is cut."""

_DRIFT = np.array([1e-3, 1e-3, 1e-5])
"""Random walk of inverse load, cable offset [m] and cable share, per square root of a second; ours.
It keeps their gains above zero."""


class LoadFilter:
    """The filter. Its unknowns are stacked as w = (coordinates, rates, 1/load, offset, share),
    shape (2 n + 3,).

    The mass of the load is `load` times the planned one; its inverse is estimated, because the
    acceleration that an effort of the hoist causes is linear in it, so that one step corrects a
    wrong estimate (Newton: l̈ = F/m + g). The cable is l = (1 + share) reading +
    offset. The mean is predicted by RK4 on the full model, the covariance by its derivatives
    (Jazwinski 1970, Stochastic Processes and Filtering Theory, §8.3), and kept in Joseph's form.
    Both are written for any kind of number, see `cranedyn.compiled.load_filter`.

    Attributes:
        source: Planned crane, period, sensors, disturbance and noise.
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
        import_module("scipy.linalg.lapack")  # takes tenths of a second, which no period has
        crane.require_independent_joints("An observer of the load")
        self.source = crane, period, sensors, disturbance, noise
        self.crane = replace(crane, model=crane.model.copy())
        self.mean, self.covariance, self.sensors = mean, covariance, sensors
        self._period, self._noise = period, noise
        self._n, self._joint = crane.layout.n, JointForces.of(crane)
        self._data = self.crane.model.createData()
        self._hoist = crane.layout.role("hoist", "An observer of the load")
        self._body = crane.payload.body + 1
        self._load = self.crane.model.inertias[self._body]  # a view into the model
        self._planned = self._load.mass
        alone = pin.Inertia(self._planned, self._load.lever, np.zeros((3, 3)))
        self._alone = alone.toDynamicParameters()  # of the planned load as a point
        n = self._n
        self._identity = np.eye(2 * n + 3)
        self._added = np.zeros((2 * n + 3, 2 * n + 3))
        self._added[: 2 * n, : 2 * n] = process_noise(disturbance, period)
        self._added[2 * n :, 2 * n :] = np.diag(_DRIFT) ** 2 * period
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
        return float(1.0 / self.mean[-3])

    @property
    def cable(self) -> tuple[float, float]:
        """Offset [m] and share of l = (1 + share) reading + offset."""
        return float(self.mean[-2]), float(self.mean[-1])

    def step(self, effort: np.ndarray, reading: State) -> None:
        """Predict as `predict`, then correct as `correct`."""
        self.predict(effort)
        self.correct(reading)

    def predict(self, effort: np.ndarray) -> None:
        """Predict mean and covariance over one control period under efforts of the drives [N m or
        N], shape (m,).
        """
        n, h = self._n, self._period
        before, step = self.state, 0.0 * self._identity
        by_state, by_load = self._linearised(before, effort)
        step[:n, n : 2 * n] = h * self._identity[:n, :n]
        step[n : 2 * n, : 2 * n] = h * by_state
        step[n : 2 * n, -3] = h * by_load
        over = self._identity + step + step @ step / 2.0
        self.mean = np.concatenate([*self.advanced(before, effort, h), self.mean[-3:]])
        self.covariance = over @ self.covariance @ over.T + self._added

    def advanced(self, state: State, effort: np.ndarray, time: float) -> State:
        """Return the state after a time [s] under efforts, by one step of RK4 with the estimated
        load.
        """
        tau = full(self.crane, effort)

        def acceleration(q: np.ndarray, u: np.ndarray) -> np.ndarray:
            v = u / time
            return time * time * self._acceleration(q, v, tau + self._joint.effort(q, v))

        q, u = rk4.rule(acceleration, np.add, np.add, state.q, time * state.v, 1)
        return State(q, u / time)

    def correct(self, reading: State) -> None:
        """Correct mean and covariance by a reading; only the measured part of it is used."""
        expected, by = self._expected(self.mean)
        innovation = self._measured(reading) - expected
        cross = by @ self.covariance
        gain = kalman_gain(cross, cross @ by.T + self._noise)
        self.mean = self.mean + gain @ innovation
        self.mean[-3] = clipped(self.mean[-3], 1.0 / HEAVIEST, 1.0 / LIGHTEST)
        self.covariance = corrected_covariance(self.covariance, by, gain, self._noise)
        self._believe()

    def _measured(self, reading: State) -> np.ndarray:
        direct = np.concatenate(reading)[self._direct]
        rates = self._turning(reading)[0] if self.sensors == "imu" else direct[:0]
        return np.concatenate([direct, rates])

    def _expected(self, mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the expected measurements and their derivatives by w."""
        n, hoist = self._n, self._hoist
        offset, scale = mean[-2], 1.0 + mean[-1]
        values, by = mean[: 2 * n].copy(), self._identity[: 2 * n].copy()
        values[hoist] -= offset
        by[hoist, -2] = -1.0
        read = slice(hoist, None, n)  # position of the hoist, and its rate n further on
        values[read] /= scale
        by[read] /= scale
        by[read, -1] = -values[read] / scale
        if self.sensors != "imu":
            return values[self._direct], by[self._direct]
        rates, slopes = self._turning(State(*mean[: 2 * n].reshape(2, -1)))
        turning = np.hstack([slopes, self._identity[:3, 2 * n :]])
        return np.concatenate([values[self._direct], rates]), np.vstack([by[self._direct], turning])

    def _acceleration(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the accelerations under generalized forces with the estimated load."""
        return pin.aba(self.crane.model, self._data, q, v, tau)

    def _linearised(self, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the accelerations by the state, shape (n, 2 n), and by 1/load,
        shape (n,). The force of the load alone is linear in its mass.
        """
        by_state, inverse_mass = by_state_and_force(self.crane, state, effort)
        crane, columns = self.crane, slice(10 * self._body - 10, 10 * self._body)
        regressor = pin.computeJointTorqueRegressor(crane.model, self._data, *state, crane.data.ddq)
        cost = regressor[:, columns] @ self._alone
        if (falls := crane.springs.bifilar) is not None:
            pull = self._planned * crane.gravity * (0.5 * falls.spacing) ** 2
            none = np.zeros(self._n)
            cost -= Springs(none, none, bifilar=falls._replace(stiffness=pull)).effort(state.q)
        return by_state, inverse_mass @ cost / self.mean[-3] ** 2

    def _turning(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates at a gyroscope on the load in its frame [rad/s], shape (3,), and their
        derivatives by the state, shape (3, 2 n).
        """
        model, data = self.crane.model, self._data
        pin.computeForwardKinematicsDerivatives(model, data, *state, np.zeros(self._n))
        frame = pin.ReferenceFrame.LOCAL
        by_q, by_v = pin.getJointVelocityDerivatives(model, data, self._body, frame)
        return np.array(data.v[self._body].angular), np.hstack([by_q[3:], by_v[3:]])

    def _believe(self) -> None:
        """Set the load of the crane to that of the mean; its rotational inertia stays."""
        self._load.mass = self._planned / self.mean[-3]
        if self.crane.springs.bifilar is not None:
            self.crane = replace(self.crane)  # two falls carry the new load
            self._joint = JointForces.of(self.crane)
