"""One claim each: run with ``python -m experiments.NAME``."""

import os
import signal
import sys
from contextlib import suppress

# While Python locates the module of "python -m", argv[0] is "-m": Ctrl-C then, before anything has
# begun, ends the program at once.
if sys.argv[:1] == ["-m"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)

# Matrices of a crane are so small that threads of OpenBLAS cost far more than they share.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Figures go to files, for which any backend will do, but matplotlib is not imported at all where
# this variable names one that it lacks.
if _backend := os.environ.pop("MPLBACKEND", ""):
    import matplotlib as mpl

    os.environ["MPLBACKEND"] = _backend
    with suppress(ValueError):
        mpl.rcParams["backend"] = _backend
