"""Stability margins of a closed loop: damping of its modes, and gain and delay margins of each
drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import schur
from scipy.optimize import brentq

from cranedyn.checks import finite
from cranedyn.controllers.affine import affine_form
from cranedyn.dynamics.linearisation import Sampled
from cranedyn.errors import CraneError
from cranedyn.interfaces import Controller, State
from cranedyn.model.crane import Crane

_POINTS, _SLOWEST = 1200, 1e-3
"""Number of frequencies, from the slowest [rad/s] to half of the sampling rate."""

_BESIDE = np.concatenate([-np.geomspace(0.2, 1e-5, 60), [0.0], np.geomspace(1e-5, 0.2, 60)])
"""Relative offsets of further frequencies around each resonance of the open loop."""


class Regulator(NamedTuple):
    """Linear controller about a rest: u = -(c x + d z), then x becomes a x + b z.

    Attributes:
        a: Shape (k, k), with k states of the controller.
        b: Shape (k, 2 n).
        c: Shape (m, k).
        d: Shape (m, 2 n).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


class Margin(NamedTuple):
    """Margins of a drive, the others unchanged.

    Attributes:
        upper_gain: Gain margin: least factor above one on its effort at which the loop is
            unstable; inf for none.
        lower_gain: Largest such factor below one; 0 for none.
        delay: Delay margin: delay of its commands at which the loop is unstable [s]; inf for none.
    """

    upper_gain: float
    lower_gain: float
    delay: float


class Margins(NamedTuple):
    """Stability of a closed loop.

    Attributes:
        damping: Least share of critical damping of a mode, -Re s/|s|: 1 where nothing oscillates,
            negative where one grows.
        growth_rate: Largest growth rate of a mode [1/s], negative where it is stable.
        drives: Margins of each drive; empty where the loop is unstable.
    """

    damping: float
    growth_rate: float
    drives: tuple[Margin, ...]

    @property
    def least(self) -> Margin:
        """Worst margins over all drives."""
        if not self.drives:
            return Margin(1.0, 1.0, 0.0)
        return Margin(
            min(d.upper_gain for d in self.drives),
            max(d.lower_gain for d in self.drives),
            min(d.delay for d in self.drives),
        )


def regulator(
    crane: Crane, controller: Controller, rest: State, *, t: float = 0.0, period: float
) -> Regulator:
    """Return the linear form of an affine controller about a rest at a time [s]; its integrals are
    states.

    Raises:
        CraneError: If it has no affine form, see `cranedyn.controllers.affine`.
    """
    layout = crane.layout
    rest = layout.as_state("rest", rest)
    affine = affine_form(controller, np.array([t]), rest.q[layout.drives][None], 2 * layout.n)
    if affine is None:
        raise CraneError(
            f"The controller {type(controller).__name__} is not affine in the state, so it has no "
            "margins of this kind."
        )
    integrating = np.flatnonzero(affine.integral_gain)
    count = len(integrating)
    selection = np.zeros((count, 2 * layout.n))
    selection[np.arange(count), layout.drives[integrating]] = period
    by_integral = np.zeros((layout.m, count))
    by_integral[integrating, np.arange(count)] = affine.integral_gain[integrating]
    # the error of an instant counts at once
    return Regulator(
        np.eye(count), selection, by_integral, affine.gain[-1] + by_integral @ selection
    )


def behind_observer(
    law: Regulator, plant: Sampled, gain: np.ndarray, measured: np.ndarray
) -> Regulator:
    """Return the same controller fed by the estimate of a filter that measures part of the state
    and knows the commands.

    Args:
        law: Controller.
        plant: Crane model of the filter, over a control period.
        gain: Gain of the filter, shape (2 n, measured).
        measured: Indices of the measured coordinates and rates, shape (measured,).

    Raises:
        OutOfRange: If the gain has another shape or is not finite.
    """
    nz = len(plant.a)
    indices = finite("measured", measured, ("measured",)).astype(int)
    selected = finite("gain of the filter", gain, (nz, len(indices))) @ np.eye(nz)[indices]
    unseen, moved = np.eye(nz) - selected, plant.a - plant.b @ law.d
    return Regulator(
        np.block([[moved @ unseen, -plant.b @ law.c], [law.b @ unseen, law.a]]),
        np.vstack([moved @ selected, law.b @ selected]),
        np.hstack([law.d @ unseen, law.c]),
        law.d @ selected,
    )


def margins(plant: Sampled, law: Regulator) -> Margins:
    """Return the margins of a crane under a linear controller, each drive's loop opened at its
    effort while the others stay closed.

    Args:
        plant: The crane over a control period, see `cranedyn.dynamics.linearisation.sampled`.
        law: Controller.

    Raises:
        OutOfRange: If a matrix of the controller has another shape or is not finite.
    """
    nz, m = plant.b.shape
    k = len(law.a)
    for name, matrix, shape in zip("abcd", law, ((k, k), (k, nz), (m, k), (m, nz)), strict=True):
        finite(f"{name} of the controller", matrix, shape)
    everything = range(m)
    rates = np.log(np.linalg.eigvals(_closed(plant, law, everything)).astype(complex))
    rates = rates / plant.period
    sizes = np.abs(rates)
    shares = np.divide(-rates.real, sizes, out=np.zeros(len(rates)), where=sizes > 0.0)
    damping = float(shares.min())
    growth_rate = float(rates.real.max())
    if not growth_rate < 0.0:
        return Margins(damping, growth_rate, ())
    return Margins(damping, growth_rate, tuple(_margin(plant, law, i) for i in everything))


def _closed(plant: Sampled, law: Regulator, drives: range | list[int]) -> np.ndarray:
    """Return the loop closed at some of the drives, for (z, x)."""
    b = plant.b[:, drives]
    return np.block([[plant.a - b @ law.d[drives], -b @ law.c[drives]], [law.b, law.a]])


def _margin(plant: Sampled, law: Regulator, drive: int) -> Margin:
    further = [i for i in range(plant.b.shape[1]) if i != drive]
    a = _closed(plant, law, further)
    b = np.concatenate([plant.b[:, drive], np.zeros(len(law.a))])[:, None]
    c = np.concatenate([law.d[drive], law.c[drive]])[None]
    response = _transfer_function(a, b, c)
    fastest = 0.999 * math.pi / plant.period
    rings = np.abs(np.log(np.linalg.eigvals(a).astype(complex)).imag) / plant.period
    resonances = (rings[rings > _SLOWEST][:, None] * (1.0 + _BESIDE)).ravel()
    grid = np.unique(np.concatenate([np.geomspace(_SLOWEST, fastest, _POINTS), resonances]))
    grid = grid[grid < fastest]

    def at(rates: np.ndarray) -> np.ndarray:
        return response(np.exp(1j * plant.period * rates))

    def zeros(number_of: Callable[[np.ndarray], np.ndarray], where: Any = True) -> np.ndarray:
        changes = np.diff(np.sign(number_of(on_grid))) * where
        return np.array(
            [
                brentq(lambda rate: number_of(at(np.array([rate])))[0], grid[i], grid[i + 1])
                for i in np.flatnonzero(changes)
            ]
        )

    on_grid = at(grid)
    gains = 1.0 / np.abs(at(zeros(lambda values: np.angle(-values), on_grid.real[:-1] <= 0.0)))
    crossings = zeros(lambda values: np.abs(values) - 1.0)
    delay = np.mod(np.angle(-at(crossings)), 2.0 * math.pi) / crossings
    # at half of the sampling rate a loop is real, so it may cross there, too
    end = float(response(np.array([-1.0]))[0].real)
    gains = np.append(gains, [-1.0 / end] if end < 0.0 else [])
    return Margin(
        float(min(gains[gains > 1.0], default=math.inf)),
        float(max(gains[gains < 1.0], default=0.0)),
        float(min(delay, default=math.inf)),
    )


def _transfer_function(
    a: np.ndarray, b: np.ndarray, c: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function c (z - a)⁻¹ b of complex numbers z, shape (k,), for a loop of one input
    and one output; a Schur form of a leaves substitutions.
    """
    triangle, basis = schur(a, output="complex")
    inputs, outputs = (basis.conj().T @ b)[:, 0], (c @ basis)[0]

    def response(z: np.ndarray) -> np.ndarray:
        x = np.zeros((len(outputs), len(z)), dtype=complex)
        for i in reversed(range(len(outputs))):
            # not a product of BLAS, whose threads cost more than so few numbers
            solved = np.einsum("j,jk->k", triangle[i, i + 1 :], x[i + 1 :])
            x[i] = (inputs[i] + solved) / (z - triangle[i, i])
        return np.einsum("j,jk->k", outputs, x)

    return response
