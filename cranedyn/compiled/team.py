"""Teams: groups of lanes whose steps take turns in one call of the loop.

The results of a step wait for each other: an angle for its rate, the rate for forces, these for a
mass matrix. A processor that is given one group computes while it waits, but not enough: it could
start twice as many sums and products. Given the step of another group in between, it begins that
one before the first has ended. So the loop takes the groups of a team in turn after each step,

    for each control instant:
        for each group: the control
        for each step: for each group: the step

Each group runs the very same instructions, alone or in a team of any size, so that its results are
the same to the bit. Between two of its steps the numbers of a group stand in memory, and not in
registers, of which there are not enough for one group.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from llvmlite import ir

from cranedyn.compiled.code import INTEGER, POINTER, Code, StackVariable
from cranedyn.compiled.memory_layout import GROUP_POINTERS, SLOTS

TEAM = 2
"""Largest number of groups in a team; a power of two."""


class Team:
    """Groups of one call under construction.

    The calls of the groups stand one after another in memory. The slot "team" of the first says how
    many there are: a power of two, `TEAM` at most.

    Attributes:
        count: Number of groups, a whole number of the code.
        index: The group whose turn it is, likewise.
    """

    def __init__(self, code: Code, calls: ir.Value) -> None:
        self._code = code
        self._calls = calls
        self.count: ir.Value = code.load_one(calls, SLOTS["team"], INTEGER)
        self.index: ir.Value = code.integer(0)

    @contextmanager
    def each_group(self) -> Iterator[None]:
        """Emit statements for each group."""
        with self._code.loop(0, self.count) as index:
            self.index = index
            yield

    def take_turns(self, turn: ir.Value) -> ir.Value:
        """Let it be the turn of the group that the number of a turn leads to, and return how often
        it had been its turn before.
        """
        build = self._code.builder
        # The count is a power of two.
        self.index = build.and_(turn, self._code.plus(self.count, -1))
        return build.sdiv(turn, self.count)

    def pointers(self) -> dict[str, ir.Value]:
        """Return the addresses of the memory of the group whose turn it is, by the name of their
        slots.
        """
        first_slot = self._code.product(self.index, len(SLOTS))
        call = self._code.address(self._calls, first_slot)
        return {name: self._code.load_one(call, SLOTS[name], POINTER) for name in GROUP_POINTERS}


class TeamVariable(StackVariable):
    """A variable that each group of a team has for itself."""

    def __init__(self, code: Code, team: Team) -> None:
        self._code = code
        self._team = team
        with code.builder.goto_entry_block():
            self._first_place = code.builder.alloca(code.type, TEAM)

    def _place_now(self) -> ir.Value:
        build = self._code.builder
        return build.gep(self._first_place, [self._team.index], source_etype=self._code.type)


def teams_of(groups: Iterable[int], largest: int) -> Iterator[list[int]]:
    """Yield groups in teams, whose sizes are powers of two.

    Args:
        groups: Indices of the groups.
        largest: Largest size, a power of two.
    """
    waiting = list(groups)
    first = 0
    size = largest
    while first < len(waiting):
        while size > len(waiting) - first:
            size //= 2
        yield waiting[first : first + size]
        first += size
