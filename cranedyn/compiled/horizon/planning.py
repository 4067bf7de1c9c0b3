"""One optimisation in code: shift the last plan, linearise along it, solve, store the new plan.

This is one real-time iteration (Diehl, Bock and Schlöder 2005, "A real-time iteration scheme for
nonlinear optimization in optimal feedback control").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.code import INTEGER, Value
from cranedyn.compiled.horizon import riccati
from cranedyn.compiled.horizon.memory import Constants, HorizonShape, Programme, Work
from cranedyn.dynamics.scalars import array, larger, smaller

_MAX_FINITE = 1e300
"""Magnitude below which a number of a plan counts as finite."""

_BARRIER_GROWTH = 10.0
"""Factor on the initial barrier for the first optimisation, and after each failure.

With a larger barrier an optimisation begins farther from its bounds, from where it gets away more
easily when the last plan is a bad guess.
"""

_MAX_BARRIER_GROWTH = 100.0
"""Largest initial barrier after failures, as a multiple of the usual one."""


class SolverStatus(NamedTuple):
    """Outcome of the optimisations so far.

    They are the first numbers of the last row of a plan, since nothing but the plan passes from one
    optimisation to the next.

    Attributes:
        begun: 1 after the first optimisation, else 0.
        failures: Number of optimisations that failed, after each of which the last plan goes on.
        solved: 1 if the last optimisation succeeded, else 0.
        iterations: Iterations of the last optimisation; 0 if no bound was active.
        excess: Largest excess of a bound at the optimum without bounds, negative for none.
        barrier: Initial barrier of the next optimisation.
    """

    begun: Any
    failures: Any
    solved: Any
    iterations: Any
    excess: Any
    barrier: Any


def emit(
    module: ir.Module, shape: HorizonShape, programme: Programme, constants: Constants
) -> None:
    """Add the function `plan`.

    Its arguments, all of them addresses:

    * `work`: the memory of an optimisation;
    * `plan`: the last plan, which it replaces: a row of states and inputs for each stage, and a row
      of `SolverStatus`;
    * `query`: the state; 1, or 0 if that is implausible; and the present row of the path, a whole
      number;
    * `path`: rows of coordinates and rates along the path, or those of the goal of each crane.

    Args:
        module: Module to which it is added.
        shape: Dimensions of the optimisation.
        programme: Parameters of the controller.
        constants: Numbers that are the same in every stage.
    """
    arguments = ("plan", "query", "path")
    _Plan(Work(module, "plan", shape, constants, arguments), programme).emit()


class _Plan:
    """The function `plan` under construction."""

    def __init__(self, work: Work, programme: Programme) -> None:
        self.work = work
        self.code = work.code
        self.shape = work.shape
        self.shared = work.shared
        self.programme = programme
        self.plant = programme.plant
        self.layout = self.plant.topology.layout
        # Numbers of all cranes in a row of the plan.
        self.row_size = self.shape.row_length * self.shape.cranes

    def emit(self) -> None:
        """Emit the whole function."""
        code = self.code
        work = self.work
        states = self.shape.states
        query = [code.load(code.argument["query"], i * code.lanes) for i in range(states + 1)]
        state = array(query[:states])
        is_plausible = query[states] > 0.5
        self.shared.put_row("start", state)
        is_first = self._previous_status("begun") < 0.5
        first_barrier = _BARRIER_GROWTH * work.reported("usual_barrier")
        work.put_report(
            "barrier", code.where(is_first, first_barrier, self._previous_status("barrier"))
        )
        with code.when(code.anywhere(is_first)):
            self._plan_standstill(is_first, state)
        self._shift_plan()

        # Without a plausible state nothing is optimised, and the shifted plan goes on.
        with code.when(code.anywhere(is_plausible)):
            self._solve()
        solved = code.where(is_plausible, work.reported("solved"), 0.0)
        iterations = code.where(is_plausible, work.reported("iterations"), 0.0)
        excess = code.where(is_plausible, work.reported("excess"), 0.0)
        work.put_report("solved", solved)
        work.put_report("iterations", iterations)
        work.put_report("excess", excess)
        self._store_plan(is_plausible)
        code.end()

    def _solve(self) -> None:
        """Make the quadratic programme about the nodes, and solve it.

        The functions that it calls are those of `horizon_model`, `riccati` and `interior`, on the
        memory of the optimisation.
        """
        work = self.work
        shared = self.shared
        states = self.shape.states
        first_stage = work.stage(self.code.integer(0))
        first_stage.put_row("node", shared.row("start", states))
        self._put_cost()
        self._put_swing_bounds()
        work.call("linearise")
        work.call("end")
        # The cost beyond the horizon is ½ (x - goal)ᵀ end (x - goal).
        pull = riccati.symmetric(shared, "end", states) @ shared.row("goal", states)
        shared.put_row("end_gradient", -pull)
        work.call("solve")

    def _previous_status(self, name: str) -> Value:
        """Load a number of the `SolverStatus` after the last optimisation."""
        last_row = self.shape.stages * self.row_size
        offset = last_row + SolverStatus._fields.index(name) * self.code.lanes
        return self.code.load(self.code.argument["plan"], offset)

    def _plan_standstill(self, is_first: ir.Value, state: np.ndarray) -> None:
        """Give the cranes without a plan one that stands still where they are.

        Args:
            is_first: Whether a crane has no plan yet, for each lane.
            state: State of the crane, shape (2 n,).
        """
        code = self.code
        plan = code.argument["plan"]
        with code.loop(0, self.shape.stages) as k:
            for i in range(self.shape.variables):
                offset = code.plus(code.product(k, self.row_size), i * code.lanes)
                at_rest = state[i] if i < self.layout.n else 0.0
                code.store(code.where(is_first, at_rest, code.load(plan, offset)), plan, offset)

    def _shift_plan(self) -> None:
        """Set the nodes of linearisation to the last plan, shifted to the present time.

        The time between optimisations is j + s stages, with a whole number j and a share s < 1.
        The node of stage k is interpolated in the last plan: (1 - s) plan[k + j] + s plan[k + j +
        1]. Beyond the end of the plan its last stage stays.
        """
        code = self.code
        wide = self.work.wide
        plan = code.argument["plan"]
        programme = self.programme
        stages_passed, share = divmod(
            programme.ratio * programme.period / programme.stage_length, 1.0
        )
        last = code.integer(self.shape.stages - 1)
        with self.work.each_vector() as vector:
            before = code.least(code.plus(vector.stage, int(stages_passed)), last)
            after = code.least(code.plus(before, 1), last)
            place_before = code.builder.add(code.product(before, self.row_size), vector.first)
            place_after = code.builder.add(code.product(after, self.row_size), vector.first)
            node_before = wide.load(plan, place_before)
            node_after = wide.load(plan, place_after)
            vector.rows.put("node", (1.0 - share) * node_before + share * node_after)

    def _put_cost(self) -> None:
        """Store the weight of the states, and the gradient of the cost of each stage.

        With the states and inputs z of a stage, and those of the path z*, the cost is
        ½ (z - z*)ᵀ weight (z - z*): its gradient at z = 0 is - weight z*. The inputs of the path
        are the accelerations of its drives over the stage, by the difference of their rates. The
        weight depends on where the payload is, see
        `horizon_model.emit_weights`: it is that at the end of
        the path, for all stages.
        """
        code = self.code
        shape = self.shape
        shared = self.shared
        row = code.load_one(code.argument["query"], (shape.states + 1) * code.lanes, INTEGER)
        shared.put_row("goal", self._target(row, code.integer(shape.stages)))
        self.work.call("weigh")
        with code.loop(0, shape.stages) as k:
            now = self._target(row, k)
            coming = self._target(row, code.plus(k, 1))
            rate_columns = self.layout.n + self.layout.drives
            accelerations = (coming - now)[rate_columns] * (1.0 / self.programme.stage_length)
            target = np.concatenate([now, accelerations])
            self.work.stage(k).put_row(
                "gradient", -(shared.table("weight", shape.variables) @ target)
            )

    def _target(self, row: ir.Value, k: ir.Value) -> np.ndarray:
        """Return the state where the crane should be at the beginning of a stage, shape (2 n,): on
        the path, whose last row holds beyond its end, or at the goal.

        Args:
            row: Present row of the path.
            k: Number of the stage.
        """
        code = self.code
        programme = self.programme
        states = self.shape.states
        path = code.argument["path"]
        if not programme.rows:
            return array([code.load(path, i * code.lanes) for i in range(states)])
        row_of_stage = code.builder.add(row, code.product(k, programme.path_rows_per_stage))
        last_row = code.integer(programme.rows - 1)
        first = code.product(code.least(row_of_stage, last_row), states)
        return array([code.spread(path, code.plus(first, i)) for i in range(states)])

    def _put_swing_bounds(self) -> None:
        """Store the bounds of swing joints whose rest depends on the drives: the largest swing
        about the present rest, the rest at the goal, and between.

        Where the load hangs plumb at zero, the bounds are the same all the time and are in memory
        already.
        """
        if self.plant.plumb_at_zero:
            return
        layout = self.layout
        limit = self.programme.swing_limit
        rest_at_start = self.plant.hanging_angles(self.shared.row("start", layout.n)[layout.drives])
        rest_at_goal = self.plant.hanging_angles(self.shared.row("goal", layout.n)[layout.drives])
        swings = zip(self.plant.topology.swings, rest_at_start, rest_at_goal, strict=True)
        for (joint, _), at_start, at_goal in swings:
            self.shared.put("low", smaller(at_start, at_goal) - limit, i=joint)
            self.shared.put("high", larger(at_start, at_goal) + limit, i=joint)

    def _store_plan(self, is_plausible: ir.Value) -> None:
        """Store the new plan and the status; after a failure the shifted last plan goes on.

        Args:
            is_plausible: Whether there was a plausible state, for each lane. Without one, an
                optimisation counts as failed.
        """
        code = self.code
        wide = self.work.wide
        work = self.work
        plan = code.argument["plan"]
        # A number that is not finite stays so in all later stages: the last one shows it.
        last_stage = work.stage(code.integer(self.shape.stages - 1))
        is_finite = []
        for number in last_stage.row("iterate", self.shape.variables):
            is_finite.append(abs(number) < _MAX_FINITE)
        is_solved = code.both(work.reported("solved") > 0.5, *is_finite)
        takes_new_plan = work.in_all_lanes(code.where(is_solved, 1.0, 0.0)) > 0.5
        with work.each_vector() as vector:
            place = code.builder.add(code.product(vector.stage, self.row_size), vector.first)
            iterate = vector.rows.get("iterate")
            node = vector.rows.get("node")
            wide.store(wide.where(takes_new_plan, iterate, node), plan, place)

        usual_barrier = work.reported("usual_barrier")
        barrier = work.reported("barrier")
        begun = code.where(is_plausible, 1.0, self._previous_status("begun"))
        failures = self._previous_status("failures") + code.where(is_solved, 0.0, 1.0)
        solved = code.where(is_solved, 1.0, 0.0)
        iterations = work.reported("iterations")
        excess = work.reported("excess")
        barrier_after_failure = smaller(
            _BARRIER_GROWTH * barrier, _MAX_BARRIER_GROWTH * usual_barrier
        )
        next_barrier = code.where(is_solved, usual_barrier, barrier_after_failure)
        status = SolverStatus(begun, failures, solved, iterations, excess, next_barrier)
        for i, value in enumerate(status):
            offset = self.shape.stages * self.row_size + i * code.lanes
            code.store(value, plan, offset)
