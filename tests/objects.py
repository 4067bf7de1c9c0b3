"""What is made once and shared by all processes of a test run, and by later runs.

Half of the processor time of the tests of compiled code is LLVM's, and most of what it translates
it has translated before, in another process: each worker and each mutation compiles the same loops.
So all processes keep their files in one folder, see `cranedyn.data.kept_files`. Whatever changes
the code that is made, such as a mutation, changes the name of its file. The folder also has what
tests make once by themselves.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Callable
from pathlib import Path

FOLDER = "CRANEDYN_TEST_OBJECTS"
"""Name of the environment variable with the folder that the processes share."""


UNUSED_DAYS = 30.0
"""Days after which a file that no run has used is forgotten."""


def forget_unused(folder: Path) -> None:
    """Remove the files of a shared folder that no run has used for `UNUSED_DAYS`."""
    last = time.time() - 86400.0 * UNUSED_DAYS
    for file in folder.iterdir():
        # Another run may remove it at the same time.
        with contextlib.suppress(FileNotFoundError):
            if file.stat().st_mtime < last:
                file.unlink()


def made_once(name: str, make: Callable[[Path], object]) -> Path:
    """Return a file of the shared folder; make it if no process has made it yet.

    Args:
        name: Name of the file.
        make: Writes the file.
    """
    file = Path(os.environ[FOLDER], name)
    with open(f"{file}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not file.exists():
            draft = Path(f"{file}.draft")
            make(draft)
            draft.replace(file)
    file.touch()
    return file
