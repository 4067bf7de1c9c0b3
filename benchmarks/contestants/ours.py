"""The ways of this project."""

from __future__ import annotations

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, plain


def _loop(case: Case) -> Run:
    def run(starts: np.ndarray, duration: float) -> Result:
        return plain(case, starts[0], duration)

    return run


PLAIN = Contestant("plain loop", lambda: None, _loop)
"""Every ratio is to this one."""

CONTESTANTS = (PLAIN,)
