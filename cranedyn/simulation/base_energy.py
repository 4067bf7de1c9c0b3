"""Energy of a crane on a base that moves, and the work that the base does on it.

Energy is that in the world: a crane that stands still on a ship that heaves has kinetic energy, and
its potential energy changes. The base does the work for that. With the total force F and the torque
T about the origin of the base by which it acts on the crane, and on a load that stands on its deck,
the power is F·ṙ + T·ω, with the velocity ṙ of the origin and the angular velocity ω.

Force and torque are not taken from the dynamics, which they are to check, but from the balance of
momentum: of the momentum p and the angular momentum L of the crane about the origin O of the world,

    ṗ = F + m g + Σ f,        L̇ = T_O + c × m g + Σ r × f,

with the mass m, the centre of mass c, and the external forces f at the points r. From row to row,
the changes of p and L less what gravity and the external forces do are the impulses of the base.
These times the mean velocity of the base, as of a body at O, are its work. Like all work in the
ledger, it has an error of the order of the squared control period.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import pinocchio as pin

from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.root_motion import floating_model
from cranedyn.simulation.run_spec import RunSpec


class RowsOnBase:
    """Rows of a run whose base moves.

    Semi-implicit Euler steps coordinates ahead of the rates, see `RunSpec.position_lead`. Momenta
    and work are those at the times of the rates.
    """

    def __init__(
        self, spec: RunSpec, t: np.ndarray, q: np.ndarray, v: np.ndarray, force: np.ndarray
    ) -> None:
        """Keep the rows.

        Args:
            spec: The run.
            t: Times [s], shape (rows,).
            q: Coordinates, shape (rows, n).
            v: Rates, shape (rows, n).
            force: External forces on the points in the world [N], shape (rows, 3 points).
        """
        assert spec.base is not None
        self._spec = spec
        self._q = q
        self._v = v
        self._force = force.reshape(len(t), -1, 3)
        self._model = floating_model(spec.crane.model)
        self._model.gravity = spec.crane.model.gravity
        self._data = self._model.createData()
        self._base = spec.base
        self._t = t
        lead = spec.position_lead
        self._rate_times = np.maximum(t - lead, self._base.first)
        self._frames_of_rates = self._base.frames(self._rate_times)
        self._synchronous_q = q - lead * v

    def energy(self) -> np.ndarray:
        """Return kinetic and potential energy in the world [J], shape (rows,), without springs."""
        frames = self._base.frames(self._t)
        energy = np.zeros(len(self._t))
        for row in range(len(self._t)):
            q = self._floating_q(frames.rotation[row], frames.origin[row], self._q[row])
            v = self._floating_v(row)
            energy[row] = pin.computeMechanicalEnergy(self._model, self._data, q, v)
        return energy

    def force_work(self) -> np.ndarray:
        """Return the work of the external forces since the start [J], shape (rows,).

        A force is held in the axes of the base for a control period, so that half-way through it
        has turned as the base has.
        """
        if len(self._t) < 2:
            return np.zeros(len(self._t))
        steps = np.diff(self._points, axis=0)
        middle = 0.5 * (self._t[:-1] + self._t[1:])
        at_row = self._base.frames(self._t[:-1]).rotation
        at_middle = self._base.frames(middle).rotation
        in_base_axes = np.einsum("kij,kpi->kpj", at_row, self._force[:-1])
        half_way = np.einsum("kij,kpj->kpi", at_middle, in_base_axes)
        return _sums((half_way * steps).sum(axis=(1, 2)))

    def base_work(self) -> np.ndarray:
        """Return the work of the base since the start [J], shape (rows,)."""
        if len(self._t) < 2:
            return np.zeros(len(self._t))
        period = self._spec.clocks.period
        momentum, angular_momentum, centre = self._momenta()
        weight = self._data.mass[0] * self._model.gravity.linear
        outside_force = self._force.sum(axis=1)
        points = self._points
        outside_torque = np.cross(_means(points), self._force[:-1]).sum(axis=1)
        weight_torque = np.cross(_means(centre), weight)

        impulse = np.diff(momentum, axis=0) - period * (weight + outside_force[:-1])
        angular_impulse = np.diff(angular_momentum, axis=0) - period * (
            weight_torque + outside_torque
        )

        frames = self._frames_of_rates
        omega = np.einsum("kij,kj->ki", frames.rotation, frames.omega)
        # Velocity of the point of the base that is at the origin of the world.
        velocity = frames.velocity - np.cross(omega, frames.origin)
        work = _means(velocity) * impulse + _means(omega) * angular_impulse
        return _sums(work.sum(axis=1))

    def _momenta(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the momentum [kg m/s], the angular momentum about the origin of the world
        [kg m²/s] and the centre of mass [m], in the world, shape (rows, 3) each.
        """
        rows = len(self._t)
        momentum = np.zeros((rows, 3))
        angular_momentum = np.zeros((rows, 3))
        centre = np.zeros((rows, 3))
        frames = self._frames_of_rates
        for row in range(rows):
            rotation = frames.rotation[row]
            q = self._floating_q(rotation, frames.origin[row], self._synchronous_q[row])
            about_centre = pin.computeCentroidalMomentum(
                self._model, self._data, q, self._floating_v(row)
            )
            momentum[row] = about_centre.linear
            centre[row] = self._data.com[0]
            angular_momentum[row] = about_centre.angular
        # At once: the cross product of a single row takes as long as that of hundreds.
        angular_momentum += np.cross(centre, momentum)
        return momentum, angular_momentum, centre

    def _floating_q(self, rotation: np.ndarray, origin: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return position and attitude of the base, then the coordinates of the crane."""
        return np.concatenate([origin, pin.Quaternion(rotation).coeffs(), q])

    def _floating_v(self, row: int) -> np.ndarray:
        """Return velocity and angular velocity of the base in its axes, then the rates."""
        frames = self._frames_of_rates
        velocity = frames.rotation[row].T @ frames.velocity[row]
        return np.concatenate([velocity, frames.omega[row], self._v[row]])

    @cached_property
    def _points(self) -> np.ndarray:
        """Points of the crane in the world at the times of the rates [m], shape (rows, points,
        3).
        """
        relative = point_paths(self._spec.crane, self._synchronous_q)
        return self._frames_of_rates.points_in_world(relative)


def _means(values: np.ndarray) -> np.ndarray:
    """Return the mean of each row and the next one."""
    return 0.5 * (values[:-1] + values[1:])


def _sums(increments: np.ndarray) -> np.ndarray:
    """Return 0 and the sums of the first 1, 2, ... increments."""
    return np.concatenate([[0.0], np.cumsum(increments)])
