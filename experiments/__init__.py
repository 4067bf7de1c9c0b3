"""One claim each: run with ``python -m experiments.NAME``."""

import signal
import sys

# While Python locates the module of "python -m", argv[0] is "-m": Ctrl-C then, before anything has begun, ends the program at once.
if sys.argv[:1] == ["-m"] and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
