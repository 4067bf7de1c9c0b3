"""Riccati's recursion in code: the linear algebra of a quadratic programme over a horizon.

A stage's states and inputs stand in the lanes of one row. Eliminating the inputs of a stage turns
the cost of all that follows it into one of its state; what is eliminated is kept as feedback, so
that the same problem with another gradient takes one sweep back and one forth (Rao, Wright and
Rawlings 1998, "Application of interior-point methods to model predictive control").
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.horizon.memory import (
    HorizonShape,
    MemoryRows,
    Work,
    constant,
    element,
    everywhere,
    over_lanes,
    unit,
    with_elements,
)


def emit(module: ir.Module, shape: HorizonShape) -> None:
    """Add the functions `end`, `factor` and `sweep`, which work on the memory of an optimisation.

    end: the cost-to-go beyond the horizon, as that of a horizon as long again on which the last
    stage's model stays and nothing is bounded. factor: the feedback of every stage under its
    curvature. sweep: states, inputs and what else is bounded under the stages' slopes.
    """
    _emit_end(Work(Code(module, "end", ["work"], shape.lanes), shape))
    _emit_factor(Work(Code(module, "factor", ["work"], shape.lanes), shape))
    _emit_sweep(Work(Code(module, "sweep", ["work"], shape.lanes), shape))


def call(code: Code, name: str) -> None:
    """Call one of the functions on the memory at hand."""
    code.builder.call(code.function.module.globals[name], [code.argument["work"]])


def _emit_end(work: Work) -> None:
    code, shape, common = work.code, work.shape, work.common
    for i in range(shape.states):
        common.put("togo", common.get("weight", i) * mask(code, shape.states), i)
    last = work.stage(shape.stages - 1)
    with code.loop(0, shape.stages):
        _eliminate(work, last, bounded=False, kept=None)
    for i in range(shape.states):
        common.put("end", common.get("togo", i) * mask(code, shape.states), i)
    code.end()


def _emit_factor(work: Work) -> None:
    code, shape, common = work.code, work.shape, work.common
    for i in range(shape.states):
        common.put("togo", common.get("end", i), i)
    with code.loop(0, shape.stages) as count:
        here = work.stage(code.builder.sub(code.integer(shape.stages - 1), count))
        carried = [common.get("togo", j) * here.every("shift", 0, j) for j in range(shape.states)]
        here.put("carried", total(carried))
        _eliminate(work, here, bounded=True, kept=here)
    code.end()


def _eliminate(work: Work, here: MemoryRows, *, bounded: bool, kept: MemoryRows | None) -> None:
    """Turn the cost-to-go of the state after a stage into that of the state before it."""
    code, shape, common = work.code, work.shape, work.common
    z, w, m = shape.states, shape.both, shape.inputs
    forward = [here.get("forward", i) for i in range(z)]
    product = [total([common.every("togo", i, j) * forward[j] for j in range(z)]) for i in range(z)]
    curve = here.get("curve") if bounded else None
    extra = [here.get("extra", i) for i in range(m)] if bounded else []
    weighted = [here.every("curve", 0, w + i) * extra[i] for i in range(len(extra))]
    rows = []
    for r in range(w):
        parts = [here.every("forward", i, r) * product[i] for i in range(z)]
        parts += [here.every("extra", i, r) * weighted[i] for i in range(len(extra))]
        parts.append(common.get("weight", r))
        if curve is not None:
            parts.append(curve * unit(code, r))
        rows.append(total(parts))
        common.put("product", rows[-1], r)
    # Gauss and Jordan on the rows of the inputs, the inverse of their block beside them.
    gains = [rows[z + c] + unit(code, w + c) for c in range(m)]
    for c in range(m):
        gains[c] = gains[c] * everywhere(code, 1.0 / element(code, gains[c], z + c))
        for d in range(m):
            if d != c:
                gains[d] = gains[d] - gains[c] * everywhere(code, element(code, gains[d], z + c))
    for i in range(z):
        taken = [common.every("product", i, z + c) * gains[c] for c in range(m)]
        common.put("togo", rows[i] - total(taken), i)
    if kept is not None:
        for c in range(m):
            kept.put("feedback", gains[c], c)


def _emit_sweep(work: Work) -> None:
    code, shape, common = work.code, work.shape, work.common
    z, w, m = shape.states, shape.both, shape.inputs
    slope = code.variables([common.get("end_gradient")])[0]
    with code.loop(0, shape.stages) as count:
        here = work.stage(code.builder.sub(code.integer(shape.stages - 1), count))
        common.put("spill", slope.get() + here.get("carried"))
        felt = total(
            [here.get("slope")]
            + [here.get("forward", i) * common.every("spill", 0, i) for i in range(z)]
        )
        held = total(
            [
                here.get("feedback", c) * everywhere(code, element(code, felt, z + c))
                for c in range(m)
            ]
        )
        here.put("open", held)
        slope.set(felt - held)
    state = code.variables([common.get("start")])[0]
    with code.loop(0, shape.stages) as k:
        here, now = work.stage(k), state.get()
        common.put("spill", now)
        coming = [here.get("shift")]
        coming += [here.get("columns", j) * common.every("spill", 0, j) for j in range(z)]
        far = total(coming)
        inputs = [
            -over_lanes(code, here.get("feedback", c) * now, "fadd") - here.one("open", 0, w + c)
            for c in range(m)
        ]
        both = with_elements(code, now, {z + c: inputs[c] for c in range(m)})
        further = {w + i: over_lanes(code, here.get("extra", i) * both, "fadd") for i in range(m)}
        here.put("there", with_elements(code, both, further) + here.get("apart"))
        state.set(
            far
            + total([here.get("columns", z + c) * everywhere(code, inputs[c]) for c in range(m)])
        )
    code.end()


def total(parts: list[Any]) -> Any:
    """Sum of at least one value, in two chains so that neither waits for the other."""
    even, odd = parts[::2], parts[1::2]
    return reduce(add, even) if not odd else reduce(add, even) + reduce(add, odd)


def mask(code: Code, count: int) -> Value:
    """1 in the first lanes, 0 beyond."""
    return constant(code, [float(i < count) for i in range(code.lanes)])
