"""The list of lifts of a shift: which loads the cranes of a site bring from where to where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np

from cranedyn.checks import finite, number
from cranedyn.errors import DataError, UnknownName, quoted

HOOKING_TIME = 20.0
"""Time to hook a load on, or to unhook it, of a site that does not enter it [s]."""

ANY_CRANE = "any"
"""Name of the crane of a lift for which the planner chooses one."""


@dataclass(frozen=True, eq=False)
class ListedLift:
    """A load that a crane brings from one place to another.

    The crane goes to `start` with an empty hook, stands there while the load is hooked on, carries
    it to `goal`, and stands there while it is unhooked.

    Attributes:
        name: Its name, by which `after` of another lift refers to it.
        crane: Name of the crane; `ANY_CRANE` leaves the choice to the planner.
        start: Centre of the load where it is hooked on, in the frame of the site [m], shape (3,).
        goal: Centre of the load where it is unhooked [m], shape (3,).
        load: Mass of the load with its slings [kg]; None for the load of the crane.
        earliest: Time before which no load is hooked on [s].
        after: Names of the lifts whose loads must be unhooked before this one is hooked on.
    """

    name: str
    crane: str
    start: np.ndarray
    goal: np.ndarray
    load: float | None = None
    earliest: float = 0.0
    after: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            OutOfRange: If a point is not three finite numbers, the load is not positive, or the
                earliest time is negative.
        """
        finite(f"start of the lift {quoted(self.name)}", self.start, (3,))
        finite(f"goal of the lift {quoted(self.name)}", self.goal, (3,))
        if self.load is not None:
            number(f"load of the lift {quoted(self.name)}", self.load, "kg", "> 0")
        number(f"earliest time of the lift {quoted(self.name)}", self.earliest, "s", ">= 0")


def check_lift(lift: ListedLift, cranes: Sequence[str], earlier: Mapping[str, ListedLift]) -> None:
    """Check that a lift has a name of its own, and that its crane is one of the site.

    Args:
        lift: The lift.
        cranes: Names of the cranes of the site.
        earlier: The lifts before it in the list, by name.

    Raises:
        DataError: If a lift before it has its name, or a crane has the name `ANY_CRANE`.
        UnknownName: If there is no crane of that name.
    """
    if ANY_CRANE in cranes:
        raise DataError(
            f"A crane is called {quoted(ANY_CRANE)}, which stands for every crane in a list of "
            "lifts; give it another name."
        )
    if lift.name in earlier:
        raise DataError(f"Two lifts are called {quoted(lift.name)}; give each its own name.")
    if lift.crane not in (*cranes, ANY_CRANE):
        raise UnknownName("crane", lift.crane, [*cranes, ANY_CRANE])


def check_order(lifts: Sequence[ListedLift]) -> None:
    """Check that all lifts can be carried out in an order in which each is after those it waits
    for.

    Raises:
        UnknownName: If a lift waits for one that is not in the list.
        DataError: If lifts wait for each other in a circle.
    """
    waits_for = {lift.name: set(lift.after) for lift in lifts}
    for lift in lifts:
        for name in lift.after:
            if name not in waits_for:
                raise UnknownName("lift", name, list(waits_for))
    try:
        TopologicalSorter(waits_for).prepare()
    except CycleError as error:
        # The second argument is the circle, from each lift to the one that waits for it.
        chain = " before ".join(quoted(name) for name in error.args[1])
        raise DataError(f"Lifts wait for each other in a circle: {chain}.") from None
