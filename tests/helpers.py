"""What several test modules share."""

from __future__ import annotations

import importlib.util
import math
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.equations_of_motion import prescribed_acceleration
from cranedyn.dynamics.integrators import Acceleration, Add, Integrator
from cranedyn.errors import CraneError
from cranedyn.interfaces import EngineName, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate

ROOT = Path(__file__).parents[1]
"""Where the repository is."""

G = 9.81
"""Gravity of the closed forms [m/s²], so that none of them meets the default by chance."""


@cache
def _loaded(**values: float) -> Crane | CraneError:
    try:
        return load_crane(gravity=G, **values)
    except CraneError as error:
        return error


def crane(**values: float) -> Crane:
    """The crane with some numbers changed, in the gravity of the closed forms; loaded, or refused,
    once a session.
    """
    found = _loaded(**values)
    if isinstance(found, CraneError):
        raise found
    return found


def big_crane(**values: float) -> Crane:
    """A point load on a massless, frictionless rope, with a jib and a hook path as long as those of
    real cranes.
    """
    point = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}
    return crane(**point, trolley_max=80.0, hoist_max=60.0, pivot_height=90.0, **values)


def locked(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
    """Drives of prescribed motion that do not accelerate."""
    return np.zeros(3)


def _explicit_euler(
    acceleration: Acceleration, faster: Add, further: Add, q: Any, v: Any, steps: int
) -> tuple[Any, Any]:
    for _ in range(steps):
        acceleration_before = acceleration(q, v)
        q = further(q, v)
        v = faster(v, acceleration_before)
    return q, v


EXPLICIT_EULER = Integrator("explicit Euler", _explicit_euler, lead=-0.5)
"""A stepping rule that no module of cranedyn has."""


def constant(*command: float) -> Callable[[float, State, Setpoint], np.ndarray]:
    """A controller with one answer."""
    return lambda t, state, setpoint: np.array(command, dtype=float)


def flow(
    crane: Crane,
    start: State,
    times: np.ndarray,
    drive: Callable[[float], np.ndarray] | None = None,
    acceleration: Callable[[State], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates at given times, shape (times, n) each, under accelerations of the state
    or else under prescribed drive accelerations; by DOP853 to 1e-10.
    """
    n = crane.layout.n
    m = crane.layout.m

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        state = State(y[:n], y[n:])
        if acceleration is not None:
            return np.concatenate([state.v, acceleration(state)])
        given = np.zeros(m) if drive is None else drive(t)
        return np.concatenate([state.v, prescribed_acceleration(crane, state, given)[0]])

    span = (0.0, times[-1])
    exact = dict(rtol=1e-10, atol=1e-12, max_step=0.5)
    y = solve_ivp(rates, span, np.concatenate(start), "DOP853", times, **exact).y.T
    return y[:, :n], y[:, n:]


def alike_in_both_engines(crane: Crane, controller: Any, **how: Any) -> Trajectory:
    """Return a run by Pinocchio; assert that compiled code moves the crane alike."""
    plain, compiled = (
        simulate(crane, controller, engine=engine, **how) for engine in ("pinocchio", "compiled")
    )
    for name in ("q", "v", "effort", "energy"):
        one = getattr(plain, name)
        assert np.abs(one - getattr(compiled, name)).max() < 1e-9 * np.abs(one).max()
    return plain


def extrapolated(run: Callable[[float], np.ndarray | float], dt: float) -> np.ndarray:
    """The limit dt → 0 of a quantity with an error of order dt, from dt, dt/2, dt/4; what is left
    is of order dt³.
    """
    one, two, four = (np.asarray(run(dt / n)) for n in (1, 2, 4))
    return (one - 6.0 * two + 8.0 * four) / 3.0


def moved(
    crane: Crane,
    start: State,
    duration: float,
    dt: float,
    controller: Callable = locked,
    period: float | None = None,
) -> Trajectory:
    """A run with drives of prescribed motion."""
    clock = dict(duration=duration, dt=dt, control_period=period or dt)
    return simulate(crane, controller, start=start, drive="motion", **clock)


FAST: EngineName = "compiled" if importlib.util.find_spec("llvmlite") else "pinocchio"
"""The engine for long runs of which it is not the subject."""

quickly = partial(simulate, engine=FAST)
"""A run of which the engine is not the subject."""


def turned(old: str, new: str, text: str) -> str:
    """Text with one thing replaced that must be there exactly once."""
    assert text.count(old) == 1, f"{old!r} occurs {text.count(old)} times"
    return text.replace(old, new)


def python(
    script: str, *arguments: object, timeout: float = 300.0
) -> subprocess.CompletedProcess[str]:
    """A script in a process of its own, in the root of the repository."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=timeout, cwd=ROOT, check=False
    )


def within(seconds: float, holds: Callable[[], object]) -> bool:
    """Whether it comes to hold before this process has had the processor for so long [s], in which
    it does not sleep: others have had as much, however busy the machine is.
    """
    end = time.process_time() + seconds
    while not holds():
        if time.process_time() > end:
            return False
    return True


def long_after(count: int, values: Sequence[Any]) -> list[Any]:
    """Return parameters of a test of which the first ones are in the default run. The others, which
    repeat the same claim, are marked long.
    """
    others = [
        pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.long)
        for value in values[count:]
    ]
    return [*values[:count], *others]


def pickled(value: Any) -> Any:
    """A value after a way through bytes, as to another process."""
    return pickle.loads(pickle.dumps(value))


def files(folder: Path) -> list[str]:
    """Everything below a folder."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def pendulum_period(length: float, gravity: float, amplitude: float = 0.0) -> float:
    """Gauss: 2π√(l/g) / AGM(1, cos(A/2)), by the arithmetic-geometric mean itself."""
    arithmetic = 1.0
    geometric = math.cos(amplitude / 2.0)
    for _ in range(8):
        sum_before = arithmetic + geometric
        geometric = math.sqrt(arithmetic * geometric)
        arithmetic = sum_before / 2.0
    return 2.0 * math.pi * math.sqrt(length / gravity) / arithmetic


def _vector(*ranges: tuple[float, float]) -> st.SearchStrategy[np.ndarray]:
    return st.tuples(*(st.floats(low, high) for low, high in ranges)).map(np.array)


states = st.builds(
    State,
    _vector((-3, 3), (2, 22), (-1.2, 1.2), (-1.2, 1.2), (3.4, 26.4)),
    _vector((-0.5, 0.5), (-2, 2), (-0.5, 0.5), (-0.5, 0.5), (-2, 2)),
)
"""Any state in the ranges of the crane, swings up to 69°."""

efforts = _vector((-1e5, 1e5), (-1e4, 1e4), (-2e4, 0))
"""Slew torque [N m], trolley and hoist force [N]."""

accelerations = _vector((-0.2, 0.2), (-1, 1), (-1, 1))
"""Of slew, trolley and hoist."""


RESULT: dict[str, Any] = {
    "experiment": "a1", "about": "", "command": "", "claims": [], "parameters": {}, "figures": [],
    "files": {}, "versions": {}, "machine": "",
    "tables": [{"title": "t", "columns": ["c"], "formats": [".1f"], "rows": [[1.0]], "note": ""}],
}  # fmt: skip
"""What an experiment writes as `result.json` where nothing was run."""

HOSTILE_NAMES = (
    "{{kernel}}",
    "{{ marks }}",
    "{% include 'document.html' %}",
    r"$\frac$",
    "$5 or $6",
    "<img src=x onerror=alert(1)>",
    "</title></script><script>alert(1)</script>",
    "\"'><b>&amp;",
)
"""Names that are placeholders, formulas or elements to whoever does not take them for data."""
