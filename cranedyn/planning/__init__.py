"""Motions that are found, not given."""
