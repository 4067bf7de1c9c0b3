"""Tests of cranedyn.compiled."""
