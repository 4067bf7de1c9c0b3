"""The page of the interfaces: its commands work as they stand, its table is what the benchmark
prints, its files are whole or not there.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from benchmarks import bridges
from cranedyn import plugins
from cranedyn.__main__ import main
from cranedyn.bridges.target import new_file, new_folder
from cranedyn.errors import CraneError
from experiments import a3, harness
from tests.helpers import FAST, ROOT, python

PAGES = {path.name: path.read_text(encoding="utf-8") for path in ROOT.glob("docs/*/*.md")}
EXPORTERS = plugins.names("exporter")
COMMANDS = dict.fromkeys(
    command
    for page in PAGES.values()
    for command in re.findall(r"^cranedyn export (.+)$", page, re.MULTILINE)
)


@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_of_the_page_writes_what_it_says(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exporter, target, *others = shlex.split(words)
    if exporter == "mcap":
        pytest.importorskip(
            "mcap_ros2", reason="mcap-ros2-support is not installed: pip install 'cranedyn[mcap]'"
        )
        Path("out/a3").mkdir(parents=True)
        a3.run(harness.Setup(9.8, engine=FAST)).before(1.0).write(
            others[others.index("--trajectory") + 1]
        )
    assert main(["export", exporter, target, *others]) == 0
    assert Path(target).exists()


def test_the_page_has_a_command_for_every_door() -> None:
    assert {words.split()[0] for words in COMMANDS} == set(EXPORTERS)
    assert all(
        re.search(rf"^\| `{exporter} (DIR|FILE)` \|", PAGES["export.md"], re.MULTILINE)
        for exporter in EXPORTERS
    )


def test_the_table_of_the_page_is_what_the_benchmark_prints() -> None:
    for package in ("mujoco", "mcap_ros2", "rosbags", "llvmlite", "fmpy"):
        pytest.importorskip(package)
    made = bridges.exporter_table()
    assert {row[0] for row in made.rows} == set(EXPORTERS)
    for shown in made.shown():
        exporter, *_, compared, apart, _ = shown
        assert re.search(
            rf"^\| {exporter} \| \d+ \| \d+ \| {re.escape(compared)} \| {re.escape(apart)} \| "
            r"[\d-]+ \|$",
            PAGES["speed.md"],
            re.MULTILINE,
        )
    # Gazebo's step; the others round.
    assert max(float(row[4]) for row in made.rows if isinstance(row[4], float)) < 1e-4


def test_a_target_that_appears_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    with (
        pytest.raises(CraneError, match="it is there already"),
        new_folder(tmp_path / "out") as draft,
    ):
        (draft / "a").write_text("ours")
        (tmp_path / "out").mkdir()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert list((tmp_path / "out").iterdir()) == []


def test_a_target_is_whole_or_not_there(tmp_path: Path) -> None:
    for new in (new_folder, new_file):
        with pytest.raises(KeyboardInterrupt), new(tmp_path / "out.xml") as draft:
            (draft / "a" if draft.is_dir() else draft).write_text("half")
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(CraneError, match="no name holds a NUL"), new_file(tmp_path / "a\0b"):
        pass


def test_without_llvmlite_only_the_door_that_needs_it_stays_shut(tmp_path: Path) -> None:
    script = (
        "import sys; sys.modules['llvmlite'] = None; from cranedyn.__main__ import "
        "main; sys.exit(main(['export', *sys.argv[1:]]))"
    )
    assert python(script, "mjcf", tmp_path / "crane.xml").returncode == 0
    shut = python(script, "fmu", tmp_path / "crane.fmu")
    assert shut.returncode == 2 and shut.stderr.startswith(
        "error: The compiled engine needs llvmlite, which is not installed: pip install"
    )
    assert [path.name for path in tmp_path.iterdir()] == ["crane.xml"]


def test_the_help_says_each_door_in_whole_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--help"], *([exporter, "--help"] for exporter in EXPORTERS)):
        with pytest.raises(SystemExit):
            main(["export", *arguments])
        said = " ".join(capsys.readouterr().out.split())
        for exporter in EXPORTERS if arguments == ["--help"] else arguments[:1]:
            about = (plugins.load("exporter", exporter).__doc__ or "").split("\n\n")[0]
            assert about.rstrip().endswith(".") and " ".join(about.split()) in said


def test_no_door_is_no_door(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["export", "unity", "x"])
    assert ended.value.code == 2
    assert "invalid choice: 'unity'" in capsys.readouterr().err
