"""The time that a supervisor of eight cranes takes for a cycle, and the slews of its cranes."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.interfaces import State
from cranedyn.lifts.sites.brakes import CYCLE
from cranedyn.lifts.sites.crane_site import CraneSite
from cranedyn.lifts.sites.crane_site_file import read_crane_site
from cranedyn.lifts.sites.guard import BoxRequest, Guard
from cranedyn.lifts.sites.supervisor import Supervisor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TOWER_SPACING = 45.0
"""Distance between eight towers in two rows, for the time of a cycle [m]."""

COMMAND_CYCLES = 100
"""Number of cycles for which a drive keeps a command."""

PASSES = 3
"""Number of times that the cycles are timed."""


@dataclass(frozen=True, eq=False)
class SupervisorCycles:
    """Cycles of a supervisor of eight cranes.

    Attributes:
        times: Processor time of the supervisor in each cycle [s], shape (cycles,).
        slews: Slew of each crane with the lower and the upper end of its box [rad], shape
            (cycles, 8, 3).
    """

    times: np.ndarray
    slews: np.ndarray


def timed_cycles(cycles: int) -> SupervisorCycles:
    """Time the cycles in several passes, and return the least time of each.

    Other programs of the computer only slow a pass down: the least comes nearest to what a cycle
    takes.
    """
    passes = [supervisor_cycles(cycles) for _ in range(PASSES)]
    least = np.min([one.times for one in passes], axis=0)
    return SupervisorCycles(least, passes[0].slews)


def supervisor_cycles(cycles: int) -> SupervisorCycles:
    """Time a supervisor of eight cranes whose drives do exactly what their guards pass on.

    Two rows of four towers face each other. Every `COMMAND_CYCLES` each drive gets another
    command: its largest rate to either side, or none.

    Args:
        cycles: Number of cycles.
    """
    site = _eight_towers()
    stations = site.stations
    rng = np.random.default_rng(0)
    guards = [Guard(station, site.swing) for station in stations]
    supervisor = Supervisor(site, [guard.box for guard in guards])
    states = []
    for station in stations:
        start = station.crane.start
        states.append(State(start.q[None].copy(), start.v[None].copy()))
    commands = [np.zeros((1, 3))] * len(stations)

    times = np.zeros(cycles)
    rows = []
    for cycle in range(cycles):
        requests: list[tuple[int, BoxRequest]] = []
        for i, (guard, state, station) in enumerate(zip(guards, states, stations, strict=True)):
            if cycle % COMMAND_CYCLES == 0:
                commands[i] = rng.integers(-1, 2, (1, 3)) * station.converters.rates
            rates, request = guard.step(cycle * CYCLE, state, commands[i])
            drives = station.crane.layout.drives
            state.q[:, drives] += rates * CYCLE
            state.v[:, drives] = rates
            if len(request.copies):
                requests.append((i, request))

        begin = time.process_time()
        grants = [(i, supervisor.receive(i, request)) for i, request in requests]
        times[cycle] = time.process_time() - begin
        for i, grant in grants:
            guards[i].receive(grant)

        row = []
        for guard, state, station in zip(guards, states, stations, strict=True):
            slew = station.crane.layout.drives[0]
            low, high = guard.box[0, :, 0]
            row.append((state.q[0, slew], low, high))
        rows.append(row)
    return SupervisorCycles(times, np.array(rows))


def _eight_towers() -> CraneSite:
    """Return a site of two rows of four towers, each row turned towards the other, with jibs 3 m
    one above the next.
    """
    four = read_crane_site("four_towers")
    stations = []
    for i in range(8):
        foot = np.array([TOWER_SPACING * (i % 4), TOWER_SPACING * (i // 4), 3.0 * i])
        heading = math.copysign(math.pi / 2.0, i - 3.5)
        stations.append(replace(four.stations[i % 4], name=str(i), foot=foot, heading=heading))
    return CraneSite("eight towers", tuple(stations), swing=four.swing)


def slews_figure(slews: np.ndarray) -> Figure:
    """Draw the slews of the first two cranes in their boxes.

    Args:
        slews: Slew and ends of the box of each crane [rad], shape (cycles, cranes, 3).
    """
    from cranedyn.plotting.figures import legend_above, panels

    drawing, axes = panels(2, sharex=True)
    t = CYCLE * np.arange(len(slews))
    for axis, crane, name in zip(axes, (0, 1), "ab", strict=True):
        slew, low, high = np.degrees(slews[:, crane]).T
        axis.fill_between(t, low, high, alpha=0.3, linewidth=0.0, label="box that it holds")
        axis.plot(t, slew, label="slew")
        axis.set_ylabel(f"slew of crane {name} [°]")
    drawing.align_ylabels(axes)
    axes[-1].set_xlabel("time [s]")
    legend_above(axes[0])
    return drawing
