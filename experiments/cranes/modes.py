"""Frequencies: the closed form, the linearisation of the multibody crane, and small swings of a
run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from cranedyn import theory
from cranedyn.controllers import Hold
from cranedyn.controllers.hold import zero_command
from cranedyn.dynamics.equations_of_motion import holding_effort, linearise
from cranedyn.dynamics.linearisation import free_modes
from cranedyn.interfaces import Drive, EngineName, State
from cranedyn.model.crane import Crane
from cranedyn.simulation.simulate import simulate
from experiments.harness import Claim, Outcome, ResultTable, Setup, make_table
from experiments.scenarios.crane_variants import (
    BEND,
    BRIDGE,
    HOOK,
    JIB,
    POINT,
    ROPE,
    TWIST,
    at_start,
    moved,
    rope_stiffness,
)

EXACT = 1e-8
"""Largest difference between linearisation and closed form, and between a run and the linearisation
with the error of the step [rad/s]."""

_SMALL = 1e-5
"""Amplitude of the small swings [rad or m]; what is not linear in them goes with its square, some
1e-10 of the frequency."""

STEP = 5e-3
"""Physics step [s]."""

PERIOD = 0.04
"""Time from one row of a run to the next [s]."""

ROWS = 100
"""Number of rows of a run from which a frequency is read."""


class Frequency(NamedTuple):
    """One frequency of one crane.

    Attributes:
        crane: Name of the crane.
        mode: What swings.
        closed: Frequency in closed form [rad/s].
        linear: Frequency by the linearisation of the crane [rad/s].
        simulated: Frequency of a small swing in a run [rad/s].
        stepped: `linear` with the error of the step [rad/s], see `_stepped`.
        allowed: Largest difference between `closed` and `linear` [rad/s]. Where a structure leans
            at rest it is the square of that angle times the frequency.
    """

    crane: str
    mode: str
    closed: float
    linear: float
    simulated: float
    stepped: float
    allowed: float = EXACT

    @property
    def holds(self) -> bool:
        """Whether all three agree."""
        return (
            abs(self.linear - self.closed) < self.allowed
            and abs(self.simulated - self.stepped) < EXACT
        )


Measurement = Callable[..., Frequency]
"""Function that runs a crane by an engine, the keyword `engine`, and returns a frequency."""


def study(setup: Setup) -> Outcome:
    """Compare the frequencies of all cranes."""
    frequencies = []
    for measurements in (_hooks(), _ropes(), _twists(), _bends(), _bridges()):
        for measure in measurements:
            frequencies.append(measure(engine=setup.engine_of_runs))
    return Outcome([_table(frequencies)], _claims(frequencies))


def _hooks() -> Iterator[Measurement]:
    """Yield the two modes of a load that is slung below a hook, on three cranes."""
    # Lengths of cable and sling [m], masses of hook and load [kg].
    cases = [(15.0, 5.0, 300.0, 2000.0), (40.0, 4.0, 500.0, 5000.0), (20.0, 10.0, 1000.0, 1000.0)]
    for cable, sling, hook, load in cases:
        crane = HOOK.crane(
            hook_mass=hook,
            sling_length=sling,
            payload_mass=load,
            hoist_init=cable,
            hoist_max=60.0,
            pivot_height=90.0,
            hoist_effort=1e6,
        )
        name = f"hook: l = {cable:g} + {sling:g} m, {hook:g} + {load:g} kg"
        forms = theory.double_pendulum(cable, sling, hook, load, crane.gravity)
        for mode, closed in zip(("slow", "fast"), forms, strict=True):
            yield partial(_locked, name, mode, crane, closed)


def _ropes() -> Iterator[Measurement]:
    """Yield the bounce of a load on a rope that stretches."""
    crane = ROPE.crane(**POINT)
    bounce = theory.rope_bounce(rope_stiffness(crane), at_start(crane, "l"), crane.payload_mass)
    yield partial(_locked, ROPE.name, "bounce", crane, bounce)


def _twists() -> Iterator[Measurement]:
    """Yield the two modes of a tower that twists.

    The mass of the trolley once counts in the 1e6 kg m² of the structure, as in the 2 × 2 model
    from which the frequencies are known, and once comes on top of them.
    """
    numbers = {"trolley_init": 20.0, "hoist_init": 15.0, "payload_mass": 2000.0, **POINT}
    numbers["trolley_inertia"] = 0.0
    inertia = 1e6
    trolley = 500.0
    radius = 20.0
    for name, inertia_of_structure in (
        ("trolley within J", inertia - trolley * radius**2),
        ("and a trolley of 500 kg", inertia),
    ):
        crane = TWIST.crane(slewing_inertia=inertia_of_structure, trolley_mass=trolley, **numbers)
        forms = theory.twisting_tower(
            inertia_of_structure, 2e7, radius, 15.0, 2000.0, crane.gravity, trolley
        )
        for mode, closed in zip(("slow", "fast"), forms, strict=True):
            yield partial(_locked, f"twist: J = 1e6 kg m², {name}", mode, crane, closed)


def _bends() -> Iterator[Measurement]:
    """Yield the modes of a tower and of a jib that bend."""
    height = 28.0
    mass = 1000.0
    length = 15.0
    crane = BEND.crane(trolley_inertia=0.0, **POINT)
    # Above the foot are the trolley and the upper structure, 3 t. The inertia of the latter about
    # the axis along the jib is a fiftieth of its slewing inertia, 1e6 kg m².
    above = crane.trolley_mass + 3000.0
    inertia = above * height**2 + 0.02 * 1e6
    forms = theory.bending_tower(inertia, 1e8, above * height, height, length, mass, crane.gravity)
    lean = at_start(crane, "tower_bend_x")
    for mode, closed in zip(("slow", "fast"), forms, strict=True):
        allowed = closed * lean**2
        yield partial(_locked, BEND.name, f"across the jib, {mode}", crane, closed, allowed)
    crane = JIB.crane(trolley_inertia=0.0, **POINT)
    droop = at_start(crane, "jib_bend")
    closed = theory.bending_jib(4e7, 4e5, 10.0, mass + crane.trolley_mass)
    yield partial(_locked, JIB.name, "up and down", crane, closed, closed * droop**2)


def _bridges() -> Iterator[Measurement]:
    """Yield the swings of an overhead crane with its drives locked and with one that rolls."""
    crane = BRIDGE.crane(**POINT)
    length = at_start(crane, "l")
    yield partial(_locked, BRIDGE.name, "drives locked", crane, math.sqrt(crane.gravity / length))
    for symbol, mode, carried in (
        ("phi", "trolley rolls freely", 1500.0),
        ("theta", "bridge rolls freely", 13500.0),
    ):
        period = theory.rolling_period(length, crane.gravity, crane.payload_mass, carried)
        closed = 2.0 * math.pi / period
        yield partial(_rolling, crane, symbol, mode, closed)


def _locked(
    name: str,
    mode: str,
    crane: Crane,
    closed: float,
    allowed: float = EXACT,
    *,
    engine: EngineName | None,
) -> Frequency:
    """Return the mode with locked drives whose frequency is nearest to a closed form.

    Args:
        name: Name of the crane.
        mode: What swings.
        crane: The crane.
        closed: The closed form [rad/s].
        allowed: Largest difference between the two [rad/s].
        engine: Engine of the run.
    """
    modes = free_modes(crane, crane.start)
    k = int(np.argmin(np.abs(modes.frequencies - closed)))
    q = crane.start.q.copy()
    q[modes.passive] += _SMALL * modes.shapes[:, k] / np.abs(modes.shapes[:, k]).max()
    rows = _rows(crane, zero_command(crane), State(q, crane.start.v), "motion", engine)
    signal = (rows - modes.rest)[:, modes.passive] @ modes.weights[k]
    linear = float(modes.frequencies[k])
    return Frequency(name, mode, closed, linear, _frequency(signal), _stepped(linear), allowed)


def _rolling(
    crane: Crane, symbol: str, mode: str, closed: float, *, engine: EngineName | None
) -> Frequency:
    """Return a swing while all drives roll freely, but for the weight that the hoist holds.

    Args:
        crane: The crane.
        symbol: Symbol of the joint that swings.
        mode: What rolls.
        closed: The closed form [rad/s].
        engine: Engine of the run.
    """
    holding = holding_effort(crane, crane.start.q)
    by_q = linearise(crane, crane.start, holding)[0][:, : crane.layout.n]
    squares = -np.linalg.eigvals(by_q).real
    linear = float(np.sqrt(squares[np.argmin(np.abs(squares - closed**2))]))
    zeros = np.zeros(crane.layout.m)
    free = Hold(crane, zeros, zeros, holding)
    start = moved(crane, **{symbol: _SMALL})
    signal = _rows(crane, free, start, "effort", engine)[:, crane.layout.index(symbol)]
    return Frequency(BRIDGE.name, mode, closed, linear, _frequency(signal), _stepped(linear))


def _rows(
    crane: Crane, controller: Hold, start: State, drive: Drive, engine: EngineName | None
) -> np.ndarray:
    """Return the coordinates of a run, shape (rows, n)."""
    return simulate(
        crane,
        controller,
        start=start,
        duration=PERIOD * ROWS,
        dt=STEP,
        control_period=PERIOD,
        drive=drive,
        validity="mark",
        engine=engine,
    ).q


def _frequency(y: np.ndarray) -> float:
    """Return the frequency of an undamped oscillation in rows a time T apart [rad/s].

    Its rows obey y[k+1] + y[k-1] = 2 cos(ωT) y[k]. The least squares of 2 y[k] - y[k+1] - y[k-1] =
    2 (1 - cos ωT) y[k] = 4 sin²(ωT/2) y[k] give the sine; a cosine would lose the digits of a slow
    swing.
    """
    neighbours = y[2:] + y[:-2]
    middle = y[1:-1]
    square = float((2.0 * middle - neighbours) @ middle) / float(middle @ middle)
    return 2.0 / PERIOD * math.asin(math.sqrt(square) / 2.0)


def _stepped(frequency: float) -> float:
    """Return the frequency that semi-implicit Euler gives a frequency ω [rad/s].

    It is ω' with sin(ω' dt/2) = ω dt/2, exactly.
    """
    return 2.0 / STEP * math.asin(frequency * STEP / 2.0)


def _table(results: Sequence[Frequency]) -> ResultTable:
    return make_table(
        "Frequencies",
        results,
        ("crane", "", lambda f: f.crane),
        ("mode", "", lambda f: f.mode),
        ("closed form [rad/s]", ".8f", lambda f: f.closed),
        ("linearised", ".8f", lambda f: f.linear),
        ("difference", "+.0e>1e-11", lambda f: f.linear - f.closed),
        ("small swing", ".8f", lambda f: f.simulated),
        ("error of the step", "+.0e", lambda f: f.stepped - f.linear),
        ("remainder", "+.0e>1e-11", lambda f: f.simulated - f.stepped),
        note="Drives are locked unless they roll. The twisting tower is held to a 2 × 2 model "
        "without the trolley, 0.79786094 and 4.53213150 rad/s: the full model agrees if the "
        "trolley's m x² is part of the 1e6 kg m², and is slower otherwise. A structure that leans "
        "at rest may differ by the square of that angle.",
    )


def _claims(frequencies: Sequence[Frequency]) -> list[Claim]:
    """Claim that closed form, linearisation and small swings agree, for each crane."""
    names = dict.fromkeys(f.crane for f in frequencies)
    claims = []
    for name in names:
        of_crane = [f for f in frequencies if f.crane == name]
        off = max(abs(f.linear - f.closed) for f in of_crane)
        simulated_off = max(abs(f.simulated - f.stepped) for f in of_crane)
        claims.append(
            Claim(
                f"{name}: {', '.join(f'{f.closed:.8f}' for f in of_crane)} rad/s by closed form, "
                f"off by {off:.0e} in the linearisation (allowed "
                f"{max(f.allowed for f in of_crane):.0e}), by {simulated_off:.0e} in small swings "
                f"beyond the step's own error ({EXACT:.0e}).",
                all(f.holds for f in of_crane),
            )
        )
    return claims
