"""Physics step in code, by the stepping rules of `cranedyn.dynamics.integrators`.

A rule alone is a step of a smooth motion. Two things break that:

* A buffer or the ground is far stiffer than the rest of the crane. Where one is touched before or
  after the step, small semi-implicit steps replace it.
* A rope becomes taut or slack. The step is then divided at the instant at which it does.

Lanes run the same instructions. What only some lanes need is therefore computed for all lanes as
soon as one needs it, and taken over where it is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import Code, StackVariable, Value
from cranedyn.compiled.plant.plant import Plant
from cranedyn.compiled.plant.rigid_body import ExternalForce
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.dynamics.root_motion import RootMotion, interpolated_root
from cranedyn.dynamics.scalars import array, is_zero
from cranedyn.errors import OutOfRange

PHASE_CHANGES = 2
"""Changes between a taut and a slack rope that are looked for within a step."""

_ILLINOIS_STEPS = 10
"""Steps of the Illinois method to the instant at which the rope changes its phase."""


class _Number:
    """Placeholder for a number of the code, with which `check_rule` tries a stepping rule: sums and
    products are placeholders, too, and comparisons raise.
    """

    def _combine(self, operand: Any = None) -> _Number:
        """Return the result of an operation with any operand."""
        return self

    def _unknown(self, operand: Any = None) -> bool:
        """Refuse to compare: code has no value yet.

        Raises:
            TypeError: Always.
        """
        raise TypeError("the value of a number is not known while code is made")

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
    """State of a crane during a step.

    Attributes:
        q: Coordinates, shape (n,).
        v: Rates, shape (n,).
        works: Work since the start [J], shape (2,): that of buffers and ground, and that of impacts
            of the rope.
        anchors: Anchors of the points that may touch the ground [m], shape (3 points,); empty
            without ground.
    """

    q: np.ndarray
    v: np.ndarray
    works: np.ndarray
    anchors: np.ndarray = np.empty(0, dtype=object)

    @property
    def numbers(self) -> list[Any]:
        """All numbers, one after another."""
        return [*self.q, *self.v, *self.works, *self.anchors]

    def of(self, variables: list[StackVariable]) -> StepState:
        """Return the values of variables in the order of the numbers of a state."""
        values = array([variable.get() for variable in variables])
        n = len(self.q)
        first_anchor = 2 * n + len(self.works)
        return StepState(
            q=values[:n],
            v=values[n : 2 * n],
            works=values[2 * n : first_anchor],
            anchors=values[first_anchor:],
        )


class _RuleStep(NamedTuple):
    """Step by the rule alone.

    Attributes:
        state: State after the step.
        pulls: Force at each stage of the rule that is positive where a rope that may go slack
            pulls; None for any other rope.
    """

    state: StepState
    pulls: list[Any]


class _TautStep(NamedTuple):
    """Step with a taut inextensible rope.

    Attributes:
        state: State after the step.
        taut: Whether the rope is taut before it.
        lasts: Whether the rope is taut all the time.
    """

    state: StepState
    taut: ir.Value
    lasts: ir.Value


class _Trial(NamedTuple):
    """Attempt at a piece of a step, during which a rope stays taut or slack.

    Attributes:
        state: State after the piece.
        start_margin: Number for the start of the piece that is below zero where the rope is in
            another phase; at least 0, as the phase was right there up to round-off.
        end_margin: The same for the end of the piece.
        phase_lasts: Whether it is known that the rope stays in its phase.
    """

    state: StepState
    start_margin: Value
    end_margin: Value
    phase_lasts: ir.Value


@dataclass(frozen=True)
class Step:
    """A physics step.

    Attributes:
        integrator: The stepping rule.
        plant: The crane, in any units, see `Plant.in_steps`.
        command: Command of the drives.
        forces: External forces.
        dt: The step; 1 where time is counted in steps.
        unit: The plant's unit of work, see `Units.work` [J].
        substeps: Number of semi-implicit substeps that replace the step where the load touches the
            ground, or buffers act and the rule needs a smooth motion.
        reactions: Forces of the ground, which are constant during a substep.
        root: Motion of the base at the beginning, in the middle and at the end of the physics step,
            in the units of the plant, shape (3, 9), see
            `cranedyn.dynamics.root_motion.interpolated_root`; None for a base at rest.
        phase: Share of the physics step that has elapsed where this step begins: 0, but for a part
            of a physics step.
        span: Share of the physics step that this step takes.
    """

    integrator: Integrator
    plant: Plant
    command: np.ndarray
    forces: Any
    dt: Any
    unit: Any
    substeps: Any
    reactions: Sequence[ExternalForce] = ()
    root: np.ndarray | None = None
    phase: Any = 0.0
    span: Any = 1.0

    def after(self, state: StepState) -> StepState:
        """Return the state after the step."""
        plant = self.plant
        needs_smooth_motion = self.integrator.smooth
        if plant.contacts is None and not (plant.buffers and needs_smooth_motion):
            return self._in_phases(state)
        # First a step as if nothing were touched. Buffers stay in it if the rule bears them.
        buffers = plant.buffers and not needs_smooth_motion
        free = replace(self, plant=replace(plant, buffers=buffers, contacts=None))
        return self._where_contacts_act(state, free._in_phases(state))

    def _in_phases(self, state: StepState) -> StepState:
        """Return the state after the step, divided where a rope becomes taut or slack."""
        rope = self.plant.joint.rope
        if rope is None or not (rope.inextensible or self.integrator.smooth):
            return self._by_rule(state).state
        return self._where_rope_changes(state)

    def _by_rule(self, state: StepState, taut: Any = None) -> _RuleStep:
        """Return the step by the rule alone.

        Args:
            state: State before the step.
            taut: Whether the rope is taut all the time; None leaves that to the state.
        """
        plant = self._with_rope(taut)
        q, v, works, anchors = state
        pulls: list[Any] = []
        if self.root is None:
            q_after, v_after = self._at_rest(plant, q, v, pulls)
        else:
            q_after, v_after = self._on_base(plant, q, v, pulls)
        if plant.buffers:
            # Force at the start of the step times the mean of the rates before and after it.
            done = plant.stops.effort(q, v) @ (v + v_after)[plant.stops.drives]
            works = works + array([0.5 * self.dt * self.unit * done, 0.0])
        return _RuleStep(StepState(q_after, v_after, works, anchors), pulls)

    def _at_rest(
        self, plant: Plant, q: np.ndarray, v: np.ndarray, pulls: list[Any]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates after the step on a base at rest.

        Args:
            plant: The crane, with its rope in a phase.
            q: Coordinates before the step, shape (n,).
            v: Rates before the step, shape (n,).
            pulls: To which the pull of the rope at each stage of the rule is added.
        """

        def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
            dynamics = plant.forward_dynamics(q, v, self.command, self.forces, self.reactions)
            pulls.append(dynamics.pull)
            return dynamics.acceleration

        return self.integrator.rule(acceleration, self._add_acceleration, self._add_rate, q, v, 1)

    def _on_base(
        self, plant: Plant, q: np.ndarray, v: np.ndarray, pulls: list[Any]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates and rates after the step on a base that moves, see `_at_rest`.

        A rule knows no time. The elapsed share of the physics step is therefore one more
        coordinate, whose rate is 1, and the rule itself carries it to its stages.
        """

        def acceleration(q_and_phase: np.ndarray, v_and_one: np.ndarray) -> np.ndarray:
            dynamics = plant.forward_dynamics(
                q_and_phase[:-1],
                v_and_one[:-1],
                self.command,
                self.forces,
                self.reactions,
                self._root_at(q_and_phase[-1]),
            )
            pulls.append(dynamics.pull)
            return array([*dynamics.acceleration, 0.0])

        def add_acceleration(v_and_one: np.ndarray, a_and_zero: np.ndarray) -> np.ndarray:
            # No acceleration changes the rate of time.
            rates = self._add_acceleration(v_and_one[:-1], a_and_zero[:-1])
            return array([*rates, v_and_one[-1]])

        def add_rate(q_and_phase: np.ndarray, v_and_one: np.ndarray) -> np.ndarray:
            phase = q_and_phase[-1] + v_and_one[-1] * self.span
            return array([*self._add_rate(q_and_phase[:-1], v_and_one[:-1]), phase])

        q_after, v_after = self.integrator.rule(
            acceleration,
            add_acceleration,
            add_rate,
            array([*q, self.phase]),
            array([*v, 1.0]),
            1,
        )
        return q_after[:-1], v_after[:-1]

    def _add_acceleration(self, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return rates after the step under accelerations.

        All terms of an acceleration are summed up before they meet the rate. Added to it one by one
        the small ones would be lost: in single precision the damping of a swing is less than a
        rounding error of its rate.
        """
        increments = a * self.dt
        values = [number for number in (*v, *increments) if isinstance(number, Value)]
        if not values:
            return v + increments
        with values[0].code.in_order():
            return v + increments

    def _add_rate(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return coordinates after the step at rates."""
        moved = []
        for coordinate, increment in zip(q, v * self.dt, strict=True):
            if is_zero(coordinate):
                moved.append(increment)
            else:
                # Records the sum, so that sines and cosines are rotated by the increment.
                moved.append(coordinate.code.advanced(coordinate, increment))
        return array(moved)

    def _root_at(self, phase: Any) -> RootMotion | None:
        """Return the motion of the base where a share of the physics step has elapsed."""
        return None if self.root is None else interpolated_root(self.root, phase)

    def _with_rope(self, taut: Any) -> Plant:
        """Return the crane whose rope is in a phase; None leaves the phase to its state."""
        return replace(self.plant, joint=replace(self.plant.joint, taut=taut))

    def _where_contacts_act(self, before: StepState, smooth: StepState) -> StepState:
        """Return the state after a smooth step, replaced by that of small semi-implicit substeps
        where the load touches the ground, or a drive is beyond its range, before or after it.
        """
        code: Code = before.q[0].code
        plant = self.plant
        outcome = code.variables(smooth.numbers)
        touches = []
        for q in (before.q, smooth.q):
            if plant.buffers and self.integrator.smooth:
                touches += plant.stops.beyond(q)
            touches += plant.touching(q)
        touched = code.either(*touches)
        with code.when(code.anywhere(touched)):
            small_dt = self.dt / code.from_integer(self.substeps)
            substep = replace(self, integrator=semi_implicit_euler, dt=small_dt)
            state = code.variables(before.numbers)
            with code.loop(0, self.substeps) as number:
                if self.root is not None:
                    share = 1.0 / code.from_integer(self.substeps)
                    substep = replace(substep, phase=code.from_integer(number) * share, span=share)
                after = substep._on_ground(before.of(state))
                for variable, value in zip(state, after.numbers, strict=True):
                    variable.set(value)
            self._replace(outcome, touched, before.of(state).numbers)
        return before.of(outcome)

    def _on_ground(self, state: StepState) -> StepState:
        """Return the state after a step under the reactions of the ground at its start."""
        plant = self.plant
        q, v, _, anchors = state
        reactions, anchors = plant.ground_reactions(q, v, anchors)
        after = replace(self, reactions=reactions)._in_phases(state)
        if not reactions:
            return after
        # Forces times the mean of the rates before and after the step.
        work = 0.5 * self.dt * self.unit * plant.power(q, v + after.v, reactions)
        return after._replace(works=after.works + array([work, 0.0]), anchors=anchors)

    def _where_rope_changes(self, before: StepState) -> StepState:
        """Return the state after a step that is divided where the rope becomes taut or slack.

        All lanes take the step in their phase, those with a taut inextensible rope without its
        joint, then those with a slack one. Where the phase does not last, all lanes take the step
        again, in pieces.
        """
        code: Code = before.q[0].code
        rope = self.plant.joint.rope
        assert rope is not None
        if rope.inextensible:
            smooth, taut, lasts = self._as_taut(before, rope.stretch)
        else:
            taut = self.plant.joint.pull(before.q, before.v) > 0.0
            smooth = self._by_rule(before, taut=taut).state
            taut_after = self.plant.joint.pull(smooth.q, smooth.v) > 0.0
            lasts = code.builder.icmp_unsigned("==", taut, taut_after)

        # The coordinates of the outcome are increments, by which sines and cosines are rotated at
        # the end, whichever way a lane came to them.
        increments = []
        for coordinate_after, coordinate in zip(smooth.q, before.q, strict=True):
            increments.append(code.increment(coordinate_after, coordinate))
        outcome = code.variables(smooth._replace(q=array(increments)).numbers)
        changes = code.builder.not_(lasts)
        if rope.inextensible:
            changes = self._replace_where_slack(outcome, before, taut, lasts, rope.stretch)
        with code.when(code.anywhere(changes)):
            pieces = self._in_pieces(before, taut)
            self._replace(outcome, changes, pieces._replace(q=pieces.q - before.q).numbers)
        after = before.of(outcome)
        moved = []
        for coordinate, increment in zip(before.q, after.q, strict=True):
            moved.append(code.advanced(coordinate, increment))
        return after._replace(q=array(moved))

    def _as_taut(self, before: StepState, stretch: int) -> _TautStep:
        """Return the step with a taut inextensible rope, whose end is at the coordinate of a joint:
        0 where the rope is taut and below 0 where it is slack.
        """
        code: Code = before.q[0].code
        q, v, works, anchors = before
        q = q.copy()
        v = v.copy()
        q[stretch] = 0.0
        v[stretch] = 0.0
        smooth, pulls = self._by_rule(StepState(q, v, works, anchors), taut=True)
        loose = code.either(before.q[stretch] < 0.0, before.v[stretch] < 0.0)
        taut = code.both(code.builder.not_(loose), pulls[0] > 0.0)
        lasts = code.both(taut, *(pull > 0.0 for pull in pulls))
        return _TautStep(smooth, taut, lasts)

    def _replace_where_slack(
        self,
        outcome: list[StackVariable],
        before: StepState,
        taut: ir.Value,
        stays_taut: ir.Value,
        stretch: int,
    ) -> ir.Value:
        """Replace the outcome of a step where an inextensible rope is slack all the time.

        Args:
            outcome: Variables of the state after the step, whose coordinates are increments.
            before: State before the step.
            taut: Whether the rope is taut before it.
            stays_taut: Whether it is taut all the time.
            stretch: Joint of the end of the rope.

        Returns:
            Whether the rope changes its phase within the step.
        """
        code: Code = before.q[0].code
        (lasts,) = code.variables([code.where(stays_taut, 1.0, 0.0)])
        slack = code.builder.not_(taut)
        with code.when(code.anywhere(slack)):
            loose_end = self._by_rule(before, taut=False).state
            stays_slack = code.both(slack, loose_end.q[stretch] < 0.0)
            numbers = loose_end._replace(q=loose_end.q - before.q).numbers
            self._replace([*outcome, lasts], stays_slack, [*numbers, 1.0])
        return lasts.get() < 0.5

    def _in_pieces(self, before: StepState, taut: Any) -> StepState:
        """Return the state after a step in pieces, in each of which the rope is taut or slack.

        A piece is the rest of the step, unless the rope changes within. Then the time of the change
        is found as a zero of the margin, see `_Trial`: it is positive while the phase is right. The
        bracket [a, b] begins with no time and the rest of the step. Each step of the method of
        false position tries the time at which the line through both margins is zero,

            a + (b - a) f(a) / (f(a) - f(b)),

        and makes it the new end of the bracket on its side of the zero. Where the same end stays
        for a second time, its margin is halved, so that both ends close in: that is the Illinois
        method (Dowell and Jarratt 1971, "A modified regula falsi method for computing the root of
        an equation"). After `_ILLINOIS_STEPS` the piece up to the time that was tried last is
        taken, the phase changes, and the rest of the step follows.

        Each pass of the loop tries one piece in every lane, which may be at another point of the
        method than its neighbours. All decisions are therefore choices, and not branches. Of a
        lane,

        * `rest` is what is left of the step, and `time` the piece that is tried next;
        * `phase` is 1 where the rope is taut, else 0;
        * `low`, `high` are the ends a and b of the bracket, 0 without one, and `low_margin`,
          `high_margin` the margins there;
        * `side` is 1 if the last try replaced a, -1 if it replaced b, and 0 without a bracket;
        * `tries` counts the steps of the method, and `changes` those of the phase.
        """
        code: Code = before.q[0].code
        state = code.variables(before.numbers)
        rest, time, phase = code.variables([self.dt, self.dt, code.where(taut, 1.0, 0.0)])
        low, low_margin, high, high_margin, side, tries, changes = code.variables([0.0] * 7)
        with (
            code.loop(0, PHASE_CHANGES * (_ILLINOIS_STEPS + 1) + 1),
            code.when(code.anywhere(rest.get() > 0.0)),
        ):
            trying = time.get()
            left = rest.get()
            is_taut = phase.get() > 0.5
            bracketed = high.get() > 0.0
            piece = replace(self, dt=trying)
            if self.root is not None:
                elapsed = (self.dt - left) / self.dt * self.span
                share = trying / self.dt * self.span
                piece = replace(piece, phase=self.phase + elapsed, span=share)
            trial = piece._trial(before.of(state), is_taut)
            margin = trial.end_margin

            # The piece fails where the rope is in another phase at its end. After too many changes
            # of the phase the rest is taken as it is.
            new = code.builder.not_(bracketed)
            active = code.both(left > 0.0, code.either(bracketed, changes.get() < PHASE_CHANGES))
            fails = code.both(
                active,
                margin < 0.0,
                code.either(bracketed, code.builder.not_(trial.phase_lasts)),
            )
            holds = code.both(left > 0.0, code.builder.not_(fails))
            # The whole rest without a change ends the step.
            ends = code.both(new, holds)
            replaces_a = code.both(bracketed, holds)
            replaces_b = code.both(bracketed, fails)
            count = code.where(new, 0.0, tries.get() + 1.0)
            found = code.both(left > 0.0, count >= float(_ILLINOIS_STEPS))

            # The bracket [a, b] and the margins at its ends.
            a = code.where(replaces_a, trying, low.get())
            b = code.where(fails, trying, high.get())
            a_stays_again = code.both(replaces_b, side.get() < 0.0)
            kept_at_a = code.where(a_stays_again, 0.5 * low_margin.get(), low_margin.get())
            kept_or_first_at_a = code.where(new, trial.start_margin, kept_at_a)
            at_a = code.where(replaces_a, margin, kept_or_first_at_a)
            b_stays_again = code.both(replaces_a, side.get() > 0.0)
            kept_at_b = code.where(b_stays_again, 0.5 * high_margin.get(), high_margin.get())
            at_b = code.where(fails, margin, kept_at_b)

            remaining = code.where(ends, 0.0, code.where(found, left - trying, left))
            updates = {
                rest: remaining,
                time: code.where(found, remaining, a + (b - a) * at_a / (at_a - at_b)),
                phase: code.where(found, 1.0 - phase.get(), phase.get()),
                low: code.where(found, 0.0, a),
                low_margin: at_a,
                high: code.where(found, 0.0, b),
                high_margin: at_b,
                side: code.where(replaces_a, 1.0, code.where(replaces_b, -1.0, 0.0)),
                tries: count,
                changes: changes.get() + code.where(found, 1.0, 0.0),
            }
            self._replace(state, code.either(ends, found), trial.state.numbers)
            for variable, value in updates.items():
                variable.set(value)
            rope = self.plant.joint.rope
            if rope is not None and rope.inextensible:
                hits = code.both(found, code.builder.not_(is_taut))
                with code.when(code.anywhere(hits)):
                    self._replace(state, hits, self._after_impact(before.of(state), rope.stretch))
        return before.of(state)

    def _after_impact(self, state: StepState, stretch: int) -> list[Any]:
        """Return the numbers of a state after an inextensible rope has become taut with an impact.

        Args:
            state: State before the impact.
            stretch: Joint of the end of the rope.
        """
        q, v, works, anchors = state
        q[stretch] = 0.0
        v, gained = self.plant.impact(q, v)
        works[1] = works[1] + self.unit * gained
        return StepState(q, v, works, anchors).numbers

    def _trial(self, start: StepState, taut: Any) -> _Trial:
        """Try a piece in which the rope is taut where a condition holds, and slack elsewhere."""
        trial, pulls = self._by_rule(start, taut=taut)
        code: Code = start.numbers[0].code
        joint = self.plant.joint
        rope = joint.rope
        assert rope is not None

        def margin(pull: Any, state: StepState) -> Value:
            # A taut rope pulls. A slack one is shorter than its length or, if it is elastic, would
            # have to push.
            if rope.inextensible:
                return code.where(taut, pull, -state.q[rope.stretch])
            return code.where(taut, pull, -pull)

        end_pull = joint.pull(trial.q, trial.v)
        phase_lasts = code.both(False)
        if rope.inextensible:
            plant = self._with_rope(taut)
            end_pull = plant.forward_dynamics(
                trial.q,
                trial.v,
                self.command,
                self.forces,
                self.reactions,
                self._root_at(self.phase + self.span),
            ).pull
            phase_lasts = code.both(taut, *(pull > 0.0 for pull in pulls))
        start_margin = code.call("llvm.maxnum", margin(pulls[0], start), 0.0)
        return _Trial(trial, start_margin, margin(end_pull, trial), phase_lasts)

    @staticmethod
    def _replace(variables: list[StackVariable], where: ir.Value, values: list[Any]) -> None:
        """Assign values to variables in the lanes where a condition holds."""
        for variable, value in zip(variables, values, strict=True):
            old = variable.get()
            variable.set(old.code.where(where, value, old))
