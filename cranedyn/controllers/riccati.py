"""The finite-horizon linear-quadratic regulator in discrete time."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigvalsh

from cranedyn.errors import OutOfRange


def riccati(a: np.ndarray, b: np.ndarray, state_weight: np.ndarray, effort_weight: np.ndarray, final_weight: np.ndarray) -> np.ndarray:
    """Gains that minimise Σ zᵀQz + uᵀRu + z_nᵀQ_n z_n along z[k+1] = a[k] z[k] + b[k] u[k], with u = -gain z.

    The backward sweep of Kwakernaak & Sivan, Linear Optimal Control Systems, §6.4.

    Args:
        a: Shape (n, nz, nz).
        b: Shape (n, nz, nu).
        state_weight: Q, positive semidefinite, shape (nz, nz).
        effort_weight: R, positive definite, shape (nu, nu).
        final_weight: Q_n, positive semidefinite, shape (nz, nz).

    Returns:
        Gains, shape (n, nu, nz).

    Raises:
        OutOfRange: If a weight is not symmetric or has an eigenvalue that is not allowed.
    """
    for name, weight, least in (
        ("state weight", state_weight, 0.0),
        ("effort weight", effort_weight, np.nextafter(0, 1)),
        ("final weight", final_weight, 0.0),
    ):
        if (
            not np.isfinite(weight).all()
            or not np.allclose(weight, weight.T)
            or eigvalsh(weight).min() < least - 1e-9 * np.abs(weight).max() * (least == 0.0)
        ):
            raise OutOfRange(name, weight.tolist(), "symmetric and positive " + ("semidefinite" if least == 0.0 else "definite"))
    gains = np.empty((len(a), b.shape[2], a.shape[1]))
    cost = final_weight
    for k in range(len(a) - 1, -1, -1):
        push = b[k].T @ cost
        gains[k] = cho_solve(cho_factor(effort_weight + push @ b[k], check_finite=False), push @ a[k], check_finite=False)
        cost = state_weight + a[k].T @ cost @ (a[k] - b[k] @ gains[k])
        cost = (cost + cost.T) / 2.0
    return gains
