"""Compiled code of a crane, cached, and compared with Pinocchio before it is used."""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import repeat
from typing import Any, cast
from weakref import ref

import numpy as np
import pinocchio as pin

from cranedyn.compiled.binding import kernel_accelerations
from cranedyn.compiled.kernel import Kernel, KernelSource, Recipe, kernel
from cranedyn.dynamics.converters import Converters, Response
from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.pinocchio import inverse_dynamics
from cranedyn.errors import ModelError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.plant import rigid_body
from cranedyn.plant.cranes import Cranes
from cranedyn.plant.plant import Topology, numbers

_CHECKED = 16
"""Number of cranes of a batch that are checked at most."""

_REMEMBERED = 4096
"""Number of cranes that code remembers to have been checked with."""

_MAKING = threading.Lock()
"""Held while code is made, so that threads make it only once."""

_kernel = lru_cache(maxsize=256)(kernel)

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
    rows = cranes.numbers if isinstance(cranes, Cranes) else np.array([*map(numbers, cranes)])
    if converters is not None:
        rows = np.hstack([rows, np.broadcast_to(converters, (len(rows), converters.shape[-1]))])
    varied = (rows != rows[0]).any(axis=0)
    constants = tuple(None if v else x for v, x in zip(varied, rows[0].tolist(), strict=True))
    varied_numbers = np.ascontiguousarray(rows[:, varied])
    with _MAKING:
        code = _kernel(KernelSource(Topology.of(cranes[0]), constants, recipe))
        if len(code.verified) > _REMEMBERED:
            code.verified.clear()
        verify_cranes(cranes, code, varied_numbers, code.verified, converters)
    return code, varied_numbers


@lru_cache(maxsize=256)
def crane_kernel(crane: ref[Crane], recipe: Recipe, response: bytes | None) -> Kernel:
    """Return code for one crane; response is that of its converters, see `compile_kernel`."""
    converters = None if response is None else np.frombuffer(response)
    return compile_kernel([cast(Crane, crane())], recipe, converters)[0]


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
            _verify_crane(crane, code, row, response, answers)
            verified.add(row.tobytes())


def _verify_crane(
    crane: Crane,
    code: Kernel,
    varied: np.ndarray,
    converters: np.ndarray | None,
    answers: Accelerations,
) -> None:
    """Compare accelerations of a crane with Pinocchio's at random states, see `verify_cranes`."""
    recipe = code.source.recipe
    layout = crane.layout
    rng = random.Random(0)
    external = ExternalForces(crane, buffers=False) if recipe.forces else None
    drives = _drives(crane, recipe.drive, external, converters)
    rope = crane.springs.rope
    lane_numbers = np.repeat(varied[:, None], recipe.lanes, axis=1)
    sizes = layout.n, 3 * len(crane.points)
    for k in range(8):
        q = np.array([*map(rng.uniform, crane.lower, crane.upper)])
        q[crane.swings] = [rng.uniform(-1.4, 1.4) for _ in crane.swings]
        v, force = (np.array([rng.gauss() for _ in range(size)]) for size in sizes)
        if rope is not None:
            q[rope.stretch] = rng.uniform(-0.5, 0.1) * q[rope.length]
            if rope.inextensible:  # taut in every other state
                q[rope.stretch], v[rope.stretch] = (-1.0, v[rope.stretch]) if k % 2 else (0.0, 0.0)
        if crane.coupling is not None:
            q, v = crane.coupling.complete(q), crane.coupling.spread(v)
        command = np.array([rng.uniform(-1.0, 1.0) for _ in range(layout.m)])
        force *= crane.payload_mass
        mass = crane.mass_matrix(q)
        inertia = mass.diagonal()[layout.drives]
        if external is not None:
            external.force = force.reshape(-1, 3)
        if recipe.drive == "effort":
            command = np.clip(command * inertia, -crane.effort_limit, crane.effort_limit)
        if isinstance(drives, VelocityDrives):
            assert converters is not None
            lags = np.array_split(converters, len(Response._fields))[3]
            # every other time beyond the effort limits
            strong = rng.choice([1.0, 3.0]) * crane.effort_limit / inertia
            command = v[layout.drives] + lags * strong * command
            drives.recall(command, 0.0 * command, command[:0].reshape(0, layout.m))
        else:
            drives.take_command(command, State(q, v))
        if rope is not None and rope.inextensible:
            drives.free = _free_joints(drives, crane, State(q, v))
        expected = drives.acceleration(q, v)
        query = np.repeat(np.concatenate([q, v, command, force])[:, None], recipe.lanes, axis=1)
        if off := rigid_body.disagreement(answers(code, query, lane_numbers).T, expected, mass):
            raise ModelError(
                "The compiled crane moves otherwise than Pinocchio's: accelerations differ by "
                f"{off:.1e} of the largest."
            )


def _free_joints(drives: Drives, crane: Crane, state: State) -> np.ndarray:
    """Return the joints that are free to move at a state, by their indices: where an inextensible
    rope would pull, it holds its stretch.

    Args:
        drives: The drives, which hold a command.
        crane: A crane with an inextensible rope.
        state: Its state.
    """
    rope = crane.springs.rope
    assert rope is not None
    q, v = state
    all_joints = (
        crane.layout.independent if isinstance(drives, EffortDrives) else crane.layout.passive
    )
    if q[rope.stretch] < 0.0 or v[rope.stretch] < 0.0:
        return all_joints
    drives.free = crane.springs.free(all_joints)
    acceleration = drives.acceleration(q, v)
    joint, external = drives.passive_forces(q, v)
    needed = inverse_dynamics(crane.model, crane.data, q, v, acceleration, joint, external)
    tension = -float(needed[rope.stretch])
    return drives.free if tension > 0.0 else all_joints


def _drives(
    crane: Crane, drive: str, external: ExternalForces | None, converters: np.ndarray | None
) -> Drives:
    """Return Pinocchio's drives of a crane."""
    if converters is not None:
        numbers = Converters(*np.array_split(converters, len(Response._fields)))  # type: ignore[arg-type]
        return VelocityDrives(crane, external, numbers, 1.0, 0)
    if drive == "motion":
        return MotionDrives(crane, external)
    drives = EffortDrives(crane, external)
    drives.convention = pin.Convention.LOCAL  # which loses fewer digits
    return drives
