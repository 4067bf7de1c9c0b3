"""Motions of a base: tables, sines, places on a ship, and waves."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.disturbances.base_motion import BaseCoordinates, BaseMotion
from cranedyn.disturbances.waves import (
    Jonswap,
    RandomSea,
    Raos,
    motion_in_waves,
    significant_motion,
    wave_train,
)
from cranedyn.errors import CraneError, DataError, Misshapen, OutOfRange, UnknownName

SEA = BaseMotion.sines(
    surge=(0.5, 7.0),
    sway=(0.3, 6.0, 1.0),
    heave=(1.0, 8.0, 0.3),
    roll=(0.3, 9.0, 0.2),
    pitch=(0.4, 8.0, 2.0),
    yaw=(0.5, 11.0, 0.4),
)
"""A base that moves far in all coordinates."""

TIMES = np.array([0.3, 3.1, 7.7])


def derivative(function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Derivative by time at `TIMES`, by central differences of order 4."""
    h = 1e-3
    return (
        8.0 * (function(TIMES + h) - function(TIMES - h))
        - (function(TIMES + 2.0 * h) - function(TIMES - 2.0 * h))
    ) / (12.0 * h)


@pytest.mark.parametrize("motion", [SEA, SEA.seen_at((3.0, -7.0, 12.0))])
def test_rates_and_accelerations_are_the_derivatives(motion: BaseMotion) -> None:
    coordinates = motion.at(TIMES)
    # O(h⁴) = 1e-12, and round-off over h
    assert_allclose(derivative(lambda t: motion.at(t).position), coordinates.velocity, atol=1e-10)
    found = derivative(lambda t: motion.at(t).velocity)
    assert_allclose(found, coordinates.acceleration, atol=1e-10)


def test_the_attitude_is_that_of_urdf_and_turns_with_its_angular_velocity() -> None:
    frames = SEA.frames(TIMES)
    for rotation, angles in zip(frames.rotation, SEA.at(TIMES).position[:, 3:], strict=True):
        assert_allclose(rotation, pin.rpy.rpyToMatrix(*angles), atol=1e-15)
    # Ṙ = R [ω] with ω in the axes of the base
    rates = derivative(lambda t: SEA.frames(t).rotation)
    for rotation, rate, omega in zip(frames.rotation, rates, frames.omega, strict=True):
        assert_allclose(rotation.T @ rate, pin.skew(omega), atol=1e-10)
    assert_allclose(derivative(lambda t: SEA.frames(t).omega), frames.alpha, atol=1e-10)


def test_a_place_on_a_ship_moves_as_a_point_of_a_rigid_body() -> None:
    point = np.array([3.0, -7.0, 12.0])
    ship = SEA.frames(TIMES)
    expected = ship.origin + ship.rotation @ point - point
    assert_allclose(SEA.seen_at(point).at(TIMES).position[:, :3], expected, atol=1e-14)


def test_a_table_is_met_and_smooth_in_between() -> None:
    t = np.linspace(0.0, 10.0, 101)
    omega = 1.3
    motion = BaseMotion.from_table(t, heave=np.sin(omega * t), roll=0.1 * np.cos(omega * t))
    assert_allclose(motion.at(t).position[:, 2], np.sin(omega * t), atol=1e-14)
    inner = np.linspace(2.0, 8.0, 57)
    found = motion.at(inner)
    # a spline of degree 5: O((ω h)⁶) and, for its second derivative, O((ω h)⁴)
    assert_allclose(found.position[:, 2], np.sin(omega * inner), atol=(omega * 0.1) ** 6)
    assert_allclose(
        found.acceleration[:, 2], -(omega**2) * np.sin(omega * inner), atol=(omega * 0.1) ** 4
    )
    assert not found.position[:, [0, 1, 4, 5]].any()


def test_a_file_has_degrees_or_radians(tmp_path: Path) -> None:
    file = tmp_path / "sea.csv"
    t = np.arange(0.0, 1.0, 0.1)
    lines = [f"{x:g},{2 * x:.17g},{x * x:.17g}" for x in t]
    file.write_text("t_s,roll_deg,heave_m\n" + "\n".join(lines) + "\n")
    position = BaseMotion.from_file(file).at(np.array([0.4])).position[0]
    assert position[3] == pytest.approx(math.radians(0.8), abs=1e-15)
    assert position[2] == pytest.approx(0.16, abs=1e-14)
    file.write_text("t_s,depth_m\n0,1\n")
    with pytest.raises(DataError, match="has no column of a motion of the base"):
        BaseMotion.from_file(file)


@pytest.mark.parametrize(
    ("make", "kind", "sentence"),
    [
        (lambda: BaseMotion.sines(heav=(1.0, 8.0)), UnknownName, "the nearest is heave"),
        (lambda: BaseMotion.sines(heave=(1.0, 0.0)), OutOfRange, "period of heave is 0.0 s"),
        (lambda: BaseMotion.sines(heave=1.0), OutOfRange, "an amplitude, a period"),
        (lambda: BaseMotion.from_table([0.0, 1.0], heave=[0.0, 1.0]), OutOfRange, "6 or more"),
        (
            lambda: BaseMotion.from_table([0, 1, 2, 2, 3, 4], heave=np.zeros(6)),
            OutOfRange,
            r"later than the row before, at 2 s \(row 4\)",
        ),
        (
            lambda: BaseMotion.from_table(np.arange(6.0), heave=np.zeros(5)),
            Misshapen,
            "heave of the base",
        ),
        (lambda: SEA.seen_at((0.0, math.nan, 0.0)), OutOfRange, "place of the crane"),
        (lambda: Jonswap(2.0, 8.0, 9.0), OutOfRange, "peak enhancement factor is 9"),
        (lambda: Jonswap(-2.0, 8.0), OutOfRange, "significant wave height is -2"),
    ],
)
def test_a_wrong_number_is_refused_in_a_sentence(
    make: Callable[[], object], kind: type[CraneError], sentence: str
) -> None:
    with pytest.raises(kind, match=sentence):
        make()


def test_a_function_of_another_shape_is_refused() -> None:
    motion = BaseMotion(lambda times: BaseCoordinates(*np.zeros((3, 6))))
    with pytest.raises(Misshapen, match="coordinates of the base"):
        motion.at(TIMES)


# --- waves ----------------------------------------------------------------------------------------

FOLLOWING = Raos(np.array([0.1, 6.0]), np.array([[0, 0, 1, 0, 0, 0]] * 2, dtype=complex), 0.0)
"""A raft that heaves as the water does."""


def test_a_jonswap_spectrum_has_the_height_and_the_peak_of_its_formula() -> None:
    spectrum = Jonswap(2.5, 9.0, 3.3)
    omega = np.linspace(0.2, 8.0, 200_001)
    density = spectrum(omega)
    # 0.2 % of the energy lies above the range that normalises it
    assert 4.0 * math.sqrt(np.trapezoid(density, omega)) == pytest.approx(2.5, rel=2e-3)
    assert omega[np.argmax(density)] == pytest.approx(2.0 * math.pi / 9.0, rel=1e-3)
    # Without enhancement it is Pierson and Moskowitz: 5/16 Hs² ωp⁴ ω⁻⁵ exp(-5/4 (ωp/ω)⁴).
    plain = Jonswap(2.5, 9.0, 1.0)
    peak = plain.peak_frequency
    closed = 5.0 / 16.0 * 2.5**2 * peak**4 * omega**-5 * np.exp(-1.25 * (peak / omega) ** 4)
    inside = (omega > 0.5 * peak) & (omega < 5.0 * peak)
    assert_allclose(plain(omega)[inside], closed[inside], rtol=3e-3)
    ratio = spectrum(np.array([peak]))[0] / spectrum(np.array([2.0 * peak]))[0]
    of_plain = plain(np.array([peak]))[0] / plain(np.array([2.0 * peak]))[0]
    assert ratio == pytest.approx(3.3 * of_plain, rel=1e-9)


def test_a_raft_heaves_as_the_water_does_and_as_high_as_the_sea_is() -> None:
    spectrum = Jonswap(2.0, 8.0)
    motion = motion_in_waves(spectrum, raos=FOLLOWING, seed=3)
    waves = wave_train(spectrum, seed=3)
    t = np.linspace(0.0, 50.0, 77)
    assert_allclose(motion.at(t).position[:, 2], waves.elevation(t), atol=1e-12)
    assert 4.0 * math.sqrt((waves.amplitude**2).sum() / 2.0) == pytest.approx(2.0, rel=1e-9)
    assert significant_motion(spectrum, FOLLOWING)[2] == pytest.approx(2.0, rel=1e-9)
    other = motion_in_waves(spectrum, raos=FOLLOWING, seed=4)
    assert np.abs(other.at(t).position - motion.at(t).position).max() > 0.1


def test_a_response_has_the_phase_of_its_file_and_its_heading(tmp_path: Path) -> None:
    file = tmp_path / "raos.csv"
    file.write_text(
        "heading_deg,period_s,heave_m_m,heave_phase_deg,roll_deg_m,roll_phase_deg\n"
        "180,1.5,0.5,90,0,0\n180,30,0.5,90,0,0\n90,1.5,1,0,2,-90\n90,30,1,0,2,-90\n"
    )
    spectrum = Jonswap(2.0, 8.0)
    t = np.linspace(0.0, 20.0, 2001)
    waves = wave_train(spectrum, seed=1)
    head = motion_in_waves(spectrum, raos=file, heading=180.0, seed=1)
    beam = motion_in_waves(spectrum, raos=file, heading=90.0, seed=1)
    assert not head.at(t).position[:, 3].any()
    # A phase of 90° is a lead: cos(ω t + ε + 90°).
    lead = np.cos(np.multiply.outer(t, waves.frequency) + waves.phase + math.pi / 2.0)
    assert_allclose(head.at(t).position[:, 2], 0.5 * lead @ waves.amplitude, atol=1e-12)
    # Of two degrees a metre, a quarter of a period late.
    late = np.cos(np.multiply.outer(t, waves.frequency) + waves.phase - math.pi / 2.0)
    roll = math.radians(2.0) * late @ waves.amplitude
    assert_allclose(beam.at(t).position[:, 3], roll, atol=1e-12)
    with pytest.raises(OutOfRange, match="one of 90, 180"):
        motion_in_waves(spectrum, raos=file, heading=45.0, seed=1)
    with pytest.raises(OutOfRange, match="heading of the waves is none"):
        motion_in_waves(spectrum, raos=file, seed=1)
    with pytest.raises(OutOfRange, match="of the energy of the waves lies outside"):
        motion_in_waves(Jonswap(2.0, 2.5), raos=file, heading=90.0, seed=1)


def test_a_shifted_motion_is_the_same_motion_later() -> None:
    table = BaseMotion.from_table(np.arange(20.0), roll=np.sin(0.5 * np.arange(20.0)))
    for motion in (SEA, table):
        shifted = motion.shifted(3.0)
        for given, expected in zip(shifted.at(TIMES), motion.at(TIMES + 3.0), strict=True):
            assert_allclose(given, expected, atol=1e-12)
    assert (table.shifted(3.0).first, table.shifted(3.0).last) == (-3.0, 16.0)
    with pytest.raises(OutOfRange, match="allowed is -3 to 16"):
        table.shifted(3.0).at(np.array([17.0]))
    with pytest.raises(OutOfRange, match="time by which the base is shifted"):
        SEA.shifted(math.inf)


def test_a_random_sea_without_spectra_or_operators_is_refused() -> None:
    with pytest.raises(OutOfRange, match="number of spectra is 0"):
        RandomSea([], [FOLLOWING])
    with pytest.raises(OutOfRange, match="number of RAOs is 0"):
        RandomSea([Jonswap(1.0, 8.0)], [])
    with pytest.raises(OutOfRange, match="of the energy of the waves lies outside"):
        RandomSea([Jonswap(1.0, 500.0)], [FOLLOWING])


@pytest.mark.parametrize("count", [2, 3, 10, 1000, 1003])
def test_equally_spaced_times_have_the_coordinates_of_each_alone(count: int) -> None:
    """Their sines are products of starts and offsets; one time alone is a sine itself."""
    motion = BaseMotion.sines(heave=(1.5, 8.0, 0.3), roll=(0.05, 11.0, -1.2), yaw=(0.1, 3.0))
    times = 40.0 + 2.5e-3 * np.arange(count)
    together = motion.at(times)
    for row in {0, 1, count // 2, count - 1}:
        alone = motion.at(times[[row]])
        for ours, own in zip(together, alone, strict=True):
            # Angles of some hundred radians keep 14 digits of a double.
            assert_allclose(ours[row], own[0], atol=1e-13)


def test_times_that_are_not_equally_spaced_are_no_products() -> None:
    motion = BaseMotion.sines(heave=(1.5, 8.0))
    times = np.array([0.0, 1.0, 2.0, 3.5, 4.0, 9.0, 9.5, 20.0, 21.0])
    expected = 1.5 * np.sin(2.0 * np.pi / 8.0 * times)
    assert_allclose(motion.at(times).position[:, 2], expected, atol=1e-14)


def test_the_frames_at_one_time_are_those_of_that_time_to_the_last_bit() -> None:
    ship = SEA.seen_at((3.0, -7.0, 12.0))
    for motion in (ship, SEA):
        # One time twice, as wind and engine ask for it, and then another one.
        for t in (0.3, 0.3, 7.7):
            alone = motion.frames(np.array([t]))
            for numbers, kept in zip(alone, motion.frames_at(t), strict=True):
                assert np.array_equal(numbers, kept)
                assert not kept.flags.writeable


def test_velocities_in_the_world_are_those_of_a_rigid_body() -> None:
    position = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 9.0]])
    velocity = np.array([[0.1, 0.2, 0.3], [0.0, -0.4, 0.2]])
    frames = SEA.frames(TIMES[:1])
    relative = velocity + np.cross(frames.omega[0], position)
    expected = frames.velocity[0] + relative @ frames.rotation[0].T
    # The products are those of NumPy, to the last bit.
    assert np.array_equal(SEA.world_velocities(TIMES[0], position, velocity), expected)
