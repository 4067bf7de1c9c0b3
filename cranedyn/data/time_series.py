"""Named columns over time: the table that trajectories and loads are."""

from __future__ import annotations

import json
from collections import namedtuple
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cranedyn.errors import CraneError, UnknownColumn

if TYPE_CHECKING:
    import pandas
    import pyarrow


def html_table(title: str, rows: Sequence[Sequence[str]]) -> str:
    """Return a title and a table as HTML for notebooks, its first row as heading."""
    from html import escape  # few runs need it

    headings = "</th><th>".join(escape(cell) for cell in rows[0])
    body = ""
    for row in rows[1:]:
        cells = "</td><td>".join(escape(cell) for cell in row)
        body += f"<tr><td>{cells}</td></tr>"
    return (
        f"<p>{escape(title)}</p><table><thead><tr><th>{headings}</th></tr></thead>"
        f"<tbody>{body}</tbody></table>"
    )


class _ColumnRange(NamedTuple):
    """Range of a column.

    Attributes:
        name: Name of the column.
        first: Value in the first row.
        last: Value in the last row.
        least: Least value.
        largest: Largest value.
    """

    name: str
    first: float
    last: float
    least: float
    largest: float


class TimeSeries:
    """A table of named columns with units, one row for each time.

    A class of this kind defines `keys` and `__getitem__`. `dict(series)` gives the columns by name,
    `pandas.DataFrame(series)` a data frame, and libraries that read Arrow take it as a table.

    Attributes:
        t: Time [s], shape (rows,).
        parameters: Numbers and words that belong to the whole table, by name.
        record: Crane, controller, reference and disturbance of the run, see
            `cranedyn.data.trajectory.Trajectory`.
    """

    t: np.ndarray
    parameters: Mapping[str, float | str]
    record: Mapping[str, Any]

    def keys(self) -> list[str]:
        """Return the names of the columns."""
        raise NotImplementedError

    def __getitem__(self, column: str) -> np.ndarray:
        """Return a column by its name, shape (rows,)."""
        raise NotImplementedError

    @property
    def coordinate_keys(self) -> list[str]:
        """Names of the columns of coordinates: those for which there is a column of the rate."""
        names = self.keys()
        coordinates = []
        for name in names:
            symbol, _, unit = name.rpartition("_")
            if f"{symbol}_dot_{unit}_s" in names:
                coordinates.append(name)
        return coordinates

    @property
    def principal_keys(self) -> list[str]:
        """Names of the columns that a figure shows by default."""
        return self.coordinate_keys

    def __len__(self) -> int:
        return len(self.t)

    def __contains__(self, column: object) -> bool:
        """Return whether there is a column of this name."""
        return column in self.keys()

    def __iter__(self) -> Iterator[Any]:
        """Iterate over the rows as named tuples.

        A column whose name is no identifier of Python, such as "bridge-rail 1_m", is reached by its
        place only.
        """
        names = self.keys()
        row_type = namedtuple("Row", names, rename=True)  # type: ignore[misc]
        columns = [self[name].tolist() for name in names]
        return map(row_type._make, zip(*columns, strict=True))

    def table(self) -> pyarrow.Table:
        """Return all columns as an Arrow table with parameters and record in its metadata."""
        import pyarrow

        from cranedyn.data.tables import number_array

        columns = {name: number_array(self[name]) for name in self.keys()}
        metadata = {
            "cranedyn": json.dumps(dict(self.parameters)),
            "cranedyn.record": json.dumps(dict(self.record)),
        }
        return pyarrow.table(columns, metadata=metadata)

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Export all columns to libraries that read Arrow."""
        return self.table().__arrow_c_stream__(requested_schema)

    def to_pandas(self) -> pandas.DataFrame:
        """Return all columns as a data frame; its ``attrs`` are the parameters.

        Raises:
            CraneError: If pandas is not installed.
        """
        from cranedyn.command import uninterrupted_import

        try:
            pandas = uninterrupted_import("pandas")
        except ImportError:
            message = "pandas is not installed; install it with: pip install 'cranedyn[pandas]'"
            raise CraneError(message) from None
        frame = pandas.DataFrame({name: self[name] for name in self.keys()})
        frame.attrs.update(self.parameters)
        return frame

    def write(self, path: str | Path) -> Path:
        """Write a ``.csv`` or ``.parquet`` file and return its path.

        Both hold every number to the bit; only Parquet holds parameters and record.

        Raises:
            DataError: If the ending is another or the file cannot be written.
        """
        from cranedyn.data.tables import write_table

        return write_table(path, self.table())

    def __repr__(self) -> str:
        """Return a few lines: duration, rows that are not valid, and the range of the coordinates,
        or of all columns where there is no coordinate.
        """
        if not len(self):
            return f"{type(self).__name__} without rows"
        names = self.coordinate_keys or self.keys()[1:]  # without time
        lines = []
        for column in self._ranges(names):
            lines.append(
                f"{column.name:14} {column.first:12.6g} {column.last:12.6g} "
                f"{column.least:12.6g} {column.largest:12.6g}"
            )
        heading = f"{'':14} {'first':>12} {'last':>12} {'least':>12} {'most':>12}"
        return "\n".join([self._title(), *self._validity_lines(), heading, *lines])

    def _repr_html_(self) -> str:
        """Return the range of every column as an HTML table, for notebooks."""
        if not len(self):
            return f"<p>{type(self).__name__} without rows</p>"
        rows: list[tuple[str, ...]] = [("column", "first", "last", "least", "most")]
        for column in self._ranges(self.keys()):
            values = (column.first, column.last, column.least, column.largest)
            rows.append((column.name, *(f"{value:.6g}" for value in values)))
        return html_table(self._title(), rows)

    def _title(self) -> str:
        """Return the first line of texts about the table."""
        duration = f"t = {self.t[0]:g} to {self.t[-1]:g} s"
        return f"{type(self).__name__} of {len(self)} rows, {duration}"

    def _validity_lines(self) -> list[str]:
        """Return how many rows are not valid, and why the first of the run is not."""
        if "valid" not in self:
            return []
        invalid = np.flatnonzero(self["valid"] != 1.0)
        if not len(invalid):
            return []
        reason = self.record.get("not_valid")
        sentence = (
            f"{len(invalid)} of {len(self)} rows are not valid, the first at "
            f"t = {self.t[invalid[0]]:g} s"
        )
        return wrap(f"{sentence}: {reason}." if reason else f"{sentence}.", 80)

    def _ranges(self, names: list[str]) -> Iterator[_ColumnRange]:
        """Yield the range of each of some columns."""
        for name in names:
            values = self[name]
            yield _ColumnRange(name, values[0], values[-1], values.min(), values.max())


class ColumnSeries(TimeSeries):
    """A table whose columns stand beside its times, by name.

    Attributes:
        values: Columns by name, shape (rows,) each.
    """

    values: Mapping[str, np.ndarray]

    def keys(self) -> list[str]:
        """Return the names of the columns."""
        return ["t_s", *self.values]

    def __getitem__(self, column: str) -> np.ndarray:
        """Return a column by its name, shape (rows,).

        Raises:
            UnknownColumn: If there is no such column; it is also a KeyError.
        """
        if column == "t_s":
            return self.t
        if column not in self.values:
            raise UnknownColumn("column", column, self.keys())
        return self.values[column]
