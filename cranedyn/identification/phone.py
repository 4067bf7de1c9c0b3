"""Records made with a phone and a tape: what to measure, a template, and a gyroscope's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cranedyn.checks import number
from cranedyn.data.external import Source, load_external
from cranedyn.data.files import write_text
from cranedyn.data.logs import open_log
from cranedyn.data.tables import arrow, write_table
from cranedyn.errors import DataError
from cranedyn.export.target import check_free

TEMPLATE = Path(__file__).with_name("record_template.csv").read_text(encoding="utf-8")
"""Record of three rows, to be replaced by measured ones."""

RECIPE = Path(__file__).with_name("record_template.txt").read_text(encoding="utf-8")
"""What to measure, and how to go on."""

_APPS = {
    "phyphox": (
        "Time (s)",
        "Gyroscope x (rad/s)",
        "Gyroscope y (rad/s)",
        "Gyroscope z (rad/s)",
    ),
    "Sensor Logger": ("seconds_elapsed", "x", "y", "z"),
}
"""Columns of time and of the rates about three axes [rad/s] by app."""


def write_template(path: str | Path) -> None:
    """Write `TEMPLATE` to a new file."""
    check_free(Path(path))
    write_text(path, TEMPLATE)


def write_gyroscope_record(path: str | Path, source: str | Path, length: float | str) -> None:
    """Write the record of a phone that swings with the load to a new file.

    The swing turns the phone about one axis, however the phone lies: that of the largest variance.
    Its sign is unknown, which a free swing does not need.

    Args:
        path: A ``.csv`` or ``.parquet`` file.
        source: CSV of the app phyphox or Sensor Logger.
        length: Cable length [m].

    Raises:
        DataError: If a file cannot be read or written, or is that of another app.
        OutOfRange: If the length is not positive.
    """
    length = number("length of the cable", length, "m", "> 0")
    log = open_log(source)
    app_columns = None
    for columns in _APPS.values():
        if app_columns is None and {*columns} <= {*log.names}:
            app_columns = columns
    if app_columns is None:
        known = "; ".join(f"{', '.join(columns)} ({name})" for name, columns in _APPS.items())
        raise DataError(f"{source} has no columns of a gyroscope; allowed are {known}.")
    ours = ("t_s", "x_rad_s", "y_rad_s", "z_rad_s")
    sources = {}
    for our_name, app_name in zip(ours, app_columns, strict=True):
        sources[our_name] = Source(app_name)
    data = load_external(log, ours, sources).columns
    rates = np.stack([data[name] for name in ours[1:]], axis=1)
    # The first right singular vector is the axis of the largest variance.
    axis = np.linalg.svd(rates - rates.mean(axis=0), full_matrices=False)[2][0]
    record = {
        "t_s": data["t_s"],
        "phi_dot_rad_s": rates @ axis,
        "l_m": np.full(len(rates), length),
    }
    check_free(Path(path))
    write_table(path, arrow().table(record))
