"""Tests of `cranedyn.sites`."""
