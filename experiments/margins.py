"""Margins: how far each strategy is from its end over trolley radius and cable length, and whether
simulation goes unstable where the map says so.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from cranedyn.checks import whole, within
from cranedyn.command import interrupted
from cranedyn.controllers import hold_controller, lqr, paper_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.linearisation import Sampled, sampled
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.estimation import with_observer
from cranedyn.interfaces import Controller, Setpoint, State
from cranedyn.model.crane import STANDARD_GRAVITY
from cranedyn.plotting.figures import panels
from cranedyn.references.motion import Motion
from experiments import harness
from experiments.harness import (
    Claim,
    Column,
    Outcome,
    ResultTable,
    Setup,
    finite_or_none,
    make_table,
)
from experiments.scenarios.strategies import LQR, PAPER, PD, with_integral

if TYPE_CHECKING:
    from cranedyn.interop.margins import Margins, Regulator

RADII = (4.0, 20.0)
"""Least and largest trolley radius of the map [m]."""

CABLES = (5.0, 25.0)
"""Least and largest cable length of the map [m]."""

MIDDLE = (12.0, 15.0)
"""Where the LQR that is not scheduled is designed [m]."""

KEPT = "LQR made for the middle"
"""Name of an LQR that keeps the gain of the middle of the map everywhere."""

BLIND = "LQR, no swing sensor"
"""Name of an LQR that does not measure the swing."""

AFFECTED = 1e-3
"""By how much the load swings at the start of a simulated check [rad], so that it stays linear."""

WATCHED = 40.0
"""How long a simulated check lasts [s]."""

MOST = 500
"""Radii, and cable lengths, of the largest map."""

MarginMap = dict[str, np.ndarray]
"""Least "damping", and margins "stronger", "weaker" and "late" of the worst drive, by cable length,
then by radius; shape (points, points) each."""


def standstill(setup: Setup, equilibrium: State) -> Motion:
    """Return a motion that stands still."""
    layout = setup.crane.layout
    still = np.zeros_like(equilibrium.q[None])
    return Motion(setup.control_period, equilibrium.q[None], still, still, layout.drives)


def integrating(setup: Setup, equilibrium: State) -> HoistIntegral:
    """Return the full-model LQR with an integrator on the hoist, made for a rest."""
    return with_integral(setup, standstill(setup, equilibrium))


CONTROLLERS: dict[str, Callable[[Setup, State], Controller]] = {
    PD: lambda setup, equilibrium: hold_controller(setup.crane, gravity=STANDARD_GRAVITY),
    PAPER: lambda setup, rest: paper_controller(
        setup.crane, standstill(setup, rest), gravity=STANDARD_GRAVITY
    ),
    LQR: integrating,
}
"""How the drives are closed at a rest, by name. Plans that differ in what they feed forward only,
such as flat paths, the shortest time and the MPC within its limits, end in the full-model LQR."""

STRATEGIES = (*CONTROLLERS, KEPT, BLIND)


def linear_form(setup: Setup, strategy: str, equilibrium: State) -> Regulator:
    """Return the linear form of a strategy at a rest: of the LQR made for the middle everywhere the
    same, of the LQR without a swing sensor behind a filter whose gain has settled.
    """
    from cranedyn.interop.margins import behind_observer, regulator

    crane = setup.crane
    period = setup.control_period
    if strategy == KEPT:
        return linear_form(setup, LQR, crane.state(x=MIDDLE[0], l=MIDDLE[1]))
    if strategy != BLIND:
        controller = CONTROLLERS[strategy](setup, equilibrium)
        return regulator(crane, controller, equilibrium, t=0.0, period=period)
    plant = _plant(setup, equilibrium)
    still = standstill(setup, equilibrium)
    gains = with_observer(lqr(crane, still, dt=setup.dt), crane, still, dt=setup.dt).gains
    output = np.eye(len(plant.a))[gains.measured]
    p = scipy.linalg.solve_discrete_are(plant.a.T, output.T, gains.disturbance, gains.noise)
    gain = np.linalg.solve(output @ p @ output.T + gains.noise, output @ p).T
    return behind_observer(linear_form(setup, LQR, equilibrium), plant, gain, gains.measured)


def margins_at(setup: Setup, strategy: str, equilibrium: State) -> Margins:
    """Return the margins of a strategy at a rest."""
    from cranedyn.interop.margins import margins

    return margins(_plant(setup, equilibrium), linear_form(setup, strategy, equilibrium))


def margin_maps(setup: Setup, points: int) -> dict[str, MarginMap]:
    """Return the margins of each strategy over the map."""
    radii, cables = axes(points)
    update = setup.reporter.count("margins", len(STRATEGIES) * points)
    done = 0
    maps = {}
    for strategy in STRATEGIES:
        values = np.empty((4, points, points))
        for i, length in enumerate(cables.tolist()):
            for j, radius in enumerate(radii.tolist()):
                loop = margins_at(setup, strategy, setup.crane.state(x=radius, l=length))
                values[:, i, j] = loop.damping, *loop.least
            update(done := done + 1)
        maps[strategy] = dict(zip(("damping", "stronger", "weaker", "late"), values, strict=True))
    return maps


def _plant(setup: Setup, equilibrium: State) -> Sampled:
    return sampled(setup.crane, equilibrium, dt=setup.dt, control_period=setup.control_period)


def axes(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the radii and cable lengths of the map [m]."""
    return np.linspace(*RADII, points), np.linspace(*CABLES, points)


def disturbed(
    controller: Controller, holding: np.ndarray, drive: int, factor: float, periods: int
) -> Controller:
    """Return a controller one drive of which is some control periods late, and whose effort beyond
    holding the load is multiplied by a factor.
    """
    waiting = deque([0.0] * periods)

    def command(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        efforts = np.array(controller(t, state, setpoint))
        waiting.append(factor * (efforts[drive] - holding[drive]))
        efforts[drive] = holding[drive] + waiting.popleft()
        return efforts

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
    crane = setup.crane
    layout = setup.crane.layout
    q = equilibrium.q.copy()
    q[crane.swings] += AFFECTED
    designed = integrating(setup, equilibrium if made_for is None else made_for)
    table = designed.tracking
    row = np.concatenate([equilibrium.q, equilibrium.v])[None]
    holding = holding_effort(crane, equilibrium.q)
    moved = replace(designed, tracking=replace(table, setpoint=row, feed_forward=holding[None]))
    try:
        run = setup.simulate(
            crane,
            disturbed(moved, holding, drive, factor, periods),
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
    maps = margin_maps(setup, points)
    check, claims = _met(setup, maps[LQR], points)
    unstable = [strategy for strategy, margins in maps.items() if margins["damping"].min() <= 0.0]
    note = f" Unstable somewhere: {', '.join(unstable)}." if unstable else ""
    least_delay = float(maps[LQR]["late"].min())
    return Outcome(
        tables=[_table(maps, points, note), check],
        claims=[
            Claim(
                "Every strategy that is made for the place is stable over the whole map.",
                not set(unstable) - {KEPT},
            ),
            _needed(setup, maps[KEPT]["damping"], points),
            Claim(
                "The full-model LQR, made for each place, bears a drive that is late by "
                f"{1e3 * least_delay:.1f} ms, {least_delay / setup.control_period:.1f} control "
                "periods, wherever the trolley stands.",
                least_delay > setup.control_period,
            ),
            *claims,
        ],
        parameters={"points": points, "radii_m": RADII, "cables_m": CABLES},
        figures={"margins_map": _figure(*axes(points), maps)},
    )


def _first(value: np.ndarray, extreme: float) -> tuple[int, int]:
    """Return the first index of an extreme value, up to rounding."""
    index = int(np.flatnonzero(np.isclose(value, extreme, rtol=1e-6, atol=0.0))[0])
    return divmod(index, value.shape[1])


def _table(maps: Mapping[str, MarginMap], points: int, note: str) -> ResultTable:
    radii, cables = axes(points)

    def least(strategy: str, name: str, scale: float, item: int) -> float:
        """Return the least margin over the map, or the radius or the cable length of its place."""
        margin = scale * maps[strategy][name]
        i, j = _first(margin, margin.max() if name == "weaker" else margin.min())
        return float((margin[i, j], radii[j], cables[i])[item])

    columns: list[Column] = [
        (*head, partial(least, name=name, scale=scale, item=item))
        for header, form, name, scale in (
            ("damping [%]", ".3g", "damping", 100.0),
            ("upper gain margin", ".3g", "stronger", 1.0),
            ("lower gain margin", ".3f", "weaker", 1.0),
            ("delay margin [ms]", ".1f", "late", 1e3),
        )
        for item, head in enumerate(((header, form), ("at x [m]", "g"), ("l [m]", "g")))
    ]
    return make_table(
        "Least margins over trolley radius and cable length",
        maps,
        ("strategy", "", str),
        *columns,
        note="Damping: of the least damped mode. Gain margin: factor on the effort of one drive at "
        f"which the loop becomes unstable; delay margin: delay of its commands.{note}",
    )


def _met(setup: Setup, mapped: MarginMap, points: int) -> tuple[ResultTable, list[Claim]]:
    """Simulate the place where the full-model LQR bears the least delay."""
    radii, cables = axes(points)
    i, j = _first(mapped["late"], mapped["late"].min())
    equilibrium = setup.crane.state(x=radii[j], l=cables[i])
    loop = margins_at(setup, LQR, equilibrium)
    if not loop.drives:
        raise OutOfRange("the full-model LQR", "unstable", "stable, for margins to be met")
    drive = int(np.argmin([margin.delay for margin in loop.drives]))
    stronger = loop.drives[drive].upper_gain
    periods = loop.drives[drive].delay / setup.control_period
    name = setup.crane.layout.driven[drive].effort_name
    last = math.ceil(periods) - 1
    delays = [last, last + 1]
    factors = [0.98 * stronger, 1.02 * stronger]
    late = [grows(setup, equilibrium, drive, periods=delay) for delay in delays]
    strong = [grows(setup, equilibrium, drive, factor=factor) for factor in factors]
    rows = [
        (f"{name} {kind}", *map(finite_or_none, (limit, below, growth, beyond, growth_there)))
        for kind, limit, (below, beyond), (growth, growth_there) in (
            ("delay [periods]", periods, delays, late),
            ("gain [times]", stronger, factors, strong),
        )
    ]
    heads = ("predicted", ".4g"), ("simulated below", ".4g"), ("growth", ".3g")
    table = ResultTable(
        f"Margins simulated at x = {radii[j]:g} m, l = {cables[i]:g} m",
        [("full-model LQR", ""), *heads, ("simulated above", ".4g"), ("its growth", ".3g")],
        rows,
        "Growth: largest deviation of that drive in the last quarter of "
        f"{WATCHED:g} s over that in the second; a dash where the run breaks off.",
    )
    claims = [
        Claim(
            "Where the map shows the least delay for the full-model LQR, simulation is stable with "
            f"{name} {last} control periods late and unstable with {last + 1}: predicted are "
            f"{periods:.2f}.",
            late[0] < 1.0 < late[1],
        ),
        Claim(
            f"There it is stable with {name} {factors[0]:.3g} times as strong and unstable with "
            f"{factors[1]:.3g} times: predicted are {stronger:.3g}.",
            strong[0] < 1.0 < strong[1],
        ),
    ]
    return table, claims


def _needed(setup: Setup, damping: np.ndarray, points: int) -> Claim:
    """Claim that the LQR made for the middle is unstable where the map says so, by simulation."""
    radii, cables = axes(points)
    middle = setup.crane.state(x=MIDDLE[0], l=MIDDLE[1])
    agree = True
    verdicts = []
    for i, j in (_first(damping, extreme) for extreme in (damping.min(), damping.max())):
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


def _figure(radii: np.ndarray, cables: np.ndarray, maps: Mapping[str, MarginMap]) -> Figure:
    """Draw damping, and the delay that the worst drive bears, of each strategy over radius and
    cable.
    """
    figure, panes = panels(len(maps), 2, height=1.8, sharex=True, sharey=True)
    terms = ("least damping [% of critical]", "damping", 100.0), ("delay margin [ms]", "late", 1e3)
    for column, (title, name, scale) in enumerate(terms):
        values = {strategy: scale * margins[name] for strategy, margins in maps.items()}
        norm = LogNorm(
            min(v[v > 0.0].min(initial=v.max()) for v in values.values()),
            max(v.max() for v in values.values()),
        )
        for ax, (strategy, numbers) in zip(panes[column::2], values.items(), strict=True):
            drawn = ax.pcolormesh(
                radii, cables, numbers, norm=norm, cmap="viridis", rasterized=True
            )
            for (i, j), number in np.ndenumerate(numbers):
                stable = number > 0.0
                text = f"{number:.0f}" if number > 9.5 else f"{number:.1g}"
                style: dict[str, Any] = {"ha": "center", "va": "center"}
                style["color"] = "white" if stable and norm(number) <= 0.6 else "#111111"
                style["fontsize"] = min(9.0, 45.0 / len(radii))
                ax.text(float(radii[j]), float(cables[i]), text if stable else "×", **style)
            ax.grid(visible=False)
            ax.set_title(strategy, fontsize=10.0)
        figure.colorbar(drawn, ax=panes[column::2], label=title, location="top", aspect=40)
    figure.supxlabel("trolley radius [m]; × unstable", fontsize=11.0)
    figure.supylabel("cable length [m]", fontsize=11.0)
    return figure


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("margins", __doc__, recording=False)
    harness.add_setup(parser)
    text = "places along each side of the map"
    parser.add_argument("--points", type=int, default=5, metavar="N", help=text)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
