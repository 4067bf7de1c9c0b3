"""Charts: what may hang at a radius, what a run takes of it, and what is no chart."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName
from cranedyn.lifts.judging.chart import (
    CHARTS,
    Chart,
    CutOut,
    RatedLoads,
    assess_run,
    cut_outs,
    read_chart,
    utilisation,
)
from cranedyn.lifts.judging.loads import loads
from cranedyn.simulation.simulate import simulate
from tests.helpers import crane, locked

MCT88 = read_chart(CHARTS / "mct88.toml")
LABORATORY = read_chart(CHARTS / "laboratory.toml")


@st.composite
def falls(draw: st.DrawFn) -> RatedLoads:
    """A chart of two to eight points whose loads do not rise."""
    count = draw(st.integers(2, 8))
    steps = draw(st.lists(st.floats(0.1, 10.0), min_size=count, max_size=count))
    loads = draw(st.lists(st.floats(10.0, 2e4), min_size=count, max_size=count))
    return RatedLoads(2, np.cumsum(steps), np.sort(loads)[::-1].copy())


def test_an_example_chart_is_read_by_its_name_and_another_name_is_refused() -> None:
    assert read_chart("mct88").name == MCT88.name
    with pytest.raises(UnknownName, match="mct88"):
        read_chart("mct99")


def test_between_its_points_the_moment_is_a_straight_line() -> None:
    rated = MCT88.on().at(np.array([5.0, 20.1, 25.0, 29.9]))  # the maker's points, the first inward
    np.testing.assert_allclose(rated, [3900.0, 3900.0, 2990.0, 2540.0], rtol=1e-15)
    halfway = (20.1 + 25.0) / 2.0
    moment = (20.1 * 3900.0 + 25.0 * 2990.0) / 2.0
    assert MCT88.on().at(halfway) * halfway == pytest.approx(moment, rel=1e-14)


@given(falls(), st.floats(0.0, 1.0))
def test_it_is_never_above_the_chart(made: RatedLoads, share: float) -> None:
    radius = made.radii[0] + share * (made.radii[-1] - made.radii[0])
    rated = made.at(radius)
    # A straight line of the loads is above, and so is the point before; both to round-off.
    chord = np.interp(radius, made.radii, made.rated)
    before = made.rated[max(int(np.searchsorted(made.radii, radius, "right")) - 1, 0)]
    assert rated <= chord * (1.0 + 1e-12)
    assert rated <= before
    assert rated >= made.rated[-1] * (1.0 - 1e-12)


def test_between_two_points_of_one_load_a_chart_says_that_load_and_never_a_bit_more() -> None:
    flat = RatedLoads(2, np.array([10.0, 20.0, 30.0]), np.array([3900.0, 3900.0, 2500.0]))
    rated = flat.at(np.linspace(0.0, 20.0, 2001))
    assert rated.max() == 3900.0
    np.testing.assert_allclose(rated, 3900.0, rtol=1e-15)


def test_a_load_at_rest_takes_its_share_and_one_that_is_lifted_faster_more() -> None:
    of = crane(payload_mass=2000.0)
    start = of.state(x=20.0)
    rest = simulate(of, locked, start=start, duration=0.05, drive="motion")
    used, stops = assess_run(of, rest, LABORATORY)
    np.testing.assert_allclose(used, 2000.0 / 2500.0, rtol=1e-11)
    assert stops == []
    up = simulate(
        of,
        lambda t, *_: np.array([0.0, 0.0, -3.0 if t > 0.0249 else -1.5]),
        start=start,
        duration=0.05,
        drive="motion",
    )
    used, stops = assess_run(of, up, LABORATORY)
    np.testing.assert_allclose(used[0], 0.8 * (1.0 + 1.5 / of.gravity), rtol=1e-11)
    assert [one.kind for one in stops] == ["warning", "cut-out"]
    assert stops[1].t == pytest.approx(0.025)
    assert stops[1].most == pytest.approx(used[-1])


BY_HAND = Chart(
    "by hand",
    "moments of 40 t m and 60 t m",
    (
        RatedLoads(2, np.array([10.0, 20.0]), np.array([4000.0, 2000.0]), 2.0),
        RatedLoads(4, np.array([10.0, 20.0]), np.array([6000.0, 3000.0]), 2.0),
    ),
)


@pytest.mark.parametrize(("falls", "rated"), [(None, 2500.0), (2, 2500.0), (4, 3750.0)])
def test_utilisation_is_that_of_a_chart_by_hand(falls: int | None, rated: float) -> None:
    """At 16 m a moment of 40 t m leaves 2500 kg, and one of 60 t m 3750 kg."""
    of = crane(payload_mass=2000.0)
    run = simulate(of, locked, start=of.state(x=16.0), duration=0.02, drive="motion")
    used, stops = assess_run(of, run, BY_HAND, falls)
    # Of masses, whatever gravity: that of the crane counts on both sides.
    np.testing.assert_allclose(used, 2000.0 / rated, rtol=1e-11)
    assert stops == []
    carried = loads(of, run)
    for gravity, expected in ((of.gravity, 2000.0 / rated), (5.0, 2000.0 * of.gravity / 5 / rated)):
        found = utilisation(carried, BY_HAND, falls, gravity=gravity)
        np.testing.assert_allclose(found, expected, rtol=1e-11)
    np.testing.assert_allclose(
        utilisation(carried, BY_HAND, falls), 2000.0 * of.gravity / (9.80665 * rated), rtol=1e-11
    )


def test_a_load_that_swings_takes_of_the_chart_what_pulls_down() -> None:
    """Let go at φ a point load pulls m g cos φ along the rope, and m g cos² φ down, at the radius
    of the hook, where the moment of the chart is 40 t m.
    """
    point = {"payload_inertia": 0.0, "dummy_mass": 0.0, "dummy_inertia": 0.0, "damp_swing": 0.0}
    of = crane(payload_mass=2000.0, **point)
    start = of.state(x=16.0, l=10.0, phi=0.5)
    run = simulate(of, locked, start=start, duration=0.005, drive="motion")
    used, _ = assess_run(of, run, BY_HAND)
    radius = 16.0 - 10.0 * np.sin(0.5)
    assert loads(of, run)["radius_m"][0] == pytest.approx(radius, rel=1e-9)
    assert used[0] == pytest.approx(2000.0 / (40e3 / radius) * np.cos(0.5) ** 2, rel=1e-9)


def test_a_plan_beyond_the_chart_is_refused_and_a_rope_held_beyond_it_too() -> None:
    """What only swings beyond the chart is judged; what hangs plumb there is not."""
    rated = BY_HAND.on(2)
    assert rated.at_swinging(np.array([25.0, 1.0]), np.array([20.0, 2.0])).tolist() == [1600, 4000]
    rated.refuse_planned(np.array([1.9985, 20.0015]))
    with pytest.raises(OutOfRange, match=r"is 20\.1"):
        rated.refuse_planned(np.array([5.0, 20.1]))
    with pytest.raises(OutOfRange, match=r"is 20\.1"):
        rated.at_swinging(np.array([19.0]), np.array([20.1]))


@pytest.mark.parametrize("radius", [1.99, 20.01, 23.0, -12.0])
def test_outside_of_its_radii_a_chart_says_nothing(radius: float) -> None:
    with pytest.raises(OutOfRange, match=r"radius on 4 falls is .* allowed is 2 to 20, where the"):
        BY_HAND.on(4).at(np.array([12.0, radius]))
    assert BY_HAND.on(4).at(np.array([2.0, 20.0])).tolist() == [6000.0, 3000.0]


def test_a_maker_who_forbids_interpolation_has_the_load_of_the_next_larger_radius(
    tmp_path: Path,
) -> None:
    file = tmp_path / "chart.toml"
    (tmp_path / "table.csv").write_text("r, 20, 30\n10, 4000, 3500\n15, 3000, 2900\n20, 2000,\n")
    text = 'name = "a"\nsource = "b"\ninterpolation = false\n'
    file.write_text(text + '[[falls]]\ncount = 2\ntable = "table.csv"\n')
    chart = read_chart(file)
    assert not chart.interpolation
    loads_at = chart.on(2, 20.0).at(np.array([10.0, 10.001, 10.1, 14.9, 15.0, 15.1, 20.0]))
    assert loads_at.tolist() == [4000.0, 4000.0, 3000.0, 3000.0, 3000.0, 2000.0, 2000.0]
    # Between two booms the smaller one of both, at the next larger radius of each.
    assert chart.on(2, 25.0).at(np.array([10.0, 12.0])).tolist() == [3500.0, 2900.0]
    assert chart.on(2, 20.0).points_about(12.0) is None
    file.write_text(file.read_text().replace("[[falls]]", 'between_booms = "linear"\n[[falls]]'))
    with pytest.raises(DataError, match=r"between_booms: \"linear\" interpolates"):
        read_chart(file)
    file.write_text(file.read_text().replace("interpolation = false\n", ""))
    assert read_chart(file).interpolation


def test_the_fewest_falls_come_first_whatever_the_order_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "chart.toml"
    more = "[[falls]]\ncount = {}\nradii = [10.0]\nloads = [{}]\n"
    text = 'name = "a"\nsource = "b"\n'
    file.write_text(text + more.format(4, 9e3) + more.format(1, 1e3) + more.format(2, 5e3))
    chart = read_chart(file)
    assert [falls.count for falls in chart.reevings] == [1, 2, 4]
    assert chart.on().at(10.0) == 1000.0
    assert chart.on(4).at(10.0) == 9000.0
    file.write_text(text + more.format(2, 9e3) + more.format(2, 5e3))
    sentence = r"line 8, \[falls\] count: another \[\[falls\]\] has 2 falls, too"
    with pytest.raises(DataError, match=sentence):
        read_chart(file)


@pytest.mark.parametrize("least", [10.1, -0.1, np.nan, np.inf])
def test_the_smallest_radius_is_from_none_to_that_of_the_first_point(least: float) -> None:
    with pytest.raises(OutOfRange, match="smallest radius"):
        RatedLoads(2, np.array([10.0, 20.0]), np.array([4000.0, 2000.0]), least)


def test_cut_outs_are_stretches_of_time() -> None:
    t = np.arange(8.0)
    used = np.array([0.5, 0.9, 0.95, 1.0, 1.2, 0.89, 0.2, 0.9])
    assert cut_outs(t, used) == [
        CutOut(1.0, 5.0, "warning", 1.2),
        CutOut(3.0, 5.0, "cut-out", 1.2),
        CutOut(7.0, 7.0, "warning", 0.9),
    ]
    assert cut_outs(t, 0.0 * t) == []


GOOD = 'name = "a"\nsource = "b"\n[[falls]]\ncount = 2\nradii = [10.0, 20.0]\nloads = [4e3, 2e3]\n'


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[4e3, 2e3]", "[2e3, 4e3]", "4000 kg after 2000 kg at 10 m; allowed is no more than"),
        ("[10.0, 20.0]", "[20.0, 10.0]", "10 m after 20 m; allowed is more than the one before"),
        ("[10.0, 20.0]", "[10.0]", r"\[falls\] loads: number of loads is 2 for 1 radii;"),
        ("[10.0, 20.0]", "[]", "number of loads is 2 for 0 radii"),
        ("[4e3, 2e3]", "[4e3, nan]", "loads is nan kg; allowed is finite"),
        ("[4e3, 2e3]", "[4e3, -1.0]", "load at 20 m is -1.0 kg; allowed is 0.001 to 1e"),
        ("[4e3, 2e3]", '"heavy"', "loads is no array of numbers but str"),
        ("count = 2", "count = 0", "number of falls is 0"),
        ("count = 2", "", r"\[falls\] count: it is missing"),
        ("count = 2", "count = 2,5", r"is not TOML: .* Use a decimal point: 2\.5"),
        ("count = 2", "count = 2\nreeving = 2", "There is no field 'reeving'"),
        ('name = "a"', "name = 3", "name: name is 3; allowed is a printable text"),
        ("[[falls]]", "[falls]", r"\[chart\] falls: write each as \[\[falls\]\]"),
        ("count = 2", "count = ", "is not TOML"),
    ],
)
def test_what_is_no_chart_is_refused_in_a_sentence(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "chart.toml"
    file.write_text(GOOD, encoding="utf-8")
    assert read_chart(file).on(2).at(20.0) == 2000.0
    file.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(DataError, match=words) as caught:
        read_chart(file)
    assert str(caught.value).startswith(str(file))


def test_a_chart_without_these_falls_names_those_it_has() -> None:
    with pytest.raises(CraneError, match="There is no number of falls '3'; there are 2, 4"):
        LABORATORY.on(3)
    assert LABORATORY.on().count == 2
