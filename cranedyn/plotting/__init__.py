"""Figures in one style, one colour for each quantity."""
