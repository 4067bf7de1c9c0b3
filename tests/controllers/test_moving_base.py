"""Heave compensation, and swing as it is in the world."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import follow
from cranedyn.controllers.moving_base import heave_compensated, swing_in_world
from cranedyn.disturbances.base_motion import BaseCoordinates, BaseMotion
from cranedyn.dynamics.bodies import point_paths
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import OutOfRange
from cranedyn.interfaces import Setpoint, State
from cranedyn.model.load import load_crane
from cranedyn.references import hold, ramp
from tests.gantry import GANTRY
from tests.helpers import crane, quickly

SEA = BaseMotion.sines(heave=(0.5, 8.0), roll=(0.05, 9.0, 0.3), pitch=(0.04, 7.0, 1.0))


def test_a_compensated_setpoint_keeps_a_plumb_load_at_its_height_and_has_its_derivatives() -> None:
    one = crane()
    start = one.state(x=12.0, l=10.0)
    reference = heave_compensated(one, hold(one, start), SEA)
    times = np.array([0.4, 3.3, 6.1])
    setpoint = reference.at(times)
    q = np.tile(start.q, (3, 1))
    q[:, one.layout.drives] = setpoint.position
    frames = SEA.frames(times)
    pivot = np.einsum("kij,kj->ki", frames.rotation, point_paths(one, q)[:, 1]) + frames.origin
    at_rest = point_paths(one, start.q[None])[0, 1, 2] - start.q[-1]
    assert_allclose(pivot[:, 2] - q[:, -1], at_rest, atol=1e-12)
    h = 1e-3
    later = reference.at(times + h)
    earlier = reference.at(times - h)
    # O(h²)
    rate = (later.position - earlier.position) / (2.0 * h)
    assert_allclose(setpoint.velocity, rate, atol=1e-6)
    acceleration = (later.velocity - earlier.velocity) / (2.0 * h)
    assert_allclose(setpoint.acceleration, acceleration, atol=1e-6)
    assert_allclose(reference(0.4).position, setpoint.position[0], atol=1e-14)
    foreseen = heave_compensated(one, hold(one, start), SEA, ahead=0.5)
    assert_allclose(foreseen(0.4).position, reference(0.9).position, atol=1e-13)


def test_the_other_drives_keep_their_setpoints() -> None:
    one = crane()
    start = one.state(x=12.0, l=10.0)
    moving = ramp(one, hold(one, start), "x", 0.5, rate=0.1, at=0.0)
    setpoint = heave_compensated(one, moving, SEA)(2.0)
    plain = moving(2.0)
    for found, expected in zip(setpoint, plain, strict=True):
        assert_allclose(found[:2], expected[:2], atol=1e-14)
    assert abs(setpoint.position[2] - plain.position[2]) > 0.01


def test_a_hoist_that_follows_exactly_holds_a_load_on_a_heaving_base_still() -> None:
    one = crane()
    start = one.state(x=12.0, l=10.0)
    amplitude = 0.5
    omega = 2.0 * math.pi / 8.0
    # from rest, so that the hoist has nothing to catch up with
    base = BaseMotion.sines(heave=(amplitude, 8.0, -math.pi / 2.0))
    reference = heave_compensated(one, hold(one, start), base)
    period = 5e-3
    q = start.q.copy()
    q[-1] = reference(0.0).position[-1]
    run = quickly(
        one,
        follow(one, reference, period),
        reference,
        start=State(q, start.v),
        duration=8.0,
        dt=period,
        integrator=rk4,
        drive="motion",
        base=base,
    )
    height = run["base_heave_m"] - run["l_m"]
    # Accelerations that are held for a period: (ω h)²/12 of the heave.
    allowed = 1.01 * 2.0 * (omega * period) ** 2 / 12.0 * amplitude
    assert np.ptp(height) < allowed
    assert np.abs(run.coordinates("phi", "theta")).max() < 1e-12


@pytest.mark.parametrize("tilt", [0.02, 0.04])
def test_a_load_that_hangs_plumb_on_a_tilted_base_does_not_swing_for_the_controller(
    tilt: float,
) -> None:
    one = crane()
    angles = np.array([tilt, -0.5 * tilt, 0.3])

    def tilted(times: np.ndarray) -> BaseCoordinates:
        arrays = np.zeros((3, len(times), 6))
        arrays[0, :, 3:] = angles
        return BaseCoordinates(*arrays)

    seen = []

    def watching(t: float, state: State, setpoint: Setpoint) -> np.ndarray:
        seen.append(state)
        return np.zeros(3)

    base = BaseMotion(tilted)
    down = base.frames(np.zeros(1)).rotation[0].T @ np.array([0.0, 0.0, -1.0])
    start = one.state(gamma=0.4, x=12.0, l=10.0)
    # The jib at slew γ points along (sin γ, -cos γ): components of what is down along it and across
    along = down[0] * math.sin(0.4) - down[1] * math.cos(0.4)
    across = down[0] * math.cos(0.4) + down[1] * math.sin(0.4)
    q = start.q.copy()
    q[one.layout.index("phi")] = math.atan2(-along, -down[2])
    q[one.layout.index("theta")] = -math.asin(across)
    controller = swing_in_world(one, watching, base)
    controller(0.0, State(q, start.v), hold(one, start)(0.0))
    # first order of the tilt: what is left is of the third
    assert np.abs(seen[0].q[one.layout.passive]).max() < tilt**3
    assert np.abs(q[one.layout.passive]).max() > 0.5 * tilt
    assert_allclose(seen[0].v, 0.0, atol=1e-12)


def test_a_crane_without_a_hoist_has_no_heave_to_compensate(tmp_path: object) -> None:
    from pathlib import Path

    file = Path(str(tmp_path)) / "gantry.urdf"
    file.write_text(GANTRY)
    one = load_crane(file)
    with pytest.raises(OutOfRange, match="one with a hoist"):
        heave_compensated(one, hold(one), SEA)
