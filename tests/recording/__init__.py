"""Tests of recordings and viewers."""
