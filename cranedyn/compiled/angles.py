"""Sine and cosine in code, vectorised over the lanes: functions of libraries take one lane at a
time.

An angle that changes little in a step is not evaluated afresh: sine and cosine are rotated by the
increment h,

    sin(x + h) = sin x cos h + cos x sin h,     cos(x + h) = cos x cos h - sin x sin h,

with short series for sin h and for the versine 1 - cos h, which is small as h is, so that no digits
are lost.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from llvmlite import ir

from cranedyn.compiled.instructions import SINGLE, Instructions, Value
from cranedyn.dynamics.scalars import larger

LARGEST_ANGLE = 1e6
"""Largest angle that is reduced by whole quarter turns without a loss of digits [rad]. It has fewer
than 2²⁰ of them, see `HALF_PI`."""

LARGEST_SINGLE_ANGLE = 1e4
"""The same in single precision, where it has fewer than 2¹³ quarter turns."""


class Series(NamedTuple):
    """Series for sine and cosine of a small rotation.

    Attributes:
        limit: Largest increment h at which the error is below the precision of a double [rad]: the
            first term that is left out is below 2⁻⁵³ there.
        sine: Coefficients of the sine, sin h = h + h³ (…), in powers of h².
        versine_series: Coefficients of the versine, 1 - cos h = h² (…), likewise.
    """

    limit: float
    sine: tuple[float, ...]
    versine_series: tuple[float, ...]


SHORTER = Series(
    limit=1.0 / 640.0,
    sine=(-1.0 / 6.0,),
    versine_series=(0.5, -1.0 / 24.0),
)
"""Taylor series that suffices for most steps."""

LONGER = Series(
    limit=1.0 / 64.0,
    sine=(-1.0 / 6.0, 1.0 / 120.0),
    versine_series=(0.5, -1.0 / 24.0, 1.0 / 720.0),
)
"""Taylor series for larger increments."""

HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""π/2 in three parts; products of the first two with whole numbers up to 2²⁰ are exact (Cody and
Waite, Software Manual for the Elementary Functions, 1980).
"""

SINGLE_HALF_PI = (1.5703125, 4.837512969970703e-4, 7.549789948768648e-8)
"""π/2 in three parts for single precision; products of the first two, which have 8 and 11 bits,
with whole numbers up to 2¹³ are exact. What the rounding of the third leaves out is 2e-15 rad for
each quarter turn."""

SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(1, 8))
"""Taylor coefficients of the sine beyond the angle itself, sin x = x + x³ (…), in powers of x²."""

COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(1, 9))
"""Taylor coefficients of the cosine beyond 1, cos x = 1 + x² (…), in powers of x²."""


def sine_and_cosine(code: Instructions, angle: Value) -> tuple[Value, Value]:
    """Return sine and cosine of an angle [rad], to about one unit in the last place; NaN beyond
    `LARGEST_ANGLE`, in single precision `LARGEST_SINGLE_ANGLE`.

    They are two Taylor polynomials, whose error at 45° is below the precision of a double. If a
    lane has a larger angle, the angles of all lanes are first reduced by whole quarter turns. This
    leaves smaller angles unchanged, so that lanes do not affect each other. A module contains the
    polynomials once, as a function.
    """
    module = code.function.module
    name = f"sine_and_cosine_{code.lanes}"
    if code.scalar is SINGLE:
        name += "_single"
    if name not in module.globals:
        kind = ir.FunctionType(ir.LiteralStructType([code.type] * 2), [code.type])
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        # The polynomials are emitted into the new function by the builder of this one.
        outside = code.builder
        code.builder = ir.IRBuilder(function.append_basic_block())
        pair = ir.Constant(kind.return_type, ir.Undefined)
        argument = type(angle)(code, function.args[0])
        for i, value in enumerate(_evaluate(code, argument)):
            pair = code.builder.insert_value(pair, value.register, i)
        code.builder.ret(pair)
        code.builder = outside  # back to the function from which this one is called
    result = code.builder.call(module.globals[name], [angle.register])
    sine = type(angle)(code, code.builder.extract_value(result, 0))
    cosine = type(angle)(code, code.builder.extract_value(result, 1))
    return sine, cosine


def _evaluate(code: Instructions, angle: Value) -> tuple[Value, Value]:
    """Return sine and cosine of an angle of any size, without the reduction where all lanes have
    less than 45°.
    """
    small = code.everywhere(code.call("llvm.fabs", angle) < np.pi / 4.0)
    with code.builder.if_else(small, likely=True) as (then, otherwise):
        with then:
            unreduced = _of_eighth_turn(code, angle)
            small_block = code.builder.block
        with otherwise:
            reduced = _of_any_angle(code, angle)
            reduced_block = code.builder.block
    sine = code.join_paths(unreduced[0], small_block, reduced[0], reduced_block)
    cosine = code.join_paths(unreduced[1], small_block, reduced[1], reduced_block)
    return sine, cosine


class Turn(NamedTuple):
    """Rotation to a new angle.

    Attributes:
        sine_cosine: Sine and cosine of the angle before.
        increment: Change of the angle [rad].
        angle: The new angle [rad].
    """

    sine_cosine: tuple[Value, Value]
    increment: Value
    angle: Value

    def rotate(self, series: Series) -> tuple[Value, Value]:
        """Return sine and cosine, updated by the rotation; each update adds a rounding error or
        two.
        """
        sine, cosine = self.sine_cosine
        increment = self.increment
        code = increment.code
        square = increment * increment
        rise = code.fused(increment * square, _polynomial(code, square, series.sine), increment)
        versine = square * _polynomial(code, square, series.versine_series)
        # sin x - sin x (1 - cos h) + cos x sin h, and likewise for the cosine.
        new_sine = code.fused(cosine, rise, code.fused(-sine, versine, sine))
        new_cosine = code.fused(-sine, rise, code.fused(-cosine, versine, cosine))
        return new_sine, new_cosine

    def refine(self, quick: tuple[Value, Value]) -> tuple[Value, Value]:
        """Return sine and cosine, with lanes beyond the limit of the shorter series replaced by the
        longer series or a full evaluation; other lanes are unchanged.

        Args:
            quick: Sine and cosine by the shorter series.
        """
        is_short = self.increment * self.increment < SHORTER.limit**2
        code = self.increment.code
        return _where_accurate(self, _choose_pair(code, is_short, quick, self.rotate(LONGER)))


def all_within(code: Instructions, turns: Sequence[Turn], series: Series) -> ir.Value:
    """Return whether all increments in all lanes are within the limit of a series."""
    if not turns:
        return ir.Constant(ir.IntType(1), True)
    squares = [turn.increment * turn.increment for turn in turns]
    largest = squares[0]
    for square in squares[1:]:
        largest = larger(largest, square)
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
        is_small = turn.increment * turn.increment < LONGER.limit**2
        slow = _choose_pair(code, is_small, fast, sine_and_cosine(code, turn.angle))
        slow_block = code.builder.block
    sine = code.join_paths(fast[0], fast_block, slow[0], slow_block)
    cosine = code.join_paths(fast[1], fast_block, slow[1], slow_block)
    return sine, cosine


def _choose_pair(
    code: Instructions, condition: ir.Value, yes: tuple[Value, Value], no: tuple[Value, Value]
) -> tuple[Value, Value]:
    """Return one pair in the lanes where a condition holds, and another in the others."""
    return code.where(condition, yes[0], no[0]), code.where(condition, yes[1], no[1])


def _of_eighth_turn(code: Instructions, angle: Value) -> tuple[Value, Value]:
    """Return sine and cosine of an angle up to 45°, by their Taylor polynomials."""
    square = angle * angle
    sine = code.fused(angle * square, _polynomial(code, square, SINE), angle)
    cosine = code.fused(square, _polynomial(code, square, COSINE), 1.0)
    return sine, cosine


def _of_any_angle(code: Instructions, angle: Value) -> tuple[Value, Value]:
    """Return sine and cosine of an angle that is reduced by whole quarter turns; NaN beyond the
    largest angle.

    After an odd number of quarter turns, sine and cosine change places and one of them its sign;
    after half a turn both change their signs.
    """
    is_single = code.scalar is SINGLE
    largest_angle = LARGEST_SINGLE_ANGLE if is_single else LARGEST_ANGLE
    quarters = code.call("llvm.rint", angle * (2.0 / np.pi))
    reduced = angle
    for part in SINGLE_HALF_PI if is_single else HALF_PI:
        reduced = code.fused(-quarters, code.value(part), reduced)
    sine, cosine = _of_eighth_turn(code, reduced)
    # Remainders of the number of quarters by 4 and by 2, without whole numbers of the code.
    quarter = quarters - code.call("llvm.floor", quarters * 0.25) * 4.0
    half = code.call("llvm.floor", quarter * 0.5)
    odd = quarter - half * 2.0 > 0.5
    sign = 1.0 - half * 2.0
    sign = code.where(code.call("llvm.fabs", angle) < largest_angle, sign, np.nan)
    return code.where(odd, cosine, sine) * sign, code.where(odd, -sine, cosine) * sign


def _polynomial(code: Instructions, x: Value, coefficients: Sequence[float]) -> Value:
    """Return a polynomial by Horner's rule, from its coefficients of ascending order."""
    value = code.value(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = code.fused(value, x, coefficient)
    return value
