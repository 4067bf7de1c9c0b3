"""Tests of `cranedyn.lifts.sites`."""
