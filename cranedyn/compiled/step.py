"""Physics step in code, by the stepping rules of `cranedyn.dynamics.integrators`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from cranedyn.compiled.code import Code, StackVariable
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


class StepState(NamedTuple):
    """Coordinates, rates, work of the buffers and of the ground so far [J], and anchors of the
    points that touch it [m], shape (3 points,).
    """

    q: np.ndarray
    v: np.ndarray
    work: Any
    anchors: np.ndarray = np.empty(0, dtype=object)

    @property
    def numbers(self) -> list[Any]:
        """All numbers."""
        return [*self.q, *self.v, self.work, *self.anchors]

    def of(self, variables: list[StackVariable]) -> StepState:
        """Return the values of variables in the order of the numbers of a state."""
        n, values = len(self.q), array([variable.get() for variable in variables])
        return StepState(values[:n], values[n : 2 * n], values[2 * n], values[2 * n + 1 :])


@dataclass(frozen=True)
class Step:
    """A physics step.

    Attributes:
        integrator: The stepping rule.
        plant: The crane, in any units, see `Plant.in_steps`.
        command: Command of the drives.
        forces: External forces.
        dt: The step; 1 where time is counted in steps.
        unit: The plant's unit of work [J].
        substeps: Number of semi-implicit substeps that replace the step where the load touches the
            ground, or buffers act and the rule needs a smooth motion.
    """

    integrator: Integrator
    plant: Plant
    command: np.ndarray
    forces: Any
    dt: Any
    unit: Any
    substeps: Any

    def after(self, state: StepState) -> StepState:
        """Return the state after the step."""
        plant, smooth = self.plant, self.integrator.smooth
        if plant.contacts is None and not (plant.buffers and smooth):
            return self._by_rule(state)
        buffers = plant.buffers and not smooth
        free = replace(self, plant=replace(plant, buffers=buffers, contacts=None))
        return self._where_contacts_act(state, free._by_rule(state))

    def _by_rule(self, state: StepState) -> StepState:
        plant, dt = self.plant, self.dt
        reactions, anchors = plant.ground_reactions(state.q, state.v, state.anchors)

        def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            return plant.answer(q, v, self.command, self.forces, reactions)[0]

        def speed_up(v: np.ndarray, a: np.ndarray) -> np.ndarray:
            return v + a * dt

        def move(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            return array([x.code.advanced(x, by) for x, by in zip(q, v * dt, strict=True)])

        q, v, work, _ = state
        q_after, faster = self.integrator.rule(acceleration, speed_up, move, q, v, 1)
        if plant.buffers:
            done = plant.stops.effort(q, v) @ (v + faster)[plant.stops.drives]
            work = work + 0.5 * dt * self.unit * done
        if reactions:
            work = work + 0.5 * dt * self.unit * plant.power(q, v + faster, reactions)
        return StepState(q_after, faster, work, anchors)

    def _where_contacts_act(self, before: StepState, smooth: StepState) -> StepState:
        """Return the state after a smooth step, replaced by that of small semi-implicit substeps
        where the load touches the ground, or a drive is beyond its range, before or after it.
        """
        code: Code = before.q[0].code
        plant, smooth_rule = self.plant, self.integrator.smooth
        outcome = code.variables(smooth.numbers)
        beyond = plant.stops.beyond if plant.buffers and smooth_rule else lambda q: []
        rough = code.either(
            *(flag for q in (before.q, smooth.q) for flag in (*beyond(q), *plant.touching(q)))
        )
        with code.when(code.anywhere(rough)):
            fine = self.dt / code.from_integer(self.substeps)
            substep = replace(self, integrator=semi_implicit_euler, dt=fine)
            state = code.variables(before.numbers)
            with code.loop(0, self.substeps):
                after = substep._by_rule(before.of(state))
                for variable, value in zip(state, after.numbers, strict=True):
                    variable.set(value)
            for variable, value in zip(outcome, state, strict=True):
                variable.set(code.chosen(rough, value.get(), variable.get()))
        return before.of(outcome)
