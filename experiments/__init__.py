"""One claim each: run with ``python -m experiments.NAME``."""
