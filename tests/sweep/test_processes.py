"""Worker processes end within two seconds of whoever started them, even in native code that keeps
Python's lock.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import ROOT
from tests.sweep.test_sweep_interrupted import gone, ran, until

pytestmark = [
    pytest.mark.usefixtures("limited"),
    pytest.mark.skipif(not Path("/proc/self").exists(), reason="processes are looked up in /proc"),
]

_SWEEP = """
import sys
from cranedyn.sweep import grid, sweep
from tests import studies

if __name__ == "__main__":
    sweep(studies.stuck, grid(x=[3.0, 3.0]), sys.argv[1], chunk=1, workers=2)
"""

_COMPARE = """
from experiments.compare.runs import processes
from tests.studies import deaf

if __name__ == "__main__":
    with processes(1) as workers:
        workers.submit(deaf, 100).result()
"""


@pytest.mark.parametrize(
    ("script", "workers"), [(_SWEEP, 2), (_COMPARE, 1)], ids=["sweep", "compare"]
)
def test_no_worker_outlives_a_killed_parent_by_two_seconds(
    script: str, workers: int, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    (tmp_path / "stuck.py").write_text(script)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "stuck.py"), str(tmp_path / "sweep")],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT), "SWEEP_LOG": str(log)},
        start_new_session=True,
    )
    try:
        until(lambda: len(ran(log)[1]) == workers)
        process.kill()
        process.wait(10)
        until(lambda: gone(ran(log)[1]), 2.0)
    finally:
        for pid in ran(log)[1]:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
