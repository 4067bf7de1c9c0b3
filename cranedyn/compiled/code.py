"""Code under construction with loops, conditions, and cached sines and cosines."""

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
        """Return sine and cosine of an angle [rad], see `cranedyn.compiled.angles`, computed once.

        Sine and cosine of a sum that `advanced` returned are updated from those of its first term.
        """
        if angle.register not in self._angles:
            turn = self.turn(angle)
            pair = sine_and_cosine(self, angle) if turn is None else rotate_or_evaluate(turn)
            self._angles[angle.register] = pair
        return self._angles[angle.register]

    def turn(self, angle: Value) -> Turn | None:
        """Return the turn to an angle from one of known sine and cosine; None if there is none."""
        before, by = self._turns.get(angle.register, (angle, angle))
        sine_cosine = self._angles.get(before.register)
        return None if sine_cosine is None else Turn(sine_cosine, by, angle)

    def cache_angle(self, angle: Value, sine: Value, cosine: Value) -> None:
        """Use sine and cosine of an angle as known until this loop or condition ends."""
        self._angles[angle.register] = sine, cosine

    def advanced(self, before: Value, by: Any) -> Value:
        """Return the sum and record its terms, from which its sine and cosine are updated."""
        after = before + by
        if isinstance(by, Value) and after is not before:
            self._turns[after.register] = before, by
        return after

    def increment(self, after: Any, before: Value) -> Any:
        """Return after - before, exactly what was added where `advanced` returned after."""
        start, by = self._turns.get(getattr(after, "register", None), (None, None))
        return by if start is before else after - before

    def variables(self, values: Sequence[Any]) -> list[StackVariable]:
        """Return variables for values that change from one pass of a loop to the next."""
        return [StackVariable(self, value) for value in values]

    @contextmanager
    def loop(self, first: Any, last: Any) -> Iterator[ir.Value]:
        """Emit statements for each whole number from the first to the one before the last; a
        function gives a last that the statements change.
        """
        begin, end = (self.integer(x) if isinstance(x, int) else x for x in (first, last))
        before = self.builder.block
        head, body, after = map(self.function.append_basic_block, ("head", "body", "after"))
        self.builder.branch(head)
        self.builder.position_at_end(head)
        counter = self.builder.phi(INTEGER)
        counter.add_incoming(begin, before)
        end = end() if callable(end) else end
        self.builder.cbranch(self.builder.icmp_signed("<", counter, end), body, after)
        self.builder.position_at_end(body)
        self._forget_angles()
        yield counter
        counter.add_incoming(self.plus(counter, 1), self.builder.block)
        self.builder.branch(head)
        self.builder.position_at_end(after)
        self._forget_angles()

    @contextmanager
    def fast_loop(self, first: ir.Value, last: ir.Value) -> Iterator[Callable[[ir.Value], None]]:
        """Emit statements for each whole number from the first to the one before the last, as a
        loop without branches that is left for rare cases.

        Yields:
            What to call at the end of the statements with whether nothing is. Statements after that
            call run where something is, and after the last number.
        """
        build = self.builder
        names = ("head", "body", "rest", "after")
        head, body, rare, after = map(self.function.append_basic_block, names)
        before = build.block
        build.branch(head)
        build.position_at_end(head)
        begin = build.phi(INTEGER)
        build.cbranch(build.icmp_signed("<", begin, last), body, after)
        build.position_at_end(body)
        number = build.phi(INTEGER)
        next_one = self.plus(number, 1)
        self._forget_angles()

        def end(nothing: ir.Value) -> None:
            again = build.and_(nothing, build.icmp_signed("<", next_one, last))
            number.add_incoming(next_one, build.block)
            build.cbranch(again, body, rare)
            build.position_at_end(rare)

        yield end
        begin.add_incoming(first, before)
        begin.add_incoming(next_one, build.block)
        number.add_incoming(begin, head)
        build.branch(head)
        build.position_at_end(after)
        self._forget_angles()

    @contextmanager
    def when(self, condition: ir.Value) -> Iterator[None]:
        """Emit statements that run where a condition, common to all lanes, holds."""
        known = dict(self._angles)
        with self.builder.if_then(condition):
            yield
        self._angles = known

    def _forget_angles(self) -> None:
        """Forget sines and cosines that were computed on another path of the code."""
        self._angles = {}

    def end(self) -> None:
        """End the function."""
        self.builder.ret_void()


class StackVariable:
    """A variable on the stack."""

    def __init__(self, code: Code, value: Any) -> None:
        self._code = code
        with code.builder.goto_entry_block():
            self._place = code.builder.alloca(code.type)
        self.set(value)

    def get(self) -> Value:
        """Return its value at this point of the code."""
        return Value(self._code, self._code.builder.load(self._place, typ=self._code.type))

    def set(self, value: Any) -> None:
        """Assign a value."""
        self._code.builder.store(self._code.value(value).register, self._place)


def uses(function: ir.Function) -> Counter[Any]:
    """Return how often each instruction is needed for what a function stores and calls."""
    needed: Counter[Any] = Counter()
    waiting = [
        operand
        for block in function.blocks
        for instruction in block.instructions
        if isinstance(instruction.type, ir.VoidType)
        for operand in instruction.operands
    ]
    while waiting:
        value = waiting.pop()
        if isinstance(value, ir.Instruction):
            needed[value] += 1
            if needed[value] == 1:
                first = 1 if value.type is INTEGER else None  # of a count, where it begins
                incoming = getattr(value, "incomings", ())[:first]
                waiting.extend([*value.operands, *(number for number, _ in incoming)])
    return needed
