"""Load charts by length of the boom: what counts between two lengths, and what is not covered."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import DataError, OutOfRange, UnknownName
from cranedyn.lifts.judging.chart import Chart, NotCovered, RatedLoads, read_chart, utilisation
from cranedyn.lifts.judging.chart_setup import setup_gap
from cranedyn.lifts.judging.lift_checks import utilisation_below_warning
from cranedyn.lifts.judging.lift_positions import interpolation
from cranedyn.lifts.judging.loads import Loads
from cranedyn.lifts.planning.site import Base, Site
from cranedyn.verdict import Verdict

SHORT = RatedLoads(4, np.array([4.0, 8.0, 12.0]), np.array([40e3, 18e3, 9e3]), 3.0, 20.0)
LONG = RatedLoads(4, np.array([6.0, 10.0, 16.0]), np.array([20e3, 12e3, 7e3]), 6.0, 30.0)
CHART = Chart("test", "", (SHORT, LONG))
G = 9.80665

TABLE = """radius_m, 20.0, 30.0
4.0, 40,
6.0, 26, 20
8.0, 18, 15.5

10.0, 13, 12
16.0, , 7
"""

TOML = 'name = "a"\nsource = "b"\n[[falls]]\ncount = 4\ntable = "loads.csv"\nunit = "t"\n'


def carried(radius: float, boom: float | None, mass: float = 9e3) -> Loads:
    """Loads of one row in which a mass hangs at a radius from a boom."""
    columns = {"pull_N": np.array([mass * G]), "radius_m": np.array([radius])}
    if boom is not None:
        columns["boom_m"] = np.array([boom])
    return Loads(np.zeros(1), columns)


@pytest.mark.parametrize(("boom", "reeving"), [(20.0, SHORT), (20.04, SHORT), (29.96, LONG)])
def test_a_length_of_the_chart_within_half_a_decimetre_has_its_loads(
    boom: float, reeving: RatedLoads
) -> None:
    assert CHART.on(4, boom) is reeving
    used = utilisation(carried(10.0, boom), CHART)
    assert used == pytest.approx(9e3 / float(reeving.at(10.0)))


def test_the_points_about_a_radius_are_those_of_the_boom_of_the_run() -> None:
    """Of a boom that does not telescope the site has no length."""
    analysis = SimpleNamespace(
        chart=CHART,
        utilisation=np.array([0.5]),
        inputs=SimpleNamespace(falls=4),
        loads=carried(9.0, 30.0),
        site=SimpleNamespace(boom=None),
    )
    assert interpolation(analysis, 9.0) == "between 6 and 10 m"  # type: ignore[arg-type]


def test_between_two_lengths_the_smaller_load_counts_at_the_points_of_both() -> None:
    between = CHART.on(4, 25.0)
    # At 8 m: 18 t of the short boom; of the long one the moment is (120 + 120)/2 t m, so 15 t.
    assert between.at(8.0) == pytest.approx(15e3)
    # At 12 m: 9 t of the short boom; of the long one (120 - 8 2/6)/12 = 9.8 t.
    assert between.at(12.0) == pytest.approx(9e3)
    assert (between.least, between.radii[-1]) == (6.0, 12.0)


@given(st.floats(20.06, 29.94), st.floats(6.0, 12.0))
def test_between_two_lengths_no_load_is_more_than_that_of_either(
    boom: float, radius: float
) -> None:
    smaller = min(float(SHORT.at(radius)), float(LONG.at(radius)))
    counted = float(CHART.on(4, boom).at(radius))
    assert counted <= smaller * (1.0 + 1e-12)
    assert counted >= 0.85 * smaller  # of use: it errs only where both curves cross between points
    linear = replace(CHART, between_booms="linear").on(4, boom)
    assert float(linear.at(radius)) >= counted * (1.0 - 1e-12)


def test_a_chart_interpolates_between_lengths_only_if_it_says_so() -> None:
    linear = replace(CHART, between_booms="linear")
    # A quarter of the way from 18 t to 15 t.
    assert linear.on(4, 22.5).at(8.0) == pytest.approx(18e3 - 0.25 * 3e3)
    none = replace(CHART, between_booms="none")
    assert none.on(4, 20.0) is SHORT
    with pytest.raises(NotCovered, match=r"boom on 4 falls is 25 m; .* no loads for lengths betw"):
        none.on(4, 25.0)


@pytest.mark.parametrize("boom", [19.9, 30.1, 50.0])
def test_a_boom_beyond_the_chart_is_not_covered(boom: float) -> None:
    with pytest.raises(NotCovered, match="allowed is 20 to 30, where the chart is"):
        CHART.on(4, boom)


def test_a_boom_of_unknown_length_is_not_covered_and_one_that_telescopes_neither() -> None:
    with pytest.raises(NotCovered, match="length of the boom on 4 falls is not known"):
        utilisation(carried(8.0, None), CHART)
    columns = {
        "pull_N": np.full(2, 1e4),
        "radius_m": np.array([8.0, 8.0]),
        "boom_m": np.array([22.0, 24.0]),
    }
    with pytest.raises(NotCovered, match="the chart is not for telescoping under load"):
        utilisation(Loads(np.arange(2.0), columns), CHART)


def test_a_radius_of_another_boom_is_not_permitted_and_one_of_no_boom_not_covered() -> None:
    # At 14 m the chart has loads for the long boom: the field of the short one is empty.
    with pytest.raises(OutOfRange, match="4 falls and a boom of 20 m is 14 m") as refused:
        utilisation(carried(14.0, 20.0), CHART)
    assert not isinstance(refused.value, NotCovered)
    for radius in (2.9, 16.1):
        with pytest.raises(NotCovered, match="3 to 16, where the chart is for any boom"):
            utilisation(carried(radius, 20.0), CHART)


@pytest.fixture
def chart_file(tmp_path: Path) -> Path:
    (tmp_path / "loads.csv").write_text(TABLE)
    file = tmp_path / "chart.toml"
    file.write_text(TOML)
    return file


def test_a_table_of_radii_and_booms_is_read_as_makers_print_it(chart_file: Path) -> None:
    chart = read_chart(chart_file)
    assert chart.booms(4) == [20.0, 30.0]
    short, long = chart.of_falls(4)
    assert short.radii.tolist() == [4.0, 6.0, 8.0, 10.0]
    assert short.rated.tolist() == [40e3, 26e3, 18e3, 13e3]
    assert long.radii.tolist() == [6.0, 8.0, 10.0, 16.0]
    # Below its first load a column permits nothing.
    assert (short.least, long.least) == (4.0, 6.0)


def test_a_row_of_empty_cells_permits_nothing_at_its_radius(chart_file: Path) -> None:
    chart_file.with_name("loads.csv").write_text(TABLE.replace("16.0, , 7", "16.0, , "))
    assert read_chart(chart_file).of_falls(4)[1].radii[-1] == 10.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("8.0, 18, 15.5", "8.0, , 15.5", "boom of 20 m has no load at 8 m"),
        ("8.0, 18, 15.5", "8.0, 18", "line 4: it has 2 cells, and the first line 3"),
        ("8.0, 18, 15.5", "8.0, many, 15.5", "line 4: load is many; allowed is a number above 0"),
        ("8.0, 18, 15.5", "8.0, -1, 15.5", "line 4: load is -1"),
        ("8.0, 18, 15.5", "8.0, nan, 15.5", "line 4: load is nan"),
        ("8.0, 18, 15.5", "8.0, 27, 15.5", "column of the boom of 20 m: .* no more than at a smal"),
        ("10.0, 13", "7.0, 13", "column of the boom of 20 m: radius of a point is 7 m after 8 m"),
        ("20.0, 30.0", "20.0, 20.05", "two lengths on 4 falls that are less than 0.1 m apart"),
        ("20.0, 30.0", "20.0, x", "line 1: length of the boom is x"),
    ],
)
def test_what_is_no_table_is_refused_in_a_sentence(
    old: str, new: str, words: str, chart_file: Path
) -> None:
    table = chart_file.with_name("loads.csv")
    changed = TABLE.replace(old, new)
    assert changed != TABLE
    table.write_text(changed)
    with pytest.raises(DataError, match=words):
        read_chart(chart_file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('unit = "t"', 'unit = "lb"', "There is no unit 'lb'; there are kg and t|lb"),
        ('unit = "t"', "boom = 20.0", "table is given, too, which has the loads"),
        ('table = "loads.csv"', "radii = [4.0]\nloads = [3.0]", "it is for loads of a table"),
        ('table = "loads.csv"', 'table = "../loads.csv"', "lies outside of the folder"),
        ('source = "b"', 'source = "b"\nbetween_booms = "larger"', "no rule 'larger'"),
        ('source = "b"', 'source = "b"\ncounterweight = -1.0', "counterweight"),
        (
            "[[falls]]",
            "[[falls]]\ncount = 4\nradii = [4.0]\nloads = [3.0]\n[[falls]]",
            "one .* of 4 falls has a boom and another one none",
        ),
    ],
)
def test_a_chart_of_booms_is_refused_with_its_field(
    old: str, new: str, words: str, chart_file: Path
) -> None:
    assert old in TOML
    chart_file.write_text(TOML.replace(old, new))
    with pytest.raises(DataError, match=words):
        read_chart(chart_file)


def test_booms_in_the_chart_itself_are_sorted_and_falls_named(tmp_path: Path) -> None:
    file = tmp_path / "chart.toml"
    entry = "[[falls]]\ncount = 2\nboom = {}\nradii = [4.0]\nloads = [{}]\n"
    file.write_text('name = "a"\nsource = "b"\n' + entry.format(30, 5e3) + entry.format(20, 8e3))
    chart = read_chart(file)
    assert chart.booms() == [20.0, 30.0]
    assert chart.on(None, 20.0).at(4.0) == 8e3
    with pytest.raises(UnknownName, match="There is no number of falls '3'; there are 2"):
        chart.on(3, 20.0)


SITE = Site("s", (), telescope="telescope_joint", boom=20.0)
NEEDS = replace(CHART, counterweight=12e3, outriggers=6.4)


@pytest.mark.parametrize(
    ("chart", "site", "words"),
    [
        (CHART, SITE, ""),
        (Chart("c", "", (replace(SHORT, boom=None),)), SITE, "give each .*falls.* its boom"),
        (NEEDS, SITE, "counterweight of 12000 kg, and .crane. counterweight of the site is mis"),
        (NEEDS, replace(SITE, counterweight=9e3), "12000 kg, and the crane has 9000 kg"),
        (NEEDS, replace(SITE, counterweight=12e3), r"\[base\] of the site is missing"),
        (
            NEEDS,
            replace(SITE, counterweight=12e3, base=Base(5.0, 0.0)),
            "outriggers 6.4 m apart, and .base. spacing of the site is 5 m",
        ),
        (NEEDS, replace(SITE, counterweight=12e3, base=Base(6.36, 0.0)), ""),
    ],
)
def test_a_chart_is_for_one_counterweight_and_one_base(
    chart: Chart, site: Site, words: str
) -> None:
    reason = setup_gap(chart, 4, site)
    assert re.search(words, reason) and bool(words) == bool(reason)


@pytest.mark.parametrize(
    ("covers", "verdict"), [(False, Verdict.NOT_JUDGED), (True, Verdict.FAILS)]
)
def test_what_a_chart_says_nothing_about_is_not_judged_and_what_it_does_not_permit_fails(
    covers: bool, verdict: Verdict
) -> None:
    analysis = SimpleNamespace(
        chart=CHART, chart_covers=covers, chart_error="the reason.", utilisation=None
    )
    check = utilisation_below_warning(analysis)  # type: ignore[arg-type]
    assert check.verdict is verdict
    assert check.sentence.endswith(": the reason.")


def test_charts_of_makers_have_the_loads_of_their_sheets_and_between_them_no_more() -> None:
    pound = 0.45359237
    foot = 0.3048
    large = read_chart("terex_rt665")
    assert not large.example
    assert large.booms() == pytest.approx([36.0 * foot, 51.0 * foot], abs=0.005)
    for boom, radius, load in ((36, 30, 37800), (36, 10, 130000), (51, 45, 21400), (51, 20, 63400)):
        rated = float(large.on(boom=boom * foot).at(round(radius * foot, 6)))
        assert load * pound - 1.0 < rated <= load * pound
    # The same sheet gives the angle of the boom at each radius: its hinge is some four feet behind
    # the slew axis.
    hinges = []
    for boom, radius, angle in ((36, 10, 67.1), (36, 30, 18.0), (51, 10, 74.1), (51, 45, 15.0)):
        hinges.append(boom * math.cos(math.radians(angle)) - radius)
    assert np.ptp(hinges) < 0.6
    small = read_chart("terex_rt335")
    assert small.booms() == [9.23, 11.89, 15.24]
    assert float(small.on(boom=15.24).at(12.0)) == 7200.0
    with pytest.raises(NotCovered):
        small.on(boom=20.0)


def test_a_chart_is_an_example_where_it_says_so() -> None:
    assert read_chart("laboratory").example
    assert not read_chart("mct88").example
