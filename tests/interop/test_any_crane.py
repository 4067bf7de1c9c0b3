"""The task of moving a load without swing for cranes of any kind: each crane against `simulate`, a
regulator that solves the task, and a random policy that does not.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from copy import deepcopy
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy
from numpy.testing import assert_allclose

from cranedyn.disturbances.wind import constant_force
from cranedyn.dynamics.converters import converters
from cranedyn.dynamics.cylinders import Pump
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.integrators import rk4
from cranedyn.dynamics.linearisation import linear
from cranedyn.errors import ModelError, OutOfRange
from cranedyn.interfaces import State
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.recording.sketch import Projection
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from cranedyn.theory import amplitude_factor

gym = pytest.importorskip("gymnasium", reason="extra gymnasium is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
from gymnasium.utils.env_checker import check_env  # noqa: E402

from cranedyn.interop.gymnasium import ID, CraneEnv, CraneVectorEnv  # noqa: E402
from cranedyn.interop.hanging_loads import hanging_coordinates  # noqa: E402
from cranedyn.interop.task import PENALTY, SwingTask, cranes_between  # noqa: E402

OVERHEAD = XACRO.with_name("overhead_crane.urdf.xacro")
LUFFING = XACRO.with_name("luffing_crane.urdf.xacro")

LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{rate}"/>
</joint>"""


def gantry() -> str:
    """A gantry crane of somebody else, as plain URDF: no joint has a name that this project knows,
    and the first swing is about Y.
    """
    text = '<robot name="gantry"><link name="rails"/>'
    for name, mass, inertia in (
        ("portal", 8000, 1e4),
        ("crab", 600, 20),
        ("upper", 1, 0.1),
        ("lower", 1, 0.1),
        ("container", 2500, 300),
    ):
        text += LINK.format(name=name, mass=mass, inertia=inertia)
    rows = (
        ("travel", "prismatic", "rails", "portal", "1 0 0", 0, 60, 5e4, 1.5),
        ("cross", "prismatic", "portal", "crab", "0 1 0", -9, 9, 2e4, 1.0),
        ("along", "revolute", "crab", "upper", "0 1 0", -1.2, 1.2, 1, 10),
        ("across", "revolute", "upper", "lower", "1 0 0", -1.2, 1.2, 1, 10),
        ("rope", "prismatic", "lower", "container", "0 0 -1", 2, 11, 6e4, 0.6),
    )
    keys = ("name", "kind", "parent", "child", "axis", "lower", "upper", "effort", "rate")
    for row in rows:
        text += JOINT.format(**dict(zip(keys, row, strict=True)))
    return text + "</robot>"


CART = """<mujoco model="cart"><compiler angle="radian"/><worldbody>
<body name="cart" pos="0 0 8"><joint name="rail" type="slide" axis="1 0 0" range="-4 4"/>
<geom type="box" size=".2 .2 .1" mass="60"/>
<body name="hook"><joint name="swing" type="hinge" axis="0 1 0" range="-1.4 1.4"/>
<geom type="sphere" size=".1" pos="0 0 -3" mass="8"/></body></body>
</worldbody><actuator><motor name="push" joint="rail" ctrlrange="-500 500"/></actuator></mujoco>"""
"""A cart with a pendulum, as MJCF."""


def gantry_crane() -> Crane:
    """Load the gantry crane."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "gantry.urdf")
        path.write_text(gantry())
        return load_crane(path, driven=["travel", "cross", "rope"])


def cart_crane() -> Crane:
    """Load the cart."""
    pytest.importorskip("mujoco", reason="extra mujoco is not installed")
    with TemporaryDirectory() as folder:
        path = Path(folder, "cart.xml")
        path.write_text(CART)
        return load_crane(path)


LOADERS: dict[str, Callable[[], Crane]] = {
    "overhead": partial(load_crane, OVERHEAD),
    # In a part of its range, so that one linear model is valid in all of it.
    "luffing": partial(
        load_crane, LUFFING, luff_min=1.0, luff_max=1.35, hoist_min=15.0, hoist_max=30.0
    ),
    "gantry": gantry_crane,
    "cart": cart_crane,
    "laboratory": partial(load_crane, machine="inteco_3dcrane"),
    "hook and load": partial(load_crane, hook_mass=300.0, payload_mass=2000.0, sling_length=5.0),
    "elastic rope": partial(load_crane, rope_stiffness=3e6, rope_damping=1e4),
    "inextensible rope": partial(load_crane, rope_stiffness=math.inf),
    "two falls": partial(load_crane, fall_spacing=1.0),
    "hook on two falls": partial(load_crane, hook_mass=300.0, fall_spacing=1.0),
    "bending jib": partial(load_crane, jib_bend_stiffness=4e7),
}
"""All cranes, by name."""


@cache
def crane_named(name: str) -> Crane:
    """Return a crane, loaded once."""
    return LOADERS[name]()


CRANES = [
    pytest.param(name, marks=[] if name == "overhead" else pytest.mark.long) for name in LOADERS
]
"""Names as parameters of tests: each crane is compiled, which takes seconds."""

REACH = {"luffing": (0.2, 0.1, 4.0)}
"""Farthest goals of cranes that are so slow that a regulator would need minutes for others."""


def random_actions(env: CraneVectorEnv, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Take steps of random actions: states before and after each, shape (steps + 1, 2 n, k), and
    the commands, shape (steps, m, k).
    """
    rng = np.random.default_rng(1)
    task = env.task
    states = [task.fleet.z.copy()]
    commands = []
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, (env.num_envs, task.layout.m))
        commands.append(task.commands(action.T, task.fleet.z, task.crane_index))
        env.step(action)
        states.append(task.fleet.z.copy())
    return np.array(states), np.array(commands)


def regulator(task: SwingTask) -> Any:
    """Return a function that returns actions, shape (m, k), of an LQR about the goal.

    Drives far from their goals count as if they were as far as their way of braking.
    """
    crane = task.fleet.cranes[0]
    n = crane.layout.n
    drives = crane.layout.drives
    limits = task.drive_limits
    rates = np.array([limit.rate for limit in limits])
    accelerations = np.array([limit.acceleration for limit in limits])
    braking = rates**2 / (2.0 * accelerations)
    is_effort = task.rules.action == "effort"
    model = linear(
        crane, State(crane.rest.q, np.zeros(n)), drive="effort" if is_effort else "motion"
    )
    unit = task.efforts if is_effort else accelerations
    # What no drive moves, such as the yaw of a load, is damped a little so that there is an answer.
    a, b, *_ = scipy.signal.cont2discrete(
        (model.a - 1e-4 * np.eye(2 * n), model.b * unit, np.eye(2 * n), 0.0),
        task.fleet.control_period,
    )
    frequency = np.sqrt(crane.gravity / task.view.pendulum_lengths(crane.rest.q[:, None], [0])[0])
    weight = np.full(2 * n, 1e-6)
    weight[drives] = braking**-2
    weight[n + drives] = rates**-2
    weight[task.view.swings] = 0.1**-2
    weight[n + task.view.swings] = (0.1 * frequency) ** -2
    # Efforts that hold the crane at its goal, beyond those that hold it at its start.
    feed_forward = np.zeros((len(drives), task.fleet.count))
    if is_effort:
        goals = hanging_coordinates(task.fleet.cranes, task.crane_index, task.goal)
        at_start = holding_effort(crane, crane.start.q)
        for i, goal in enumerate(goals.T):
            feed_forward[:, i] = (holding_effort(crane, goal) - at_start) / unit
    effort_weight = np.eye(len(drives))
    cost = scipy.linalg.solve_discrete_are(a, b, np.diag(weight), effort_weight)
    gain = np.linalg.solve(effort_weight + b.T @ cost @ b, b.T @ cost @ a)

    def actions() -> np.ndarray:
        z = task.fleet.z
        to_go = np.clip(task.goal - z[drives], -braking[:, None], braking[:, None])
        at_rest = hanging_coordinates(task.fleet.cranes, task.crane_index, z[drives] + to_go)
        deviation = z.copy()
        deviation[:n] -= at_rest
        return np.clip(feed_forward - gain @ deviation, -1.0, 1.0)

    return actions


@pytest.mark.slow
@pytest.mark.parametrize("name", CRANES)
def test_gymnasium_finds_no_fault_with_any_crane(name: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = gym.make(
            f"cranedyn.interop.gymnasium:{ID}", crane=crane_named(name), folder=tmp_path
        )
        # Drawing is checked with the tower crane.
        check_env(made.unwrapped, skip_render_check=True)
    assert made.spec.max_episode_steps == 400


@pytest.mark.slow
@pytest.mark.parametrize("name", CRANES)
@pytest.mark.parametrize("action", ["velocity", "effort", "converters"])
def test_any_crane_moves_as_in_simulate_with_the_same_commands(name: str, action: str) -> None:
    crane = crane_named(name)
    how: dict[str, Any] = {"action": action}
    if action == "converters":
        how = {"converters": converters(crane)}
    # A drag area in proportion to the mass, since the wind would blow a small load away.
    area = 2e-3 * crane.payload_mass
    env = CraneVectorEnv(9, crane=crane, wind=12.0, payload_area=area, swing=0.05, **how)
    env.reset(seed=5)
    # Two steps of efforts stay within the rates; beyond them the next episode begins.
    steps = 2 if action == "effort" else 15
    states, commands = random_actions(env, steps)
    n = crane.layout.n
    force = env.task.force_on(8)
    assert np.hypot(*force[:2]) > 0.01 * crane.payload_mass
    run = simulate(
        crane,
        lambda t, *_: commands[min(round(t / 0.1), steps - 1), :, 8],
        start=State(states[0, :n, 8], states[0, n:, 8]),
        duration=steps * 0.1,
        dt=1e-2,
        control_period=0.1,
        drive=env.task.drive,
        integrator=rk4,
        disturbance=constant_force(crane, payload=force),
        validity="mark",
        # Only the compiled engine has ropes that stretch or go slack.
        engine="pinocchio" if crane.springs.rope is None else "compiled",
    )
    assert_allclose(states[:, :, 8], np.hstack([run.q, run.v]), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", CRANES)
def test_starts_hang_in_reach_of_goals_and_a_seed_draws_them_again(name: str) -> None:
    crane = crane_named(name)
    n = crane.layout.n
    drives = crane.layout.drives
    env = CraneVectorEnv(60, crane=crane, swing=0.0)
    again = CraneVectorEnv(60, crane=crane, swing=0.0)
    seen, infos = env.reset(seed=9)
    assert seen in env.observation_space
    assert np.array_equal(seen, again.reset(seed=9)[0])
    assert not np.array_equal(seen, again.reset(seed=10)[0])
    z = env.task.fleet.z
    assert (z[:n] >= crane.lower[:, None]).all() and (z[:n] <= crane.upper[:, None]).all()
    assert (env.task.goal >= crane.lower[drives][:, None]).all()
    assert (env.task.goal <= crane.upper[drives][:, None]).all()
    # The load is at rest at the start, and the distance is that of the load from its place.
    at_goal = crane.hanging(_with_drives(crane, env.task.goal[:, 0]))
    for i, at_rest in ((0, z[:n, 0]), (1, z[:n, 1])):
        assert_allclose(at_rest, crane.hanging(at_rest), atol=1e-9)
        assert not z[n:, i].any()
    expected = np.linalg.norm(load_place(crane, z[:n, 0]) - load_place(crane, at_goal))
    assert infos["distance"][0] == pytest.approx(expected, rel=1e-9)


def _with_drives(crane: Crane, positions: np.ndarray) -> np.ndarray:
    """Return the coordinates of the start with the drives elsewhere."""
    q = crane.rest.q.copy()
    q[crane.layout.drives] = positions
    return q


def load_place(crane: Crane, q: np.ndarray) -> np.ndarray:
    """Return where the centre of mass of the payload is, by Pinocchio's kinematics [m]."""
    pin.forwardKinematics(crane.model, crane.data, q)
    return crane.data.oMi[crane.payload.body + 1].act(crane.payload.lever)


@pytest.mark.slow
@pytest.mark.parametrize("name", CRANES)
@pytest.mark.parametrize("action", ["acceleration", pytest.param("effort", marks=pytest.mark.long)])
def test_a_regulator_brings_the_load_to_its_place_and_a_random_policy_does_not(
    name: str, action: str
) -> None:
    how: dict[str, Any] = {"action": action, "reach": REACH.get(name)}
    crane = crane_named(name)
    regulated = CraneVectorEnv(20, crane=crane, max_episode_steps=601, **how)
    regulated.reset(seed=1)
    actions = regulator(regulated.task)
    for _ in range(600):
        *_, infos = regulated.step(actions().T)
    assert np.median(infos["distance"]) < 0.02
    assert infos["is_success"].mean() >= 0.8

    left_to_chance = CraneVectorEnv(20, crane=crane, max_episode_steps=601, **how)
    left_to_chance.reset(seed=1)
    left_to_chance.action_space.seed(1)
    solved = 0.0
    for _ in range(400):
        *_, infos = left_to_chance.step(left_to_chance.action_space.sample())
        solved += infos["is_success"].mean() / 400
    assert solved < 0.1


# --- what is observed, rewarded and commanded -----------------------------------------------------


def test_a_load_that_swings_about_its_goal_is_as_far_from_it_as_it_swings() -> None:
    crane = crane_named("overhead")
    env = CraneVectorEnv(1, crane=crane)
    goal = crane.start.q[crane.layout.drives]
    length = goal[2]
    # Released at the angle φ it is the chord 2 L sin(φ/2) from its place.
    env.reset(options={"start": crane.state(phi=0.1), "goal": goal})
    chord = 2.0 * length * np.sin(0.05)
    assert env.task.goal_distance[0] == pytest.approx(chord, rel=1e-9)
    # A quarter of a period later it passes its place with the speed that energy gives it, and
    # counts as just as far: 2 g L (1 - cos φ) = u², and u² L/g is the square of the chord.
    speed = np.sqrt(2.0 * crane.gravity * length * (1.0 - np.cos(0.1)))
    env.reset(options={"start": crane.state(phi_dot=speed / length), "goal": goal})
    assert env.task.goal_distance[0] == pytest.approx(chord, rel=1e-9)
    assert amplitude_factor(0.1) < 1.001  # the pendulum keeps its period to this


def test_observations_of_an_overhead_crane_are_shares_of_limits_and_ranges() -> None:
    crane = crane_named("overhead")
    limits = Limits(rates=(1.6, 0.8, 0.4), accelerations=(0.3, 0.3, 0.2))
    env = CraneVectorEnv(1, crane=crane, limits=limits, reach=(10.0, 5.0, 2.0), swing_limit=0.5)
    start = crane.state(bridge=20.0, x=10.0, l=8.0, phi=0.1, theta=-0.2, x_dot=0.4)
    seen, _ = env.reset(options={"start": start, "goal": (25.0, 10.0, 7.0)})
    named = dict(zip(env.task.observed, seen[0].tolist(), strict=True))
    assert named["bridge_to_go"] == pytest.approx(0.5) and named["x_to_go"] == 0.0
    assert named["l_to_go"] == pytest.approx(-0.5)
    assert named["x_dot"] == pytest.approx(0.5) and named["l_dot"] == 0.0
    assert named["phi"] == pytest.approx(0.2) and named["theta"] == pytest.approx(-0.4)
    assert named["x"] == pytest.approx(0.0, abs=1e-6)  # the middle of the span


@pytest.mark.slow
def test_a_load_that_hangs_still_shows_no_swing_whatever_the_angle_of_the_boom() -> None:
    crane = crane_named("luffing")
    env = CraneVectorEnv(1, crane=crane)
    for luff in (1.0, 1.2, 1.35):
        seen, _ = env.reset(options={"start": crane.state(luff=luff)})
        named = dict(zip(env.task.observed, seen[0].tolist(), strict=True))
        assert abs(named["swing_radial"]) < 1e-6 and abs(named["theta"]) < 1e-6


def test_the_reward_is_that_of_the_distance_of_the_load() -> None:
    env = CraneVectorEnv(1, crane=crane_named("overhead"), action="acceleration")
    env.reset(options={"goal": (20.0, 10.0, 8.0), "start": crane_named("overhead").state(x=13.0)})
    _, reward, *_, infos = env.step(np.zeros((1, 3)))
    assert infos["distance"][0] == pytest.approx(3.0, rel=1e-9)
    assert reward[0] == pytest.approx(-0.1 * np.log10(1.0 + 3.0 / 0.01), rel=1e-9)


def test_an_effort_of_zero_holds_each_load_at_rest_where_it_starts() -> None:
    cranes = [load_crane(OVERHEAD, payload_mass=mass) for mass in (2000.0, 5000.0)]
    env = CraneVectorEnv(16, crane=cranes, action="effort", swing=0.0)
    env.reset(seed=1)
    assert set(env.task.crane_index.tolist()) == {0, 1}
    before = env.task.fleet.z.copy()
    for _ in range(20):
        env.step(np.zeros((16, 3)))
    assert_allclose(env.task.fleet.z, before, atol=1e-9)


def test_a_drive_of_efforts_that_is_driven_beyond_its_rate_ends_the_episode() -> None:
    env = CraneVectorEnv(1, action="effort", autoreset_mode="Disabled", max_episode_steps=1000)
    env.reset(seed=1)
    ended = False
    while not ended:
        _, reward, terminated, truncated, _ = env.step(np.array([[0.0, 1.0, 0.0]]))
        ended = bool(terminated[0] or truncated[0])
    assert terminated[0] and reward[0] == PENALTY
    trolley = env.task.layout.index("x")
    position = env.task.fleet.z[trolley, 0]
    rate = env.task.fleet.z[env.task.layout.n + trolley, 0]
    limits = env.task.drive_limits[1]
    assert limits.lower < position < limits.upper and rate > limits.rate


@pytest.mark.slow
def test_drives_with_converters_stop_before_the_ends_of_their_ranges() -> None:
    crane = crane_named("overhead")
    env = CraneVectorEnv(8, crane=crane, converters=converters(crane), max_episode_steps=10_000)
    env.reset(seed=0)
    push = np.sign(np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3)))
    drives = crane.layout.drives
    for _ in range(600):
        _, _, terminated, *_ = env.step(push)
        assert not terminated.any()
    q = env.task.fleet.z[drives]
    gap = np.minimum(q - crane.lower[drives][:, None], crane.upper[drives][:, None] - q)
    assert (gap > 0.0).all() and (gap < 0.2).all()


@pytest.mark.slow
def test_cranes_that_differ_in_load_and_length_share_one_environment() -> None:
    cranes = cranes_between(2, urdf=OVERHEAD, payload_mass=(1e3, 9e3), height=(11.5, 14.0))
    env = CraneVectorEnv(40, crane=cranes, swing=0.0)
    _, infos = env.reset(seed=2)
    task = env.task
    n = task.layout.n
    for i in range(40):
        crane = task.crane_of(i)
        at_goal = load_place(crane, crane.hanging(_with_drives(crane, task.goal[:, i])))
        expected = np.linalg.norm(load_place(crane, task.fleet.z[:n, i]) - at_goal)
        assert infos["distance"][i] == pytest.approx(expected, rel=1e-9)
    assert len(set(task.crane_index.tolist())) == 2
    machines = cranes_between(2, machine="inteco_3dcrane", payload_mass=(0.5, 1.0))
    assert all(crane.trolley_mass == 1.155 for crane in machines)


@pytest.mark.slow
def test_neither_threads_nor_copies_change_what_is_observed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cranes = [crane_named("overhead"), load_crane(OVERHEAD, payload_mass=2000.0, height=13.0)]
    observed = []
    for at_once in (0, 10_000):
        monkeypatch.setattr("cranedyn.interop.task._MAX_UNDIVIDED_COUNT", at_once)
        env = CraneVectorEnv(600, crane=cranes, threads=2, wind=5.0)
        env.reset(seed=3)
        copied = deepcopy(env)
        action = np.random.default_rng(0).uniform(-1.0, 1.0, (600, 3))
        observed += [one.step(action)[0] for one in (env, copied)]
    for other in observed[1:]:
        np.testing.assert_array_equal(observed[0], other)


@pytest.mark.slow
@pytest.mark.parametrize(
    "drive",
    [
        "converters",
        *(pytest.param(kind, marks=pytest.mark.long) for kind in ("velocity", "effort")),
    ],
)
def test_the_recording_of_an_episode_repeats_it(drive: str, tmp_path: Path) -> None:
    crane = crane_named("overhead")
    how: dict[str, Any] = {"action": drive}
    if drive == "converters":
        how = {"converters": converters(crane)}
    env = CraneEnv(crane=crane, render_mode="rrd", folder=tmp_path, wind=8.0, **how)
    env.reset(seed=2)
    rng = np.random.default_rng(3)
    for _ in range(2 if drive == "effort" else 20):
        env.step(rng.uniform(-1.0, 1.0, 3))
    again = env._simulated()
    assert_allclose(np.concatenate([again.q[-1], again.v[-1]]), env.task.fleet.z[:, 0], atol=1e-9)
    assert Path(str(env.render())).stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["overhead", pytest.param("gantry", marks=pytest.mark.long)])
def test_a_picture_shows_the_load_wherever_the_drives_go(name: str) -> None:
    crane = crane_named(name)
    env = CraneEnv(crane=crane, render_mode="rgb_array")
    (left, right), (bottom, top) = env._picture_limits(crane)
    projection = Projection(crane)
    for seed in range(20):
        env.reset(seed=seed)
        across, up = projection.rope(env.task.fleet.z[: crane.layout.n, 0]).T
        assert left < across.min() and across.max() < right
        assert bottom < up.min() and up.max() < top


# --- what is refused ------------------------------------------------------------------------------


def test_a_crane_whose_load_does_not_swing_is_told_what_the_task_needs(tmp_path: Path) -> None:
    text = gantry()
    for name in ("along", "across"):
        text = text.replace(
            f'<joint name="{name}" type="revolute">', f'<joint name="{name}" type="fixed">'
        )
    path = tmp_path / "stiff.urdf"
    path.write_text(text)
    crane = load_crane(path, driven=["travel", "cross", "rope"])
    with pytest.raises(ModelError, match="needs one that hangs: a passive revolute joint") as said:
        CraneVectorEnv(1, crane=crane)
    assert "\n" not in str(said.value)


def test_a_crane_whose_load_does_not_hang_everywhere_is_refused_before_it_is_learned_on(
    tmp_path: Path,
) -> None:
    # A crab that tilts by 1.5 rad, where the swing joint below it would have to make up for that.
    text = gantry().replace('"cross" type="prismatic"', '"cross" type="revolute"')
    text = text.replace('lower="-9" upper="9"', 'lower="-1.5" upper="1.5"')
    path = tmp_path / "tilting.urdf"
    path.write_text(text)
    crane = load_crane(path, driven=["travel", "cross", "rope"])
    with pytest.raises(ModelError, match=r"along would be at 1\.47 rad, its range is -1\.2 to"):
        CraneVectorEnv(1, crane=crane)


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"action": "push"}, "action is push; allowed is velocity, acceleration or effort"),
        ({"reach": (1.0, 2.0)}, "allowed is three numbers: bridge, trolley, hoist"),
        ({"efforts": (1.0, 1.0, 1.0)}, "efforts is given; allowed is None where action = velocity"),
        ({"action": "effort", "efforts": (5e4, 2e4, 1e4)}, "effort of x is 20000.0 N; allowed is"),
        ({"action": "effort", "efforts": (1e3, 1e3, 9e4)}, "effort of l is 90000.0 N; allowed is"),
        ({"tolerance": -1.0}, "tolerance is -1.0 m; allowed is 0 to 1000"),
    ],
)
def test_rules_that_a_crane_cannot_keep_are_refused_in_a_sentence(how: Any, sentence: str) -> None:
    with pytest.raises(OutOfRange) as said:
        CraneVectorEnv(1, crane=crane_named("overhead"), **how)
    assert sentence in str(said.value) and "\n" not in str(said.value)


def test_a_load_that_the_hoist_cannot_hold_is_refused_for_efforts() -> None:
    heavy = load_crane(OVERHEAD, payload_mass=20_000.0)
    with pytest.raises(ModelError, match="hoist_joint cannot hold this crane at its start"):
        CraneVectorEnv(1, crane=heavy, action="effort")


def test_a_physics_step_that_is_too_long_for_a_stiff_rope_is_refused() -> None:
    stiff = load_crane(rope_stiffness=1e9)
    with pytest.raises(OutOfRange, match=r"dt is 0\.01 s; allowed is .* or less: a mode has"):
        CraneVectorEnv(1, crane=stiff)


def test_the_name_of_a_file_is_no_crane() -> None:
    with pytest.raises(OutOfRange, match=r"crane is 'crane\.urdf'; allowed is a crane, or several"):
        CraneVectorEnv(1, crane="crane.urdf")  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_boom_that_telescopes_learns_with_drives_that_share_a_pump_as_in_simulate() -> None:
    """A mobile crane with cylinders at boom and telescope: each crane as in `simulate`, and no more
    oil than the pump gives.
    """
    mobile = load_crane(XACRO.with_name("mobile_crane.urdf.xacro"))
    flow = 1.5e-3
    pump = Pump(mobile, flow, {"slew": 2e-3, "l": 1e-2})
    start = mobile.state(luff=0.7, telescope=2.0)
    env = CraneEnv(crane=mobile, pump=pump)
    env.reset(seed=1, options={"start": start})
    free = CraneEnv(crane=mobile)
    free.reset(seed=1, options={"start": start})
    oil = []
    for _ in range(30):
        asked = np.array([0.8, 1.0, 1.0, -1.0], dtype=np.float32)
        env.step(asked)
        free.step(asked)
        q, v = env.task.fleet.z[:, 0].reshape(2, -1)
        oil.append(float(pump.volumes(q) @ np.abs(v[mobile.layout.drives])))
    # Rates follow what is commanded at the ends of the steps; by then the lever arm of the cylinder
    # has changed a little.
    assert max(oil) < 1.01 * flow and oil[-1] > 0.99 * flow
    q, v = free.task.fleet.z[:, 0].reshape(2, -1)
    assert float(pump.volumes(q) @ np.abs(v[mobile.layout.drives])) > 1.5 * flow
    again = env._simulated()
    z = env.task.fleet.z[:, 0]
    assert_allclose(np.append(again.q[-1], again.v[-1]), z, rtol=0.0, atol=1e-9)


def test_a_pump_of_another_crane_or_of_other_actions_is_refused() -> None:
    pump = Pump(load_crane(XACRO.with_name("mobile_crane.urdf.xacro")), 1e-3, {"l": 1e-2})
    with pytest.raises(OutOfRange, match="pump is one of another crane; allowed is a pump of the"):
        CraneEnv(crane=crane_named("overhead"), pump=pump)
    with pytest.raises(OutOfRange, match="pump is given; allowed is None where action = effort"):
        CraneEnv(crane=pump.crane, pump=pump, action="effort")
