"""Margins of closed loops against the poles of the loop with a drive that is later or stronger."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cranedyn.controllers import hold_controller, lqr, paper_controller
from cranedyn.controllers.integral import HoistIntegral
from cranedyn.controllers.linear import LinearController
from cranedyn.dynamics.linearisation import Sampled, sampled
from cranedyn.errors import CraneError
from cranedyn.estimation import with_observer
from cranedyn.interfaces import Controller, Drive, Setpoint, State
from cranedyn.interop.margins import (
    Margins,
    Regulator,
    behind_observer,
    loop_margins,
    margins,
    regulator,
    sampled_plant,
)
from cranedyn.model.load import load_crane
from cranedyn.references import Motion
from tests import linear_laws
from tests.helpers import ROOT, crane
from tests.linear_laws import filtered

PERIOD = 5e-3
REST = crane().state(x=10.0, l=15.0)


def at_rest() -> Motion:
    """A motion that is none."""
    still = np.zeros((1, 5))
    return Motion(PERIOD, REST.q[None], still, still, crane().layout.drives)


def integrating() -> HoistIntegral:
    """The LQR with an integrator on the hoist."""
    return HoistIntegral(crane(), lqr(crane(), at_rest()), 4e3, 1e5)


def law_of(controller: Controller) -> Regulator:
    """A controller about the rest."""
    return regulator(crane(), controller, REST, t=0.0, period=PERIOD)


def radius(
    plant: Sampled, law: Regulator, drive: int, *, factor: float = 1.0, periods: int = 0
) -> float:
    """Largest pole of the loop whose one drive is stronger and late: its commands wait in a queue
    that is part of the state.
    """
    nz, m = plant.b.shape
    k = len(law.a)
    n = nz + len(law.a) + periods
    reads = np.zeros((m, n))
    reads[:, :nz] = -law.d
    reads[:, nz : nz + k] = -law.c
    acts = reads.copy()
    acts[drive] = factor * reads[drive]
    queue = np.zeros((periods, n))
    if periods:
        acts[drive] = np.eye(n)[nz + k]
        queue[:-1] = np.eye(n)[nz + k + 1 :]
        queue[-1] = factor * reads[drive]
    moves = np.zeros((nz, n))
    moves[:, :nz] = plant.a
    remembers = np.zeros((k, n))
    remembers[:, :nz] = law.b
    remembers[:, nz : nz + k] = law.a
    loop = np.vstack([moves + plant.b @ acts, remembers, queue])
    return float(np.abs(np.linalg.eigvals(loop)).max())


CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "hold": lambda: hold_controller(crane()),
    "paper": lambda: paper_controller(crane(), at_rest()),
    "lqr": integrating,
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_drive_is_unstable_just_beyond_what_its_margins_say(name: str) -> None:
    plant = sampled(crane(), REST)
    law = law_of(CONTROLLERS[name]())
    found = margins(plant, law)
    for drive, margin in enumerate(found.drives):
        below, beyond = (
            radius(plant, law, drive, factor=share * margin.upper_gain) for share in (0.995, 1.005)
        )
        assert below < 1.0 < beyond
        if margin.lower_gain > 0.0:
            # the crossing lies between frequencies of a grid
            below, beyond = (
                radius(plant, law, drive, factor=share * margin.lower_gain)
                for share in (0.98, 1.02)
            )
            assert beyond < 1.0 < below
        last = math.ceil(margin.delay / PERIOD) - 1
        assert radius(plant, law, drive, periods=last) < 1.0
        assert radius(plant, law, drive, periods=last + 1) > 1.0


def test_a_regulator_answers_as_the_controller_that_it_stands_for() -> None:
    law = law_of(integrating())
    goal = Setpoint(REST.q[crane().layout.drives], *np.zeros((2, 3)))
    away = np.random.default_rng(2).normal(size=10) * 1e-2
    runs = [integrating(), integrating()]
    for controller in runs:
        controller.begin_run(0.0, PERIOD)
    x = np.zeros(len(law.a))
    for k in range(3):
        there = State(REST.q + away[:5], away[5:])
        moved, still = (
            controller(k * PERIOD, state, goal)
            for controller, state in zip(runs, (there, REST), strict=True)
        )
        # rounding of efforts of 1e4 N
        np.testing.assert_allclose(moved - still, -law.c @ x - law.d @ away, atol=1e-9)
        x = law.a @ x + law.b @ away


def test_damping_and_growth_are_those_of_the_slowest_poles() -> None:
    plant = sampled(crane(), REST)
    law = law_of(integrating())
    found = margins(plant, law)
    assert math.exp(found.growth_rate * PERIOD) == pytest.approx(radius(plant, law, 0), rel=1e-9)
    assert 0.0 < found.damping < 1.0


def of_one(pole: float, gain: float) -> Margins:
    """A loop of one drive: z becomes pole z + u with u = -gain z, in closed form."""
    plant = Sampled(np.array([[pole]]), np.array([[1.0]]), PERIOD)
    empty = np.zeros((0, 0))
    law = Regulator(empty, np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]]))
    return margins(plant, law)


def test_margins_of_one_pole_are_those_of_the_closed_form() -> None:
    found = of_one(1.0, 0.1)
    # |1 - g/10| = 1 at g = 0 and 20; arg L(ω) = -π/2 - ωT/2 and |L| = 0.1/(2 sin(ωT/2))
    assert found.growth_rate == pytest.approx(math.log(0.9) / PERIOD)
    assert found.drives[0].upper_gain == pytest.approx(20.0, rel=1e-9)
    turning = 2.0 * math.asin(0.05)
    late = (math.pi / 2.0 - turning / 2.0) / turning * PERIOD
    assert found.drives[0].delay == pytest.approx(late, rel=1e-3)


def test_the_phase_margin_of_one_pole_is_that_of_the_closed_form() -> None:
    # |L| = 1 at the frequency of the closed form above, where arg L is -π/2 - ωT/2.
    turning = 2.0 * math.asin(0.05)
    found = of_one(1.0, 0.1).drives[0].phase
    assert found == pytest.approx(math.pi / 2.0 - turning / 2.0, rel=1e-9)


def joined(plant: Sampled, law: LinearController) -> np.ndarray:
    """The loop of a plant with a controller, from the matrices of the controller."""
    states = law.states
    further = len(plant.a) - 10
    gain = np.pad(law.tracking.gain[0], ((0, 0), (0, further)))
    by_state = np.pad(states.b, ((0, 0), (0, further)))
    return np.block([[plant.a - plant.b @ gain, plant.b @ states.c], [by_state, states.a]])


def slowest(loop: np.ndarray) -> float:
    """Largest eigenvalue of a loop."""
    return float(np.abs(np.linalg.eigvals(loop)).max())


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
def test_the_growth_of_a_controller_with_states_is_that_of_the_joined_matrices(
    drive: Drive,
) -> None:
    law = filtered(drive)
    clock: Any = {"dt": 2e-3, "control_period": linear_laws.PERIOD}
    found = loop_margins(crane(), law, linear_laws.REST, drive=drive, **clock)
    plant = sampled_plant(crane(), linear_laws.REST, drive=drive, **clock)
    expected = math.log(slowest(joined(plant, law))) / linear_laws.PERIOD
    assert found.growth_rate == pytest.approx(expected, rel=1e-9)
    assert found.growth_rate < 0.0 < found.damping


@pytest.mark.parametrize("drive", ["effort", "velocity"])
def test_margins_of_a_controller_with_states_are_those_of_python_control(drive: Drive) -> None:
    ct = pytest.importorskip("control")
    law = filtered(drive)
    clock: Any = {"dt": 2e-3, "control_period": linear_laws.PERIOD}
    plant = sampled_plant(crane(), linear_laws.REST, drive=drive, **clock)
    found = loop_margins(crane(), law, linear_laws.REST, drive=drive, **clock)
    for i, margin in enumerate(found.drives):
        # The command of one drive does not reach the crane; the loop goes from there to itself.
        others = replace(plant, b=plant.b * (np.arange(3) != i))
        into = np.append(plant.b[:, i], np.zeros(5))[:, None]
        width = len(plant.a) - 10
        out = np.concatenate([law.tracking.gain[0][i], np.zeros(width), -law.states.c[i]])[None]
        loop = ct.ss(joined(others, law), into, out, 0, dt=linear_laws.PERIOD)
        grid = np.geomspace(1e-3, 0.999 * math.pi / linear_laws.PERIOD, 2000)
        gains, phases, _, _, crossings, _ = ct.stability_margins(
            ct.frequency_response(loop, grid), returnall=True
        )
        # python-control leaves out half of the sampling rate, where L is real, too.
        gains = np.append(gains, -1.0 / loop(-1.0).real)
        upper = min(gains[gains > 1.0], default=math.inf)
        assert margin.upper_gain == pytest.approx(upper, rel=1e-6)
        shifts = np.abs(np.radians(phases))
        assert margin.phase == pytest.approx(min(shifts, default=math.inf), rel=1e-6)
        lags = np.mod(np.radians(phases), 2.0 * math.pi) / crossings
        assert margin.delay == pytest.approx(min(lags, default=math.inf), rel=1e-6)


@pytest.mark.parametrize("drive", ["effort", "velocity"])
def test_a_controller_with_states_is_unstable_just_beyond_its_margins(drive: Drive) -> None:
    law = filtered(drive)
    clock: Any = {"dt": 2e-3, "control_period": linear_laws.PERIOD}
    plant = sampled_plant(crane(), linear_laws.REST, drive=drive, **clock)
    found = loop_margins(crane(), law, linear_laws.REST, drive=drive, **clock)
    tried = 0
    for i, margin in enumerate(found.drives):
        for limit in (margin.upper_gain, margin.lower_gain):
            if not 0.0 < limit < 100.0:
                continue
            within = 0.99 * limit if limit > 1.0 else 1.01 * limit
            beyond = limit * limit / within
            radii = []
            for factor in (within, beyond):
                factors = np.ones(3)
                factors[i] = factor
                radii.append(slowest(joined(replace(plant, b=plant.b * factors), law)))
            assert radii[0] < 1.0 < radii[1]
            tried += 1
    assert tried > 0


@pytest.mark.parametrize("of", ["sampled", "loop_margins"])
def test_margins_of_a_taut_rope_that_does_not_stretch_are_those_of_a_rigid_one(of: str) -> None:
    found = []
    for c in (crane(), crane(rope_stiffness=math.inf, drum_inertia=1e-6)):
        controller = hold_controller(c)
        if of == "loop_margins":
            found.append(loop_margins(c, controller, c.start))
        else:
            law = regulator(c, controller, c.start, period=PERIOD)
            found.append(margins(sampled(c, c.start), law))
    # The tiny inertia of the drum.
    assert found[1].damping == pytest.approx(found[0].damping, rel=1e-6)
    assert found[1].growth_rate == pytest.approx(found[0].growth_rate, rel=1e-6)
    for one, other in zip(found[0].drives, found[1].drives, strict=True):
        assert other == pytest.approx(one, rel=1e-4)


def test_a_controller_of_another_period_has_no_margins() -> None:
    with pytest.raises(CraneError, match=r"control period of the run is 0\.005 s; allowed is"):
        loop_margins(crane(), filtered(), linear_laws.REST)


def test_an_unstable_plant_has_a_lower_gain_margin_also_where_it_does_not_oscillate() -> None:
    # |1.1 - g/2| = 1 at g = 0.2 and 4.2: at z = 1 and z = -1
    found = of_one(1.1, 0.5)
    assert found.drives[0].lower_gain == pytest.approx(0.2, rel=1e-12)
    assert found.drives[0].upper_gain == pytest.approx(4.2, rel=1e-12)


@pytest.mark.slow
def test_a_luffing_jib_falls_just_below_its_lower_gain_margin() -> None:
    luffing = load_crane(urdf=ROOT / "urdf" / "luffing_crane.urdf.xacro")
    plant = sampled(luffing, luffing.start)
    law = regulator(luffing, hold_controller(luffing), luffing.start, period=PERIOD)
    jib = luffing.layout.drives.tolist().index(luffing.layout.symbols.index("luff"))
    lower = margins(plant, law).drives[jib].lower_gain
    assert radius(plant, law, jib, factor=0.99 * lower) > 1.0
    assert radius(plant, law, jib, factor=1.01 * lower) < 1.0


def test_an_unstable_loop_has_no_margins_and_negative_damping() -> None:
    found = of_one(1.1, 0.05)
    assert found.drives == () and found.damping == -1.0 and found.growth_rate > 0.0
    assert found.least.delay == 0.0 and found.least.upper_gain == 1.0


def test_a_loop_behind_a_filter_has_the_poles_of_both() -> None:
    plant = sampled(crane(), REST)
    law = law_of(integrating())
    measured = with_observer(lqr(crane(), at_rest()), crane(), at_rest()).gains.measured
    gain = np.random.default_rng(1).normal(size=(10, 6)) * 1e-3
    gain[measured] += np.eye(6) * 0.2
    behind = behind_observer(law, plant, gain, measured)
    whole = np.block([[plant.a - plant.b @ behind.d, -plant.b @ behind.c], [behind.b, behind.a]])
    own = np.block([[plant.a - plant.b @ law.d, -plant.b @ law.c], [law.b, law.a]])
    errs = plant.a @ (np.eye(10) - gain @ np.eye(10)[measured])
    # separation principle: coefficients of the product, as far as poles that lie together allow
    expected = np.poly(np.concatenate([np.linalg.eigvals(own), np.linalg.eigvals(errs)]))
    np.testing.assert_allclose(np.poly(np.linalg.eigvals(whole)), expected, rtol=1e-6, atol=1e-4)
