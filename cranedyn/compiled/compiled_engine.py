"""The engine of compiled code: many times faster than the loop in Python, with the same numbers up
to round-off.

Under a controller that is affine in the state, or a predictive one, nothing in the loop is Python:
whole blocks of the run are computed at once, see `cranedyn.compiled.blocks`. Any other controller
is called at each control instant, and the code computes what lies between.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cranedyn.compiled.blocks import run_blocks
from cranedyn.compiled.memory_layout import size, slices
from cranedyn.compiled.moving_crane import CompiledCrane
from cranedyn.interfaces import Controller, Monitor, Reference, State
from cranedyn.references.simple import checked_reference
from cranedyn.simulation.log import EnergyLedger, Log
from cranedyn.simulation.loop_checks import as_command, as_force, check_bounded
from cranedyn.simulation.run_spec import RunSpec


def run(
    spec: RunSpec, controller: Controller, reference: Reference, monitors: Sequence[Monitor]
) -> Log:
    """Carry out a run and return its log, see `cranedyn.simulation.engine.Engine`.

    Raises:
        OutOfRange: If there is no code for the integrator, the log would take too much memory, or
            the reference is one of another crane.
    """
    layout = spec.crane.layout
    setpoint_at = checked_reference(reference, layout, spec.t_start, spec.clocks.period)
    moving = CompiledCrane(spec)
    log = Log(spec)
    rows = _share_memory(log, moving)
    drive_count = layout.m
    t = spec.t_start
    force = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for written in run_blocks(moving, controller, reference, log.t, rows):
                last_row = written - 1
                t = spec.time(last_row)
                log.extend_to(written)
                if monitors:
                    # The crane itself is a control period further on, unless the run has ended.
                    state_then = layout.as_state("state", State(log.q[last_row], log.v[last_row]))
                    for monitor in monitors:
                        monitor(last_row, t, state_then)

            # What no block can compute, instant by instant: all of a run under a controller that
            # only Python knows, and whatever a block has left.
            state = moving.state
            for instant in range(len(log), spec.instants):
                t = spec.time(instant)
                check_bounded(layout, t, state)

                setpoint = setpoint_at(t)
                if spec.disturbance is not None:
                    force = as_force(spec.disturbance(t, state), layout)
                command = as_command(controller(t, state, setpoint), t, layout)

                state_before = state
                if instant < spec.clocks.periods:
                    state = moving.step(command, force)
                else:
                    moving.hold(command, force)
                row = rows[instant]
                # The setpoint is the first section of a row.
                row[:drive_count] = setpoint.position
                row[drive_count:] = moving.acting
                if force is not None and spec.base is not None:
                    # The code has them in the axes of the base.
                    log.force[instant] = force.ravel()
                log.extend_to(instant + 1)
                for monitor in monitors:
                    monitor(instant, t, state_before)
            log.judge()
    except (Exception, KeyboardInterrupt) as error:
        log.end_early(t, error)
    return log


def begin(spec: RunSpec) -> CompiledCrane:
    """Return the crane of a run at its start, see `cranedyn.simulation.engine.Engine`. Its code is
    compiled now, so that its first step takes no longer than the others.

    Raises:
        OutOfRange: If there is no code for the integrator.
    """
    moving = CompiledCrane(spec)
    moving.prepare()
    return moving


def _share_memory(log: Log, moving: CompiledCrane) -> np.ndarray:
    """Make the arrays of a log views of one memory, whose rows compiled code writes, and return it,
    shape (instants, columns).

    The section `unused` is always 0: the log computes the work of external forces.
    """
    memory = np.empty((log.spec.instants, size(moving.sizes.row)))
    columns = {name: memory[:, place] for name, place in slices(moving.sizes.row).items()}
    log.q = columns["q"]
    log.v = columns["v"]
    log.setpoint = columns["setpoint"]
    log.needed_effort = columns["needed"]
    log.effort = columns["effort"]
    log.effort_before = columns["effort_before"]
    log.force = columns["force"]
    log.contact_work = columns["contact_work"][:, 0]
    log.impact_work = columns["impact_work"][:, 0]
    log.cable_buffer_force = columns["cable_buffer_force"][:, 0]
    log.saturated = columns["saturated"][:, 0]
    log.valid = columns["valid"][:, 0]
    if log.spec.base is None:
        # On a moving base the log computes the ledger, as the code knows no energy in the world.
        log.ledger = EnergyLedger(
            energy=columns["energy"][:, 0],
            drive_work=columns["work"],
            dissipated=columns["dissipated"][:, 0],
        )
    return memory
