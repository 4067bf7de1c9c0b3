"""Worker processes end with whoever started them, however that ended, and hear no Ctrl-C."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker

from cranedyn.command import defer_sigint

_PR_SET_PDEATHSIG = 1


def end_with_parent() -> None:
    """End this process, a spawned one of `multiprocessing`, as soon as its parent has ended; to be
    called in it, first of all.

    A thread waits for the parent. Where the thread does not get its turn, in compiled code that
    keeps Python's lock, Linux itself kills the process; it does so, too, when the thread that
    started the process ends, so that this must live as long as the process shall.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL), 0, 0, 0)
    # It is there at once if the parent has ended meanwhile.
    threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: multiprocessing.process.BaseProcess) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def deaf() -> Iterator[None]:
    """Keep Ctrl-C, which goes to all processes of a terminal, from processes that are started in
    this context: their parent ends them.
    """
    # A process of multiprocessing's own, at whose start it would unblock the signal.
    resource_tracker.ensure_running()
    # The mask is for the process that starts, which inherits it; here another thread may be given
    # the signal, and a process that is cut off before it has been told its task says so aloud.
    with defer_sigint():
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
