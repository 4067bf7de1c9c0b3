"""The report: one page that needs nothing else, looked at in a real browser."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from markupsafe import escape

from cranedyn.command import INTERRUPTED
from experiments import report
from experiments.catalogue import EXPERIMENTS
from tests.experiments.conftest import Ran
from tests.helpers import FAST, HOSTILE_NAMES, RESULT
from tests.next_commands import check_next_commands

selenium = pytest.importorskip(
    "selenium.webdriver", reason="extra browser (selenium) is not installed"
)
CHROMIUM = shutil.which("chromium")
DRIVER = shutil.which("chromedriver")
browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="Chromium and its driver are not installed"
)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_takes_the_arguments_of_its_entry(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("experiments.harness.run._outcome", stop)
    main = importlib.import_module(f"experiments.{name}").main
    for words in (EXPERIMENTS[name].arguments, EXPERIMENTS[name].quick):
        assert main([*words, "--out", str(tmp_path / "out")]) == INTERRUPTED
    for engine in ("", "--engine=pinocchio", "--engine=compiled"):
        given = [word for word in ("--out", str(tmp_path), engine) if word]
        options = report.report_parser().parse_args(given)
        assert main(report.experiment_arguments(name, options)) == INTERRUPTED


UNFOLD = "document.querySelectorAll('details').forEach(folded => folded.open = true)"

SHOWN = ("energy", "mass_ratio")
"""Experiments on the page."""


@pytest.fixture(scope="module")
def made(ran: Callable[..., Ran], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two experiments, one of them run by the report itself."""
    folder = tmp_path_factory.mktemp("report") / "out"
    shutil.copytree(ran("mass_ratio", "--engine", FAST).folder, folder / "mass_ratio")
    words = ["--out", str(folder), "--only", *SHOWN, "--engine", FAST]
    assert report.main(words) == 0
    return folder


@pytest.fixture(scope="module")
def results(made: Path) -> dict[str, dict[str, Any]]:
    return {name: json.loads((made / name / "result.json").read_text()) for name in SHOWN}


@pytest.fixture(scope="module")
def page(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The report in a browser of a phone's width."""
    options = selenium.ChromeOptions()
    options.binary_location = CHROMIUM
    profile = tmp_path_factory.mktemp("profile")
    words = (
        "--headless=new --no-sandbox --disable-gpu --no-first-run "
        "--disable-background-networking --disable-component-update --disable-sync"
    )
    for word in (*words.split(), "--window-size=400,800", f"--user-data-dir={profile}"):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = selenium.Chrome(options=options, service=selenium.ChromeService(DRIVER))
    try:
        driver.get((made / "report.html").as_uri())
        driver.execute_script(UNFOLD)
        yield driver
    finally:
        driver.quit()


def _all(where: Any, selector: str) -> list[Any]:
    return where.find_elements("css selector", selector)


@browser
def test_every_table_is_there_with_its_rows(results: dict[str, Any], page: Any) -> None:
    for name, result in results.items():
        shown = _all(page, f"#{name} table")
        tables = result["tables"]
        titles = [table.find_element("css selector", "caption").text for table in shown]
        assert titles == [table["title"] for table in tables]
        rows = [len(_all(table, "tbody tr")) for table in shown]
        assert rows == [len(table["rows"]) for table in tables]


@browser
def test_every_figure_is_loaded_a_drawing_and_has_a_caption(made: Path, page: Any) -> None:
    widths = page.execute_script(
        "return Array.from(document.images, i => i.complete ? i.naturalWidth : 0)"
    )
    assert len(widths) == 1 + sum(1 for _ in made.glob("*/*.svg"))  # one stands twice
    assert min(widths) > 100
    figures = _all(page, "section figure")
    assert figures
    for figure in figures:
        (image,) = _all(figure, "img")
        (caption,) = _all(figure, "figcaption")
        assert image.get_attribute("src").startswith("data:image/svg+xml")
        assert len(caption.text.split()) > 4


@browser
def test_the_page_fits_a_phone_and_leaves_no_error_in_the_console(page: Any) -> None:
    assert page.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")
    assert [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"] == []


@browser
def test_nothing_is_fetched_from_anywhere(page: Any) -> None:
    script = "return performance.getEntriesByType('resource').map(e => e.name)"
    fetched = page.execute_script(script)
    assert [name for name in fetched if not name.startswith("data:")] == []


@browser
def test_the_first_screen_says_when_what_and_how_many_claims_hold(
    results: dict[str, Any], page: Any
) -> None:
    count = sum(len(result["claims"]) for result in results.values())
    assert [e.text for e in _all(page, ".count")] == [f"✔{count} of {count}"]
    titles = ["Energy", "Light links"]
    assert [heading.text for heading in _all(page, "section h2")] == titles
    assert len(_all(page, "nav a .mark.held")) == len(titles)
    assert f"{date.today().year}" in _all(page, "header p")[1].text
    holding = [row.text.split("\n")[-1] for row in _all(page, "section > details > summary")]
    counts = [len(result["claims"]) for result in results.values()]
    assert all(
        text.endswith(f"{count} of {count}") for text, count in zip(holding, counts, strict=True)
    )


@browser
def test_at_1280_pixels_the_contents_stand_beside_one_screen_and_all_else_is_folded(
    page: Any,
) -> None:
    size = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    page.refresh()
    try:
        nav, main, header = (_all(page, name)[0].rect for name in ("nav", "main", "header"))
        assert nav["x"] == 0
        assert nav["height"] == 800
        assert nav["width"] < 300
        assert main["x"] >= nav["width"]
        assert main["x"] + main["width"] <= 1280
        assert header["y"] + header["height"] < 800
        assert not any(item.is_displayed() for item in _all(page, "section li, section figure"))
        for link in _all(page, "nav a[href='#mass_ratio'], .pictures a, section .claims a"):
            page.execute_script("arguments[0].click()", link)
            target = page.find_element("css selector", link.get_attribute("hash"))
            assert target.is_displayed()
        assert all(item.is_displayed() for item in _all(page, "section li, section figure"))
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        page.execute_script(UNFOLD)


@browser
def test_search_shows_the_claims_tables_and_figures_that_have_every_word(page: Any) -> None:
    field = page.find_element("css selector", "input[type=search]")
    shown = "section .claims li, section .table, section figure"
    try:
        page.execute_script("document.querySelectorAll('details').forEach(d => d.open = false)")
        field.send_keys("DAMPED pendulum")
        found = [item.text.lower() for item in _all(page, shown) if item.is_displayed()]
        assert found
        assert all("damped" in text and "pendulum" in text for text in found)
        assert page.find_element("css selector", "[role=status]").text == f"{len(found)} found"
        assert not page.find_element("id", "mass_ratio").is_displayed()
        field.clear()
        field.send_keys("no such thing")
        assert not any(item.is_displayed() for item in _all(page, "header, section"))
    finally:
        field.clear()
        field.send_keys(" ")
        page.execute_script(UNFOLD)
    assert all(item.is_displayed() for item in _all(page, f"header, {shown}"))


@browser
def test_every_claim_leads_to_the_command_that_repeats_it(
    results: dict[str, Any], page: Any
) -> None:
    for name, result in results.items():
        links = _all(page, f"#{name} .claims a")
        assert len(links) == len(result["claims"])
        for link in links:
            command = page.find_element("css selector", link.get_attribute("hash"))
            assert command.text == link.get_attribute("title") == result["command"]


@browser
def test_on_paper_no_table_is_wider_than_the_page_and_by_night_words_are_light(page: Any) -> None:
    def emulate(**words: Any) -> None:
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", words)

    try:
        a4 = round((210 - 2 * 12) / 25.4 * 96)
        page.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": a4, "height": 1000, "deviceScaleFactor": 1, "mobile": False},
        )
        emulate(media="print")
        page.execute_script("document.querySelectorAll('details').forEach(d => d.open = false)")
        page.execute_script("dispatchEvent(new Event('beforeprint'))")
        edges = page.execute_script(
            "return Array.from(document.querySelectorAll('table'), t => "
            "t.getBoundingClientRect().right)"
        )
        assert edges
        assert max(edges) <= a4
        shown = "return getComputedStyle(document.querySelector('nav')).display"
        assert page.execute_script(shown) == "none"
        emulate(media="screen", features=[{"name": "prefers-color-scheme", "value": "dark"}])
        ink, paper = (
            sum(map(int, re.findall(r"\d+", colour)[:3]))
            for colour in page.execute_script(
                "const s = getComputedStyle(document.body); return [s.color, s.backgroundColor]"
            )
        )
        assert ink > 600 > 150 > paper
    finally:
        emulate(media="screen", features=[])
        page.execute_script(UNFOLD)
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@browser
def test_the_contents_stay_in_view(page: Any) -> None:
    page.execute_script("window.scrollTo(0, document.body.scrollHeight)")
    script = "return document.querySelector('nav').getBoundingClientRect().top"
    assert 0 <= page.execute_script(script) < 10


def test_every_experiment_of_the_catalogue_is_one_of_the_report() -> None:
    assert report.EXPERIMENTS is EXPERIMENTS
    assert all(len(entry.title) < 30 for entry in EXPERIMENTS.values())
    without = [name for name, entry in EXPERIMENTS.items() if not entry.figures]
    assert without == ["cranes", "lift_benchmark"]


RUNNER = """
import pathlib, sys, time
result, name, folder = *sys.argv[1:3], pathlib.Path(sys.argv[-1].removeprefix("--out="))
(folder.parent / f"began_{name}").touch()
deadline = time.process_time() + 5.0  # in which the other may run as long
while not all((folder.parent / f"began_{name}").exists() for name in ("energy", "mass_ratio")):
    assert time.process_time() < deadline, "the other does not run beside this one"
if name == "energy":
    sys.exit("error: a sentence")
folder.mkdir()
(folder / "result.json").write_text(result)
print("noise", "3 of 3 claims hold, 0 not judged.", sep="\\n")
"""


def test_two_experiments_run_side_by_side_and_one_that_fails_stops_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = json.dumps(RESULT | {"experiment": "mass_ratio"})
    monkeypatch.setattr(report, "COMMAND", (sys.executable, "-c", RUNNER, result))
    assert report.main(["--out", str(tmp_path), "--only", "energy", "mass_ratio", "--quick"]) == 1
    out, err = capsys.readouterr()
    assert "Experiment 2 of 2: mass_ratio" in out
    assert "noise" not in out
    assert "mass_ratio: 3 of 3 claims hold" in out
    assert "energy: error: a sentence" in out
    assert "Energy (energy) could not be made" in err
    assert 'id="mass_ratio"' in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_claims_and_the_command_that_repeats_them_are_on_the_page(
    made: Path, results: dict[str, Any]
) -> None:
    text = (made / "report.html").read_text(encoding="utf-8")
    for name, result in results.items():
        for claim in result["claims"]:
            assert claim["sentence"].split("(")[0].strip()[:40] in text
        assert f"cranedyn run {name}" in text
        assert result["parameters"]["engine"] == FAST


@pytest.mark.parametrize(
    ("verdicts", "mark"),
    [([True, True], "held"), ([True, False, None], "fails"), ([True, None], "open")],
)
def test_an_experiment_is_marked_by_its_worst_claim_and_a_failing_one_is_on_the_first_screen(
    verdicts: list[bool | None], mark: str, tmp_path: Path
) -> None:
    claims = [{"sentence": f"a < {i}", "holds": holds} for i, holds in enumerate(verdicts)]
    (tmp_path / "result.json").write_text(json.dumps(RESULT | {"claims": claims}))
    first, _, section = report.page([tmp_path]).partition("<section")
    link = first[first.index('<a href="#a1">') : first.index("</nav>")]
    assert f'class="mark {mark}"' in link
    assert "A1, free swing" in link
    assert f"</span>{verdicts.count(True)} of {len(verdicts)}</span>" in section
    assert re.findall(r"a &lt; \d", first) == [
        f"a &lt; {i}" for i, holds in enumerate(verdicts) if holds is False
    ]


def test_results_that_are_there_are_collected_not_run_again(
    made: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "COMMAND", ("/nothing is run",))
    assert report.main(["--out", str(made), "--only", "mass_ratio"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"Written to {made / 'report.html'}.\n")
    check_next_commands(text, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_what_a_result_says_is_data_of_the_page(name: str, tmp_path: Path) -> None:
    claims = [{"sentence": name, "holds": False}]
    words = {"claims": claims, "about": name, "command": name, "machine": name}
    (tmp_path / "result.json").write_text(json.dumps(RESULT | words))
    text = report.page([tmp_path])
    assert f"<code>{escape(name)}</code>" in text
    assert f"</span>{escape(name)} <a" in text
    assert "<img src=x" not in text
    assert "<b>" not in text
    assert text.count("<script>") == 1
    # The style sheet hides the heading above a list that holds nothing, not even a space.
    assert '<h2>Newly found</h2>\n<ul class="claims"></ul>' in text
