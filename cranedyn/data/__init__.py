"""Records of runs as tables with named columns, and files.

Public: `trajectory.Trajectory` with `read`, `read_columns` and `join`; `time_series.TimeSeries`,
the table that trajectories and loads are; `external.read_external` for files of other programs.

To read: `columns` (names with units), `trajectory`, `tables` (CSV and Parquet), `files` (complete
files or none). Files of other programs: `external` (our names and units), `logs` (a function for
each format), `text_layout` (what is recognised in a text), `bounded` and `binary_reader` (binary
files in a process of their own).
"""
