"""Tests of planned, judged and simulated lifts."""
