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
from cranedyn.compiled.layout import size, slices
from cranedyn.compiled.moving_crane import CompiledCrane
from cranedyn.interfaces import Controller, Monitor, Reference
from cranedyn.references.simple import checked
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
    setpoint_at = checked(reference, layout, spec.t_start, spec.clocks.period)
    moving = CompiledCrane(spec)
    log = Log(spec)
    rows = _rows_of(log, moving)
    drive_count = layout.m
    t = spec.t_start
    force = None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for written in run_blocks(moving, controller, reference, log.t, rows):
                t = spec.time(written - 1)
                log.extend_to(written)
                for monitor in monitors:
                    monitor(written - 1, t, moving.state)

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
                row[:drive_count] = setpoint.position
                row[drive_count:] = moving.acting
                log.extend_to(instant + 1)
                for monitor in monitors:
                    monitor(instant, t, state_before)
            log.judge()
    except (Exception, KeyboardInterrupt) as error:
        log.end_early(t, error)
    return log


def begin(spec: RunSpec) -> CompiledCrane:
    """Return the crane of a run at its start, see `cranedyn.simulation.engine.Engine`. It is
    compiled now, so that its first step takes no longer than the others.

    Raises:
        OutOfRange: If there is no code for the integrator.
    """
    moving = CompiledCrane(spec)
    moving.prepare()
    return moving


def _rows_of(log: Log, moving: CompiledCrane) -> np.ndarray:
    """Return memory for the rows that compiled code writes, shape (instants, columns), of which the
    arrays of a log become views.
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
    log.buffer_work = columns["outside"][:, 1]
    log.impact_work = columns["outside"][:, 2]
    log.cable_buffer_force = columns["outside"][:, 3]
    log.saturated = columns["saturated"][:, 0]
    log.valid = columns["valid"][:, 0]
    log.ledger = EnergyLedger(
        energy=columns["energy"][:, 0],
        drive_work=columns["work"],
        dissipated=columns["dissipated"][:, 0],
    )
    return memory
