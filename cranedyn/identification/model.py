"""Prediction of records by a crane with given values of the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification.problem import EstimationProblem
from cranedyn.identification.variants import Variants
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.simulation.simulate import simulate

_CHANGE = 1e-6

ROUND_OFF = 1e-12
"""Changes of a channel below this share of its range are round-off."""


@dataclass(frozen=True, eq=False)
class Model(EstimationProblem):
    """Model of records of one crane: predicts them from values of the parameters."""

    @cached_property
    def steps(self) -> np.ndarray:
        """Steps of finite differences, shape (parameters,): some channel changes by a millionth of
        its range.
        """
        factor = np.where(
            self.sensitivity > 0.0, _CHANGE / np.where(self.sensitivity, self.sensitivity, 1.0), 1.0
        )
        return self._trial_steps * np.clip(factor, 1e-6, 1e6)

    @cached_property
    def _trial_steps(self) -> np.ndarray:
        up = [p.start + p.scale <= p.high for p in self.parameters]
        return 1e-3 * np.where(up, 1.0, -1.0) * self.scale

    @cached_property
    def sensitivity(self) -> np.ndarray:
        """Largest change of a channel, as a share of its range, with a thousandth of the scale of
        each parameter at the first values; 0 where it is round-off, shape (parameters,).
        """
        steps, largest = self._trial_steps, np.zeros(len(self.parameters))
        for index in range(len(self.records)):
            indices, measured = self.of_record(index), self.measured(index)
            variants = np.tile(self.first, (len(indices) + 1, 1))
            variants[np.arange(1, len(indices) + 1), indices] += steps[indices]
            outputs = self.predicted(index, variants)
            change = np.abs(outputs[1:] - outputs[0]).max(axis=2)
            share = (change / np.maximum(np.ptp(measured, axis=1), 1e-9)).max(axis=1)
            largest[indices] = np.maximum(
                largest[indices], np.where(np.isfinite(share), share, 0.0)
            )
        return np.where(largest > ROUND_OFF, largest, 0.0)

    def predicted(self, index: int, values: np.ndarray, until: float = np.inf) -> np.ndarray:
        """Predict a record, shape (variants, channels, rows evaluated); not finite where a variant
        cannot be simulated.

        Args:
            index: Index of the record.
            values: Values of all parameters for each variant, shape (variants, parameters).
            until: End of the rows evaluated [s].
        """
        # Numbers in which all cranes agree are compiled into the code. A further variant keeps the
        # parameters out of it, or each crane would need code of its own.
        further = values[:1] + np.where(self._varied, 1e-3 * self.scale, 0.0)
        variants = Variants(self, index, np.vstack([values, further]), until)
        return variants.outputs(variants.batch())[:-1]

    @cached_property
    def _varied(self) -> np.ndarray:
        """Mask of the parameters that change the crane, shape (parameters,)."""
        return np.array([p.kind == "argument" for p in self.parameters])

    def run(self, index: int, values: np.ndarray, crane: Crane) -> Trajectory:
        """Simulate a record with one crane.

        Args:
            index: Index of the record.
            values: Values of all parameters, shape (parameters,).
            crane: The crane with these values.
        """
        variant = Variants(self, index, values[None])
        (controller, *_), (reference, *_) = variant.controllers([crane])
        states = variant.start()
        return simulate(
            crane,
            controller,
            reference,
            start=State(states.q[0], states.v[0]),
            duration=variant.duration,
            dt=variant.period,
            control_period=variant.period,
            drive=variant.drive,
            integrator=rk4,
            validity="mark",
            engine="compiled",
        )
