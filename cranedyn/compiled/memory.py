"""The memory of many cranes, arranged in groups of lanes."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from cranedyn.compiled.kernel import Kernel
from cranedyn.compiled.layout import Call

_PARTS = 8
"""Parts into which the groups are divided for each thread, so that none waits long for the last."""


def grouped(rows: np.ndarray, lanes: int) -> np.ndarray:
    """From one row for each crane, shape (n, m), to groups of lanes, shape (groups, m, lanes); the last crane fills the last group."""
    groups = -(-len(rows) // lanes)
    whole = np.concatenate([rows, rows[-1:].repeat(groups * lanes - len(rows), axis=0)])
    return np.ascontiguousarray(whole.reshape(groups, lanes, -1).transpose(0, 2, 1))


def ungrouped(groups: np.ndarray, count: int) -> np.ndarray:
    """From groups of lanes back to one row for each crane, shape (count, m)."""
    return groups.transpose(0, 2, 1).reshape(groups.shape[0] * groups.shape[2], groups.shape[1])[:count]


def run(code: Kernel, memory: dict[str, np.ndarray], threads: int | None, **common: np.ndarray | float) -> None:
    """Run code over groups of lanes.

    Args:
        code: The code.
        memory: What belongs to each group, by the names of a `Call`, the group first.
        threads: How many; None for one for each processor.
        common: What all groups have in common.
    """
    groups = len(memory["state"])
    workers = min(threads or len(os.sched_getaffinity(0)), groups)
    share = max(1, groups // (workers * _PARTS))

    def work(first: int) -> None:
        call = Call(**common)
        for group in range(first, min(first + share, groups)):
            code.run(call.set(**{name: part[group] for name, part in memory.items()}).address)

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(0, groups, share)))
