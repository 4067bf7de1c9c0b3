"""The plant that compiled code is generated from, beside Pinocchio and closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled.plant.plant import Plant, Topology, make_plant, plant_numbers
from cranedyn.dynamics.contact import Contacts, Ground, box_corners
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.equations_of_motion import body_points
from cranedyn.dynamics.scalars import array
from cranedyn.model.crane import Crane
from tests.helpers import crane

DT = 1e-3
"""Step of the plants that count time in steps [s]."""

AIR_DENSITY = 1.25
"""Density of air by which the drag is judged [kg/m³]."""


def _plant_of(c: Crane, drive: str = "effort", buffers: bool = False) -> Plant:
    """Return the plant of a crane in SI units."""
    values = plant_numbers(c).tolist()
    if drive == "velocity":
        values += np.concatenate(converters(c).response).tolist()
    return make_plant(Topology.of(c), values, drive, buffers)


def _state(c: Crane, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and rates that are not small, in their ranges."""
    rng = np.random.default_rng(seed)
    q = c.start.q + 0.2 * rng.normal(size=c.layout.n)
    v = rng.normal(size=c.layout.n)
    return q, v


def _scalars(values: np.ndarray) -> np.ndarray:
    """Return an array of Python floats, as the plant takes it."""
    return array(values.tolist())


def _mass_matrix(c: Crane, q: np.ndarray) -> np.ndarray:
    """Return the mass matrix by Pinocchio, which fills the upper triangle only."""
    upper = np.triu(pin.crba(c.model, c.model.createData(), q))
    return upper + np.triu(upper, 1).T


def _load_position(c: Crane, data: pin.Data) -> np.ndarray:
    """Return where the load is, after forward kinematics into `data`."""
    return data.oMi[c.payload.body + 1].act(c.payload.lever)


def _kinetic_energy(c: Crane, q: np.ndarray, v: np.ndarray) -> float:
    return pin.computeKineticEnergy(c.model, c.model.createData(), q, v)


def _result_in_si(made: Plant, command: np.ndarray, force: np.ndarray, *state: np.ndarray) -> Any:
    """Return accelerations and efforts of a plant in SI units."""
    result = made.forward_dynamics(*state, _scalars(command), _scalars(force))
    return result.acceleration.astype(float), result.effort.astype(float)


def _result_in_steps(
    made: Plant, command: np.ndarray, force: np.ndarray, q: np.ndarray, v: np.ndarray
) -> Any:
    """Return the same, computed in steps and loads and turned back into SI units."""
    scaled, units = made.in_steps(DT)
    result = scaled.forward_dynamics(
        q, v * units.time, _scalars(command * units.command), _scalars(force * units.force)
    )
    acceleration = result.acceleration / units.time**2
    effort_unit = units.command if made.drive == "effort" else units.force
    effort = result.effort / effort_unit
    return acceleration.astype(float), effort.astype(float)


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
@pytest.mark.parametrize(
    "values",
    [{}, {"hook_mass": 300.0, "sling_length": 4.0}, {"rope_stiffness": 4e7, "rope_damping": 1e4}],
)
def test_a_plant_that_counts_in_steps_and_loads_moves_the_same(
    drive: str, values: dict[str, float]
) -> None:
    c = crane(**values)
    made = _plant_of(c, drive, buffers=drive == "effort")
    trolley = c.layout.index("x")
    force = np.tile([300.0, -200.0, 100.0], len(c.points))
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = c.start.q + rng.normal(size=c.layout.n) * 0.1
        if drive == "effort":
            q[trolley] = c.upper[trolley] + 0.02  # against its buffer
        v = rng.normal(size=c.layout.n) * 0.3
        command = {
            "effort": np.array([3e4, -2e3, -9e3]),
            "motion": np.array([0.01, -0.3, 0.2]),
            "velocity": v[c.layout.drives] + [0.002, -0.01, 5.0],  # more than the hoist can do
        }[drive]

        in_si = _result_in_si(made, command, force, q, v)
        in_steps = _result_in_steps(made, command, force, q, v)

        for one, other in zip(in_si, in_steps, strict=True):
            assert_allclose(other, one, rtol=1e-9, atol=1e-9 * np.abs(one).max())


def test_work_and_force_have_one_unit() -> None:
    _, units = make_plant(
        Topology.of(crane()), plant_numbers(crane()).tolist(), "effort", False
    ).in_steps(DT)
    assert units.time == DT
    assert units.force == pytest.approx(DT**2 / crane().payload_mass)
    assert units.work == pytest.approx(1.0 / units.force)


def test_drag_in_still_air_holds_a_load_back_and_wind_takes_it_along() -> None:
    """Half of the density of air times area times the square of the speed through it."""
    c = crane()
    made = _plant_of(c)
    q, v = _state(c)
    load = c.points[0]
    _, velocities = body_points(c.model, c.data, load.body, load.lever[None], q, v)
    speed = velocities[:, 0]
    count = len(c.points)
    area = 3.0
    areas = [area] + [0.0] * (count - 1)

    def drag(wind_at_load: np.ndarray) -> np.ndarray:
        wind = np.zeros(3 * count)
        wind[:3] = wind_at_load
        return np.array(made.drag(q, v, wind, areas), dtype=float)

    still_air = np.zeros(3)
    for wind in (still_air, speed, np.array([9.0, -4.0, 0.0])):
        through = wind - speed
        expected = 0.5 * AIR_DENSITY * area * np.linalg.norm(through) * through
        force = drag(wind)
        assert_allclose(force[:3], expected, rtol=1e-12, atol=1e-9)
        assert not force[3:].any()
    assert drag(still_air)[:3] @ speed < 0.0


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_an_impact_takes_the_energy_that_rates_before_and_after_differ_by(drive: str) -> None:
    """Rates by Pinocchio's mass matrix: what is free keeps its momentum where the rope stops."""
    c = crane(rope_stiffness=np.inf, payload_inertia=300.0, dummy_mass=20.0)
    stretch = c.layout.index("rope_stretch")
    q, v = _state(c)
    v[stretch] = 1.7

    after, gained = _plant_of(c, drive).impact(q, v)

    # The stretch stops; drives of prescribed motion keep their rates.
    held = [stretch]
    if drive == "motion":
        held += c.layout.drives.tolist()
    free = np.delete(np.arange(c.layout.n), held)
    mass = _mass_matrix(c, q)
    change = np.zeros(c.layout.n)
    change[stretch] = -v[stretch]
    momentum = -mass[free, stretch] * change[stretch]
    change[free] = np.linalg.solve(mass[np.ix_(free, free)], momentum)
    assert_allclose(after.astype(float), v + change, rtol=1e-9, atol=1e-9)
    energy_gain = _kinetic_energy(c, q, v + change) - _kinetic_energy(c, q, v)
    assert float(gained) == pytest.approx(energy_gain, rel=1e-9)
    if drive == "effort":
        assert gained < 0.0  # a drive that keeps its rate may put energy in


def test_energy_is_that_of_pinocchio_and_of_springs() -> None:
    c = crane(rope_stiffness=4e7)
    q, v = _state(c)
    stretch = 0.013
    q[c.layout.index("rope_stretch")] = stretch
    rope = c.springs.rope
    assert rope is not None

    energy = float(_plant_of(c).energy(q, v))

    kinetic = _kinetic_energy(c, q, v)
    potential = pin.computePotentialEnergy(c.model, c.model.createData(), q)
    spring = 0.5 * rope.stiffness / q[rope.length] * stretch**2
    assert energy == pytest.approx(kinetic + potential + spring, rel=1e-12)


def test_the_swing_of_a_pendulum_is_its_amplitude_by_energy() -> None:
    """Small angles: A² = φ² + φ̇² L / g, with L from the joint to the load."""
    c = crane()
    made = _plant_of(c)
    layout = c.layout
    phi = layout.index("phi")
    theta = layout.index("theta")
    cable = layout.index("l")
    q = c.start.q.copy()
    q[phi] = 0.03
    q[theta] = -0.02
    q[cable] = 11.0
    v = np.zeros(layout.n)
    v[phi] = 0.05
    v[theta] = 0.01

    square, amplitude = made.swing(q, v)

    assert square == pytest.approx(0.03**2 + 0.02**2)
    hanging = np.zeros(layout.n)
    hanging[cable] = 11.0
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, hanging)
    load = _load_position(c, data)
    phi_length = np.linalg.norm(load - data.oMi[phi + 1].translation)
    theta_length = np.linalg.norm(load - data.oMi[theta + 1].translation)
    kinetic = (0.05**2 * phi_length + 0.01**2 * theta_length) / c.gravity
    assert amplitude == pytest.approx(square + kinetic)
    assert made.plumb_at_zero


def _partly_in_ground(c: Crane, contacts: Contacts, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a state of which the load leans by 0.05 rad and has its lowest corner this deep in the
    ground [m]: two corners are in it, and two just above.
    """
    lean = 0.05
    q = c.start.q.copy()
    q[c.layout.index("phi")] = lean
    v = 0.05 * np.random.default_rng(4).normal(size=c.layout.n)
    corners, _ = body_points(c.model, c.data, contacts.body, np.array(contacts.points), q, v)
    height = corners[2].min()
    q[c.layout.index("l")] += (height + depth) / np.cos(lean)
    return q, v


def _acceleration_under(
    c: Crane, contacts: Contacts, q: np.ndarray, v: np.ndarray, forces: Sequence[np.ndarray]
) -> np.ndarray:
    """Return accelerations under forces on the contact points [N, world frame], by Pinocchio."""
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, q)
    joint = contacts.body + 1
    rotation = data.oMi[joint].rotation
    wrench = pin.Force.Zero()
    for point, force in zip(contacts.points, forces, strict=True):
        local = rotation.T @ force
        wrench = wrench + pin.Force(local, np.cross(point, local))
    wrenches = [pin.Force.Zero() for _ in range(c.layout.n + 1)]
    wrenches[joint] = wrench
    listed = pin.StdVec_Force()
    listed.extend(wrenches)
    return pin.aba(c.model, c.model.createData(), q, v, -c.damping * v, listed)


def test_the_ground_pushes_where_the_load_touches_and_its_power_is_force_times_speed() -> None:
    c = crane(hoist_max=40.0)
    contacts = Ground(box_corners(1.5, 3.0, 1.2), friction=0.3).contacts(c)
    made = replace(_plant_of(c), contacts=contacts)
    q, v = _partly_in_ground(c, contacts, depth=0.004)
    corners, speeds = body_points(c.model, c.data, contacts.body, np.array(contacts.points), q, v)

    reactions, anchors = made.ground_reactions(q, v, corners.T.ravel())

    assert made.touching(q) == (corners[2] < 0.0).tolist()
    assert sum(made.touching(q)) == 2
    power = 0.0
    for i, reaction in enumerate(reactions):
        force, anchor = contacts.reaction(corners[:, i], speeds[:, i], corners[:, i])
        assert_allclose(reaction.force.astype(float), force, atol=1e-6)
        assert_allclose(anchors[3 * i : 3 * i + 3].astype(float), anchor, atol=1e-9)
        power += float(np.dot(force, speeds[:, i]))
    assert float(made.power(q, v, reactions)) == pytest.approx(power, rel=1e-9)
    assert power != 0.0
    no_command = array([0.0] * c.layout.m)
    found = made.forward_dynamics(q, v, no_command, None, reactions).acceleration
    forces = [reaction.force.astype(float) for reaction in reactions]
    expected = _acceleration_under(c, contacts, q, v, forces)
    assert_allclose(found.astype(float), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_efforts_are_cut_to_the_limits_and_other_commands_are_not() -> None:
    c = crane()
    slew, trolley, hoist = c.effort_limit
    command = array([3.0 * slew, -3.0 * trolley, 0.3 * hoist])
    saturated = _plant_of(c).within(command)
    assert_allclose(saturated.astype(float), [slew, -trolley, 0.3 * hoist])
    assert _plant_of(c, "motion").within(command) is command


def test_a_prescribed_motion_costs_what_inverse_dynamics_says() -> None:
    c = crane()
    q, v = _state(c)
    command = np.array([0.02, -0.4, 0.3])

    solved = _plant_of(c, "motion").forward_dynamics(q, v, _scalars(command), None)

    a = solved.acceleration.astype(float)
    assert_allclose(a[c.layout.drives], command)
    needed = pin.rnea(c.model, c.model.createData(), q, v, a) + c.damping * v
    assert_allclose(solved.effort.astype(float), needed[c.layout.drives], rtol=1e-9, atol=1e-6)
    assert_allclose(needed[c.layout.passive], 0.0, atol=1e-8 * np.abs(needed).max())
    assert solved.pull is None


def test_buffers_push_a_drive_back_into_its_range() -> None:
    """Springs and dampers at 20 rad/s, half critical: by hand 400 M and 20 M for a drive of M."""
    c = crane()
    layout = c.layout
    trolley = layout.index("x")
    hoist = layout.index("l")
    hanging = c.start.q.copy()
    hanging[layout.passive] = 0.0
    inertia = np.diag(pin.crba(c.model, c.data, hanging))
    q, v = _state(c, 6)
    q[trolley] = c.upper[trolley] + 0.03
    v[trolley] = 0.2
    q[hoist] = c.lower[hoist] - 0.02
    v[hoist] = -0.1
    push = np.zeros(layout.n)
    push[trolley] = -inertia[trolley] * (400.0 * 0.03 + 20.0 * 0.2)
    push[hoist] = inertia[hoist] * (400.0 * 0.02 + 20.0 * 0.1)
    made = _plant_of(c, buffers=True)

    found = made.forward_dynamics(q, v, array([0.0] * layout.m), None).acceleration

    expected = pin.aba(c.model, c.model.createData(), q, v, push - c.damping * v)
    assert_allclose(found.astype(float), expected, rtol=1e-9)
    assert float(made.stop_force(q, v)) == pytest.approx(push[hoist])
    without_buffers = _plant_of(c)
    assert without_buffers.stop_force(q, v) == 0.0


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_an_inextensible_rope_holds_while_it_pulls_and_falls_free_while_it_does_not(
    drive: str,
) -> None:
    """By Pinocchio's mass matrix and forces, with the stretch as one more prescribed joint."""
    c = crane(rope_stiffness=np.inf, payload_inertia=300.0, dummy_mass=20.0)
    layout = c.layout
    stretch = layout.index("rope_stretch")
    weight = c.payload_mass * c.gravity
    made = _plant_of(c, drive)
    command = np.zeros(layout.m)
    if drive == "effort":
        command[-1] = -weight  # nearly what holds the load
    q = c.start.q.copy()
    q[layout.index("phi")] = 0.2
    v = np.zeros(layout.n)
    v[layout.index("phi")] = 0.1
    v[layout.index("theta")] = -0.1
    for lifted in (0.0, 0.1):
        q[stretch] = -lifted

        solved = made.forward_dynamics(q, v, _scalars(command), None)

        # M a + resisting = 0 in the joints that are free; the others do not accelerate.
        held = [stretch] if lifted == 0.0 else []
        if drive == "motion":
            held += layout.drives.tolist()
        free = np.delete(np.arange(layout.n), held)
        mass = _mass_matrix(c, q)
        bias = pin.rnea(c.model, c.model.createData(), q, v, np.zeros(layout.n))
        resisting = bias + c.damping * v
        resisting[layout.drives] -= command
        a = np.zeros(layout.n)
        a[free] = np.linalg.solve(mass[np.ix_(free, free)], -resisting[free])
        scale = np.abs(a).max()
        assert_allclose(solved.acceleration.astype(float), a, rtol=1e-8, atol=1e-9 * scale)
        if lifted == 0.0:
            tension = -(mass[stretch] @ a + resisting[stretch])
            assert float(solved.pull) == pytest.approx(tension)
            assert 0.7 < tension / weight < 1.1
        else:
            assert float(solved.pull) < 0.0


def test_conditions_tell_what_the_model_does_not_hold_for() -> None:
    c = crane()
    trolley = c.layout.index("x")
    hoist_force = -c.payload_mass * c.gravity

    def broken(
        drive: str = "effort",
        trolley_rate: float = 0.0,
        needed_share: float = 0.0,
        ground_height: float | None = None,
    ) -> int:
        """Return how many conditions do not hold at the start of the crane.

        Args:
            drive: Kind of the commands.
            trolley_rate: Rate of the trolley [m/s].
            needed_share: Force that the trolley needs, as a share of what its drive has.
            ground_height: Height of a ground [m]; None for none.
        """
        made = _plant_of(c, drive)
        if ground_height is not None:
            ground = Ground(box_corners(1.0, 1.0, 1.0), height=ground_height)
            made = replace(made, contacts=ground.contacts(c))
        v = np.zeros(c.layout.n)
        v[trolley] = trolley_rate
        efforts = np.array([0.0, needed_share * c.effort_limit[1], hoist_force])
        conditions = made.conditions(c.start.q, v, hoist_force, efforts)
        return sum(not bool(condition) for condition in conditions)

    assert broken("effort") == 0
    assert broken("motion") == 0
    assert broken("velocity") == 0

    # A drive that is faster than it can be; frequency converters keep to their rates themselves.
    limit = c.rate_limit[1]
    assert broken("effort", trolley_rate=0.9 * limit) == 0
    assert broken("effort", trolley_rate=1.1 * limit) == 1
    assert broken("motion", trolley_rate=1.1 * limit) == 1
    assert broken("motion", trolley_rate=-1.1 * limit) == 1
    assert broken("velocity", trolley_rate=1.01 * limit) == 0

    # A prescribed motion that takes more than the drive has; efforts are limited by themselves.
    assert broken("motion", needed_share=0.9) == 0
    assert broken("motion", needed_share=1.1) == 1
    assert broken("motion", needed_share=-1.1) == 1
    assert broken("effort", needed_share=1.1) == 0

    # A load below the ground.
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, c.start.q)
    load_height = float(_load_position(c, data)[2])
    assert broken(ground_height=load_height - 0.01) == 0
    assert broken(ground_height=load_height + 0.01) == 1


def test_a_load_that_hangs_askew_swings_about_where_it_hangs() -> None:
    c = crane()
    plumb = _plant_of(c)
    angle = np.array([0.02, -0.03])
    slope = np.array([[0.0, 1e-3, 2e-3], [4e-3, 0.0, -1e-3]])
    askew = replace(plumb, rest_angle=angle, rest_slope=slope)
    phi, theta = c.swings.tolist()
    q = c.start.q.copy()
    q[c.layout.drives] = [0.5, 8.0, 12.0]
    q[phi] = 0.1
    q[theta] = 0.2

    hanging = askew.hanging_angles(q[c.layout.drives])
    swing = askew.swing_angles(q)

    expected = [0.02 + 8e-3 + 24e-3, -0.03 + 2e-3 - 12e-3]
    assert_allclose(hanging, expected)
    assert swing == pytest.approx({phi: 0.1 - expected[0], theta: 0.2 - expected[1]})
    assert plumb.plumb_at_zero
    assert not askew.plumb_at_zero


def test_arms_reach_from_the_joint_of_each_swing_to_the_load() -> None:
    c = crane(hook_mass=300.0, sling_length=4.0)
    arms = _plant_of(c).arms.tolist()
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, np.zeros(c.layout.n))
    load = _load_position(c, data)
    for joint, arm in zip(c.swings.tolist(), arms, strict=True):
        name = c.layout.joints[joint].name
        pivot = data.oMi[c.model.getJointId(name)].translation
        assert arm == pytest.approx(np.linalg.norm(load - pivot)), name
    assert min(arms) == pytest.approx(4.0)
