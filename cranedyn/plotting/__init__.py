"""Figures in one style with one colour for each quantity.

`figures`: `panels`, `save`, `plot_columns` and `plot_runs`. `style`: colours.
"""
