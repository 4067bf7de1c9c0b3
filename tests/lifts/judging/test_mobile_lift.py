"""Lifts of a mobile crane: outriggers, utilisation and verdicts, against statics by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from cranedyn.assumptions import Origin
from cranedyn.dynamics.equations_of_motion import holding_effort
from cranedyn.lifts.judging.analysis import Requirements
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.judging.judgement import judge
from cranedyn.lifts.judging.load_joints import LoadJoints
from cranedyn.lifts.judging.loads import loads_of_rows
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.plan_assumptions import plan_assumptions
from cranedyn.lifts.planning.site import CRANE_HEADING, Base
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.model.crane import STANDARD_GRAVITY as G
from cranedyn.model.crane import Crane
from cranedyn.model.description import XACRO
from cranedyn.model.load import load_crane
from cranedyn.verdict import Verdict
from tests.helpers import ROOT

EXTENSION = 6.0
"""Extension of each section [m], for a boom of 11 + 3 · 6 = 29 m."""

LOAD = 4060.0
"""Load with hook, and both links between the swing joints [kg]."""


@cache
def held() -> Crane:
    return load_crane(
        XACRO.with_name("mobile_crane.urdf.xacro"), locked={"telescope_joint": EXTENSION}
    )


def corners_by_hand(luff: float, slew: float, spacing: float) -> np.ndarray:
    """Forces of the outriggers by moments about the axes X and Y [N], shape (4,).

    Masses along the boom direction, outwards from the slew axis: the superstructure 1 m and the
    counterweight 2.9 m behind it, the hinge 1.6 m behind it. The carrier lies 0.8 m ahead, at -Y.
    """
    cos = np.cos(luff)
    sections = [(3200.0, 4.75, 0), (2100.0, 5.4, 1), (1600.0, 5.7, 2), (1300.0, 6.0, 3)]
    outwards = 7000.0 * -1.0 + 12000.0 * -2.9
    for mass, centre, sections_out in [*sections, (LOAD, 11.0, 3)]:
        outwards += mass * ((centre + sections_out * EXTENSION) * cos - 1.6)
    weight = 22000.0 + 7000.0 + 12000.0 + 8200.0 + LOAD
    # The boom points along -Y at zero slew, and turns from there towards +X.
    x = outwards * np.sin(slew) / weight
    y = (-outwards * np.cos(slew) - 22000.0 * 0.8) / weight
    signs = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    shares = 0.25 + (signs @ np.array([x, y])) / (2.0 * spacing)
    return G * weight * shares


@pytest.mark.parametrize(("luff", "slew"), [(1.2, 0.0), (0.9, 0.8), (0.6, -2.0)])
def test_outriggers_of_a_crane_at_rest_press_as_statics_by_hand_say(
    luff: float, slew: float
) -> None:
    crane = held()
    q = crane.hanging(crane.state(luff=luff, slew=slew).q)[None]
    effort = holding_effort(crane, q[0])[None]
    base = Base(6.4, 0.0, turns_with_crane=True)
    found = loads_of_rows(crane, q, 0.0 * q, effort, base=base, heading=CRANE_HEADING + 0.5)
    corners = np.array([found[f"corner_{i}_N"][0] for i in range(1, 5)])
    np.testing.assert_allclose(corners, corners_by_hand(luff, slew, 6.4), rtol=1e-9)
    assert found["boom_m"] == pytest.approx(29.0)
    assert found["radius_m"] == pytest.approx(29.0 * np.cos(luff) - 1.6)
    # Sides along the axes of the site, and a crane that is turned against them by half a radian.
    fixed = loads_of_rows(
        crane, q, 0.0 * q, effort, base=Base(6.4, 0.0), heading=CRANE_HEADING + 0.5
    )
    assert fixed["corner_1_N"][0] != pytest.approx(corners[0], rel=1e-3)


def test_a_crane_that_slews_and_has_no_trolley_has_a_boom() -> None:
    assert LoadJoints.of(held()).has_boom
    assert not LoadJoints.of(load_crane()).has_boom
    assert not LoadJoints.of(load_crane(XACRO.with_name("overhead_crane.urdf.xacro"))).has_boom


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """The site of the page, with its chart and its table beside it."""
    page = (ROOT / "docs/howto/mobile_crane.md").read_text("utf-8")
    chart, site = re.findall(r"^```toml\n(.*?)^```", page, re.S | re.M)
    (table,) = re.findall(r"^```csv\n(.*?)^```", page, re.S | re.M)
    (tmp_path / "mobile_60t.toml").write_text(chart)
    (tmp_path / "mobile_60t.csv").write_text(table)
    file = tmp_path / "street.toml"
    file.write_text(site)
    return file


def test_the_chart_of_the_page_is_read_with_its_table(street: Path) -> None:
    chart = read_chart(street.with_name("mobile_60t.toml"))
    assert chart.booms(6) == [11.0, 18.0, 24.0, 30.0, 35.6]
    # Between 24 and 30 m the smaller load counts: that of 30 m at 12 m, that of 24 m at 20 m.
    assert chart.on(6, 28.0).at(np.array([12.0, 20.0])).tolist() == [9000.0, 4200.0]


def test_values_of_a_crane_of_this_package_are_entered_or_estimated_as_its_site_says(
    street: Path,
) -> None:
    """The masses of the mobile crane are all entered here; its carrier does not move."""
    masses = {
        **{"carrier_mass": 12600.0, "upper_mass": 4500.0, "counterweight": 4990.0},
        **{"boom_mass": 2200.0, "section_1_mass": 1300.0},
        **{"section_2_mass": 950.0, "section_3_mass": 800.0},
    }
    site = replace(
        read_site(street),
        crane={**masses, "payload_mass": 3000.0, "luff_effort": 3.5e6},
        estimated=frozenset({"[crane.values] boom_mass"}),
    )
    crane = crane_of(site)
    assert site.limits is not None
    made = plan_assumptions(site, crane, site.limits)
    values = {a.origin: a.value for a in made if a.name == "values of the crane"}
    assert values[Origin.ESTIMATED] == "boom mass 2,200 kg"
    assert "carrier mass 12,600 kg" in values[Origin.ENTERED]
    found = {a.name: a for a in made}
    assert found["largest efforts of the drives"].value == "luff effort 3,500 kN m"
    total = found["masses of the crane's description"]
    assert total.origin is Origin.COMPUTED
    # With the two links of the model between the swing joints, of 30 kg each.
    assert total.value == "14,800 kg in all that moves, without the load"
    del masses["section_3_mass"]
    less = replace(site, crane={**masses, "payload_mass": 3000.0})
    found = {a.name: a for a in plan_assumptions(less, crane_of(less), site.limits)}
    total = found["masses of the crane's description"]
    assert total.origin is Origin.SHIPPED and "as shipped: section 3 mass 1,300 kg" in total.value


MASS = 3600.0
"""Load with hook and slings of the site [kg]."""


@pytest.mark.long
def test_a_lift_over_a_building_is_a_go_as_statics_by_hand_say(street: Path) -> None:
    judgement = judge(read_site(street), requirements=Requirements(lifts=400, gusts=2))
    assert judgement.go, judgement.reasons
    page = judgement.html()
    assert "telescoping under load is not planned" in page
    # The words of a boom crane, and no headroom by one largest height of the hook.
    for words in ("Elevation in the plane of the boom", "<dt>Boom length</dt>"):
        assert words in page
    assert "<dt>Block below the boom head, at least</dt>" in page
    assert "Headroom" not in page and "height_under_hook" not in page
    assert "boom: from" in page and "upper, with its tail: from" in page
    analysis = judgement.analysis
    assert analysis.utilisation is not None
    # The farthest point is the goal, 14.4 m away, where the load arrives and stays.
    radius = float(np.hypot(8.0, 12.0))
    rated = float(np.interp(radius, [14.0, 16.0], [14.0 * 7500.0, 16.0 * 6200.0])) / radius
    assert float(analysis.loads["radius_m"][-1]) == pytest.approx(radius, abs=1e-3)
    assert analysis.utilisation[-1] == pytest.approx(MASS / rated, rel=1e-3)
    # Dynamics add little: slow drives and a load that hardly swings.
    assert float(analysis.utilisation.max()) == pytest.approx(MASS / rated, rel=0.02)


def short_lift(street: Path) -> str:
    """Return the site with a move of 1 m and no building, which is planned in a few seconds."""
    text = street.read_text().replace("from = [-12.0, -4.0, 2.5]", "from = [7.2, -11.5, 11.0]")
    return text[: text.index("[[box]]")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "old", "new", "verdict", "words"),
    [
        # 7.6 + 0.4 t at 14.4 m, where the boom bears 7.2 t.
        ("street.toml", "mass = 3200.0", "mass = 7600.0", Verdict.FAILS, r"Utilisation is 11\d"),
        ("street.toml", "permitted = 400.0", "permitted = 150.0", Verdict.FAILS, "may bear 150 kN"),
        (
            "street.toml",
            "counterweight = 12000.0",
            "counterweight = 6000.0",
            Verdict.NOT_JUDGED,
            "chart says nothing about this lift: .* 12000 kg, and the crane has 6000 kg",
        ),
        (
            "mobile_60t.toml",
            "[[falls]]",
            'between_booms = "none"\n[[falls]]',
            Verdict.NOT_JUDGED,
            "chart says nothing about this lift: .* 28 m; .* no loads for lengths between",
        ),
    ],
)
def test_a_lift_that_the_crane_may_not_make_is_no_go_and_one_beyond_its_chart_not_judged(
    file: str, old: str, new: str, verdict: Verdict, words: str, street: Path
) -> None:
    street.write_text(short_lift(street))
    changed = street.with_name(file)
    text = changed.read_text()
    assert old in text
    changed.write_text(text.replace(old, new))
    judgement = judge(read_site(street), requirements=Requirements(lifts=0, gusts=0))
    assert any(re.search(words, reason) for reason in judgement.reasons), judgement.reasons
    (check,) = [check for check in judgement.checks if re.search(words, check.sentence)]
    assert check.verdict is verdict
