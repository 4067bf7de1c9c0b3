"""Code under construction with loops, conditions, and cached sines and cosines.

Sines and cosines take the longest of all that a crane's code computes. They are saved like this:

* `Code.sine_and_cosine` computes them once for an angle in a stretch of code without branches.
* `Code.cache_angle` says what they are, where a variable has kept them since the last step.
* `Code.advanced` adds an increment to an angle and records that. Where sine and cosine of the angle
  before are known, those of the sum are rotated by the increment, see `cranedyn.compiled.angles`.

What is known of angles holds on the path of the code on which it was computed: it is forgotten
where a loop begins or ends, and after a condition what was known before it is known again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

from cranedyn.compiled.angles import Turn, rotate_or_evaluate, sine_and_cosine
from cranedyn.compiled.instructions import DOUBLE, INTEGER, POINTER, Instructions, Value, lane_type

__all__ = ["DOUBLE", "INTEGER", "POINTER", "Code", "StackVariable", "Value", "lane_type", "uses"]


class Code(Instructions):
    """A function under construction, see `Instructions`."""

    def sine_and_cosine(self, angle: Value) -> tuple[Value, Value]:
        """Return sine and cosine of an angle [rad], see the module."""
        if angle.register not in self._angles:
            turn = self.turn(angle)
            pair = sine_and_cosine(self, angle) if turn is None else rotate_or_evaluate(turn)
            self._angles[angle.register] = pair
        return self._angles[angle.register]

    def turn(self, angle: Value) -> Turn | None:
        """Return the rotation by which an angle that `advanced` returned follows from the angle
        before; None for another angle, or if sine and cosine of the angle before are not known.
        """
        if angle.register not in self._turns:
            return None
        before, increment = self._turns[angle.register]
        if before.register not in self._angles:
            return None
        return Turn(self._angles[before.register], increment, angle)

    def cache_angle(self, angle: Value, sine: Value, cosine: Value) -> None:
        """Use sine and cosine of an angle as known until this loop or condition ends."""
        self._angles[angle.register] = sine, cosine

    def advanced(self, before: Value, by: Any) -> Value:
        """Return an angle plus an increment, and record both, see the module."""
        after = before + by
        if isinstance(by, Value) and after is not before:
            self._turns[after.register] = before, by
        return after

    def increment(self, after: Any, before: Value) -> Any:
        """Return after - before. Where `advanced` made the one of the other, that is the very
        increment, without the rounding error of the difference.

        Args:
            after: A value or a float.
            before: The value before.
        """
        if isinstance(after, Value) and after.register in self._turns:
            start, by = self._turns[after.register]
            if start is before:
                return by
        return after - before

    def variables(self, values: Sequence[Any]) -> list[StackVariable]:
        """Return variables for values that change from one pass of a loop to the next."""
        return [StackVariable(self, value) for value in values]

    @contextmanager
    def loop(self, first: Any, last: Any) -> Iterator[ir.Value]:
        """Emit statements for each whole number from the first to the one before the last.

        Args:
            first: First number, of Python or of the code.
            last: Number after the last one, of Python or of the code. Where the statements change
                it, a function that emits it: it is asked anew before each number.

        Yields:
            The number for which the statements run.
        """
        begin = self.integer(first) if isinstance(first, int) else first
        end = self.integer(last) if isinstance(last, int) else last
        before = self.builder.block
        head = self.function.append_basic_block("head")
        body = self.function.append_basic_block("body")
        after = self.function.append_basic_block("after")
        self.builder.branch(head)
        self.builder.position_at_end(head)
        counter = self.builder.phi(INTEGER)
        counter.add_incoming(begin, before)
        if callable(end):
            end = end()
        self.builder.cbranch(self.builder.icmp_signed("<", counter, end), body, after)
        self.builder.position_at_end(body)
        self._forget_angles()
        yield counter
        counter.add_incoming(self.plus(counter, 1), self.builder.block)
        self.builder.branch(head)
        self.builder.position_at_end(after)
        self._forget_angles()

    @contextmanager
    def fast_loop(
        self, first: ir.Value, last: ir.Value
    ) -> Iterator[tuple[ir.Value, Callable[[ir.Value], None]]]:
        """Emit statements for each whole number from the first to the one before the last, where
        some of them are needed in rare cases only.

        The usual statements are one basic block that branches to itself, within which LLVM can
        order instructions freely. In a rare case that inner loop is left, the rare statements run,
        and an outer loop enters it again with the next number:

            number = first
            while number < last:
                do:
                    usual statements
                    number = number + 1
                while is_usual and number < last
                rare statements

        The rare statements run after the last number as well, so they must do no harm there.

        Yields:
            The number, and a function that ends the usual statements. Its argument is whether the
            case is usual, one truth value for all lanes. What is emitted after it are the rare
            statements.
        """
        build = self.builder
        head = self.function.append_basic_block("head")
        body = self.function.append_basic_block("body")
        rare = self.function.append_basic_block("rest")
        after = self.function.append_basic_block("after")
        before = build.block
        build.branch(head)
        build.position_at_end(head)
        entered_at = build.phi(INTEGER)
        build.cbranch(build.icmp_signed("<", entered_at, last), body, after)
        build.position_at_end(body)
        number = build.phi(INTEGER)
        next_number = self.plus(number, 1)
        self._forget_angles()

        def end(is_usual: ir.Value) -> None:
            goes_on = build.and_(is_usual, build.icmp_signed("<", next_number, last))
            number.add_incoming(next_number, build.block)
            build.cbranch(goes_on, body, rare)
            build.position_at_end(rare)

        yield number, end
        entered_at.add_incoming(first, before)
        entered_at.add_incoming(next_number, build.block)
        number.add_incoming(entered_at, head)
        build.branch(head)
        build.position_at_end(after)
        self._forget_angles()

    @contextmanager
    def when(self, condition: ir.Value) -> Iterator[None]:
        """Emit statements that run if a condition holds, one truth value for all lanes, see
        `everywhere` and `anywhere`.
        """
        known = dict(self._angles)
        with self.builder.if_then(condition):
            yield
        self._angles = known

    def _forget_angles(self) -> None:
        """Forget sines and cosines: they may not have been computed on the path that leads here."""
        self._angles = {}

    def end(self) -> None:
        """End the function, which returns nothing."""
        self.builder.ret_void()


class StackVariable:
    """A variable on the stack, for a value that changes from one pass of a loop to the next.

    LLVM keeps it in a register where it can.
    """

    def __init__(self, code: Code, value: Any) -> None:
        self._code = code
        with code.builder.goto_entry_block():
            self._place = code.builder.alloca(code.type)
        self.set(value)

    def get(self) -> Value:
        """Return its value at this point of the code."""
        return Value(self._code, self._code.builder.load(self._place_now(), typ=self._code.type))

    def set(self, value: Any) -> None:
        """Assign a value."""
        self._code.builder.store(self._code.value(value).register, self._place_now())

    def _place_now(self) -> ir.Value:
        """Return the address of the variable at this point of the code."""
        return self._place


def uses(function: ir.Function) -> Counter[Any]:
    """Return how often each instruction is needed for what a function stores, calls and decides.

    Functions of Python emit more than is needed in the end, such as sines of angles that cancel.
    LLVM removes the rest. Here it is left out before, so that it is not even updated or printed.
    """
    needed: Counter[Any] = Counter()
    # Instructions without a result are there for their effect: stores, branches, calls.
    waiting: list[Any] = []
    for block in function.blocks:
        for instruction in block.instructions:
            if isinstance(instruction.type, ir.VoidType):
                waiting.extend(instruction.operands)
    while waiting:
        value = waiting.pop()
        if isinstance(value, ir.Instruction):
            needed[value] += 1
            if needed[value] == 1:
                waiting.extend(value.operands)
                waiting.extend(_joined_values(value))
    return needed


def _joined_values(instruction: ir.Instruction) -> list[Any]:
    """Return the values among which an instruction chooses by the path that led to it; none for
    any instruction but a phi.

    Of a counter of a loop it is the first number alone: the other value is the counter plus one,
    which the loop itself computes and which would count as a use.
    """
    values = [value for value, _ in getattr(instruction, "incomings", ())]
    return values[:1] if instruction.type is INTEGER else values
