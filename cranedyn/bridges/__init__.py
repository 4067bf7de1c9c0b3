"""Doors to other people's tools, each one file and one extra."""
