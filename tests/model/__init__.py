"""Tests of cranes and what they are read from."""
