"""Compiled load filter: prediction and correction of a control period in one call."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.horizon.dual import constants, slopes, variables
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.bodies import Bodies, numeric_bodies
from cranedyn.dynamics.pinocchio import full
from cranedyn.dynamics.scalars import array, solve_linear
from cranedyn.errors import CraneError
from cranedyn.estimation.load_estimate import LoadEstimateController
from cranedyn.estimation.load_filter import LoadFilter, Sensors
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plant import rigid_body
from cranedyn.plant.plant import Topology, numbers

_CODES = dict[tuple[Any, ...], RowFunction]()
"""Compiled steps by what their code depends on, 16 at most."""


def compile_load_estimate(controller: LoadEstimateController) -> LoadEstimateController:
    """Return a new controller of `with_load_estimate` with a compiled filter, to round-off the
    same; for a crane with springs, the controller itself. It pays from four runs on.
    """
    if controller.filter.crane.springs.any:
        return controller
    return replace(controller, filter=CompiledLoadFilter(controller.filter))


class CompiledLoadFilter(LoadFilter):
    """A copy of a filter, with a compiled `step`."""

    def __init__(self, plain: LoadFilter) -> None:
        """Compile the step, once for equal cranes, periods, sensors and noise."""
        crane, period, sensors, *noise = plain.source
        super().__init__(crane, period, sensors, plain.mean, plain.covariance, *noise)
        arrays = [values.tobytes() for values in (numbers(crane), *noise)]
        key = (Topology.of(crane), period, sensors, *arrays)
        if key not in _CODES and len(_CODES) >= 16:
            _CODES.clear()
        code = _CODES.get(key) or _CODES.setdefault(key, _compile(*self.source))
        self._row, self._answers, self._run = code.bind_row()

    def step(self, effort: np.ndarray, reading: State) -> None:
        """Predict and correct as `LoadFilter.step`.

        Raises:
            CraneError: If the result is not finite.
        """
        size = len(self.mean)
        np.concatenate([self.mean, self.covariance.ravel(), effort, *reading], out=self._row)
        self._run()
        result = self._answers.copy()
        if not np.isfinite(result @ result):
            raise CraneError(
                "The observer cannot go on: its estimate is not finite any more. The readings do "
                "not fit its crane, or its noise is too small for them."
            )
        self.mean = result[:size]
        self.covariance = result[size:].reshape(size, size)
        self._believe()


def _compile(crane: Crane, period: float, sensors: Sensors, *noise: np.ndarray) -> RowFunction:
    n, m = crane.layout.n, crane.layout.m
    size = 2 * n + 3

    def step(row: np.ndarray) -> np.ndarray:
        mean, covariance, effort, reading = np.split(row, np.cumsum([size, size**2, m]))
        covariance = covariance.reshape(size, size)
        traced = _TracedFilter(crane, period, sensors, mean, covariance, *noise)
        traced.step(effort, State(*reading.reshape(2, -1)))
        # Code computes one triangle, and copies it to the other.
        lower = np.tril(traced.covariance)
        return np.concatenate([traced.mean, (lower + np.tril(lower, -1).T).ravel()])

    return compile_rows(step, size + size**2 + m + 2 * n, size + size**2)


class _TracedFilter(LoadFilter):
    """The filter in numbers of code; the derivatives are those of the inverse dynamics."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for name in ("_identity", "_added", "_noise"):  # code folds Python floats
            matrix = getattr(self, name)
            setattr(self, name, array(matrix.ravel().tolist()).reshape(matrix.shape))

    def _believe(self) -> None:
        self._tree = self._with_load(self._planned / self.mean[-3])

    def _with_load(self, mass: Any) -> Bodies:
        tree = numeric_bodies(self.crane)
        masses = tree.mass.copy()
        masses[self._body - 1] = mass
        return replace(tree, mass=masses)

    def _acceleration(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        frames = rigid_body.frames(self._tree, q)
        return rigid_body.tree_forward_dynamics(self._tree, frames, v, tau)

    def _linearised(self, state: State, effort: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = 2 * self._n + 1
        frames = rigid_body.frames
        tau = full(self.crane, effort) + self._joint.effort(*state)
        load = self._tree.mass[self._body - 1]
        q, v, (load_dual,) = variables(*state, array([load]))
        tree = self._with_load(load_dual)
        a = constants(self._acceleration(*state, tau), count)
        force = rigid_body.tree_inverse_dynamics(tree, frames(tree, q), v, a)
        force = force - self._joint.effort(q, v)
        mass = rigid_body.mass_matrix(self._tree, frames(self._tree, state.q))
        by = -solve_linear(mass, slopes(force, count))
        return by[:, :-1], by[:, -1] * -(load / self.mean[-3])

    def _turning(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        q, v = variables(*state)
        frames = rigid_body.frames(self._tree, q)
        rates = rigid_body.angular_velocity(self._tree, frames, self._body - 1, v)
        values = array([getattr(rate, "value", rate) for rate in rates])
        return values, slopes(rates, 2 * self._n)
