"""Instructions for LLVM: numbers, one for each lane of a vector, and their arithmetic.

A function of Python that runs with a `Value` in place of each number leaves behind the instructions
that compute it: every sum or product of values adds one to the function under construction. Here
are the values (`Value`) and the instructions (`Instructions`); loops, conditions, and sines and
cosines are added by `cranedyn.compiled.code.Code`.

Numbers known while the code is made stay Python floats and are folded: nothing is multiplied by 1,
added to 0, or computed twice for them.

Numbers are doubles, or in code of single precision floats of four bytes, of which a vector holds
twice as many. Memory holds doubles in both cases: code of single precision converts what it loads
and stores.

Two kinds of whole numbers occur: those of Python, which are known while the code is made, and those
of the code, which are of type `ir.Value`, such as the counters of its loops. The latter are the
same for all lanes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache, reduce
from typing import Any

import numpy as np
from llvmlite import ir

from cranedyn.dynamics.scalars import array

INTEGER = ir.IntType(64)
POINTER = ir.PointerType()
DOUBLE = ir.DoubleType()
SINGLE = ir.FloatType()

_CACHE_LINE = 64
"""Bytes in a line of the cache, and in the widest vector."""

_WITH_ITSELF = {"fsub": 0.0, "fdiv": 1.0}
"""Results of operations on a number and itself, by the name of LLVM's instruction."""

_FAST = ("contract", "reassoc", "nsz", "arcp")
"""Flags of LLVM for sums and products, by which it may make them faster at the cost of other
rounding: fuse a product with a sum, reorder them, ignore the sign of zero, and multiply by a
reciprocal. Infinities and NaN must stay what they are, since a run that diverges is recognised by
them: the flags `nnan` and `ninf` are left out."""


class Value:
    """A number that the code computes, in every lane.

    Attributes:
        code: The function under construction.
        register: LLVM's name of the result.
    """

    def __init__(self, code: Instructions, register: ir.Value) -> None:
        self.code = code
        self.register = register

    @property
    def choices(self) -> Instructions:
        """What chooses between such numbers, see `cranedyn.dynamics.scalars.where`."""
        return self.code

    def __add__(self, operand: Any) -> Any:
        return self if _is_float(operand, 0.0) else self._combined("fadd", operand)

    __radd__ = __add__

    def __sub__(self, operand: Any) -> Any:
        return self if _is_float(operand, 0.0) else self._combined("fsub", operand)

    def __rsub__(self, operand: Any) -> Any:
        return (
            -self if _is_float(operand, 0.0) else self.code.value(operand)._combined("fsub", self)
        )

    def __mul__(self, operand: Any) -> Any:
        if isinstance(operand, float) and operand in (0.0, 1.0, -1.0):
            # Code is for numbers that are finite: only then is the product with zero zero.
            if operand == 0.0:
                return 0.0
            return self if operand == 1.0 else -self
        return self._combined("fmul", operand)

    __rmul__ = __mul__

    def __truediv__(self, operand: Any) -> Any:
        # A product takes a fraction of the time of a quotient, and differs by a rounding error. See
        # `Instructions.quotient` for where that adds up.
        return (
            self * (1.0 / operand)
            if isinstance(operand, float)
            else self._combined("fdiv", operand)
        )

    def __rtruediv__(self, operand: Any) -> Any:
        return 0.0 if _is_float(operand, 0.0) else self.code.value(operand)._combined("fdiv", self)

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
        return self._compare("<", operand)

    def __gt__(self, operand: Any) -> ir.Value:
        return self._compare(">", operand)

    def __le__(self, operand: Any) -> ir.Value:
        return self._compare("<=", operand)

    def __ge__(self, operand: Any) -> ir.Value:
        return self._compare(">=", operand)

    def _compare(self, predicate: str, operand: Any) -> ir.Value:
        """Return a condition of the code; "ordered" means that it is false for NaN."""
        right = self.code.value(operand).register
        return self.code.builder.fcmp_ordered(predicate, self.register, right)

    def _combined(self, operation: str, operand: Any) -> Any:
        """Return the result of an operation, named as LLVM's instruction, on this number and
        another one.
        """
        same = isinstance(operand, Value) and operand.register is self.register
        if same and operation in _WITH_ITSELF:
            return _WITH_ITSELF[operation]
        return self.code.result(operation, self, operand)


class Instructions:
    """Instructions of a function under construction.

    Attributes:
        lanes: Number of lanes of a value; 1 is a plain number.
        scalar: Type of a number in one lane, `DOUBLE` or `SINGLE`.
        stride: Distance in memory between the numbers of one crane [doubles]. It is the number of
            lanes, except for a thread of a GPU: that has one lane, but its numbers stand among
            those of the other threads, see `cranedyn.compiled.threads`.
        type: Type of a value.
        function: The function.
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
        scalar: ir.Type = DOUBLE,
    ) -> None:
        self.lanes = lanes
        self.scalar = scalar
        self.stride = stride or lanes
        self.type = lane_type(lanes, scalar)
        self.function = ir.Function(
            module, ir.FunctionType(ir.VoidType(), [POINTER] * len(arguments)), name
        )
        self._align_stack()
        self.argument = dict(zip(arguments, self.function.args, strict=True))
        self.builder = ir.IRBuilder(self.function.append_basic_block())
        self._clear_caches()

    def _clear_caches(self) -> None:
        """Clear all cached values.

        These are results by what they are computed from; sine and cosine by the register of the
        angle; and for an angle that has been advanced, the angle before and its increment, see
        `Code.advanced`.
        """
        self._results: dict[tuple[Any, ...], Value] = {}
        self._angles: dict[ir.Value, tuple[Value, Value]] = {}
        self._turns: dict[ir.Value, tuple[Value, Value]] = {}

    def _align_stack(self) -> None:
        """Keep vectors that the processor stores on the stack from crossing lines of the cache,
        which takes two accesses instead of one.
        """
        if self.lanes > 1:
            bytes_per_number = 4 if self.scalar is SINGLE else 8
            self.function.attributes.alignstack = min(bytes_per_number * self.lanes, _CACHE_LINE)
            # llvmlite writes alignstack only beside another attribute. This one is harmless.
            self.function.attributes.add("nounwind")

    @contextmanager
    def as_written(self) -> Iterator[None]:
        """Emit sums and products that are rounded one by one, in the order in which they are
        written, as NumPy does.
        """
        self._flags = ()
        try:
            yield
        finally:
            self._flags = _FAST

    @contextmanager
    def in_order(self) -> Iterator[None]:
        """Emit sums that LLVM does not reorder: each adds its two operands as they are."""
        before = self._flags
        self._flags = tuple(flag for flag in before if flag != "reassoc")
        try:
            yield
        finally:
            self._flags = before

    def value(self, number: Any) -> Value:
        """Return a number as a value of the code."""
        if isinstance(number, Value):
            return number
        return Value(self, _constant(self.lanes, self.scalar, float(number).hex()))

    def result(self, operation: str, *operands: Any) -> Value:
        """Return a sum, difference, product, quotient or negative.

        Within a basic block of LLVM it is computed once, however often it is asked for. A result of
        another block may be that of a path that was not taken.

        Args:
            operation: Name of LLVM's instruction, such as "fadd".
            operands: Values and floats.
        """
        terms = (x.register if isinstance(x, Value) else float(x) for x in operands)
        key = self.builder.block, self._flags, operation, *terms
        if key not in self._results:
            registers = (self.value(operand).register for operand in operands)
            result = getattr(self.builder, operation)(*registers, flags=self._flags)
            self._results[key] = Value(self, result)
        return self._results[key]

    def fused(self, a: Value, b: Value, c: Any) -> Value:
        """Return a b + c, rounded once on a processor with an instruction for it, else twice."""
        return self.call("llvm.fmuladd", a, b, c)

    def quotient(self, value: Value, by: Any) -> Value:
        """Return a quotient, rounded once.

        A product with the rounded reciprocal is off by the same share each time. Where the same
        number is divided again and again, such as a rate after every few steps, that adds up.
        """
        if _is_float(by, 1.0):
            return value
        return Value(self, self.builder.fdiv(value.register, self.value(by).register))

    def common_factor(self, numbers: np.ndarray) -> tuple[Any, np.ndarray]:
        """Return a product that all numbers have as a factor, and the numbers without it; 1.0 if
        they have none. Floats among the numbers are zero.

        With numbers f x and f y, the sum (f x) a + (f y) b takes a product less as f (x a + y b).
        """
        values = [number for number in numbers if isinstance(number, Value)]
        common = _factors(values[0].register)[1]
        for value in values[1:]:
            left = Counter(_factors(value.register)[1])
            common = list((Counter(common) & left).elements())
        if not common:
            return 1.0, numbers
        rest = []
        for number in numbers:
            if isinstance(number, Value):
                sign, factors = _factors(number.register)
                left = Counter(factors)
                left.subtract(Counter(common))
                rest.append(self._product(left.elements()) * sign)
            else:
                rest.append(number)
        return self._product(common), array(rest)

    def _product(self, registers: Iterable[ir.Value]) -> Any:
        """Return the product of results; 1.0 of none."""
        product: Any = 1.0
        for register in registers:
            product = Value(self, register) * product
        return product

    def call(self, intrinsic: str, *values: Any) -> Value:
        """Return the result of an intrinsic function of LLVM, such as llvm.maxnum, llvm.sqrt or
        llvm.fabs.
        """
        vector = f"v{self.lanes}" if self.lanes > 1 else ""
        name = f"{intrinsic}.{vector}{'f32' if self.scalar is SINGLE else 'f64'}"
        registers = [self.value(value).register for value in values]
        return Value(self, self._intrinsic(name, self.type, registers))

    def where(self, condition: ir.Value, yes: Any, no: Any) -> Value:
        """Return one value in the lanes where a condition holds, and another in the others."""
        registers = self.value(yes).register, self.value(no).register
        return Value(self, self.builder.select(condition, *registers))

    def sine_and_cosine(self, angle: Value) -> tuple[Value, Value]:
        """Return sine and cosine of an angle [rad]."""
        raise NotImplementedError

    def join_paths(self, a: Value, from_a: ir.Block, b: Value, from_b: ir.Block) -> Value:
        """Return one of two values, that of the path by which this point of the code is reached.

        Args:
            a: Value of one path.
            from_a: Last block of that path.
            b: Value of the other path.
            from_b: Last block of that path.
        """
        phi = self.builder.phi(self.type)
        phi.add_incoming(a.register, from_a)
        phi.add_incoming(b.register, from_b)
        return Value(self, phi)

    def clipped(self, value: Value, low: Any, high: Any) -> Value:
        """Clip a value to the range [low, high]. NaN is returned unchanged."""
        value = self.where(value < low, low, value)
        return self.where(value > high, high, value)

    def both(self, *conditions: Any) -> ir.Value:
        """Return whether all conditions hold; some may be Python bools."""
        return reduce(self.builder.and_, map(self._condition, conditions))

    def _condition(self, condition: Any) -> ir.Value:
        """Return a condition or a Python bool as a condition of the code."""
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
        """Return whether a condition holds in all lanes, as one truth value."""
        return self._over_lanes("and", condition)

    def anywhere(self, condition: ir.Value) -> ir.Value:
        """Return whether a condition holds in at least one lane, as one truth value."""
        return self._over_lanes("or", condition)

    def _over_lanes(self, operation: str, condition: ir.Value) -> ir.Value:
        """Combine a condition over its lanes by "and" or "or"."""
        if self.lanes == 1:
            return condition
        name = f"llvm.vector.reduce.{operation}.v{self.lanes}i1"
        return self._intrinsic(name, ir.IntType(1), [condition])

    def _intrinsic(self, name: str, result: ir.Type, values: Sequence[ir.Value]) -> ir.Value:
        """Call an intrinsic function by its whole name; the module declares it at the first call.

        Args:
            name: The name, with the types of its arguments.
            result: Type of its result.
            values: Its arguments.
        """
        module = self.function.module
        kind = ir.FunctionType(result, [value.type for value in values])
        function = module.globals.get(name) or ir.Function(module, kind, name)
        return self.builder.call(function, values)

    def integer(self, number: int) -> ir.Value:
        """Return a whole number of Python as one of the code."""
        return ir.Constant(INTEGER, number)

    def least(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Return the smaller of two whole numbers of the code."""
        return self.builder.select(self.builder.icmp_signed("<", a, b), a, b)

    def most(self, a: ir.Value, b: ir.Value) -> ir.Value:
        """Return the larger of two whole numbers of the code."""
        return self.builder.select(self.builder.icmp_signed(">", a, b), a, b)

    def product(self, a: ir.Value, number: int) -> ir.Value:
        """Return a whole number of the code times one of Python."""
        return self.builder.mul(a, self.integer(number))

    def plus(self, a: ir.Value, number: int) -> ir.Value:
        """Return a whole number of the code plus one of Python."""
        return self.builder.add(a, self.integer(number))

    def from_integer(self, number: ir.Value) -> Value:
        """Return a whole number of the code as a number in every lane."""
        return self.from_double(self.builder.sitofp(number, DOUBLE))

    def from_double(self, double: ir.Value) -> Value:
        """Return one double in every lane, in the precision of the code."""
        number = double
        if self.scalar is SINGLE:
            number = self.builder.fptrunc(double, SINGLE)
        if self.lanes == 1:
            return Value(self, number)
        undefined, first_lane, first_for_all = _spreading_constants(self.lanes, self.scalar)
        register = self.builder.insert_element(undefined, number, first_lane)
        return Value(self, self.builder.shuffle_vector(register, undefined, first_for_all))

    def load(self, pointer: ir.Value, first: Any = 0) -> Value:
        """Load the lanes from consecutive doubles of memory, beginning at an index."""
        doubles = lane_type(self.lanes, DOUBLE)
        register = self.builder.load(self.address(pointer, first), align=8, typ=doubles)
        if self.scalar is SINGLE:
            register = self.builder.fptrunc(register, self.type)
        return Value(self, register)

    def store(self, value: Any, pointer: ir.Value, first: Any = 0) -> None:
        """Store the lanes in consecutive doubles of memory."""
        register = self.value(value).register
        if self.scalar is SINGLE:
            register = self.builder.fpext(register, lane_type(self.lanes, DOUBLE))
        self.builder.store(register, self.address(pointer, first), align=8)

    def spread(self, pointer: ir.Value, index: Any) -> Value:
        """Load one double of memory into every lane."""
        return self.from_double(self.load_one(pointer, index, DOUBLE))

    def gather(self, addresses: Sequence[ir.Value], index: int = 0) -> Value:
        """Load a double into each lane, from an address of its own or from one for all lanes.

        Args:
            addresses: The address of each lane, or a single one.
            index: Which double behind the address.
        """
        if len(addresses) == 1:
            return self.spread(addresses[0], index)
        register = ir.Constant(lane_type(self.lanes, DOUBLE), ir.Undefined)
        for lane, address in enumerate(addresses):
            double = self.load_one(address, index, DOUBLE)
            place = ir.Constant(ir.IntType(32), lane)
            register = self.builder.insert_element(register, double, place)
        if self.scalar is SINGLE:
            register = self.builder.fptrunc(register, self.type)
        return Value(self, register)

    def load_one(self, pointer: ir.Value, index: Any, kind: ir.Type) -> ir.Value:
        """Load one whole number, double or address, eight bytes each."""
        return self.builder.load(self.address(pointer, index), align=8, typ=kind)

    def address(self, pointer: ir.Value, index: Any) -> ir.Value:
        """Return the address of a double at an index, a whole number of the code or of Python."""
        offset = index if isinstance(index, ir.Value) else self.integer(index)
        return self.builder.gep(pointer, [offset], source_etype=DOUBLE)


def _factors(register: ir.Value) -> tuple[float, list[ir.Value]]:
    """Return the sign of a result, and the results whose product it is, which are no products."""
    operation = getattr(register, "opname", "")
    if operation == "fneg":
        sign, factors = _factors(register.operands[0])
        return -sign, factors
    if operation != "fmul":
        return 1.0, [register]
    left_sign, left = _factors(register.operands[0])
    right_sign, right = _factors(register.operands[1])
    return left_sign * right_sign, left + right


@cache
def lane_type(lanes: int, scalar: ir.Type = DOUBLE) -> ir.Type:
    """Return the type of a number for each lane."""
    return ir.VectorType(scalar, lanes) if lanes > 1 else scalar


@lru_cache(maxsize=4096)
def _constant(lanes: int, scalar: ir.Type, text: str) -> ir.Constant:
    """Return a number in every lane.

    llvmlite takes long to make the text of a constant, and keeps it with the constant: so equal
    constants are made once.

    Args:
        lanes: Number of lanes.
        scalar: Type of the number in one lane, to which it is rounded.
        text: The number in the format of `float.hex`. It is the key of the cache: by their values,
            0.0 and -0.0 would be the same.
    """
    number = float.fromhex(text)
    kind = lane_type(lanes, scalar)
    return ir.Constant(kind, [number] * lanes if lanes > 1 else number)


@cache
def _spreading_constants(
    lanes: int, scalar: ir.Type
) -> tuple[ir.Constant, ir.Constant, ir.Constant]:
    """Return what `from_double` needs: an undefined vector, the index of its first lane, and that
    index for every lane.
    """
    index = ir.IntType(32)
    zeros = ir.Constant(ir.VectorType(index, lanes), [0] * lanes)
    return ir.Constant(lane_type(lanes, scalar), ir.Undefined), ir.Constant(index, 0), zeros


def _is_float(operand: Any, number: float) -> bool:
    """Return whether an operand is known to be this number while the code is made."""
    return isinstance(operand, float) and operand == number
