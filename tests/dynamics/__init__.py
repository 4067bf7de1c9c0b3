"""Tests of what a state of a crane leads to."""
