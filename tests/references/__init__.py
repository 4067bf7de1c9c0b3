"""Tests of where drives and payload should be."""
