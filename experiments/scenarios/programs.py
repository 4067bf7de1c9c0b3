"""Runs by name, not made but handed on: to engines that are not ours."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NoReturn

from cranedyn.bridges.programs import Program
from cranedyn.errors import DataError, UnknownName
from experiments import a1, a2, a3, energy
from experiments.harness import Setup
from experiments.scenarios.moves import MOVES
from experiments.scenarios.perturbations import make
from experiments.scenarios.strategies import FLAT, STRATEGIES

RUNS = ("a1", "a2", "a3", "swing", "move")
"""Free swing, hoisting, slewing, the swing of the energy ledger, and the combined move of the
control experiments."""

_LENGTH = 15.0


class _Asked(Exception):
    """What an experiment wanted to run."""

    def __init__(self, program: Program) -> None:
        super().__init__()
        self.program = program


@dataclass(frozen=True)
class _Asking(Setup):
    """A setup in which an experiment gets no further than to say what it wants to run."""

    def simulate(
        self,
        crane: Any,
        controller: Any,
        reference: Any,
        *,
        start: Any,
        duration: float,
        label: str,
        **options: Any,
    ) -> NoReturn:
        clocks, drive = (self.dt, self.control_period), options.get("drive", "effort")
        raise _Asked(Program(crane, controller, reference, start, duration, *clocks, drive))


def program(
    name: str, setup: Setup, *, length: float | None = None, strategy: str | None = None
) -> Program:
    """Return a run of the experiments by its name.

    Args:
        name: One of `RUNS`.
        setup: Its gravity, crane and clocks.
        length: Cable length of a1 and swing [m], 15 by default.
        strategy: Of a move, one of `STRATEGIES`, flat + LQR by default.

    Raises:
        UnknownName: If there is no such run or strategy.
        DataError: If an argument has no effect on this run.
    """
    if name not in RUNS:
        raise UnknownName("run", name, RUNS)
    for flag, value, users in (
        ("--length", length, ("a1", "swing")),
        ("--strategy", strategy, ("move",)),
    ):
        if value is not None and name not in users:
            raise DataError(f"{flag} has no effect on the run {name}; leave it out.")
    asking = _Asking(**{field.name: getattr(setup, field.name) for field in fields(setup)})
    along = _LENGTH if length is None else length
    try:
        if name == "a1":
            a1.run(asking, along)
        elif name == "a2":
            a2.run(asking)
        elif name == "a3":
            a3.run(asking)
        elif name == "swing":
            energy.run(asking, asking.crane, energy.SWING, along, energy.AUDIT)
        elif (strategy := strategy or FLAT) in STRATEGIES:
            make(asking, MOVES[-1], STRATEGIES[strategy](asking, MOVES[-1]))
        else:
            raise UnknownName("strategy", strategy, STRATEGIES)
    except _Asked as asked:
        return asked.program
    raise AssertionError(name)  # every experiment runs something
