"""Sine and cosine in code, all lanes at once; libraries' functions would take one lane at a
time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from llvmlite import ir

if TYPE_CHECKING:
    from cranedyn.compiled.code import Code, Value

_LARGEST_ANGLE = 1e6
"""Beyond this the reduction of an angle to a quarter turn loses digits [rad]."""

_LITTLE = 1.0 / 64.0
"""Up to this the series of a small turn end below the precision of a double [rad]."""

_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
"""π/2 in three parts; products of the first two with whole numbers up to 2²⁰ are exact (Cody &
Waite 1980)."""

_SINE = (
    -1.0 / 6.0,
    1.0 / 120.0,
    -1.0 / 5040.0,
    1.0 / 362880.0,
    -1.0 / 39916800.0,
    1.0 / 6227020800.0,
    -1.0 / 1307674368000.0,
)
_COSINE = (
    -0.5,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40320.0,
    -1.0 / 3628800.0,
    1.0 / 479001600.0,
    -1.0 / 87178291200.0,
    1.0 / 20922789888000.0,
)


def sine_and_cosine(code: Code, angle: Value) -> tuple[Value, Value]:
    """Sine and cosine of an angle [rad], to about one unit in the last place; not a number beyond a
    million rad.

    Two Taylor polynomials, which end below the precision of a double at 45°. Where a lane has a
    larger angle, all are reduced by whole quarter turns before; a smaller angle comes out of that
    as it went in, so that no lane feels another. They stand once in a module, as a function.
    """
    module, name = code.function.module, f"sine_and_cosine_{code.lanes}"
    if name not in module.globals:
        kind = ir.FunctionType(ir.LiteralStructType([code.type] * 2), [code.type])
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        outside, code.builder = code.builder, ir.IRBuilder(function.append_basic_block())
        pair = ir.Constant(kind.return_type, ir.Undefined)
        for i, value in enumerate(_both(code, type(angle)(code, function.args[0]))):
            pair = code.builder.insert_value(pair, value.register, i)
        code.builder.ret(pair)
        code.builder = outside
    both = code.builder.call(module.globals[name], [angle.register])
    sine, cosine = (type(angle)(code, code.builder.extract_value(both, i)) for i in range(2))
    return sine, cosine


def _both(code: Code, angle: Value) -> tuple[Value, Value]:
    small = code.everywhere(code.call("llvm.fabs", angle) < np.pi / 4.0)
    with code.builder.if_else(small, likely=True) as (then, otherwise):
        with then:
            plain = _of_eighth_turn(code, angle)
            here = code.builder.block
        with otherwise:
            turned = _of_any_angle(code, angle)
            there = code.builder.block
    sine, cosine = (
        code.joined(one, here, other, there) for one, other in zip(plain, turned, strict=True)
    )
    return sine, cosine


class Turn(NamedTuple):
    """An angle that went on: sine and cosine before, by how much [rad], and where it is now."""

    known: tuple[Value, Value]
    by: Value
    angle: Value

    def little(self) -> ir.Value:
        """For each lane, whether it went on by so little that `turned` is as good as new."""
        return self.by * self.by < _LITTLE**2

    def turned(self) -> tuple[Value, Value]:
        """Sine and cosine from those before; each time adds a rounding or two."""
        (sine, cosine), by, code = self.known, self.by, self.by.code
        square = by * by
        rise = code.fused(by * square, code.fused(square, code.value(1.0 / 120.0), -1.0 / 6.0), by)
        less = code.fused(square, code.value(1.0 / 720.0), -1.0 / 24.0)
        less = square * code.fused(less, square, 0.5)
        return (
            code.fused(cosine, rise, code.fused(-sine, less, sine)),
            code.fused(-sine, rise, code.fused(-cosine, less, cosine)),
        )

    def mended(self, turned: tuple[Value, Value]) -> tuple[Value, Value]:
        """Sine and cosine computed anew in lanes that went on by more; no lane feels another."""
        code, little = self.by.code, self.little()
        sine, cosine = sine_and_cosine(code, self.angle)
        return code.chosen(little, turned[0], sine), code.chosen(little, turned[1], cosine)


def all_little(code: Code, turns: Sequence[Turn]) -> ir.Value:
    """Whether all angles went on by a little in all lanes."""
    if not turns:
        return ir.Constant(ir.IntType(1), True)
    squares = [turn.by * turn.by for turn in turns]
    largest = reduce(lambda a, b: code.chosen(a > b, a, b), squares)
    return code.everywhere(largest < _LITTLE**2)


def turned(code: Code, turn: Turn) -> tuple[Value, Value]:
    """Sine and cosine of an angle that went on."""
    small, fast = all_little(code, [turn]), turn.turned()
    here = code.builder.block
    with code.builder.if_then(code.builder.not_(small), likely=False):
        slow = turn.mended(fast)
        there = code.builder.block
    sine, cosine = (
        code.joined(one, here, other, there) for one, other in zip(fast, slow, strict=True)
    )
    return sine, cosine


def _of_eighth_turn(code: Code, angle: Value) -> tuple[Value, Value]:
    square = angle * angle
    sine = code.fused(angle * square, _polynomial(code, square, _SINE), angle)
    return sine, code.fused(square, _polynomial(code, square, _COSINE), 1.0)


def _of_any_angle(code: Code, angle: Value) -> tuple[Value, Value]:
    quarters = code.call("llvm.rint", angle * (2.0 / np.pi))
    rest = angle
    for part in _HALF_PI:
        rest = code.fused(-quarters, code.value(part), rest)
    sine, cosine = _of_eighth_turn(code, rest)
    quarter = quarters - code.call("llvm.floor", quarters * 0.25) * 4.0
    half = code.call("llvm.floor", quarter * 0.5)
    odd, sign = quarter - half * 2.0 > 0.5, 1.0 - half * 2.0
    sign = code.chosen(code.call("llvm.fabs", angle) < _LARGEST_ANGLE, sign, np.nan)
    return code.chosen(odd, cosine, sine) * sign, code.chosen(odd, -sine, cosine) * sign


def _polynomial(code: Code, x: Value, coefficients: Sequence[float]) -> Value:
    value = code.value(coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = code.fused(value, x, coefficient)
    return value
