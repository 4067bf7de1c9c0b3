"""Factors of the standards: their formulas, the mechanics under them, and what control needs."""
