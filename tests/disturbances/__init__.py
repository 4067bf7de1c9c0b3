"""Tests of wind and forces."""
