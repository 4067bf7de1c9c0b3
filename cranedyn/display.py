"""Figures of cranes and runs: `plot` of the API, see also `cranedyn.recording.viewer.view`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

from cranedyn.data.time_series import TimeSeries
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@overload
def plot(subject: Crane, state: State | None = None, /) -> Figure: ...


@overload
def plot(subject: TimeSeries, /, *columns: str) -> Figure: ...


def plot(subject: Crane | TimeSeries, /, *selection: Any) -> Figure:
    """Draw a crane from the side, or columns of a run over time; notebooks display the figure.

    Args:
        subject: A crane, a trajectory, or another table such as
            `cranedyn.lifts.judging.loads.Loads`.
        selection: For a crane the state to draw, by default the one in which it starts. For a table
            the names of columns, one panel each; by default the drives beside their setpoints and
            the swing.

    Raises:
        UnknownColumn: If there is no column of a name.
    """
    # Neither import costs time where the other is needed.
    if isinstance(subject, Crane):
        from cranedyn.recording.sketch import sketch

        return sketch(subject, *selection)
    from cranedyn.plotting.figures import plot_columns

    return plot_columns(subject, *selection)
