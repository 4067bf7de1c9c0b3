"""Loads and judgements of cranes that are no tower crane, against statics by hand."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.assumptions import Origin
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.errors import DataError, MissingRole, OutOfRange
from cranedyn.interfaces import State
from cranedyn.lifts.judging.analysis import Requirements
from cranedyn.lifts.judging.chart import read_chart, utilisation
from cranedyn.lifts.judging.judgement import judge
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.loads import Loads, loads_of_rows
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.plan_assumptions import plan_assumptions
from cranedyn.lifts.planning.site import Base, Runway
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.verdict import Verdict

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"


def kind(name: str) -> Crane:
    return load_crane(XACRO.parent / f"{name}_crane.urdf.xacro")


def at_rest(crane: Crane, state: State, **given: object) -> dict[str, np.ndarray]:
    """The loads of one row in which nothing moves."""
    q = crane.hanging(state.q)[None]
    effort = holding_effort(crane, q[0])[None]
    return loads_of_rows(crane, q, np.zeros_like(q), effort, **given)  # type: ignore[arg-type]


def test_joints_of_a_crane_without_roles_follow_from_what_they_do() -> None:
    portal = load_crane(EXAMPLES / "portal_crane.urdf")
    names = [joint.name for joint in portal.layout.joints]
    joints = LoadJoints.of(portal)
    assert names[joints.travel or 0] == "travel_joint"
    assert joints.slew is not None and names[joints.slew] == "slew_joint"
    assert joints.hoist is not None and names[joints.hoist] == "hoist_joint"
    assert joints.trolley is None
    assert joints.pivot is not None and names[joints.pivot] == "swing_radial_joint"
    tower = LoadJoints.of(load_crane())
    assert (tower.slew, tower.trolley, tower.hoist) == (0, 1, 4)
    assert tower.travel is None


@pytest.mark.parametrize("luff", [0.5, 1.0, 1.3])
def test_a_luffing_crane_at_rest_has_the_loads_of_statics(luff: float) -> None:
    crane = kind("luffing")
    g = crane.gravity
    found = at_rest(crane, crane.state(gamma=0.4, luff=luff), base=Base(6.0, 1e5))
    boom = 45.0
    load = 2000.0
    dummies = 100.0  # both links between the swing joints
    radius = boom * np.cos(luff)
    assert found["radius_m"] == pytest.approx(radius)
    assert found["rope_N"] == pytest.approx(load * g)
    assert found["load_moment_Nm"] == pytest.approx(load * g * radius)
    tilting = g * ((load + dummies) * radius + 6000.0 * radius / 2.0)
    assert found["ring_tilting_Nm"] == pytest.approx(tilting)
    assert found["off_lead_rad"] == pytest.approx(0.0, abs=1e-9)
    assert found["side_lead_rad"] == pytest.approx(0.0, abs=1e-9)
    corners = sum(found[f"corner_{i}_N"] for i in range(1, 5))
    assert corners == pytest.approx(g * (load + dummies + 6000.0 + 8000.0 + 1e5))


@pytest.mark.parametrize("x", [2.0, 10.0, 17.0])
def test_wheels_of_an_overhead_crane_carry_it_as_a_beam_on_two_supports(x: float) -> None:
    crane = kind("overhead")
    g = crane.gravity
    runway = Runway((0.0, -20.0), 3.2)
    found = at_rest(crane, crane.state(bridge=30.0, x=x), runway=runway)
    moving = 5000.0 + 1500.0 + 100.0  # load, trolley and both links between the swing joints
    far_rail = g * (12000.0 / 2.0 + moving * x / 20.0)
    near_rail = g * (12000.0 / 2.0 + moving * (1.0 - x / 20.0))
    for wheel, rail in ((1, near_rail), (2, near_rail), (3, far_rail), (4, far_rail)):
        assert found[f"wheel_{wheel}_N"] == pytest.approx(rail / 2.0)
    of_load = sum(found[f"wheel_{i}_load_N"] for i in range(1, 5))
    assert of_load == pytest.approx(5000.0 * g)
    assert found["wheel_3_load_N"] == pytest.approx(5000.0 * g * x / 40.0)
    assert "radius_m" not in found


def test_the_radius_of_a_crane_from_a_file_is_that_of_its_rope_not_of_its_trolleys_frame(
    tmp_path: Path,
) -> None:
    text = (EXAMPLES / "portal_crane.urdf").read_text()
    # A jib crane whose trolley slides on the boom's joint, and whose rope begins 4 m beyond it.
    text = text.replace('name="luff_joint" type="revolute"', 'name="luff_joint" type="prismatic"')
    text = text.replace(
        '<axis xyz="-1 0 0"/>\n    <limit lower="0.5" upper="1.35" effort="8e6" velocity="0.03"/>',
        '<axis xyz="0 1 0"/>\n    <limit lower="-20" upper="-2" effort="8e6" velocity="1"/>',
    )
    text = text.replace('<origin xyz="0 -30 0"/>', '<origin xyz="0 -4 0"/>')
    text = text.replace(
        '<param name="initial_value">1.0</param>', '<param name="initial_value">-8</param>'
    )
    (tmp_path / "jib.urdf").write_text(text)
    jib = load_crane(tmp_path / "jib.urdf", locked={"travel_joint": 12.0})
    found = at_rest(jib, jib.start)
    assert found["radius_m"] == pytest.approx(2.0 + 8.0 + 4.0)
    assert found["pivot_radius_m"] == pytest.approx(2.0 + 8.0 + 4.0)
    assert found["load_moment_Nm"] == pytest.approx(5000.0 * jib.gravity * 14.0)


def test_a_portal_that_stands_weighs_on_its_corners_about_its_slew_axis() -> None:
    portal = load_crane(EXAMPLES / "portal_crane.urdf", locked={"travel_joint": 12.0})
    g = portal.gravity
    state = portal.state(luff=1.0)
    found = at_rest(portal, state, base=Base(10.0, 0.0))
    masses = 60000.0 + 50000.0 + 9000.0 + 5000.0 + 80.0
    assert found["foot_vertical_N"] == pytest.approx(masses * g)
    radius = 2.0 + 30.0 * np.cos(1.0)
    boom = 2.0 + 15.0 * np.cos(1.0)
    # About the slew axis: the counterweight 2 m behind it, boom, and what hangs.
    tilting = g * (5080.0 * radius + 9000.0 * boom - 50000.0 * 2.0)
    corners = np.array([found[f"corner_{i}_N"][0] for i in range(1, 5)])
    # The boom points along -Y: corners 3 and 4.
    assert corners[2] + corners[3] - corners[0] - corners[1] == pytest.approx(tilting / 5.0)
    assert corners[0] == pytest.approx(corners[1])


def test_of_two_drives_about_the_vertical_the_one_near_the_ground_slews(tmp_path: Path) -> None:
    text = (EXAMPLES / "portal_crane.urdf").read_text()
    text = text.replace(
        '<axis xyz="-1 0 0"/>\n    <limit lower="0.5"',
        '<axis xyz="0 0 1"/>\n    <limit lower="0.5"',
    )
    (tmp_path / "elbow.urdf").write_text(text)
    elbow = load_crane(tmp_path / "elbow.urdf", locked={"travel_joint": 12.0})
    assert LoadJoints.of(elbow).slew == 0


def test_wheel_loads_of_a_crane_that_does_not_travel_are_refused() -> None:
    crane = load_crane()
    with pytest.raises(MissingRole, match="Wheel loads of a runway"):
        at_rest(crane, crane.start, runway=Runway((0.0, 1.0), 1.0))
    with pytest.raises(OutOfRange, match="distance of the rails"):
        Runway((1.0, 1.0), 1.0)


def test_a_chart_of_one_load_holds_at_any_radius_and_for_a_crane_without_one(
    tmp_path: Path,
) -> None:
    file = tmp_path / "chart.toml"
    file.write_text('name = "c"\nsource = "s"\n[[falls]]\ncount = 4\nrated = 6300.0\n')
    chart = read_chart(file)
    assert chart.on(4).at(37.0) == 6300.0
    pull = np.array([6300.0 * 9.80665])
    without_radius = Loads(np.zeros(1), {"pull_N": pull})
    assert utilisation(without_radius, chart) == pytest.approx(1.0)
    file.write_text(
        'name = "c"\nsource = "s"\n[[falls]]\ncount = 2\nradii = [1.0, 2.0]\nloads = [9.0, 8.0]\n'
    )
    with pytest.raises(OutOfRange, match="this crane does not slew and has no radius"):
        utilisation(without_radius, read_chart(file))
    file.write_text('name = "c"\nsource = "s"\n[[falls]]\ncount = 2\nradii = [1.0]\nrated = 9.0\n')
    with pytest.raises(DataError, match="rated is given, too"):
        read_chart(file)


@cache
def page_tables() -> tuple[str, str]:
    """Return chart and site of the page about lifts of other cranes."""
    page = EXAMPLES.parent / "docs/howto/other_cranes_lift.md"
    chart, site = re.findall(r"^```toml\n(.*?)^```", page.read_text("utf-8"), re.S | re.M)
    return chart, site


@pytest.fixture
def hall(tmp_path: Path) -> Path:
    (tmp_path / "hall_crane.toml").write_text(page_tables()[0])
    file = tmp_path / "hall.toml"
    file.write_text(page_tables()[1])
    return file


@pytest.mark.long
def test_a_lift_by_an_overhead_crane_is_a_go_and_none_on_weaker_rails(hall: Path) -> None:
    required = Requirements(lifts=400, gusts=2)
    judgement = judge(read_site(hall), requirements=required)
    assert judgement.go, judgement.reasons
    page = judgement.html()
    assert "overhead" in page
    # A bridge has no jib, no radius and no slew, and a hall no weather.
    words = re.sub(r"data:image[^\"]*", "", page[page.index("<body>") :])
    assert re.findall(r"(?i)\bjib|\bslew|radius|tower", words) == []
    hall.write_text(page_tables()[1].replace("permitted = 120.0", "permitted = 50.0"))
    # That rails are too weak is no matter of gusts: without them nothing else fails.
    weaker = judge(read_site(hall), requirements=Requirements(lifts=0, gusts=0))
    assert weaker.verdict is Verdict.FAILS
    assert any("a rail may bear 50 kN of a wheel" in reason for reason in weaker.reasons)
    without = Requirements(lifts=0, gusts=0)
    hall.write_text(re.sub(r"\[runway\].*?(?=\[ground\])", "", page_tables()[1], flags=re.S))
    unknown = judge(read_site(hall), requirements=without)
    assert unknown.verdict is Verdict.NOT_JUDGED
    assert any("[runway] of the site is missing" in reason for reason in unknown.reasons)
    # Half of what a wheel presses with is the bridge.
    hall.write_text(page_tables()[1].replace("bridge_mass = 12000.0", "# bridge_mass"))
    shipped = judge(read_site(hall), requirements=without)
    assert shipped.verdict is Verdict.NOT_JUDGED
    assert any("as it is shipped with" in reason for reason in shipped.reasons)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('kind = "overhead"', 'kind = "overhaed"', "line 4.*overhaed"),
        ('kind = "overhead"', 'kind = "overhead"\nmachine = "inteco_3dcrane"', "leave one out"),
        ('kind = "overhead"', 'file = "a.urdf.xacro"', "a site does not load one"),
        ('kind = "overhead"', 'file = "../a.urdf"', "lies outside of the folder"),
        ('kind = "overhead"', 'file = "missing.urdf"', "line 4.*missing.urdf"),
        ('kind = "overhead"', "locked = []", "it is for a crane that file, kind or machine names"),
        ('kind = "overhead"', 'kind = "overhead"\nheading = 3.0', "of another one give yaw"),
        ('kind = "overhead"', 'kind = "tower"  #', "of a tower crane give heading"),
        ("[runway]", "[jib]\nmass = 3.0\ncentre = 1.0\n[runway]", "it is for a tower crane"),
        ("rates = [1.3, 0.6, 0.3]", "rates = [1.3, 0.6]", "3 numbers"),
        ("rails = [0.0, -20.0]", "rails = [1.0, 1.0]", "both rails are in the same place"),
        ("rails = [0.0, -20.0]", "rails = [0.0, -22.5]", "22.5 m apart, and the bridge spans 20 m"),
    ],
)
def test_a_site_says_which_crane_it_is_or_is_refused_with_its_line(
    hall: Path, old: str, new: str, sentence: str
) -> None:
    hall.write_text(page_tables()[1].replace(old, new))
    with pytest.raises(DataError, match=sentence):
        read_site(hall)


VALUES = re.compile(r"\[crane.values\].*?(?=\[runway\])", re.DOTALL)
"""The values of the crane on the page about lifts of other cranes."""


def test_a_crane_of_this_package_is_called_shipped_with_what_was_entered_of_it(hall: Path) -> None:
    hall.write_text(VALUES.sub("", page_tables()[1]))
    site = read_site(hall)
    crane = crane_of(site)
    assert site.limits is not None
    found = {a.name: a for a in plan_assumptions(site, crane, site.limits)}
    rest = found["what is not entered of the crane"]
    assert rest.origin is Origin.SHIPPED
    assert rest.value == "as that of the overhead crane of this package"
    efforts = found["largest efforts of the drives"]
    assert efforts.origin is Origin.ENTERED
    assert efforts.value.startswith("bridge effort 50 kN, trolley effort 20 kN")
    masses = found["masses of the crane's description"]
    assert masses.origin is Origin.SHIPPED and "as shipped: " in masses.value


def test_drives_of_another_crane_are_entered_in_its_order_and_units(tmp_path: Path) -> None:
    (tmp_path / "portal_crane.urdf").write_text((EXAMPLES / "portal_crane.urdf").read_text())
    file = tmp_path / "quay.toml"
    text = VALUES.sub("", page_tables()[1]).replace(
        'kind = "overhead" ',
        'file = "portal_crane.urdf"\nlocked = { travel_joint = 12.0 }  # ',
    )
    text = text.replace("yaw = 0.0", "yaw = 90.0")
    text = text.replace("rates = [1.3, 0.6, 0.3]", "rates = [6.0, 1.2, 0.5]").replace(
        "efforts = [50e3, 20e3, 120e3]\n", ""
    )
    text = re.sub(r"\[runway\].*?(?=\[ground\])", "", text, flags=re.S)
    file.write_text(text)
    site = read_site(file)
    assert [drive.name for drive in site.drives] == ["slew", "luff", "hoist"]
    assert site.limits is not None
    assert site.limits.rates == pytest.approx([np.radians(6.0), np.radians(1.2), 0.5])
    # Turned by a quarter, the X axis of the crane is the Y axis of the site.
    assert site.to_site(np.array([1.0, 0.0, 0.0])) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
