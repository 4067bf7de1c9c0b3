"""Margins: how far each strategy is from its end over trolley radius and cable length, and whether
simulation goes unstable where the map says so.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import scipy

from cranedyn.checks import whole, within
from cranedyn.command import interrupted
from cranedyn.controllers import hold_controller, lqr, paper_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.dynamics.linearisation import Sampled, sampled
from cranedyn.dynamics.pinocchio import holding_effort
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.estimation import with_observer
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.references.motion import Motion
from experiments import harness
from experiments.harness import Claim, Column, Outcome, ResultTable, Setup, finite_or_none, tabulate
from experiments.margins.figures import margin_values, margins_figure
from experiments.scenarios.strategies import LQR, PAPER, PD, with_integral

if TYPE_CHECKING:
    from cranedyn.bridges.margins import Margins, Regulator

RADII, CABLES = (4.0, 20.0), (5.0, 25.0)
"""Ends of the map: trolley radius and cable length [m]."""

MIDDLE = (12.0, 15.0)
"""Where the LQR that is not scheduled is designed [m]."""

KEPT, BLIND = "LQR made for the middle", "LQR, no swing sensor"

AFFECTED = 1e-3
"""By how much the load swings at the start of a simulated check [rad], so that it stays linear."""

WATCHED = 40.0
"""How long a simulated check lasts [s]."""

MOST = 500
"""Radii, and cable lengths, of the largest map."""

Mapped = list[list["Margins"]]
"""Margins by cable length, then by radius."""


def standstill(setup: Setup, equilibrium: State) -> Motion:
    """Return a motion that stands still."""
    still = np.zeros((1, setup.crane.layout.n))
    return Motion(
        setup.control_period, equilibrium.q[None], still, still, setup.crane.layout.drives
    )


def integrating(setup: Setup, equilibrium: State) -> HoistIntegral:
    """Return the full-model LQR with an integrator on the hoist, made for a rest."""
    return with_integral(setup, standstill(setup, equilibrium))


def _linear(setup: Setup, controller: Controller, equilibrium: State) -> Regulator:
    from cranedyn.bridges.margins import regulator

    return regulator(setup.crane, controller, equilibrium, t=0.0, period=setup.control_period)


def _held(setup: Setup, equilibrium: State) -> Regulator:
    return _linear(setup, hold_controller(setup.crane), equilibrium)


def _paper(setup: Setup, equilibrium: State) -> Regulator:
    return _linear(
        setup, paper_controller(setup.crane, standstill(setup, equilibrium)), equilibrium
    )


def _scheduled(setup: Setup, equilibrium: State) -> Regulator:
    return _linear(setup, integrating(setup, equilibrium), equilibrium)


def _kept(setup: Setup, equilibrium: State) -> Regulator:
    return _scheduled(setup, setup.crane.state(x=MIDDLE[0], l=MIDDLE[1]))


def _blind(setup: Setup, equilibrium: State) -> Regulator:
    """Return the same behind the filter that sees the drives alone, when its gain has settled."""
    from cranedyn.bridges.margins import behind_observer

    crane = setup.crane
    plant = _plant(setup, equilibrium)
    observer = with_observer(
        lqr(crane, standstill(setup, equilibrium), dt=setup.dt),
        crane,
        standstill(setup, equilibrium),
        dt=setup.dt,
    )
    output = np.eye(len(plant.a))[observer.measured]
    p = scipy.linalg.solve_discrete_are(plant.a.T, output.T, observer.disturbance, observer.noise)
    gain = np.linalg.solve(output @ p @ output.T + observer.noise, output @ p).T
    return behind_observer(_scheduled(setup, equilibrium), plant, gain, observer.measured)


STRATEGIES: dict[str, Callable[[Setup, State], Regulator]] = {
    PD: _held,
    PAPER: _paper,
    LQR: _scheduled,
    KEPT: _kept,
    BLIND: _blind,
}
"""How the drives are closed at a rest, by name. Plans that differ in what they feed forward only,
such as flat paths, the shortest time and the MPC within its limits, end in the full-model LQR."""


def mapped(setup: Setup, points: int) -> dict[str, Mapped]:
    """Return the margins of each strategy over the map."""
    from cranedyn.bridges.margins import margins

    radii, cables = axes(points)
    update = setup.reporter.count("margins", len(STRATEGIES) * points)
    maps: dict[str, Mapped] = {strategy: [] for strategy in STRATEGIES}
    for strategy, law in STRATEGIES.items():
        for length in cables.tolist():
            rests = [setup.crane.state(x=radius, l=length) for radius in radii.tolist()]
            maps[strategy].append([margins(_plant(setup, r), law(setup, r)) for r in rests])
            update(sum(map(len, maps.values())))
    return maps


def _plant(setup: Setup, equilibrium: State) -> Sampled:
    return sampled(setup.crane, equilibrium, dt=setup.dt, control_period=setup.control_period)


def axes(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the radii and cable lengths of the map [m]."""
    return np.linspace(*RADII, points), np.linspace(*CABLES, points)


class Disturbed:
    """A controller about a rest of whose drives one is late, or stronger than it is told.

    Attributes:
        controller: The controller.
        drive: Which one.
        factor: What its effort beyond holding the load is multiplied by.
        periods: By how many control periods it is late.
    """

    def __init__(
        self, controller: Controller, holding: np.ndarray, drive: int, factor: float, periods: int
    ) -> None:
        self.controller, self.holding = controller, holding
        self.drive, self.factor = drive, factor
        self._waiting = deque([0.0] * periods)

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the efforts, shape (m,)."""
        command = np.array(self.controller(t, state, setpoint))
        self._waiting.append(self.factor * (command[self.drive] - self.holding[self.drive]))
        command[self.drive] = self.holding[self.drive] + self._waiting.popleft()
        return command


def grows(
    setup: Setup,
    equilibrium: State,
    drive: int,
    *,
    factor: float = 1.0,
    periods: int = 0,
    made_for: State | None = None,
) -> float:
    """Return the ratio of a drive's deviation in the last quarter of a run to that in the second,
    under the full-model LQR made for this place or another one; inf if the run breaks off.
    """
    crane, layout = setup.crane, setup.crane.layout
    q = equilibrium.q.copy()
    q[crane.swings] += AFFECTED
    designed = integrating(setup, equilibrium if made_for is None else made_for)
    table = designed.tracking
    row = np.concatenate([equilibrium.q, equilibrium.v])[None]
    holding = holding_effort(crane, equilibrium.q)
    moved = replace(designed, tracking=replace(table, setpoint=row, feed_forward=holding[None]))
    disturbed = Disturbed(moved, holding, drive, factor, periods)
    try:
        run = setup.simulate(
            crane,
            disturbed,
            standstill(setup, equilibrium),
            start=State(q, equilibrium.v),
            duration=WATCHED,
            label=f"{factor:g} times the effort, {periods} periods late",
        )
    except CraneError as error:
        if interrupted(error):
            raise
        return math.inf
    deviation = np.abs(run.q[:, layout.drives[drive]] - equilibrium.q[layout.drives[drive]])
    quarter = len(deviation) // 4
    return float(deviation[-quarter:].max() / deviation[quarter : 2 * quarter].max())


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Map the margins, then meet them."""
    points = whole("points", options.points, 2)
    within("points", points, 2, MOST)
    maps = mapped(setup, points)
    check, claims = _met(setup, maps[LQR], points)
    unstable = [
        name for name, margins in maps.items() if margin_values(margins, "damping").min() <= 0.0
    ]
    note = f" Unstable somewhere: {', '.join(unstable)}." if unstable else ""
    least_delay = float(margin_values(maps[LQR], "late").min())
    return Outcome(
        tables=[_table(maps, points, note), check],
        claims=[
            Claim(
                "Every strategy that is made for the place is stable over the whole map.",
                not set(unstable) - {KEPT},
            ),
            _needed(setup, maps[KEPT], points),
            Claim(
                "The full-model LQR, made for each place, bears a drive that is late by "
                f"{1e3 * least_delay:.1f} ms, {least_delay / setup.control_period:.1f} control "
                "periods, wherever the trolley stands.",
                least_delay > setup.control_period,
            ),
            *claims,
        ],
        parameters=setup.parameters() | {"points": points, "radii_m": RADII, "cables_m": CABLES},
        figures={"margins_map": margins_figure(*axes(points), maps)},
    )


def _first(value: np.ndarray, extreme: float) -> tuple[int, int]:
    """Return the first index of an extreme value, up to rounding."""
    index = int(np.flatnonzero(np.isclose(value, extreme, rtol=1e-6, atol=0.0))[0])
    return divmod(index, value.shape[1])


def _table(maps: Mapping[str, Mapped], points: int, note: str) -> ResultTable:
    radii, cables = axes(points)

    def least(strategy: str, name: str, scale: float, item: int) -> float:
        """Return the least margin over the map, or the radius or the cable length of its place."""
        margin = scale * margin_values(maps[strategy], name)
        i, j = _first(margin, margin.max() if name == "weaker" else margin.min())
        return float((margin[i, j], radii[j], cables[i])[item])

    columns: list[Column] = [
        (*head, partial(least, name=name, scale=scale, item=item))
        for header, form, name, scale in (
            ("damping [%]", ".3g", "damping", 100.0),
            ("stronger", ".3g", "stronger", 1.0),
            ("weaker", ".3f", "weaker", 1.0),
            ("late [ms]", ".1f", "late", 1e3),
        )
        for item, head in enumerate(((header, form), ("at x [m]", "g"), ("l [m]", "g")))
    ]
    return tabulate(
        "Least margins over trolley radius and cable length",
        maps,
        [("strategy", "", str), *columns],
        "Damping: of the least damped mode, of critical. Stronger, weaker: factor on the effort of "
        "one drive at which the loop is unstable; late: delay of its commands. Each with its "
        f"place, the worst drive of it.{note}",
    )


def _met(setup: Setup, margins_of: Mapped, points: int) -> tuple[ResultTable, list[Claim]]:
    """Simulate the place where the full-model LQR bears the least delay."""
    radii, cables = axes(points)
    borne = margin_values(margins_of, "late")
    i, j = _first(borne, borne.min())
    margins_there = margins_of[i][j]
    if not margins_there.drives:
        raise OutOfRange("the full-model LQR", "unstable", "stable, for margins to be met")
    drive = int(np.argmin([d.late for d in margins_there.drives]))
    margin, equilibrium = margins_there.drives[drive], setup.crane.state(x=radii[j], l=cables[i])
    name = setup.crane.layout.driven[drive].effort_name
    last = math.ceil(margin.late / setup.control_period) - 1
    delays = [
        (float(late), grows(setup, equilibrium, drive, periods=late)) for late in (last, last + 1)
    ]
    factors = [
        (share * margin.stronger, grows(setup, equilibrium, drive, factor=share * margin.stronger))
        for share in (0.98, 1.02)
    ]
    periods = margin.late / setup.control_period
    limits = (
        (f"{name} late [periods]", periods, delays),
        (f"{name} stronger [times]", margin.stronger, factors),
    )
    table = tabulate(
        f"Met in simulation at x = {radii[j]:g} m, l = {cables[i]:g} m",
        limits,
        [
            ("full-model LQR", "", lambda limit: limit[0]),
            ("predicted", ".4g", lambda limit: finite_or_none(limit[1])),
            ("below it", ".4g", lambda limit: finite_or_none(limit[2][0][0])),
            ("growth", ".3g", lambda limit: finite_or_none(limit[2][0][1])),
            ("beyond it", ".4g", lambda limit: finite_or_none(limit[2][1][0])),
            ("growth there", ".3g", lambda limit: finite_or_none(limit[2][1][1])),
        ],
        "Growth: largest deviation of that drive in the last quarter of "
        f"{WATCHED:g} s over that in the second; a dash where the run breaks off.",
    )
    claims = [
        Claim(
            "Where the map shows the least delay for the full-model LQR, simulation is stable with "
            f"{name} {last} control periods late and unstable with {last + 1}: predicted are "
            f"{periods:.2f}.",
            delays[0][1] < 1.0 < delays[1][1],
        ),
        Claim(
            f"There it is stable with {name} {factors[0][0]:.3g} times as strong and unstable with "
            f"{factors[1][0]:.3g} times: predicted are {margin.stronger:.3g}.",
            factors[0][1] < 1.0 < factors[1][1],
        ),
    ]
    return table, claims


def _needed(setup: Setup, margins_of: Mapped, points: int) -> Claim:
    """Claim that the LQR made for the middle is unstable where the map says so, by simulation."""
    radii, cables = axes(points)
    damping = margin_values(margins_of, "damping")
    locations = [_first(damping, end) for end in (damping.min(), damping.max())]
    middle = setup.crane.state(x=MIDDLE[0], l=MIDDLE[1])
    agree, verdicts = True, []
    for i, j in locations:
        equilibrium = setup.crane.state(x=radii[j], l=cables[i])
        growth = grows(setup, equilibrium, setup.crane.layout.drive("x"), made_for=middle)
        stable = damping[i, j] > 0.0
        agree &= (growth < 1.0) == stable
        verdicts.append(
            f"{'stable' if stable else 'unstable'} at x = {radii[j]:g} m, l = {cables[i]:g} m "
            f"({100.0 * damping[i, j]:.3g} % of critical damping)"
        )
    return Claim(
        f"The LQR made for x = {MIDDLE[0]:g} m, l = {MIDDLE[1]:g} m is {verdicts[0]} and "
        f"{verdicts[1]} by the map, and so it is in simulation.",
        bool(agree),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("margins", "how far each strategy is from its end, over the workspace.")
    harness.add_setup(parser)
    parser.add_argument(
        "--points", type=int, default=5, metavar="N", help="places along each side of the map"
    )
    return harness.run_experiment(parser, experiment, argv)
