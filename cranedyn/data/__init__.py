"""Records and files: trajectories with named columns, tables, files written whole or not at all."""
