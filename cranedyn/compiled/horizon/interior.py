"""Primal-dual interior-point method in code, for bounds that may be exceeded at a price.

Each number y of a stage has bounds low <= y <= high. To exceed one by s costs price s, so that
there is always a solution, and a bound holds wherever this costs less than the price. With the
margin g to a bound, slack t - s = g, multiplier of the bound λ and price - λ of s >= 0, the
central path is t λ = s (price - λ) = μ. Predictor and corrector after Mehrotra (1992), "On the
implementation of a primal-dual interior point method"; the linear algebra is that of
`cranedyn.compiled.horizon.riccati`.
"""

from __future__ import annotations

from functools import partial, reduce
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.horizon.memory import (
    Constants,
    HorizonShape,
    MemoryRows,
    Work,
    everywhere,
    over_lanes,
    row_code,
    single,
    with_elements,
)
from cranedyn.compiled.horizon.riccati import call, total
from cranedyn.dynamics.scalars import larger

_MOST = 20
"""Largest number of iterations."""

_SHORT = 0.995
"""Largest step, as a share of the step at which a slack or a multiplier would be zero."""

_GAP, _OPEN = 1e-8, 1e-9
"""Tolerances: mean product of slacks and multipliers, as a share of the initial barrier, and
residual of the gradient, as a share of the initial one."""

_SIDES = {"high": 1.0, "low": -1.0}


def emit(module: ir.Module, shape: HorizonShape, constants: Constants | None = None) -> None:
    """Add the function `solve`, from the stages' model, gradient and bounds to the optimum."""
    _Solve(Work(row_code(module, "solve", ["work"], shape), shape, constants)).emit()


class _Solve:
    """Function under construction."""

    def __init__(self, work: Work) -> None:
        self.work, self.shape, self.single = work, work.shape, single(work.code)
        self.code = self.single if work.shape.cranes > 1 else work.code

    def emit(self) -> None:
        code, single = self.code, self.single
        self._free()
        self.work.report("flag", 1.0)
        self.work.report("iterations", 0.0)
        bounded = self.work.reported("excess") > 0.0
        with code.when(single.anywhere(bounded)):
            self._begin(bounded)
            self.work.report("flag", single.chosen(bounded, 0.0, 1.0))
            barrier = self.work.reported("barrier")
            gap, residual = single.variables([barrier, 1.0])
            # Once solved, a lane takes steps of 0 until the others are.
            with code.loop(0, _MOST), code.when(single.anywhere(self.work.reported("flag") < 0.5)):
                unsolved = 1.0 - self.work.reported("flag")
                step = unsolved * self._iterate(gap.get())
                gap.set(self._move(step))
                residual.set(residual.get() * (1.0 - step))
                self.work.report("iterations", self.work.reported("iterations") + unsolved)
                self.work.report("gap", gap.get())
                self.work.report("open", residual.get())
                done = code.both(gap.get() < _GAP * barrier, residual.get() < _OPEN)
                solved = single.chosen(done, 1.0, 1.0 - unsolved)
                self.work.report("flag", solved)
        code.end()

    def _free(self) -> None:
        """Solve without bounds, and report the largest excess of a bound."""
        code, work = self.code, self.work
        with work.each() as (rows, _):
            rows.put("slope", rows.get("gradient"))
        call(code, "free")
        call(code, "sweep")
        worst = code.variables([-1.0])[0]
        with work.each() as (rows, common):
            trial = rows.get("trial")
            rows.put("iterate", trial)
            over = _larger(code, trial - common.get("high"), common.get("low") - trial)
            worst.set(_larger(code, worst.get(), over))
        self.work.report("excess", over_lanes(code, worst.get(), "fmax"))

    def _begin(self, bounded: ir.Value) -> None:
        """Start on the central path of the barrier, at the nodes."""
        code, shape, work = self.code, self.shape, self.work
        with work.code.loop(0, shape.stages) as k:
            rows = work.stage(k)
            node = rows.get("node")
            extra = [
                over_lanes(work.code, rows.get("extra", i) * node, "fadd")
                for i in range(shape.inputs)
            ]
            further = dict(enumerate(extra, shape.both))
            rows.put("trial", with_elements(work.code, node, further) + rows.get("extra_shift"))
        barrier = everywhere(code, work.reported("barrier"))
        with work.each() as (rows, common):
            node, soft = rows.get("trial"), barrier / common.get("price")
            rows.put("iterate", code.chosen(bounded, node, rows.get("iterate")))
            for side in _SIDES:
                room = self._room(node, side, common)
                root = code.call("llvm.sqrt", room * room + 4.0 * (soft * soft))
                slack, excess = soft + 0.5 * (root + room), soft + 0.5 * (root - room)
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
        code = self.code
        call(code, "factor")
        call(code, "sweep")
        ratio, crossed = code.variables([1.0, 0.0])
        with self.work.each() as (rows, common):
            self._predict(rows, common, ratio, crossed)
        step = 1.0 / over_lanes(code, ratio.get(), "fmax")
        count = 4.0 * self.shape.stages * self.shape.lanes
        cross = over_lanes(code, crossed.get(), "fadd") * (1.0 / count)
        predicted = (gap * (1.0 - step) + cross * (step * step)) / gap
        centred = everywhere(code, gap * (predicted * predicted * predicted))
        with self.work.each() as (rows, common):
            self._bend(rows, common, centred)
        call(code, "sweep")
        ratio = code.variables([_SHORT])[0]
        with self.work.each() as (rows, common):
            self._correct(rows, common, centred, ratio)
        return _SHORT / over_lanes(code, ratio.get(), "fmax")

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
        pull: Any = rows.get("curve") * rows.get("extra_shift")
        for side, sign in _SIDES.items():
            bound = common.get(side)
            aim = bound - bent[side] if sign > 0.0 else -bound - bent[side]
            pull = pull + sign * (rows.get(f"force_{side}") - rows.get(f"stiff_{side}") * aim)
        rows.put("slope", rows.get("gradient") + pull)

    def _predict(self, rows: MemoryRows, common: MemoryRows, ratio: Any, crossed: Any) -> None:
        """Compute the predictor step, which aims at the bounds themselves."""
        candidates, products = [], []
        for side in _SIDES:
            dforce = -(rows.get(f"stiff_{side}") * self._room(rows.get("trial"), side, common))
            share, against = (
                dforce * rows.get(f"per_{kind}_{side}") for kind in ("force", "relief")
            )
            dslack = -(rows.get(f"slack_{side}") * (1.0 + share))
            dexcess = -(rows.get(f"excess_{side}") * (1.0 - against))
            candidates += [-share, 1.0 + share, against, 1.0 - against]
            product, excess_product = dforce * dslack, -(dforce * dexcess)
            rows.put(f"dslack_{side}", product)
            rows.put(f"dexcess_{side}", excess_product)
            products += [product, excess_product]
        self._grow(ratio, candidates)
        crossed.set(crossed.get() + total(products))

    def _bend(self, rows: MemoryRows, common: MemoryRows, centred: Value) -> None:
        """Compute the slope of the corrector, which aims at a point of the central path, to second
        order.
        """
        self._slope(rows, common, {side: self._bent(rows, side, centred) for side in _SIDES})

    def _bent(self, rows: MemoryRows, side: str, centred: Value) -> Any:
        return (centred - rows.get(f"dslack_{side}")) * rows.get(f"per_force_{side}") - (
            centred - rows.get(f"dexcess_{side}")
        ) * rows.get(f"per_relief_{side}")

    def _correct(self, rows: MemoryRows, common: MemoryRows, centred: Value, ratio: Any) -> None:
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

    def _grow(self, ratio: Any, candidates: list[Value]) -> None:
        """Replace a ratio by the largest of it and candidates, with one operation after the last
        ratio is known.
        """
        larger = partial(_larger, self.code)
        ratio.set(larger(ratio.get(), reduce(larger, candidates)))

    def _move(self, step: Value) -> Value:
        """Take the step, and return the mean product of slacks and multipliers after it; prepare
        the next one.
        """
        code = self.code
        share, products = everywhere(code, step), code.variables([0.0])[0]
        with self.work.each() as (rows, common):
            iterate = rows.get("iterate")
            rows.put("iterate", iterate + share * (rows.get("trial") - iterate))
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
        count = 4.0 * self.shape.stages * self.shape.lanes
        return over_lanes(code, products.get(), "fadd") * (1.0 / count)
