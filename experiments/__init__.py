"""One claim each: run with ``python -m experiments.NAME``."""

import os
from contextlib import suppress

# Matrices of a crane are so small that threads of OpenBLAS cost far more than they share.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Figures go to files, for which any backend will do, but matplotlib is not imported at all where
# this variable names one that it lacks.
if _backend := os.environ.pop("MPLBACKEND", ""):
    import matplotlib as mpl

    os.environ["MPLBACKEND"] = _backend
    with suppress(ValueError):
        mpl.rcParams["backend"] = _backend
