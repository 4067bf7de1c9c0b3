"""The double pendulum: what moves leave in each of its two modes, with designs that know the hook
and with one that does not.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.linearisation import free_modes, sampled
from cranedyn.interfaces import Controller, EngineName, Reference, Setpoint, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.planning.joystick import JoystickPulse, joystick
from cranedyn.planning.optimal import optimal
from cranedyn.references import hold
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.shaped import shaped, zv
from cranedyn.references.simple import spline
from cranedyn.simulation.simulate import simulate
from experiments.relatives.catalogue import HOOK, POINT, moved, relative_crane, rest_at
from experiments.scenarios.moves import of_sampling

WAY, LASTS = 4.0, 9.0
"""Of the trolley in the moves [m], and time for those that are given one [s]."""

NUDGE = 0.05
"""Speed of the operator's moves that are shaped [m/s]: slow, since the closed form is that of a
small swing."""

_DT, _PERIOD, _AFTER = 1e-3, 5e-3, 10.0


@dataclass(frozen=True, eq=False)
class Unaware:
    """A controller made for another crane, which sees the joints that it knows of.

    Attributes:
        controller: The controller; its drives are those of this crane.
        indices: Where the joints of its crane stand among the coordinates of this one.
    """

    controller: Controller
    indices: list[int]

    def __call__(self, t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        """Return the command, shape (m,)."""
        return self.controller(t, State(state.q[self.indices], state.v[self.indices]), setpoint)


class ModeResidual(NamedTuple):
    """What a move leaves.

    Attributes:
        strategy: How it is made.
        arrival: When the drives are there [s].
        slow, fast: Amplitude of the load's sling, or of the cable, in each mode, whichever is
            larger [rad].
        closed_slow, closed_fast: By a closed form; None without one.
        run: What happened.
    """

    strategy: str
    arrival: float
    slow: float
    fast: float
    closed_slow: float | None
    closed_fast: float | None
    run: Trajectory


def mode_amplitudes(crane: Crane, goal: State, run: Trajectory, t: float) -> tuple[float, float]:
    """Return the amplitude of the slow and of the fast mode at a time [rad], radial and tangential
    together.
    """
    modes = free_modes(crane, goal)
    row = int(np.searchsorted(run.t, t - 1e-9))
    sizes = (
        np.abs(modes.shapes).max(axis=0)
        * modes.amplitudes(run.q[row : row + 1], run.v[row : row + 1])[0]
    )
    return float(np.hypot(*sizes[:2])), float(np.hypot(*sizes[2:]))


def sampling(run: Trajectory) -> float:
    """Swing that a move may leave since efforts are held for a control period [rad], by the fast
    mode.
    """
    crane = relative_crane(HOOK)
    length = crane.gravity / float(free_modes(crane, crane.start).frequencies[-1]) ** 2
    return of_sampling(crane.gravity, length, _PERIOD, float(np.abs(run.q[:, crane.swings]).max()))


def shaping(engine: EngineName = "pinocchio") -> list[ModeResidual]:
    """Make an operator's slow move of the trolley as it is, and shaped for no, one or both
    modes.
    """
    crane = relative_crane(HOOK)
    slow, fast = theory.double_pendulum(_at(crane, "l"), 5.0, 300.0, 2000.0, crane.gravity)
    base = joystick(
        crane, crane.start, [JoystickPulse("x", NUDGE, 0.0, 3.0)], accelerations=(0.05, 0.5, 0.3)
    )
    one_cable = 2.0 * np.pi / float(theory.point_period(_at(crane, "l") + 5.0, crane.gravity))
    plans: dict[str, tuple[float, ...]] = {
        "operator": (),
        "ZV for a load on one cable of 20 m": (one_cable,),
        "ZV for the slow mode": (slow,),
        "ZV for both modes": (slow, fast),
    }
    results: list[ModeResidual] = []
    for name, modes in plans.items():
        reference = shaped(base, zv(), [2.0 * np.pi / mode for mode in modes]) if modes else base
        end = _whole(3.0 + NUDGE / 0.5 + sum(np.pi / mode for mode in modes))
        drives: Any = {"drive": "motion", "engine": engine}
        run = _run(crane, follow(crane, reference, _PERIOD), reference, end + 0.5, **drives)
        goal = rest_at(crane, x=float(run["x_m"][-1]))
        amounts = mode_amplitudes(crane, goal, run, end)
        closed: list[float | None] = [None, None]
        if results:
            closed = [
                theory.convolved_zv(mode, modes) * alone
                for mode, alone in zip((slow, fast), results[0][2:4], strict=True)
            ]
        results.append(ModeResidual(name, end, amounts[0], amounts[1], closed[0], closed[1], run))
    return results


def trolley_moves(engine: EngineName = "pinocchio") -> Iterator[ModeResidual]:
    """Move the trolley by four metres, with the whole model, and with that of a load on one
    cable.
    """
    crane, simple = relative_crane(HOOK), one_pendulum()
    indices = [crane.layout.index(symbol) for symbol in simple.layout.symbols]
    for name, designed, motion in (
        ("spline, LQR of the whole model", crane, _spline(crane)),
        ("least time, LQR of the whole model", crane, _fastest(crane)),
        ("spline, five-joint LQR", simple, _spline(simple)),
        ("least time, five-joint LQR", simple, _fastest(simple)),
    ):
        tracking = lqr(designed, motion, dt=_DT)
        controller = tracking if designed is crane else Unaware(tracking, indices)
        # Of the drives, which both cranes have; the motion itself is of one crane.
        setpoints = motion.__call__
        run = _run(crane, controller, setpoints, _whole(motion.arrival + _AFTER), engine=engine)
        slow, fast = mode_amplitudes(
            crane, rest_at(crane, x=_at(crane, "x") + WAY), run, motion.arrival
        )
        yield ModeResidual(name, motion.arrival, slow, fast, None, None, run)


def one_pendulum() -> Crane:
    """Return the tower crane of a designer who does not know of the hook: all the mass at the
    hoist's end.
    """
    return load_crane(payload_mass=2300.0, **POINT)


def closed_loop_growth() -> tuple[float, float]:
    """Return the largest growth rate of the closed loops at rest [1/s]: LQR of the whole model, and
    of five joints on the crane with the hook.
    """
    crane, simple = relative_crane(HOOK), one_pendulum()
    loop = sampled(crane, crane.start, dt=_DT, control_period=_PERIOD)
    indices = [crane.layout.index(symbol) for symbol in simple.layout.symbols]
    n = crane.layout.n
    gain = np.zeros((crane.layout.m, 2 * n))
    gain[:, [*indices, *(n + i for i in indices)]] = _regulator(simple).gain[-1]
    radii = (
        np.abs(np.linalg.eigvals(loop.closed(gain_matrix))).max()
        for gain_matrix in (_regulator(crane).gain[-1], gain)
    )
    aware, unaware = (float(np.log(radius) / _PERIOD) for radius in radii)
    return aware, unaware


def stirred(engine: EngineName = "pinocchio") -> float:
    """Return the growth rate of the fast mode in a run under the LQR of five joints [1/s], from a
    small swing of the sling across the jib.
    """
    crane, simple = relative_crane(HOOK), one_pendulum()
    indices = [crane.layout.index(symbol) for symbol in simple.layout.symbols]
    start = moved(crane, sling_tangential=1e-3)
    controller = Unaware(_regulator(simple), indices)
    run = _run(crane, controller, None, 30.0, start=start, engine=engine)
    later = run.since(15.0)
    fast = np.hypot(*free_modes(crane, crane.start).amplitudes(later.q, later.v)[:, 2:].T)
    return float(np.polyfit(later.t, np.log(fast), 1)[0])


def _regulator(crane: Crane) -> Tracking:
    return lqr(
        crane, hanging_reference(crane, hold(crane, crane.start), 2 * _PERIOD, _PERIOD), dt=_DT
    )


def _spline(crane: Crane) -> Motion:
    goal = crane.start.q[crane.layout.drives] + WAY * crane.layout.along("x")
    return hanging_reference(crane, spline(crane, crane.start, [goal], [LASTS]), LASTS, _PERIOD)


def _fastest(crane: Crane) -> Motion:
    goal = rest_at(crane, x=_at(crane, "x") + WAY)
    return optimal(
        crane, crane.start, goal, HOOK.limits, ramp=1.0, still=["gamma", "l"], period=_PERIOD
    )


def _run(
    crane: Crane,
    controller: Controller,
    reference: Reference | None,
    duration: float,
    **options: Any,
) -> Trajectory:
    return simulate(
        crane, controller, reference, duration=duration, dt=_DT, control_period=_PERIOD, **options
    )


def _at(crane: Crane, symbol: str) -> float:
    return float(crane.start.q[crane.layout.index(symbol)])


def _whole(duration: float) -> float:
    return _PERIOD * float(np.ceil(duration / _PERIOD - 1e-9))
