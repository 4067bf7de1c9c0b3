"""Riccati recursion in code: the linear algebra of a quadratic programme over a horizon.

States and inputs of a stage are the lanes of one row. Eliminating the inputs of a stage turns the
cost of all later stages into a cost of its state; the eliminated terms are stored as feedback, so
that the same problem with another gradient takes one backward and one forward sweep (Rao, Wright
and Rawlings 1998, "Application of interior-point methods to model predictive control").
"""

from __future__ import annotations

from functools import reduce
from operator import add
from typing import Any

from llvmlite import ir

from cranedyn.compiled.code import Code, Value
from cranedyn.compiled.horizon.memory import (
    Constants,
    HorizonShape,
    MemoryRows,
    RowCode,
    Work,
    constant,
    element,
    everywhere,
    over_lanes,
    row_code,
    unit,
    with_elements,
)


def emit(module: ir.Module, shape: HorizonShape, constants: Constants) -> None:
    """Add the functions `end`, `free`, `factor` and `sweep`, which work on the memory of an
    optimisation.

    end: the cost-to-go beyond the horizon, as that of a horizon as long again on which the last
    stage's model stays and nothing is bounded. free, factor: the feedback of every stage without
    and under its curvature. sweep: states, inputs and what else is bounded under the stages'
    slopes.
    """
    _emit_end(Work(row_code(module, "end", ["work"], shape), shape, constants))
    for name, bounded in (("free", False), ("factor", True)):
        _emit_factor(Work(row_code(module, name, ["work"], shape), shape, constants), bounded)
    _emit_sweep(Work(row_code(module, "sweep", ["work"], shape), shape, constants))


def call(code: Code, name: str) -> None:
    """Call a function of the module on the memory of the optimisation."""
    code.builder.call(code.function.module.globals[name], [code.argument["work"]])


def _emit_end(work: Work) -> None:
    code, shape, common = work.code, work.shape, work.common
    for i in range(shape.states):
        common.put("togo", common.get("weight", i) * mask(code, shape.states), i)
    last = work.stage(shape.stages - 1)
    with code.loop(0, shape.stages):
        _eliminate(work, last, bounded=False, keeps=False)
    for i in range(shape.states):
        common.put("end", common.get("togo", i) * mask(code, shape.states), i)
    code.end()


def _emit_factor(work: Work, bounded: bool) -> None:
    code, shape, common = work.code, work.shape, work.common
    for i in range(shape.states):
        common.put("togo", common.get("end", i), i)
    with code.loop(0, shape.stages) as count:
        rows = work.stage(code.builder.sub(code.integer(shape.stages - 1), count))
        carried = [common.get("togo", j) * rows.every("shift", 0, j) for j in range(shape.states)]
        rows.put("carried", total(carried))
        _eliminate(work, rows, bounded=bounded, keeps=True)
    code.end()


def _eliminate(work: Work, stage: MemoryRows, *, bounded: bool, keeps: bool) -> None:
    """Replace the cost-to-go of the state after a stage by that of the state before it, and store
    the feedback of a stage that keeps it.
    """
    code, shape, common = work.code, work.shape, work.common
    z, w, m = shape.states, shape.both, shape.inputs
    forward = [stage.get("forward", i) for i in range(z)]
    product = [total([common.every("togo", i, j) * forward[j] for j in range(z)]) for i in range(z)]
    curves = [stage.get("curve")] if bounded else []
    extra = [stage.get("extra", i) for i in range(m)] if bounded else []
    weighted = [stage.every("curve", 0, w + i) * extra[i] for i in range(len(extra))]
    rows = []
    for r in range(w):
        terms = [stage.every("forward", i, r) * product[i] for i in range(z)]
        terms += [stage.every("extra", i, r) * weighted[i] for i in range(len(extra))]
        terms.append(common.get("weight", r))
        terms += [curve * unit(code, r) for curve in curves]
        rows.append(total(terms))
        if isinstance(code, RowCode):  # the matrix is symmetric
            rows[r][:r] = [rows[c][r] for c in range(r)]
            for row in (*product, *weighted):
                row[r] = 0.0
    for r in range(w):
        common.put("product", rows[r], r)
    # Gauss and Jordan on the rows of the inputs, the inverse of their block beside them.
    gains = [rows[z + c] + unit(code, w + c) for c in range(m)]
    for c in range(m):
        gains[c] = gains[c] * everywhere(code, 1.0 / element(code, gains[c], z + c))
        for d in range(m):
            if d != c:
                gains[d] = gains[d] - gains[c] * everywhere(code, element(code, gains[d], z + c))
    for i in range(z):
        eliminated = [common.every("product", i, z + c) * gains[c] for c in range(m)]
        common.put("togo", rows[i] - total(eliminated), i)
    for c in range(m) if keeps else ():
        stage.put("feedback", gains[c], c)


def _emit_sweep(work: Work) -> None:
    code, shape, common = work.code, work.shape, work.common
    z, w, m = shape.states, shape.both, shape.inputs
    slope = code.variables([common.get("end_gradient")])[0]
    with code.loop(0, shape.stages) as count:
        rows = work.stage(code.builder.sub(code.integer(shape.stages - 1), count))
        common.put("spill", slope.get() + rows.get("carried"))
        ahead = [rows.get("forward", i) * common.every("spill", 0, i) for i in range(z)]
        steep = rows.get("slope")
        pulls = [
            rows.get("extra", i) * everywhere(code, element(code, steep, w + i)) for i in range(m)
        ]
        felt = total([steep, *ahead, *pulls])
        answers = [
            rows.get("feedback", c) * everywhere(code, element(code, felt, z + c)) for c in range(m)
        ]
        feedback = total(answers)
        rows.put("open", feedback)
        slope.set(felt - feedback)
    state = code.variables([common.get("start")])[0]
    with code.loop(0, shape.stages) as k:
        rows, current = work.stage(k), state.get()
        common.put("spill", current)
        columns = [rows.get("columns", j) * common.every("spill", 0, j) for j in range(z)]
        predicted = total([rows.get("shift"), *columns])
        inputs = [
            -over_lanes(code, rows.get("feedback", c) * current, "fadd")
            - rows.one("open", 0, w + c)
            for c in range(m)
        ]
        both = with_elements(code, current, {z + c: inputs[c] for c in range(m)})
        further = {w + i: over_lanes(code, rows.get("extra", i) * both, "fadd") for i in range(m)}
        rows.put("trial", with_elements(code, both, further) + rows.get("extra_shift"))
        moved = [rows.get("columns", z + c) * everywhere(code, inputs[c]) for c in range(m)]
        state.set(predicted + total(moved))
    code.end()


def total(terms: list[Any]) -> Any:
    """Return the sum of one or more values, in two independent chains."""
    even, odd = terms[::2], terms[1::2]
    return reduce(add, even) if not odd else reduce(add, even) + reduce(add, odd)


def mask(code: Code, count: int) -> Value:
    """Return 1 in the first lanes, 0 beyond."""
    return constant(code, [float(i < count) for i in range(code.lanes)])
