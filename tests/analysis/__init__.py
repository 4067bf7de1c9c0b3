"""Tests of what is measured of runs."""
