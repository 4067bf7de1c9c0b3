"""Tasks as data, and the instances drawn from them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from cranedyn.benchmark.limits import AGREEMENT, least_time, least_time_motion
from cranedyn.benchmark.task import (
    FOLDER,
    KINDS,
    MOVES,
    RANGES,
    all_tasks,
    instances,
    read_tasks,
    seed_of,
    select_tasks,
)
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName
from tests.benchmark.toys import TOY, toy

DATES = ("public", "2026-11-28", "2026-11-29")


def changed(folder: Path, before: str, after: str, original: Path = TOY) -> Path:
    """A file of tasks, by default that of the short ones, with one text replaced."""
    text = original.read_text(encoding="utf-8")
    assert before in text
    file = folder / original.name
    file.write_text(text.replace(before, after, 1), encoding="utf-8")
    return file


def test_every_crane_has_a_task_of_every_kind_and_moves_have_their_least_time() -> None:
    tasks = all_tasks()
    for crane in {task.crane_name for task in tasks}:
        assert [task.kind for task in tasks if task.crane_name == crane] == [*KINDS]
    for task in tasks:
        assert (task.least_time is not None) == (task.kind in MOVES)


@pytest.mark.parametrize(
    "crane", ["gantry", "inteco", "overhead", "tower", "luffing", "hook", "ship"]
)
def test_starts_goals_and_paths_are_within_the_ranges_of_the_crane_with_any_rope(
    crane: str,
) -> None:
    for task in select_tasks([crane]):
        nominal = task.crane()
        drives = nominal.layout.drives
        places = [task.start_state().q[drives]]
        goal = task.goal_state()
        if goal is not None:
            places.append(goal.q[drives])
        places += [np.array(waypoint) for waypoint in task.waypoints]
        for offset in task.ranges.get("rope_offset", (0.0, 0.0)):
            for place in places:
                longer = place.copy()
                longer[nominal.winch] += offset
                assert (longer > nominal.lower[drives]).all(), task.name
                assert (longer < nominal.upper[drives]).all(), task.name


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("period = 0.02", "period = -0.02", "line 15, [clock] period"),
        ("swing_bound = 0.2\n\n[tasks.path]", "swing = 0.2\n\n[tasks.path]", "[tasks.move] swing:"),
        ("corridor = 0.08\n", "", "[tasks.path] corridor: it is missing"),
        ("rope_offset", "rope_ofset", "There is no field 'rope_ofset'"),
        ("[0.5, 1.5]", "[1.5, 0.5]", "the lower end first"),
        ("repeats = 1", "often = 1", "gusts"),
        ("count = 2", "count = 2000", "1000 at most"),
    ],
)
def test_a_field_that_is_wrong_is_refused_with_its_place(
    before: str, after: str, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError) as error:
        read_tasks(changed(tmp_path, before, after))
    assert sentence in str(error.value)


def test_the_digest_of_a_task_is_that_of_all_its_numbers_and_of_no_other_task(
    tmp_path: Path,
) -> None:
    usual = {task.kind: task.digest for task in read_tasks(TOY)}
    other = {
        task.kind: task.digest
        for task in read_tasks(changed(tmp_path, "corridor = 0.08", "corridor = 0.09"))
    }
    assert {kind for kind in usual if usual[kind] != other[kind]} == {"path"}


def test_the_nominal_instance_is_what_an_entry_is_told() -> None:
    nominal, *perturbed = instances(toy("move"))
    assert nominal.values == RANGES
    assert len(perturbed) == 2
    for instance in perturbed:
        for name, value in instance.values.items():
            low, high = instance.task.ranges.get(name, (RANGES[name], RANGES[name]))
            assert low <= value <= high
        assert 0.5 <= instance.values["payload_factor"] <= 1.5
        assert instance.values["payload_factor"] != 1.0


def test_instances_depend_on_their_seeds_alone() -> None:
    task = toy("move")
    assert instances(task, "2026-11-28") == instances(task, "2026-11-28")
    drawn = {seeds: instances(task, seeds)[1].values["payload_factor"] for seeds in DATES}
    assert len(set(drawn.values())) == len(DATES)
    text = "cranedyn benchmark v1 2026-11-28 toy/move 1"
    by_hand = int(hashlib.sha256(text.encode()).hexdigest()[:16], 16)
    assert seed_of("2026-11-28", "toy/move", 1) == by_hand


def test_a_further_range_changes_no_other_number(tmp_path: Path) -> None:
    more = changed(tmp_path, "count = 2", "count = 3\nlag_factor = [0.5, 2.0]")
    for usual, other in zip(
        instances(toy("move"))[1:], instances(read_tasks(more)[0])[1:], strict=False
    ):
        differing = {name for name in RANGES if usual.values[name] != other.values[name]}
        assert differing == {"lag_factor"}


def test_a_ship_moves_by_waves_of_its_own_in_each_instance_and_land_does_not() -> None:
    (task,) = select_tasks(["ship/move"])
    assert task.sea is not None
    drawn = instances(task)
    times = np.linspace(0.0, task.duration, 601)
    heave = []
    for instance in drawn:
        base = instance.base_motion()
        assert base is not None
        heave.append(base.at(times).position[:, 2] / instance.values["sea_factor"])
    # The shapes of the waves differ, and not their heights alone.
    assert len({round(float(row[100]), 9) for row in heave}) == len(drawn)
    # The heave of a ship is not above that of the waves for long: hs is four standard deviations.
    assert 0.1 * task.sea.hs < np.std(heave[0]) < 0.4 * task.sea.hs
    assert drawn[0].values["sea_factor"] == 1.0
    assert instances(toy("move"))[1].base_motion() is None


def test_a_crane_on_land_keeps_its_instances_though_there_is_a_sea_now() -> None:
    """Numbers drawn before there were ships."""
    (task,) = select_tasks(["inteco/move"])
    values = instances(task)[1].values
    rng = np.random.default_rng(seed_of("public", "inteco/move", 1))
    first, second = rng.random(2)
    assert values["payload_factor"] == pytest.approx(0.8 + 0.4 * first)
    assert values["rope_offset"] == pytest.approx(-0.02 + 0.04 * second)
    rng.random(9)
    signs = rng.choice([-1.0, 1.0], size=2)
    assert instances(task)[1].swing_signs == tuple(signs)
    assert instances(task)[1].noise_seed == int(rng.integers(2**63))


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("1.0, 0.0, 0.25,", "1.0, 0.25,", "rows of 7 numbers"),
        ("place = [-6.0, 4.0, 6.0]", "place = [-6.0]", "3 numbers"),
        ("hs = 0.8", "hs = -0.8", "> 0"),
        ("tp = 11.0", "period = 11.0", "period"),
    ],
)
def test_a_sea_that_is_wrong_is_refused(
    before: str, after: str, sentence: str, tmp_path: Path
) -> None:
    with pytest.raises(DataError) as error:
        read_tasks(changed(tmp_path, before, after, FOLDER / "ship.toml"))
    assert sentence in str(error.value)


def test_unknown_seeds_and_tasks_are_refused() -> None:
    with pytest.raises(OutOfRange, match="a date such as"):
        instances(toy("move"), "tomorrow")
    with pytest.raises(UnknownName, match="the nearest is tower"):
        select_tasks(["towr"])


@pytest.mark.slow
def test_a_least_time_is_not_below_that_of_the_drives_alone() -> None:
    """From rest to rest over d at the rate v, the acceleration a and the jerk j, a drive needs
    d/v + v/a + a/j.
    """
    pytest.importorskip("casadi")
    (task,) = select_tasks(["inteco/move"])
    motion = least_time_motion(task)
    drives_alone = 0.4 / 0.3 + 0.3 / 0.6 + 0.6 / 6.0
    assert drives_alone - task.period < motion.arrival < 1.5 * drives_alone
    swing = np.abs(task.crane().swing_angles(motion.q))
    assert swing.max() < task.swing_bound + 1e-3


@pytest.mark.slow
def test_the_least_time_in_a_file_is_the_computed_one() -> None:
    pytest.importorskip("casadi")
    (task,) = select_tasks(["inteco/move"])
    assert task.least_time == pytest.approx(least_time(task), abs=AGREEMENT)
    with pytest.raises(CraneError, match="one with a goal"):
        least_time(toy("wind"))


@pytest.mark.parametrize(
    ("name", "ramps"), [("inteco/move", [0.1]), ("hook/move", [0.0, 1.0, 0.2])]
)
def test_the_least_time_of_a_load_on_a_sling_is_sought_by_way_of_easier_motions(
    name: str, ramps: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each search begins with the motion of the one before, and the last has the ramp of the
    drives.
    """
    optimal_module = pytest.importorskip("cranedyn.lifts.planning.optimal", exc_type=CraneError)
    calls = []

    def recorded(*places: object, ramp: float, begin: object, **options: object) -> str:
        calls.append((ramp, begin))
        return f"motion with the ramp {ramp:g}"

    monkeypatch.setattr(optimal_module, "optimal", recorded)
    (task,) = select_tasks([name])
    assert least_time_motion(task) == f"motion with the ramp {ramps[-1]:g}"
    assert [ramp for ramp, _ in calls] == pytest.approx(ramps)
    begins = [begin for _, begin in calls]
    assert begins == [None, *(f"motion with the ramp {ramp:g}" for ramp in ramps[:-1])]
