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


@pytest.fixture(scope="module")
def made(ran: Callable[..., Ran], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two experiments, one of them run by the report itself."""
    folder = tmp_path_factory.mktemp("report") / "out"
    shutil.copytree(ran("mass_ratio", "--engine", FAST).folder, folder / "mass_ratio")
    assert (
        report.main(["--out", str(folder), "--only", "energy", "mass_ratio", "--engine", FAST]) == 0
    )
    return folder


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


@browser
def test_every_table_is_there_with_its_rows(made: Path, page: Any) -> None:
    for name in ("energy", "mass_ratio"):
        tables = json.loads((made / name / "result.json").read_text())["tables"]
        shown = page.find_elements("css selector", f"#{name} table")
        assert [t.find_element("css selector", "caption").text for t in shown] == [
            t["title"] for t in tables
        ]
        assert [len(t.find_elements("css selector", "tbody tr")) for t in shown] == [
            len(t["rows"]) for t in tables
        ]


@browser
def test_every_figure_is_loaded(made: Path, page: Any) -> None:
    widths = page.execute_script(
        "return Array.from(document.images, i => i.complete ? i.naturalWidth : 0)"
    )
    assert len(widths) == 1 + sum(1 for _ in made.glob("*/*.svg"))  # the crane of the first screen
    assert min(widths) > 100


@browser
def test_the_page_fits_a_phone_and_leaves_no_error_in_the_console(page: Any) -> None:
    assert page.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")
    assert [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"] == []


@browser
def test_nothing_is_fetched_from_anywhere(page: Any) -> None:
    fetched = page.execute_script(
        "return performance.getEntriesByType('resource').map(e => e.name)"
    )
    assert [name for name in fetched if not name.startswith("data:")] == []


@browser
def test_the_first_screen_says_when_what_and_how_many_claims_hold(made: Path, page: Any) -> None:
    claims = [
        claim
        for name in ("energy", "mass_ratio")
        for claim in json.loads((made / name / "result.json").read_text())["claims"]
    ]
    assert page.find_element("css selector", ".count").text == f"{len(claims)} of {len(claims)}"
    rows = [row.text for row in page.find_elements("css selector", ".summary tbody tr")]
    assert [
        row.split("\n")[0].startswith(title)
        for row, title in zip(rows, ("Energy", "Light links"), strict=True)
    ] == [True] * 2
    assert f"{date.today().year}" in page.find_element("css selector", ".lead").text
    assert [h.text for h in page.find_elements("css selector", "h2")] == ["Energy", "Light links"]


@browser
def test_every_figure_is_a_drawing_with_a_caption(page: Any) -> None:
    figures = page.find_elements("css selector", "section figure")
    assert figures
    for figure in figures:
        assert (
            figure.find_element("css selector", "img")
            .get_attribute("src")
            .startswith("data:image/svg+xml")
        )
        assert len(figure.find_element("css selector", "figcaption").text.split()) > 4


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
        tables = page.execute_script(
            "return Array.from(document.querySelectorAll('table'), t => "
            "t.getBoundingClientRect().right)"
        )
        assert tables and max(tables) <= a4
        assert (
            page.execute_script("return getComputedStyle(document.querySelector('nav')).display")
            == "none"
        )
        emulate(media="screen", features=[{"name": "prefers-color-scheme", "value": "dark"}])
        ink, paper = page.execute_script(
            "const s = getComputedStyle(document.body); return [s.color, s.backgroundColor]"
        )
        assert (
            sum(map(int, re.findall(r"\d+", ink)[:3]))
            > 600
            > 150
            > sum(map(int, re.findall(r"\d+", paper)[:3]))
        )
    finally:
        emulate(media="screen", features=[])
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@browser
def test_the_contents_stay_in_view(page: Any) -> None:
    page.execute_script("window.scrollTo(0, document.body.scrollHeight)")
    assert (
        0
        <= page.execute_script("return document.querySelector('nav').getBoundingClientRect().top")
        < 10
    )


def test_every_experiment_of_the_catalogue_is_one_of_the_report() -> None:
    assert report.EXPERIMENTS is EXPERIMENTS
    assert all(len(entry.title) < 30 for entry in EXPERIMENTS.values())
    assert [name for name, entry in EXPERIMENTS.items() if not entry.figures] == [
        "cranes",
        "lift_benchmark",
    ]


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


def test_claims_and_the_command_that_repeats_them_are_on_the_page(made: Path) -> None:
    text = (made / "report.html").read_text(encoding="utf-8")
    for name in ("energy", "mass_ratio"):
        result = json.loads((made / name / "result.json").read_text())
        assert all(
            claim["sentence"].split("(")[0].strip()[:40] in text for claim in result["claims"]
        )
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
