"""Templates load as they stand, and so do they with each example value taken."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cranedyn.__main__ import main
from cranedyn.errors import UnknownName
from cranedyn.lifts.judging.chart import read_chart
from cranedyn.lifts.planning.details_file import (
    CRANE_FIELDS,
    GROUND_FIELDS,
    JOB_FIELDS,
    LIMIT_FIELDS,
    LOAD_FIELDS,
    PEOPLE_FIELDS,
    SAFETY_FIELDS,
    SLING_FIELDS,
    SPREADER_FIELDS,
)
from cranedyn.lifts.planning.file_templates import (
    CRANE_KINDS,
    TEMPLATES,
    template_text,
    write_file_template,
)
from cranedyn.lifts.planning.site_file import read_site
from cranedyn.lifts.sites.crane_site_file import read_crane_site


def with_examples(text: str) -> str:
    """A template whose lines that begin with a field or an obstacle behind # are taken."""
    return re.sub(r"(?m)^# (?=\w+ = |\[\[)", "", text)


def test_the_site_enters_nothing_as_it_stands_and_everything_with_its_examples(
    tmp_path: Path,
) -> None:
    file = tmp_path / "site.toml"
    file.write_text(template_text("site"), encoding="utf-8")
    here = read_site(file)
    # A verdict rests on what somebody entered, and nobody has entered anything.
    assert here.crane == {} and here.limits is None and here.start is None and not here.rigging

    file.write_text(with_examples(template_text("site")), encoding="utf-8")
    here = read_site(file)
    assert here.unusual == () and len(here.solids) == 3
    for table, fields in (
        ("job", JOB_FIELDS),
        ("people", PEOPLE_FIELDS),
        ("crane", CRANE_FIELDS),
        ("load", LOAD_FIELDS),
        ("ground", GROUND_FIELDS),
        ("limits", LIMIT_FIELDS),
        ("safety", SAFETY_FIELDS),
        ("rigging.slings", SLING_FIELDS),
        ("rigging.spreader", SPREADER_FIELDS),
    ):
        for field in fields:
            # The limit of the slings is that of one leg or that of the set.
            if field != "set_limit":
                assert f"[{table}] {field}" in here.entered


def test_the_chart_is_an_example_and_says_so(tmp_path: Path) -> None:
    file = tmp_path / "chart.toml"
    for text in (template_text("chart"), with_examples(template_text("chart"))):
        file.write_text(text, encoding="utf-8")
        chart = read_chart(file)
        assert "EXAMPLE" in chart.name and "EXAMPLE" in chart.source
        assert [reeving.count for reeving in chart.reevings][:2] == [2, 4]


def test_the_lifts_are_read_with_their_cranes(tmp_path: Path) -> None:
    file = tmp_path / "lifts.toml"
    file.write_text(template_text("lifts"), encoding="utf-8")
    formwork, rebar = read_crane_site(file).lifts
    assert (formwork.crane, formwork.load) == ("north", 800.0)
    assert (rebar.crane, rebar.earliest, rebar.after) == ("any", 60.0, ("formwork",))


def test_a_template_is_written_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in TEMPLATES:
        assert main(["template", name]) == 0
        assert Path(f"{name}.toml").read_text(encoding="utf-8") == template_text(name)
    capsys.readouterr()
    Path("site.toml").write_text("mine", encoding="utf-8")
    assert main(["template", "site"]) == 2
    assert "it is there already; name another" in capsys.readouterr().err
    assert Path("site.toml").read_text(encoding="utf-8") == "mine"
    with pytest.raises(UnknownName, match="There is no template 'sites'"):
        write_file_template("sites", tmp_path / "new.toml")


@pytest.mark.parametrize("kind", ["mobile", "overhead"])
def test_a_site_for_another_crane_plans_with_its_examples(kind: str, tmp_path: Path) -> None:
    pytest.importorskip("toppra", reason="extra planning (toppra) is not installed")
    from cranedyn.lifts.planning.lift import plan_lift

    for name in ("site", "chart"):
        if kind in CRANE_KINDS[name]:
            write_file_template(name, tmp_path / f"{name}.toml", kind)
    file = tmp_path / "site.toml"
    text = file.read_text(encoding="utf-8")
    here = read_site(file)
    assert here.limits is None and here.start is None and not here.rigging
    text = with_examples(text).replace('"my_crane.toml"', '"laboratory"')
    if kind == "mobile":
        chart = read_chart(tmp_path / "chart.toml")
        assert chart.booms(2) == [24.0, 30.0] and chart.example
        assert chart.counterweight == 12000.0 and chart.outriggers == 6.4
        (tmp_path / "chart.toml").write_text(with_examples(template_text("chart", kind)))
        assert not read_chart(tmp_path / "chart.toml").interpolation
        text = text.replace('"laboratory"', '"chart.toml"')
    file.write_text(text, encoding="utf-8")
    here = read_site(file)
    assert here.unusual == () and len(here.solids) == 3
    for field in CRANE_FIELDS:
        # Neither has ballast on a base, and a bridge none at all, no jib and no corners.
        of_jib = field in ("jib_length", "wind_measured") or field.startswith("corner_")
        if not field.endswith("_ballast") and not (kind == "overhead" and of_jib):
            assert f"[crane] {field}" in here.entered
    assert here.limits is not None
    lift = plan_lift(here, here.limits)
    assert lift.timed.motion.arrival > 5.0


def test_a_template_knows_its_kinds_and_its_hints_name_the_site(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UnknownName, match="kind of crane for a template of chart"):
        template_text("chart", "overhead")
    assert template_text("site", "tower") == template_text("site")
    assert main(["template", "site", "street.toml", "--kind", "mobile"]) == 0
    shown = capsys.readouterr().out
    assert (
        "cranedyn drive --site street.toml" in shown and "lift_report --site street.toml" in shown
    )
    assert main(["template", "chart", "--kind", "mobile"]) == 0
    shown = capsys.readouterr().out
    assert "cranedyn template site --kind mobile" in shown
    assert "lift_report --site site.toml --chart chart.toml" in shown
