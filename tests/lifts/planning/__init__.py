"""Tests of planning: sites, distances, proofs, lifts."""
