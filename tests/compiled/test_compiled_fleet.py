"""Cranes that go on from one command to the next: each as in `simulate`, and no call that could
harm.
"""

from __future__ import annotations

import os
import signal
import threading
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cranedyn.controllers import hold_controller
from cranedyn.disturbances.base_motion import BaseMotion
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.dynamics.integrators import rk4
from cranedyn.errors import CraneError
from cranedyn.interfaces import DirectDrive, State
from cranedyn.model.crane import Crane
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from experiments.scenarios.crane_variants import BRIDGE, HOOK, ROPE, CraneVariant
from tests.helpers import crane

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
from cranedyn.compiled.batch import simulate_batch
from cranedyn.compiled.fleet import Fleet

COUNT = 19


def scattered(rng: np.random.Generator, count: int) -> State:
    """States near the start of the crane."""
    return State(
        crane().start.q + rng.uniform(-0.1, 0.1, (count, 5)), rng.uniform(-0.1, 0.1, (count, 5))
    )


def test_threads_share_the_parts_of_many_cranes() -> None:
    fleet = Fleet(crane(), 8 * 512 * 6, threads=2)
    did: dict[int, list[int]] = {}
    both = threading.Barrier(2)  # no thread begins a part before the other has one

    def work(part: int) -> None:
        both.wait(60.0)
        did.setdefault(threading.get_ident(), []).append(part)

    fleet.spread(work)
    assert sorted(part for parts in did.values() for part in parts) == list(range(6))
    assert [len(parts) for parts in did.values()] == [3, 3]


def _check_alone(
    found: np.ndarray, kinds: list[Crane], which: np.ndarray, start: State, indices: Any, **how: Any
) -> None:
    """Compare states of a fleet, shape (steps, 2 joints, n), with runs of some cranes alone.

    Further arguments are those of `simulate`, commands and forces by crane.
    """
    commands = how.pop("commands")
    force = how.pop("force", None)
    steps = len(found)
    for i in indices:
        own: Any = commands[:, :, i]
        push: Any = None if force is None else force[i].reshape(-1, 3)
        run = simulate(
            kinds[which[i]],
            lambda t, state, setpoint, own=own: own[min(round(t / 2e-2), steps - 1)],
            start=State(start.q[i], start.v[i]),
            duration=steps * 2e-2,
            dt=1e-3,
            control_period=2e-2,
            disturbance=None if push is None else (lambda t, state, push=push: push),
            validity="mark",
            **how,
        )
        # round-off of efforts of 1e5 N m.
        assert_allclose(found[:, :, i], np.hstack([run.q, run.v])[1:], atol=1e-11)


@pytest.mark.slow
def test_efforts_are_cut_to_the_limits_of_each_crane_as_in_simulate() -> None:
    rng = np.random.default_rng(1)
    kinds = [crane(), crane(payload_mass=2500.0, trolley_effort=5e2)]
    fleet = Fleet(kinds, COUNT, drive="effort", control_period=2e-2, dt=1e-3)
    start = scattered(rng, COUNT)
    which = rng.integers(0, 2, COUNT)
    assert which[:2].tolist() == [0, 1]
    fleet.place(np.arange(COUNT), start, which)
    drawn = rng.uniform(-1.0, 1.0, (25, 3, COUNT))
    weight = np.array([0.0, 0.0, 1e4])[:, None]
    commands = drawn * np.array([1e5, 2e3, 4e3])[:, None] - weight
    found = np.array([fleet.step(command).copy() for command in commands])
    _check_alone(found, kinds, which, start, (0, 1, COUNT - 1), commands=commands)
    assert (np.abs(commands[:, 1]) > 500.0).any()


@pytest.mark.parametrize("drive", ["effort", "motion"])
@pytest.mark.parametrize("variant", [HOOK, ROPE, BRIDGE], ids=lambda variant: variant.name)
@pytest.mark.slow
def test_cranes_of_other_topology_move_as_in_simulate_under_forces_on_their_points(
    variant: CraneVariant, drive: DirectDrive
) -> None:
    rng = np.random.default_rng(4)
    kinds = [variant.crane(), variant.crane(payload_mass=1500.0)]
    c = kinds[0]
    n = kinds[0].layout.n
    m = kinds[0].layout.m
    fleet = Fleet(kinds, COUNT, drive=drive, control_period=2e-2, dt=1e-3, forces=True)
    away = rng.uniform(-0.01, 0.01, (COUNT, n))
    rates = rng.uniform(-0.01, 0.01, (COUNT, n))
    start = State(c.start.q + away, rates)
    which = rng.integers(0, 2, COUNT)
    force = rng.uniform(-200.0, 200.0, (COUNT, 3 * len(c.points)))
    fleet.place(np.arange(COUNT), start, which)
    fleet.push(np.arange(COUNT), force)
    size = holding_effort(c, c.start.q)[:, None] + 100.0 if drive == "effort" else 0.1
    commands = rng.uniform(0.5, 1.0, (20, m, COUNT)) * size
    found = np.array([fleet.step(command).copy() for command in commands])
    how: Any = {"commands": commands, "force": force, "drive": drive}
    _check_alone(found, kinds, which, start, (0, COUNT - 1), **how)


def test_cranes_of_different_joints_are_not_one_fleet() -> None:
    with pytest.raises(
        CraneError,
        match=r"joints of a crane is yaw_joint, .*sling.*; allowed is those of the first",
    ):
        Fleet([crane(), HOOK.crane()], COUNT)


SPRING = (
    '<gazebo reference="swing_radial_joint"><springStiffness>2e4</springStiffness></gazebo></robot>'
)


@pytest.mark.slow
def test_cranes_with_springs_in_different_joints_do_not_run_together(tmp_path: Path) -> None:
    path = tmp_path / "sprung.urdf"
    path.write_text(crane().urdf.replace("</robot>", SPRING))
    cranes = [crane(), load_crane(path, gravity=9.81)]
    words = "joints of a crane with springs is swing_radial_joint; allowed is those of the first"
    with pytest.raises(CraneError, match=words):
        Fleet(cranes, COUNT)
    with pytest.raises(CraneError, match=words):
        simulate_batch(cranes, hold_controller(cranes[0]), duration=0.01)


@pytest.mark.parametrize("threads", [1, 3])
def test_how_many_there_are_and_on_how_many_threads_changes_no_bit(threads: int) -> None:
    rng = np.random.default_rng(2)
    start = scattered(rng, 900)
    command = rng.uniform(-0.1, 0.1, (3, 900))
    many = Fleet(crane(), 900, control_period=0.1, threads=threads)
    one = Fleet(crane(), 1, control_period=0.1)
    many.place(np.arange(900), start)
    assert len(many.chunks) == threads
    for _ in range(3):
        z = many.step(command)
    for i in (0, 300, 899):
        one.place(np.zeros(1), State(start.q[i], start.v[i]))
        for _ in range(3):
            alone = one.step(command[:, [i]])
        assert np.array_equal(alone[:, 0], z[:, i])


def _steered(fleet: Fleet, seed: int, steps: int = 4) -> np.ndarray:
    """States after steps of random commands."""
    rng = np.random.default_rng(seed)
    return np.array([fleet.step(rng.normal(size=(3, fleet.count))).copy() for _ in range(steps)])


@pytest.mark.slow
@pytest.mark.parametrize(("count", "threads"), [(COUNT, 1), (600, 2)])
def test_a_copy_of_a_fleet_goes_on_by_itself_from_where_the_original_was(
    count: int, threads: int
) -> None:
    fleet, alone, other = (
        Fleet([crane(), crane(payload_mass=2500.0)], count, forces=True, threads=threads)
        for _ in range(3)
    )
    for one in (fleet, alone, other):
        one.place(np.arange(3), one.cranes[0].start, np.array([0, 1, 1]))
        one.push(np.arange(2), np.full((2, 6), 30.0))
        _steered(one, 0)
    copied = deepcopy(fleet)
    for seed in (1, 2):
        assert np.array_equal(_steered(copied, 5 + seed), _steered(other, 5 + seed))
        assert np.array_equal(_steered(fleet, seed), _steered(alone, seed))


@pytest.mark.slow
def test_a_fleet_on_threads_goes_on_in_a_forked_process() -> None:
    fleet = Fleet(crane(), 600, threads=2)
    _steered(fleet, 0)
    expected = deepcopy(fleet)
    child = os.fork()
    if child == 0:
        signal.alarm(300)  # instead of hanging for ever
        os._exit(0 if np.array_equal(_steered(fleet, 1), _steered(expected, 1)) else 1)
    assert os.waitpid(child, 0)[1] == 0
    assert np.array_equal(_steered(fleet, 1), _steered(expected, 1))


def test_one_that_diverges_or_is_placed_anew_is_felt_by_no_other() -> None:
    rng = np.random.default_rng(3)
    start = scattered(rng, COUNT)
    command = rng.uniform(-0.1, 0.1, (3, COUNT))
    fleets = [Fleet(crane(), COUNT, control_period=1e-2) for _ in range(2)]
    for fleet in fleets:
        fleet.place(np.arange(COUNT), start)
    wild = command.copy()
    wild[:, 5] = 1e200
    for _ in range(3):
        calm = fleets[0].step(command).copy()
        stormy = fleets[1].step(wild)
    assert not np.isfinite(stormy[:, 5]).all()
    assert np.array_equal(np.delete(calm, 5, axis=1), np.delete(stormy, 5, axis=1))
    fleets[1].place(np.array([5]), State(start.q[5], start.v[5]))
    assert np.array_equal(fleets[1].z[:5, 5], start.q[5])
    assert np.isfinite(fleets[1].step(command)).all()


REFUSED: list[tuple[Any, str]] = [
    (lambda f: f.step(np.zeros((3, COUNT - 1))), r"command is .* \(3, 18\); .* \(3, 19\)"),
    (lambda f: f.step(np.full((3, COUNT), np.nan)), "command is nan; allowed is finite"),
    (lambda f: f.step("now"), "command is no array of numbers but str"),
    (lambda f: f.advance(7, np.zeros((3, COUNT))), "chunk is 7; allowed is 0 to 0"),
    (lambda f: f.advance(-1, np.zeros((3, COUNT))), "chunk is -1"),
    (
        lambda f: f.place(np.array([COUNT]), crane().start),
        "index of a crane is 19.0; allowed is a whole number from 0 to 18",
    ),
    (lambda f: f.place(np.array([0.5]), crane().start), "index of a crane is 0.5"),
    (lambda f: f.place(np.array([-1]), crane().start), "index of a crane is -1"),
    (
        lambda f: f.place(np.arange(3), crane().start, np.array([0, 0])),
        "cranes chosen is 2; allowed is 3",
    ),
    (
        lambda f: f.place(np.arange(2), crane().start, np.array([0, 1])),
        "index of a kind of crane is 1.0; allowed is a whole number from 0 to 0",
    ),
    (
        lambda f: f.place(np.arange(2), State(np.full(5, np.inf), np.zeros(5))),
        "coordinates at the start is inf",
    ),
    (
        lambda f: f.push(np.arange(2), np.zeros((2, 6))),
        "forces from outside is array.*made with forces = True",
    ),
]


@pytest.mark.parametrize(("call", "sentence"), REFUSED)
def test_a_call_that_could_harm_is_refused_in_a_sentence_and_changes_nothing(
    call: Any, sentence: str
) -> None:
    fleet = Fleet(crane(), COUNT, control_period=1e-2)
    before = fleet.z.copy()
    with pytest.raises(CraneError, match=sentence):
        call(fleet)
    assert np.array_equal(fleet.z, before)
    with pytest.raises(ValueError, match="read-only"):
        fleet.z[0] = 1.0


@pytest.mark.slow
def test_forces_act_until_something_else_is_said() -> None:
    fleet = Fleet(crane(), 2, control_period=1e-2, forces=True)
    fleet.push(np.array([1]), np.array([[0.0, -300.0, 0.0, 0.0, 0.0, 0.0]]))
    for _ in range(5):
        z = fleet.step(np.zeros((3, 2)))
    assert z[2, 0] == 0.0 and abs(z[2, 1]) > 1e-6
    still = abs(z[7, 1])
    fleet.push(np.array([1]), np.zeros((1, 6)))
    assert abs(abs(fleet.step(np.zeros((3, 2)))[7, 1]) - still) < 0.1 * still


def test_each_crane_moves_on_its_own_base_at_its_own_time_as_in_simulate() -> None:
    """A sum of sines, a function, a table and a base at rest, in one group of lanes."""
    t = np.linspace(0.0, 20.0, 101)
    sines = BaseMotion.sines(
        heave=(0.5, 8.0), roll=(0.1, 7.0, 0.3), pitch=(0.05, 5.0), yaw=(0.2, 9.0)
    )
    bases: list[BaseMotion | None] = [
        sines,
        sines.seen_at((3.0, -2.0, 8.0)),
        BaseMotion.from_table(t, surge=0.3 * np.sin(t), roll=0.1 * np.cos(0.7 * t)),
        None,
    ]
    start = crane().state(x=12.0, l=10.0)
    begins = np.array([0.0, 1.5, 3.0, 7.0])
    force = np.zeros((4, 3 * len(crane().layout.points)))
    force[:, :3] = [300.0, -200.0, 100.0]
    fleet = Fleet(
        crane(), 4, dt=1e-2, drive="motion", integrator=rk4, forces=True, base=True, threads=1
    )
    fleet.place(np.arange(4), start)
    fleet.stand_on(np.arange(4), bases, begins)
    fleet.push(np.arange(4), force)
    command = np.array([0.01, 0.05, -0.02])
    for _ in range(40):
        fleet.step(np.tile(command[:, None], 4))
    for i, base in enumerate(bases):
        run = simulate(
            crane(),
            lambda t, state, setpoint: command,
            start=start,
            t_start=float(begins[i]),
            duration=4.0,
            dt=1e-2,
            control_period=0.1,
            drive="motion",
            integrator=rk4,
            base=base,
            disturbance=lambda t, state: force[0].reshape(-1, 3),
            validity="mark",
            engine="compiled",
        )
        # The round-off of sums of sines, and of 400 steps.
        assert_allclose(fleet.z[:, i], np.append(run.q[-1], run.v[-1]), rtol=0.0, atol=1e-12)


def test_a_fleet_of_standing_cranes_has_no_bases_and_says_so() -> None:
    fleet = Fleet(crane(), 2)
    with pytest.raises(CraneError, match="unless the fleet is made with base = True"):
        fleet.stand_on(np.array([0]), None)
    with pytest.raises(CraneError, match="'double' with a base that moves"):
        Fleet(crane(), 2, base=True, precision="single")
    moving = Fleet(crane(), 2, base=True)
    with pytest.raises(CraneError, match="bases is 3; allowed is 2, one for each crane"):
        moving.stand_on(np.array([0, 1]), [None] * 3)
    with pytest.raises(CraneError, match="base is float; allowed is a BaseMotion"):
        moving.stand_on(np.array([0, 1]), [None, 0.5])  # type: ignore[list-item]
