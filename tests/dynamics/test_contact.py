"""Contact of the load with ground and platforms; closed forms stand in experiment validate."""

from __future__ import annotations

import itertools
import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from cranedyn.controllers.hold import zero_command
from cranedyn.data.trajectory import Trajectory
from cranedyn.dynamics.contact import (
    OFF_LEAD,
    ON_GROUND,
    Ground,
    Hull,
    Platform,
    box_corners,
    box_load,
    damping_ratio,
    ground_phases,
    standing,
)
from cranedyn.dynamics.equations_of_motion import body_points, payload_position
from cranedyn.dynamics.integrators import rk4, semi_implicit_euler
from cranedyn.dynamics.joint_forces import SLACK, TAUT, JointForces
from cranedyn.dynamics.validity import events
from cranedyn.errors import CraneError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.validate.bench import MASS
from experiments.validate.bench import G as GRAVITY
from experiments.validate.box_on_ground import HEIGHT, SINK, WIDTH, free_box
from tests.helpers import FAST, constant, crane

pytestmark = pytest.mark.usefixtures("oracle")

CORNERS = box_corners(WIDTH, WIDTH, HEIGHT)
SIDES = (1.5, 3.0, 1.2)


def slid(duration: float, force: float = 0.0, **options: Any) -> Trajectory:
    box = free_box()
    ground = options.pop("ground", Ground(CORNERS, sink=SINK))
    start = {"z": HEIGHT / 2.0 - SINK} | options.pop("start", {})
    return simulate(
        box,
        options.pop("controller", constant(force)),
        start=box.state(**start),
        duration=duration,
        ground=ground,
        validity="mark",
        engine=options.pop("engine", FAST),
        **options,
    )


def unexplained(run: Trajectory) -> np.ndarray:
    gained = run.energy - run.energy[0]
    return gained - (run.work.sum(axis=1) - run.dissipated + run.outside.sum(axis=1))


@pytest.mark.parametrize("rule", [rk4, semi_implicit_euler], ids=lambda rule: rule.name)
@pytest.mark.slow
def test_both_engines_let_a_box_fall_tip_and_slide_alike(rule: Any) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    ground = Ground(CORNERS, (Platform((2.0, 0.0), (1.0, 2.0), 0.5, 0.2),), 0.1)
    start = {"z": HEIGHT / 2.0 + 0.1, "p": 0.1, "x_dot": 3.0}
    options = {"start": start, "ground": ground, "integrator": rule, "dt": 1e-3}
    plain, compiled = (slid(0.8, engine=name, **options) for name in ("oracle", "compiled"))
    ahead = slid(0.8, engine="compiled", controller=zero_command(free_box()), **options)
    for run in (compiled, ahead):
        assert np.allclose(run.q, plain.q, rtol=0.0, atol=1e-9)
        assert np.allclose(run.outside, plain.outside, rtol=0.0, atol=1e-4)
    assert plain.outside[-1, 1] < -1000.0


def test_the_ledger_of_a_falling_box_closes_with_the_step_and_no_energy_comes_from_nowhere() -> (
    None
):
    fall = partial(slid, 1.0, start={"z": HEIGHT / 2.0 + 0.2, "p": 0.2, "x_dot": 1.0})
    coarse, fine = (np.abs(unexplained(fall(dt=dt))).max() for dt in (2.5e-4, 1.25e-4))
    assert fine < 0.6 * coarse
    elastic = Ground(CORNERS, restitution=1.0, friction=0.0)
    bounces = [fall(dt=dt, ground=elastic).energy for dt in (2.5e-4, 1.25e-4)]
    gains = [(energy.max() - energy[0]) / np.ptp(energy) for energy in bounces]
    assert gains[1] < 0.6 * gains[0] < 1e-3


def test_a_box_tips_where_a_push_at_its_centre_is_half_the_weight() -> None:
    sinking = math.asin(2.0 * SINK / WIDTH)  # of the edge when the other is free
    critical = MASS * GRAVITY * math.tan(math.atan(WIDTH / HEIGHT) - sinking)
    ground = Ground(CORNERS, friction=0.9, sink=SINK)

    def pushed(t: float, *_: object, force: float) -> np.ndarray:
        return np.array([force * min(t / 2.0, 1.0)])

    below, above = (
        slid(5.0, controller=partial(pushed, force=share * critical), ground=ground)["p_rad"][-1]
        for share in (0.995, 1.005)
    )
    assert below < 1.5 * sinking
    assert above > 3.0 * sinking


def test_a_box_is_stopped_by_the_side_of_a_platform_and_stands_on_its_top() -> None:
    platform = Platform((2.0, 0.0), (2.0, 4.0), 3.0)
    ground = Ground(CORNERS, (platform,), friction=0.0, sink=SINK)
    assert slid(2.0, ground=ground, start={"x_dot": 1.0})["x_m"].max() < 0.5 + 0.02
    above = slid(1.0, ground=ground, start={"x": 2.0, "z": 3.0 + HEIGHT / 2.0})
    assert above["z_m"][-1] == pytest.approx(3.0 + HEIGHT / 2.0 - SINK, abs=1e-9)


@pytest.mark.slow
def test_a_load_stands_below_a_slack_rope_until_it_is_lifted() -> None:
    values = {"rope_stiffness": 2e7, "rope_damping": 2e4, "hoist_max": 30.0}
    tower = crane(**box_load(MASS, *SIDES), **values)
    ground = Ground(box_corners(*SIDES))
    start = standing(tower, ground, tower.state(l=26.9, phi=0.0))
    assert payload_position(tower, start.q)[2] == pytest.approx(0.6 - ground.sink, abs=1e-12)
    run = simulate(
        tower,
        lambda t, state, setpoint: np.array([0.0, 0.0, -0.2 - state.v[4]]),
        start=start,
        duration=2.0,
        drive="motion",
        engine=FAST,
        ground=ground,
    )
    pull = JointForces.of(tower).tension(run.q.T, run.v.T) / (MASS * GRAVITY)
    assert pull[0] == 0.0
    assert payload_position(tower, run.q[20])[2] == pytest.approx(0.6 - ground.sink, abs=1e-6)
    assert pull[-1] == pytest.approx(1.0, abs=0.05)
    assert payload_position(tower, run.q[-1])[2] > 0.7


@pytest.mark.slow
def test_both_engines_lift_a_load_off_lead_by_frequency_converters_alike() -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    tower = crane(**box_load(MASS, *SIDES), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(*SIDES))
    start = standing(tower, ground, tower.state(l=26.83))
    common = {"start": start, "duration": 1.0, "drive": "velocity", "ground": ground}
    rates = constant(0.02, 0.3, -0.3)
    plain, compiled = (simulate(tower, rates, engine=e, **common) for e in ("oracle", "compiled"))
    assert {*plain.phase.tolist()} == {0.0, 2.0, 3.0}
    assert np.array_equal(plain.phase, compiled.phase)
    assert np.allclose(plain.q, compiled.q, rtol=0.0, atol=1e-9)
    assert np.allclose(plain.effort, compiled.effort, rtol=1e-6, atol=1e-3)
    assert np.allclose(plain.work, compiled.work, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_cranes_of_a_batch_touch_the_ground_each_on_its_own() -> None:
    batch = pytest.importorskip("cranedyn.compiled.batch", reason="needs the extra compiled")
    box = free_box()
    ground = Ground(CORNERS, friction=0.2)
    starts = [box.state(z=1.0 + height, x_dot=1.0, p=0.1 * height) for height in (0.1, 0.3, 5.0)]
    common = {"duration": 0.6, "dt": 5e-4, "control_period": 5e-3, "ground": ground}
    end = batch.simulate_batch(box, zero_command(box), start=starts, **common).end
    for row, start in enumerate(starts):
        run = slid(
            0.6,
            ground=ground,
            controller=zero_command(box),
            start=dict(zip("xzp", start.q, strict=True)) | {"x_dot": 1.0},
        )
        assert np.allclose(end.q[row], run.q[-1], rtol=0.0, atol=1e-9)


def test_a_load_without_restitution_stays_where_it_falls() -> None:
    def highest(restitution: float) -> float:
        ground = Ground(CORNERS, restitution=restitution, sink=SINK)
        bottom = slid(1.0, ground=ground, start={"z": HEIGHT / 2.0 + 1.0})["z_m"] - HEIGHT / 2.0
        return float(bottom[np.flatnonzero(bottom < 0.0)[0] :].max())

    assert highest(0.0) < 0.0 < 0.01 < highest(0.2)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["oracle", "compiled"])
def test_the_ground_is_at_any_height_and_a_hull_is_like_the_platform_of_its_corners(
    engine: Any,
) -> None:
    if engine == "compiled":
        pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    low = -3.0
    box = Platform((2.0, 0.0), (1.0, 2.0), -2.5, 0.2)
    x, y = box.centre
    corners = [[a, b] for a in (-0.5, 0.5) for b in (-1.0, 1.0)]
    turn = np.array([[math.cos(0.2), math.sin(0.2)], [-math.sin(0.2), math.cos(0.2)]])
    hull = Hull([[*row, z] for row in np.array(corners) @ turn + [x, y] for z in (low, -2.5)])
    start = {"z": low + HEIGHT / 2.0 + 0.1, "p": 0.1, "x_dot": 3.0}
    runs = [
        slid(0.6, engine=engine, start=start, ground=Ground(CORNERS, (support,), 0.1, height=low))
        for support in (box, hull)
    ]
    assert runs[0]["z_m"].min() > low and runs[0]["x_m"].max() < 2.0
    assert np.allclose(runs[0].q, runs[1].q, rtol=0.0, atol=1e-6)  # normals are rounded at 1e-9
    assert all((run.valid == 1.0).all() for run in runs)
    leaves = slid(
        0.05, engine=engine, start=start | {"x": 99.9}, ground=Ground(CORNERS, height=low)
    )
    assert [event.joint for event in events(free_box(), leaves)] == ["x"]


def test_a_load_that_starts_in_the_ground_is_refused() -> None:
    with pytest.raises(CraneError, match="in the ground"):
        slid(0.1, start={"z": 0.9})


@pytest.mark.slow
@pytest.mark.parametrize("engine", [pytest.param("oracle", marks=pytest.mark.long), "compiled"])
def test_a_box_stands_and_slides_on_a_seam_of_two_platforms_as_on_one(engine: Any) -> None:
    if engine == "compiled":
        pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    seam = WIDTH / 2.0  # below the corners of a box that stands in the middle
    one = (Platform((0.0, 0.0), (8.0, 4.0), 2.0),)
    for speed, overlap in ((0.0, 0.0), (1.0, 0.0), (1.0, 1e-3), (0.0, 0.5)):
        two = [Platform((seam + x, 0.0), (8.0 + overlap, 4.0), 2.0) for x in (-4.0, 4.0)]
        start = {"x": -0.3 * speed, "x_dot": speed, "z": 2.0 + HEIGHT / 2.0 - SINK}
        whole, parts = (
            slid(0.5, start=start, ground=Ground(CORNERS, tops, 0.05, sink=SINK), engine=engine)
            for tops in (one, two)
        )
        assert np.allclose(parts.q, whole.q, rtol=0.0, atol=1e-9)


# A load with four points at the height of its centre: forces of the ground do not tilt it.
FLAT = tuple((x, y, 0.0) for x in (-0.5, 0.5) for y in (-0.5, 0.5))
OMEGA = math.sqrt(GRAVITY / SINK)
"""Frequency of a load on the springs of its four points [rad/s]."""


def test_friction_that_sticks_is_a_critically_damped_spring() -> None:
    """A push within the cone moves the load by F / (m ω²) (1 - (1 + ω t) exp(-ω t))."""
    force = 0.5 * 0.4 * MASS * GRAVITY
    ground = Ground(FLAT, friction=0.4, sink=SINK)
    dt = 2e-5
    run = slid(0.08, force, ground=ground, start={"z": -SINK}, dt=dt, control_period=1e-3,
               integrator=rk4)  # fmt: skip
    x = OMEGA * run.t
    closed = force / (MASS * OMEGA**2) * (1.0 - (1.0 + x) * np.exp(-x))
    # Anchors are kept for each step, which costs a share of the order of ω dt = 0.0014.
    assert np.abs(run["x_m"] - closed).max() < 5e-3 * closed[-1]


def test_the_spring_of_a_sliding_point_carries_what_its_damper_leaves_of_the_friction() -> None:
    """Both act side by side and make up the friction: a point that stops at once is held by
    μ N - c v, and by μ N where it went on.
    """
    contacts = Ground(FLAT, friction=0.4, sink=SINK).contacts(free_box())
    stiffness = MASS / 4.0 * OMEGA**2
    slip_damping = 2.0 * MASS / 4.0 * OMEGA
    assert (contacts.stiffness, contacts.slip_damping) == pytest.approx((stiffness, slip_damping))
    depth = 0.003
    speed = 0.02
    limit = 0.4 * stiffness * depth
    damped = slip_damping * speed
    assert 0.2 * limit < damped < 0.8 * limit
    place = [1.0, 2.0, -depth]
    anchor = [0.9, 2.0, 0.0]
    force, moved = contacts.reaction(place, [speed, 0.0, 0.0], anchor)
    assert force == pytest.approx([-limit, 0.0, stiffness * depth])
    assert contacts.reaction(place, [speed, 0.0, 0.0], moved)[0] == pytest.approx(force)
    stopped, still = contacts.reaction(place, [0.0, 0.0, 0.0], moved)
    assert stopped == pytest.approx([-(limit - damped), 0.0, stiffness * depth])
    assert still == moved  # it sticks
    assert place[0] - moved[0] == pytest.approx((limit - damped) / stiffness)


def test_a_point_in_the_air_feels_nothing_and_one_that_leaves_fast_is_not_pulled() -> None:
    contacts = Ground(FLAT, friction=0.4, restitution=0.2, sink=SINK).contacts(free_box())
    assert contacts.reaction([0.0, 0.0, 1e-9], [1.0, 0.0, -9.0], [0.5, 0.0, 0.0]) == (
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 1e-9],
    )
    ratio = damping_ratio(0.2)
    mass = MASS / 4.0
    depth = 0.003
    for rate in (-0.1, 0.05, 0.5):
        push = mass * (OMEGA**2 * depth - 2.0 * ratio * OMEGA * rate)
        force, _ = contacts.reaction([0.0, 0.0, -depth], [0.0, 0.0, rate], [0.0, 0.0, 0.0])
        assert force == pytest.approx([0.0, 0.0, max(push, 0.0)])
        assert (push < 0.0) == (rate == 0.5)


def test_a_taut_rope_that_leans_lifts_off_lead_and_so_does_a_load_that_slides() -> None:
    """By more than one degree, or 10 mm/s of a point that touches."""
    tower = crane(**box_load(MASS, *SIDES), rope_stiffness=2e7, hoist_max=30.0)
    ground = Ground(box_corners(*SIDES))
    contacts = ground.contacts(tower)
    layout = tower.layout
    points = np.array(contacts.points)
    q = []
    v = []
    for lean, speed in ((0.5, 0.0), (1.5, 0.0), (-1.5, 0.0), (0.5, 0.02), (0.5, 0.005)):
        angle = math.radians(lean)
        state = standing(tower, ground, tower.state(l=26.0, phi=angle, sling_radial=-angle))
        q.append(state.q)
        v.append(0.0 * state.v)
        v[-1][layout.index("x")] = speed
    # It tips about its lower edges, which stand: the corners in the air do not slide.
    q.append(q[0])
    v.append(0.0 * v[0])
    v[-1][layout.at("x", "sling_radial")] = 0.02, 0.02 / SIDES[2]
    bottom = body_points(tower.model, tower.data, contacts.body, points[:1], q[-1], v[-1])[1]
    assert np.abs(bottom[:2]).max() < 1e-3
    raised = q[1].copy()
    raised[layout.index("l")] -= 1.0
    q.append(raised)
    v.append(0.0 * v[0])
    rows = np.array(q), np.array(v)
    taut = np.full(len(q), TAUT)
    slack = np.full(len(q), SLACK)
    expected = [ON_GROUND, *[OFF_LEAD] * 3, ON_GROUND, ON_GROUND, TAUT]
    assert ground_phases(tower, contacts, *rows, taut).tolist() == expected
    assert ground_phases(tower, contacts, *rows, slack).tolist() == [ON_GROUND] * 6 + [SLACK]


def test_a_platform_is_turned_from_x_towards_y() -> None:
    """Its corners by the library of rotations, a little inside and a little outside."""
    platform = Platform((2.0, 1.0), (4.0, 1.0), 3.0, yaw=math.radians(30.0))
    contacts = Ground(CORNERS, (platform,)).contacts(free_box())
    turn = Rotation.from_euler("z", 30.0, degrees=True)
    centre = np.array([2.0, 1.0, 0.0])
    for x, y in ((2.0, 0.5), (-2.0, 0.5), (2.0, -0.5), (-2.0, -0.5)):
        inside, outside = (
            centre + turn.apply([share * x, share * y, 2.9]) for share in (0.99, 1.01)
        )
        assert contacts.depth(inside)[0] == pytest.approx(0.005)  # of the nearer side
        assert contacts.depth(outside)[0] == pytest.approx(-0.02)  # of the farther side
    normal = contacts.depth(centre + turn.apply([1.9, 0.0, 2.5]))[1]
    assert np.array(normal) == pytest.approx(turn.apply([1.0, 0.0, 0.0]))
    assert contacts.depth([2.0, 1.0, 2.99])[1] == pytest.approx((0.0, 0.0, 1.0))


@pytest.mark.parametrize("restitution", [0.06, 0.3, 0.9])
def test_a_point_rebounds_without_gravity_at_its_share_of_the_speed(restitution: float) -> None:
    """By integration of spring and damper up to where they no longer push."""
    ratio = damping_ratio(restitution)

    def push_off(_: float, state: np.ndarray) -> float:
        return float(state[0] + 2.0 * ratio * state[1])

    push_off.terminal = True  # type: ignore[attr-defined]
    push_off.direction = -1.0  # type: ignore[attr-defined]
    impact = solve_ivp(lambda t, s: [s[1], -push_off(t, s)], (0.0, 50.0), [0.0, 1.0],
                       events=push_off, rtol=1e-10, atol=1e-12)  # fmt: skip
    assert -impact.y[1, -1] == pytest.approx(restitution, abs=1e-8)


def test_a_box_of_a_crane_has_the_moments_of_its_sides_and_hangs_amid_its_top() -> None:
    """Those of twelve kilograms are the sums of squares of two sides."""
    values = box_load(12.0, 1.0, 2.0, 3.0)
    assert values == pytest.approx({"payload_mass": 12.0, "lug_height": 1.5, "payload_ixx": 13.0,
                                    "payload_iyy": 10.0, "payload_izz": 5.0})  # fmt: skip


def test_a_body_above_the_ground_has_an_underside_and_one_on_the_ground_has_none() -> None:
    square = [(x, y) for x in (-1.0, 1.0) for y in (-1.0, 1.0)]
    beam = Hull([[x, y, z] for x, y in square for z in (2.0, 3.0)])
    plinth = Hull([[4.0 + x, y, z] for x, y in square for z in (0.0, 1.0)])
    contacts = Ground(CORNERS, (beam, plinth)).contacts(free_box())
    depth, normal = contacts.depth([0.0, 0.0, 2.01])
    assert (depth, *normal) == pytest.approx((0.01, 0.0, 0.0, -1.0))
    depth, normal = contacts.depth([4.9, 0.0, 0.01])
    assert (depth, *normal) == pytest.approx((0.1, 1.0, 0.0, 0.0))


def test_a_load_that_is_put_on_the_ground_keeps_its_rates() -> None:
    tower = crane(**box_load(MASS, *SIDES), rope_stiffness=2e7, hoist_max=30.0)
    state = tower.state(l=26.0, phi=0.0)
    moving = State(state.q, np.arange(tower.layout.n) + 0.5)
    assert standing(tower, Ground(box_corners(*SIDES)), moving).v.tolist() == moving.v.tolist()


@pytest.mark.parametrize(
    ("scale", "offset", "words"),
    [
        ([1.0, 1.0, 0.0], 0.0, "four that are not in a plane"),
        ([1.0, 1.0, 1e-9], 0.0, "four that are not in a plane"),
        ([1.0, 1.0, 1e-9], 1e3, "four that are not in a plane"),
        ([1e-9, 1e-9, 1e-9], 0.0, "four that are not in a plane"),
        ([1.0, 1.0, 1.0], 1e7, "coordinate of a corner of a hull"),
        ([1e9, 1e9, 1e9], 0.0, "coordinate of a corner of a hull"),
    ],
)
def test_a_hull_that_is_nearly_flat_or_far_off_is_refused(
    scale: list[float], offset: float, words: str
) -> None:
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * scale @ turn + offset
    with pytest.raises(OutOfRange, match=words):
        Hull(corners.tolist())


@pytest.mark.parametrize("corners", [[], [[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
def test_too_few_corners_are_no_hull(corners: list[list[float]]) -> None:
    with pytest.raises(OutOfRange, match="of a hull"):
        Hull(corners)


def test_the_thinnest_hull_has_faces_wherever_it_may_stand() -> None:
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    box = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    for place in (0.0, 1e3, 9e5):
        assert len(Hull((box * [1.0, 1.0, 1e-6] @ turn + place).tolist()).faces) >= 6


@pytest.mark.parametrize(
    "values",
    [
        {"centre": (1e12, 0.0)},
        {"size": (1e3, 1e-9)},
        {"size": (1e9, 1.0)},
        {"height": 1e9},
    ],
)
def test_a_platform_that_cannot_be_meant_is_refused(values: dict[str, Any]) -> None:
    meant: dict[str, Any] = {"centre": (0.0, 0.0), "size": (1.0, 1.0), "height": 1.0}
    with pytest.raises(OutOfRange, match=f"{next(iter(values))} of a platform"):
        Platform(**{**meant, **values})


def test_a_load_on_a_rope_that_does_not_stretch_cannot_stand_below_where_it_hangs() -> None:
    c = load_crane(**box_load(1000.0, 1.5, 3.0, 1.2), rope_stiffness=math.inf, hoist_max=30.0)
    ground = Ground(box_corners(1.5, 3.0, 1.2))
    with pytest.raises(OutOfRange, match="since the rope does not stretch; give a larger l"):
        standing(c, ground, c.state(l=20.0))
    stands = standing(c, ground, c.state(l=28.0))
    assert stands.q[c.layout.index("rope_stretch")] == pytest.approx(-1.198)
