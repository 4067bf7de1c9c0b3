"""Compiled load filter: prediction and correction of a control period in one call.

The step of `cranedyn.estimation.load_filter.LoadFilter` runs once with values of the code in place
of numbers (`_TracedFilter`), and what it computes becomes machine code.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.horizon.dual import constants, slopes, variables
from cranedyn.compiled.plant import rigid_body
from cranedyn.compiled.plant.forward_dynamics import tree_forward_dynamics
from cranedyn.compiled.plant.plant import Topology, plant_numbers
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.bodies import Bodies, bodies_of_crane
from cranedyn.dynamics.equations_of_motion import over_all_joints
from cranedyn.dynamics.scalars import array, solve_linear
from cranedyn.errors import CraneError
from cranedyn.estimation.load_estimate import LoadEstimateController
from cranedyn.estimation.load_filter import FilterSource, LoadFilter, Sensors
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

_MAX_CACHED_STEPS = 16
"""Number of compiled steps that are kept."""

_COMPILED_STEPS = dict[tuple[Any, ...], RowFunction]()
"""Compiled steps by all that their code depends on."""


def compile_load_estimate(controller: LoadEstimateController) -> LoadEstimateController:
    """Return a new controller with a compiled filter, which does the same but for round-off.

    The controller itself is returned for a crane with springs, whose filter is not compiled.
    Compiling takes about as long as the filter saves in four runs.

    Args:
        controller: A controller of `with_load_estimate`.
    """
    if controller.filter.crane.springs.any:
        return controller
    return replace(controller, filter=CompiledLoadFilter(controller.filter))


class CompiledLoadFilter(LoadFilter):
    """A copy of a filter, with a compiled `step`."""

    def __init__(self, plain: LoadFilter) -> None:
        """Compile the step, once for equal cranes, periods, sensors and noise."""
        source = plain.source
        super().__init__(
            source.crane,
            source.period,
            source.sensors,
            plain.mean,
            plain.covariance,
            source.disturbance,
            source.noise,
        )
        key = (
            Topology.of(source.crane),
            source.period,
            source.sensors,
            plant_numbers(source.crane).tobytes(),
            source.disturbance.tobytes(),
            source.noise.tobytes(),
        )
        if key not in _COMPILED_STEPS:
            if len(_COMPILED_STEPS) >= _MAX_CACHED_STEPS:
                _COMPILED_STEPS.clear()
            _COMPILED_STEPS[key] = _compile(self.source)
        self._row, self._result, self._run = _COMPILED_STEPS[key].bind_row()

    def step(self, effort: np.ndarray, reading: State) -> None:
        """Predict and correct as `LoadFilter.step`.

        Raises:
            CraneError: If the result is not finite.
        """
        size = len(self.mean)
        np.concatenate([self.mean, self.covariance.ravel(), effort, *reading], out=self._row)
        self._run()
        result = self._result.copy()
        # The sum of squares is finite only if all terms are, and quicker than a look at each.
        if not np.isfinite(result @ result):
            raise CraneError(
                "The observer cannot go on: its estimate is not finite any more. The readings do "
                "not fit its crane, or its noise is too small for them."
            )
        self.mean = result[:size]
        self.covariance = result[size:].reshape(size, size)
        self._believe()


def _compile(source: FilterSource) -> RowFunction:
    """Return the step of a filter as machine code.

    Its row is mean, covariance row by row, effort, and reading; its result is mean and covariance.
    """
    n = source.crane.layout.n
    m = source.crane.layout.m
    size = 2 * n + 3

    def step(row: np.ndarray) -> np.ndarray:
        mean, covariance, effort, reading = np.split(row, np.cumsum([size, size**2, m]))
        traced = _TracedFilter(
            source.crane,
            source.period,
            source.sensors,
            mean,
            covariance.reshape(size, size),
            source.disturbance,
            source.noise,
        )
        traced.step(effort, State(reading[:n], reading[n:]))
        # The covariance is symmetric. One triangle is computed, and copied to the other.
        lower = np.tril(traced.covariance)
        symmetric = lower + np.tril(lower, -1).T
        return np.concatenate([traced.mean, symmetric.ravel()])

    return compile_rows(step, size + size**2 + m + 2 * n, size + size**2)


class _TracedFilter(LoadFilter):
    """The filter with values of the code as mean and covariance.

    It replaces what `LoadFilter` asks of Pinocchio, which takes numbers only. Derivatives follow
    from the inverse dynamics in dual numbers.
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
        super().__init__(crane, period, sensors, mean, covariance, disturbance, noise)
        # The filter writes into copies of the unit matrix, which must be able to hold values of the
        # code.
        self._identity = self._identity.astype(object)

    def _believe(self) -> None:
        """Give the crane the mass of the load that is estimated."""
        # The estimate is the inverse of the mass over the planned one, see `LoadFilter`.
        self._tree = self._with_load(self._planned / self.mean[-3])

    def _with_load(self, mass: Any) -> Bodies:
        """Return the bodies of the planned crane with another mass of the load [kg]."""
        tree = bodies_of_crane(self.crane)
        masses = tree.mass.copy()
        masses[self._body - 1] = mass  # `_body` counts the world, which Pinocchio's joint 0 is
        return replace(tree, mass=masses)

    def _acceleration(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the accelerations that generalized forces `tau` cause, shape (n,)."""
        frames = rigid_body.frames(self._tree, q)
        return tree_forward_dynamics(self._tree, frames, v, tau)

    def _linearised(self, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of the accelerations by the state and by the estimate of the load.

        With τ = f(q, v, a, m) of the inverse dynamics and the mass matrix M = ∂f/∂a, a change of
        state or mass at a constant τ changes the accelerations by -M⁻¹ ∂f. Dual numbers carry the
        derivatives of f by the 2 n coordinates and rates and by the mass m. By the estimate
        w = m0/m of a planned mass m0 they are ∂m/∂w = -m/w times those by the mass.
        """
        count = 2 * self._n + 1
        tau = over_all_joints(self.crane, effort) + self._joint.effort(state.q, state.v)
        load = self._tree.mass[self._body - 1]
        q, v, (load_dual,) = variables(state.q, state.v, array([load]))
        tree = self._with_load(load_dual)
        a = constants(self._acceleration(state.q, state.v, tau), count)
        force = rigid_body.tree_inverse_dynamics(tree, rigid_body.frames(tree, q), v, a)
        force = force - self._joint.without_dry_friction().effort(q, v)
        mass = rigid_body.mass_matrix(self._tree, rigid_body.frames(self._tree, state.q))
        derivatives = -solve_linear(mass, slopes(force, count))
        by_state = derivatives[:, :-1]
        by_load = derivatives[:, -1] * -(load / self.mean[-3])
        return by_state, by_load

    def _turning(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        """Return the angular velocity of the load in its frame [rad/s], shape (3,), and its
        derivatives by coordinates and rates, shape (3, 2 n).
        """
        q, v = variables(state.q, state.v)
        frames = rigid_body.frames(self._tree, q)
        rates = rigid_body.angular_velocity(self._tree, frames, self._body - 1, v)
        # A rate that no coordinate changes is a plain number, and not a dual one.
        values = array([getattr(rate, "value", rate) for rate in rates])
        return values, slopes(rates, 2 * self._n)
