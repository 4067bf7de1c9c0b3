"""Compiled code of a crane, cached, and compared with Pinocchio before it is used."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import repeat
from typing import Any

import numpy as np
import pinocchio as pin

from cranedyn.compiled.binding import kernel_accelerations
from cranedyn.compiled.kernel import Kernel, KernelSource, Recipe, kernel
from cranedyn.dynamics.converters import Response, saturate_acceleration
from cranedyn.dynamics.joint_forces import JointForces
from cranedyn.dynamics.pinocchio import follow_drives, full, inverse_dynamics, outside_effort
from cranedyn.errors import ModelError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plant import rigid_body
from cranedyn.plant.cranes import Cranes
from cranedyn.plant.plant import Topology, numbers

_CHECKED, _REMEMBERED = 16, 4096
_MAKING = threading.Lock()

Accelerations = Callable[[Kernel, np.ndarray, np.ndarray], np.ndarray]
"""Accelerations at one state in each lane, see `cranedyn.compiled.binding.kernel_accelerations`."""


def compile_kernel(
    cranes: Sequence[Crane] | Cranes, recipe: Recipe, converters: np.ndarray | None = None
) -> tuple[Kernel, np.ndarray]:
    """Return code for cranes that differ in numbers only, and their varied numbers, shape (n, m).

    The code is the same for all cranes, and is compared with Pinocchio for the first 16 of them. A
    lock makes threads compile it only once.

    Args:
        cranes: The cranes.
        recipe: Features of the code.
        converters: Parameters of their frequency converters, one row for all or one for each; None
            for drives without converters.

    Raises:
        ModelError: If the code does not do what Pinocchio does.
    """
    if isinstance(cranes, Cranes):
        rows = cranes.numbers
    else:
        rows = np.array([numbers(crane) for crane in cranes])
    if converters is not None:
        rows = np.hstack([rows, np.broadcast_to(converters, (len(rows), converters.shape[-1]))])
    varied = (rows != rows[0]).any(axis=0)
    constants = (
        None if differs else value
        for value, differs in zip(rows[0].tolist(), varied.tolist(), strict=True)
    )
    varied_numbers = np.ascontiguousarray(rows[:, varied])
    with _MAKING:
        code = _kernel(KernelSource(Topology.of(cranes[0]), tuple(constants), recipe))
        if len(code.verified) > _REMEMBERED:
            code.verified.clear()
        verify_cranes(cranes, code, varied_numbers, code.verified, converters)
    return code, varied_numbers


def verify_cranes(
    cranes: Sequence[Crane] | Cranes,
    code: Kernel,
    varied: np.ndarray,
    verified: set[bytes],
    converters: np.ndarray | None = None,
    answers: Accelerations = kernel_accelerations,
) -> None:
    """Compare accelerations of the first 16 cranes with Pinocchio's, except those that have agreed
    before; converters are as in `compile_kernel`.

    Raises:
        ModelError: If they differ by more than round-off.
    """
    rows: Any = repeat(None)
    if converters is not None:
        rows = np.broadcast_to(converters, (len(varied), converters.shape[-1]))
    for crane, row, response in zip(cranes[:_CHECKED], varied, rows, strict=False):
        if row.tobytes() not in verified:
            verify_crane(crane, code, row, response, answers)
            verified.add(row.tobytes())


@lru_cache(maxsize=256)
def _kernel(source: KernelSource) -> Kernel:
    return kernel(source)


def verify_crane(
    crane: Crane,
    code: Kernel,
    varied: np.ndarray,
    converters: np.ndarray | None = None,
    answers: Accelerations = kernel_accelerations,
) -> None:
    """Compare accelerations of a crane with Pinocchio's at random states.

    Args:
        crane: The crane.
        code: The code.
        varied: Varied numbers of this crane.
        converters: Parameters of its frequency converters, see `cranedyn.dynamics.converters`.
        answers: Function that runs the code, see `cranedyn.compiled.binding.kernel_accelerations`.

    Raises:
        ModelError: If they differ by more than round-off.
    """
    rng, recipe, layout = np.random.default_rng(0), code.source.recipe, crane.layout
    model, data, joint = crane.model, crane.model.createData(), JointForces.of(crane)
    rope, lags = crane.springs.rope, np.zeros(layout.m)
    lane_numbers = np.repeat(varied[:, None], recipe.lanes, axis=1)
    for k in range(8):
        q = rng.uniform(crane.lower, crane.upper)
        q[crane.swings] = rng.uniform(-1.4, 1.4, len(crane.swings))
        if rope is not None:
            q[rope.stretch] = rng.uniform(-0.5, 0.1) * q[rope.length]
        v = rng.normal(size=layout.n)
        if rope is not None and rope.inextensible:  # taut in every other state
            q[rope.stretch], v[rope.stretch] = (0.0, 0.0) if k % 2 else (-1.0, v[rope.stretch])
        force = rng.normal(size=3 * len(crane.points)) * crane.payload_mass
        command, mass = rng.uniform(-1.0, 1.0, layout.m), pin.crba(model, data, q)
        inertia, external = mass.diagonal()[layout.drives], np.zeros(layout.n)
        if recipe.forces:
            external = outside_effort(crane.points, model, data, q, force.reshape(-1, 3))
        acting = joint.effort(q, v) + external
        if recipe.drive == "effort":
            command = np.clip(command * inertia, -crane.effort_limit, crane.effort_limit)
        elif recipe.drive == "velocity":
            assert converters is not None
            lags = np.array_split(converters, len(Response._fields))[3]
            # every other time beyond the effort limits
            strong = rng.choice([1.0, 3.0]) * crane.effort_limit / inertia
            command = v[layout.drives] + lags * strong * command
        expect = partial(_accelerations, crane, recipe.drive, State(q, v), command, acting, lags)
        expected = expect(taut=False)
        if rope is not None and rope.inextensible and v[rope.stretch] == 0.0:
            held = expect(taut=True)
            if recipe.drive == "effort":
                acting = acting + full(crane, command)
            if inverse_dynamics(model, data, q, v, held, acting)[rope.stretch] < 0.0:  # it pulls
                expected = held
        query = np.repeat(np.concatenate([q, v, command, force])[:, None], recipe.lanes, axis=1)
        if off := rigid_body.disagreement(answers(code, query, lane_numbers).T, expected, mass):
            raise ModelError(
                "The compiled crane moves otherwise than Pinocchio's: accelerations differ by "
                f"{off:.1e} of the largest."
            )


def _accelerations(
    crane: Crane,
    drive: str,
    state: State,
    command: np.ndarray,
    acting: np.ndarray,
    lags: np.ndarray,
    *,
    taut: bool,
) -> np.ndarray:
    """Return accelerations by Pinocchio under generalized forces that act beside the drives, shape
    (n,), with an inextensible rope taken as taut or slack.
    """
    layout, model, data, (q, v) = crane.layout, crane.model, crane.data, state
    answering = np.arange(layout.n) if drive == "effort" else layout.passive
    free = crane.springs.free(answering) if taut else answering
    if drive == "velocity":
        mass = pin.crba(model, data, q)
        return saturate_acceleration(
            np.triu(mass) + np.triu(mass, 1).T,
            pin.rnea(model, data, q, v, 0.0 * v) - acting,
            (command - v[layout.drives]) / lags,
            crane.effort_limit,
            layout.drives,
            free,
        )[0]
    given = full(crane, command)
    if drive == "motion":
        return follow_drives(model, data, q, v, given, acting, free)
    if free is answering:
        return pin.aba(model, data, q, v, given + acting)
    return follow_drives(model, data, q, v, 0.0 * v, given + acting, free)
