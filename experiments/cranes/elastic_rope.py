"""A rope that stretches: a load picked up at a speed, and a part of the load dropped."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.controllers import follow
from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.interfaces import Controller, Reference, State
from cranedyn.model.crane import Crane
from cranedyn.references import hold, ramp
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import POINT, ROPE, at_start, moved, rope_stiffness

STEP = 5e-4
"""Physics step, and time between control instants [s]."""


class Jump(NamedTuple):
    """An extreme tension of the rope over the weight that hangs.

    Attributes:
        name: Event of the load.
        closed: Value in closed form.
        simulated: Value in a run.
        allowed: Largest difference between them.
        why: Reasons for the difference.
    """

    name: str
    closed: float
    simulated: float
    allowed: float
    why: str

    @property
    def holds(self) -> bool:
        """Whether the run agrees with the closed form."""
        return abs(self.simulated - self.closed) < self.allowed


def study(setup: Setup) -> Outcome:
    """Compare all jumps of the tension, with runs of a rope that may go slack."""
    jumps = [*_pickups(), *_drops()]
    claim = Claim(
        "A load picked up at a speed v loads the rope by 1 + v ω/g, a part dropped by 1 ± its "
        f"share of the load left: {len(jumps)} cases, each within what is allowed.",
        all(jump.holds for jump in jumps),
    )
    return Outcome([_table(jumps)], [claim])


def _pickups() -> Iterator[Jump]:
    """Pick up a load that stands on the ground by a drum that already turns.

    The run begins when the rope just carries the load: it is stretched by the weight, and stretches
    at the speed of the drum.
    """
    crane = ROPE.crane(**POINT)
    length = at_start(crane, "l")
    omega = _bounce(crane)
    for speed in (0.05, 0.2, 0.5):
        start = moved(crane, l_dot=-speed, rope_stretch_dot=speed)
        closed = theory.pickup_factor(speed, omega, crane.gravity)
        hoisted = ramp(crane, hold(crane, start), "l", -speed, rate=speed, at=-0.5)
        run = _run(crane, follow(crane, hoisted, STEP), hoisted, start, 0.4)
        assert float(np.ptp(run["l_dot_m_s"])) < 1e-6, "the drum turns evenly"
        weight = crane.payload_mass * crane.gravity
        peak = float(_tension(crane, run).max()) / weight
        strain = weight / rope_stiffness(crane)
        shorter = math.pi / 2.0 * speed / (omega * length)
        allowed = (closed - 1.0) * (strain + shorter) + (omega * STEP) ** 2
        why = "strain at rest; shorter cable at the peak; (ω dt)²"
        yield Jump(f"picked up at {speed:g} m/s", closed, peak, allowed, why)


def _drops() -> Iterator[Jump]:
    """Drop a part of the load: the run has what is left, and the stretch under the whole load."""
    for mass_before, mass_after in ((1000.0, 800.0), (1000.0, 500.0)):
        before = ROPE.crane(payload_mass=mass_before, **POINT)
        after = ROPE.crane(payload_mass=mass_after, **POINT)
        stretch = at_start(before, "rope_stretch") - at_start(after, "rope_stretch")
        start = moved(after, rope_stretch=stretch)
        run = _run(after, zero_command(after), None, start, 1.0)
        tension = _tension(after, run) / (mass_after * after.gravity)
        closed = theory.drop_factor(mass_before - mass_after, mass_after)
        allowed = (_bounce(after) * STEP) ** 2
        name = f"{mass_before - mass_after:g} of {mass_before:g} kg dropped"
        yield Jump(f"{name}, at most", 1.0 + closed, float(tension.max()), allowed, "(ω dt)²")
        yield Jump(f"{name}, at least", 1.0 - closed, float(tension.min()), allowed, "(ω dt)²")


def _run(
    crane: Crane,
    controller: Controller,
    reference: Reference | None,
    start: State,
    duration: float,
) -> Trajectory:
    """Run a crane whose drives move as prescribed, with a row for each step."""
    return simulate(
        crane,
        controller,
        reference,
        start=start,
        dt=STEP,
        control_period=STEP,
        duration=duration,
        drive="motion",
        validity="mark",
    )


def _tension(crane: Crane, run: Trajectory) -> np.ndarray:
    """Return the tension of the rope at each row, by its strain [N]."""
    return rope_stiffness(crane) * run["rope_stretch_m"] / run["l_m"]


def _bounce(crane: Crane) -> float:
    """Return the frequency of the load on its rope [rad/s]."""
    return theory.rope_bounce(rope_stiffness(crane), at_start(crane, "l"), crane.payload_mass)


def _table(results: Sequence[Jump]) -> ResultTable:
    return make_table(
        "Rope that stretches: tension over the weight that hangs",
        results,
        ("event", "", lambda j: j.name),
        ("closed form", ".4f", lambda j: j.closed),
        ("simulated", ".4f", lambda j: j.simulated),
        ("difference", "+.1e", lambda j: j.simulated - j.closed),
        ("allowed", ".1e", lambda j: j.allowed),
        ("for", "", lambda j: j.why),
    )
