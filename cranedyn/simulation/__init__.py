"""The plain loop, its clocks, its log, and what computes a step."""
