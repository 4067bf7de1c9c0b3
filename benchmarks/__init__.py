"""What is fast, against whom: run with ``python -m benchmarks.NAME``."""
