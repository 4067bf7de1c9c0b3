"""A tower-crane dynamics laboratory: one xacro URDF, Pinocchio, a plain loop, and every number explained."""

import signal
import sys

# As in the package of the experiments: Ctrl-C before "python -m cranedyn.model.description" has begun ends it at once.
if sys.argv[:1] == ["-m"] and any(word.startswith("cranedyn.") for word in sys.orig_argv):
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
