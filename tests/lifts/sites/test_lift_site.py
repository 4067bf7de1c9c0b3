"""A lift of a shift as the site of one crane: what is written is what the plan of the shift has."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.errors import DataError
from cranedyn.lifts.planning.site import Site
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.lifts.sites.crane_site_file import SITES, read_crane_site
from cranedyn.lifts.sites.lift_site import (
    drive_positions,
    folder_name,
    toml_text,
    write_lift_site,
)
from cranedyn.lifts.sites.shift_plan import PlannedLift, ShiftPlan, plan_shift

slow = pytest.mark.slow


@cache
def shift_of(example: str) -> ShiftPlan:
    """Return the plan of an example shift."""
    return plan_shift(read_crane_site(example))


def site_of(example: str, lift: str, folder: Path) -> tuple[ShiftPlan, PlannedLift, Site]:
    """Return the plan of an example shift, one of its lifts, and its site as it reads back."""
    shift = shift_of(example)
    planned = next(x for x in shift.lifts if x.lift.name == lift)
    source = SITES / f"{example}.toml"
    return shift, planned, read_site(write_lift_site(shift, planned, source, folder))


@slow
def test_the_site_of_a_lift_has_its_crane_its_ends_and_its_times(tmp_path: Path) -> None:
    _, planned, site = site_of("two_towers_shift", "bucket", tmp_path)
    assert planned.crane == "south"
    assert np.array_equal(site.foot, [0.0, -55.0, 0.0])
    assert site.heading == pytest.approx(-math.pi / 2.0)
    assert site.crane["pivot_height"] == 50.0
    assert site.crane["payload_mass"] == pytest.approx(1000.0)  # with hook and slings
    assert np.array_equal(site.start, [-5.0, -30.0, 3.0])
    assert np.array_equal(site.goal, [20.0, -20.0, 12.0])
    assert site.distance == 1.0
    of_shift = site.details.shift
    assert of_shift is not None
    assert (of_shift.lift, of_shift.crane) == ("bucket", "south")
    assert of_shift.after == "formwork, rebar unhooked"
    (other,) = of_shift.others
    assert other.startswith("north brings facade from ")
    assert site.details.people.communication == "radio, a channel for each crane"


@slow
def test_the_other_crane_is_a_neighbour_where_it_is_when_the_load_leaves(tmp_path: Path) -> None:
    """Its hook is where the plan has it: the lowest point of the neighbour in that column."""
    shift, planned, site = site_of("two_towers_shift", "bucket", tmp_path)
    (parked,) = [solid for solid in site.solids if solid.name == "north"]
    station = shift.plan.site.stations[0]
    drives = drive_positions(shift, 0, planned.off)
    _, (load,) = station.plumb(drives[None])
    middle = min(parked.parts, key=lambda part: float(np.linalg.norm(part.mean(axis=0) - load)))
    assert np.linalg.norm(middle.mean(axis=0) - load) < 1.0
    begin = drive_positions(shift, 0, 0.0)
    assert np.abs(drives - begin).max() > 0.1  # it has moved until then


@slow
def test_a_bridge_on_the_same_runway_has_no_rails_of_its_own(tmp_path: Path) -> None:
    shift = shift_of("two_bridges")
    planned = shift.lifts[0]
    path = write_lift_site(shift, planned, SITES / "two_bridges.toml", tmp_path)
    assert "on_runway = true" in path.read_text("utf-8")
    site = read_site(path)
    (parked,) = [solid for solid in site.solids if solid.name != planned.crane]
    # Columns of the runway would reach the ground.
    assert parked.vertices[:, 2].min() > 1.0


@slow
def test_rigging_that_weighs_more_than_what_hangs_is_refused(tmp_path: Path) -> None:
    shift = shift_of("two_towers_shift")
    planned = shift.lifts[0]
    light = replace(planned, lift=replace(planned.lift, load=100.0))
    with pytest.raises(DataError, match=r"the rigging of the lift formwork weighs 130 kg"):
        write_lift_site(shift, light, SITES / "two_towers_shift.toml", tmp_path)


@slow
def test_folders_are_named_by_number_and_plain_letters() -> None:
    shift = shift_of("two_towers_shift")
    first = shift.lifts[0]
    strange = replace(first, lift=replace(first.lift, name="../Träger <3>"))
    renamed = replace(shift, lifts=(strange, *shift.lifts[1:]))
    assert folder_name(renamed, strange) == "01_tr_ger_3"


def test_a_content_reads_back_as_it_was(tmp_path: Path) -> None:
    content = {
        "name": 'a "quoted" name, ü',
        "ground": {"height": 0.0, "mat": [1.5, 2], "flag": True},
        "box": [{"name": "a", "size": [1.0, 2.0, 3.0]}, {"values": {"x": 1.0}}],
    }
    assert tomllib.loads(toml_text(content)) == content


@pytest.mark.parametrize(
    ("report", "reason"),
    [
        ("[report.peoples]\nsupervisor = 'A'\n", r"line \d\d, .* There is no table 'peoples'"),
        ("[report]\npeople = 'A'\n", r"report\.people: it must be a table"),
    ],
)
def test_a_report_of_unknown_tables_is_refused(tmp_path: Path, report: str, reason: str) -> None:
    text = (SITES / "two_towers.toml").read_text("utf-8")
    file = tmp_path / "site.toml"
    file.write_text(f"{text}\n{report}", "utf-8")
    with pytest.raises(DataError, match=reason):
        read_crane_site(file)
