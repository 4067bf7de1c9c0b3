"""Code under construction: doubles, one for each lane of a vector, and the arithmetic that adds
instructions for LLVM.

What is known while the code is made stays a Python float and is folded: nothing is multiplied by 1,
added to 0, or computed twice for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache, reduce
from typing import Any

from llvmlite import ir

from cranedyn.compiled.angles import Turn, sine_and_cosine, turned_or_anew

INTEGER, POINTER, DOUBLE = ir.IntType(64), ir.PointerType(), ir.DoubleType()

_LINE = 64
"""Bytes in a line of the cache."""

_OF_ITSELF = {"fsub": 0.0, "fdiv": 1.0}
"""What comes of a number and itself."""

_FAST = ("contract", "reassoc", "nsz", "arcp")
"""Sums and products may be fused and put in another order, the sign of zero is free; infinities and
what is not a number stay."""


class Value:
    """A number that the code computes, in every lane."""

    def __init__(self, code: Code, register: ir.Value) -> None:
        self.code, self.register = code, register

    @property
    def choices(self) -> Code:
        """What chooses between such numbers."""
        return self.code

    def __add__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self._with("fadd", other)

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        return self if _is(other, 0.0) else self._with("fsub", other)

    def __rsub__(self, other: Any) -> Any:
        return -self if _is(other, 0.0) else self.code.value(other)._with("fsub", self)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, float) and other in (0.0, 1.0, -1.0):
            return 0.0 if other == 0.0 else self if other == 1.0 else -self
        return self._with("fmul", other)

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        return self * (1.0 / other) if isinstance(other, float) else self._with("fdiv", other)

    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if _is(other, 0.0) else self.code.value(other)._with("fdiv", self)

    def __neg__(self) -> Value:
        return self.code.result("fneg", self)

    def sin(self) -> Value:
        """Sine of an angle [rad]."""
        return self.code.sine_and_cosine(self)[0]

    def cos(self) -> Value:
        """Cosine of an angle [rad]."""
        return self.code.sine_and_cosine(self)[1]

    def __lt__(self, other: Any) -> ir.Value:
        return self._compared("<", other)

    def __gt__(self, other: Any) -> ir.Value:
        return self._compared(">", other)

    def __le__(self, other: Any) -> ir.Value:
        return self._compared("<=", other)

    def __ge__(self, other: Any) -> ir.Value:
        return self._compared(">=", other)

    def _compared(self, how: str, other: Any) -> ir.Value:
        return self.code.builder.fcmp_ordered(how, self.register, self.code.value(other).register)

    def _with(self, operation: str, other: Any) -> Any:
        if isinstance(other, Value) and other.register is self.register and operation in _OF_ITSELF:
            return _OF_ITSELF[operation]
        return self.code.result(operation, self, other)


class Code:
    """A function under construction.

    Attributes:
        lanes: How many numbers a value holds; 1 is a plain double.
        apart: How far apart the numbers of one crane stand in memory.
        builder: Where the next instruction goes.
        argument: The arguments, all of them addresses, by name.
    """

    def __init__(
        self,
        module: ir.Module,
        name: str,
        arguments: Sequence[str],
        lanes: int,
        apart: int | None = None,
    ) -> None:
        self.lanes, self.apart = lanes, apart or lanes
        self.type = lane_type(lanes)
        self.function = ir.Function(
            module, ir.FunctionType(ir.VoidType(), [POINTER] * len(arguments)), name
        )
        if lanes > 1:  # or vectors that wait on the stack would cross lines of the cache
            self.function.attributes.alignstack = min(8 * lanes, _LINE)
            self.function.attributes.add("nounwind")  # llvmlite writes the one only with another
        self.argument = dict(zip(arguments, self.function.args, strict=True))
        self.builder = ir.IRBuilder(self.function.append_basic_block())
        self._know_nothing()

    def _know_nothing(self) -> None:
        """Begin without a value."""
        self._angles: dict[ir.Value, tuple[Value, Value]] = {}
        self._turns: dict[ir.Value, tuple[Value, Value]] = {}
        self._results: dict[tuple[Any, ...], Value] = {}
        self._asked: set[ir.Value] = set()

    def value(self, number: Any) -> Value:
        """A number known now as one that the code has."""
        if isinstance(number, Value):
            return number
        return Value(self, _constant(self.lanes, float(number).hex()))

    def result(self, operation: str, *operands: Any) -> Value:
        """A sum, difference, product, quotient or negative; asked for again in the same block it is
        the one there is.
        """
        known = (one.register if isinstance(one, Value) else float(one) for one in operands)
        key = self.builder.block, operation, *known
        if key not in self._results:
            registers = (self.value(one).register for one in operands)
            made = getattr(self.builder, operation)(*registers, flags=_FAST)
            self._results[key] = Value(self, made)
        return self._results[key]

    def fused(self, a: Value, b: Value, c: Any) -> Value:
        """A b + c, rounded once where the machine can."""
        return self.call("llvm.fmuladd", a, b, c)

    def quotient(self, value: Value, by: Any) -> Value:
        """A quotient rounded once: a product with the reciprocal is off to the same side always."""
        if _is(by, 1.0):
            return value
        return Value(self, self.builder.fdiv(value.register, self.value(by).register))

    def call(self, intrinsic: str, *values: Any) -> Value:
        """One of LLVM's functions of numbers, such as llvm.maxnum, llvm.sqrt, llvm.fabs."""
        name = f"{intrinsic}.{f'v{self.lanes}' if self.lanes > 1 else ''}f64"
        return Value(
            self, self._intrinsic(name, self.type, [self.value(value).register for value in values])
        )

    def chosen(self, condition: ir.Value, yes: Any, no: Any) -> Value:
        """One value where a condition holds, another where not."""
        return Value(
            self, self.builder.select(condition, self.value(yes).register, self.value(no).register)
        )

    def sine_and_cosine(self, angle: Value) -> tuple[Value, Value]:
        """Sine and cosine together [rad], see `cranedyn.compiled.angles`; asked for the same value
        again they are those there are; of an angle that has `gone_on` those from which it comes,
        turned.
        """
        self._asked.add(angle.register)
        if angle.register not in self._angles:
            turn = self.turn(angle)
            self._angles[angle.register] = (
                sine_and_cosine(self, angle) if turn is None else turned_or_anew(turn)
            )
        return self._angles[angle.register]

    def turn(self, angle: Value) -> Turn | None:
        """How an angle went on from one whose sine and cosine are known; None if it did not."""
        before, by = self._turns.get(angle.register, (angle, angle))
        known = self._angles.get(before.register)
        return None if known is None else Turn(known, by, angle)

    def asked(self, angle: Value) -> bool:
        """Whether sine or cosine of an angle were asked for."""
        return angle.register in self._asked

    def known_angle(self, angle: Value, sine: Value, cosine: Value) -> None:
        """Have sine and cosine of an angle, here and until this loop or condition ends."""
        self._angles[angle.register] = sine, cosine

    def gone_on(self, before: Value, by: Any) -> Value:
        """A sum, of which it is remembered what comes from what, in case it is an angle."""
        after = before + by
        if isinstance(by, Value) and after is not before:
            self._turns[after.register] = before, by
        return after

    def joined(self, a: Value, from_a: ir.Block, b: Value, from_b: ir.Block) -> Value:
        """The value of one block or the other, whichever this point was reached from."""
        phi = self.builder.phi(self.type)
        phi.add_incoming(a.register, from_a)
        phi.add_incoming(b.register, from_b)
        return Value(self, phi)

    def clipped(self, value: Value, low: Any, high: Any) -> Value:
        """A value cut to a range; what is not a number stays."""
        value = self.chosen(value < low, low, value)
        return self.chosen(value > high, high, value)

    def both(self, *conditions: Any) -> ir.Value:
        """Whether all conditions hold; one may be known now."""
        return reduce(self.builder.and_, map(self._condition, conditions))

    def _condition(self, condition: Any) -> ir.Value:
        if not isinstance(condition, bool):
            return condition
        kind = ir.IntType(1)
        if self.lanes == 1:
            return ir.Constant(kind, condition)
        return ir.Constant(ir.VectorType(kind, self.lanes), [condition] * self.lanes)

    def either(self, *conditions: ir.Value) -> ir.Value:
        """Whether one of the conditions holds."""
        return reduce(self.builder.or_, conditions)

    def everywhere(self, condition: ir.Value) -> ir.Value:
        """Whether a condition holds in all lanes."""
        return self._over_lanes("and", condition)

    def anywhere(self, condition: ir.Value) -> ir.Value:
        """Whether a condition holds in a lane."""
        return self._over_lanes("or", condition)

    def _over_lanes(self, how: str, condition: ir.Value) -> ir.Value:
        if self.lanes == 1:
            return condition
        return self._intrinsic(
            f"llvm.vector.reduce.{how}.v{self.lanes}i1", ir.IntType(1), [condition]
        )

    def _intrinsic(self, name: str, answer: ir.Type, values: Sequence[ir.Value]) -> ir.Value:
        module = self.function.module
        kind = ir.FunctionType(answer, [value.type for value in values])
        return self.builder.call(
            module.globals.get(name) or ir.Function(module, kind, name), values
        )

    def integer(self, number: int) -> ir.Value:
        """A whole number known now."""
        return ir.Constant(INTEGER, number)

    def least(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """The smaller of two whole numbers."""
        return self.builder.select(self.builder.icmp_signed("<", a, b), a, b)

    def most(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """The larger of two whole numbers."""
        return self.builder.select(self.builder.icmp_signed(">", a, b), a, b)

    def product(self, a: ir.Value, number: int) -> ir.Value:
        """A whole number so many times."""
        return self.builder.mul(a, self.integer(number))

    def from_integer(self, number: ir.Value) -> Value:
        """A whole number in every lane."""
        return self.from_double(self.builder.sitofp(number, DOUBLE))

    def from_double(self, part: ir.Value) -> Value:
        """One double in every lane."""
        if self.lanes == 1:
            return Value(self, part)
        undefined, first, everywhere = _spreading(self.lanes)
        register = self.builder.insert_element(undefined, part, first)
        return Value(self, self.builder.shuffle_vector(register, undefined, everywhere))

    def load(self, pointer: ir.Value, first: Any = 0) -> Value:
        """The lanes that stand one after another in memory, from an index of doubles on."""
        return Value(self, self.builder.load(self._at(pointer, first), align=8, typ=self.type))

    def store(self, value: Any, pointer: ir.Value, first: Any = 0) -> None:
        """Put the lanes into memory one after another."""
        self.builder.store(self.value(value).register, self._at(pointer, first), align=8)

    def spread(self, pointer: ir.Value, place: Any) -> Value:
        """One double of memory in every lane."""
        return self.from_double(self.builder.load(self._at(pointer, place), align=8, typ=DOUBLE))

    def gathered(self, pointer: ir.Value, places: Sequence[Any]) -> Value:
        """A double of memory for each lane, each from a place of its own."""
        if self.lanes == 1:
            return self.spread(pointer, places[0])
        register = ir.Constant(self.type, ir.Undefined)
        for lane, place in enumerate(places):
            part = self.builder.load(self._at(pointer, place), align=8, typ=DOUBLE)
            register = self.builder.insert_element(
                register, part, ir.Constant(ir.IntType(32), lane)
            )
        return Value(self, register)

    def load_one(self, pointer: ir.Value, place: int, kind: ir.Type) -> ir.Value:
        """One whole number, double or address of memory."""
        return self.builder.load(self._at(pointer, place), align=8, typ=kind)

    def _at(self, pointer: ir.Value, index: Any) -> ir.Value:
        place = index if isinstance(index, ir.Value) else self.integer(index)
        return self.builder.gep(pointer, [place], source_etype=DOUBLE)

    def variables(self, values: Sequence[Any]) -> list[Variable]:
        """Places for values that change from one pass of a loop to the next."""
        return [Variable(self, value) for value in values]

    @contextmanager
    def loop(self, first: Any, last: Any) -> Iterator[ir.Value]:
        """Statements for each whole number from the first up to, but without, the last."""
        begin, end = (x if isinstance(x, ir.Value) else self.integer(x) for x in (first, last))
        before = self.builder.block
        head, body, after = (
            self.function.append_basic_block(name) for name in ("head", "body", "after")
        )
        self.builder.branch(head)
        self.builder.position_at_end(head)
        counter = self.builder.phi(INTEGER)
        counter.add_incoming(begin, before)
        self.builder.cbranch(self.builder.icmp_signed("<", counter, end), body, after)
        self.builder.position_at_end(body)
        self._forget()
        yield counter
        counter.add_incoming(self.builder.add(counter, self.integer(1)), self.builder.block)
        self.builder.branch(head)
        self.builder.position_at_end(after)
        self._forget()

    @contextmanager
    def stretches(self, first: ir.Value, last: ir.Value) -> Iterator[Callable[[ir.Value], None]]:
        """Statements for each whole number from the first up to, but without, the last, in a loop
        without branches that is left where something rare is to be done.

        Yields:
            What to call at the end of the statements with whether nothing is. Statements after that
            call are gone through where something is, and after the last number.
        """
        block, build = self.function.append_basic_block, self.builder
        head, body, rest, after = (block(name) for name in ("head", "body", "rest", "after"))
        before = build.block
        build.branch(head)
        build.position_at_end(head)
        begin = build.phi(INTEGER)
        build.cbranch(build.icmp_signed("<", begin, last), body, after)
        build.position_at_end(body)
        number = build.phi(INTEGER)
        next_one = build.add(number, self.integer(1))
        self._forget()

        def end(nothing: ir.Value) -> None:
            on = build.and_(nothing, build.icmp_signed("<", next_one, last))
            number.add_incoming(next_one, build.block)
            build.cbranch(on, body, rest)
            build.position_at_end(rest)

        yield end
        begin.add_incoming(first, before)
        begin.add_incoming(next_one, build.block)
        number.add_incoming(begin, head)
        build.branch(head)
        build.position_at_end(after)
        self._forget()

    @contextmanager
    def when(self, condition: ir.Value) -> Iterator[None]:
        """Statements for where a condition, one for all lanes, holds."""
        with self.builder.if_then(condition):
            self._forget()
            yield
        self._forget()

    def _forget(self) -> None:
        """What was computed elsewhere may not have been on the way here."""
        self._angles = {}

    def end(self) -> None:
        """Nothing more comes."""
        self.builder.ret_void()


class Variable:
    """A place whose value changes."""

    def __init__(self, code: Code, value: Any) -> None:
        self._code = code
        with code.builder.goto_entry_block():
            self._place = code.builder.alloca(code.type)
        self.set(value)

    def get(self) -> Value:
        """What is in it at this point of the code."""
        return Value(self._code, self._code.builder.load(self._place, typ=self._code.type))

    def set(self, value: Any) -> None:
        """Put a value into it."""
        self._code.builder.store(self._code.value(value).register, self._place)


@cache
def lane_type(lanes: int) -> ir.Type:
    """A double for each lane."""
    return ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE


@lru_cache(maxsize=4096)
def _constant(lanes: int, written: str) -> ir.Constant:
    """A number in every lane, the same object for the same number: LLVM's text is made of it often.
    It is told by what `float.hex` writes, which has a sign also of zero.
    """
    number = float.fromhex(written)
    return ir.Constant(lane_type(lanes), [number] * lanes if lanes > 1 else number)


@cache
def _spreading(lanes: int) -> tuple[ir.Constant, ir.Constant, ir.Constant]:
    """A vector of anything, the first of its places, and that place for every lane."""
    index = ir.IntType(32)
    places = ir.Constant(ir.VectorType(index, lanes), [0] * lanes)
    return ir.Constant(lane_type(lanes), ir.Undefined), ir.Constant(index, 0), places


def _is(other: Any, number: float) -> bool:
    return isinstance(other, float) and other == number
