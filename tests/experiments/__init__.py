"""Tests of the experiments, as a user runs them."""
