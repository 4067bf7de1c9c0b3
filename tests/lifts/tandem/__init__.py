"""Tests of lifts by two cranes together."""
