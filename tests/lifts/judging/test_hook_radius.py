"""One radius for one place of a load: on the page, in the chart and on the drawing."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.__main__ import main
from cranedyn.export import driving_page
from cranedyn.lifts.judging import judgement
from cranedyn.lifts.judging.analysis import Requirements
from cranedyn.lifts.judging.hook_radius import hook_radii, hook_radius
from cranedyn.lifts.judging.lift_positions import lift_positions
from cranedyn.lifts.judging.report_page import ONE_MOTION, first_page_notices
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.lift import NoWay, crane_of, plan_lift
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.model.crane import Crane
from tests.helpers import ROOT

RADIUS = 12.0
"""Radius of both ends of the lift, and of all places between [m]."""


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """The site of the page about mobile cranes without its building, the load swept round."""
    page = (ROOT / "docs/howto/mobile_crane.md").read_text("utf-8")
    chart, site = re.findall(r"^```toml\n(.*?)^```", page, re.S | re.M)[:2]
    (table,) = re.findall(r"^```csv\n(.*?)^```", page, re.S | re.M)
    (tmp_path / "mobile_60t.toml").write_text(chart)
    (tmp_path / "mobile_60t.csv").write_text(table)
    site = site[: site.index("[[box]]")]
    site = site.replace("from = [-12.0, -4.0, 2.5]", f"from = [-{RADIUS}, 0.0, 4.0]")
    site = site.replace("to = [8.0, -12.0, 11.0]", f"to = [0.0, -{RADIUS}, 4.0]")
    file = tmp_path / "street.toml"
    file.write_text(site.replace("permitted = 400.0", "permitted = 4000.0"))
    return file


@pytest.mark.slow
def test_page_chart_and_drawing_have_one_radius_for_a_load_that_is_swept_round(
    street: Path,
) -> None:
    """Swept round at 6 degrees a second, the load hangs centimetres farther out than its rope."""
    site = read_site(street)
    required = Requirements(lifts=0, gusts=0)
    judged = judgement.judge(site, requirements=required)
    analysis = judged.analysis
    both = "The load hangs at the start and at the end of this lift: its pick-up and its set-down"
    assert both in judged.html() and ONE_MOTION in judged.html()
    begins = replace(site, start=np.array([-RADIUS, 0.0]))
    (notice,) = first_page_notices(replace(analysis, site=begins))
    assert notice.sentence.startswith("The load hangs at the end of this lift: its set-down is not")
    stands = replace(begins, goal=np.array([0.0, -RADIUS]))
    assert first_page_notices(replace(analysis, site=stands)) == []
    lift = analysis.certificate.lift
    planned = hook_radii(lift.clearance, lift.timed.places)
    assert planned is not None
    assert hook_radius(lift.clearance, lift.timed.places[7]) == planned[7]
    of_run = analysis.loads["radius_m"]
    assert float(of_run.max()) == pytest.approx(float(planned.max()), abs=5e-3)
    # In the middle of the sweep at 6 degrees a second a load on a rope of 20 m lags by ω² r l / g.
    middle = len(of_run) // 2
    outwards = of_run[middle] - analysis.loads["pivot_radius_m"][middle]
    assert of_run[middle] == pytest.approx(RADIUS, abs=5e-3)
    assert 0.1 < outwards < 0.35
    farthest = max(lift_positions(analysis), key=lambda position: position.share or 0.0)
    assert farthest.radius == pytest.approx(float(of_run.max()))
    # By hand: the load of 30 m of boom at 12 m, or that of the points about the radius.
    assert farthest.share == pytest.approx(3600.0 / 9000.0, rel=5e-3)
    in_plan = np.hypot(*farthest.place[:2])
    assert farthest.radius == pytest.approx(float(in_plan), abs=5e-3)


@pytest.mark.slow
def test_a_plan_that_takes_the_load_beyond_the_chart_is_not_judged_by_it(
    street: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the plan went 40 m out while the rope is held within the chart."""
    monkeypatch.setattr(judgement, "hook_radii", lambda clearance, places: np.array([12.0, 40.0]))
    text = street.read_text().replace("to = [0.0, -12.0, 4.0]", "to = [-11.8, -1.0, 4.0]")
    street.write_text(text)
    judged = judgement.judge(read_site(street), requirements=Requirements(lifts=0, gusts=0))
    assert judged.analysis.utilisation is None
    assert "radius on 6 falls is 40 m" in judged.analysis.chart_error


def test_a_carrier_that_stands_in_a_box_is_named_with_where_its_nose_points(street: Path) -> None:
    box = '[[box]]\nname = "{}"\ncentre = {}\nsize = [1.0, 1.0, 1.0]\n'
    street.write_text(street.read_text() + box.format("kerb", [0.0, -4.0]))
    site = read_site(street)
    assert site.limits is not None
    with pytest.raises(
        NoWay, match=r"structure stands in kerb\. The structure is the carrier .*-Y"
    ):
        plan_lift(site, site.limits)
    # The nose is longer than the tail, at -Y and at yaw = 90 at +X.
    for yaw, ahead in ((0.0, [0.0, -1.0]), (90.0, [1.0, 0.0])):
        text = street.read_text().replace("yaw = 0.0", f"yaw = {yaw}")
        street.with_name("turned.toml").write_text(text)
        turned = read_site(street.with_name("turned.toml"))
        clearance = clearance_of(crane_of(turned), turned)
        corners = turned.to_site(np.concatenate(list(clearance.standing)))
        along = corners[:, :2] @ np.array(ahead)
        assert along.max() > -along.min() + 0.2


def test_the_page_to_drive_leaves_out_the_chart_of_a_mobile_crane(
    street: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {}

    def export(target: Path, crane: Crane, **arguments: object) -> Path:
        given.update(arguments)
        return target

    monkeypatch.setattr(driving_page, "export", export)
    page = str(street.with_name("page.html"))
    assert main(["export", "page", page, "--site", str(street)]) == 0
    assert given["chart"] is None and given["site"] is not None
    assert "chart of the site is left out" in capsys.readouterr().out
