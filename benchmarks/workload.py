"""The workload that every contestant runs: free swing of the project's crane while hold control
brakes its drives, all of it logged.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.controllers.hold import Hold
from cranedyn.interfaces import Controller, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate

DURATION = 70.0
"""Simulated time of a whole run [s]."""


@dataclass(frozen=True)
class Case:
    """A crane, its controller and the clocks.

    Attributes:
        crane: The crane.
        controller: Holds the drives where they start, at every control instant until the next.
        dt: Physics step [s].
        period: Control period [s].
    """

    crane: Crane = field(default_factory=load_crane)
    dt: float = 5e-4
    period: float = 5e-3

    @cached_property
    def controller(self) -> Hold:
        """Of all drives, made once, as the gains of every contestant."""
        return hold_controller(self.crane)

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return self.crane.layout.n

    @property
    def steps(self) -> int:
        """Physics steps in a control period."""
        return round(self.period / self.dt)

    def periods(self, duration: float) -> int:
        """Return the number of control periods in a run of a duration [s]."""
        return round(duration / self.period)

    def starts(self, cranes: int) -> np.ndarray:
        """Return coordinates and rates of cranes at rest that differ in swing, shape (cranes, 2 n).

        The first swings by 0.1 rad radially, the last by 0.2 rad radially and 0.1 rad tangentially.
        """
        share = np.linspace(0.0, 0.1, cranes)
        rows = np.tile(np.concatenate(self.crane.state(l=15.0)), (cranes, 1))
        radial = self.crane.swings[0::2]
        tangential = self.crane.swings[1::2]
        rows[:, radial] = 0.1 + share[:, None]
        rows[:, tangential] = share[:, None]
        return rows

    def swing(self, rows: np.ndarray) -> np.ndarray:
        """Return √(φ² + θ²) of rows that begin with coordinates [rad]."""
        return np.sqrt(sum(rows[..., i] ** 2 for i in self.crane.swings))

    def logged(self, log: np.ndarray) -> Result:
        """Return the result of a single crane from its log, shape (rows, 2 n + 3)."""
        ends = log[-1:, : 2 * self.n].copy()
        peak = self.swing(log).max(keepdims=True)
        return Result(ends, peak, lambda: log)


@dataclass(frozen=True)
class Result:
    """What a run leaves.

    Attributes:
        ends: Coordinates and rates of each crane at the end, shape (cranes, 2 n).
        peaks: The largest swing of each at a control instant, √(φ² + θ²) [rad], shape (cranes,).
        log: Returns of a single crane coordinates, rates and efforts at each control instant, shape
            (periods + 1, 2 n + 3); None for many.
    """

    ends: np.ndarray
    peaks: np.ndarray
    log: Callable[[], np.ndarray] | None = None


Run = Callable[[np.ndarray, float], Result]
"""Runs cranes from their starts, shape (cranes, 2 n), for a time [s]."""


@dataclass(frozen=True)
class Contestant:
    """A way to run the workload.

    Attributes:
        name: What it is called.
        missing: Why it cannot run here, None if it can.
        prepare: From a case to what runs it: all that is done once, such as loading a model or
            compiling.
        many: Whether it runs many cranes at once and leaves no log; the others run one and leave
            one.
        any_crane: Whether it runs other cranes than that of five joints, too.
    """

    name: str
    missing: Callable[[], str | None]
    prepare: Callable[[Case], Run]
    many: bool = False
    any_crane: bool = False


def plain(
    case: Case,
    start: np.ndarray,
    duration: float,
    *,
    controller: Controller | None = None,
    engine: EngineName = "pinocchio",
) -> Result:
    """Simulate a start, shape (2 n,), by default with the case's controller."""
    run = simulate(
        case.crane,
        case.controller if controller is None else controller,
        start=State(start[: case.n], start[case.n :]),
        duration=duration,
        dt=case.dt,
        control_period=case.period,
        engine=engine,
    )
    ends = np.hstack([run.q[-1:], run.v[-1:]])
    peak = case.swing(run.q).max(keepdims=True)
    return Result(ends, peak, lambda: np.hstack([run.q, run.v, run.effort]))


def brake(
    case: Case, start: np.ndarray
) -> Callable[[Sequence[float], Sequence[float]], tuple[float, float, float]]:
    """Return the hold controller within the limits of the drives, on plain Python floats.

    Plain floats are quicker than NumPy's for three drives. All drives are written out, since a loop
    over them would take longer than the arithmetic.

    Args:
        case: What is run.
        start: Coordinates and rates at the start, where the drives are held; shape (2 n,).
    """
    hold = case.controller
    drives = case.crane.layout.drives
    slew, trolley, hoist = drives.tolist()
    slew_k_p, trolley_k_p, hoist_k_p = hold.stiffness.tolist()
    slew_k_d, trolley_k_d, hoist_k_d = hold.damping.tolist()
    slew_feed, trolley_feed, hoist_feed = hold.feed_forward.tolist()
    slew_limit, trolley_limit, hoist_limit = case.crane.effort_limit.tolist()
    gamma, radius, length = start[drives].tolist()

    def effort(q: Sequence[float], v: Sequence[float]) -> tuple[float, float, float]:
        slew_effort = slew_feed + slew_k_p * (gamma - q[slew]) - slew_k_d * v[slew]
        trolley_effort = (
            trolley_feed + trolley_k_p * (radius - q[trolley]) - trolley_k_d * v[trolley]
        )
        hoist_effort = hoist_feed + hoist_k_p * (length - q[hoist]) - hoist_k_d * v[hoist]
        return (
            max(-slew_limit, min(slew_limit, slew_effort)),
            max(-trolley_limit, min(trolley_limit, trolley_effort)),
            max(-hoist_limit, min(hoist_limit, hoist_effort)),
        )

    return effort
