"""A lift judged: go or no go and why, wind limits, and a page whose numbers can be made again."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")

from cranedyn.assumptions import Assumption, Origin
from cranedyn.data.trajectory import read
from cranedyn.disturbances.wind import AIR_DENSITY
from cranedyn.lifts.judging import report_page, wind_standards
from cranedyn.lifts.judging import wind_limit as wind_limit_module
from cranedyn.lifts.judging.analysis import JudgedInputs, LiftAnalysis, Requirements
from cranedyn.lifts.judging.chart import CHARTS, assess_run, read_chart
from cranedyn.lifts.judging.drawings import NoDxf
from cranedyn.lifts.judging.judged_inputs import is_shipped_crane, resolve_inputs
from cranedyn.lifts.judging.judgement import Judgement, judge
from cranedyn.lifts.judging.lift_checks import CHECKS, counter_jib_entered, run_checks
from cranedyn.lifts.judging.lift_figures import _swept_boxes
from cranedyn.lifts.judging.lift_tables import tables
from cranedyn.lifts.judging.loads import loads
from cranedyn.lifts.judging.plan_folder import with_documents
from cranedyn.lifts.judging.plan_record import PlanOptions, read_plan_record, write_plan_record
from cranedyn.lifts.judging.plan_writing import PlanSource
from cranedyn.lifts.judging.report_page import STATEMENT
from cranedyn.lifts.judging.verify_plan import NamedFiles, verify
from cranedyn.lifts.judging.wind_limit import GUST_FACTOR, WindLimit, wind_limit
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.perturbed import (
    DRAG_COEFFICIENT,
    Perturbed,
    Spread,
    _largest_silhouette,
)
from cranedyn.lifts.planning.plan_assumptions import plan_assumptions
from cranedyn.lifts.planning.site import Arm, Base
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.model.load import load_crane
from cranedyn.verdict import Check, Verdict, overall
from experiments import lift_report
from experiments.lift_judging import judge_plan
from tests.lifts.planning.sites import certificate, lift

pytestmark = pytest.mark.slow

CHART = read_chart(CHARTS / "laboratory.toml")

Drawn = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lift beside a neighbour, judged by few lifts and gusts."""
    made = tmp_path_factory.mktemp("judged") / "out"
    words = ["--site", "neighbour", "--lifts", "500", "--gusts", "2", "--out", str(made)]
    assert lift_report.main(words) == 0
    return made


def result(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


def table(folder: Path, title: str) -> dict[str, list]:
    rows = next(one for one in result(folder)["tables"] if one["title"] == title)["rows"]
    return {row[0]: row[1:] for row in rows}


def test_the_page_begins_with_go_and_needs_no_other_file(folder: Path) -> None:
    text = (folder / "lift.html").read_text(encoding="utf-8")
    assert ">GO<" in text and "NO GO" not in text and STATEMENT in text
    page_text = unescape(text)
    for claim in result(folder)["claims"]:
        assert claim["holds"] is True and claim["sentence"] in page_text
    # What somebody decides by and signs stands on the first page.
    first = page_text[: page_text.index("<section")]
    for words in (">GO<", "Category: at least routine", "their least distance", "Sign-off"):
        assert words in first
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", text) and "<script" not in text
    assert result(folder)["command"] in text
    for one in result(folder)["tables"]:
        said = one["note"] + " ".join(one["columns"])
        assert re.search("cranedyn run|from|clause", said), one["title"]


def test_numbers_of_the_page_are_made_again_from_the_run_that_lies_beside_it(folder: Path) -> None:
    run = read(folder / "lift.parquet")
    crane = load_crane(from_record=folder / "lift.parquet")
    used, stops = assess_run(crane, run, CHART)
    carried = loads(crane, run)
    shown = table(folder, "Loads of the run")
    assert shown["utilisation [%]"][0] == pytest.approx(100.0 * used.max(), rel=1e-12)
    assert stops == []
    moment = carried["load_moment_Nm"].max() / 1e3
    assert shown["load moment [kN m]"][0] == pytest.approx(moment, rel=1e-12)
    # By hand: a tonne at its farthest, and what the hoist may add by its 0.4 m/s².
    still = 9.80665 * carried["radius_m"].max()
    assert 0.99 * still < moment < (1.01 + 0.4 / 9.80665) * still


@pytest.mark.skipif(
    not any(map(shutil.which, report_page.BROWSERS)), reason="no browser that prints is installed"
)
def test_the_page_is_printed(folder: Path) -> None:
    content = (folder / "lift.pdf").read_bytes()
    assert content.startswith(b"%PDF") and content.rstrip().endswith(b"%%EOF")
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b(?!s)", content)) <= 18


def test_the_plan_is_verified_and_each_forged_cell_of_its_tables_is_found(
    folder: Path, tmp_path: Path
) -> None:
    record = read_plan_record(folder / "lift.json")
    page = (folder / "lift.html").read_text(encoding="utf-8")
    assert (
        record.digest in page
        and f'content: "Record, revision 1 · digest {record.short_digest}"' in page
    )
    untouched = verify(folder / "lift.html", judge_plan, NamedFiles(), recompute=False)
    assert overall(untouched) is Verdict.HOLDS
    # Somebody makes the lift lighter in record, page and digests alike, so that all files agree.
    first = record.result.tables[0]
    forged_rows = []
    for row in first.rows:
        is_forged = row[0] == "utilisation of the chart"
        forged_rows.append((row[0], "12.3 %", *row[2:]) if is_forged else row)
    shown = next(row[1] for row in first.rows if row[0] == "utilisation of the chart")
    tables = (replace(first, rows=tuple(forged_rows)), *record.result.tables[1:])
    forged = replace(record, result=replace(record.result, tables=tables))
    forged_page = page.replace(f">{shown}<", ">12.3 %<").replace(record.digest, forged.digest)
    (tmp_path / "lift.html").write_text(forged_page, encoding="utf-8")
    write_plan_record(tmp_path / "lift.json", with_documents(forged, [tmp_path / "lift.html"]))
    checks = verify(tmp_path / "lift.html", judge_plan, NamedFiles())
    assert [check.sentence for check in checks if check.verdict is not Verdict.HOLDS] == [
        f"Judged again: In numbers, utilisation of the chart, this lift: 12.3 % → {shown}."
    ]


def test_without_a_browser_there_is_a_sentence_and_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report_page, "BROWSERS", ("no such browser",))
    undecided = Judgement(small(), [Check("Nobody entered it.", None)])
    assert undecided.word == "NOT COMPLETE"
    source = PlanSource.of(PlanOptions("open_yard"), "open_yard")
    assert lift_report.write_pages(undecided, tmp_path, "", source) == 1
    assert (tmp_path / "lift.html").exists() and not (tmp_path / "lift.pdf").exists()
    assert "install Chromium, or print the page from any browser" in capsys.readouterr().err
    documents = set(read_plan_record(tmp_path / "lift.json").documents)
    assert documents == {"lift.html", "lift_plan.dxf", "lift_elevation.dxf"}


def test_a_plan_that_nobody_signed_is_replaced_with_all_its_documents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_page, "BROWSERS", ("no such browser",))
    undecided = Judgement(small(), [Check("Nobody entered it.", None)])
    source = PlanSource.of(PlanOptions("open_yard"), "open_yard")
    lift_report.write_pages(undecided, tmp_path, "", source)
    # What lies beside the plan and is none of its documents stays, whatever its record says.
    (tmp_path / "notes.pdf").write_text("mine")
    record = read_plan_record(tmp_path / "lift.json")
    with_notes = replace(record, documents={**record.documents, "notes.pdf": "0" * 64})
    write_plan_record(tmp_path / "lift.json", with_notes)

    def no_dxf(*args: object) -> None:
        raise NoDxf("It is not installed.")

    monkeypatch.setattr("cranedyn.lifts.judging.plan_writing.write_drawings", no_dxf)
    lift_report.write_pages(undecided, tmp_path, "", source)
    assert list(read_plan_record(tmp_path / "lift.json").documents) == ["lift.html"]
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".lock") == [
        "lift.html",
        "lift.json",
        "notes.pdf",
    ]


def test_what_does_not_hold_is_no_go_and_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Judgement, "figures", {})  # the lists of checks are the same without
    analysis = small()
    checks = run_checks(analysis)
    assert Judgement(analysis, checks).go
    sentence = checks[4].sentence
    for verdict, word, counted in (
        (Verdict.FAILS, "NO GO", "Of 18 checks 1 does not hold and 0 were not judged; 17 hold."),
        (
            Verdict.NOT_JUDGED,
            "NOT COMPLETE",
            "Of 18 checks 0 do not hold and 1 was not judged; 17 hold.",
        ),
    ):
        changed = [*checks[:4], Check(sentence, verdict), *checks[5:]]
        judgement = Judgement(analysis, changed)
        assert not judgement.go and judgement.reasons == [sentence] and judgement.word == word
        text = judgement.html()
        assert f">{word}<" in text and counted in text
        assert unescape(re.findall(r"</span>([^<]*)</li>", text)[0]) == sentence


def small(**changes: object) -> LiftAnalysis:
    """The lift over a wall of the tests of plans, without wind and without others like it."""
    made = certificate()
    # As if the crane had been loaded with the counter-jib of its site, which is drawn only.
    crane = made.lift.crane
    crane = replace(crane, record={**crane.record, "arguments": {"counter_jib": 9.4}})
    clearance = replace(made.lift.clearance, crane=crane)
    made = replace(made, lift=replace(made.lift, clearance=clearance))
    site = replace(
        made.lift.clearance.site,
        crane={"counter_jib": 9.4},
        limits=made.lift.limits,
        base=Base(4.5, 60.0e3, 400.0e3),
        arms=(Arm(2000.0, 10.0), Arm(3500.0, -6.0)),
    )
    carried = loads(made.lift.crane, made.run, base=site.base, arms=site.arms)
    used, _ = assess_run(made.lift.crane, made.run, CHART)
    entered = tuple(
        replace(a, origin=Origin.ENTERED)
        for a in resolve_inputs(site, made.lift.crane, made.lift.limits, Requirements()).assumptions
    )
    required = Requirements(wind=8.0, swing=0.09, risk=0.01)
    inputs = JudgedInputs(required, Spread(), CHART, 2, entered)
    mild = WindLimit(
        np.array([4.0, 8.0]),
        {
            "utilisation": np.array([0.3, 0.4]),
            "swing": np.array([0.01, 0.02]),
            "clearance": np.array([2.0, 1.5]),
        },
        {"utilisation": 1.0, "swing": 0.09, "clearance": 0.5},
        2,
    )
    harmless = Perturbed(np.ones(400), 0.5, {}, np.zeros(400))
    case = LiftAnalysis(site, inputs, made, carried, used, "", mild, harmless)
    return replace(case, **changes)  # type: ignore[arg-type]


def requiring(**changes: object) -> JudgedInputs:
    """The values of `small` with other requirements."""
    inputs = small().inputs
    required = replace(inputs.requirements, **changes)  # type: ignore[arg-type]
    return replace(inputs, requirements=required)


def red(made: LiftAnalysis) -> list[str]:
    return [check.sentence for check in run_checks(made) if check.holds is False]


def test_a_lift_that_holds_goes_and_each_thing_that_does_not_stops_it() -> None:
    case = small()
    assert red(case) == []
    assert case.utilisation is not None
    used = case.utilisation / case.utilisation.max()
    over, heavier = red(small(utilisation=0.95 * used))
    assert "Utilisation is 95.0 %" in over and "warning at" in over
    assert "30 % heavier than entered uses 123.5 %" in heavier
    lifted, slack = (
        replace(case.loads, values={**case.loads.values, column: -case.loads.t})
        for column in ("corner_2_N", "slack_margin")
    )
    cut_out = np.where(case.loads.t > 4.0, 1.2, 0.95)
    of_chart, _ = red(small(utilisation=cut_out))
    assert of_chart.endswith(f"cut-out at {case.loads.t[cut_out > 1.0][0]:.1f} s.")
    for changes, words in (
        ({"utilisation": 0.8 * used}, "30 % heavier than entered uses 104.0 %"),
        ({"utilisation": None, "chart_error": "radius is 23 m."}, "does not reach: radius is 23"),
        ({"loads": lifted}, "corners"),
        ({"loads": slack}, "taut"),
    ):
        (sentence,) = red(small(**changes))  # type: ignore[arg-type]
        assert words in sentence


@pytest.mark.parametrize(
    ("lifts", "nearer", "goes"), [(100, 0, False), (400, 0, True), (400, 1, False)]
)
def test_too_few_lifts_prove_no_risk_though_none_came_too_near(
    lifts: int, nearer: int, goes: bool
) -> None:
    """None of n in which nothing happens leave a probability of 1 - 0.025^(1/n), so that 1 % needs
    368 of them.
    """
    least = np.where(np.arange(lifts) < nearer, 0.4, 1.0)
    made = Perturbed(least, 0.5, {}, np.zeros(lifts))
    if not nearer:
        assert made.interval() == (0.0, pytest.approx(1.0 - 0.025 ** (1.0 / lifts), rel=1e-9))
    found = [sentence for sentence in red(small(perturbed=made)) if "perturbed lifts" in sentence]
    assert len(found) == (not goes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"wind": None}, "The wind limit was not computed: it needs a load chart"),
        ({"wind": None, "inputs": "no gusts"}, "The wind limit was not computed: no gusts"),
        ({"perturbed": None, "inputs": "no lifts"}, "No perturbed lifts were simulated: none"),
        ({"inputs": "strong wind"}, "none stronger was tried; 30 m/s required"),
        ({"inputs": "no chart", "utilisation": None}, "no load chart of this crane was entered"),
        ({"inputs": "default swing"}, "Nobody entered 1 value that the result rests on: [lift]"),
        ({"site": "no permitted"}, "[base] permitted is missing"),
        ({"site": "on the ground"}, "Lift-off and set-down were not simulated"),
    ],
)
def test_what_was_not_computed_or_entered_is_not_judged_and_no_go(
    changes: dict[str, object], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Judgement, "figures", {})  # the lists of checks are the same without
    case = small()
    base = case.site.base
    assert base is not None
    swing = Assumption("swing", "2°", Origin.DEFAULT, "[lift] swing")
    made = {
        "no gusts": requiring(gusts=0),
        "no lifts": requiring(lifts=0),
        "strong wind": requiring(wind=30.0),
        "no chart": replace(case.inputs, chart=None, falls=None),
        "default swing": replace(case.inputs, assumptions=(swing,)),
        "no permitted": replace(case.site, base=replace(base, permitted=None)),
        "on the ground": replace(case.site, start=np.array([6.0, -12.0])),
    }
    analysis = small(**{key: made.get(str(value), value) for key, value in changes.items()})
    checks = run_checks(analysis)
    unjudged = [check.sentence for check in checks if check.verdict is Verdict.NOT_JUDGED]
    assert any(words in sentence for sentence in unjudged), unjudged
    judgement = Judgement(analysis, checks)
    assert not judgement.go and judgement.word == "NOT COMPLETE"
    page_text = unescape(judgement.html())
    for sentence in unjudged:  # never with the sign of a check that holds
        assert f'"not judged">–</span>{sentence}' in page_text


def test_a_wind_is_borne_and_a_ground_bears_up_to_what_was_found_and_no_further() -> None:
    speeds = np.array([4.0, 8.0, 9.0])
    swing = np.array([0.01, 0.05, 0.2])
    blown = WindLimit(speeds, {"swing": swing}, {"swing": 0.1}, 3)
    case = small(wind=blown)
    assert case.requirements.wind == 8.0 and red(case) == []
    (wind_,) = red(small(wind=blown, inputs=requiring(wind=8.5)))
    assert "The lift bears gusts up to 8 m/s (29 km/h), not 9 m/s" in wind_
    most = max(float(case.loads[f"corner_{i}_N"].max()) for i in range(1, 5))
    exact = replace(case.inputs, spread=replace(case.inputs.spread, load=0.0))
    for share, stops in ((1.001, 0), (0.999, 1)):
        site = replace(case.site, base=replace(case.site.base, permitted=share * most))
        assert len(red(small(site=site, inputs=exact))) == stops


def test_a_ground_bears_a_load_that_is_heavier_by_its_tolerance() -> None:
    """A tenth of the weight at 14 m adds W/4 + W r/(√2 b) to the corner that the jib points to."""
    case = small()
    base = case.site.base
    assert base is not None
    heavier = replace(case.inputs, spread=replace(case.inputs.spread, load=0.1))
    corners = np.stack([case.loads[f"corner_{i}_N"] for i in range(1, 5)]).max(axis=0)
    radius = case.loads["radius_m"]
    added = 0.1 * case.loads["pull_N"] * (0.25 + radius / (math.sqrt(2.0) * base.spacing))
    needed = float((corners + added).max())
    assert needed > 1.01 * corners.max()
    for share, stops in ((1.001, 0), (0.999, 1)):
        site = replace(case.site, base=replace(base, permitted=share * needed))
        assert len(red(small(site=site, inputs=heavier))) == stops


def test_drives_that_are_planned_slower_than_entered_are_not_called_as_entered() -> None:
    case = small()
    entered = case.site.limits
    assert entered is not None
    faster = replace(entered, rates=tuple(2.0 * rate for rate in entered.rates))
    made = small(site=replace(case.site, limits=faster))
    (as_entered,) = [c for c in run_checks(case) if c.sentence.startswith("The drives")]
    (less,) = [c for c in run_checks(made) if c.sentence.startswith("The drives")]
    assert "as entered: 4.8 °/s" in as_entered.sentence
    assert "planned with less than that" in less.sentence and "4.8 °/s" in less.sentence
    (rates,) = [
        a
        for a in plan_assumptions(made.site, case.crane, case.certificate.lift.limits)
        if "rates" in a.name
    ]
    assert rates.origin is Origin.COMPUTED


def test_a_load_that_stands_is_not_said_to_hang_where_it_was_not_simulated() -> None:
    site = replace(small().site, goal=np.array([6.0, 12.0]))
    made = small(site=site, perturbed=None, wind=None)
    (row,) = [r for r in tables(made)[1].rows if r[0] == "begins and ends"]
    assert row[1] == "hanging, standing (set-down not simulated)"
    sentences = report_page.limits_of(made)
    assert "The load hangs where picking up would be; that is not in this lift." in sentences
    not_held = replace(made, certificate=replace(made.certificate, checks=(Check("No.", False),)))
    sentences = report_page.limits_of(not_held)
    assert "Not simulated: setting down; the plan has no certificate." in sentences
    # Of another crane than a tower crane that is the reason, whatever its certificate says.
    other: Any = SimpleNamespace(clearance=SimpleNamespace(site=made.site))
    of_chain = replace(made, certificate=replace(made.certificate, lift=other))
    assert (
        "Not simulated: setting down; they are simulated for tower cranes only."
        in report_page.limits_of(of_chain)
    )


def test_the_middle_of_a_load_that_hangs_beside_it_slews_with_the_load() -> None:
    """A load whose box lies a metre beside its rope, across the jib."""
    planned = lift()
    bodies = planned.clearance.bodies
    aside = replace(planned.clearance.site, load=bodies.load + np.array([1.0, 0.0, 0.0]))
    made = replace(planned, clearance=clearance_of(planned.crane, aside))
    swept = _swept_boxes(made)
    middles = swept["centres"] - _swept_boxes(planned)["centres"]
    # At zero slew X is across the jib.
    expected = np.stack([np.cos(swept["yaw"]), np.sin(swept["yaw"]), 0.0 * swept["yaw"]], axis=1)
    assert np.ptp(swept["yaw"]) > 1.0
    np.testing.assert_allclose(middles, expected, rtol=0.0, atol=1e-12)


def test_the_swing_of_lifts_that_broke_off_is_not_that_of_the_others() -> None:
    made = Perturbed(np.array([1.0, math.nan]), 0.5, {}, np.array([2e-3, math.nan]))
    (robust,) = [t for t in tables(small(perturbed=made)) if t.title == "Perturbed lifts"]
    assert robust.rows[-1] == ["swing after, at most [mrad]", "2.0"]


@pytest.mark.parametrize(("gravity", "judged"), [(9.81, True), (8.0, False)])
def test_a_lift_in_another_gravity_is_not_judged(gravity: float, judged: bool) -> None:
    case = small()
    model = case.crane.model.copy()
    model.gravity = pin.Motion(np.array([0.0, 0.0, -gravity]), np.zeros(3))
    crane = replace(case.crane, model=model)
    clearance = replace(case.certificate.lift.clearance, crane=crane)
    made = replace(case.certificate, lift=replace(case.certificate.lift, clearance=clearance))
    (check,) = [c for c in run_checks(small(certificate=made)) if "in a gravity of" in c.sentence]
    assert (check.verdict is Verdict.HOLDS) is judged


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        ({"limits": None}, "[drives] of the site is missing"),
        ({"crane": {}}, "[counter_jib] length of the site is missing"),
        ({"base": None}, "[base] of the site missing"),
        ({"arms": ()}, "[jib], [counter_jib] of the site missing"),
        ({"arms": (Arm(2000.0, 10.0),)}, "[counter_jib] of the site missing"),
        ({"arms": (Arm(3500.0, -6.0),)}, "[jib] of the site missing"),
    ],
)
def test_what_nobody_entered_is_not_judged_and_no_go(
    missing: dict[str, object], words: str
) -> None:
    case = small()
    made = replace(case, site=replace(case.site, **missing))  # type: ignore[arg-type]
    checks = run_checks(made)
    unjudged = [check for check in checks if check.verdict is not Verdict.HOLDS]
    assert {check.verdict for check in unjudged} == {Verdict.NOT_JUDGED}
    assert any(check.sentence.startswith(words) for check in unjudged)
    assert not Judgement(made, checks).go


def test_a_check_of_ones_own_is_one_function() -> None:
    """As CONTRIBUTING says: a load case or a check is a function of the analysis."""

    def short_enough(analysis: LiftAnalysis) -> Check:
        duration = analysis.certificate.lift.timed.motion.arrival
        return Check(f"The lift takes {duration:.0f} s, 1 s allowed.", duration <= 1.0)

    analysis = small()
    assert run_checks(analysis, [*CHECKS, short_enough])[-1].holds is False
    alone = run_checks(analysis, [short_enough])
    assert alone[-2].verdict is Verdict.NOT_JUDGED and "Checks were left out" in str(alone[-2])
    site = replace(analysis.site, crane={}, base=None, arms=())
    lifted = lift()
    few = Requirements(lifts=0, gusts=0)
    judgement = judge(site, CHART, few, crane=lifted.crane, checks=[short_enough])
    assert not judgement.go and judgement.reasons[-1].endswith("1 s allowed.")
    assert judgement.checks[:-2] == certificate().checks


def test_the_corners_of_a_judged_lift_are_those_of_its_site() -> None:
    """The base lies along the axes of the site, however the crane on it is turned."""
    made = lift()
    site = replace(
        made.clearance.site,
        heading=0.3,
        limits=made.limits,
        base=Base(4.5, 60.0e3),
        arms=(Arm(2000.0, 10.0), Arm(3500.0, -6.0)),
    )
    analysis = judge(site, CHART, Requirements(lifts=0, gusts=0), crane=made.crane).analysis
    found = loads(made.crane, analysis.certificate.run, base=site.base, arms=site.arms, heading=0.3)
    for i in range(1, 5):
        np.testing.assert_array_equal(analysis.loads[f"corner_{i}_N"], found[f"corner_{i}_N"])


def test_the_weakest_wind_that_breaks_a_limit_is_the_first_beyond_it() -> None:
    found = WindLimit(
        np.array([4.0, 8.0, 9.0, 12.0]),
        {
            "utilisation": np.array([0.5, 0.6, 0.7, 1.1]),
            "swing": np.array([0.01, 0.05, 0.2, 0.09]),
            "clearance": np.array([1.0, 0.5, 0.5, -1.0]),
        },
        {"utilisation": 1.0, "swing": 0.1, "clearance": 0.5},
        4,
    )
    assert [found.limit(name) for name in found.allowed] == [9.0, 8.0, 9.0]
    assert found.limit() == 8.0 and found.binding == "swing" and found.interval() == (8.0, 9.0)
    assert replace(found, allowed={"swing": 0.001}).limit() == 0.0
    none_breaks = replace(found, allowed={"swing": 1.0})
    assert none_breaks.limit() == 12.0 and none_breaks.interval() == (12.0, math.inf)
    assert none_breaks.binding is None
    (check,) = [c for c in run_checks(small(wind=none_breaks)) if "bears gusts" in c.sentence]
    assert check.sentence.endswith("8 m/s required. No limit is exceeded.")


@pytest.mark.parametrize("seed", range(6))
def test_the_wind_limit_is_that_of_the_worst_gust_whatever_is_drawn(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a closed form in the place of simulations: a gust takes as much clearance as it is
    strong, most by far at 20 s of 8 s from 1 rad. There 11.5 m/s take all that is not required:
    half a step of the speeds that are tried.
    """
    blown = []

    def by_hand(_: object, drawn: Drawn, **__: object) -> list[Drawn]:
        blown.append(drawn)
        return [drawn]

    def note(found: Drawn, made: Drawn, *_: object) -> None:
        turn = np.angle(np.exp(1j * (made["direction_rad"] - 1.0)))
        away = ((made["gust_at_s"] - 20.0) / 6.0) ** 2 + ((made["gust_lasts_s"] - 8.0) / 4.0) ** 2
        speed = made["wind_m_s"] + made["gust_m_s"]
        found["clearance"][:] = 12.0 - speed * (0.4 + 0.6 * np.exp(-away - turn**2))
        found["utilisation"][:] = found["swing"][:] = 0.0

    monkeypatch.setattr(wind_limit_module, "simulate_perturbed", by_hand)
    monkeypatch.setattr(wind_limit_module, "_enter_values", note)
    monkeypatch.setattr(wind_limit_module._Trial, "nearest", lambda *_: None)
    found = wind_limit(certificate(), CHART, seed=seed)
    assert found.interval() == (11.0, 12.0) and found.binding == "clearance"
    assert found.lifts == sum(len(drawn["gust_m_s"]) for drawn in blown)
    for drawn in blown:  # the mean wind in which the load hangs, and what the gust is more
        np.testing.assert_allclose(0.5 * drawn["wind_m_s"], drawn["gust_m_s"], rtol=1e-12)


def test_gusts_swing_a_load_as_far_as_mechanics_has_it() -> None:
    found = wind_limit(certificate(), CHART, count=4, dt=1e-3)
    assert (np.diff(found.speeds) > 0.0).all()
    crane = lift().crane
    area = DRAG_COEFFICIENT * _largest_silhouette(lift().clearance.bodies.load)
    planned = float(lift().clearance.tilt(certificate().run.q).max())

    def lean(speed: float) -> float:
        force = 0.5 * AIR_DENSITY * area * speed**2
        return wind_standards.wind_lean(force, crane.payload_mass, crane.gravity)

    for speed, swing in zip(found.speeds.tolist(), found.worst["swing"].tolist(), strict=True):
        # It leans in the mean wind; a gust at worst comes at once, on top of what is planned. The
        # load moves against the wind by up to 2 m/s.
        assert lean(speed / GUST_FACTOR) - planned < swing
        assert swing < planned + 2.0 * lean(speed + 2.0)
    assert found.worst["swing"][-1] > 2.0 * planned
    assert 4.0 <= found.limit("swing") < 28.0


@pytest.mark.slow
def test_a_thousand_random_gusts_are_no_worse_than_those_that_are_looked_for() -> None:
    """Simulated at the limit of the swing, drawn by other random numbers; the worst swing of a
    thousand is at most 1 % beyond what the search by halved steps found.
    """
    found = wind_limit(certificate(), CHART, count=1)
    speed = found.limit("swing")
    ranges = wind_limit_module._GustRanges.of(certificate())
    trial = wind_limit_module._Trial(certificate(), CHART, None, found.allowed, 1e-3)
    rng = np.random.default_rng(987)
    drawn = ranges.lowest + ranges.widths * rng.random((1000, 3))
    rows = trial.simulate(np.array([speed]), drawn)
    at_random = wind_limit_module._limits(rows, found.allowed)
    ours = found.worst["swing"][found.speeds == speed].item()
    assert at_random.worst["swing"].item() <= 1.01 * ours
    assert at_random.kept("swing").all()


def test_what_a_gust_brings_the_load_next_to_is_named() -> None:
    """In a breath of wind it is what the certificate names, at nearly the same distance."""
    trial = wind_limit_module._Trial(certificate(), CHART, None, {"clearance": 0.5}, 1e-3)
    found = trial.nearest(0.01, np.array([5.0, 5.0, 0.0]))
    calm = certificate().nearest
    assert found is not None
    assert (found.body, found.obstacle) == (calm.body, calm.obstacle)
    assert found.distance == pytest.approx(calm.distance, abs=0.02)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--wind -1", "wind asked for is -1.0 m/s"),
        ("--swing 90", "swing allowed is 90.0 degrees; allowed is 0.1 to 45"),
        ("--risk 101", "risk allowed is 101.0 %"),
        ("--lifts -1", "lifts is -1"),
        ("--load 0", "load is 0.0 kg"),
        ("--falls 3", "There is no number of falls '3'; there are 2, 4."),
        ("--chart missing.toml", "Cannot read missing.toml"),
        ("--crane missing.urdf", "Cannot read missing.urdf"),
        ("--set urdf:=5", "urdf is no number of a crane"),
        ("--set payload_mass:=5", "payload_mass is set by the experiment lift_report itself"),
    ],
)
def test_what_cannot_be_judged_is_refused_in_a_sentence(
    words: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert lift_report.main(words.split()) == 2
    assert sentence in capsys.readouterr().err and list(tmp_path.iterdir()) == []


def test_each_value_that_nobody_entered_is_a_default() -> None:
    """The caller's value comes before the site's, and that before the default."""
    limits = lift().limits
    bare = lift().clearance.site
    entered = replace(
        bare,
        gust=9.0,
        gust_swing=0.1,
        risk=0.02,
        spread={"load": 0.1, "cable": 0.2, "wind": 3.0, "gust": 4.0, "late": 0.04},
        falls=4,
        entered=frozenset({"[lift] swing", "[lift] distance"}),
        limits=limits,
        crane={"payload_mass": 1000.0},
        rigging={"hook": 0.0, "slings": 30.0},
    )
    crane = lift().crane
    unknown = resolve_inputs(bare, crane, limits, Requirements())
    known = resolve_inputs(entered, crane, limits, Requirements())
    given = resolve_inputs(
        entered, crane, limits, Requirements(wind=12.0, swing=0.2, risk=0.03), falls=2
    )
    defaults = [a.name for a in unknown.assumptions if a.origin is Origin.DEFAULT]
    assert len(unknown.assumptions) == 27
    assert {a.name for a in unknown.assumptions} - {*defaults} == {
        *("size of the load", "load chart", "crane", "gravity", "attitude of the load"),
        *("masses of the crane as shipped", "centre of gravity of the load"),
        *("ground", "obstacles and zones", "wind on the structure of the crane"),
        "area of the load to the wind, times its drag coefficient",
    }
    assert [a.name for a in known.assumptions if a.origin is Origin.DEFAULT] == []
    required = [
        (made.requirements.wind, made.requirements.swing, made.requirements.risk, made.falls)
        for made in (unknown, known, given)
    ]
    assert required == [
        (8.0, pytest.approx(math.radians(5.0)), 0.01, 2),
        (9.0, 0.1, 0.02, 4),
        (12.0, 0.2, 0.03, 2),
    ]
    assert known.spread == Spread(0.1, 0.2, 3.0, 4.0, late=(0.0, 0.01, 0.02, 0.04))


@pytest.mark.parametrize(
    ("rigging", "missing", "gross"),
    [
        ({}, ["[rigging] hook", "[rigging] slings"], "1.00 t; no hook block and no slings were"),
        ({"hook": 100.0}, ["[rigging] slings"], "1.00 t = load 0.90 t + hook 0.10 t"),
        ({"hook": 0.0, "slings": 0.0}, [], "1.00 t with hook block and slings"),
        ({"hook": 100.0, "slings": 30.0}, [], "1.00 t = load 0.87 t + hook 0.10 t + slings 0.03"),
    ],
)
def test_a_lift_whose_hook_block_or_slings_nobody_weighed_is_not_complete(
    rigging: dict[str, float], missing: list[str], gross: str
) -> None:
    """Forgetting the rigging is a common mistake of a lift plan, on the unsafe side."""
    case = small()
    site = replace(case.site, rigging=rigging)
    inputs = resolve_inputs(site, case.crane, case.certificate.lift.limits, Requirements())
    defaults = [a.field for a in inputs.assumptions if a.origin is Origin.DEFAULT]
    assert [field for field in defaults if "slings" in field or "hook" in field] == missing
    (row,) = [row for row in tables(small(site=site))[1].rows if row[0] == "gross load"]
    assert str(row[1]).startswith(gross)


# --- whole commands ------------------------------------------------------------------------------

GROUND_SITE = """
name = "from ground to ground"
[ground]
height = 0.0
[crane]
{crane}
[load]
size = [1.5, 3.0, 1.2]
mass = 870.0
[rigging]
hook = 100.0
slings = 30.0
falls = 2
[drives]
rates = [4.8, 1.583, 1.0]
accelerations = [1.15, 0.4, 0.4]
[lift]
from = [6.0, -14.0{z}]
to = [8.0, -13.0{z}]
distance = 0.5
swing = 2.0
risk = 1.0
[wind]
gust = 8.0
swing = 5.0
[uncertainty]
mass = 30.0
cable = 0.5
wind = 4.0
gust = 6.0
delay = 0.02
"""

LONG_JIB = "values = {trolley_max = 60.0}"


@pytest.mark.long
def test_without_gusts_and_perturbed_lifts_a_report_is_not_complete(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--lifts", "0", "--gusts", "0", "--wind", "60", "--out", str(tmp_path)]
    assert lift_report.main(words) == 1
    printed = capsys.readouterr().out
    assert "NOT COMPLETE: " in printed and "16 of 18 claims hold, 2 not judged." in printed
    assert "Is 60 in kilometres per hour?" in printed
    text = (tmp_path / "lift.html").read_text(encoding="utf-8")
    assert ">NOT COMPLETE<" in text and ">GO<" not in text
    for sentence in ("The wind limit was not computed", "No perturbed lifts were simulated"):
        assert f'title="not judged">–</span>{sentence}' in text


@pytest.mark.parametrize(("entered", "verdict"), [(9.43, True), (9.5, False)])
def test_the_counter_jib_of_a_plain_urdf_is_compared_with_the_one_entered(
    tmp_path: Path, entered: float, verdict: bool
) -> None:
    (tmp_path / "mine.urdf").write_text(load_crane().urdf)  # drawn to 9.425 m
    crane = load_crane(tmp_path / "mine.urdf")
    site = replace(read_site("open_yard"), crane={"counter_jib": entered})
    lift = SimpleNamespace(clearance=clearance_of(crane, site))
    analysis: Any = SimpleNamespace(crane=crane, site=site, certificate=SimpleNamespace(lift=lift))
    check = counter_jib_entered(analysis)
    assert (check.verdict is Verdict.HOLDS) is verdict and "reaches 9.43 m" in check.sentence


@pytest.mark.long
def test_another_crane_is_not_judged_by_the_chart_of_the_shipped_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "site.toml").write_text(GROUND_SITE.format(crane=LONG_JIB, z=", 3.0"))
    words = ["--site", str(tmp_path / "site.toml"), "--lifts", "0", "--gusts", "0"]
    assert lift_report.main([*words, "--out", str(tmp_path / "out")]) == 1
    made = result(tmp_path / "out")
    sentences = {claim["sentence"]: claim["holds"] for claim in made["claims"]}
    (of_chart,) = [s for s in sentences if s.startswith("Utilisation: no load chart")]
    assert sentences[of_chart] is None
    assert not any("% of the chart at most" in sentence for sentence in sentences)
    text = (tmp_path / "out" / "lift.html").read_text(encoding="utf-8")
    assert "tower crane of this project, 22 m jib" not in text and ">NOT COMPLETE<" in text
    assert "The load hangs where picking up and setting down would be" in text


def test_a_chart_is_entered_in_the_site_and_read_from_its_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chart = (CHARTS / "mct88.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(chart, encoding="utf-8")
    crane = f'chart = "mine.toml"\n{LONG_JIB}'
    (tmp_path / "site.toml").write_text(GROUND_SITE.format(crane=crane, z=", 3.0"))
    words = ["--site", str(tmp_path / "site.toml"), "--lifts", "0", "--gusts", "0"]
    assert lift_report.main([*words, "--out", str(tmp_path / "out")]) == 1
    text = (tmp_path / "out" / "lift.html").read_text(encoding="utf-8")
    assert "The chart is Potain MCT 88, 30 m jib. Source: the maker" in text
    assert "chosen for this project" not in text
    assert "ends at 29.9 m and the crane's trolley reaches 60 m" in unescape(text)


@pytest.mark.long
def test_lift_off_and_set_down_are_part_of_the_report(tmp_path: Path) -> None:
    crane = "values = {hoist_max = 30.0}"
    (tmp_path / "site.toml").write_text(GROUND_SITE.format(crane=crane, z=""))
    words = ["--site", str(tmp_path / "site.toml"), "--lifts", "0", "--gusts", "0"]
    assert lift_report.main([*words, "--out", str(tmp_path / "out")]) == 1
    made = result(tmp_path / "out")
    sentences = {claim["sentence"]: claim["holds"] for claim in made["claims"]}
    for phase in ("Lift-off: the rope pulls", "Motion: the load", "Set-down: the load touches"):
        (sentence,) = [s for s in sentences if s.startswith(phase)]
        assert sentences[sentence] is True
    run = read(tmp_path / "out" / "lift.parquet")
    assert run["phase"][[0, -1]].tolist() == [2.0, 2.0]  # it stands at both ends
    # At up to 15.3 m the chart rates 2,500 kg; a lift-off pulls more than the weight of a tonne.
    used = next(s for s in sentences if s.startswith("Utilisation is"))
    percent = float(re.findall(r"[\d.]+", used)[0])
    assert run["x_m"].max() < 20.0 and 40.0 < percent < 48.0
    assert table(tmp_path / "out", "The lift")["begins and ends"][0] == "lifted off, set down"
    # The run ends with a rest after the set-down.
    (duration,) = re.findall(
        r"(\d+) s", table(tmp_path / "out", "In numbers")["time of the lift"][0]
    )
    assert run.t[-1] - 10.0 < float(duration) <= run.t[-1] + 0.5


@pytest.mark.parametrize(
    ("values", "shipped"),
    [
        ({}, True),
        ({"payload_mass": 2000.0, "mast_height": 33.0, "pivot_height": 35.0}, True),
        ({"trolley_max": 60.0}, False),
        ({"hoist_effort": 2e5}, False),
    ],
)
def test_the_shipped_chart_is_of_the_shipped_crane(values: dict[str, float], shipped: bool) -> None:
    assert is_shipped_crane(load_crane(values=values)) is shipped
    assert not is_shipped_crane(load_crane("urdf/overhead_crane.urdf.xacro"))


def test_the_time_of_a_lift_contains_lift_off_and_set_down() -> None:
    made = small()
    hanging = made.certificate.lift.timed.motion.arrival
    lift_from_ground: Any = SimpleNamespace(
        lift=SimpleNamespace(motion=SimpleNamespace(arrival=hanging + 30.0))
    )
    longer = replace(made, grounded=lift_from_ground)
    assert (made.duration, longer.duration) == (hanging, hanging + 30.0)


def test_the_first_table_has_the_numbers_that_decide_and_says_what_was_not_judged() -> None:
    made = small()
    numbers = {row[0]: row[1:] for row in tables(made)[0].rows}
    assert made.utilisation is not None
    assert made.wind is not None
    used = 100.0 * made.utilisation.max()
    assert numbers["utilisation of the chart"] == [f"{used:.1f} %", "90 %"]
    # 8 m/s are 28.8 km/h.
    assert numbers["gust that the lift bears"] == ["8 m/s (29 km/h)", "8 m/s (29 km/h) needed"]

    # All 400 harmless lifts keep 1 m and more; of others the nearest was measured.
    assert numbers["their least distance"] == ["at least 1.00 m", "0.5 m needed"]
    near = Perturbed(np.array([1.0, 0.4, math.nan]), 0.5, {}, np.zeros(3))
    nearest = {row[0]: row[1] for row in tables(small(perturbed=near))[0].rows}
    assert nearest["their least distance"] == "0.40 m"

    unjudged = {row[0]: row[1] for row in tables(small(wind=None, perturbed=None))[0].rows}
    assert unjudged["gust that the lift bears"] == "not judged"
    assert unjudged["perturbed lifts too near"] == "not judged"
