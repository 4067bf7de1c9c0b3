"""Tandem lifts around obstacles: the way, distances that are proven between rows, and files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("coal", reason="extra planning (coal) is not installed")

from cranedyn.errors import DataError, OutOfRange
from cranedyn.lifts.planning.file_templates import template_text
from cranedyn.lifts.planning.lift import NoWay
from cranedyn.lifts.planning.solids import Solid, box, prism
from cranedyn.lifts.tandem.clearance import TandemDistance, tandem_distances
from cranedyn.lifts.tandem.judgement import judge_tandem
from cranedyn.lifts.tandem.plan import TandemLift, plan_tandem
from cranedyn.lifts.tandem.simulation import planned_run, simulate_tandem
from cranedyn.lifts.tandem.tandem_file import read_tandem
from cranedyn.lifts.tandem.way import RAISE_STEP, SPARE, plan_around
from cranedyn.verdict import Verdict
from tests.lifts.tandem.test_tandem import START, USUAL, YAW, lift_of, planned, yard

GOAL = (6.0, -32.0, 5.5)
STACK = box("stack", (3.0, -32.0), (1.0, 3.0, 8.0), 0.0)


def among(*solids: Solid) -> TandemLift:
    return replace(lift_of(rope=USUAL), site=replace(yard(), solids=solids))


def test_a_way_that_is_free_is_straight_and_one_that_is_not_is_raised_just_enough() -> None:
    assert not len(plan_around(among(), START, GOAL, yaw=YAW).via)
    plan = plan_around(among(STACK), START, GOAL, yaw=YAW)
    height = plan.via[0, 2]
    np.testing.assert_allclose(plan.via, [[0.0, -32.0, height], [6.0, -32.0, height]])
    # The bottom of the load clears the stack by what is required, and not by two steps more.
    required = 8.0 + 0.4 + 1.0 + SPARE
    assert required <= height < required + 2.0 * RAISE_STEP
    lower = [[x, -32.0, height - RAISE_STEP] for x in (0.0, 6.0)]
    too_low = plan_tandem(among(STACK), START, GOAL, yaw=YAW, via=lower)
    nearest = min(entry.distance for entry in tandem_distances(planned_run(too_low)))
    assert nearest < 1.0 + SPARE


def test_a_plan_by_places_moves_the_load_through_them_and_stands_still_there() -> None:
    lift = among()
    via = [[0.0, -32.0, 8.0], [6.0, -32.0, 8.0]]
    plan = plan_tandem(lift, START, GOAL, yaw=YAW, via=via)
    run = simulate_tandem(lift, plan, dt=2e-3)
    legs = [
        plan_tandem(lift, *ends, yaw=YAW).duration
        for ends in ((START, via[0]), (via[0], via[1]), (via[1], GOAL))
    ]
    assert plan.duration == pytest.approx(sum(legs))
    for place, t in zip(via, np.cumsum(legs[:2]), strict=True):
        row = int(np.searchsorted(run.t, t))
        # The roll of the beam that the plan neglects, as at its end: millimetres.
        np.testing.assert_allclose(run.centres[row], place, atol=5e-3)
        speed = np.linalg.norm(run.centres[row + 1] - run.centres[row]) / 0.02
        assert speed < 0.02
    with pytest.raises(OutOfRange, match="None where the way has places"):
        plan_tandem(lift, START, GOAL, yaw=YAW, via=via, duration=60.0)


def test_what_is_proven_between_rows_holds_at_all_rows_of_a_denser_run() -> None:
    """Rows half a second apart prove no more than rows 25 times as dense measure."""
    plan = planned()
    lift = replace(plan.lift, site=replace(yard(), solids=(STACK, *zones())))
    found = {}
    for period in (0.5, 0.02):
        run = simulate_tandem(lift, plan, dt=4e-3, duration=16.0, period=period)
        found[period] = {entry.between: entry for entry in tandem_distances(run)}
    assert set(found[0.5]) == set(found[0.02])
    for name, sparse in found[0.5].items():
        dense = found[0.02][name]
        assert sparse.proven <= dense.distance + 1e-9, name
        assert dense.proven <= dense.distance
        # The bound is of use: no more than what moves in half a second is lost.
        assert sparse.proven > dense.distance - 1.0, name


def zones() -> list[Solid]:
    outline = np.array([[-9.0, -40.0], [-6.0, -40.0], [-6.0, -25.0], [-9.0, -25.0]])
    return [prism("street", outline, 0.0, 12.0, zone=True)]


def test_only_what_hangs_keeps_out_of_a_zone_and_no_distance_is_required_of_it() -> None:
    lift = replace(planned().lift, site=replace(yard(), solids=tuple(zones())))
    run = replace(planned_run(planned()), lift=lift)
    of_zone = [entry for entry in tandem_distances(run) if entry.from_zone]
    names = {entry.between for entry in of_zone}
    assert names == {
        "the load and street",
        "the rope of north and street",
        "the rope of south and street",
    }
    assert all(entry.required(1.0) == 0.0 for entry in of_zone)
    assert TandemDistance("a and b", 2.0, 0.0, 1.9).required(1.0) == 1.0


def test_a_lift_without_a_way_is_refused_with_what_would_be_enough() -> None:
    near = box("near", (-1.0, -32.0), (1.0, 30.0, 6.0), 0.0)
    with pytest.raises(NoWay, match=r"At the start, the load and near are .* Move the start away"):
        plan_around(among(near), START, GOAL, yaw=YAW)
    tall = box("wall", (3.0, -32.0), (1.0, 4.0, 40.0), 0.0)
    with pytest.raises(NoWay) as refused:
        plan_around(among(tall), (0.0, -32.0, 21.0), (6.0, -32.0, 21.0), yaw=YAW)
    sentence = str(refused.value)
    assert "Straight, the load and wall are" in sentence and "required, and 0.1 m more" in sentence
    assert "give places in between as via" in sentence and "its hoist has" in sentence


def test_an_obstacle_that_is_too_near_fails_with_what_is_missing() -> None:
    plan = planned()
    lift = replace(plan.lift, site=replace(yard(), solids=(STACK,)))
    run = simulate_tandem(lift, plan, dt=4e-3)
    failing = [check for check in judge_tandem(run) if check.verdict is Verdict.FAILS]
    assert len(failing) == 1
    assert "Between the load and stack" in failing[0].sentence
    assert failing[0].sentence.endswith("m are missing.")


def written(tmp_path: Path, **changes: str) -> Path:
    """Write the template with some of its lines replaced."""
    text = template_text("tandem")
    for begin, line in changes.items():
        lines = text.splitlines()
        place = next(i for i, old in enumerate(lines) if old.startswith(f"{begin} ="))
        lines[place] = line
        text = "\n".join(lines)
    file = tmp_path / "lift.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_the_template_is_planned_around_its_obstacle_in_its_wind(tmp_path: Path) -> None:
    job = read_tandem(written(tmp_path))
    assert job.wind is not None and job.via is None
    assert job.plan().via[0, 2] > 7.0
    own = written(tmp_path, inclination="via = [[-2.0, -32.0, 12.0], [6.0, -32.0, 12.0]]")
    assert read_tandem(own).plan().via[0, 2] == 12.0


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"cranes": 'cranes = ["north"]'}, r"line 8, \[tandem\] cranes: allowed are two names"),
        ({"cranes": 'cranes = ["north", "east"]'}, r"no crane 'east'"),
        ({"lugs": "lugs = [[0.0, 0.0, 0.4]]"}, r"\[load\] lugs: allowed are two places"),
        ({"mass": "mass = -1.0"}, r"\[load\] mass: mass is -1.0 kg"),
        ({"stiffness": "stifness = 2e7"}, r"\[rope\] stifness"),
        ({"speed": "gust = 3.0"}, r"\[load_wind\] speed: it is missing"),
        ({"from": "from = [1.0, 2.0]"}, r"\[tandem\] from: .* 3 numbers"),
    ],
)
def test_a_file_is_refused_with_line_and_field(
    tmp_path: Path, changes: dict[str, str], sentence: str
) -> None:
    with pytest.raises(DataError, match=sentence):
        read_tandem(written(tmp_path, **changes))


def test_a_file_without_a_load_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "lift.toml"
    file.write_text('[tandem]\ncranes = ["a", "b"]\n', encoding="utf-8")
    with pytest.raises(DataError, match=r"a tandem lift needs a table \[load\]"):
        read_tandem(file)
