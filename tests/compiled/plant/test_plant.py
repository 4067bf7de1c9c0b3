"""Cranes that count time and mass in units of their own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from cranedyn.compiled.plant.plant import Plant, Topology, make_plant, plant_numbers
from cranedyn.dynamics.contact import Ground, box_corners
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.pinocchio import body_points
from cranedyn.dynamics.scalars import array
from cranedyn.model.crane import Crane
from tests.helpers import crane

DT = 1e-3


def _answers(c: Crane, drive: str, q: np.ndarray, v: np.ndarray) -> list[list[np.ndarray]]:
    """Accelerations and efforts in SI, from a plant in SI and from one that counts in steps."""
    values = plant_numbers(c).tolist()
    if drive == "velocity":
        values += np.concatenate(converters(c).response).tolist()
    whole = make_plant(Topology.of(c), values, drive, drive == "effort")
    command = {
        "effort": np.array([3e4, -2e3, -9e3]),
        "motion": np.array([0.01, -0.3, 0.2]),
        "velocity": v[c.layout.drives] + [0.002, -0.01, 5.0],  # more than the hoist can do
    }[drive]
    force = np.tile([300.0, -200.0, 100.0], len(c.points))
    scaled, units = whole.in_steps(DT)
    found: list[list[Any]] = [
        list(whole.forward_dynamics(q, v, array(command.tolist()), array(force.tolist()))[:2]),
        list(
            scaled.forward_dynamics(
                q,
                v * units.time,
                array((command * units.command).tolist()),
                array((force * units.force).tolist()),
            )[:2]
        ),
    ]
    found[1][0] = found[1][0] / units.time**2
    found[1][1] = found[1][1] / (units.command if drive == "effort" else units.force)
    return [[part.astype(float) for part in one] for one in found]


@pytest.mark.parametrize("drive", ["effort", "motion", "velocity"])
@pytest.mark.parametrize(
    "values",
    [{}, {"hook_mass": 300.0, "sling_length": 4.0}, {"rope_stiffness": 4e7, "rope_damping": 1e4}],
)
def test_a_plant_that_counts_in_steps_and_loads_moves_the_same(
    drive: str, values: dict[str, float]
) -> None:
    c = crane(**values)
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = c.start.q + rng.normal(size=c.layout.n) * 0.1
        if drive == "effort":
            q[c.layout.drives[1]] = c.upper[c.layout.drives[1]] + 0.02  # against its buffer
        in_si, in_steps = _answers(c, drive, q, rng.normal(size=c.layout.n) * 0.3)
        for one, other in zip(in_si, in_steps, strict=True):
            assert_allclose(other, one, rtol=1e-9, atol=1e-9 * np.abs(one).max())


def test_work_and_force_have_one_unit() -> None:
    _, units = make_plant(
        Topology.of(crane()), plant_numbers(crane()).tolist(), "effort", False
    ).in_steps(DT)
    assert units.time == DT
    assert units.force == pytest.approx(DT**2 / crane().payload_mass)
    assert units.work == pytest.approx(1.0 / units.force)


def _plant_of(c: Crane, drive: str = "effort", buffers: bool = False) -> Plant:
    values = plant_numbers(c).tolist()
    if drive == "velocity":
        values += np.concatenate(converters(c).response).tolist()
    return make_plant(Topology.of(c), values, drive, buffers)


def _state(c: Crane, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return coordinates and rates that are not small, in their ranges."""
    rng = np.random.default_rng(seed)
    return c.start.q + 0.2 * rng.normal(size=c.layout.n), rng.normal(size=c.layout.n)


def test_drag_in_still_air_holds_a_load_back_and_wind_takes_it_along() -> None:
    """Half of the density of air times area times the square of the speed through it."""
    c = crane()
    made, (q, v) = _plant_of(c), _state(c)
    area = 3.0
    areas = [area, *[0.0] * (len(c.points) - 1)]
    body, lever = c.points[0].body, c.points[0].lever
    _, velocity = body_points(c.model, c.data, body, lever[None], q, v)
    speed = velocity[:, 0]
    for wind in (np.zeros(3), speed, np.array([9.0, -4.0, 0.0])):
        air = np.concatenate([wind, np.zeros(3 * len(areas) - 3)])
        through = wind - speed
        expected = 0.5 * 1.25 * area * np.linalg.norm(through) * through
        force = np.array(made.drag(q, v, air, areas), dtype=float)
        assert_allclose(force[:3], expected, rtol=1e-12, atol=1e-9)
        assert not force[3:].any()
    still = np.array(made.drag(q, v, np.zeros(3 * len(areas)), areas), dtype=float)
    assert still[:3] @ speed < 0.0


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_an_impact_takes_the_energy_that_rates_before_and_after_differ_by(drive: str) -> None:
    """Rates by Pinocchio's mass matrix: what is free keeps its momentum where the rope stops."""
    c = crane(rope_stiffness=np.inf, payload_inertia=300.0, dummy_mass=20.0)
    stretch = c.layout.index("rope_stretch")
    q, v = _state(c)
    v[stretch] = 1.7
    after, gained = _plant_of(c, drive).impact(q, v)
    data = c.model.createData()
    mass = np.triu(pin.crba(c.model, data, q))
    mass = mass + np.triu(mass, 1).T
    held = [stretch] if drive == "effort" else [stretch, *c.layout.drives.tolist()]
    free = np.delete(np.arange(c.layout.n), held)
    change = np.zeros(c.layout.n)
    change[stretch] = -v[stretch]
    change[free] = np.linalg.solve(mass[np.ix_(free, free)], -mass[free, stretch] * -v[stretch])
    assert_allclose(after.astype(float), v + change, rtol=1e-9, atol=1e-9)
    before, later = (pin.computeKineticEnergy(c.model, data, q, r) for r in (v, v + change))
    assert float(gained) == pytest.approx(later - before, rel=1e-9)
    if drive == "effort":
        assert gained < 0.0  # a drive that keeps its rate may put energy in


def test_energy_is_that_of_pinocchio_and_of_springs() -> None:
    c = crane(rope_stiffness=4e7)
    q, v = _state(c)
    q[c.layout.index("rope_stretch")] = 0.013
    data = c.model.createData()
    rigid = pin.computeKineticEnergy(c.model, data, q, v) + pin.computePotentialEnergy(
        c.model, data, q
    )
    rope = c.springs.rope
    assert rope is not None
    spring = 0.5 * rope.stiffness / q[rope.length] * 0.013**2
    assert float(_plant_of(c).energy(q, v)) == pytest.approx(rigid + spring, rel=1e-12)


def test_the_swing_of_a_pendulum_is_its_amplitude_by_energy() -> None:
    """Small angles: A² = φ² + φ̇² L / g, with L from the joint to the load."""
    c = crane()
    made = _plant_of(c)
    layout = c.layout
    q, v = c.start.q.copy(), np.zeros(layout.n)
    phi, theta, cable = (layout.index(name) for name in ("phi", "theta", "l"))
    q[phi], q[theta], q[cable], v[phi], v[theta] = 0.03, -0.02, 11.0, 0.05, 0.01
    square, amplitude = made.swing(q, v)
    assert square == pytest.approx(0.03**2 + 0.02**2)
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, np.where(np.arange(layout.n) == cable, 11.0, 0.0))
    load = data.oMi[c.payload.body + 1].act(c.payload.lever)
    lengths = {i: np.linalg.norm(load - data.oMi[i + 1].translation) for i in (phi, theta)}
    kinetic = (0.05**2 * lengths[phi] + 0.01**2 * lengths[theta]) / c.gravity
    assert amplitude == pytest.approx(square + kinetic)
    assert made.plumb_at_zero


def test_the_ground_pushes_where_the_load_touches_and_its_power_is_force_times_speed() -> None:
    c = crane(hoist_max=40.0)
    contacts = Ground(box_corners(1.5, 3.0, 1.2), friction=0.3).contacts(c)
    made = replace(_plant_of(c), contacts=contacts)
    q, v = c.start.q.copy(), 0.05 * np.random.default_rng(4).normal(size=c.layout.n)
    points = np.array(contacts.points)
    place, _ = body_points(c.model, c.data, contacts.body, points, q, v)
    q[c.layout.index("phi")] = 0.05  # so that two of them are in it, and two just above
    place, _ = body_points(c.model, c.data, contacts.body, points, q, v)
    # The lowest corner is 4 mm in the ground then.
    q[c.layout.index("l")] += (place[2].min() + 0.004) / np.cos(0.05)
    place, speed = body_points(c.model, c.data, contacts.body, points, q, v)
    assert made.touching(q) == (place[2] < 0.0).tolist()
    assert sum(made.touching(q)) == 2
    reactions, anchors = made.ground_reactions(q, v, place.T.ravel())
    power = 0.0
    for i, reaction in enumerate(reactions):
        force, moved = contacts.reaction(place[:, i], speed[:, i], place[:, i])
        assert_allclose(reaction.force.astype(float), force, atol=1e-6)
        assert_allclose(anchors[3 * i : 3 * i + 3].astype(float), moved, atol=1e-9)
        power += float(np.dot(force, speed[:, i]))
    assert float(made.power(q, v, reactions)) == pytest.approx(power, rel=1e-9)
    assert power != 0.0
    # What the forces do to the accelerations, by Pinocchio.
    found = made.forward_dynamics(q, v, array([0.0] * c.layout.m), None, reactions).acceleration
    wrenches = pin.StdVec_Force()
    pin.forwardKinematics(c.model, c.data, q)
    rotation = c.data.oMi[contacts.body + 1].rotation
    total = pin.Force.Zero()
    for point, reaction in zip(points, reactions, strict=True):
        local = rotation.T @ reaction.force.astype(float)
        total = total + pin.Force(local, np.cross(point, local))
    pushes = [pin.Force.Zero() for _ in range(c.layout.n + 1)]
    pushes[contacts.body + 1] = total
    wrenches.extend(pushes)
    effort = -c.damping * v
    expected = pin.aba(c.model, c.model.createData(), q, v, effort, wrenches)
    assert_allclose(found.astype(float), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_efforts_are_cut_to_the_limits_and_other_commands_are_not() -> None:
    c = crane()
    command = array((3.0 * c.effort_limit * [1.0, -1.0, 0.1]).tolist())
    cut = [c.effort_limit[0], -c.effort_limit[1], 0.3 * c.effort_limit[2]]
    assert_allclose(_plant_of(c).within(command).astype(float), cut)
    assert _plant_of(c, "motion").within(command) is command


def test_a_prescribed_motion_costs_what_inverse_dynamics_says() -> None:
    c = crane()
    q, v = _state(c)
    command = np.array([0.02, -0.4, 0.3])
    solved = _plant_of(c, "motion").forward_dynamics(q, v, array(command.tolist()), None)
    a = solved.acceleration.astype(float)
    assert_allclose(a[c.layout.drives], command)
    needed = pin.rnea(c.model, c.model.createData(), q, v, a) + c.damping * v
    assert_allclose(solved.effort.astype(float), needed[c.layout.drives], rtol=1e-9, atol=1e-6)
    assert_allclose(needed[c.layout.passive], 0.0, atol=1e-8 * np.abs(needed).max())
    assert solved.pull is None


def test_buffers_push_a_drive_back_into_its_range() -> None:
    """Springs and dampers at 20 rad/s, half critical: by hand 400 M and 20 M for a drive of M."""
    c = crane()
    layout, (q, v) = c.layout, _state(c, 6)
    trolley, hoist = layout.index("x"), layout.index("l")
    start = c.start.q.copy()
    start[layout.passive] = 0.0
    inertia = np.diag(pin.crba(c.model, c.data, start))
    q[trolley], v[trolley] = c.upper[trolley] + 0.03, 0.2
    q[hoist], v[hoist] = c.lower[hoist] - 0.02, -0.1
    push = np.zeros(layout.n)
    push[trolley] = -inertia[trolley] * (400.0 * 0.03 + 20.0 * 0.2)
    push[hoist] = inertia[hoist] * (400.0 * 0.02 + 20.0 * 0.1)
    made = _plant_of(c, buffers=True)
    found = made.forward_dynamics(q, v, array([0.0] * layout.m), None).acceleration
    expected = pin.aba(c.model, c.model.createData(), q, v, push - c.damping * v)
    assert_allclose(found.astype(float), expected, rtol=1e-9)
    assert float(made.stop_force(q, v)) == pytest.approx(push[hoist])
    assert _plant_of(c).stop_force(q, v) == 0.0


@pytest.mark.parametrize("drive", ["effort", "motion"])
def test_an_inextensible_rope_holds_while_it_pulls_and_falls_free_while_it_does_not(
    drive: str,
) -> None:
    """By Pinocchio's mass matrix and forces, with the stretch as one more prescribed joint."""
    c = crane(rope_stiffness=np.inf, payload_inertia=300.0, dummy_mass=20.0)
    layout = c.layout
    stretch = c.layout.index("rope_stretch")
    made = _plant_of(c, drive)
    data = c.model.createData()
    command = np.zeros(layout.m)
    hanging = 0 if drive == "motion" else -c.payload_mass * c.gravity  # nearly
    if drive == "effort":
        command[-1] = hanging
    q, v = c.start.q.copy(), np.zeros(layout.n)
    q[layout.index("phi")], v[layout.index("phi")], v[layout.index("theta")] = 0.2, 0.1, -0.1
    mass = np.triu(pin.crba(c.model, data, q))
    mass = mass + np.triu(mass, 1).T
    resisting = pin.rnea(c.model, data, q, v, np.zeros(layout.n)) + c.damping * v
    resisting[layout.drives] -= command
    for lifted in (0.0, 0.1):
        q[stretch] = -lifted
        held = [stretch] if lifted == 0.0 else []
        if drive == "motion":
            held += layout.drives.tolist()
        free = np.delete(np.arange(layout.n), held)
        if lifted > 0.0:
            mass = np.triu(pin.crba(c.model, data, q))
            mass = mass + np.triu(mass, 1).T
            resisting = pin.rnea(c.model, data, q, v, np.zeros(layout.n)) + c.damping * v
            resisting[layout.drives] -= command
        a = np.zeros(layout.n)
        a[free] = np.linalg.solve(mass[np.ix_(free, free)], -resisting[free])
        solved = made.forward_dynamics(q, v, array(command.tolist()), None)
        scale = np.abs(a).max()
        assert_allclose(solved.acceleration.astype(float), a, rtol=1e-8, atol=1e-9 * scale)
        if lifted == 0.0:
            tension = -(mass[stretch] @ a + resisting[stretch])
            assert float(solved.pull) == pytest.approx(tension)
            assert 0.7 < tension / (c.payload_mass * c.gravity) < 1.1
        else:
            assert float(solved.pull) < 0.0


def test_conditions_tell_what_the_model_does_not_hold_for() -> None:
    c = crane()
    layout = c.layout
    hoist_force = -c.payload_mass * c.gravity
    trolley, hoist = layout.index("x"), layout.index("l")

    def broken(drive: str = "effort", needed: float = 0.0, level: float = 0.0, **at: float) -> int:
        made = _plant_of(c, drive)
        if level:
            contacts = Ground(box_corners(1.0, 1.0, 1.0), height=level).contacts(c)
            made = replace(made, contacts=contacts)
        q, v = c.start.q.copy(), np.zeros(layout.n)
        q[hoist] = at.get("l", q[hoist])
        v[trolley] = at.get("x_dot", 0.0)
        efforts = np.array([0.0, needed * c.effort_limit[1], hoist_force])
        conditions = made.conditions(q, v, hoist_force, efforts)
        return sum(not bool(condition) for condition in conditions)

    fast = 1.1 * c.rate_limit[1]
    assert broken() == broken("motion") == broken("velocity") == 0
    assert broken(x_dot=0.9 * c.rate_limit[1]) == 0
    assert broken(x_dot=fast) == broken("motion", x_dot=fast) == broken("motion", x_dot=-fast) == 1
    assert broken("velocity", x_dot=1.01 * c.rate_limit[1]) == 0
    assert broken("motion", needed=1.1) == broken("motion", needed=-1.1) == 1
    assert broken("motion", needed=0.9) == broken("effort", needed=1.1) == 0
    # The load hangs at a height of its own: a ground above it is broken through.
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, c.start.q)
    height = float(data.oMi[c.payload.body + 1].act(c.payload.lever)[2])
    assert broken(level=height - 0.01) == 0
    assert broken(level=height + 0.01) == 1


def test_a_load_that_hangs_askew_swings_about_where_it_hangs() -> None:
    c = crane()
    made = _plant_of(c)
    angle = np.array([0.02, -0.03])
    slope = np.array([[0.0, 1e-3, 2e-3], [4e-3, 0.0, -1e-3]])
    askew = replace(made, rest_angle=angle, rest_slope=slope)
    q = c.start.q.copy()
    q[c.layout.drives] = 0.5, 8.0, 12.0
    hanging = [0.02 + 8e-3 + 24e-3, -0.03 + 2e-3 - 12e-3]
    assert_allclose(askew.hanging_angles(q[c.layout.drives]), hanging)
    phi, theta = c.swings.tolist()
    q[phi], q[theta] = 0.1, 0.2
    assert askew.swing_angles(q) == pytest.approx({phi: 0.1 - hanging[0], theta: 0.2 - hanging[1]})
    assert made.plumb_at_zero and not askew.plumb_at_zero


def test_arms_reach_from_the_joint_of_each_swing_to_the_load() -> None:
    c = crane(hook_mass=300.0, sling_length=4.0)
    made = _plant_of(c)
    arms = dict(zip(c.swings.tolist(), made.arms.tolist(), strict=True))
    data = c.model.createData()
    pin.forwardKinematics(c.model, data, np.zeros(c.layout.n))
    load = data.oMi[c.payload.body + 1].act(c.payload.lever)
    for joint, arm in arms.items():
        name = c.layout.joints[joint].name
        pivot = data.oMi[c.model.getJointId(name)].translation
        assert arm == pytest.approx(np.linalg.norm(load - pivot)), name
    assert min(arms.values()) == pytest.approx(4.0)
