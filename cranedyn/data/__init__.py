"""Records of runs as tables with named columns, and files.

Public: `trajectory.Trajectory` with `read`, `read_columns` and `join`; `time_series.TimeSeries`,
the table that trajectories and loads are; `external.read_external` for files of other programs.

To read: `columns` (names with units), `trajectory`, `tables` (CSV and Parquet), `files` (complete
files or none).
"""
