"""Primal-dual interior-point method in code, for bounds that may be exceeded at a price.

Each number y of a stage has bounds low <= y <= high. To exceed one by s costs price s, so that
there is always a solution, and a bound holds wherever this costs less than the price. With the
margin g to a bound, slack t - s = g, multiplier of the bound λ and price - λ of s >= 0, the
central path is t λ = s (price - λ) = μ. Predictor and corrector after Mehrotra (1992), "On the
implementation of a primal-dual interior point method"; the linear algebra is that of
`cranedyn.compiled.horizon.riccati`.
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import StackVariable, Value
from cranedyn.compiled.horizon.memory import Constants, HorizonShape, MemoryRows, Work
from cranedyn.dynamics.scalars import larger

_MOST = 20
"""Largest number of iterations."""

_SHORT = 0.995
"""Largest step, as a share of the step at which a slack or a multiplier would be zero."""

_GAP = 1e-8
"""Tolerance of the mean product of slacks and multipliers, as a share of the initial barrier."""

_OPEN = 1e-9
"""Tolerance of the residual of the gradient, as a share of the initial one."""

_SIDES = {"high": 1.0, "low": -1.0}


def emit(module: ir.Module, shape: HorizonShape, constants: Constants | None = None) -> None:
    """Add the function `solve`, from the stages' model, gradient and bounds to the optimum."""
    _Solve(Work(module, "solve", shape, constants)).emit()


class _Solve:
    """Function under construction."""

    def __init__(self, work: Work) -> None:
        self.work = work
        self.code = work.code
        self.wide = work.wide
        self.shape = work.shape

    def emit(self) -> None:
        code, work = self.code, self.work
        self._free()
        bounded = work.reported("excess") > 0.0
        work.report(flag=code.chosen(bounded, 0.0, 1.0), iterations=0.0)
        with code.when(code.anywhere(bounded)):
            self._begin(bounded)
            barrier = work.reported("barrier")
            gap, residual = code.variables([barrier, 1.0])
            # Once solved, a lane takes steps of 0 until the others are.
            with code.loop(0, _MOST), code.when(code.anywhere(work.reported("flag") < 0.5)):
                unsolved = work.reported("flag") < 0.5
                step = code.chosen(unsolved, self._iterate(gap.get()), 0.0)
                gap.set(self._move(step))
                residual.set(residual.get() * (1.0 - step))
                iterations = work.reported("iterations") + code.chosen(unsolved, 1.0, 0.0)
                done = code.both(gap.get() < _GAP * barrier, residual.get() < _OPEN)
                flag = code.chosen(done, 1.0, work.reported("flag"))
                work.report(flag=flag, iterations=iterations, gap=gap.get(), open=residual.get())
        code.end()

    def _free(self) -> None:
        """Solve without bounds, and report the largest excess of a bound."""
        work = self.work
        work.call("free")
        work.call("sweep")
        (worst,) = self.wide.variables([-1.0])
        with work.each() as (rows, common, *_):
            trial = rows.get("trial")
            rows.put("iterate", trial)
            self._grow(worst, [trial - common.get("high"), common.get("low") - trial])
        work.report(excess=work.over_numbers(worst.get(), larger))

    def _begin(self, bounded: ir.Value) -> None:
        """Start on the central path of the barrier, at the nodes."""
        work = self.work
        wide = self.wide
        w = self.shape.both
        m = self.shape.inputs
        with work.code.loop(0, self.shape.stages) as k:
            rows = work.stage(k)
            node = rows.row("node", w)
            further = rows.table("extra", w) @ node + rows.row("extra_shift", m, first=w)
            rows.put_row("trial", [*node, *further])
        barrier = work.repeated(work.reported("barrier"))
        begins = work.repeated(self.code.chosen(bounded, 1.0, 0.0)) > 0.5
        with work.each() as (rows, common, *_):
            node = rows.get("trial")
            soft = barrier / common.get("price")
            rows.put("iterate", wide.chosen(begins, node, rows.get("iterate")))
            for side in _SIDES:
                room = self._room(node, side, common)
                root = wide.call("llvm.sqrt", room * room + 4.0 * (soft * soft))
                slack = soft + 0.5 * (root + room)
                excess = soft + 0.5 * (root - room)
                rows.put(f"slack_{side}", slack)
                rows.put(f"excess_{side}", excess)
                rows.put(f"force_{side}", barrier / slack)
                rows.put(f"relief_{side}", barrier / excess)
            self._weigh(rows, common)

    def _room(self, value: Value, side: str, common: MemoryRows) -> Value:
        bound = common.get(side)
        return bound - value if side == "high" else value - bound

    def _iterate(self, gap: Value) -> Value:
        """Prepare a step, and return the share of it that keeps slacks positive."""
        work, wide = self.work, self.wide
        work.call("factor")
        work.call("sweep")
        ratio, crossed = wide.variables([1.0, 0.0])
        with work.each() as (rows, common, *_):
            self._predict(rows, common, ratio, crossed)
        step = 1.0 / work.over_numbers(ratio.get(), larger)
        predicted = (gap * (1.0 - step) + self._mean(crossed) * (step * step)) / gap
        centred = work.repeated(gap * (predicted * predicted * predicted))
        with work.each() as (rows, common, *_):
            self._slope(rows, common, {side: self._bent(rows, side, centred) for side in _SIDES})
        work.call("sweep")
        (ratio,) = wide.variables([_SHORT])
        with work.each() as (rows, common, *_):
            self._correct(rows, common, centred, ratio)
        return _SHORT / work.over_numbers(ratio.get(), larger)

    def _weigh(self, rows: MemoryRows, common: MemoryRows) -> None:
        """Compute the curvature of the barriers, and the slope of the predictor."""
        for side in _SIDES:
            force, relief = rows.get(f"force_{side}"), rows.get(f"relief_{side}")
            both = force * relief
            soft = rows.get(f"slack_{side}") * relief + rows.get(f"excess_{side}") * force
            inverse = 1.0 / (both * soft)  # a division for three quotients
            rows.put(f"per_force_{side}", relief * (soft * inverse))
            rows.put(f"per_relief_{side}", force * (soft * inverse))
            rows.put(f"stiff_{side}", both * (both * inverse))
        rows.put("curve", rows.get("stiff_high") + rows.get("stiff_low"))
        self._slope(rows, common, {side: 0.0 for side in _SIDES})

    def _slope(self, rows: MemoryRows, common: MemoryRows, bent: dict[str, Any]) -> None:
        """Compute the gradient of cost and barriers at zero, in all bounded values."""
        pull = rows.get("gradient") + rows.get("curve") * rows.get("extra_shift")
        for side, sign in _SIDES.items():
            aim = sign * common.get(side) - bent[side]
            pull = pull + sign * (rows.get(f"force_{side}") - rows.get(f"stiff_{side}") * aim)
        rows.put("slope", pull)

    def _predict(
        self, rows: MemoryRows, common: MemoryRows, ratio: StackVariable, crossed: StackVariable
    ) -> None:
        """Compute the predictor step, which aims at the bounds themselves."""
        candidates = []
        products = crossed.get()
        for side in _SIDES:
            dforce = -(rows.get(f"stiff_{side}") * self._room(rows.get("trial"), side, common))
            share, against = (
                dforce * rows.get(f"per_{kind}_{side}") for kind in ("force", "relief")
            )
            dslack = -(rows.get(f"slack_{side}") * (1.0 + share))
            dexcess = -(rows.get(f"excess_{side}") * (1.0 - against))
            candidates += [-share, 1.0 + share, against, 1.0 - against]
            product = dforce * dslack
            excess_product = -(dforce * dexcess)
            rows.put(f"dslack_{side}", product)
            rows.put(f"dexcess_{side}", excess_product)
            products = products + (product + excess_product)
        self._grow(ratio, candidates)
        crossed.set(products)

    def _bent(self, rows: MemoryRows, side: str, centred: Value) -> Any:
        """Return the bend of the central path for the corrector, which aims at a point of it, to
        second order.
        """
        return (centred - rows.get(f"dslack_{side}")) * rows.get(f"per_force_{side}") - (
            centred - rows.get(f"dexcess_{side}")
        ) * rows.get(f"per_relief_{side}")

    def _correct(
        self, rows: MemoryRows, common: MemoryRows, centred: Value, ratio: StackVariable
    ) -> None:
        """Compute the combined step, and the ratio that limits it."""
        candidates = []
        for side in _SIDES:
            per_force, per_relief = rows.get(f"per_force_{side}"), rows.get(f"per_relief_{side}")
            slack, excess = rows.get(f"slack_{side}"), rows.get(f"excess_{side}")
            room = self._room(rows.get("trial"), side, common)
            dforce = rows.get(f"stiff_{side}") * (self._bent(rows, side, centred) - room)
            share, against = dforce * per_force, dforce * per_relief
            dslack = (centred - rows.get(f"dslack_{side}")) * per_force - slack * (1.0 + share)
            dexcess = (centred - rows.get(f"dexcess_{side}")) * per_relief - excess * (
                1.0 - against
            )
            inverse = 1.0 / (slack * excess)
            ratios = -(dslack * excess * inverse), -(dexcess * slack * inverse)
            candidates += [-share, against, *ratios]
            rows.put(f"dforce_{side}", dforce)
            rows.put(f"dslack_{side}", dslack)
            rows.put(f"dexcess_{side}", dexcess)
        self._grow(ratio, candidates)

    def _grow(self, ratio: StackVariable, candidates: list[Value]) -> None:
        """Replace a ratio by the largest of it and candidates, with one operation after the last
        ratio is known.
        """
        ratio.set(larger(ratio.get(), reduce(larger, candidates)))

    def _move(self, step: Value) -> Value:
        """Take the step, and return the mean product of slacks and multipliers after it."""
        work = self.work
        wide = self.wide
        share = self.work.repeated(step)
        (products,) = wide.variables([0.0])
        with work.each() as (rows, common, *_):
            iterate = rows.get("iterate")
            moved = iterate + share * (rows.get("trial") - iterate)
            rows.put("iterate", wide.chosen(share > 0.0, moved, iterate))
            for side in _SIDES:
                dforce = share * rows.get(f"dforce_{side}")
                force = rows.get(f"force_{side}") + dforce
                relief = rows.get(f"relief_{side}") - dforce
                slack = rows.get(f"slack_{side}") + share * rows.get(f"dslack_{side}")
                excess = rows.get(f"excess_{side}") + share * rows.get(f"dexcess_{side}")
                values = {"force": force, "relief": relief, "slack": slack, "excess": excess}
                for name, value in values.items():
                    rows.put(f"{name}_{side}", value)
                products.set(products.get() + (force * slack + relief * excess))
            self._weigh(rows, common)
        return self._mean(products)

    def _mean(self, products: StackVariable) -> Value:
        count = 4.0 * self.shape.stages * self.shape.lanes
        return self.work.over_numbers(products.get(), add) * (1.0 / count)
