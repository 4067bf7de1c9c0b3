"""Tests of cranedyn.simulation."""
