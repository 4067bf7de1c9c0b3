"""Worker processes of an experiment: what they import, and what comes of one that is ended from
outside.
"""

from __future__ import annotations

import pytest

from tests.helpers import python

_SUBMIT = """
import os, signal, sys
from concurrent.futures import as_completed
from cranedyn.command import command
from experiments.harness.processes import processes
from tests import studies

CALLS = {
    "killed while it computes": (signal.raise_signal, signal.SIGKILL),
    "killed while it sends its result": (studies.killed_while_sending,),
}

def main():
    with processes(2) as workers:
        killed = workers.submit(*CALLS[sys.argv[1]])
        others = [workers.submit(studies.deaf, 100) for _ in range(3)]
        for _ in as_completed([killed, *others]):
            pass
    print(killed.result())
    return 0

sys.exit(command(main))
"""


@pytest.mark.slow
@pytest.mark.parametrize("what", ["killed while it computes", "killed while it sends its result"])
def test_a_process_that_is_killed_ends_the_experiment_at_once_with_a_sentence(what: str) -> None:
    run = python(_SUBMIT, what, timeout=60.0)
    assert run.stderr == (
        "error: A process of the experiment was ended from outside; what it had done is lost.\n"
    )
    assert run.returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize("module", ["experiments.compare.runs", "experiments.sweep.sweep_study"])
def test_what_workers_compute_with_imports_nothing_that_draws_or_tabulates(module: str) -> None:
    program = (
        f"import sys; import {module}; "
        "print([name for name in ('matplotlib', 'rerun', 'scipy.stats') if name in sys.modules])"
    )
    run = python(program)
    assert (run.stdout, run.stderr) == ("[]\n", "")
