"""Where recorded runs leave the range in which the model holds: a table and a figure."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.dynamics.validity import events
from experiments.harness.outcome import Outcome
from experiments.harness.table import ResultTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from cranedyn.recording import Run


_NUMBER = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?")
"""A number in the message of an event.

Messages that differ only in their numbers report the same kind of event and share a row.
"""


def with_events(outcome: Outcome) -> Outcome:
    """Return the outcome; if a recorded run leaves the range in which the model holds, it has a
    table and a figure more.

    The table has a row for each run, joint and kind of event: how often it occurs, when it occurs
    first, and with which message.
    """
    invalid = [run for run in outcome.recording if not run.trajectory.valid.all()]
    if not invalid:
        return outcome
    # Time and message of each event, by name of the run, joint and kind.
    occurrences: dict[tuple[str, str, str], list[tuple[float, str]]] = {}
    for run in invalid:
        for event in events(run.crane, run.trajectory):
            kind = (run.name, event.joint, _NUMBER.sub("", event.words))
            time = float(run.trajectory.t[event.row])
            occurrences.setdefault(kind, []).append((time, event.words))

    rows = []
    for (run_name, _, _), found in occurrences.items():
        first_time, first_message = found[0]
        rows.append((run_name, len(found), first_time, first_message))
    columns = [("run", ""), ("times", "d"), ("first at [s]", ".3f"), ("because", "")]
    table = ResultTable("Where the model does not hold", columns, rows)
    figures = {**outcome.figures, "validity": _figure(invalid)}
    return replace(outcome, tables=[*outcome.tables, table], figures=figures)


def _figure(runs: Sequence[Run]) -> Figure:
    """Draw a line for each run, with a bar wherever the model does not hold."""
    # Workers, which draw nothing, do not wait for this import.
    from cranedyn.plotting.figures import panels

    figure, (ax,) = panels(height=0.8 + 0.4 * len(runs))
    for i, run in enumerate(runs):
        t = run.trajectory.t
        invalid = run.trajectory.valid == 0.0
        # A row describes the run until the next one. `fill_between` fills only where both ends of
        # an interval are marked, so the row after an invalid one is marked as well.
        until_next = invalid | np.append(False, invalid[:-1])
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
