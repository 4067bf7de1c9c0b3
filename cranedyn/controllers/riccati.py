"""The finite-horizon linear-quadratic regulator in discrete time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import scipy

from cranedyn.checks import as_array, finite, short_repr
from cranedyn.errors import CraneError, OutOfRange


class Sweep(NamedTuple):
    """The optimal feedback u = -gain z and what it costs to go from each instant.

    Attributes:
        gain: Shape (n, nu, nz).
        cost: The cost from instant k on is zᵀ cost[k] z, shape (n + 1, nz, nz); the last is the
            final weight.
    """

    gain: np.ndarray
    cost: np.ndarray


def riccati(
    a: np.ndarray,
    b: np.ndarray,
    state_weight: np.ndarray,
    effort_weight: np.ndarray,
    final_weight: np.ndarray | None = None,
) -> Sweep:
    """Return gains and costs-to-go that minimise Σ zᵀQz + uᵀRu + z_nᵀQ_n z_n along z[k+1] = a[k]
    z[k] + b[k] u[k], with u = -gain z.

    The backward sweep of Kwakernaak & Sivan, Linear Optimal Control Systems, §6.4.

    Args:
        a: Shape (n, nz, nz).
        b: Shape (n, nz, nu).
        state_weight: Q, positive semidefinite, shape (nz, nz).
        effort_weight: R, positive definite, shape (nu, nu).
        final_weight: Q_n, positive semidefinite, shape (nz, nz); None for the cost of going on for
            ever with the last a and b.

    Raises:
        OutOfRange: If shapes differ, or a weight is not symmetric or has an eigenvalue that is not
            allowed.
        CraneError: If no final weight is given and there is no stationary feedback, or gains or
            costs cannot be computed in double precision.
    """
    n, nz, nu = as_array("b", b, ("n", "nz", "nu")).shape
    a, b = finite("a", a, (n, nz, nz)), finite("b", b, (n, nz, nu))
    if not n:
        raise OutOfRange("a", short_repr(a), "one instant or more")
    state_weight = as_array("state weight", state_weight, (nz, nz))
    effort_weight = as_array("effort weight", effort_weight, (nu, nu))
    _check("state weight", state_weight, definite=False)
    _check("effort weight", effort_weight, definite=True)
    if final_weight is None:
        final_weight = stationary(a[-1], b[-1], state_weight, effort_weight)
    final_weight = as_array("final weight", final_weight, (nz, nz))
    _check("final weight", final_weight, definite=False)
    gain = np.empty((len(a), b.shape[2], a.shape[1]))
    cost = np.empty((len(a) + 1, *final_weight.shape))
    cost[-1] = final_weight
    with _solvable():
        for k in range(len(a) - 1, -1, -1):
            input_cost = b[k].T @ cost[k + 1]
            gain[k] = np.linalg.solve(effort_weight + input_cost @ b[k], input_cost @ a[k])
            cost_to_go = state_weight + a[k].T @ cost[k + 1] @ (a[k] - b[k] @ gain[k])
            cost[k] = (cost_to_go + cost_to_go.T) / 2.0
        if not (np.isfinite(gain).all() and np.isfinite(cost).all()):
            raise ValueError("a gain is not finite")
    return Sweep(gain, cost)


def stationary(
    a: np.ndarray, b: np.ndarray, state_weight: np.ndarray, effort_weight: np.ndarray
) -> np.ndarray:
    """Return the cost, shape (nz, nz), of an endless horizon with constant a, shape (nz, nz), and
    b, shape (nz, nu).

    Raises:
        CraneError: If it cannot be computed in double precision.
    """
    with _solvable():
        return scipy.linalg.solve_discrete_are(a, b, state_weight, effort_weight)


@contextmanager
def _solvable() -> Iterator[None]:
    """Raise an error with a message for numbers that overflow or are ill-conditioned."""
    try:
        with np.errstate(all="ignore"):
            yield
    except (np.linalg.LinAlgError, ValueError) as error:
        raise CraneError(
            "There is no linear-quadratic regulator for this crane: its masses, dampings, gravity "
            "or control period make numbers that "
            "differ too much for double precision "
            f"({str(error).strip().partition(chr(10))[0].rstrip('.')})."
        ) from error


def _check(name: str, weight: np.ndarray, *, definite: bool) -> None:
    threshold = np.nextafter(0, 1) if definite else -1e-9 * np.abs(weight).max()
    if (
        not np.isfinite(weight).all()
        or not np.allclose(weight, weight.T)
        or scipy.linalg.eigvalsh(weight).min() < threshold
    ):
        raise OutOfRange(
            name,
            weight.tolist(),
            "symmetric and positive " + ("definite" if definite else "semidefinite"),
        )
