"""The ways of this project."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.workload import Case, Contestant, Result, Run, plain
from cranedyn.dynamics.integrators import Integrator, semi_implicit_euler
from cranedyn.interfaces import Setpoint, State


def _no_need() -> None:
    """Return None: it is always installed."""


def _llvm() -> str | None:
    """Return why nothing can be compiled here, None if it can."""
    try:
        import llvmlite  # noqa: F401
    except ModuleNotFoundError:
        return "llvmlite is not installed: pip install 'cranedyn[compiled]'"
    return None


def _loop(case: Case) -> Run:
    """Return a run of one crane in the plain loop."""

    def run(starts: np.ndarray, duration: float) -> Result:
        return plain(case, starts[0], duration)

    return run


def _stepping(case: Case) -> Run:
    """Return a run with steps compiled and control in Python: the engine does not look into a
    `partial`, and so cannot compile the controller.
    """
    return _compiled(case, partial(case.controller))


def _closed(case: Case) -> Run:
    """Return a run with control and steps compiled."""
    return _compiled(case, case.controller)


def _compiled(case: Case, controller: Callable[[float, State, Setpoint], np.ndarray]) -> Run:
    """Return a run of one crane by the compiled engine, which has compiled what it needs."""

    def run(starts: np.ndarray, duration: float) -> Result:
        return plain(case, starts[0], duration, controller=controller, engine="compiled")

    run(case.starts(1), case.period)
    return run


def _batch(
    threads: int | None, integrator: Integrator = semi_implicit_euler
) -> Callable[[Case], Run]:
    """Return a run of eight cranes in a vector, with control and steps compiled."""

    def prepare(case: Case) -> Run:
        from cranedyn.compiled.batch import simulate_batch

        def run(starts: np.ndarray, duration: float) -> Result:
            q, v = np.split(starts, 2, axis=1)
            batch = simulate_batch(
                case.crane,
                case.controller,
                start=State(q, v),
                duration=duration,
                dt=case.dt,
                control_period=case.period,
                threads=threads,
                integrator=integrator,
            )
            return Result(np.hstack(batch.end), batch.peak_swing)

        run(case.starts(1), case.period)
        return run

    return prepare


PLAIN = Contestant("plain loop", _no_need, _loop, any_crane=True)
"""Every ratio is to this one."""

CONTESTANTS = (
    PLAIN,
    Contestant("Python controller, compiled steps", _llvm, _stepping, any_crane=True),
    Contestant("compiled closed loop", _llvm, _closed, any_crane=True),
    Contestant("compiled batch, 1 thread", _llvm, _batch(1), many=True, any_crane=True),
    Contestant("compiled batch, all cores", _llvm, _batch(None), many=True, any_crane=True),
)
