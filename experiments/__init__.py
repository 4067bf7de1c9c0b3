"""One claim each: run with ``python -m experiments.NAME``."""

import os

# Matrices of a crane are so small that threads of OpenBLAS cost far more than they share.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
