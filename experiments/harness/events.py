"""Where the runs of an experiment left what the model holds for: a table, a figure and words for
the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.dynamics.validity import events
from cranedyn.plotting.figures import panels
from experiments.harness.outcome import Outcome, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.recording import Run


def with_events(outcome: Outcome) -> Outcome:
    """The outcome, with a table and a figure more if a recorded run goes beyond what the model
    holds for.
    """
    beyond = [run for run in outcome.recording if not run.trajectory.valid.all()]
    if not beyond:
        return outcome
    rows = [
        (run.name, float(run.trajectory.t[event.row]), event.words)
        for run in beyond
        for event in events(run.crane, run.trajectory)
    ]
    table = Table(
        "Where the model does not hold", [("run", ""), ("from [s]", ".3f"), ("because", "")], rows
    )
    return replace(
        outcome,
        tables=[*outcome.tables, table],
        figures={**outcome.figures, "validity": _figure(beyond)},
    )


def _figure(runs: Sequence[Run]) -> Figure:
    """A bar for each run while the model does not hold."""
    figure, (ax,) = panels(height=0.8 + 0.4 * len(runs))
    for i, run in enumerate(runs):
        t, off = run.trajectory.t, run.trajectory.valid == 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]]).astype(int)))
        period = float(t[1] - t[0]) if len(t) > 1 else 0.0
        spans = [
            (float(t[a]), float(t[b - 1]) - float(t[a]) + period)
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
        ax.broken_barh(spans, (i - 0.3, 0.6), color="#D55E00", edgecolor="#D55E00")
        ax.axhline(i, color="#999999", linewidth=0.8, zorder=0)
    ax.set(
        yticks=range(len(runs)),
        yticklabels=[run.name for run in runs],
        xlabel="time [s]; bars: the model does not hold",
    )
    ax.set_xlim(
        min(float(run.trajectory.t[0]) for run in runs),
        max(float(run.trajectory.t[-1]) for run in runs),
    )
    return figure
