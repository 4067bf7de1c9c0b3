"""One optimisation in code: shift the last plan, linearise along it, solve, store the new plan.

This is one real-time iteration (Diehl, Bock and Schlöder 2005, "A real-time iteration scheme for
nonlinear optimization in optimal feedback control").
"""

from __future__ import annotations

from typing import Any, NamedTuple

from llvmlite import ir

from cranedyn.compiled.code import INTEGER, Value
from cranedyn.compiled.horizon.memory import (
    Constants,
    HorizonShape,
    LaneView,
    Work,
    everywhere,
    over_lanes,
    row_code,
    single,
)
from cranedyn.compiled.horizon.riccati import call, mask, total
from cranedyn.dynamics.scalars import array
from cranedyn.plant.plant import Plant

_HUGE = 1e300
"""Bound of all numbers of a finite plan."""

_WIDER, _WIDEST = 10.0, 100.0
"""Factor on the barrier for the first optimisation and after each failure, and its largest
value."""

QUERY = ("row", "last", "hop")
"""Whole numbers after the state in a query: present row of the path, its last row, rows from one
stage to the next. The last number of a query is 1, or 0 for an implausible state."""


class Marks(NamedTuple):
    """First lanes of the last row of a plan: the outcome of the optimisations so far.

    Only the plan passes from one optimisation to the next: lanes share the memory of the
    optimisation.

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
    module: ir.Module,
    shape: HorizonShape,
    plant: Plant,
    length: float,
    period: float,
    swing: float,
    tracks: bool,
    constants: Constants,
) -> None:
    """Add the function `plan`.

    Its arguments: memory of an optimisation; a plan, rows of states and inputs by stage and a row
    of `Marks`; a query, the state and the numbers of `QUERY`; a path, rows of coordinates and
    rates where to be.

    Args:
        module: Module to extend.
        shape: Dimensions of the problem.
        plant: Crane model.
        length: Length of a stage [s].
        period: Time from one optimisation to the next [s].
        swing: Largest angle of each swing joint from its rest [rad].
        tracks: Whether a path is tracked, the same for all cranes; else each has its goal.
        constants: Entries that are the same in every stage.
    """
    code = row_code(module, "plan", ["work", "plan", "query", "path"], shape)
    _Plan(Work(code, shape, constants), plant, length, period, swing, tracks).emit()


class _Plan:
    """Function under construction."""

    def __init__(
        self, work: Work, plant: Plant, length: float, period: float, swing: float, tracks: bool
    ) -> None:
        self.work, self.code, self.shape, self.common = work, work.code, work.shape, work.common
        self.plant, self.layout, self.swing = plant, plant.topology.layout, swing
        self.length, self.period = length, period
        self.one, self.marks = single(self.code), self.shape.stages * self.shape.lanes
        shared = LaneView(self.code, self.shape.cranes)
        self.path_number = shared.spread if tracks else self.one.load

    def emit(self) -> None:
        code, shape, arguments = self.code, self.shape, self.code.argument
        self.common.put("start", code.load(arguments["query"]) * mask(code, shape.states))
        fresh = self._mark("begun") < 0.5
        wider = _WIDER * self.work.reported("first")
        barrier = self.one.chosen(fresh, wider, self._mark("barrier"))
        self.work.report("barrier", barrier)
        with code.when(self.one.anywhere(fresh)), code.loop(0, shape.stages) as k:
            still = code.load(arguments["query"]) * mask(code, shape.states // 2)
            first = code.product(k, shape.lanes)
            plan = code.chosen(fresh, still, code.load(arguments["plan"], first))
            code.store(plan, arguments["plan"], first)
        self._shift()
        plausible = self.one.load(arguments["query"], shape.lanes + len(QUERY)) > 0.5
        with code.when(self.one.anywhere(plausible)):
            self._solve()
        for name in ("flag", "iterations", "excess"):
            self.work.report(name, self.one.chosen(plausible, self.work.reported(name), 0.0))
        self._keep(plausible)
        code.end()

    def _solve(self) -> None:
        common = self.common
        self._begin_at_state()
        self._aim()
        self._bound()
        call(self.code, "linearise")
        call(self.code, "end")
        states = range(self.shape.states)
        aim = [common.get("end", i) * common.every("goal", 0, i) for i in states]
        common.put("end_gradient", -total(aim))
        call(self.code, "solve")

    def _mark(self, name: str) -> Value:
        return self.one.load(self.code.argument["plan"], self.marks + Marks._fields.index(name))

    def _shift(self) -> None:
        """Set the nodes to the last plan, shifted to the present time."""
        code, shape = self.code, self.shape
        ahead, share = divmod(self.period / self.length, 1.0)
        last = code.integer(shape.stages - 1)
        with code.loop(0, shape.padded) as k:
            before = code.least(code.builder.add(k, code.integer(int(ahead))), last)
            after = code.least(code.builder.add(before, code.integer(1)), last)
            nodes = [
                code.load(code.argument["plan"], code.product(row, shape.lanes))
                for row in (before, after)
            ]
            self.work.stage(k).put("node", (1.0 - share) * nodes[0] + share * nodes[1])

    def _begin_at_state(self) -> None:
        """Move the first node to the state."""
        code, shape, first = self.code, self.shape, self.work.stage(0)
        inputs = mask(code, shape.both) - mask(code, shape.states)
        first.put("node", first.get("node") * inputs + self.common.get("start"))

    def _aim(self) -> None:
        """Compute weights about the end of the path, and the gradient of the cost, which is about
        the path.
        """
        code, shape, layout, common = self.code, self.shape, self.layout, self.common
        query, path = code.argument["query"], code.argument["path"]
        row, last, hop = (code.load_one(query, shape.lanes + i, INTEGER) for i in range(len(QUERY)))

        def number(k: ir.Value, i: int) -> Value:
            path_row = code.least(code.builder.add(row, code.builder.mul(hop, k)), last)
            first = code.product(path_row, shape.states)
            return self.path_number(path, code.builder.add(first, code.integer(i)))

        for i in range(shape.states):
            self.common.put_one("goal", 0, i, number(code.integer(shape.stages), i))
        if "weigh" in code.function.module.globals:
            call(code, "weigh")
        with code.loop(0, shape.stages) as k:
            for i in range(shape.states):
                self.common.put_one("spill", 0, i, number(k, i))
            coming = code.builder.add(k, code.integer(1))
            states = range(shape.states)
            terms = [common.get("weight", i) * common.every("spill", 0, i) for i in states]
            for c, drive in enumerate((layout.n + layout.drives).tolist()):
                pull = (number(coming, drive) - number(k, drive)) * (1.0 / self.length)
                terms.append(self.common.get("weight", shape.states + c) * everywhere(code, pull))
            self.work.stage(k).put("gradient", -total(terms))

    def _bound(self) -> None:
        """Set bounds of swing joints whose rest depends on the drives: about the present rest, the
        rest at the goal, and between.
        """
        if self.plant.plumb_at_zero:
            return
        drives = self.layout.drives.tolist()
        ends = [
            self.plant.hanging_angles(array([self.common.one(name, 0, i) for i in drives]))
            for name in ("start", "goal")
        ]
        for (i, _), a, b in zip(self.plant.topology.swings, *ends, strict=True):
            self.common.put_one("low", 0, i, self.one.call("llvm.minnum", a, b) - self.swing)
            self.common.put_one("high", 0, i, self.one.call("llvm.maxnum", a, b) + self.swing)

    def _keep(self, plausible: ir.Value) -> None:
        """Store the new plan; after a failure keep the last one."""
        code, shape, single = self.code, self.shape, self.one
        plan = code.argument["plan"]
        flag = self.work.reported("flag")
        flat = single if shape.cranes > 1 else code
        finite = flat.variables([0.0])[0]
        with self.work.each() as (rows, _):
            size = flat.call("llvm.fabs", rows.get("iterate"))
            finite.set(flat.chosen(size < _HUGE, finite.get(), 1.0))
        solved = code.both(flag > 0.5, over_lanes(flat, finite.get(), "fadd") < 0.5)
        with code.loop(0, shape.stages) as k:
            rows = self.work.stage(k)
            plan_row = code.chosen(solved, rows.get("iterate"), rows.get("node"))
            code.store(plan_row, plan, code.product(k, shape.lanes))
        first, barrier = map(self.work.reported, ("first", "barrier"))
        wider = single.call("llvm.minnum", _WIDER * barrier, _WIDEST * first)
        failed = self._mark("failures") + single.chosen(solved, 0.0, 1.0)
        marks = Marks(
            begun=single.chosen(plausible, 1.0, self._mark("begun")),
            failures=failed,
            flag=single.chosen(solved, 1.0, 0.0),
            iterations=self.work.reported("iterations"),
            excess=self.work.reported("excess"),
            barrier=single.chosen(solved, first, wider),
        )
        for i, value in enumerate(marks):
            single.store(value, plan, self.marks + i)
