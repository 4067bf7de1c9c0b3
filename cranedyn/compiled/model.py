"""Compiled forward dynamics of any tree of joints with one degree of freedom: `pin.aba` for many
states at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from cranedyn.checks import finite
from cranedyn.compiled.binding import RowFunction
from cranedyn.compiled.code import Value
from cranedyn.compiled.rows import compile_rows
from cranedyn.dynamics.bodies import bodies
from cranedyn.dynamics.scalars import array
from cranedyn.errors import ModelError
from cranedyn.plant import rigid_body


@dataclass(frozen=True, eq=False)
class ForwardDynamics:
    """Compiled forward dynamics of a model.

    Attributes:
        model: Copy of the compiled model.
        columns: Numbers of q, v and tau.
        run: Compiled function.
    """

    model: pin.Model
    columns: tuple[int, int, int]
    run: RowFunction

    def __call__(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return accelerations at states in rows, shape (n, nv).

        Args:
            q: Coordinates, shape (n, nq).
            v: Their rates, shape (n, nv).
            tau: Generalized forces [N m or N], shape (n, nv).

        Raises:
            OutOfRange: If an array has another shape, or a number is not finite.
        """
        nq, *widths = self.columns
        blocks = [finite("q", q, (len(q) if isinstance(q, np.ndarray) and q.ndim else "n", nq))]
        for name, block, columns in zip(("v", "tau"), (v, tau), widths, strict=True):
            blocks.append(finite(name, block, (len(blocks[0]), columns)))
        return self.run(np.hstack(blocks))


class _Turned:
    """Coordinate of a joint without limits, given by cosine and sine of its angle."""

    def __init__(self, cosine: Value, sine: Value) -> None:
        self._cosine, self._sine = cosine, sine

    def cos(self) -> Value:
        return self._cosine

    def sin(self) -> Value:
        return self._sine

    def __rmul__(self, nothing: float) -> float:
        """Return 0, since the joint moves along no axis."""
        return 0.0


def compile_forward_dynamics(model: pin.Model) -> ForwardDynamics:
    """Compile the forward dynamics of a model, without damping and friction, and compare it with
    Pinocchio's at random states.

    Raises:
        ModelError: If a joint cannot be compiled, or the accelerations differ by more than 1e-11 of
            the largest.
    """
    tree = bodies(model)
    tree = tree.with_numbers(tree.numbers().tolist())

    def accelerations(numbers: np.ndarray) -> np.ndarray:
        q = array([_coordinate(model, i, numbers) for i in range(1, model.njoints)])
        v, tau = (numbers[model.nq + k * model.nv :][: model.nv] for k in (0, 1))
        return rigid_body.tree_forward_dynamics(tree, rigid_body.frames(tree, q), v, tau)

    columns = (model.nq, model.nv, model.nv)
    run = compile_rows(accelerations, sum(columns), model.nv)
    dynamics = ForwardDynamics(model.copy(), columns, run)
    _check(dynamics)
    return dynamics


def _coordinate(model: pin.Model, joint: int, numbers: np.ndarray) -> Value | _Turned:
    first = model.joints[joint].idx_q
    if model.joints[joint].nq == 1:
        return numbers[first]
    return _Turned(numbers[first], numbers[first + 1])


def _check(dynamics: ForwardDynamics) -> None:
    model, data = dynamics.model, dynamics.model.createData()
    rng = np.random.default_rng(0)
    for _ in range(8):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-3.0, 3.0, model.nv))
        v, tau = rng.normal(size=(2, model.nv))
        expected = pin.aba(model, data, q, v, tau)
        found, mass = dynamics(q[None], v[None], tau[None])[0], pin.crba(model, data, q)
        if off := rigid_body.disagreement(found, expected, mass):
            raise ModelError(
                f"{model.name!r} compiled moves otherwise than in Pinocchio: accelerations differ "
                f"by {off:.1e} of the largest."
            )
