"""The stepping rule, on a pendulum whose exact answer is known and on robots that are no cranes."""

from __future__ import annotations

import math
from importlib import metadata

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from cranedyn.dynamics.integrators import semi_implicit_euler

OMEGA = 0.8
"""Frequency of the pendulum [rad/s]."""

ROBOTS = ("double_pendulum_continuous.urdf", "panda.urdf", "ur5_robot.urdf")
"""A chain of joints that turn without end (nq = 4, nv = 2), an arm with a gripper (9 joints) and an
arm (6 joints)."""


def _pendulum() -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(
        joint,
        pin.Inertia(2.0, np.array([0.0, 0.0, -9.81 / OMEGA**2]), np.zeros((3, 3))),
        pin.SE3.Identity(),
    )
    return model


def _robot(name: str) -> pin.Model:
    files = metadata.files("example-robot-data") or []
    return pin.buildModelFromUrdf(str(next(file for file in files if file.name == name).locate()))


def _advance(
    model: pin.Model, q: np.ndarray, v: np.ndarray, dt: float, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Free motion by the rule under test."""
    data = model.createData()
    none = np.zeros(model.nv)
    return semi_implicit_euler.advance(
        lambda q, v: pin.aba(model, data, q, v, none), model, q, v, dt, steps
    )


def _exact(model: pin.Model, q: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Free motion from rest by a Runge-Kutta of order 8; joints of one degree of freedom each, so
    increments add up.
    """
    data = model.createData()
    none = np.zeros(model.nv)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        moved, v = np.split(y, 2)
        return np.concatenate([v, pin.aba(model, data, pin.integrate(model, q, moved), v, none)])

    moved, v = np.split(
        solve_ivp(
            rates, (0.0, duration), np.zeros(2 * model.nv), "DOP853", rtol=1e-11, atol=1e-12
        ).y[:, -1],
        2,
    )
    return pin.integrate(model, q, moved), v


def _start(model: pin.Model) -> np.ndarray:
    return pin.integrate(model, pin.neutral(model), np.linspace(0.3, -0.4, model.nv))


def _energy(model: pin.Model, q: np.ndarray, v: np.ndarray) -> float:
    return float(pin.computeMechanicalEnergy(model, model.createData(), q, v))


@pytest.mark.parametrize("name", ROBOTS)
def test_the_error_halves_with_the_step_on_any_robot(name: str) -> None:
    model = _robot(name)
    duration = 0.2
    q = _start(model)
    goal, speed = _exact(model, q, duration)

    def miss(steps: int) -> np.ndarray:
        reached, v = _advance(model, q, np.zeros(model.nv), duration / steps, steps)
        return np.concatenate([pin.difference(model, goal, reached), v - speed])

    coarse, fine, finest = (float(np.linalg.norm(miss(steps))) for steps in (200, 400, 800))
    assert finest > 1e-6  # above the reference's own 1e-10, so the ratio means something
    # order 1; the second order is 1/800 of the robots' fastest rates of about 10/s
    assert coarse / fine == pytest.approx(2.0, abs=0.03)
    assert fine / finest == pytest.approx(2.0, abs=0.02)


def test_coordinates_that_are_no_vector_space_stay_where_they_belong() -> None:
    model = _robot("double_pendulum_continuous.urdf")
    assert (model.nq, model.nv) == (4, 2)
    q, _ = _advance(model, _start(model), np.zeros(2), 1e-3, 5000)
    assert_allclose(np.hypot(q[0::2], q[1::2]), 1.0, atol=1e-12)  # rounding, 5000 steps


def _energy_errors(model: pin.Model, q: np.ndarray, dt: float, duration: float) -> np.ndarray:
    first = _energy(model, q, np.zeros(model.nv))
    v = np.zeros(model.nv)
    errors = []
    for _ in range(round(duration / (10 * dt))):
        q, v = _advance(model, q, v, dt, 10)
        errors.append(_energy(model, q, v) - first)
    return np.array(errors)


@pytest.mark.slow
def test_the_energy_of_a_large_swing_ripples_but_does_not_drift() -> None:
    model = _pendulum()
    whole = np.ptp([_energy(model, np.array([angle]), np.zeros(1)) for angle in (0.0, 1.0)])
    ripples = {}
    for dt in (0.02, 0.01):
        errors = _energy_errors(model, np.array([1.0]), dt, 400.0)
        first = np.abs(np.array_split(errors, 4)[0])
        last = np.abs(np.array_split(errors, 4)[-1])
        # Both hold a dozen swings; the peak is met within ω · 10 dt squared.
        assert last.max() == pytest.approx(first.max(), rel=1e-2)
        # Order 1; explicit Euler gains ω² dt t, more than the whole.
        assert first.max() < OMEGA * dt * whole
        ripples[dt] = first.max()
    # Order 1, next order ω dt = 0.016.
    assert ripples[0.02] / ripples[0.01] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("name", ["double_pendulum_continuous.urdf", "ur5_robot.urdf"])
def test_where_inertia_depends_on_the_posture_the_energy_error_still_halves_with_the_step(
    name: str,
) -> None:
    model = _robot(name)
    hanging = pin.integrate(
        model, pin.neutral(model), np.array([math.pi] + [0.0] * (model.nv - 1)) + 0.3
    )
    coarse, fine = (
        float(np.abs(_energy_errors(model, hanging, dt, 2.5)).max()) for dt in (1e-3, 5e-4)
    )
    # Order 1; the next order is dt times rates of some 10/s.
    assert coarse / fine == pytest.approx(2.0, abs=0.1)


def test_a_step_keeps_the_area_of_the_phase_plane() -> None:
    model = _pendulum()
    dt = 0.05
    h = 1e-5

    def step(q: float, v: float) -> np.ndarray:
        return np.concatenate(_advance(model, np.array([q]), np.array([v]), dt, 1))

    columns = [
        (step(0.7 + h * a, 0.2 + h * b) - step(0.7 - h * a, 0.2 - h * b)) / (2 * h)
        for a, b in ((1, 0), (0, 1))
    ]
    # symplectic: 1 exactly; central differences leave 1e-10. Explicit Euler has 1 + (ω dt)² cos q =
    # 1.0012
    assert np.linalg.det(columns) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("dt", [0.1, 0.3])
def test_the_period_is_short_by_one_part_in_24_of_the_squared_phase_step(dt: float) -> None:
    model = _pendulum()
    q = np.array([1e-4])
    v = np.zeros(1)
    angles = []
    for _ in range(400):
        q, v = _advance(model, q, v, dt, 1)
        angles.append(q[0])
    y = np.array(angles)
    # a discrete wave: y[n+1] + y[n-1] = 2 cos(ω' dt) y[n]
    cosine = float((y[2:] + y[:-2]) @ y[1:-1] / (2.0 * y[1:-1] @ y[1:-1]))
    error = OMEGA * dt / math.acos(cosine) - 1.0
    # Finite amplitude 1e-9, acos 1e-8.
    assert error == pytest.approx(OMEGA * dt / (2.0 * math.asin(OMEGA * dt / 2.0)) - 1.0, abs=1e-7)
    # The next term is -17/5760 (ω dt)⁴.
    assert error == pytest.approx(-((OMEGA * dt) ** 2) / 24.0, abs=0.01 * (OMEGA * dt) ** 4)


def test_velocities_are_those_of_half_a_step_earlier() -> None:
    model = _pendulum()
    duration = 8.0
    amplitude = 1e-4

    def miss(steps: int) -> tuple[float, float]:
        dt = duration / steps
        lead = semi_implicit_euler.lead * dt
        first = np.array([amplitude * OMEGA * math.sin(OMEGA * lead)])
        q, v = _advance(model, np.array([amplitude]), first, dt, steps)
        speed = -amplitude * OMEGA * math.sin(OMEGA * (duration - lead))
        return abs(q[0] - amplitude * math.cos(OMEGA * duration)), abs(v[0] - speed)

    for coarse, fine in zip(miss(100), miss(200), strict=True):
        # Order 2 once the lead is allowed for; (ω dt)² = 0.004 beyond.
        assert coarse / fine == pytest.approx(4.0, abs=0.1)


def test_steps_taken_together_are_steps_taken_one_by_one() -> None:
    model = _robot("ur5_robot.urdf")
    q = _start(model)
    v = np.linspace(-1.0, 1.0, model.nv)
    together = _advance(model, q, v, 2.0**-10, 8)
    for _ in range(8):
        q, v = _advance(model, q, v, 2.0**-10, 1)
    # To the bit: the step is a power of two.
    assert [a.tolist() for a in together] == [q.tolist(), v.tolist()]


def test_what_goes_in_stays_as_it_was() -> None:
    model = _pendulum()
    q = np.array([0.3])
    v = np.array([0.1])
    _advance(model, q, v, 0.01, 5)
    assert (q.tolist(), v.tolist()) == ([0.3], [0.1])
    assert model.gravity.linear.tolist() == [0.0, 0.0, -9.81]
