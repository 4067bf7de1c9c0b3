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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
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

MIDDLE_RADIUS = 12.0
"""Trolley radius in the middle of the map, for which the LQR that is not scheduled is made [m]."""

MIDDLE_CABLE = 15.0
"""Cable length in the middle of the map [m]."""

UNSCHEDULED = "LQR made for the middle"
"""Name of an LQR that keeps the gain of the middle of the map everywhere."""

NO_SWING_SENSOR = "LQR, no swing sensor"
"""Name of an LQR that does not measure the swing."""

START_SWING = 1e-3
"""Angle of the swing joints at the start of a simulated check [rad].

It is so small that the loop stays linear.
"""

CHECK_DURATION = 40.0
"""Duration of a simulated check [s]."""

GAIN_STEP = 0.02
"""Relative distance from the predicted gain margin at which the loop is simulated."""

MAX_POINTS = 500
"""Largest number of radii, and of cable lengths, of a map."""

MarginMap = dict[str, np.ndarray]
"""The least damping "damping" of any mode, and the margins of the worst drive: factors "stronger"
and "weaker" on its effort, and its delay "late" [s]. By cable length, then by radius; shape
(points, points) each."""


def standstill(setup: Setup, equilibrium: State) -> Motion:
    """Return a motion that stands still at an equilibrium."""
    layout = setup.crane.layout
    position = equilibrium.q[None]
    zero = np.zeros_like(position)
    return Motion(setup.control_period, position, zero, zero, layout.drives)


def _hold(setup: Setup, equilibrium: State) -> Controller:
    return hold_controller(setup.crane, gravity=STANDARD_GRAVITY)


def _paper(setup: Setup, equilibrium: State) -> Controller:
    motion = standstill(setup, equilibrium)
    return paper_controller(setup.crane, motion, gravity=STANDARD_GRAVITY)


def full_model_lqr(setup: Setup, equilibrium: State) -> HoistIntegral:
    """Return the full-model LQR made for an equilibrium, with an integrator on the hoist."""
    return with_integral(setup, standstill(setup, equilibrium))


CONTROLLERS: dict[str, Callable[[Setup, State], Controller]] = {
    PD: _hold,
    PAPER: _paper,
    LQR: full_model_lqr,
}
"""Functions that make the controller of a strategy for an equilibrium, by the name of the strategy.

Strategies that differ in their feed-forward only, such as flat paths, least time, and the MPC
within its limits, end in the full-model LQR.
"""

STRATEGIES = (*CONTROLLERS, UNSCHEDULED, NO_SWING_SENSOR)
"""Names of all strategies of the map."""


def linear_form(setup: Setup, strategy: str, equilibrium: State) -> Regulator:
    """Return the linear form of a strategy at an equilibrium.

    The LQR made for the middle has the same form everywhere. That without a swing sensor acts on
    the estimate of a Kalman filter whose gain has settled.
    """
    from cranedyn.interop.margins import behind_observer, regulator

    crane = setup.crane
    if strategy == UNSCHEDULED:
        return linear_form(setup, LQR, crane.state(x=MIDDLE_RADIUS, l=MIDDLE_CABLE))
    if strategy != NO_SWING_SENSOR:
        controller = CONTROLLERS[strategy](setup, equilibrium)
        return regulator(crane, controller, equilibrium, t=0.0, period=setup.control_period)
    plant = _plant(setup, equilibrium)
    motion = standstill(setup, equilibrium)
    # Only the covariances of the observer are used, which do not depend on its controller.
    observer = with_observer(lqr(crane, motion, dt=setup.dt), crane, motion, dt=setup.dt).gains
    output = np.eye(len(plant.a))[observer.measured]
    # The filter that has settled: P solves the Riccati equation, and K = P Cᵀ (C P Cᵀ + R)⁻¹.
    covariance = scipy.linalg.solve_discrete_are(
        plant.a.T, output.T, observer.disturbance, observer.noise
    )
    innovation = output @ covariance @ output.T + observer.noise
    gain = np.linalg.solve(innovation, output @ covariance).T
    return behind_observer(linear_form(setup, LQR, equilibrium), plant, gain, observer.measured)


def margins_at(setup: Setup, strategy: str, equilibrium: State) -> Margins:
    """Return the margins of a strategy at a rest."""
    from cranedyn.interop.margins import margins

    return margins(_plant(setup, equilibrium), linear_form(setup, strategy, equilibrium))


def margin_maps(setup: Setup, points: int) -> dict[str, MarginMap]:
    """Return the margins of each strategy over a map with a number of points along each side."""
    radii, cables = axes(points)
    update = setup.reporter.count("margins", len(STRATEGIES) * points)
    done = 0
    maps: dict[str, MarginMap] = {}
    for strategy in STRATEGIES:
        values = np.empty((4, points, points))
        for i, length in enumerate(cables.tolist()):
            for j, radius in enumerate(radii.tolist()):
                loop = margins_at(setup, strategy, setup.crane.state(x=radius, l=length))
                least = loop.least
                values[:, i, j] = loop.damping, least.upper_gain, least.lower_gain, least.delay
            done += 1
            update(done)
        damping, stronger, weaker, late = values
        maps[strategy] = {
            "damping": damping,
            "stronger": stronger,
            "weaker": weaker,
            "late": late,
        }
    return maps


def _plant(setup: Setup, equilibrium: State) -> Sampled:
    return sampled(setup.crane, equilibrium, dt=setup.dt, control_period=setup.control_period)


def axes(points: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the radii and cable lengths of the map [m]."""
    return np.linspace(*RADII, points), np.linspace(*CABLES, points)


def disturbed(
    controller: Controller, holding: np.ndarray, drive: int, factor: float, periods: int
) -> Controller:
    """Return a controller of which one drive is late, or stronger than it should be.

    Args:
        controller: The controller.
        holding: Efforts that hold the load at rest [N m or N], shape (m,); they are not changed.
        drive: Index of the drive.
        factor: Factor on its effort beyond holding the load.
        periods: Number of control periods by which this effort is late.
    """
    waiting = deque([0.0] * periods)

    def command(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        efforts = np.array(controller(t, state, setpoint))
        waiting.append(factor * (efforts[drive] - holding[drive]))
        efforts[drive] = holding[drive] + waiting.popleft()
        return efforts

    return command


def growth_in_run(
    setup: Setup,
    equilibrium: State,
    drive: int,
    *,
    factor: float = 1.0,
    periods: int = 0,
    made_for: State | None = None,
) -> float:
    """Return by how much the deviation of a drive grows in a run under the full-model LQR.

    It is the largest deviation in the last quarter of the run over that in the second quarter: less
    than 1 if the loop is stable, infinite if the run breaks off.

    Args:
        setup: The world.
        equilibrium: Where the crane stands.
        drive: Index of the drive.
        factor: Factor on its effort, see `disturbed`.
        periods: Its delay in control periods.
        made_for: Equilibrium for which the LQR is made; None for the same.
    """
    crane = setup.crane
    designed = full_model_lqr(setup, equilibrium if made_for is None else made_for)
    # Its gain holds the crane where it stands, whatever place it is made for.
    setpoint = np.concatenate([equilibrium.q, equilibrium.v])[None]
    holding = holding_effort(crane, equilibrium.q)
    tracking = replace(designed.tracking, setpoint=setpoint, feed_forward=holding[None])
    regulator = replace(designed, tracking=tracking)

    q = equilibrium.q.copy()
    q[crane.swings] += START_SWING
    try:
        run = setup.simulate(
            crane,
            disturbed(regulator, holding, drive, factor, periods),
            standstill(setup, equilibrium),
            start=State(q, equilibrium.v),
            duration=CHECK_DURATION,
            label=f"{factor:g} times the effort, {periods} periods late",
        )
    except CraneError as error:
        if interrupted(error):
            raise
        return math.inf
    joint = crane.layout.drives[drive]
    deviation = np.abs(run.q[:, joint] - equilibrium.q[joint])
    quarter = len(deviation) // 4
    return float(deviation[-quarter:].max() / deviation[quarter : 2 * quarter].max())


def experiment(options: argparse.Namespace, setup: Setup) -> Outcome:
    """Map the margins, then simulate just inside and outside of them."""
    points = whole("points", options.points, 2)
    within("points", points, 2, MAX_POINTS)
    maps = margin_maps(setup, points)
    check = _check_least_delay(setup, maps[LQR], points)
    unstable = [strategy for strategy, margins in maps.items() if margins["damping"].min() <= 0.0]
    note = f" Unstable somewhere: {', '.join(unstable)}." if unstable else ""
    least_delay = float(maps[LQR]["late"].min())
    radii, cables = axes(points)
    return Outcome(
        tables=[_table(maps, points, note), _check_table(check)],
        claims=[
            Claim(
                "Every strategy that is made for the place is stable over the whole map.",
                not set(unstable) - {UNSCHEDULED},
            ),
            _unscheduled_claim(setup, maps[UNSCHEDULED]["damping"], points),
            Claim(
                "The full-model LQR, made for each place, bears a drive that is late by "
                f"{1e3 * least_delay:.1f} ms, {least_delay / setup.control_period:.1f} control "
                "periods, wherever the trolley stands.",
                least_delay > setup.control_period,
            ),
            *_check_claims(check),
        ],
        parameters={"points": points, "radii_m": RADII, "cables_m": CABLES},
        figures={"margins_map": _figure(radii, cables, maps)},
    )


def _first(value: np.ndarray, extreme: float) -> tuple[int, int]:
    """Return row and column of the first value of a map that is extreme, up to rounding."""
    index = int(np.flatnonzero(np.isclose(value, extreme, rtol=1e-6, atol=0.0))[0])
    return divmod(index, value.shape[1])


class _LeastMargin(NamedTuple):
    """The least margin of a strategy over the map.

    Attributes:
        value: The margin.
        radius: Trolley radius at which it is least [m].
        cable: Cable length at which it is least [m].
    """

    value: float
    radius: float
    cable: float


def _margin_value(least: Mapping[str, _LeastMargin], strategy: str) -> float:
    return least[strategy].value


def _margin_radius(least: Mapping[str, _LeastMargin], strategy: str) -> float:
    return least[strategy].radius


def _margin_cable(least: Mapping[str, _LeastMargin], strategy: str) -> float:
    return least[strategy].cable


def _table(maps: Mapping[str, MarginMap], points: int, note: str) -> ResultTable:
    radii, cables = axes(points)

    columns: list[Column] = [("strategy", "", str)]
    for header, form, name, scale in (
        ("damping [%]", ".3g", "damping", 100.0),
        ("upper gain margin", ".3g", "stronger", 1.0),
        ("lower gain margin", ".3f", "weaker", 1.0),
        ("delay margin [ms]", ".1f", "late", 1e3),
    ):
        least: dict[str, _LeastMargin] = {}
        for strategy, margins in maps.items():
            margin = scale * margins[name]
            # A lower gain margin is the worse the larger it is.
            i, j = _first(margin, margin.max() if name == "weaker" else margin.min())
            least[strategy] = _LeastMargin(float(margin[i, j]), float(radii[j]), float(cables[i]))
        columns += [
            (header, form, partial(_margin_value, least)),
            ("at x [m]", "g", partial(_margin_radius, least)),
            ("l [m]", "g", partial(_margin_cable, least)),
        ]
    return make_table(
        "Least margins over trolley radius and cable length",
        maps,
        *columns,
        note="Damping: of the least damped mode. Gain margin: factor on the effort of one drive at "
        f"which the loop becomes unstable; delay margin: delay of its commands.{note}",
    )


class _MarginCheck(NamedTuple):
    """A predicted margin of a drive, simulated just below and just above it.

    Attributes:
        kind: What is varied, with its unit.
        predicted: The predicted margin.
        below: Largest simulated value below it.
        growth_below: Growth in that run, see `growth_in_run`.
        above: Smallest simulated value above it.
        growth_above: Growth in that run.
    """

    kind: str
    predicted: float
    below: float
    growth_below: float
    above: float
    growth_above: float

    @property
    def holds(self) -> bool:
        """Whether the loop is stable below the margin and unstable above it."""
        return self.growth_below < 1.0 < self.growth_above


class _LeastDelayCheck(NamedTuple):
    """Simulations at the place where the full-model LQR bears the least delay.

    Attributes:
        radius: Trolley radius of the place [m].
        cable: Cable length of the place [m].
        drive: Name of the effort of the drive that bears the least delay.
        delay: Its delay margin [control periods].
        gain: Its gain margin [times].
    """

    radius: float
    cable: float
    drive: str
    delay: _MarginCheck
    gain: _MarginCheck


def _check_least_delay(setup: Setup, mapped: MarginMap, points: int) -> _LeastDelayCheck:
    """Simulate the place where the full-model LQR bears the least delay.

    Raises:
        OutOfRange: If the LQR is unstable there.
    """
    radii, cables = axes(points)
    i, j = _first(mapped["late"], mapped["late"].min())
    equilibrium = setup.crane.state(x=radii[j], l=cables[i])
    loop = margins_at(setup, LQR, equilibrium)
    if not loop.drives:
        raise OutOfRange("the full-model LQR", "unstable", "stable, for margins to be met")
    drive = int(np.argmin([margin.delay for margin in loop.drives]))
    grow = partial(growth_in_run, setup, equilibrium, drive)

    predicted_delay = loop.drives[drive].delay / setup.control_period
    last_stable = math.ceil(predicted_delay) - 1
    delay = _MarginCheck(
        kind="delay [periods]",
        predicted=predicted_delay,
        below=last_stable,
        growth_below=grow(periods=last_stable),
        above=last_stable + 1,
        growth_above=grow(periods=last_stable + 1),
    )
    predicted_gain = loop.drives[drive].upper_gain
    weaker = (1.0 - GAIN_STEP) * predicted_gain
    stronger = (1.0 + GAIN_STEP) * predicted_gain
    gain = _MarginCheck(
        kind="gain [times]",
        predicted=predicted_gain,
        below=weaker,
        growth_below=grow(factor=weaker),
        above=stronger,
        growth_above=grow(factor=stronger),
    )
    name = setup.crane.layout.driven[drive].effort_name
    return _LeastDelayCheck(float(radii[j]), float(cables[i]), name, delay, gain)


def _check_table(check: _LeastDelayCheck) -> ResultTable:
    return make_table(
        f"Margins simulated at x = {check.radius:g} m, l = {check.cable:g} m",
        [check.delay, check.gain],
        ("full-model LQR", "", lambda margin: f"{check.drive} {margin.kind}"),
        ("predicted", ".4g", lambda margin: finite_or_none(margin.predicted)),
        ("simulated below", ".4g", lambda margin: finite_or_none(margin.below)),
        ("growth", ".3g", lambda margin: finite_or_none(margin.growth_below)),
        ("simulated above", ".4g", lambda margin: finite_or_none(margin.above)),
        ("its growth", ".3g", lambda margin: finite_or_none(margin.growth_above)),
        note="Growth: largest deviation of that drive in the last quarter of "
        f"{CHECK_DURATION:g} s over that in the second; a dash where the run breaks off.",
    )


def _check_claims(check: _LeastDelayCheck) -> list[Claim]:
    delay = check.delay
    gain = check.gain
    return [
        Claim(
            "Where the map shows the least delay for the full-model LQR, simulation is stable with "
            f"{check.drive} {delay.below} control periods late and unstable with {delay.above}: "
            f"predicted are {delay.predicted:.2f}.",
            delay.holds,
        ),
        Claim(
            f"There it is stable with {check.drive} {gain.below:.3g} times as strong and unstable "
            f"with {gain.above:.3g} times: predicted are {gain.predicted:.3g}.",
            gain.holds,
        ),
    ]


def _unscheduled_claim(setup: Setup, damping: np.ndarray, points: int) -> Claim:
    """Return the claim that the LQR made for the middle is stable and unstable where the map says
    so, by simulation at the places of least and of largest damping.

    Args:
        setup: The world.
        damping: Its least damping over the map.
        points: Number of points along each side of the map.
    """
    radii, cables = axes(points)
    middle = setup.crane.state(x=MIDDLE_RADIUS, l=MIDDLE_CABLE)
    trolley = setup.crane.layout.drive("x")
    agree = True
    verdicts = []
    for extreme in (damping.min(), damping.max()):
        i, j = _first(damping, extreme)
        equilibrium = setup.crane.state(x=radii[j], l=cables[i])
        growth = growth_in_run(setup, equilibrium, trolley, made_for=middle)
        is_stable = damping[i, j] > 0.0
        agree &= (growth < 1.0) == is_stable
        verdicts.append(
            f"{'stable' if is_stable else 'unstable'} at x = {radii[j]:g} m, l = {cables[i]:g} m "
            f"({100.0 * damping[i, j]:.3g} % of critical damping)"
        )
    return Claim(
        f"The LQR made for x = {MIDDLE_RADIUS:g} m, l = {MIDDLE_CABLE:g} m is {verdicts[0]} and "
        f"{verdicts[1]} by the map, and so it is in simulation.",
        bool(agree),
    )


def _figure(radii: np.ndarray, cables: np.ndarray, maps: Mapping[str, MarginMap]) -> Figure:
    """Draw damping, and the delay that the worst drive bears, of each strategy over radius and
    cable.
    """
    figure, panes = panels(len(maps), 2, height=1.8, sharex=True, sharey=True)
    for column, (title, name, scale) in enumerate(
        (("least damping [% of critical]", "damping", 100.0), ("delay margin [ms]", "late", 1e3))
    ):
        values = {strategy: scale * margins[name] for strategy, margins in maps.items()}
        # A logarithmic scale has no place for unstable loops, which are not positive.
        least = min(of_map[of_map > 0.0].min(initial=of_map.max()) for of_map in values.values())
        norm = LogNorm(least, max(of_map.max() for of_map in values.values()))
        for ax, (strategy, numbers) in zip(panes[column::2], values.items(), strict=True):
            drawn = _draw_map(ax, radii, cables, numbers, norm)
            ax.set_title(strategy, fontsize=10.0)
        figure.colorbar(drawn, ax=panes[column::2], label=title, location="top", aspect=40)
    figure.supxlabel("trolley radius [m]; × unstable", fontsize=11.0)
    figure.supylabel("cable length [m]", fontsize=11.0)
    return figure


def _draw_map(
    ax: Axes, radii: np.ndarray, cables: np.ndarray, numbers: np.ndarray, norm: LogNorm
) -> QuadMesh:
    """Draw a map with its numbers in it, a cross where the loop is unstable."""
    drawn = ax.pcolormesh(radii, cables, numbers, norm=norm, cmap="viridis", rasterized=True)
    for (i, j), number in np.ndenumerate(numbers):
        text = f"{number:.0f}" if number > 9.5 else f"{number:.1g}"
        is_stable = number > 0.0
        is_dark = is_stable and norm(number) <= 0.6
        ax.text(
            float(radii[j]),
            float(cables[i]),
            text if is_stable else "×",
            ha="center",
            va="center",
            color="white" if is_dark else "#111111",
            fontsize=min(9.0, 45.0 / len(radii)),
        )
    ax.grid(visible=False)
    return drawn


def main(argv: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = harness.parser("margins", __doc__, recording=False)
    harness.add_setup(parser)
    text = "places along each side of the map"
    parser.add_argument("--points", type=int, default=5, metavar="N", help=text)
    return harness.run_experiment(parser, experiment, argv)


if __name__ == "__main__":
    sys.exit(main())
