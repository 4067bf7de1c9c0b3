"""The report: one page that needs nothing else, looked at in a real browser."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from experiments import report
from experiments.catalogue import EXPERIMENTS
from tests.experiments.conftest import Ran
from tests.helpers import FAST

selenium = pytest.importorskip(
    "selenium.webdriver", reason="extra browser (selenium) is not installed"
)
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="Chromium and its driver are not installed"
)


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
        yield driver
    finally:
        driver.quit()


def _all(where: Any, selector: str) -> list[Any]:
    return where.find_elements("css selector", selector)


@browser
def test_every_table_is_there_with_its_rows(results: dict[str, Any], page: Any) -> None:
    for name, result in results.items():
        shown, tables = _all(page, f"#{name} table"), result["tables"]
        titles = [table.find_element("css selector", "caption").text for table in shown]
        assert titles == [table["title"] for table in tables]
        rows = [len(_all(table, "tbody tr")) for table in shown]
        assert rows == [len(table["rows"]) for table in tables]


@browser
def test_every_figure_is_loaded_a_drawing_and_has_a_caption(made: Path, page: Any) -> None:
    widths = page.execute_script(
        "return Array.from(document.images, i => i.complete ? i.naturalWidth : 0)"
    )
    assert len(widths) == 1 + sum(1 for _ in made.glob("*/*.svg"))  # the crane of the first screen
    assert min(widths) > 100
    figures = _all(page, "section figure")
    assert figures
    for figure in figures:
        (image,), (caption,) = _all(figure, "img"), _all(figure, "figcaption")
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
    assert [e.text for e in _all(page, ".count")] == [f"{count} of {count}"]
    rows = [row.text.split("\n")[0] for row in _all(page, ".summary tbody tr")]
    titles = ["Energy", "Light links"]
    assert all(row.startswith(title) for row, title in zip(rows, titles, strict=True))
    assert f"{date.today().year}" in _all(page, ".lead")[0].text
    assert [heading.text for heading in _all(page, "h2")] == titles


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
        edges = page.execute_script(
            "return Array.from(document.querySelectorAll('table'), t => "
            "t.getBoundingClientRect().right)"
        )
        assert edges and max(edges) <= a4
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


def test_a_report_says_which_experiment_it_is_at_and_goes_on_without_one_that_fails(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(argv: list[str]) -> int:
        return 2

    def works(argv: list[str]) -> int:
        shutil.copytree(made / "mass_ratio", tmp_path / "mass_ratio")
        assert argv == [f"--out={tmp_path / 'mass_ratio'}"]
        return 0

    modules = {
        "experiments.energy": SimpleNamespace(main=fails),
        "experiments.mass_ratio": SimpleNamespace(main=works),
    }
    monkeypatch.setattr(report.importlib, "import_module", modules.__getitem__)
    assert report.main(["--out", str(tmp_path), "--only", "energy", "mass_ratio", "--quick"]) == 2
    out, err = capsys.readouterr()
    assert "Experiment 2 of 2: Light links (mass_ratio)" in out
    assert "Energy (energy) could not be made" in err
    assert 'id="mass_ratio"' in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_claims_and_the_command_that_repeats_them_are_on_the_page(
    made: Path, results: dict[str, Any]
) -> None:
    text = (made / "report.html").read_text(encoding="utf-8")
    for name, result in results.items():
        for claim in result["claims"]:
            assert claim["sentence"].split("(")[0].strip()[:40] in text
        assert f"python -m experiments.{name}" in text
        assert result["parameters"]["engine"] == FAST


def test_results_that_are_there_are_collected_not_run_again(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        report.importlib, "import_module", lambda name: pytest.fail(f"{name} was run")
    )
    assert report.main(["--out", str(made), "--only", "mass_ratio"]) == 0


def test_bad_input_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report.main(["--out", str(tmp_path / "out"), "--only", "a9"]) == 2
    (tmp_path / "a1").mkdir()
    (tmp_path / "a1" / "result.json").write_text("{", encoding="utf-8")
    assert report.main(["--out", str(tmp_path), "--only", "a1"]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert "a9" in errors[0]
    assert "it is not JSON" in errors[1]
    assert not (tmp_path / "report.html").exists()
