"""Physics step in code, by the stepping rules of `cranedyn.dynamics.integrators`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import Code, StackVariable, Value
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.scalars import array, is_zero
from cranedyn.errors import OutOfRange
from cranedyn.plant.plant import Plant
from cranedyn.plant.rigid_body import ExternalForce
from cranedyn.simulation.engine import PHASE_CHANGES

_TRIES = 10
"""Steps of the Illinois method to the instant at which the rope changes its phase."""


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


@cache
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
    """Coordinates, rates, work of buffers and ground and of impacts of the rope so far [J], shape
    (2,), and anchors of the points that may touch the ground [m], shape (3 points,).
    """

    q: np.ndarray
    v: np.ndarray
    works: np.ndarray
    anchors: np.ndarray = np.empty(0, dtype=object)

    @property
    def numbers(self) -> list[Any]:
        """All numbers."""
        return [*self.q, *self.v, *self.works, *self.anchors]

    def of(self, variables: list[StackVariable]) -> StepState:
        """Return the values of variables in the order of the numbers of a state."""
        n, values = len(self.q), array([variable.get() for variable in variables])
        return StepState(*np.split(values, [n, 2 * n, 2 * n + len(self.works)]))


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
        reactions: Forces of the ground, which are constant during a substep.
    """

    integrator: Integrator
    plant: Plant
    command: np.ndarray
    forces: Any
    dt: Any
    unit: Any
    substeps: Any
    reactions: Sequence[ExternalForce] = ()

    def after(self, state: StepState) -> StepState:
        """Return the state after the step."""
        plant, smooth = self.plant, self.integrator.smooth
        if plant.contacts is None and not (plant.buffers and smooth):
            return self._in_phases(state)
        buffers = plant.buffers and not smooth
        free = replace(self, plant=replace(plant, buffers=buffers, contacts=None))
        return self._where_contacts_act(state, free._in_phases(state))

    def _in_phases(self, state: StepState) -> StepState:
        """Return the state after the step, divided where a rope becomes taut or slack."""
        rope = self.plant.joint.rope
        if rope is None or not (rope.inextensible or self.integrator.smooth):
            return self._by_rule(state)[0]
        return self._where_rope_changes(state)

    def _by_rule(self, state: StepState, taut: Any = None) -> tuple[StepState, list[Any]]:
        """Return the state after the step, and the pull of the rope at each stage of the rule;
        taut fixes the phase of the rope.
        """
        plant, dt = self._with_rope(taut), self.dt
        pulls = []

        def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            answer = plant.answer(q, v, self.command, self.forces, self.reactions)
            pulls.append(answer.pull)
            return answer.acceleration

        def speed_up(v: np.ndarray, a: np.ndarray) -> np.ndarray:
            return v + a * dt

        def move(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            sums = zip(q, v * dt, strict=True)
            return array([x + by if is_zero(x) else x.code.advanced(x, by) for x, by in sums])

        q, v, works, anchors = state
        q_after, faster = self.integrator.rule(acceleration, speed_up, move, q, v, 1)
        if plant.buffers:
            done = plant.stops.effort(q, v) @ (v + faster)[plant.stops.drives]
            works = works + array([0.5 * dt * self.unit * done, 0.0])
        return StepState(q_after, faster, works, anchors), pulls

    def _with_rope(self, taut: Any) -> Plant:
        return replace(self.plant, joint=replace(self.plant.joint, taut=taut))

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
                after = substep._on_ground(before.of(state))
                for variable, value in zip(state, after.numbers, strict=True):
                    variable.set(value)
            self._replace(outcome, rough, before.of(state).numbers)
        return before.of(outcome)

    def _on_ground(self, state: StepState) -> StepState:
        """Return the state after a step under the reactions of the ground at its start."""
        plant, (q, v, _, anchors) = self.plant, state
        reactions, anchors = plant.ground_reactions(q, v, anchors)
        after = replace(self, reactions=reactions)._in_phases(state)
        if not reactions:
            return after
        work = 0.5 * self.dt * self.unit * plant.power(q, v + after.v, reactions)
        return after._replace(works=after.works + array([work, 0.0]), anchors=anchors)

    def _where_rope_changes(self, before: StepState) -> StepState:
        """Return the state after a step that is divided where the rope becomes taut or slack.

        All lanes take the step in their phase, those with a taut inextensible rope without its
        joint, then those with a slack one. Where that does not do, all lanes take it again, in
        pieces.
        """
        code: Code = before.q[0].code
        rope, (q, v, works, anchors) = self.plant.joint.rope, before
        assert rope is not None
        if rope.inextensible:
            s = rope.stretch
            q, v = q.copy(), v.copy()
            q[s] = v[s] = 0.0
            smooth, pulls = self._by_rule(StepState(q, v, works, anchors), taut=True)
            loose = code.either(before.q[s] < 0.0, before.v[s] < 0.0)
            taut = code.both(code.builder.not_(loose), pulls[0] > 0.0)
            lasts = code.both(taut, *(pull > 0.0 for pull in pulls))
        else:
            taut = self.plant.joint.pull(q, v) > 0.0
            smooth = self._by_rule(before, taut=taut)[0]
            after = self.plant.joint.pull(smooth.q, smooth.v) > 0.0
            lasts = code.builder.icmp_unsigned("==", taut, after)
        increments = [code.increment(*pair) for pair in zip(smooth.q, before.q, strict=True)]
        outcome = code.variables(smooth._replace(q=array(increments)).numbers)
        changes = code.builder.not_(lasts)
        if rope.inextensible:
            (known,) = code.variables([code.chosen(lasts, 1.0, 0.0)])
            slack = code.builder.not_(taut)
            with code.when(code.anywhere(slack)):
                loose_end = self._by_rule(before, taut=False)[0]
                stays = code.both(slack, loose_end.q[rope.stretch] < 0.0)
                numbers = loose_end._replace(q=loose_end.q - before.q).numbers
                self._replace([*outcome, known], stays, [*numbers, 1.0])
            changes = known.get() < 0.5
        with code.when(code.anywhere(changes)):
            pieces = self._in_pieces(before, taut)
            self._replace(outcome, changes, pieces._replace(q=pieces.q - before.q).numbers)
        after = before.of(outcome)
        moved = map(code.advanced, before.q, after.q)  # which updates sines and cosines
        return after._replace(q=array([*moved]))

    def _in_pieces(self, before: StepState, taut: Any) -> StepState:
        """Return the state after a step in pieces, in each of which the rope is taut or slack.

        A piece is the rest of the step, unless the rope changes within; the time of that is found
        by the Illinois method, from a bracket whose upper end is that rest.
        """
        code: Code = before.q[0].code
        state = code.variables(before.numbers)
        rest, time, phase = code.variables([self.dt, self.dt, code.chosen(taut, 1.0, 0.0)])
        low, low_margin, high, high_margin, side, tries, changes = code.variables([0.0] * 7)
        with (
            code.loop(0, PHASE_CHANGES * (_TRIES + 1) + 1),
            code.when(code.anywhere(rest.get() > 0.0)),
        ):
            trying, left = time.get(), rest.get()
            taut, bracketed = phase.get() > 0.5, high.get() > 0.0
            piece = replace(self, dt=trying)
            trial, start_margin, margin, lasts = piece._trial(before.of(state), taut)
            new = code.builder.not_(bracketed)
            active = code.both(left > 0.0, code.either(bracketed, changes.get() < PHASE_CHANGES))
            fails = code.both(
                active, margin < 0.0, code.either(bracketed, code.builder.not_(lasts))
            )
            holds = code.both(left > 0.0, code.builder.not_(fails))
            ends, above = code.both(new, holds), code.both(bracketed, holds)
            below = code.both(bracketed, fails)
            count = code.chosen(new, 0.0, tries.get() + 1.0)
            found = code.both(left > 0.0, count >= float(_TRIES))

            def halved(variable: StackVariable, again: ir.Value) -> Value:
                return code.chosen(again, 0.5 * variable.get(), variable.get())

            a = code.chosen(above, trying, low.get())
            b = code.chosen(fails, trying, high.get())
            at_a = halved(low_margin, code.both(below, side.get() < 0.0))
            at_a = code.chosen(above, margin, code.chosen(new, start_margin, at_a))
            at_b = halved(high_margin, code.both(above, side.get() > 0.0))
            at_b = code.chosen(fails, margin, at_b)
            over = code.chosen(ends, 0.0, code.chosen(found, left - trying, left))
            updates = {
                rest: over,
                time: code.chosen(found, over, a + (b - a) * at_a / (at_a - at_b)),
                phase: code.chosen(found, 1.0 - phase.get(), phase.get()),
                low: code.chosen(found, 0.0, a),
                low_margin: at_a,
                high: code.chosen(found, 0.0, b),
                high_margin: at_b,
                side: code.chosen(above, 1.0, code.chosen(below, -1.0, 0.0)),
                tries: count,
                changes: changes.get() + code.chosen(found, 1.0, 0.0),
            }
            self._replace(state, code.either(ends, found), trial.numbers)
            for variable, value in updates.items():
                variable.set(value)
            rope = self.plant.joint.rope
            if rope is not None and rope.inextensible:
                hits = code.both(found, code.builder.not_(taut))
                with code.when(code.anywhere(hits)):
                    q, v, works, anchors = before.of(state)
                    q[rope.stretch] = 0.0
                    v, gained = self.plant.impact(q, v)
                    works[1] = works[1] + self.unit * gained
                    self._replace(state, hits, StepState(q, v, works, anchors).numbers)
        return before.of(state)

    def _trial(self, start: StepState, taut: Any) -> tuple[StepState, Any, Any, Any]:
        """Return the state after a piece, a number for its start and one for its end that is below
        zero where the rope is in another phase, and whether it is known that its phase lasts.
        """
        trial, pulls = self._by_rule(start, taut=taut)
        code, rope, joint = start.numbers[0].code, self.plant.joint.rope, self.plant.joint
        assert rope is not None

        def margin(pull: Any, at: StepState) -> Value:
            return code.chosen(taut, pull, -at.q[rope.stretch] if rope.inextensible else -pull)

        end, lasts = joint.pull(trial.q, trial.v), code.both(False)
        if rope.inextensible:
            plant = self._with_rope(taut)
            end = plant.answer(trial.q, trial.v, self.command, self.forces, self.reactions).pull
            lasts = code.both(taut, *(pull > 0.0 for pull in pulls))
        at_start = code.call("llvm.maxnum", margin(pulls[0], start), 0.0)
        return trial, at_start, margin(end, trial), lasts

    @staticmethod
    def _replace(variables: list[StackVariable], where: ir.Value, values: list[Any]) -> None:
        for variable, value in zip(variables, values, strict=True):
            old = variable.get()
            variable.set(old.code.chosen(where, value, old))
