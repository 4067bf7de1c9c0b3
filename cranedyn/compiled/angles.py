"""Sine and cosine in code, vectorised over the lanes; functions of libraries take one lane at a
time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.instructions import Instructions, Value
from cranedyn.dynamics.scalars import larger

LARGEST_ANGLE = 1e6
"""Beyond this the reduction of an angle to a quarter turn loses digits [rad]."""


class Series(NamedTuple):
    """Series for sine and cosine of a small rotation.

    Attributes:
        limit: Largest increment at which the error is below the precision of a double [rad].
        sine: Coefficients of the sine, sin h = h + h³ (…), in powers of h².
        versine_series: Coefficients of the versine, 1 - cos h = h² (…), likewise.
    """

    limit: float
    sine: tuple[float, ...]
    versine_series: tuple[float, ...]


SHORTER = Series(1.0 / 640.0, (-1.0 / 6.0,), (0.5, -1.0 / 24.0))
LONGER = Series(1.0 / 64.0, (-1.0 / 6.0, 1.0 / 120.0), (0.5, -1.0 / 24.0, 1.0 / 720.0))
"""The shorter series suffices for most steps."""

HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""π/2 in three parts; products of the first two with whole numbers up to 2²⁰ are exact (Cody &
Waite 1980)."""

SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 8))
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(1, 9))
"""Taylor coefficients of the sine beyond the angle itself, and of the cosine beyond 1."""


def sine_and_cosine(code: Instructions, angle: Value) -> tuple[Value, Value]:
    """Return sine and cosine of an angle [rad], to about one unit in the last place; NaN beyond a
    million rad.

    Two Taylor polynomials, whose error at 45° is below the precision of a double. If a lane has a
    larger angle, all are first reduced by whole quarter turns, which leaves smaller angles
    unchanged, so that lanes do not affect each other. A module contains them once, as a function.
    """
    module = code.function.module
    name = f"sine_and_cosine_{code.lanes}"
    if name not in module.globals:
        kind = ir.FunctionType(ir.LiteralStructType([code.type] * 2), [code.type])
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        outside = code.builder
        code.builder = ir.IRBuilder(function.append_basic_block())
        pair = ir.Constant(kind.return_type, ir.Undefined)
        for i, value in enumerate(_both(code, type(angle)(code, function.args[0]))):
            pair = code.builder.insert_value(pair, value.register, i)
        code.builder.ret(pair)
        code.builder = outside
    both = code.builder.call(module.globals[name], [angle.register])
    sine, cosine = (type(angle)(code, code.builder.extract_value(both, i)) for i in range(2))
    return sine, cosine


def _both(code: Instructions, angle: Value) -> tuple[Value, Value]:
    small = code.everywhere(code.call("llvm.fabs", angle) < np.pi / 4.0)
    with code.builder.if_else(small, likely=True) as (then, otherwise):
        with then:
            plain = _of_eighth_turn(code, angle)
            small_block = code.builder.block
        with otherwise:
            turned = _of_any_angle(code, angle)
            reduced_block = code.builder.block
    pairs = zip(plain, turned, strict=True)
    sine, cosine = (code.join_paths(a, small_block, b, reduced_block) for a, b in pairs)
    return sine, cosine


class Turn(NamedTuple):
    """Rotation to a new angle: sine and cosine before, increment [rad], and the new angle."""

    sine_cosine: tuple[Value, Value]
    increment: Value
    angle: Value

    def rotate(self, series: Series) -> tuple[Value, Value]:
        """Return sine and cosine, updated by the rotation; each update adds a rounding error or
        two.
        """
        (sine, cosine), increment, code = self.sine_cosine, self.increment, self.increment.code
        square = increment * increment
        rise = code.fused(increment * square, _polynomial(code, square, series.sine), increment)
        versine = square * _polynomial(code, square, series.versine_series)
        return (
            code.fused(cosine, rise, code.fused(-sine, versine, sine)),
            code.fused(-sine, rise, code.fused(-cosine, versine, cosine)),
        )

    def refine(self, quick: tuple[Value, Value]) -> tuple[Value, Value]:
        """Return sine and cosine, with lanes beyond the limit of the shorter series replaced by the
        longer series or a full evaluation; other lanes are unchanged.
        """
        short = self.increment * self.increment < SHORTER.limit**2
        code = self.increment.code
        return _where_accurate(self, _chosen(code, short, quick, self.rotate(LONGER)))


def all_within(code: Instructions, turns: Sequence[Turn], series: Series) -> ir.Value:
    """Return whether all increments in all lanes are within the limit of a series."""
    if not turns:
        return ir.Constant(ir.IntType(1), True)
    squares = [turn.increment * turn.increment for turn in turns]
    largest = reduce(larger, squares)
    return code.everywhere(largest < series.limit**2)


def rotate_or_evaluate(turn: Turn) -> tuple[Value, Value]:
    """Return sine and cosine of a rotated angle, by the longer series or a full evaluation."""
    return _where_accurate(turn, turn.rotate(LONGER))


def _where_accurate(turn: Turn, fast: tuple[Value, Value]) -> tuple[Value, Value]:
    """Return the pair where the longer series is accurate, and a full evaluation in other lanes."""
    code = turn.increment.code
    small = all_within(code, [turn], LONGER)
    fast_block = code.builder.block
    with code.builder.if_then(code.builder.not_(small), likely=False):
        little = turn.increment * turn.increment < LONGER.limit**2
        slow = _chosen(code, little, fast, sine_and_cosine(code, turn.angle))
        slow_block = code.builder.block
    pairs = zip(fast, slow, strict=True)
    sine, cosine = (code.join_paths(a, fast_block, b, slow_block) for a, b in pairs)
    return sine, cosine


def _chosen(
    code: Instructions, condition: ir.Value, yes: tuple[Value, Value], no: tuple[Value, Value]
) -> tuple[Value, Value]:
    return code.chosen(condition, yes[0], no[0]), code.chosen(condition, yes[1], no[1])


def _of_eighth_turn(code: Instructions, angle: Value) -> tuple[Value, Value]:
    square = angle * angle
    sine = code.fused(angle * square, _polynomial(code, square, SINE), angle)
    return sine, code.fused(square, _polynomial(code, square, COSINE), 1.0)


def _of_any_angle(code: Instructions, angle: Value) -> tuple[Value, Value]:
    quarters = code.call("llvm.rint", angle * (2.0 / np.pi))
    reduced = angle
    for term in HALF_PI:
        reduced = code.fused(-quarters, code.value(term), reduced)
    sine, cosine = _of_eighth_turn(code, reduced)
    quarter = quarters - code.call("llvm.floor", quarters * 0.25) * 4.0
    half = code.call("llvm.floor", quarter * 0.5)
    odd = quarter - half * 2.0 > 0.5
    sign = 1.0 - half * 2.0
    sign = code.chosen(code.call("llvm.fabs", angle) < LARGEST_ANGLE, sign, np.nan)
    return code.chosen(odd, cosine, sine) * sign, code.chosen(odd, -sine, cosine) * sign


def _polynomial(code: Instructions, x: Value, coefficients: Sequence[float]) -> Value:
    value = code.value(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = code.fused(value, x, coefficient)
    return value
