"""Events at which a run leaves the validity of the model, as a table and a figure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.dynamics.validity import events
from cranedyn.plotting.figures import panels
from experiments.harness.outcome import Outcome
from experiments.harness.table import ResultTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.recording import Run


_DIGITS = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?")
"""Numbers in a message; what is left of it is its kind."""


def with_events(outcome: Outcome) -> Outcome:
    """Return the outcome with one more table and figure if a recorded run leaves the validity of
    the model.
    """
    invalid = [run for run in outcome.recording if not run.trajectory.valid.all()]
    if not invalid:
        return outcome
    kinds: dict[tuple[str, str, str], list[tuple[float, str]]] = {}
    for run in invalid:
        for event in events(run.crane, run.trajectory):
            kind = run.name, event.joint, _DIGITS.sub("", event.words)
            kinds.setdefault(kind, []).append((float(run.trajectory.t[event.row]), event.words))
    rows = [(name, len(times), times[0][0], times[0][1]) for (name, _, _), times in kinds.items()]
    columns = [("run", ""), ("times", "d"), ("first at [s]", ".3f"), ("because", "")]
    table = ResultTable("Where the model does not hold", columns, rows)
    figures = {**outcome.figures, "validity": _figure(invalid)}
    return replace(outcome, tables=[*outcome.tables, table], figures=figures)


def _figure(runs: Sequence[Run]) -> Figure:
    """Draw a bar for each run while the model does not hold."""
    figure, (ax,) = panels(height=0.8 + 0.4 * len(runs))
    for i, run in enumerate(runs):
        t, invalid = run.trajectory.t, run.trajectory.valid == 0.0
        until_next = invalid | np.append(False, invalid[:-1])  # a row holds until the next one
        ax.fill_between(t, i - 0.3, i + 0.3, where=until_next, color="#D55E00")
        ax.axhline(i, color="#999999", linewidth=0.8, zorder=0)
    ax.set(
        yticks=range(len(runs)),
        yticklabels=[run.name for run in runs],
        xlabel="time [s]; bars: the model does not hold",
    )
    times = [run.trajectory.t for run in runs]
    ax.set_xlim(min(float(t[0]) for t in times), max(float(t[-1]) for t in times))
    return figure
