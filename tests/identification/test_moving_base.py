"""Records of a crane on a base that moves: what is found, and what is said of it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binom

from cranedyn.controllers import follow
from cranedyn.data.columns import BASE_COLUMNS
from cranedyn.data.external import parse_sources
from cranedyn.data.trajectory import Trajectory
from cranedyn.disturbances.base_motion import COORDINATES, BaseMotion
from cranedyn.disturbances.waves import Jonswap, Raos, motion_in_waves
from cranedyn.dynamics.integrators import rk4
from cranedyn.identification import Estimate, Model, Prior, Record, identify, load_record
from cranedyn.lifts.planning.joystick import JoystickPulse, joystick
from cranedyn.simulation.simulate import simulate

PRIOR = Prior()
TRUTH = {"l_offset": 0.37, "damp_swing": 2500.0}
SWING_NOISE = 2e-3
BASE_NOISE = {"base_sway_m": 5e-3, "base_heave_m": 5e-3, "base_roll_rad": 3e-4}
"""Noise of a motion reference unit [m, rad]."""


def sea() -> BaseMotion:
    """A raft that heaves with the water, rolls with its slope and drifts by half its height."""
    frequency = np.linspace(0.1, 6.0, 300)
    response = np.zeros((300, 6), dtype=complex)
    response[:, COORDINATES.index("sway")] = 0.5j
    response[:, COORDINATES.index("heave")] = 1.0
    response[:, COORDINATES.index("roll")] = -1j * frequency**2 / 9.81
    return motion_in_waves(Jonswap(0.5, 9.0), Raos(frequency, response, 90.0), seed=2)


@cache
def run() -> Trajectory:
    """A crane that is not as one believes, on a raft, by the plain loop of Pinocchio."""
    crane = PRIOR.load(damp_swing=TRUTH["damp_swing"])
    start = crane.state(x=8.0, l=12.0 + TRUTH["l_offset"], phi=0.1, theta=-0.05)
    pulses = [JoystickPulse("x", 0.6, 2.0, 4.0), JoystickPulse("l", 0.4, 16.0, 4.0)]
    aims = joystick(crane, start, pulses, accelerations=(0.05, 0.3, 0.3))
    return simulate(
        crane,
        follow(crane, aims, 0.01),
        start=start,
        duration=60.0,
        dt=0.01,
        control_period=0.01,
        drive="motion",
        integrator=rk4,
        base=sea(),
        validity="mark",
    )


def recorded(seed: int, *, base_noise: float = 1.0) -> dict[str, np.ndarray]:
    """Columns with noise, ten a second."""
    rng = np.random.default_rng(seed)
    names = ("t_s", "gamma_rad", "x_m", "l_m", "phi_rad", "theta_rad", *BASE_NOISE)
    columns = {name: run()[name][::10].copy() for name in names}
    columns["l_m"] -= TRUTH["l_offset"]
    noise = {"phi_rad": SWING_NOISE, "theta_rad": SWING_NOISE}
    noise |= {name: base_noise * deviation for name, deviation in BASE_NOISE.items()}
    for name, deviation in noise.items():
        columns[name] += deviation * rng.standard_normal(len(columns["t_s"]))
    return columns


def found(columns: dict[str, np.ndarray], *names: str) -> Estimate:
    record = Record.of(PRIOR.crane, columns)
    return identify(Model.of(PRIOR, [record], names or tuple(TRUTH)))


@pytest.mark.slow
def test_length_and_damping_are_found_at_sea_within_their_intervals() -> None:
    misses = 0
    records = 4
    for seed in range(records):
        estimate = found(recorded(seed))
        assert not estimate.not_white
        for name, value in TRUTH.items():
            misses += abs(estimate.value(name) - value) > estimate.intervals[name].margin
    # Of 95 % intervals, one in ten thousand such studies misses more often.
    assert misses <= binom.isf(1e-4, records * len(TRUTH), 0.05)
    # The noise of the base widens the intervals, which do not leave the truth out for it.
    exact = found(recorded(0, base_noise=0.0))
    assert (
        exact.intervals["l_offset"].margin < 0.8 * found(recorded(0)).intervals["l_offset"].margin
    )


@pytest.mark.slow
def test_gravity_is_found_at_sea_though_it_is_part_of_what_a_crane_feels_of_its_base() -> None:
    estimate = found(recorded(5), "l_offset", "damp_swing", "gravity")
    interval = estimate.intervals["gravity"]
    assert abs(interval.value - PRIOR.crane.gravity) < 2.0 * interval.margin < 1.0


@pytest.mark.slow
def test_a_record_at_sea_without_its_base_is_not_explained_and_says_so() -> None:
    at_sea = recorded(1)
    silent = {name: at_sea[name] for name in at_sea if name not in BASE_COLUMNS}
    estimate = found(silent)
    assert abs(estimate.value("l_offset") - TRUTH["l_offset"]) > 0.1
    assert [name for name in estimate.not_white if "phi_rad" in name]


def test_a_record_has_the_motion_of_its_base_and_says_which(tmp_path: Path) -> None:
    at_sea = recorded(0, base_noise=0.0)
    file = tmp_path / "ship.csv"
    degrees = np.degrees(at_sea["base_roll_rad"])
    table = {**at_sea, "roll": degrees}
    del table["base_roll_rad"]
    rows = zip(*table.values(), strict=True)
    lines = [",".join(table), *(",".join(repr(float(x)) for x in row) for row in rows)]
    file.write_text("\n".join(lines))
    record = load_record(file, PRIOR.crane, sources=parse_sources(["base_roll_rad=roll[deg]"]))
    assert record.base is not None
    t = np.linspace(1.0, 59.0, 300)
    for found_order, true_order in zip(record.base.at(t), sea().at(t), strict=True):
        # A spline of degree five through rows at h errs by about (ω h)⁴ of an acceleration: by
        # 1.5 % of those of the shortest waves, of 1.8 s, which are some 1e-4 m/s² and rad/s² here.
        assert_allclose(found_order, true_order, rtol=0.0, atol=5e-6)
    assert any("base_sway_m, base_heave_m, base_roll_rad; its swing" in n for n in record.notes)
    still = Record.of(PRIOR.crane, {**at_sea, **dict.fromkeys(BASE_NOISE, 0.0 * t[:1].repeat(601))})
    assert any(note.endswith("which stands still.") for note in still.notes)
