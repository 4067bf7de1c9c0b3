"""Each command ends with two commands that go on with what it has written, and that work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import cranedyn as cd
from cranedyn import plugins
from cranedyn.__main__ import main
from cranedyn.controllers import hold_controller
from cranedyn.interop.commissioning import serve
from cranedyn.interop.commissioning.served_crane import ServedCrane
from cranedyn.recording import Run, record
from tests.next_commands import check_next_commands

HEAVY = "--set payload_mass:=2000"
"""Words that name a crane whose load weighs 2 t."""

COMMANDS = (
    "benchmark list",
    "describe",
    "describe --list",
    "describe --machines",
    f"describe {HEAVY.removeprefix('--set ')} --gravity 9.8 -o crane.urdf",
    "list",
    "record-template",
    "record-template swing.csv",
    "template site",
    "template chart mine.toml",
    "template lifts",
    f"serve --map words.csv {HEAVY}",
    f"view run.csv {HEAVY}",
    "view run.rrd",
)
"""Commands that are quick."""

EXPORTS = {
    "c": ("crane_c --controller lqr", "long"),
    "fmu": ("crane.fmu", "long"),
    "gazebo": (f"crane_gazebo {HEAVY}", ""),
    "matlab": ("crane.mat", ""),
    "mcap": ("crane.mcap --trajectory run.parquet", ""),
    "mjcf": (f"crane.xml {HEAVY}", ""),
    "page": (f"crane.html {HEAVY}", "long"),
    "ros2": ("crane_description", ""),
    "st": (f"controller.st {HEAVY} --gravity 9.8", ""),
}
"""Arguments of each exporter, and the marker of its test."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to run in, whose name a shell would split, without viewer and browser."""
    two_words = tmp_path / "two words"
    two_words.mkdir()
    monkeypatch.chdir(two_words)
    monkeypatch.setattr("webbrowser.open", lambda address: True)
    monkeypatch.setattr("cranedyn.recording.open_viewer", lambda path: None)
    return two_words


def write_run(*files: str) -> None:
    """Write a short run of a heavy load that hangs, as each of the files."""
    crane = cd.load_crane(payload_mass=2000)
    run = cd.simulate(crane, hold_controller(crane), duration=0.1)
    for file in files:
        if file.endswith(".rrd"):
            record(file, [Run("run", crane, run)], title="A run")
        else:
            run.write(file)


@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_ends_with_two_commands_that_work(
    words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if words.startswith("view"):
        write_run(words.split()[1])
    assert main(words.split()) == 0
    check_next_commands(capsys.readouterr().out, monkeypatch)


def test_runs_whose_names_differ_behind_a_dot_have_recordings_of_their_own(folder: Path) -> None:
    write_run("run.1.parquet", "run.2.parquet")
    for file in ("run.1.parquet", "run.2.parquet"):
        assert main(["view", file]) == 0
    recordings = sorted(path.name for path in (folder / "out" / "view").glob("*.rrd"))
    assert recordings == ["run.1.rrd", "run.2.rrd"]


def test_every_exporter_is_one_whose_next_commands_are_tried() -> None:
    assert set(EXPORTS) == set(plugins.names("exporter"))


@pytest.mark.parametrize(
    ("exporter", "words"),
    [
        pytest.param(name, words, marks=pytest.mark.long if marker else (), id=name)
        for name, (words, marker) in EXPORTS.items()
    ],
)
def test_an_export_ends_with_two_commands_that_work(
    exporter: str,
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if exporter == "mcap":
        pytest.importorskip("mcap", reason="the extra mcap is not installed")
        write_run("run.parquet")
    assert main(["export", exporter, *words.split()]) == 0
    check_next_commands(capsys.readouterr().out, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "--controller mine.json --period 0.02",
        "--controller lqr --drive velocity --period 0.02",
        "--controller mine.json --drive velocity",
        "--controller hold",
    ],
)
def test_the_same_controller_in_c_is_named_by_the_words_that_were_given(
    words: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    gain = {"D": [[-0.5]], "inputs": ["x"], "outputs": ["x_dot_command"]}
    (folder / "mine.json").write_text(json.dumps(gain), encoding="utf-8")
    assert main(["export", "st", "mine.st", *words.split()]) == 0
    output = capsys.readouterr().out
    assert output.splitlines()[-1].strip() == f"cranedyn export c mine_c {words}"
    check_next_commands(output, monkeypatch)


@pytest.mark.long
def test_the_page_to_drive_on_is_opened_again_by_its_next_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["drive", *HEAVY.split()]) == 0
    check_next_commands(capsys.readouterr().out, monkeypatch)


def test_a_crane_that_was_served_ends_with_two_commands_that_work(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = ServedCrane(cd.load_crane(), duration=0.1)
    plant.cycle()
    serve._save(folder / "served", plant)
    check_next_commands(capsys.readouterr().out, monkeypatch)
