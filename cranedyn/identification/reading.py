"""Records from files: CSV, Parquet, and recordings of ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from cranedyn.bridges import bags
from cranedyn.data.external import Source, read_external
from cranedyn.data.tables import column_names
from cranedyn.identification.record import Record, relevant_columns
from cranedyn.model.crane import Crane


def load_record(
    path: str | Path,
    crane: Crane,
    *,
    sources: Mapping[str, Source] | None = None,
    joints: Mapping[str, str] | None = None,
    since: float = -math.inf,
    until: float = math.inf,
) -> Record:
    """Load a record from a file; columns other than those of drives and swings are not read.

    Args:
        path: ``.csv`` or ``.parquet`` with columns of cranedyn; ``.mcap`` or ``.bag`` with joint
            states.
        crane: Crane with prior values.
        sources: Names and units of columns of CSV and Parquet files, by the names of cranedyn,
            see `cranedyn.data.external.parse_sources`.
        joints: Names of the joints in a recording of ROS by the symbols of coordinates.
        since: Start of the record [s], on its own clock.
        until: End of the record [s].

    Raises:
        DataError: As `cranedyn.data.external.read_external`,
            `cranedyn.bridges.bags.read_joint_states` and `Record.of`.
        UnknownName: If a source names an unknown column.
    """
    path = Path(path)
    if path.suffix in bags.ENDINGS:
        available = bags.joint_state_columns(path, joints)
        wanted = [name for name in relevant_columns(crane) if name in available]
        data = bags.read_joint_states(path, ["t_s", *wanted], joints)
    else:
        sources = sources or {}
        names = set(column_names(path))
        wanted = [
            name
            for name in relevant_columns(crane)
            if name in sources or (name in names and name != "t_s")
        ]
        needed = list(dict.fromkeys(["t_s", *wanted, *sources]))
        data = read_external(path, needed, sources)
    return Record.of(crane, data, name=path.name, since=since, until=until)
