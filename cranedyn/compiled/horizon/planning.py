"""One optimisation in code: shift the last plan, linearise along it, solve, store the new plan.

This is one real-time iteration (Diehl, Bock and Schlöder 2005, "A real-time iteration scheme for
nonlinear optimization in optimal feedback control").
"""

from __future__ import annotations

from llvmlite import ir

from cranedyn.compiled.code import INTEGER, Code, Value
from cranedyn.compiled.horizon.memory import REPORT, HorizonShape, LaneView, Work, everywhere
from cranedyn.compiled.horizon.riccati import call, mask, total
from cranedyn.dynamics.scalars import array
from cranedyn.plant.plant import Plant

_HUGE = 1e300
"""What no number of a plan exceeds."""

_WIDER, _WIDEST = 10.0, 100.0
"""By what the barrier is wider for the first optimisation, and for the next when one fails, and by
what at most."""

QUERY = ("row", "last", "hop")
"""Whole numbers that follow the state in a query: row of the path now, its last row, rows from one
stage to the next. After them stands 1, or 0 where the state is one that the crane cannot be in."""

MARKS = ("begun", "failures", "flag", "iterations", "excess", "barrier")
"""What stands in the first lanes of the row that ends a plan: 1 once there is one; optimisations
that failed; of the last one, whether it succeeded, its iterations, and how far a bound would be
exceeded if there were none; the barrier with which the next begins. A plan is all that passes from
one optimisation to the next: cranes in lanes share the memory of the optimisation."""


def emit(
    module: ir.Module, shape: HorizonShape, plant: Plant, length: float, period: float, swing: float
) -> None:
    """Add the function `plan`.

    Its arguments: memory of an optimisation; a plan, rows of states and inputs by stage and a row
    of `MARKS`; a query, the state and the numbers of `QUERY`; a path, rows of coordinates and
    rates where to be.

    Args:
        module: Where to add it.
        shape: Of the problem.
        plant: The crane.
        length: Of a stage [s].
        period: From one optimisation to the next [s].
        swing: Largest angle of each swing joint from where it hangs [rad].
    """
    code = Code(module, "plan", ["work", "plan", "query", "path"], shape.lanes)
    _Plan(Work(code, shape), plant, length, period, swing).emit()


class _Plan:
    """Function under construction."""

    def __init__(
        self, work: Work, plant: Plant, length: float, period: float, swing: float
    ) -> None:
        self.work, self.code, self.shape, self.common = work, work.code, work.shape, work.common
        self.plant, self.layout, self.swing = plant, plant.topology.layout, swing
        self.length, self.period = length, period
        self.one, self.marks = LaneView(self.code, 1), self.shape.stages * self.shape.lanes

    def emit(self) -> None:
        code, shape, arguments = self.code, self.shape, self.code.argument
        self.common.put("start", code.load(arguments["query"]) * mask(code, shape.states))
        fresh = self._mark("begun") < 0.5
        wider = _WIDER * self.common.one("report", 0, REPORT.index("first"))
        barrier = self.one.chosen(fresh, wider, self._mark("barrier"))
        self.common.put_one("report", 0, REPORT.index("barrier"), barrier)
        with code.when(fresh), code.loop(0, shape.stages) as k:
            still = code.load(arguments["query"]) * mask(code, shape.states // 2)
            code.store(still, arguments["plan"], code.product(k, shape.lanes))
        self._shift()
        for name in ("flag", "iterations", "excess"):
            self.common.put_one("report", 0, REPORT.index(name), 0.0)
        plausible = self.one.load(arguments["query"], shape.lanes + len(QUERY)) > 0.5
        with code.when(plausible):
            self._solve()
        self._keep(plausible)
        code.end()

    def _solve(self) -> None:
        code, shape = self.code, self.shape
        self._begin_at_state()
        self._aim()
        self._bound()
        call(code, "linearise")
        call(code, "end")
        aim = [
            self.common.get("end", i) * self.common.every("goal", 0, i) for i in range(shape.states)
        ]
        self.common.put("end_gradient", -total(aim))
        call(code, "solve")

    def _mark(self, name: str) -> Value:
        return self.one.load(self.code.argument["plan"], self.marks + MARKS.index(name))

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
        code, shape, layout = self.code, self.shape, self.layout
        query, path = code.argument["query"], code.argument["path"]
        row, last, hop = (code.load_one(query, shape.lanes + i, INTEGER) for i in range(len(QUERY)))

        def number(k: ir.Value, i: int) -> Value:
            path_row = code.least(code.builder.add(row, code.builder.mul(hop, k)), last)
            first = code.product(path_row, shape.states)
            return self.one.load(path, code.builder.add(first, code.integer(i)))

        for i in range(shape.states):
            self.common.put_one("goal", 0, i, number(code.integer(shape.stages), i))
        if "weigh" in code.function.module.globals:
            call(code, "weigh")
        with code.loop(0, shape.stages) as k:
            for i in range(shape.states):
                self.common.put_one("spill", 0, i, number(k, i))
            coming = code.builder.add(k, code.integer(1))
            terms = [
                self.common.get("weight", i) * self.common.every("spill", 0, i)
                for i in range(shape.states)
            ]
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
        flag = self.common.one("report", 0, REPORT.index("flag"))
        finite = code.variables([1.0])[0]
        with code.loop(0, shape.stages) as k:
            size = code.call("llvm.fabs", self.work.stage(k).get("iterate"))
            finite.set(code.chosen(size < _HUGE, finite.get(), 0.0))
        solved = code.both(flag > 0.5, code.everywhere(finite.get() > 0.5))
        with code.loop(0, shape.stages) as k:
            rows = self.work.stage(k)
            plan_row = code.variables([rows.get("node")])[0]
            with code.when(solved):
                plan_row.set(rows.get("iterate"))
            code.store(plan_row.get(), plan, code.product(k, shape.lanes))
        first = self.common.one("report", 0, REPORT.index("first"))
        barrier = self.common.one("report", 0, REPORT.index("barrier"))
        wider = single.call("llvm.minnum", _WIDER * barrier, _WIDEST * first)
        failed = self._mark("failures") + single.chosen(solved, 0.0, 1.0)
        marks = {
            "begun": single.chosen(plausible, 1.0, self._mark("begun")),
            "failures": failed,
            "flag": single.chosen(solved, 1.0, 0.0),
            **{
                name: self.common.one("report", 0, REPORT.index(name))
                for name in ("iterations", "excess")
            },
            "barrier": single.chosen(solved, first, wider),
        }
        for name, value in marks.items():
            single.store(value, plan, self.marks + MARKS.index(name))
