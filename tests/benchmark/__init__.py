"""Tests of the benchmark of crane control."""
