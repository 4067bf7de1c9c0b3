"""Least squares from the prior values, over ever longer stretches of the records."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from cranedyn.errors import DataError
from cranedyn.identification.record_prediction import ROUND_OFF, Model

HORIZONS = (0.125, 0.25, 0.5, 1.0)
"""Shares of a record that are fitted in turn: over a short time a wrong period is less than a turn
off, so that the search converges from far away."""

_MIN_HORIZON = 12.0
"""Shortest stretch of a record that is fitted [s]."""

_MAX_EVALUATIONS = 60
"""Largest number of evaluations of the residuals in one search."""

_DIVERGED_RESIDUAL = 1e6
"""Residual, in standard deviations of the noise, in place of one that is not finite."""

_COARSE_TOLERANCE = 1e-3
"""Relative change of cost and parameters at which a search over a part of the records ends; its
result is only where the next search begins."""

_FINE_TOLERANCE = 1e-9
"""Relative change of cost and parameters at which the search over the whole records ends."""

_QUIET_START_RATIO = 0.2
"""Ratio of the initial swing to the standard deviation of the recorded swing below which the drives
are taken to have made it."""

_ROOM_STEPS = 1e4
"""Distance from the bounds at which the search begins, in steps of the finite differences. A step
changes some channel by a millionth of its range, so that this changes it by a hundredth."""

_MIN_DEGREE_RATIO = 25.0
"""Ratio of a recorded swing to the predicted one from which on it is taken for one in degrees: a
degree is 57 times as many as a radian."""

_MAX_DEGREE_RATIO = 130.0
"""Ratio of a recorded swing to the predicted one up to which it is taken for one in degrees."""

_MIN_PREDICTED_SWING = 1e-3
"""Standard deviation of a predicted swing from which on units are judged [rad or rad/s]."""


class Linearisation(NamedTuple):
    """Residuals of records and their derivatives by all parameters.

    Attributes:
        residual: Predicted less recorded values; shape (channels, rows) of one record, or (rows,)
            of several.
        slope: Derivatives, with an axis for the parameters behind those of the residual.
    """

    residual: np.ndarray
    slope: np.ndarray


def first_values(model: Model) -> np.ndarray:
    """Return the start of the search, shape (parameters,): the prior values, moved off the bounds
    so far that a channel changes by a hundredth of its range; a search that starts at a bound
    leaves it slowly.
    """
    low, high = model.bounds
    room = np.minimum(_ROOM_STEPS * np.abs(model.steps), 0.1 * (high - low))
    room = np.where(model.sensitivity > 0.0, room, 0.0)
    return np.clip(model.first, low + room, high - room)


class Search:
    """Search for the values of the parameters that fit the records best.

    Attributes:
        model: Records and parameters.
        evaluations: Number of predictions of the records so far.
    """

    def __init__(
        self, model: Model, progress: Callable[[int], object] | None, evaluations: int
    ) -> None:
        """Prepare a search.

        Args:
            model: Records and parameters.
            progress: Called with the number of predictions after each.
            evaluations: Number of predictions of the records by earlier searches.
        """
        self.model = model
        self.evaluations = evaluations
        self._progress = progress

    def solve(self, values: np.ndarray, noise: list[np.ndarray], share: float) -> np.ndarray:
        """Solve the least squares over a share of each record.

        Args:
            values: Where the search begins, shape (parameters,).
            noise: Standard deviation of each channel of each record.
            share: Share of each record, from its beginning.

        Returns:
            The best values, shape (parameters,). A parameter that changes no channel keeps its
            value.

        Raises:
            DataError: If the crane cannot be simulated from there.
        """
        # The solver works on parameters in units of their scales.
        scale = self.model.scale
        low, high = (bound / scale for bound in self.model.bounds)
        begin = np.clip(values / scale, low + 1e-9, high - 1e-9)
        initial = self._linearise(begin * scale, noise, share)
        if not np.isfinite(initial.residual).all():
            raise DataError(
                "The crane cannot be simulated through the record from where the search begins; "
                "say better what is known of it."
            )
        free = initial.slope.any(axis=0)

        def all_values(free_scaled: np.ndarray) -> np.ndarray:
            """Return the values of all parameters from the scaled ones of those that are free."""
            scaled = begin.copy()
            scaled[free] = free_scaled
            return scaled * scale

        # The solver asks for the residual and for the Jacobian at the same point in two calls; both
        # come from one batch of simulations, so that the last one is kept.
        last = {(begin * scale).tobytes(): _reduced(initial, scale)}

        def evaluate(free_scaled: np.ndarray) -> Linearisation:
            """Return the reduced residual and Jacobian at scaled values of the free parameters."""
            point = all_values(free_scaled)
            key = point.tobytes()
            if key not in last:
                linearisation = self._linearise(point, noise, share)
                last.clear()
                last[key] = _reduced(linearisation, scale)
            return last[key]

        tolerance = _FINE_TOLERANCE if share == 1.0 else _COARSE_TOLERANCE
        solution = least_squares(
            lambda free_scaled: evaluate(free_scaled).residual,
            begin[free],
            jac=lambda free_scaled: (evaluate(free_scaled).slope * scale)[:, free],
            bounds=(low[free], high[free]),
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=None,
            max_nfev=_MAX_EVALUATIONS,
        )
        return all_values(solution.x)

    def _linearise(
        self, values: np.ndarray, noise: list[np.ndarray], share: float
    ) -> Linearisation:
        """Return the residuals of all records over the noise, and their derivatives, shapes (rows,)
        and (rows, parameters).
        """
        residuals = []
        slopes = []
        for index, (record, deviation) in enumerate(zip(self.model.records, noise, strict=True)):
            until = max(share * record.duration, min(_MIN_HORIZON, record.duration))
            residual, slope = jacobian(self.model, values, index, until)
            weight = 1.0 / deviation[:, None]
            residuals.append((residual * weight).ravel())
            slopes.append((slope * weight[:, :, None]).reshape(-1, len(values)))
        self.evaluations += 1
        if self._progress is not None:
            self._progress(self.evaluations)
        return Linearisation(np.concatenate(residuals), np.concatenate(slopes))


def _reduced(linearisation: Linearisation, scale: np.ndarray) -> Linearisation:
    """Return a residual r and its Jacobian J, reduced from thousands of rows to one more than there
    are parameters, shapes (parameters + 1,) and (parameters + 1, parameters).

    With J = Q R, the reduced residual is Qᵀ r with one more element, the norm of what of r lies
    outside of the range of J, and the reduced Jacobian is R with a row of zeros. |r|², Jᵀ r and
    Jᵀ J, and with them the steps of the solver, stay as they are.
    """
    not_finite = ~np.isfinite(linearisation.residual)
    residual = np.where(not_finite, _DIVERGED_RESIDUAL, linearisation.residual)
    slope = np.where(not_finite[:, None], 0.0, linearisation.slope)
    q, r = np.linalg.qr(slope * scale)
    in_range = q.T @ residual
    # Round-off may make the difference of the squares negative.
    beside = float(np.sqrt(max(residual @ residual - in_range @ in_range, 0.0)))
    reduced_slope = np.vstack([r, np.zeros((1, len(scale)))]) / scale
    return Linearisation(np.append(in_range, beside), reduced_slope)


def jacobian(model: Model, values: np.ndarray, index: int, until: float = np.inf) -> Linearisation:
    """Linearise the prediction of one record about some values.

    Args:
        model: Records and parameters.
        values: Values of all parameters, shape (parameters,).
        index: Index of the record.
        until: End of the rows evaluated [s].

    Returns:
        Predicted less recorded values, shape (channels, rows), and their derivatives by one-sided
        differences, shape (channels, rows, parameters); 0 where a channel changes by round-off.
    """
    # A step that would leave the upper bound goes downwards.
    steps = np.where(values + model.steps > model.bounds[1], -1.0, 1.0) * model.steps
    outputs = model.variations(index, values, steps, until)
    slope = np.zeros((*outputs.shape[1:], len(values)))
    measured = model.measured(index, until)
    threshold = ROUND_OFF * (measured.max(axis=1) - measured.min(axis=1))[:, None]
    for lane, i in enumerate(model.of_record(index), start=1):
        change = outputs[lane] - outputs[0]
        if not (np.abs(change) <= threshold).all():
            slope[:, :, i] = change / steps[i]
    return Linearisation(outputs[0] - measured, slope)


def check_units(model: Model) -> None:
    """Check that a swing is about as large as the recorded motion of the drives makes it.

    Raises:
        DataError: If it is some 57 times as large, as one in degrees.
    """
    if model.drives != "motion":
        return
    # Each record is predicted from rest: what remains of the swing is what the drives make.
    values = model.first.copy()
    initial_swings: dict[tuple[int | None, str], float] = {}
    for i, p in enumerate(model.parameters):
        if p.kind in ("start", "start rate"):
            largest = initial_swings.get((p.record, p.of), 0.0)
            initial_swings[p.record, p.of] = max(largest, abs(float(values[i])))
            values[i] = 0.0
    for index, record in enumerate(model.records):
        predicted = model.predicted(index, values[None])[0]
        measured = model.measured(index)
        for c, channel in enumerate(model.channels[index]):
            if channel.kind != "swing":
                continue
            symbol = model.prior.crane.layout.symbols[channel.at]
            predicted_swing = float(np.std(predicted[c]))
            measured_swing = float(np.std(measured[c]))
            # A swing that the record begins with tells nothing of units.
            if initial_swings[index, symbol] >= _QUIET_START_RATIO * measured_swing:
                continue
            if predicted_swing <= _MIN_PREDICTED_SWING:
                continue
            ratio = measured_swing / predicted_swing
            if _MIN_DEGREE_RATIO < ratio < _MAX_DEGREE_RATIO:
                raise DataError(
                    f"{record.name}: {channel.column} swings {ratio:.3g} times as much as "
                    "the drives make it swing, as degrees do; allowed are radians. Say so: "
                    f"--columns {channel.column}={channel.column}[deg]."
                )
