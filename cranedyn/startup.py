"""What Ctrl-C does while a command's modules are imported."""

from __future__ import annotations

import signal
import sys


def end_on_interrupt(package: str) -> None:
    """Let Ctrl-C end the process without a traceback, until `cranedyn.command` takes over.

    Nothing is changed unless the program is ``python -m`` with a module of that package: while
    Python looks for it, "-m" stands in its place in `sys.argv`.

    Args:
        package: Name of the package that calls.
    """
    run = sys.orig_argv[-len(sys.argv)].removeprefix("-m") if sys.argv[0] == "-m" else ""
    if (
        run.split(".")[0] == package
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    ):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
