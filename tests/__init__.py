"""Tests: each name is a claim, each tolerance says where it comes from."""
