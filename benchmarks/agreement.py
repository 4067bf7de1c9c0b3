"""Whether a contestant runs the same physics: its trajectories against those of the plain loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, plain
from experiments.harness.outcome import ResultTable

ALLOWED = 1e-9
"""Largest difference with which a contestant is shown: of a coordinate or rate [rad, m, per
second], and of an effort as a share of its limit.

Rounding makes a hundred-thousandth of that. Swing damping of 1 N m s/rad that is taken at another
time in the step makes 0.4 of it.
"""

STRETCH = 2.0
"""Length of the common stretch [s]."""

CRANES = 19
"""Number of cranes that run together on it; no multiple of the length of any vector."""


@dataclass(frozen=True)
class Ready:
    """A contestant that agrees with the plain loop.

    Attributes:
        contestant: The contestant.
        run: Function that runs the case its way.
        max_deviation: Its largest difference from the plain loop, counted as in `ALLOWED`.
    """

    contestant: Contestant
    run: Run
    max_deviation: float


class Truth:
    """The plain loop over the common stretch, from every start."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._starts = case.starts(CRANES)
        self._results = [plain(case, start, STRETCH) for start in self._starts]

    def max_deviation(self, run: Run, *, many: bool) -> float:
        """Return the largest deviation of a contestant, in the units of `ALLOWED`.

        Many cranes are compared at the end and in their largest swings, single ones in their whole
        logs from the first and the last start.

        Args:
            run: Function that runs the case.
            many: Whether it runs many cranes at once.
        """
        if many:
            got = run(self._starts, STRETCH)
            ends = np.concatenate([result.ends for result in self._results])
            peaks = np.concatenate([result.peaks for result in self._results])
            return max(_largest(got.ends, ends), _largest(got.peaks, peaks))
        deviations = []
        for i in (0, -1):
            got = run(self._starts[i][None], STRETCH)
            deviations.append(self._of_log(got, self._results[i]))
        return max(deviations)

    def _of_log(self, got: Result, expected: Result) -> float:
        scale = np.concatenate([np.ones(2 * self._case.n), self._case.crane.effort_limit])
        if got.log is None or expected.log is None:
            return np.inf
        return max(
            _largest(got.log() / scale, expected.log() / scale),
            _largest(got.ends, expected.ends),
            _largest(got.peaks, expected.peaks),
        )


def _largest(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest difference; infinite where shapes differ or a value is not finite."""
    if a.shape != b.shape:
        return np.inf
    return float(np.nan_to_num(np.abs(a - b), nan=np.inf).max())


def sort(
    case: Case, contestants: Sequence[Contestant]
) -> tuple[list[Ready], list[tuple[str, str]]]:
    """Return the contestants that agree with the plain loop, and the names of the others with the
    reason.
    """
    truth = Truth(case)
    ready = []
    refused = []
    for contestant in contestants:
        reason = contestant.missing()
        if reason:
            refused.append((contestant.name, reason))
            continue
        try:
            run = contestant.prepare(case)
            deviation = truth.max_deviation(run, many=contestant.many)
        # Engines fail each in its own way, and one of them must not end the others.
        except Exception as error:
            line = next(iter(str(error).splitlines()), "")
            refused.append((contestant.name, f"it fails: {type(error).__name__}: {line}"))
            continue
        if deviation <= ALLOWED:
            ready.append(Ready(contestant, run, deviation))
        else:
            off = f"it is {deviation:.1e} off the plain loop after {STRETCH:g} s, more"
            refused.append((contestant.name, f"{off} than {ALLOWED:g}"))
    return ready, refused


def refused_table(refused: Sequence[tuple[str, str]]) -> list[ResultTable]:
    """Return the table of contestants that are not shown, if there are any."""
    columns = (("strategy", ""), ("why", ""))
    return [ResultTable("Not shown", columns, refused)] if refused else []
