"""Tests of trajectories, files and tables."""
