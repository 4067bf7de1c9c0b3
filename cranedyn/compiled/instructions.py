"""Instructions for LLVM: doubles, one for each lane of a vector, and their arithmetic.

Numbers known while the code is made stay Python floats and are folded: nothing is multiplied by 1,
added to 0, or computed twice for them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache, reduce
from typing import Any

from llvmlite import ir

INTEGER = ir.IntType(64)
POINTER = ir.PointerType()
DOUBLE = ir.DoubleType()

_LINE = 64
"""Bytes in a line of the cache."""

_WITH_ITSELF = {"fsub": 0.0, "fdiv": 1.0}
"""Results of operations on a number and itself."""

_FAST = ("contract", "reassoc", "nsz", "arcp")
"""Sums and products may be fused and reordered, the sign of zero is free; infinities and NaN
stay."""


class Value:
    """A number that the code computes, in every lane."""

    def __init__(self, code: Instructions, register: ir.Value) -> None:
        self.code = code
        self.register = register

    @property
    def choices(self) -> Instructions:
        """Builder of choices between such numbers."""
        return self.code

    def __add__(self, operand: Any) -> Any:
        return self if _is(operand, 0.0) else self._with("fadd", operand)

    __radd__ = __add__

    def __sub__(self, operand: Any) -> Any:
        return self if _is(operand, 0.0) else self._with("fsub", operand)

    def __rsub__(self, operand: Any) -> Any:
        return -self if _is(operand, 0.0) else self.code.value(operand)._with("fsub", self)

    def __mul__(self, operand: Any) -> Any:
        if isinstance(operand, float) and operand in (0.0, 1.0, -1.0):
            return 0.0 if operand == 0.0 else self if operand == 1.0 else -self
        return self._with("fmul", operand)

    __rmul__ = __mul__

    def __truediv__(self, operand: Any) -> Any:
        return self * (1.0 / operand) if isinstance(operand, float) else self._with("fdiv", operand)

    def __rtruediv__(self, operand: Any) -> Any:
        return 0.0 if _is(operand, 0.0) else self.code.value(operand)._with("fdiv", self)

    def __neg__(self) -> Value:
        return self.code.result("fneg", self)

    def __abs__(self) -> Value:
        return self.code.call("llvm.fabs", self)

    def sin(self) -> Value:
        """Return the sine of an angle [rad]."""
        return self.code.sine_and_cosine(self)[0]

    def cos(self) -> Value:
        """Return the cosine of an angle [rad]."""
        return self.code.sine_and_cosine(self)[1]

    def __lt__(self, operand: Any) -> ir.Value:
        return self._compared("<", operand)

    def __gt__(self, operand: Any) -> ir.Value:
        return self._compared(">", operand)

    def __le__(self, operand: Any) -> ir.Value:
        return self._compared("<=", operand)

    def __ge__(self, operand: Any) -> ir.Value:
        return self._compared(">=", operand)

    def _compared(self, predicate: str, operand: Any) -> ir.Value:
        right = self.code.value(operand).register
        return self.code.builder.fcmp_ordered(predicate, self.register, right)

    def _with(self, operation: str, operand: Any) -> Any:
        same = isinstance(operand, Value) and operand.register is self.register
        if same and operation in _WITH_ITSELF:
            return _WITH_ITSELF[operation]
        return self.code.result(operation, self, operand)


class Instructions:
    """Instructions of a function under construction.

    Attributes:
        lanes: Number of lanes of a value; 1 is a plain double.
        stride: Distance in memory between the numbers of one crane [doubles].
        builder: Builder at the position of the next instruction.
        argument: Arguments by name, all of them addresses.
    """

    _flags: tuple[str, ...] = _FAST

    def __init__(
        self,
        module: ir.Module,
        name: str,
        arguments: Sequence[str],
        lanes: int,
        stride: int | None = None,
    ) -> None:
        self.lanes = lanes
        self.stride = stride or lanes
        self.type = lane_type(lanes)
        self.function = ir.Function(
            module, ir.FunctionType(ir.VoidType(), [POINTER] * len(arguments)), name
        )
        self._align_stack()
        self.argument = dict(zip(arguments, self.function.args, strict=True))
        self.builder = ir.IRBuilder(self.function.append_basic_block())
        self._clear_caches()

    def _clear_caches(self) -> None:
        """Clear all cached values: results, sines and cosines, and increments of angles."""
        self._results: dict[tuple[Any, ...], Value] = {}
        self._angles: dict[ir.Value, tuple[Value, Value]] = {}
        self._turns: dict[ir.Value, tuple[Value, Value]] = {}

    def _align_stack(self) -> None:
        """Keep spilled vectors from crossing lines of the cache."""
        if self.lanes > 1:
            self.function.attributes.alignstack = min(8 * self.lanes, _LINE)
            # llvmlite writes alignstack only beside another attribute.
            self.function.attributes.add("nounwind")

    @contextmanager
    def as_written(self) -> Iterator[None]:
        """Emit sums and products that are rounded one by one, in the order of the text."""
        self._flags = ()
        yield
        self._flags = _FAST

    def value(self, number: Any) -> Value:
        """Return a number as a value of the code."""
        if isinstance(number, Value):
            return number
        return Value(self, _constant(self.lanes, float(number).hex()))

    def result(self, operation: str, *operands: Any) -> Value:
        """Return a sum, difference, product, quotient or negative, computed once in a block."""
        terms = (x.register if isinstance(x, Value) else float(x) for x in operands)
        key = self.builder.block, self._flags, operation, *terms
        if key not in self._results:
            registers = (self.value(operand).register for operand in operands)
            result = getattr(self.builder, operation)(*registers, flags=self._flags)
            self._results[key] = Value(self, result)
        return self._results[key]

    def fused(self, a: Value, b: Value, c: Any) -> Value:
        """Return a b + c, rounded once where the machine can."""
        return self.call("llvm.fmuladd", a, b, c)

    def quotient(self, value: Value, by: Any) -> Value:
        """Return a quotient, rounded once; a product with the reciprocal has a systematic error."""
        if _is(by, 1.0):
            return value
        return Value(self, self.builder.fdiv(value.register, self.value(by).register))

    def call(self, intrinsic: str, *values: Any) -> Value:
        """Call an intrinsic function of LLVM, such as llvm.maxnum, llvm.sqrt, llvm.fabs."""
        name = f"{intrinsic}.{f'v{self.lanes}' if self.lanes > 1 else ''}f64"
        registers = [self.value(value).register for value in values]
        return Value(self, self._intrinsic(name, self.type, registers))

    def chosen(self, condition: ir.Value, yes: Any, no: Any) -> Value:
        """Return one value where a condition holds and another elsewhere."""
        registers = self.value(yes).register, self.value(no).register
        return Value(self, self.builder.select(condition, *registers))

    def sine_and_cosine(self, angle: Value) -> tuple[Value, Value]:
        """Return sine and cosine of an angle [rad]."""
        raise NotImplementedError

    def join_paths(self, a: Value, from_a: ir.Block, b: Value, from_b: ir.Block) -> Value:
        """Return the value of the block from which this point was reached."""
        phi = self.builder.phi(self.type)
        phi.add_incoming(a.register, from_a)
        phi.add_incoming(b.register, from_b)
        return Value(self, phi)

    def clipped(self, value: Value, low: Any, high: Any) -> Value:
        """Clip a value to a range; NaN stays."""
        value = self.chosen(value < low, low, value)
        return self.chosen(value > high, high, value)

    def both(self, *conditions: Any) -> ir.Value:
        """Return whether all conditions hold; some may be Python bools."""
        return reduce(self.builder.and_, map(self._condition, conditions))

    def _condition(self, condition: Any) -> ir.Value:
        if not isinstance(condition, bool):
            return condition
        kind = ir.IntType(1)
        if self.lanes == 1:
            return ir.Constant(kind, condition)
        return ir.Constant(ir.VectorType(kind, self.lanes), [condition] * self.lanes)

    def either(self, *conditions: ir.Value) -> ir.Value:
        """Return whether one of the conditions holds."""
        return reduce(self.builder.or_, conditions)

    def everywhere(self, condition: ir.Value) -> ir.Value:
        """Return whether a condition holds in all lanes."""
        return self._over_lanes("and", condition)

    def anywhere(self, condition: ir.Value) -> ir.Value:
        """Return whether a condition holds in some lane."""
        return self._over_lanes("or", condition)

    def _over_lanes(self, operation: str, condition: ir.Value) -> ir.Value:
        if self.lanes == 1:
            return condition
        name = f"llvm.vector.reduce.{operation}.v{self.lanes}i1"
        return self._intrinsic(name, ir.IntType(1), [condition])

    def _intrinsic(self, name: str, result: ir.Type, values: Sequence[ir.Value]) -> ir.Value:
        module = self.function.module
        kind = ir.FunctionType(result, [value.type for value in values])
        function = module.globals.get(name) or ir.Function(module, kind, name)
        return self.builder.call(function, values)

    def integer(self, number: int) -> ir.Value:
        """Return a constant whole number."""
        return ir.Constant(INTEGER, number)

    def least(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Return the smaller of two whole numbers."""
        return self.builder.select(self.builder.icmp_signed("<", a, b), a, b)

    def most(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Return the larger of two whole numbers."""
        return self.builder.select(self.builder.icmp_signed(">", a, b), a, b)

    def product(self, a: ir.Value, number: int) -> ir.Value:
        """Return a multiple of a whole number."""
        return self.builder.mul(a, self.integer(number))

    def plus(self, a: ir.Value, number: int) -> ir.Value:
        """Return the sum of a whole number and a constant."""
        return self.builder.add(a, self.integer(number))

    def from_integer(self, number: ir.Value) -> Value:
        """Return a whole number in every lane."""
        return self.from_double(self.builder.sitofp(number, DOUBLE))

    def from_double(self, double: ir.Value) -> Value:
        """Return one double in every lane."""
        if self.lanes == 1:
            return Value(self, double)
        undefined, first, everywhere = _spreading(self.lanes)
        register = self.builder.insert_element(undefined, double, first)
        return Value(self, self.builder.shuffle_vector(register, undefined, everywhere))

    def load(self, pointer: ir.Value, first: Any = 0) -> Value:
        """Load the lanes from consecutive doubles of memory, beginning at an index."""
        return Value(self, self.builder.load(self.address(pointer, first), align=8, typ=self.type))

    def store(self, value: Any, pointer: ir.Value, first: Any = 0) -> None:
        """Store the lanes in consecutive doubles of memory."""
        self.builder.store(self.value(value).register, self.address(pointer, first), align=8)

    def spread(self, pointer: ir.Value, index: Any) -> Value:
        """Load one double of memory into every lane."""
        return self.from_double(self.load_one(pointer, index, DOUBLE))

    def gather(self, addresses: Sequence[ir.Value], index: int = 0) -> Value:
        """Load a double at an index behind the address of each lane, or behind one for all."""
        if len(addresses) == 1:
            return self.spread(addresses[0], index)
        register = ir.Constant(self.type, ir.Undefined)
        for lane, address in enumerate(addresses):
            double = self.load_one(address, index, DOUBLE)
            place = ir.Constant(ir.IntType(32), lane)
            register = self.builder.insert_element(register, double, place)
        return Value(self, register)

    def load_one(self, pointer: ir.Value, index: Any, kind: ir.Type) -> ir.Value:
        """Load one whole number, double or address."""
        return self.builder.load(self.address(pointer, index), align=8, typ=kind)

    def address(self, pointer: ir.Value, index: Any) -> ir.Value:
        """Return the address of a double at an index, whole number of code or of Python."""
        offset = index if isinstance(index, ir.Value) else self.integer(index)
        return self.builder.gep(pointer, [offset], source_etype=DOUBLE)


@cache
def lane_type(lanes: int) -> ir.Type:
    """Return the type of a double for each lane."""
    return ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE


@lru_cache(maxsize=4096)
def _constant(lanes: int, text: str) -> ir.Constant:
    """Return a number in every lane, cached because its text is made often.

    The key is the text of `float.hex`, which has a sign also of zero.
    """
    number = float.fromhex(text)
    return ir.Constant(lane_type(lanes), [number] * lanes if lanes > 1 else number)


@cache
def _spreading(lanes: int) -> tuple[ir.Constant, ir.Constant, ir.Constant]:
    """Return an undefined vector, the index of its first lane, and that index for every lane."""
    index = ir.IntType(32)
    zeros = ir.Constant(ir.VectorType(index, lanes), [0] * lanes)
    return ir.Constant(lane_type(lanes), ir.Undefined), ir.Constant(index, 0), zeros


def _is(operand: Any, number: float) -> bool:
    return isinstance(operand, float) and operand == number
