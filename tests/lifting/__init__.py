"""Loads, charts and factors."""
