"""The page of the interfaces: its commands work as they stand, its table is what the benchmark
prints, its files are whole or not there.
"""

from __future__ import annotations

import csv
import json
import math
import re
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from benchmarks import bridges
from cranedyn import plugins
from cranedyn.__main__ import main
from cranedyn.controllers import hold_controller
from cranedyn.errors import CraneError, ModelError
from cranedyn.export import gazebo, mjcf_file, ros2
from cranedyn.export.target import new_file, new_folder
from cranedyn.model.load import load_crane
from experiments import a3, harness
from tests.dynamics.test_converters import CART
from tests.helpers import FAST, ROOT, python
from tests.model.test_foreign import RIGID

PAGES = {path.name: path.read_text(encoding="utf-8") for path in ROOT.glob("docs/*/*.md")}
EXPORTERS = plugins.names("exporter")
COMMANDS = {
    command: name
    for name, page in PAGES.items()
    for command in re.findall(r"^cranedyn export (.+)$", page, re.MULTILINE)
}


ELSEWHERE = {"drive.md", "foreign_cranes.md", "own_design.md"}
"""Pages whose commands follow others of the page, and are run with them elsewhere."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [command for command, page in COMMANDS.items() if page not in ELSEWHERE]
)
def test_a_command_of_the_page_writes_what_it_says(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # Files that the pages call the reader's own: a crane whose hook is rigid, and a gain.
    Path("crane.urdf").write_text(RIGID, encoding="utf-8")
    gain = {"D": [[0.0], [0.4], [0.0]], "inputs": ["phi"]}
    commands = [f"{symbol}_dot_command" for symbol in ("gamma", "x", "l")]
    Path("my_gain.json").write_text(json.dumps({**gain, "outputs": commands}), encoding="utf-8")
    exporter, target, *others = shlex.split(words)
    if exporter == "mcap":
        pytest.importorskip("mcap_ros2", reason="not installed: pip install 'cranedyn[mcap]'")
        Path("out/a3").mkdir(parents=True)
        run = a3.run(harness.Setup(9.8, engine=FAST)).before(1.0)
        run.write(others[others.index("--trajectory") + 1])
    assert main(["export", exporter, target, *others]) == 0
    assert Path(target).exists()


def test_the_page_has_a_command_for_every_door() -> None:
    assert {words.split()[0] for words in COMMANDS} == set(EXPORTERS)
    assert all(
        re.search(rf"^\| `{exporter} (DIR|FILE)` \|", PAGES["export.md"], re.MULTILINE)
        for exporter in EXPORTERS
    )


@pytest.mark.slow
def test_the_table_of_the_page_is_what_the_benchmark_prints() -> None:
    for package in ("mujoco", "mcap_ros2", "rosbags", "llvmlite", "fmpy"):
        pytest.importorskip(package)
    made = bridges.exporter_table()
    # A browser, MATLAB and a PLC are tested beside their exporters.
    assert {row[0] for row in made.rows} == set(EXPORTERS) - {"matlab", "page", "st"}
    with open(ROOT / "docs/results/bridges_exporters.csv", newline="") as file:
        told = {exporter: values for exporter, *values in csv.reader(file)}
    for exporter, *_, compared, apart, _ in made.shown():
        assert told[exporter][2:4] == [compared, apart]
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


@pytest.mark.slow
def test_without_llvmlite_only_the_exporter_that_needs_it_is_missing(tmp_path: Path) -> None:
    script = (
        "import sys; sys.modules['llvmlite'] = None; from cranedyn.__main__ import "
        "main; sys.exit(main(['export', *sys.argv[1:]]))"
    )
    assert python(script, "mjcf", tmp_path / "crane.xml").returncode == 0
    refused = python(script, "fmu", tmp_path / "crane.fmu")
    sentence = "error: The compiled engine needs llvmlite, which is not installed: pip install"
    assert refused.returncode == 2
    assert refused.stderr.startswith(sentence)
    assert [path.name for path in tmp_path.iterdir()] == ["crane.xml"]


@pytest.mark.slow
def test_the_help_says_each_door_in_whole_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["--help"], *([exporter, "--help"] for exporter in EXPORTERS)):
        with pytest.raises(SystemExit):
            main(["export", *arguments])
        said = " ".join(capsys.readouterr().out.split())
        for exporter in EXPORTERS if arguments == ["--help"] else arguments[:1]:
            about = (plugins.load("exporter", exporter).__doc__ or "").split("\n\n")[0]
            assert about.rstrip().endswith(".")
            assert " ".join(about.split()) in said


BAD = """
mjcf c.mjcf => the ending must be .xml.
mjcf c.xml --dt 0 => dt is 0.0 s; allowed is > 0.
mjcf c.xml --urdf none.urdf => Cannot read none.urdf
mjcf no/c.xml => does not exist
mjcf c.xml --set payload_inertia:=0 => The link hook_link has no mass or no inertia
fmu c.zip => the ending must be .fmu.
fmu c.fmu --dt -1 => dt is -1.0 s; allowed is > 0.
ros2 c --name Crane-1 => A package of ROS cannot be called 'Crane-1'; allowed are
ros2 c --dt 0 => dt is 0.0 s; allowed is > 0.
gazebo c --angle 9 => phi at the start is 9.0 rad; allowed is
gazebo c --duration 0 => duration is 0.0 s; allowed is > 0
gazebo c --set payload_inertia:=0 => The link hook_link has no mass or no inertia
gazebo c --erp 2 => erp is 2.0; allowed is 0 to 1.
gazebo c --every 0 => control instants between rows is 0; allowed is a whole
gazebo c --machine gantry_laboratory --length 99 => l at the start is 99.0 m; allowed is
gazebo no/c => does not exist
"""
"""Exports, and what is in the sentence with which they are refused."""


@pytest.mark.slow
@pytest.mark.parametrize("row", BAD.strip().splitlines())
def test_what_cannot_be_exported_is_a_sentence_and_nothing_is_written(
    row: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line, sentence = row.split(" => ")
    exporter, name, *words = line.split()
    assert main(["export", exporter, str(tmp_path / name), *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert sentence in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "name", "c fmu.fmu gazebo matlab.mat mjcf.xml page.html ros2 st.st".split()
)
def test_a_target_that_exists_stays_as_it_is(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exporter = name.partition(".")[0]
    target = tmp_path / name
    target.write_text("mine")
    assert main(["export", exporter, str(target)]) == 2
    there = f"error: Cannot write {target}: it is there already; name another, or remove it.\n"
    assert capsys.readouterr().err == there
    assert target.read_text() == "mine"


TAKEN_CRANES: dict[str, dict[str, float]] = {
    "hook block, with or without inertia": {"hook_mass": 200.0},
    "load slung at lugs (`lug_height`) without a hook": {"lug_height": 1.0},
    "elastic rope": {"rope_stiffness": 1e7},
    "rope that goes slack and does not stretch": {"rope_stiffness": math.inf},
    "two falls": {"fall_spacing": 1.0},
    "tower that twists": {"tower_twist_stiffness": 1e8},
    "tower or jib that bends": {"tower_bend_stiffness": 1e8, "jib_bend_stiffness": 1e8},
    "load that is a point": {"payload_inertia": 0.0},
}
"""Arguments of the cranes in the table of docs/howto/export.md, by their names there."""


def is_taken(export: Callable[[], object]) -> bool:
    try:
        export()
    except ModelError:
        return False
    return True


@pytest.mark.long
def test_the_page_says_which_cranes_are_taken_by_which_simulator(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "howto" / "export.md").read_text(encoding="utf-8")
    lines = page[page.index("| crane | MuJoCo |") :].splitlines()
    rows = {}
    for line in lines[2 : 2 + len(TAKEN_CRANES)]:
        name, mujoco, others = (cell.strip() for cell in line.strip("|").split("|"))
        rows[name] = (mujoco == "taken", others == "taken")
    assert list(rows) == list(TAKEN_CRANES)
    for i, (name, values) in enumerate(TAKEN_CRANES.items()):
        crane = load_crane(**values)  # type: ignore[arg-type]
        swing = gazebo.Program(crane, hold_controller(crane), None, crane.start, 1.0)
        by_mujoco = is_taken(partial(mjcf_file.export, tmp_path / f"{i}.xml", crane))
        by_ros2 = is_taken(partial(ros2.export, tmp_path / f"package_{i}", crane))
        by_gazebo = is_taken(partial(gazebo.export, tmp_path / f"gazebo_{i}", swing))
        assert (by_mujoco, by_ros2) == rows[name], name
        assert by_gazebo == by_ros2, name


@pytest.mark.slow
def test_a_rope_that_goes_slack_without_stretching_is_refused_with_the_number_that_helps(
    tmp_path: Path,
) -> None:
    crane = load_crane(rope_stiffness=math.inf)
    with pytest.raises(CraneError, match=r"hoist_joint has an armature, .* rope_stiffness 0"):
        ros2.export(tmp_path / "own", crane)
    # Another crane may have such a rope, and a mass between drum and rope instead of an armature.
    inertia = 'ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'
    block = f'<inertial><mass value="50"/><inertia {inertia}/></inertial>'
    text = crane.urdf.replace('armature="5000.0"', "")
    text = text.replace('<link name="rope_link"/>', f'<link name="rope_link">{block}</link>')
    (tmp_path / "other.urdf").write_text(text, encoding="utf-8")
    other = load_crane(tmp_path / "other.urdf")
    with pytest.raises(CraneError, match=r"goes slack .* \(rope_stiffness > 0, EA in N\)"):
        ros2.export(tmp_path / "other", other)


@pytest.mark.slow
def test_a_load_without_inertia_is_refused_with_the_argument_that_gives_it_one(
    tmp_path: Path,
) -> None:
    message = "link payload_link has no mass or no inertia, .* by payload_inertia"
    point = load_crane(hook_mass=200.0, payload_inertia=0.0)
    for exporter, target in ((mjcf_file, "crane.xml"), (ros2, "crane")):
        with pytest.raises(CraneError, match=message):
            exporter.export(tmp_path / target, point)


def test_a_crane_of_another_file_is_told_no_argument_of_the_tower_crane(tmp_path: Path) -> None:
    (tmp_path / "other.urdf").write_text(load_crane(payload_inertia=0.0).urdf)
    with pytest.raises(CraneError, match=r"allowed are numbers > 0\.$"):
        mjcf_file.export(tmp_path / "crane.xml", load_crane(tmp_path / "other.urdf"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "named"), [("--drive velocity", True), ("--controller hold", False)]
)
def test_an_exported_crane_whose_rate_is_a_default_says_so(
    options: str, named: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("llvmlite", reason="extra compiled (llvmlite) is not installed")
    (tmp_path / "cart.xml").write_text(CART)
    words = ["export", "c", str(tmp_path / "made"), *options.split()]
    assert main([*words, "--urdf", str(tmp_path / "cart.xml")]) == 0
    assert ("rail has no velocity limit; its converter" in capsys.readouterr().err) is named
