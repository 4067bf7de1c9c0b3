"""Runs in which the load changes: it is attached to the hook, carried, and released.

A run has one crane, whose load is part of it. `simulate_stages` chains runs of cranes that differ
in their load only, such as a hook that is empty, then loaded, then empty again, and returns one
trajectory whose energy is accounted for across the changes.

What happens in a change, see `change_load`:

* Released, the load goes its own way, and all coordinates and rates stay as they are: a force that
  ends does no work.
* Attached, a load at rest becomes part of the hook at once. Where the hook moves, this is a plastic
  impact: with the mass matrices before and after, M₀ and M₁, the momentum of the coordinates that
  may jump stays,

      M₁ v₁ = M₀ v₀   in the rows of these coordinates,

  and kinetic energy is lost. Drives that follow prescribed motion keep their rates, and the rope
  that holds a load does not stretch by an impact.

Source: Pars, A Treatise on Analytical Dynamics (1965), chapter XIV, on impulsive constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cranedyn.command import defer_next_sigint
from cranedyn.data.columns import LOADS_COLUMN
from cranedyn.data.trajectory import Trajectory, join
from cranedyn.dynamics.equations_of_motion import energy
from cranedyn.errors import CraneError, DataError, Misshapen, OutOfRange, RunError
from cranedyn.interfaces import Controller, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.run_record import json_value
from cranedyn.simulation.simulate import simulate

if TYPE_CHECKING:
    from cranedyn.dynamics.contact import Ground


@dataclass(frozen=True)
class LoadStage:
    """A part of a run with one load.

    Attributes:
        crane: The crane with this load. The cranes of all stages have the same joints.
        controller: As for `cranedyn.simulation.simulate.simulate`; it begins anew in this stage.
        duration: Length of the stage [s]; with `ends_when` the longest.
        reference: From time to setpoint. If None, the drives are held where the stage begins.
        ground: Ground that this load may touch; None for none.
        ends_when: From the trajectory of the stage to whether it may end at each row, shape
            (rows,); the stage ends at the first row where it may. For example
            ``lambda run: run["phase"] == 2`` for a load that stands on the ground. None for a stage
            that lasts its duration.
    """

    crane: Crane
    controller: Controller
    duration: float
    reference: Reference | None = None
    ground: Ground | None = None
    ends_when: Callable[[Trajectory], np.ndarray] | None = None


class LoadChange(NamedTuple):
    """A change of the load.

    Attributes:
        state: State of the crane just after it.
        mass: What has been attached; negative for what was released [kg].
        brought: Energy that the load had in its own place and motion when it was attached; negative
            for one that takes its energy away [J].
        lost: Kinetic energy that the impact takes [J], which is 0 where nothing moves.
    """

    state: State
    mass: float
    brought: float
    lost: float


class StagedRun(NamedTuple):
    """A run of several stages.

    Attributes:
        trajectory: The whole run. Its column `LOADS_COLUMN` has what the changes bring, so that its
            energy ledger is constant across them, as in any run.
        stages: The trajectory of each stage.
        changes: The changes between them, one fewer.
    """

    trajectory: Trajectory
    stages: tuple[Trajectory, ...]
    changes: tuple[LoadChange, ...]


def simulate_stages(
    stages: Sequence[LoadStage], *, start: State | None = None, t_start: float = 0.0, **options: Any
) -> StagedRun:
    """Run a crane whose load is attached or released between stages.

    Args:
        stages: The stages, in order.
        start: State at the start. If None, the crane of the first stage hangs at rest.
        t_start: Time at the start [s].
        options: Options of `cranedyn.simulation.simulate.simulate` that all stages share, such as
            ``engine`` and ``drive``. A stage begins as a run does: a frequency converter does not
            remember the stage before.

    Returns:
        The run. The record of its trajectory names the crane of each stage.

    Raises:
        OutOfRange: If there is no stage.
        Misshapen: If the answer of `LoadStage.ends_when` is not one for each row.
        CraneError: As `change_load`, or if a stage never may end.
        RunError: As `cranedyn.simulation.simulate.simulate`, with the trajectory of all stages
            until there.
    """
    if not stages:
        raise OutOfRange("stages", "none", "one or more")
    prescribed = options.get("drive", "effort") != "effort"
    pieces: list[Trajectory] = []
    changes: list[LoadChange] = []
    t = t_start
    for i, stage in enumerate(stages):
        try:
            if i > 0:
                state = pieces[-1].state(-1)
                changes.append(
                    change_load(stages[i - 1].crane, stage.crane, state, prescribed=prescribed)
                )
                start = changes[-1].state
            piece = simulate(
                stage.crane,
                stage.controller,
                stage.reference,
                duration=stage.duration,
                start=start,
                t_start=t,
                ground=stage.ground,
                **options,
            )
            pieces.append(until_end(piece, stage, i))
        except (RunError, KeyboardInterrupt) as error:
            with defer_next_sigint(error):
                ended = _with_earlier_stages(error, pieces, changes, t)
                if ended is error:
                    raise
                raise ended from None
        t = float(pieces[-1].t[-1])
    return StagedRun(join_stages(pieces, changes), tuple(pieces), tuple(changes))


def _with_earlier_stages(
    error: RunError | KeyboardInterrupt,
    pieces: Sequence[Trajectory],
    changes: Sequence[LoadChange],
    t: float,
) -> RunError | KeyboardInterrupt:
    """Return the error that ended a stage with the trajectory of all stages until there.

    Args:
        error: The error. It has no trajectory, or one without rows, where the stage had not begun.
        pieces: Trajectories of the stages before.
        changes: Changes of the load so far, the last one perhaps that before this stage.
        t: Time at which the stage begins [s].
    """
    recorded = [*pieces]
    if isinstance(error, RunError) and error.trajectory is not None and len(error.trajectory) > 0:
        recorded.append(error.trajectory)
    if not recorded:
        return error
    whole = join_stages(recorded, changes[: len(recorded) - 1])
    if isinstance(error, RunError):
        error.trajectory = whole
        return error
    return RunError(f"Interrupted at t = {t:.3f} s.", t=t, trajectory=whole)


def change_load(
    before: Crane, after: Crane, state: State, *, prescribed: bool = False
) -> LoadChange:
    """Return what a change of the load does: a load at rest that is attached, or one that is
    released.

    Args:
        before: The crane with the load until now.
        after: The crane with the load from now on. Nothing but the load differs.
        state: State of the crane at the change.
        prescribed: Whether the drives follow prescribed motion, which an impact does not change.

    Raises:
        CraneError: If the cranes have other joints, or masses that differ elsewhere; if joints
            follow others.
    """
    _check_same_crane(before, after)
    mass = after.payload_mass - before.payload_mass
    if mass <= 0.0:
        brought = energy(after, state) - energy(before, state)
        return LoadChange(state, mass, brought, 0.0)

    q = state.q
    jumping = np.setdiff1d(np.arange(len(q)), before.layout.drives if prescribed else [])
    rope = before.springs.rope
    if rope is not None and rope.inextensible and q[rope.stretch] >= 0.0:
        jumping = jumping[jumping != rope.stretch]
    held = np.setdiff1d(np.arange(len(q)), jumping)
    inertia = after.mass_matrix(q)
    momentum = before.mass_matrix(q) @ state.v
    v = state.v.copy()
    known = momentum[jumping] - inertia[np.ix_(jumping, held)] @ v[held]
    v[jumping] = np.linalg.solve(inertia[np.ix_(jumping, jumping)], known)

    at_rest = State(q, np.zeros_like(v))
    brought = energy(after, at_rest) - energy(before, at_rest)
    moved = State(q, v)
    lost = energy(before, state) + brought - energy(after, moved)
    return LoadChange(moved, mass, brought, lost)


def _check_same_crane(before: Crane, after: Crane) -> None:
    """Check that two cranes differ in their load only.

    Raises:
        CraneError: If they do not, or if joints follow others.
    """
    for crane in (before, after):
        crane.require_independent_joints("A change of the load")
    if before.layout.symbols != after.layout.symbols:
        raise CraneError(
            f"The cranes of two stages have other joints: {', '.join(before.layout.symbols)}, and "
            f"{', '.join(after.layout.symbols)}."
        )
    load = before.payload.body + 1
    for i in range(1, before.model.njoints):
        same = before.model.inertias[i].isApprox(after.model.inertias[i])
        same = same and before.model.jointPlacements[i].isApprox(after.model.jointPlacements[i])
        if i != load and not same:
            raise CraneError(
                f"The cranes of two stages differ at {before.layout.joints[i - 1].name}; only what "
                "the last joint carries may change between stages."
            )


def until_end(piece: Trajectory, stage: LoadStage, index: int) -> Trajectory:
    """Return the trajectory of a stage until it ends.

    Raises:
        CraneError: If it never may end.
        Misshapen: If there is not an answer for each row.
    """
    if stage.ends_when is None:
        return piece
    may_end = np.asarray(stage.ends_when(piece), dtype=bool)
    if may_end.shape != piece.t.shape:
        raise Misshapen("answer of ends_when", may_end.shape, f"shape {piece.t.shape}")
    if not may_end.any():
        raise CraneError(
            f"Stage {index + 1} does not end within its {stage.duration:g} s; give it longer, or "
            "another condition."
        )
    last = int(may_end.argmax())
    if last == 0 and index > 0:
        raise DataError(f"Stage {index + 1} may end where it begins; it needs one period at least.")
    return piece.between(float(piece.t[0]), float(piece.t[last]))


def join_stages(pieces: Sequence[Trajectory], changes: Sequence[LoadChange]) -> Trajectory:
    """Return stages as one trajectory, whose outside work has what the changes bring."""
    whole = join(pieces)
    brought = np.zeros(len(whole.t))
    for piece, change in zip(pieces[1:], changes, strict=True):
        brought[whole.t >= piece.t[0]] += change.brought - change.lost
    columns = {**whole.columns, "outside": (*whole.columns["outside"], LOADS_COLUMN)}
    stages = []
    for piece in pieces:
        stages.append({"t_s": float(piece.t[0]), "crane": piece.record.get("crane")})
    return replace(
        whole,
        outside=np.column_stack([whole.outside, brought]),
        columns=columns,
        record={**whole.record, "stages": json_value(stages)},
    )
