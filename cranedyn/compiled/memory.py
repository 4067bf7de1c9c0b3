"""Memory of many cranes, arranged in groups of lanes."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from cranedyn.compiled.binding import Loop

_PARTS = 8
"""Chunks of groups for each thread, so that threads end at about the same time."""


def group_lanes(arrays: Sequence[np.ndarray], lanes: int, kind: type = np.float64) -> np.ndarray:
    """Arrange arrays with a row for each crane, shape (n, m) each, in groups of lanes, shape
    (groups, all m, lanes).

    The last crane fills the last group.
    """
    groups = np.empty(
        (-(-len(arrays[0]) // lanes), sum(array.shape[1] for array in arrays), lanes), dtype=kind
    )
    first = 0
    for array in arrays:
        for lane in range(lanes):
            target, rows = groups[:, first : first + array.shape[1], lane], array[lane::lanes]
            target[: len(rows)], target[len(rows) :] = rows, array[-1]
        first += array.shape[1]
    return groups


def ungroup_lanes(groups: np.ndarray, count: int) -> np.ndarray:
    """Return groups of lanes as one row for each crane, shape (count, m)."""
    return groups.transpose(0, 2, 1).reshape(groups.shape[0] * groups.shape[2], groups.shape[1])[
        :count
    ]


def run(loop: Loop, threads: int | None) -> None:
    """Run a loop over all its groups of lanes.

    Args:
        loop: The loop.
        threads: Number of threads; None for one for each processor.

    Raises:
        KeyboardInterrupt: After Ctrl-C, as soon as every thread has ended its piece.
    """
    groups = len(loop)
    workers = min(threads or len(os.sched_getaffinity(0)), groups)
    share = max(1, groups // (workers * _PARTS))
    ended = threading.Event()

    def work(first: int) -> None:
        loop.run_groups(range(first, min(first + share, groups)), ended.is_set)

    with ThreadPoolExecutor(workers) as pool:
        try:
            list(pool.map(work, range(0, groups, share)))
        finally:
            ended.set()
