"""Tests of virtual commissioning."""
