"""How a record shows itself in Python and in a notebook, and how it goes to tables of other
libraries.
"""

from __future__ import annotations

import importlib
from collections import namedtuple
from collections.abc import Iterator
from html import escape
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from cranedyn.errors import CraneError

if TYPE_CHECKING:
    import pandas
    import pyarrow
    from matplotlib.figure import Figure


class Shown:
    """What a table with columns `table` and a time `t` shows of itself."""

    if TYPE_CHECKING:
        t: np.ndarray
        parameters: Any

        def table(self) -> pyarrow.Table:
            """All columns."""

        def __getitem__(self, column: str) -> np.ndarray: ...
        def __len__(self) -> int: ...

    def keys(self) -> list[str]:
        """Names of the columns; with them ``dict(run)`` gives these."""
        return list(self.table().column_names)

    def __contains__(self, column: object) -> bool:
        """Whether there is a column of this name."""
        return column in self.keys()

    def __iter__(self) -> Iterator[Any]:
        """The rows, each a named tuple, of which pandas makes a data frame."""
        names = self.keys()
        row = namedtuple("Row", names)  # type: ignore[misc]
        return map(row._make, zip(*(self[name].tolist() for name in names), strict=True))

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """All columns for every library that reads Arrow."""
        return self.table().__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> pandas.DataFrame:
        """All columns as a data frame; the parameters are its ``attrs``.

        Raises:
            CraneError: If pandas is not installed.
        """
        try:
            frame = importlib.import_module("pandas").DataFrame(
                {name: self[name] for name in self.keys()}
            )
        except ImportError:
            raise CraneError(
                "pandas is not installed; install it with: pip install 'cranedyn[pandas]'"
            ) from None
        frame.attrs.update(self.parameters)
        return frame

    def plot(self, *columns: str) -> Figure:
        """Columns over time, or without names the drives beside their setpoints and the swing; a
        notebook shows the figure.

        Raises:
            UnknownColumn: If there is no column of a name.
        """
        # By name: a record knows nothing of those who draw it.
        figure: Figure = importlib.import_module("cranedyn.plotting.run").plot(self, *columns)
        return figure

    def view(self, crane: Any = None, *, name: str = "run", file: str | Path | None = None) -> Path:
        """Record the run and open the recording in the viewer's window.

        Args:
            crane: The crane that ran; by default the one that the record names.
            name: What the run is called.
            file: Where the recording is kept; None for a folder of its own for temporary files.

        Returns:
            The recording.

        Raises:
            DataError: If the recording cannot be written, or the record names no crane, as one from
                a CSV file.
            CraneError: If there is no display; the recording is written all the same.
        """
        path: Path = importlib.import_module("cranedyn.recording.viewer").view(
            self, crane, name, file
        )
        return path

    def __repr__(self) -> str:
        """Return a few lines: how long, which rows are not valid and why, and where the coordinates
        went.
        """
        if not len(self):
            return f"{type(self).__name__} without rows"
        lines = [
            f"{name:14} {values[0]:12.6g} {values[-1]:12.6g} {values.min():12.6g} "
            f"{values.max():12.6g}"
            for name, values in self._main()
        ]
        head = f"{type(self).__name__} of {len(self)} rows, t = {self.t[0]:g} to {self.t[-1]:g} s"
        return "\n".join(
            [
                head,
                *self._doubts(),
                f"{'':14} {'first':>12} {'last':>12} {'least':>12} {'most':>12}",
                *lines,
            ]
        )

    def _doubts(self) -> list[str]:
        """Return how many rows are not valid, and why the first of the run is not."""
        bad = np.flatnonzero(self["valid"] != 1.0) if "valid" in self else np.array([], dtype=int)
        if not len(bad):
            return []
        reason = getattr(self, "record", {}).get("not_valid")
        said = (
            f"{len(bad)} of {len(self)} rows are not valid, the first at t = {self.t[bad[0]]:g} s"
        )
        return wrap(f"{said}: {reason}." if reason else f"{said}.", 80)

    def _repr_html_(self) -> str:
        """The same for a notebook, with all columns."""
        if not len(self):
            return f"<p>{type(self).__name__} without rows</p>"
        rows = "".join(
            f"<tr><td style='text-align:left'>{escape(name)}</td>"
            + "".join(
                f"<td>{value:.6g}</td>"
                for value in (values[0], values[-1], values.min(), values.max())
            )
            + "</tr>"
            for name, values in ((name, self[name]) for name in self.keys())
        )
        return (
            f"<p>{type(self).__name__} of {len(self)} rows, t = {self.t[0]:g} to {self.t[-1]:g} "
            "s</p><table><thead><tr>"
            "<th style='text-align:left'>column</th><th>first</th><th>last</th>"
            "<th>least</th><th>most</th></tr></thead>"
            f"<tbody>{rows}</tbody></table>"
        )

    def _main(self) -> Iterator[tuple[str, np.ndarray]]:
        """The coordinates: columns that have a rate."""
        names = self.keys()
        for name in names:
            symbol, _, unit = name.rpartition("_")
            if f"{symbol}_dot_{unit}_s" in names:
                yield name, self[name]
