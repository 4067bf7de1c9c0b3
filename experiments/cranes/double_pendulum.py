"""The double pendulum: what moves leave in each of its two modes, with designs that know the hook
and with one that does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.controllers.lqr import lqr
from cranedyn.controllers.tracking import Tracking
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.linearisation import free_modes, sampled
from cranedyn.interfaces import Controller, EngineName, Setpoint, State
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.lifts.planning.optimal import optimal
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.references import hold
from cranedyn.references.motion import Motion, hanging_reference
from cranedyn.references.shaped import shaped, zv
from cranedyn.references.simple import spline
from cranedyn.simulation.simulate import simulate
from experiments.cranes.control_of_variants import SWING_TOLERANCE
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import (
    HOOK,
    POINT,
    at_start,
    moved,
    rest_at,
    variant_crane,
)
from experiments.scenarios.moves import instant, sampling_swing

TRAVEL = 4.0
"""Distance that the trolley moves [m]."""

DURATION = 9.0
"""Duration of a move by a spline [s]; the others take the time that they need."""

NUDGE = 0.05
"""Speed of the operator's moves that are shaped [m/s]: slow, since the closed form is that of a
small swing."""

STEP = 1e-3
"""Physics step [s]."""

PERIOD = 5e-3
"""Time between control instants [s]."""

WATCH_TIME = 10.0
"""Time for which a move is watched after its arrival [s]."""

CLOCKS: dict[str, Any] = {"dt": STEP, "control_period": PERIOD}
"""Both clocks, as functions that run a crane take them."""


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
    """Swing that a move leaves in each mode.

    Attributes:
        strategy: How the move is made.
        arrival: Time at which the drives arrive [s].
        slow: Amplitude of the slow mode: that of the sling or of the cable, whichever is larger
            [rad].
        fast: Amplitude of the fast mode likewise [rad].
        run: The run.
        closed: Both amplitudes in closed form, the slow one first [rad]; None without one.
    """

    strategy: str
    arrival: float
    slow: float
    fast: float
    run: Trajectory
    closed: tuple[float, float] | None = None


def study(setup: Setup) -> Outcome:
    """Make the moves, and compare closed loops that know of the hook and that do not."""
    shaped = _shaping(setup.engine_of_runs)
    moves = list(_trolley_moves(setup.engine_of_runs))
    growth = _closed_loop_growth()
    growth_in_run = _stirred(setup.engine_of_runs)
    note = f"Trolley at {NUDGE:g} m/s; closed: by the swing that the move leaves unshaped."
    return Outcome(
        [
            _table("Double pendulum: shaped moves of an operator", shaped, note),
            _table(f"Double pendulum: {TRAVEL:g} m of the trolley", moves, _unaware_note(growth)),
        ],
        _claims(shaped, moves, growth, growth_in_run),
        trajectories={"double_pendulum_unaware": moves[-1].run},
    )


def _amplitudes(crane: Crane, goal: State, run: Trajectory, t: float) -> tuple[float, float]:
    """Return the amplitude of the slow and of the fast mode at a time [rad], radial and tangential
    together.

    Args:
        crane: The crane with the hook.
        goal: State of rest about which the modes swing.
        run: The run.
        t: The time [s].
    """
    modes = free_modes(crane, goal)
    q, v = run.state(int(np.searchsorted(run.t, t - 1e-9)))
    # Modes come in the order of their frequencies: two slow ones, then two fast ones.
    sizes = np.abs(modes.shapes).max(axis=0) * modes.amplitudes(q[None], v[None])[0]
    slow = np.hypot(sizes[0], sizes[1])
    fast = np.hypot(sizes[2], sizes[3])
    return float(slow), float(fast)


def _shaping(engine: EngineName | None) -> list[ModeResidual]:
    """Make an operator's slow move of the trolley as it is, and shaped for no, one or both
    modes.
    """
    crane = variant_crane(HOOK)
    slow, fast = theory.double_pendulum(at_start(crane, "l"), 5.0, 300.0, 2000.0, crane.gravity)
    nudge = [JoystickPulse("x", NUDGE, 0.0, 3.0)]
    base = joystick(crane, crane.start, nudge, accelerations=(0.05, 0.5, 0.3))
    one_cable = 2.0 * np.pi / float(theory.point_period(at_start(crane, "l") + 5.0, crane.gravity))
    plans: dict[str, tuple[float, ...]] = {
        "operator": (),
        "ZV for a load on one cable of 20 m": (one_cable,),
        "ZV for the slow mode": (slow,),
        "ZV for both modes": (slow, fast),
    }
    results: list[ModeResidual] = []
    for name, modes in plans.items():
        reference = shaped(base, zv(), [2.0 * np.pi / mode for mode in modes]) if modes else base
        end = instant(3.0 + NUDGE / 0.5 + sum(np.pi / mode for mode in modes), PERIOD)
        run = simulate(
            crane,
            follow(crane, reference, PERIOD),
            reference,
            duration=end + 0.5,
            drive="motion",
            engine=engine,
            **CLOCKS,
        )
        amplitudes = _amplitudes(crane, rest_at(crane, x=float(run["x_m"][-1])), run, end)
        results.append(ModeResidual(name, end, *amplitudes, run))
        if modes:
            remains = [theory.convolved_zv(mode, modes) for mode in (slow, fast)]
            closed = remains[0] * results[0].slow, remains[1] * results[0].fast
            results[-1] = results[-1]._replace(closed=closed)
    return results


def _trolley_moves(engine: EngineName | None) -> Iterator[ModeResidual]:
    """Move the trolley by four metres, with the whole model, and with that of a load on one
    cable.
    """
    crane = variant_crane(HOOK)
    simple = _one_pendulum()
    joints = crane.layout.at(*simple.layout.symbols)
    goal = rest_at(crane, x=at_start(crane, "x") + TRAVEL)
    for name, designed, motion in (
        ("spline, LQR of the whole model", crane, _spline(crane)),
        ("least time, LQR of the whole model", crane, _fastest(crane)),
        ("spline, five-joint LQR", simple, _spline(simple)),
        ("least time, five-joint LQR", simple, _fastest(simple)),
    ):
        tracking = lqr(designed, motion, dt=STEP)
        run = simulate(
            crane,
            tracking if designed is crane else Unaware(tracking, joints),
            motion.__call__,  # of the drives, which both cranes have
            duration=instant(motion.arrival + WATCH_TIME, PERIOD),
            engine=engine,
            **CLOCKS,
        )
        amplitudes = _amplitudes(crane, goal, run, motion.arrival)
        yield ModeResidual(name, motion.arrival, *amplitudes, run)


def _one_pendulum() -> Crane:
    """Return the tower crane of a designer who does not know of the hook: all the mass at the
    hoist's end.
    """
    return load_crane(payload_mass=2300.0, **POINT)


class ClosedLoopGrowth(NamedTuple):
    """Largest growth rates of closed loops on the crane with the hook, at rest [1/s].

    Attributes:
        aware: Under the LQR of the whole model.
        unaware: Under the LQR of the five joints of a crane without the hook.
    """

    aware: float
    unaware: float


def _closed_loop_growth() -> ClosedLoopGrowth:
    """Return the growth rates of the LQR that knows the hook and of the one that does not."""
    crane = variant_crane(HOOK)
    simple = _one_pendulum()
    loop = sampled(crane, crane.start, **CLOCKS)
    # The gain of five joints, in the columns that these joints have in the whole model.
    indices = crane.layout.at(*simple.layout.symbols)
    n = crane.layout.n
    gain_of_five = np.zeros((crane.layout.m, 2 * n))
    gain_of_five[:, [*indices, *(n + i for i in indices)]] = _regulator(simple).gain[-1]

    def growth(gain: np.ndarray) -> float:
        """Return the growth rate of the least damped mode."""
        eigenvalues = np.linalg.eigvals(loop.closed(gain))
        return float(np.log(np.abs(eigenvalues).max()) / PERIOD)

    return ClosedLoopGrowth(growth(_regulator(crane).gain[-1]), growth(gain_of_five))


def _stirred(engine: EngineName | None) -> float:
    """Return the growth rate of the fast mode in a run under the LQR of five joints [1/s], from a
    small swing of the sling across the jib.
    """
    crane = variant_crane(HOOK)
    simple = _one_pendulum()
    run = simulate(
        crane,
        Unaware(_regulator(simple), crane.layout.at(*simple.layout.symbols)),
        start=moved(crane, sling_tangential=1e-3),
        duration=30.0,
        engine=engine,
        **CLOCKS,
    )
    later = run.since(15.0)
    fast = np.hypot(*free_modes(crane, crane.start).amplitudes(later.q, later.v)[:, 2:].T)
    return float(np.polyfit(later.t, np.log(fast), 1)[0])


def _regulator(crane: Crane) -> Tracking:
    return lqr(
        crane, hanging_reference(crane, hold(crane, crane.start), 2 * PERIOD, PERIOD), dt=STEP
    )


def _spline(crane: Crane) -> Motion:
    goal = crane.start.q[crane.layout.drives] + TRAVEL * crane.layout.along("x")
    return hanging_reference(
        crane, spline(crane, crane.start, [goal], [DURATION]), DURATION, PERIOD
    )


def _fastest(crane: Crane) -> Motion:
    goal = rest_at(crane, x=at_start(crane, "x") + TRAVEL)
    return optimal(
        crane, crane.start, goal, HOOK.limits, ramp=1.0, still=["gamma", "l"], period=PERIOD
    )


def _table(title: str, results: Sequence[ModeResidual], note: str) -> ResultTable:
    return make_table(
        title,
        results,
        ("strategy", "", lambda r: r.strategy),
        ("arrives [s]", ".2f", lambda r: r.arrival),
        ("slow [mrad]", ".4f", lambda r: 1e3 * r.slow),
        ("closed", ".4f", lambda r: r.closed and 1e3 * r.closed[0]),
        ("fast [mrad]", ".4f", lambda r: 1e3 * r.fast),
        ("closed ", ".4f", lambda r: r.closed and 1e3 * r.closed[1]),
        ("later: slow", ".4f", lambda r: 1e3 * _later(r)[0]),
        ("fast", ".4f", lambda r: 1e3 * _later(r)[1]),
        note=note,
    )


def _later(result: ModeResidual) -> tuple[float, float]:
    """Return the amplitudes at the end of the run [rad]."""
    crane = variant_crane(HOOK)
    goal = rest_at(crane, x=float(result.run["x_setpoint_m"][-1]))
    return _amplitudes(crane, goal, result.run, float(result.run.t[-1]))


def _unaware_note(growth: ClosedLoopGrowth) -> str:
    """Return a note on designs that do not know of the hook."""
    note = (
        f"At the arrival, and {DURATION + 1:g} s later. Designs of five joints treat hook and load "
        f"as one load of 2300 kg. The slowest mode at rest decays with {growth.aware:+.4f} 1/s "
        f"under the LQR of the whole model, and has {growth.unaware:+.4f} 1/s under that of five "
        "joints"
    )
    if growth.unaware > 0.0:
        note += ", which excites the fast mode across the jib through the slew."
    return note


def _claims(
    shaped: Sequence[ModeResidual],
    moves: Sequence[ModeResidual],
    growth: ClosedLoopGrowth,
    stirred: float,
) -> list[Claim]:
    size = max(shaped[0].slow, shaped[0].fast)
    off = max(max(abs(s.slow - s.closed[0]), abs(s.fast - s.closed[1])) for s in shaped if s.closed)
    least_time = moves[1]
    unaware = moves[3]
    # Of the fast mode.
    crane = variant_crane(HOOK)
    length = crane.gravity / float(free_modes(crane, crane.start).frequencies[-1]) ** 2
    peak = float(np.abs(least_time.run.q[:, crane.swings]).max())
    sampling = sampling_swing(crane.gravity, length, PERIOD, peak)
    return [
        Claim(
            "Shapers on the double pendulum leave their closed form, Π |cos(π ω/(2 ω_i))|, to "
            f"{off:.0e} rad (allowed {size**3:.0e}, the cube of the swing); that for both modes "
            f"leaves {1e3 * max(shaped[-1].slow, shaped[-1].fast):.0e} mrad.",
            off < size**3,
        ),
        Claim(
            "A move of least time on the whole model ends at rest in both modes: "
            f"{1e3 * least_time.slow:.4f} and {1e3 * least_time.fast:.4f} mrad (allowed "
            f"{1e3 * sampling:.4f}: the drives get a new effort every 5 ms only).",
            max(least_time.slow, least_time.fast) < sampling,
        ),
        Claim(
            f"The LQR of the whole model damps every motion ({growth.aware:+.3f} 1/s); planned and "
            "tracked with five joints, the move of "
            f"least time leaves {unaware.slow / least_time.slow:.0f} and "
            f"{unaware.fast / least_time.fast:.0f} times as much in the two modes.",
            growth.aware < 0.0
            and unaware.slow > least_time.slow
            and unaware.fast > least_time.fast,
        ),
        Claim(
            "On the crane with the hook the LQR of five joints stirs up the fast mode across the "
            f"jib: {stirred:+.4f} 1/s in a run, "
            f"{growth.unaware:+.4f} 1/s by the linear loop (allowed {100 * SWING_TOLERANCE:g} %).",
            stirred > 0.0 and abs(stirred / growth.unaware - 1.0) < SWING_TOLERANCE,
        ),
    ]
