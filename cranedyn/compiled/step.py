"""Physics step in code, by the stepping rules of `cranedyn.dynamics.integrators`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cranedyn.compiled.code import Code
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.scalars import array
from cranedyn.errors import OutOfRange
from cranedyn.plant.plant import Plant


class _Number:
    """Placeholder for a number: sums and products are placeholders, too, and comparisons raise."""

    def _combine(self, operand: Any = None) -> _Number:
        return self

    def _unknown(self, operand: Any = None) -> bool:
        raise TypeError("how large a number is is not known while code is made")

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = (
        __neg__
    ) = _combine
    __lt__ = __le__ = __gt__ = __ge__ = __bool__ = _unknown


def check_rule(integrator: Integrator) -> None:
    """Check that a stepping rule can be compiled.

    Raises:
        OutOfRange: If it does anything with numbers but add and multiply them, or returns anything
            but coordinates and rates.
    """
    numbers = array([_Number(), _Number()])
    try:
        q, v = integrator.rule(np.add, np.add, np.add, numbers, numbers, 1)
        fits = q.shape == v.shape == numbers.shape
    except Exception:  # a custom rule may raise anything
        fits = False
    if not fits:
        allowed = (
            "one whose rule adds and multiplies numbers of any kind, as those of "
            "semi-implicit Euler and RK4 do"
        )
        raise OutOfRange("integrator of compiled code", integrator.name, allowed)


StepResult = tuple[np.ndarray, np.ndarray, Any]
"""Coordinates, rates, and work of the buffers so far [J]."""


def take_step(
    integrator: Integrator,
    plant: Plant,
    q: np.ndarray,
    v: np.ndarray,
    command: np.ndarray,
    forces: Any,
    dt: Any,
    work: Any,
    unit: Any,
    substeps: Any,
) -> StepResult:
    """Return the state after one step.

    Args:
        integrator: The stepping rule.
        plant: The crane, in any units, see `Plant.in_steps`.
        q: Coordinates.
        v: Rates.
        command: Command of the drives.
        forces: External forces.
        dt: The step; 1 where time is counted in steps.
        work: Work of the buffers so far [J].
        unit: The plant's unit of work [J].
        substeps: Number of semi-implicit substeps that replace the step where buffers act and the
            rule needs a smooth motion.
    """
    if not (plant.buffers and integrator.smooth):
        return _by_rule(integrator, plant, q, v, command, forces, dt, work, unit)
    q_after, faster, _ = _by_rule(
        integrator, replace(plant, buffers=False), q, v, command, forces, dt, work, unit
    )
    return _where_buffers_act(
        plant, (q, v, work), (q_after, faster, work), command, forces, dt, unit, substeps
    )


def _by_rule(
    integrator: Integrator,
    plant: Plant,
    q: np.ndarray,
    v: np.ndarray,
    command: np.ndarray,
    forces: Any,
    dt: Any,
    work: Any,
    unit: Any,
) -> StepResult:
    def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return plant.answer(q, v, command, forces)[0]

    def speed_up(v: np.ndarray, a: np.ndarray) -> np.ndarray:
        return v + a * dt

    def move(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return array([x.code.advanced(x, by) for x, by in zip(q, v * dt, strict=True)])

    q_after, faster = integrator.rule(acceleration, speed_up, move, q, v, 1)
    if plant.buffers:
        done = plant.stops.effort(q, v) @ (v + faster)[plant.stops.drives]
        work = work + 0.5 * dt * unit * done
    return q_after, faster, work


def _where_buffers_act(
    plant: Plant,
    before: StepResult,
    smooth: StepResult,
    command: np.ndarray,
    forces: Any,
    dt: Any,
    unit: Any,
    substeps: Any,
) -> StepResult:
    """Return the state after a smooth step, replaced by that of small semi-implicit substeps where
    a drive is beyond its range before or after it.
    """
    code: Code = before[0][0].code
    n = len(before[0])
    outcome = code.variables([*smooth[0], *smooth[1], smooth[2]])
    rough = code.either(*plant.stops.beyond(before[0]), *plant.stops.beyond(smooth[0]))
    with code.when(code.anywhere(rough)):
        fine = dt / code.from_integer(substeps)
        fine_state = code.variables([*before[0], *before[1], before[2]])
        with code.loop(0, substeps):
            now = array([variable.get() for variable in fine_state])
            q, v, done = _by_rule(
                semi_implicit_euler,
                plant,
                now[:n],
                now[n : 2 * n],
                command,
                forces,
                fine,
                now[2 * n],
                unit,
            )
            for variable, value in zip(fine_state, [*q, *v, done], strict=True):
                variable.set(value)
        for variable, value in zip(outcome, fine_state, strict=True):
            variable.set(code.chosen(rough, value.get(), variable.get()))
    ended = array([variable.get() for variable in outcome])
    return ended[:n], ended[n : 2 * n], ended[2 * n]
