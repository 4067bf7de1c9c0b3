"""The crane as an environment of Gymnasium: its own checker, and every number against
`simulate`.
"""

from __future__ import annotations

import warnings
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.disturbances.waves import Jonswap, RandomSea
from cranedyn.disturbances.wind import AIR_DENSITY, constant_force
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError, ModelError, OutOfRange, UnknownName
from cranedyn.interfaces import State
from cranedyn.model.load import load_crane
from cranedyn.references.limits import Limits
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import HOOK
from tests.helpers import crane

gym = pytest.importorskip("gymnasium", reason="extra gymnasium is not installed")
pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402

from benchmarks import environment  # noqa: E402
from cranedyn.interop.gymnasium import (  # noqa: E402
    TOWER_ID,
    TowerCraneEnv,
    TowerCraneVectorEnv,
)
from cranedyn.interop.task import BASE_OBSERVED, PENALTY, Rules, cranes_between  # noqa: E402
from cranedyn.interop.tower_task import OBSERVED, TowerSwingTask  # noqa: E402

DRIVES = crane().layout.drives
PASSIVE = crane().layout.passive


def many(count: int, **how: Any) -> TowerCraneVectorEnv:
    """Environments that share one crane."""
    return TowerCraneVectorEnv(count, **({"crane": crane()} | how))


def rollout(env: TowerCraneVectorEnv, steps: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """States before and after steps of random actions, shape (steps + 1, 10, n), and the
    accelerations, shape (steps, 3, n).
    """
    rng = np.random.default_rng(seed)
    task = env.task
    states = [task.fleet.z.copy()]
    commands = []
    for _ in range(steps):
        action = rng.uniform(-1.0, 1.0, (env.num_envs, 3))
        commands.append(task.commands(action.T, task.fleet.z))
        env.step(action)
        states.append(task.fleet.z.copy())
    return np.array(states), np.array(commands)


@pytest.mark.slow
def test_gymnasium_finds_no_fault_with_one_crane(tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make(f"cranedyn.interop.gymnasium:{TOWER_ID}", crane=crane(), folder=tmp_path)
        check_env(env.unwrapped)
    assert env.spec.max_episode_steps == 400


def test_gymnasium_makes_many_by_name_and_they_keep_to_their_spaces() -> None:
    env = gym.make_vec(TOWER_ID, num_envs=40, crane=crane(), max_episode_steps=30)
    seen, _ = env.reset(seed=3)
    env.action_space.seed(3)
    for _ in range(70):
        assert seen in env.observation_space
        seen, reward, terminated, truncated, infos = env.step(env.action_space.sample())
        columns = reward, terminated, truncated, infos["distance"]
        assert all(column.shape == (40,) for column in columns)
        assert np.isfinite(seen).all() and np.isfinite(reward).all()


@pytest.mark.parametrize("engine", ["pinocchio", "compiled"])
@pytest.mark.parametrize("action", ["velocity", "acceleration"])
@pytest.mark.slow
def test_each_crane_moves_as_in_simulate_whatever_its_load_wind_and_neighbours(
    engine: Any, action: str
) -> None:
    cranes = [crane(), crane(payload_mass=2500.0)]
    env = many(21, crane=cranes, action=action, wind=12.0, control_period=0.1)
    env.reset(seed=5)
    steps = 20 if engine == "pinocchio" else 100
    states, commands = rollout(env, steps)
    kinds = [env.task.crane_of(i) for i in range(21)]
    for i in map(kinds.index, cranes):
        force = env.task.force_on(i)
        z = states[0, :, i]
        assert np.hypot(*force[:2]) > 1.0
        own = commands[:, :, i]
        external = constant_force(kinds[i], payload=force)
        for dt, apart in ((1e-2, 1e-12), (5e-4, 1e-8)):  # RK4 of 10 ms is exact to 1e-8
            run = simulate(
                kinds[i],
                lambda t, *_, own=own: own[min(round(t / 0.1), steps - 1)],
                start=State(z[:5], z[5:]),
                duration=steps * 0.1,
                dt=dt,
                control_period=0.1,
                drive="motion",
                integrator=rk4,
                disturbance=external,
                validity="mark",
                engine=engine,
            )
            assert_allclose(states[:, :, i], np.hstack([run.q, run.v]), atol=apart)


@pytest.mark.slow
def test_drives_keep_their_limits_and_stop_before_the_ends_of_their_ranges() -> None:
    limits = Limits(rates=(0.1, 2.0, 1.5), accelerations=(0.02, 0.8, 0.6))
    for action, dt in (("velocity", 1e-2), ("acceleration", 1e-2), ("velocity", 0.05)):
        env = many(8, action=action, limits=limits, dt=dt, max_episode_steps=10_000)
        env.reset(seed=0)
        push = np.sign(np.random.default_rng(0).uniform(-1.0, 1.0, (8, 3)))
        task = env.task
        c = crane()
        for _ in range(400):
            a = task.commands(push.T, task.fleet.z)
            env.step(push)
            q = task.fleet.z[:5]
            v = task.fleet.z[5:]
            assert (np.abs(a) <= np.array(limits.accelerations)[:, None] * (1.0 + 1e-9)).all()
            assert (np.abs(v[DRIVES]) <= np.array(limits.rates)[:, None] * (1.0 + 1e-9)).all()
            gap = np.minimum(
                q[DRIVES] - c.lower[DRIVES][:, None], c.upper[DRIVES][:, None] - q[DRIVES]
            )
            assert (gap >= 0.05 - 1e-12).all()  # rounding of 75 m
        assert (gap[1:] < 0.06).all()  # pushed there and stopped, 5 cm before


@pytest.mark.slow
def test_starts_goals_and_drives_keep_to_the_ranges_that_all_cranes_have() -> None:
    cranes = [crane(), crane(trolley_max=12.0)]
    reach = (1.0, 20.0, 20.0)
    env = many(50, crane=cranes, reach=reach, max_episode_steps=10_000)
    env.reset(seed=0)
    assert env.task.goal[1].max() < 12.0
    for _ in range(100):
        env.step(np.ones((50, 3)))
        assert env.task.fleet.z[1].max() < 12.0
    assert env.task.fleet.z[1].min() > 11.9
    with pytest.raises(OutOfRange, match="ranges of the drives that all cranes have"):
        many(1, crane=[crane(trolley_min=9.98), crane(trolley_max=10.02)])


@pytest.mark.slow
def test_what_is_shared_among_threads_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for at_once in (0, 10_000):
        monkeypatch.setattr("cranedyn.interop.task._MAX_UNDIVIDED_COUNT", at_once)
        env = many(600, threads=2, wind=5.0)
        env.reset(seed=3)
        found.append(rollout(env, 20))
    for shared, alone in zip(*found, strict=True):
        np.testing.assert_array_equal(shared, alone)


def test_the_reward_is_that_of_the_distance_the_load_would_have_from_its_goal() -> None:
    env = many(1, control_period=0.1)
    start = crane().state(x=12.0, l=10.0)
    goal = (0.1, 13.0, 10.5)
    env.reset(options={"start": start, "goal": goal})
    seen, reward, *_, infos = env.step(np.zeros((1, 3)))
    # at rest: 12 m · 0.1 rad, 1 m, 0.5 m
    expected = np.sqrt(1.2**2 + 1.0 + 0.5**2)
    assert infos["distance"][0] == pytest.approx(expected, rel=1e-12)
    assert reward[0] == pytest.approx(-0.1 * np.log10(1.0 + expected / 0.01), rel=1e-12)
    named = dict(zip(OBSERVED, seen[0].tolist(), strict=True))
    assert named["gamma_to_go"] == pytest.approx(0.1) and named["x"] == 12.0 and named["l"] == 10.0
    start = crane().state(x=12.0, l=10.0, phi=0.03, theta=0.04)
    env.reset(options={"start": start, "goal": (0.0, 12.0, 10.0)})
    assert env.task.goal_distance[0] == pytest.approx(10.0 * 0.05, rel=1e-12)


def test_too_much_swing_ends_an_episode() -> None:
    fast = {"start": crane().state(phi=0.19, phi_dot=0.3)}
    env = many(2, swing_limit=0.2, swing=0.0, autoreset_mode="Disabled")
    env.reset(options={**fast, "goal": (0.0, 12.0, 10.0)})
    _, reward, terminated, truncated, _ = env.step(np.zeros((2, 3)))
    assert terminated.all() and not truncated.any() and (reward == PENALTY).all()
    with pytest.raises(OutOfRange, match="call reset"):
        env.step(np.zeros((2, 3)))
    last = many(2, swing_limit=0.2, max_episode_steps=1)
    last.reset(options=fast)
    _, _, terminated, truncated, _ = last.step(np.zeros((2, 3)))
    assert terminated.all() and not truncated.any()
    alone = TowerCraneEnv(crane=crane(), swing_limit=0.2)
    alone.reset(options=fast)
    assert alone.step(np.zeros(3))[1:4] == (PENALTY, True, False)
    env.reset(options={"reset_mask": np.array([True, False])})
    swung = np.hypot(*env.task.fleet.z[PASSIVE])
    assert swung[0] < 1e-12 < 0.19 < swung[1]


def test_the_wind_pushes_with_its_dynamic_pressure_on_the_payload() -> None:
    env = many(1000, wind=10.0, payload_area=4.0)
    env.reset(seed=0)
    most = max(np.hypot(*env.task.force_on(i)[:2]) for i in range(1000))
    # ρ v²/2 A at 10 m/s; the fastest of a thousand uniform winds is within 1 % but for exp(-10)
    assert 0.98 < most / (0.5 * AIR_DENSITY * 10.0**2 * 4.0) <= 1.0


def test_next_step_and_same_step_are_followed_by_the_next_episode_as_gymnasium_says() -> None:
    def third_and_fourth(mode: AutoresetMode) -> tuple[TowerCraneVectorEnv, Any, np.ndarray, Any]:
        env = many(3, max_episode_steps=3, autoreset_mode=mode)
        env.reset(seed=4)
        for _ in range(2):
            env.step(np.zeros((3, 3)))
        third = env.step(np.zeros((3, 3)))
        return env, third, env.task.fleet.z.copy(), env.step(np.ones((3, 3)))

    env, (last, reward, _, truncated, infos), _, (first, after, _, again, _) = third_and_fourth(
        AutoresetMode.NEXT_STEP
    )
    assert truncated.all() and "final_obs" not in infos and (reward < 0.0).all()
    assert not again.any() and (after == 0.0).all()  # the action of this step was for nobody
    assert (first[:, 3:6] == 0.0).all() and not np.array_equal(first, last)
    same, (begun, reward_2, _, truncated, infos), z, (_, after, *_) = third_and_fourth(
        AutoresetMode.SAME_STEP
    )
    assert truncated.all() and infos["_final_obs"].all() and (reward_2 == reward).all()
    assert_allclose(infos["final_obs"], last)
    assert_allclose(begun, first)  # the same seed draws the same starts
    assert_allclose(begun[:, 10], z[1].astype(np.float32))
    assert (after < 0.0).all()
    modes = [one.metadata["autoreset_mode"] for one in (env, same)]
    assert modes == [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]


def test_the_step_that_begins_an_episode_tells_the_distance_of_its_beginning() -> None:
    env = many(3, max_episode_steps=2, autoreset_mode=AutoresetMode.SAME_STEP)
    env.reset(seed=4)
    env.step(np.zeros((3, 3)))
    *_, infos = env.step(np.zeros((3, 3)))
    assert np.array_equal(infos["distance"], env.task.distance(env.task.fleet.z, env.task.goal))
    assert not np.array_equal(infos["distance"], infos["final_info"]["distance"])


def test_a_reset_tells_the_distance_of_the_episodes_that_it_begins() -> None:
    env = many(3)
    _, infos = env.reset(seed=4)
    assert np.array_equal(infos["distance"], env.task.distance(env.task.fleet.z, env.task.goal))
    assert infos["_distance"].all()
    only_second = np.array([False, True, False])
    _, infos = env.reset(options={"reset_mask": only_second})
    assert np.array_equal(infos["_distance"], only_second)


@pytest.mark.slow
def test_cranes_in_different_gravities_are_refused() -> None:
    on_the_moon = load_crane(gravity=1.62)
    with pytest.raises(OutOfRange, match="gravity of the cranes"):
        many(2, crane=[crane(), on_the_moon])


def test_a_seed_draws_the_same_episodes_and_starts_lie_in_reach() -> None:
    rules = Rules(reach=(0.1, 2.0, 1.0), swing=0.05)
    task, other = (TowerSwingTask(crane(), 500, rules, 0.1, 5e-4, 1) for _ in range(2))
    for one in (task, other):
        one.begin(np.random.default_rng(7), np.arange(500))
    assert np.array_equal(task.fleet.z, other.fleet.z) and np.array_equal(task.goal, other.goal)
    z = task.fleet.z
    way = np.abs(task.goal - task.fleet.z[DRIVES]).max(axis=1)
    assert (way <= rules.reach).all() and (way > 0.9 * np.array(rules.reach)).all()
    swing = np.sqrt((z[PASSIVE] ** 2 + z[5 + PASSIVE] ** 2 * z[4] / crane().gravity).sum(axis=0))
    assert 0.045 < swing.max() <= 0.05 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "rows"), [(0.01, 101), (0.05, 21)])
def test_an_episode_is_drawn_by_rerun_as_seen(tmp_path: Path, dt: float, rows: int) -> None:
    env = gym.make(TOWER_ID, crane=crane(), render_mode="rrd", folder=tmp_path, wind=8.0, dt=dt)
    env.reset(seed=2)
    env.action_space.seed(2)
    for _ in range(20):
        env.step(env.action_space.sample())
    path = Path(str(env.render()))
    assert path == tmp_path / "episode_0001.rrd" and path.stat().st_size > 10_000
    again = env.unwrapped._simulated()
    z = env.unwrapped.task.fleet.z[:, 0]
    assert len(again) == rows and again.t[-1] == pytest.approx(2.0)
    assert_allclose(np.concatenate([again.q[-1], again.v[-1]]), z, atol=1e-12)


def test_a_film_of_pictures_shows_the_crane_in_real_time() -> None:
    assert TowerCraneEnv(crane=crane()).metadata["render_fps"] == 10
    assert TowerCraneEnv(crane=crane(), control_period=0.05).metadata["render_fps"] == 20


@pytest.mark.slow
def test_pictures_have_one_scale_and_show_the_load_where_it_is() -> None:
    env = gym.make(TOWER_ID, crane=crane(), render_mode="rgb_array")
    pictures = []
    for x, length in ((8.0, 12.0), (18.0, 12.0), (18.0, 20.0)):
        env.reset(options={"start": crane().state(x=x, l=length)})
        pictures.append(np.asarray(env.render()))
        assert pictures[-1].dtype == np.uint8 and pictures[-1].shape[2:] == (3,)

    def columns_rows(i: int, k: int) -> tuple[int, int]:
        changed = (pictures[i] != pictures[k]).any(axis=2)
        return int(np.ptp(np.flatnonzero(changed.any(axis=0)))), int(changed.any(axis=1).sum())

    across = columns_rows(0, 1)
    down = columns_rows(1, 2)
    # the trolley's 10 m are wider than what the load alone takes, which sinks by 8 m
    assert across[0] > 2 * down[0] and down[1] > 8.0 / 10.0 * 0.5 * across[0]


@pytest.mark.slow
def test_a_crane_for_which_the_task_is_not_made_is_refused_in_a_sentence() -> None:
    with pytest.raises(ModelError, match="is made for a tower crane of five joints; this one also"):
        many(2, crane=HOOK.crane())
    with pytest.raises(OutOfRange, match=r"rate limit is \(1.0, 1.0\); allowed is three numbers"):
        many(2, limits=Limits(rates=(1.0, 1.0), accelerations=(1.0, 1.0)))


def test_actions_that_are_none_are_refused_and_change_nothing() -> None:
    env = many(2)
    with pytest.raises(OutOfRange, match="call reset"):
        env.step(np.zeros((2, 3)))
    env.reset(seed=0)
    nan = np.full((2, 3), np.nan)
    large = np.full((2, 3), 1.5)
    for wrong in (np.zeros((3, 2)), np.zeros(3), nan, large, np.zeros((2, 3), dtype=complex)):
        before = env.task.fleet.z.copy()
        with pytest.raises(OutOfRange):
            env.step(wrong)
        assert np.array_equal(env.task.fleet.z, before)
    with pytest.raises(OutOfRange, match="reset_mask"):
        env.reset(options={"reset_mask": [1, 0]})


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"goal": (0.3, np.nan, 10.0)}, "goal"),
        ({"goal": (0.0, 500.0, 10.0)}, "goal"),
        ({"start": State(np.zeros(4), np.zeros(4))}, "start is a state of 4 coordinates and 4 rat"),
        ({"begin": 0}, "There is no option of reset 'begin'"),
        ([1], r"options is \[1\]; allowed is a dictionary or None"),
    ],
)
def test_a_reset_that_is_refused_changes_nothing(wrong: Any, sentence: str) -> None:
    for asked, alone in ((many(2), many(2)), [TowerCraneEnv(crane=crane()) for _ in "ab"]):
        asked.reset(seed=3), alone.reset(seed=3)
        with pytest.raises(CraneError, match=sentence):
            asked.reset(seed=5, options=wrong)
        assert np.array_equal(asked.task.fleet.z, alone.task.fleet.z)
        assert np.array_equal(asked.task.goal, alone.task.goal)
        np.testing.assert_array_equal(asked.reset()[0], alone.reset()[0])


def test_no_swing_at_the_start_may_be_minus_zero() -> None:
    env = many(2, swing=-0.0)
    env.reset(seed=0)
    assert not env.task.fleet.z[env.task.layout.passive].any()


def test_a_copy_of_an_environment_has_cranes_of_its_own() -> None:
    env, alone = (many(5, wind=10.0) for _ in range(2))
    for one in (env, alone):
        one.reset(seed=3)
        rollout(one, 4)
    copied = deepcopy(env)
    there, here, expected = (rollout(one, 4, seed=5)[0] for one in (copied, env, alone))
    assert np.array_equal(there, expected) and np.array_equal(here, expected)
    single = TowerCraneEnv(crane=crane())
    single.reset(seed=0)
    before = single.task.fleet.z.copy()
    moved = deepcopy(single)
    moved.step(np.array([0.0, 1.0, 0.0]))
    assert np.array_equal(single.task.fleet.z, before)
    assert not np.array_equal(moved.task.fleet.z, before)


@pytest.mark.parametrize("seed", [[1, 2, 3], np.arange(3), -1, 1.5, "a", True])
def test_a_seed_is_one_whole_number_for_all_cranes(seed: Any) -> None:
    for env in (many(3), TowerCraneEnv(crane=crane())):
        with pytest.raises(OutOfRange, match="allowed is None or one whole number >= 0") as said:
            env.reset(seed=seed)
        assert "\n" not in str(said.value)


def test_a_seed_of_numpy_is_the_same_as_that_of_python_and_gymnasiums_own_is_taken() -> None:
    one = many(3)
    other = many(3)
    assert np.array_equal(one.reset(seed=np.int64(7))[0], other.reset(seed=7)[0])
    drawn = many(3)
    drawn.reset()
    drawn.reset(seed=drawn.np_random_seed)  # 128 bits


@pytest.mark.slow
def test_the_benchmark_counts_steps(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--rounds", "1", "--seconds", "0"]
    assert environment.main(["--counts", "64", *words]) == 0
    count, *rates = capsys.readouterr().out.splitlines()[1].split()
    assert count == "64" and all(float(rate) > 0.0 for rate in rates)
    assert environment.main(["--counts", "8", *words, "--least", "1e6"]) == 1


@pytest.mark.slow
def test_cranes_can_be_drawn_between_two_ends() -> None:
    found = cranes_between(3, seed=1, payload_mass=(500.0, 3000.0))
    assert len({c.payload_mass for c in found}) == 3 and all(
        500.0 <= c.payload_mass <= 3000.0 for c in found
    )
    with pytest.raises(UnknownName):
        cranes_between(1, loads=(1.0, 2.0))
    with pytest.raises(OutOfRange, match="range of payload_mass is 5; allowed is two numbers"):
        cranes_between(1, payload_mass=5)  # type: ignore[arg-type]


def raft_at_sea(tmp_path: Path) -> RandomSea:
    """A raft that heaves as the water does and rolls in beam seas, but not in head seas."""
    file = tmp_path / "raos.csv"
    file.write_text(
        "heading_deg,omega_rad_s,heave_m_m,heave_phase_deg,roll_deg_m,roll_phase_deg\n"
        "90,0.1,1,0,2,-90\n90,9,1,0,2,-90\n180,0.1,1,0,0,0\n180,9,1,0,0,0\n"
    )
    return RandomSea.from_file([Jonswap(0.5, 7.0), Jonswap(1.0, 9.0)], file, [90.0, 180.0], 20)


def test_each_crane_of_each_episode_has_a_sea_and_a_heading_of_its_own(tmp_path: Path) -> None:
    env, again = (many(12, base=raft_at_sea(tmp_path), base_measured=True) for _ in range(2))
    first, _ = env.reset(seed=5)
    sources = [env.task.base_of(i).source for i in range(12)]
    assert len(set(sources)) == 12
    for words in ("heading 90°", "heading 180°", "Hs 0.5 m", "Hs 1 m"):
        assert any(words in source for source in sources)
    same, _ = again.reset(seed=5)
    assert np.array_equal(first, same)
    env.reset(options={"reset_mask": np.arange(12) == 3})
    after = [env.task.base_of(i).source for i in range(12)]
    assert [i for i in range(12) if after[i] != sources[i]] == [3]

    # What is observed of a base is what it does.
    observed, *_ = env.step(np.zeros((12, 3)))
    assert env.task.observed[-12:] == BASE_OBSERVED and observed.shape == (12, 24)
    for i in range(12):
        at = env.task.base_of(i).at(np.array([0.1]))
        expected = np.concatenate([at.position[0], at.velocity[0]])
        assert_allclose(observed[i, -12:], expected, rtol=1e-5, atol=1e-7)
    # The same draws without a base: it takes no random numbers from starts and goals.
    plain = many(12)
    plain.reset(seed=5)
    other = many(12, base=raft_at_sea(tmp_path))
    other.reset(seed=5)
    assert np.array_equal(plain.task.goal, other.task.goal)


def test_an_episode_on_a_ship_in_the_wind_is_that_of_simulate(tmp_path: Path) -> None:
    for wind, rows in ((8.0, 21), (0.0, 101)):
        env = TowerCraneEnv(crane=crane(), base=raft_at_sea(tmp_path), wind=wind)
        env.reset(seed=4)
        env.action_space.seed(4)
        for _ in range(20):
            env.step(env.action_space.sample())
        again = env._simulated()
        assert len(again) == rows and np.abs(again["base_heave_m"]).max() > 0.05
        z = env.task.fleet.z[:, 0]
        # The round-off of twenty control periods.
        assert_allclose(np.append(again.q[-1], again.v[-1]), z, rtol=0.0, atol=1e-12)


def test_what_is_no_base_of_an_episode_is_refused_in_a_sentence() -> None:
    with pytest.raises(OutOfRange, match="base is 'ship'; allowed is a BaseMotion"):
        many(1, base="ship")
    with pytest.raises(OutOfRange, match="base_measured is True; allowed is False"):
        many(1, base_measured=True)
    with pytest.raises(OutOfRange, match="base is int"):
        many(1, base=lambda rng: 3).reset(seed=1)
    t = np.arange(10.0)
    env = many(1, base=BaseMotion.from_table(t, heave=np.sin(t)))
    env.reset(seed=1)
    with pytest.raises(OutOfRange, match=r"allowed is 0 to 9, for which a table of 10 rows"):
        for _ in range(100):
            env.step(np.zeros((1, 3)))
