"""Compiled code of a crane, cached, and compared with Pinocchio before it is used.

The equations that become code are our own, see `cranedyn.compiled.plant`. So before code is used
for a crane, its accelerations are compared with those of Pinocchio at some random states, under
random commands and forces.
"""

from __future__ import annotations

import random
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from typing import NamedTuple, cast
from weakref import ref

import numpy as np
import pinocchio as pin

from cranedyn.compiled.binding import kernel_accelerations
from cranedyn.compiled.kernel import Kernel, KernelOptions, KernelSource, kernel
from cranedyn.compiled.plant import rigid_body
from cranedyn.compiled.plant.cranes import Cranes
from cranedyn.compiled.plant.plant import Topology, plant_numbers
from cranedyn.dynamics.converters import Converters, Response
from cranedyn.dynamics.drives import (
    Drives,
    EffortDrives,
    ExternalForces,
    MotionDrives,
    VelocityDrives,
)
from cranedyn.dynamics.equations_of_motion import inverse_dynamics
from cranedyn.dynamics.root_motion import ROOT_NUMBERS, RootMotion
from cranedyn.errors import ModelError
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

_MAX_CHECKED_CRANES = 16
"""Number of cranes of a batch that are compared with Pinocchio at most."""

_CHECKED_STATES = 8
"""Number of random states at which a crane is compared."""

_MAX_REMEMBERED_CRANES = 4096
"""Number of cranes for which code remembers that it agreed."""

_MAX_SWING = 1.4
"""Largest angle of a swing joint at which cranes are compared [rad], short of the horizontal."""

_MIN_STRETCH_RATIO = -0.5
"""Least stretch of a rope at which cranes are compared, over its length: a slack rope."""

_MAX_STRETCH_RATIO = 0.1
"""Largest stretch of a rope at which cranes are compared, over its length: a taut rope."""

_SLACK = 1.0
"""Length by which an inextensible rope is slack in every other state [m]."""

_COMPILING = threading.Lock()
"""Held while code is made, so that threads make it only once."""

_cached_kernel = lru_cache(maxsize=256)(kernel)

Accelerations = Callable[[Kernel, np.ndarray, np.ndarray], np.ndarray]
"""Function that returns accelerations at one state in each lane, see
`cranedyn.compiled.binding.kernel_accelerations`.
"""


def compile_kernel(
    cranes: Sequence[Crane] | Cranes, options: KernelOptions, converters: np.ndarray | None = None
) -> tuple[Kernel, np.ndarray]:
    """Return code for cranes that differ in numbers only, and their varied numbers, shape (n, m).

    The code is the same for all cranes, and is compared with Pinocchio for the first
    `_MAX_CHECKED_CRANES` of them. A lock makes threads compile it only once.

    Args:
        cranes: The cranes.
        options: Features of the code.
        converters: Parameters of their frequency converters, one row for all or one for each; None
            for drives without converters.

    Raises:
        ModelError: If the code does not do what Pinocchio does.
    """
    if isinstance(cranes, Cranes):
        rows = cranes.numbers
    else:
        rows = np.array([plant_numbers(crane) for crane in cranes])
    if converters is not None:
        rows = np.hstack([rows, np.broadcast_to(converters, (len(rows), converters.shape[-1]))])
    # Numbers that all cranes share become constants of the code, which the compiler folds.
    varied = (rows != rows[0]).any(axis=0)
    constants: list[float | None] = []
    for is_varied, value in zip(varied, rows[0].tolist(), strict=True):
        constants.append(None if is_varied else value)
    varied_numbers = np.ascontiguousarray(rows[:, varied])
    with _COMPILING:
        code = _cached_kernel(KernelSource(Topology.of(cranes[0]), tuple(constants), options))
        if len(code.verified) > _MAX_REMEMBERED_CRANES:
            code.verified.clear()
        verify_cranes(cranes, code, varied_numbers, code.verified, converters)
    return code, varied_numbers


class CraneNumbers(NamedTuple):
    """What tells the code of a crane from that of another one of its topology; a key of caches.

    Attributes:
        crane: The crane. A weak reference, so that a cache of code keeps no crane alive.
        response: Bytes of the numbers of its converters, which can be looked up in a cache as an
            array cannot; None for drives without converters.
    """

    crane: ref[Crane]
    response: bytes | None

    @classmethod
    def of(cls, crane: Crane, converters: Converters | None) -> CraneNumbers:
        """Return the numbers of a crane and of its converters."""
        response = None
        if converters is not None:
            response = np.concatenate(converters.response).tobytes()
        return cls(ref(crane), response)


_shared_with: ContextVar[CraneNumbers | None] = ContextVar("shared_with", default=None)
"""The crane with which others share their code, see `code_shared_with`."""


@contextmanager
def code_shared_with(crane: Crane, converters: Converters | None) -> Iterator[None]:
    """Let code that is made in this context serve many cranes that differ from a crane in the same
    numbers.

    Otherwise all numbers of a crane are constants of its code, and each crane has code of its own.
    Here the numbers in which a crane differs from the one given are read from memory, so that many
    variants of it need two codes instead of one each. What is computed agrees up to round-off, and
    does not depend on which other variants there were.

    Args:
        crane: The crane of which the others are variants.
        converters: Its frequency converters; None for drives without converters.
    """
    token = _shared_with.set(CraneNumbers.of(crane, converters))
    try:
        yield
    finally:
        _shared_with.reset(token)


def crane_kernel(
    crane: Crane, options: KernelOptions, converters: Converters | None
) -> tuple[Kernel, np.ndarray]:
    """Return code for one crane, as `compile_kernel`, and those of its numbers that the code reads
    from memory, shape (k,): none, unless the context says otherwise, see `code_shared_with`. It is
    cached.

    Args:
        crane: The crane.
        options: Features of the code.
        converters: Its frequency converters; None for drives without converters.
    """
    return _crane_kernel(CraneNumbers.of(crane, converters), options, _shared_with.get())


@lru_cache(maxsize=256)
def _crane_kernel(
    own: CraneNumbers, options: KernelOptions, shared_with: CraneNumbers | None
) -> tuple[Kernel, np.ndarray]:
    """Return code for one crane and its varied numbers, see `crane_kernel`."""
    cranes = [cast(Crane, own.crane())]
    responses = [own.response]
    if shared_with is not None:
        # The constants of the code are those of the first crane.
        cranes.insert(0, cast(Crane, shared_with.crane()))
        responses.insert(0, shared_with.response)
    converters = None
    if own.response is not None:
        converters = np.array([np.frombuffer(cast(bytes, response)) for response in responses])
    code, varied = compile_kernel(cranes, options, converters)
    return code, varied[-1]


def verify_cranes(
    cranes: Sequence[Crane] | Cranes,
    code: Kernel,
    varied: np.ndarray,
    verified: set[bytes],
    converters: np.ndarray | None = None,
    accelerations_of: Accelerations = kernel_accelerations,
) -> None:
    """Compare the accelerations of the first `_MAX_CHECKED_CRANES` cranes with Pinocchio's, except
    those that have agreed before.

    Args:
        cranes: The cranes.
        code: Code for them.
        varied: Their numbers that vary, shape (cranes, k).
        verified: Bytes of the varied numbers of cranes that have agreed; new ones are added.
        converters: As for `compile_kernel`.
        accelerations_of: Function that runs the code.

    Raises:
        ModelError: If they differ by more than round-off.
    """
    responses = None
    if converters is not None:
        # A row for each crane, also where one is given for all.
        responses = np.broadcast_to(converters, (len(varied), converters.shape[-1]))
    for i, crane in enumerate(cranes[:_MAX_CHECKED_CRANES]):
        response = None if responses is None else responses[i]
        key = varied[i].tobytes()
        if key not in verified:
            _verify_crane(crane, code, varied[i], response, accelerations_of)
            verified.add(key)


def _verify_crane(
    crane: Crane,
    code: Kernel,
    varied: np.ndarray,
    converters: np.ndarray | None,
    accelerations_of: Accelerations,
) -> None:
    """Compare accelerations of a crane with Pinocchio's at random states, see `verify_cranes`."""
    options = code.source.options
    rng = random.Random(0)
    external = None
    if options.forces or options.base:
        external = ExternalForces(crane, buffers=False, moving_base=options.base)
    drives = _drives(crane, options.drive, external, converters)
    rope = crane.springs.rope
    lane_numbers = np.repeat(varied[:, None], options.lanes, axis=1)
    for k in range(_CHECKED_STATES):
        # An inextensible rope is taut in every other state.
        state, force = _random_state(crane, rng, taut=k % 2 == 0)
        if external is not None and options.forces:
            external.force = force.reshape(-1, 3)
        root = np.zeros(0)
        if external is not None and external.root is not None:
            root = _random_root(crane, rng)
            external.root.motion = RootMotion.of(root)
        command = _random_command(crane, drives, state, rng, converters)
        if rope is not None and rope.inextensible:
            drives.free = _free_joints(drives, crane, state)
        expected = drives.acceleration(state.q, state.v)
        numbers_of_query = np.concatenate([state.q, state.v, command, force, root])
        query = np.repeat(numbers_of_query[:, None], options.lanes, axis=1)
        computed = accelerations_of(code, query, lane_numbers).T
        mass = crane.mass_matrix(state.q)
        difference = rigid_body.disagreement(computed, expected, mass)
        if difference != 0.0:  # NaN is a difference, too
            raise ModelError(
                "The compiled crane moves otherwise than Pinocchio's: accelerations differ by "
                f"{difference:.1e} of the largest."
            )


def _random_state(crane: Crane, rng: random.Random, *, taut: bool) -> tuple[State, np.ndarray]:
    """Return a random state and random forces on the points [N], shape (3 points,).

    Coordinates are in their ranges, swings up to `_MAX_SWING`. Rates are of the order of 1, and
    forces of that of the mass of the load.

    Args:
        crane: The crane.
        rng: Source of the numbers.
        taut: Whether an inextensible rope is taut.
    """
    layout = crane.layout
    limits = zip(crane.lower, crane.upper, strict=True)
    q = np.array([rng.uniform(lower, upper) for lower, upper in limits])
    q[crane.swings] = [rng.uniform(-_MAX_SWING, _MAX_SWING) for _ in crane.swings]
    v = np.array([rng.gauss() for _ in range(layout.n)])
    force = np.array([rng.gauss() for _ in range(3 * len(crane.points))])
    rope = crane.springs.rope
    if rope is not None:
        ratio = rng.uniform(_MIN_STRETCH_RATIO, _MAX_STRETCH_RATIO)
        q[rope.stretch] = ratio * q[rope.length]
        if rope.inextensible and taut:
            q[rope.stretch] = 0.0
            v[rope.stretch] = 0.0
        elif rope.inextensible:
            q[rope.stretch] = -_SLACK
    if crane.coupling is not None:
        q = crane.coupling.complete(q)
        v = crane.coupling.spread(v)
    return State(q, v), force * crane.payload_mass


def _random_root(crane: Crane, rng: random.Random) -> np.ndarray:
    """Return a random motion of the base, shape (9,), see
    `cranedyn.dynamics.root_motion.RootMotion`: rates and accelerations of the order of 1, on which
    gravity acts.
    """
    root = np.array([rng.gauss() for _ in range(ROOT_NUMBERS)])
    root[6:] -= crane.model.gravity.linear
    return root


def _random_command(
    crane: Crane,
    drives: Drives,
    state: State,
    rng: random.Random,
    converters: np.ndarray | None,
) -> np.ndarray:
    """Give a random command to Pinocchio's drives, and return it as compiled code takes it, shape
    (m,).

    These are efforts within the limits, accelerations of the order of 1, or reference rates. Of the
    latter about half may take more than the largest effort.
    """
    layout = crane.layout
    command = np.array([rng.uniform(-1.0, 1.0) for _ in range(layout.m)])
    inertia = crane.mass_matrix(state.q).diagonal()[layout.drives]
    if isinstance(drives, VelocityDrives):
        assert converters is not None
        response = Response(*np.array_split(converters, len(Response._fields)))
        largest = rng.choice([1.0, 3.0]) * crane.effort_limit / inertia
        # The speed control asks for the acceleration (reference - rate)/lag.
        reference = state.v[layout.drives] + response.lags * largest * command
        no_delay = np.zeros((0, layout.m))
        drives.recall(reference, np.zeros(layout.m), no_delay)
        return reference
    if isinstance(drives, EffortDrives):
        command = np.clip(command * inertia, -crane.effort_limit, crane.effort_limit)
    drives.take_command(command, state)
    return command


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
    joint, external = drives.joint_and_external_forces(q, v)
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
