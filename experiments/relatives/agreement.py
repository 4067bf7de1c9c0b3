"""The same move of each crane by Pinocchio, by compiled code, by MuJoCo, and its energy ledger."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.integrators import rk4
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from experiments.relatives import twin
from experiments.relatives.catalogue import Relative, moved, relative_crane

SWING, DURATION = 0.1, 6.0
"""Of the load at the start [rad], and how long the move lasts [s]."""

ROUNDING = 1e-12
"""Between engines [rad, m, per second]: a push of 1e-15 g moves a free drive by 2e-13 m in 6 s;
stiff springs and bodies of almost no mass, by which sums are divided, cost a digit more."""

OPEN = 2.4e-9
"""Share of what the energy changes by that RK4 may leave open: (ω dt)⁴ of the fastest mode, 14
rad/s, in steps of 0.5 ms."""


class EngineAgreement(NamedTuple):
    """What one crane shows.

    Attributes:
        relative: Which.
        run: The move.
        engines: Largest difference of compiled code and Pinocchio [rad, m, per second].
        mujoco: The same of MuJoCo; None without it.
        left_open: Energy that the ledger of the same move by RK4 leaves open, at most [J].
        energy: What the energy changes by in it [J].
    """

    relative: Relative
    run: Trajectory
    engines: float
    mujoco: float | None
    left_open: float
    energy: float


def compare_engines(relative: Relative) -> EngineAgreement:
    """Move one crane four times."""
    crane = relative_crane(relative)
    run = _moved(crane, _start(crane))
    code = _moved(crane, _start(crane), engine="compiled")
    exact = _moved(crane, _start(crane), integrator=rk4, engine="compiled")
    difference = max(float(np.abs(code.q - run.q).max()), float(np.abs(code.v - run.v).max()))
    return EngineAgreement(
        relative,
        run,
        difference,
        None if twin.missing() else twin.deviation(crane, run),
        float(np.abs(exact.unexplained).max()),
        float(np.ptp(exact.energy)),
    )


def _start(crane: Crane) -> State:
    """Return a state in which the load swings both ways."""
    return moved(crane, **{crane.layout.symbols[i]: SWING for i in crane.swings})


def _moved(crane: Crane, start: State, **options: object) -> Trajectory:
    """Move trolley and hoist, with whatever turns or carries the jib."""
    reference = hold(crane, start)
    distances = {"gamma": 0.2, "bridge": 1.0, "x": 1.0, "l": -0.5}
    for symbol in (joint.symbol for joint in crane.layout.driven):
        reference = ramp(
            crane, reference, symbol, distances[symbol], rate=abs(distances[symbol]) / 3.0, at=0.5
        )
    return simulate(
        crane,
        hold_controller(crane),
        reference,
        start=start,
        duration=DURATION,
        validity="mark",
        **options,  # type: ignore[arg-type]
    )
