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

_HUGE = 1e300
"""Bound of all numbers of a finite plan."""

_WIDER = 10.0
"""Factor on the barrier for the first optimisation and after each failure."""

_WIDEST = 100.0
"""Largest value of that factor."""


class Marks(NamedTuple):
    """First numbers of the last row of a plan: the outcome of the optimisations so far.

    Only the plan passes from one optimisation to the next.

    Attributes:
        begun: 1 after the first one.
        failures: Number of failures, after which the last plan continues.
        flag: 1 if the last one succeeded.
        iterations: Iterations of the last one; 0 if no bound was active.
        excess: Largest excess of a bound at the optimum without bounds, negative for none.
        barrier: Initial barrier of the next one.
    """

    begun: Any
    failures: Any
    flag: Any
    iterations: Any
    excess: Any
    barrier: Any


def emit(
    module: ir.Module, shape: HorizonShape, programme: Programme, constants: Constants
) -> None:
    """Add the function `plan`.

    Its arguments: memory of an optimisation; a plan, rows of states and inputs by stage and a row
    of `Marks`; a query, the state, 1 or 0 for an implausible state, and the present row of the
    path; a path, rows of coordinates and rates where to be, or the goal of each crane.
    """
    arguments = ("plan", "query", "path")
    _Plan(Work(module, "plan", shape, constants, arguments), programme).emit()


class _Plan:
    """Function under construction."""

    def __init__(self, work: Work, programme: Programme) -> None:
        self.work = work
        self.code = work.code
        self.shape = work.shape
        self.common = work.common
        self.programme = programme
        self.plant = programme.plant
        self.layout = self.plant.topology.layout
        self.row_length = self.shape.lanes * self.shape.cranes

    def emit(self) -> None:
        code, shape, work = self.code, self.shape, self.work
        query = [code.load(code.argument["query"], i * code.lanes) for i in range(shape.states + 1)]
        state = array(query[:-1])
        plausible = query[-1] > 0.5
        self.common.put_row("start", state)
        fresh = self._mark("begun") < 0.5
        wider = _WIDER * work.reported("first")
        work.report(barrier=code.chosen(fresh, wider, self._mark("barrier")))
        with code.when(code.anywhere(fresh)):
            self._stand(fresh, state)
        self._shift()
        with code.when(code.anywhere(plausible)):
            self._solve()
        reported = {
            name: code.chosen(plausible, work.reported(name), 0.0)
            for name in ("flag", "iterations", "excess")
        }
        work.report(**reported)
        self._keep(plausible)
        code.end()

    def _solve(self) -> None:
        work = self.work
        common = self.common
        states = self.shape.states
        work.stage(self.code.integer(0)).put_row("node", common.row("start", states))
        self._aim()
        self._bound()
        work.call("linearise")
        work.call("end")
        pull = riccati.symmetric(common, "end", states) @ common.row("goal", states)
        common.put_row("end_gradient", -pull)
        work.call("solve")

    def _mark(self, name: str) -> Value:
        first = self.shape.stages * self.row_length
        offset = first + Marks._fields.index(name) * self.code.lanes
        return self.code.load(self.code.argument["plan"], offset)

    def _stand(self, fresh: ir.Value, state: np.ndarray) -> None:
        """Set the plan of cranes without one to standing still."""
        code = self.code
        plan = self.code.argument["plan"]
        with code.loop(0, self.shape.stages) as k:
            for i in range(self.shape.both):
                offset = code.plus(code.product(k, self.row_length), i * code.lanes)
                still = state[i] if i < self.layout.n else 0.0
                code.store(code.chosen(fresh, still, code.load(plan, offset)), plan, offset)

    def _shift(self) -> None:
        """Set the nodes to the last plan, shifted to the present time."""
        code = self.code
        wide = self.work.wide
        plan = self.code.argument["plan"]
        ahead, share = divmod(
            self.programme.ratio * self.programme.period / self.programme.length, 1.0
        )
        last = code.integer(self.shape.stages - 1)
        with self.work.each() as (rows, _, k, first):
            before = code.least(code.plus(k, int(ahead)), last)
            after = code.least(code.plus(before, 1), last)
            offsets = [
                code.builder.add(code.product(k, self.row_length), first) for k in (before, after)
            ]
            nodes = [wide.load(plan, offset) for offset in offsets]
            rows.put("node", (1.0 - share) * nodes[0] + share * nodes[1])

    def _aim(self) -> None:
        """Compute weights about the end of the path, and the gradient of the cost, which is about
        the path.
        """
        code = self.code
        shape = self.shape
        common = self.common
        z = self.shape.states
        path = code.argument["path"]
        row = code.load_one(code.argument["query"], (z + 1) * code.lanes, INTEGER)

        def target(k: ir.Value) -> np.ndarray:
            if not self.programme.rows:
                return array([code.load(path, i * code.lanes) for i in range(z)])
            ahead = code.builder.add(row, code.product(k, self.programme.hop))
            first = code.product(code.least(ahead, code.integer(self.programme.rows - 1)), z)
            return array([code.spread(path, code.plus(first, i)) for i in range(z)])

        common.put_row("goal", target(code.integer(shape.stages)))
        self.work.call("weigh")
        with code.loop(0, shape.stages) as k:
            now = target(k)
            coming = target(code.plus(k, 1))
            rising = (coming - now)[self.layout.n + self.layout.drives] * (
                1.0 / self.programme.length
            )
            both = np.concatenate([now, rising])
            self.work.stage(k).put_row("gradient", -(common.table("weight", shape.both) @ both))

    def _bound(self) -> None:
        """Set bounds of swing joints whose rest depends on the drives: about the present rest, the
        rest at the goal, and between.
        """
        if self.plant.plumb_at_zero:
            return
        ends = [
            self.plant.hanging_angles(self.common.row(name, self.layout.n)[self.layout.drives])
            for name in ("start", "goal")
        ]
        for (i, _), a, b in zip(self.plant.topology.swings, *ends, strict=True):
            self.common.put("low", smaller(a, b) - self.programme.swing, i=i)
            self.common.put("high", larger(a, b) + self.programme.swing, i=i)

    def _keep(self, plausible: ir.Value) -> None:
        """Store the new plan; after a failure keep the last one."""
        code = self.code
        wide = self.work.wide
        work = self.work
        plan = self.code.argument["plan"]
        # What is not finite stays so until the last stage.
        last = work.stage(code.integer(self.shape.stages - 1)).row("iterate", self.shape.both)
        finite = [abs(number) < _HUGE for number in last]
        solved = code.both(work.reported("flag") > 0.5, *finite)
        keeps = work.repeated(code.chosen(solved, 1.0, 0.0)) > 0.5
        with work.each() as (rows, _, k, first):
            offset = code.builder.add(code.product(k, self.row_length), first)
            wide.store(wide.chosen(keeps, rows.get("iterate"), rows.get("node")), plan, offset)
        first, barrier = map(work.reported, ("first", "barrier"))
        marks = Marks(
            begun=code.chosen(plausible, 1.0, self._mark("begun")),
            failures=self._mark("failures") + code.chosen(solved, 0.0, 1.0),
            flag=code.chosen(solved, 1.0, 0.0),
            iterations=work.reported("iterations"),
            excess=work.reported("excess"),
            barrier=code.chosen(solved, first, smaller(_WIDER * barrier, _WIDEST * first)),
        )
        for i, value in enumerate(marks):
            offset = self.shape.stages * self.row_length + i * code.lanes
            code.store(value, plan, offset)
