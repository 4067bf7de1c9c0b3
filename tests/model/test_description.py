"""From xacro to a plain URDF: arguments checked, comments gone, and never a silent guess."""

from __future__ import annotations

import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.dom import minidom

import pytest
import xacro

from cranedyn.__main__ import main
from cranedyn.data import kept_files
from cranedyn.errors import DataError, ModelError, OutOfRange, UnknownName
from cranedyn.model import description
from cranedyn.model.description import XACRO, arguments, describe
from cranedyn.model.load import load_crane
from cranedyn.model.options import parse_values
from tests.helpers import files, turned

SMALL = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="size" default="2.0"/>  <!-- [m] > 0: how big -->
  <xacro:arg name="word" default="w"/>
  <link name="$(arg word)">
    <visual><geometry><sphere radius="$(arg size)"/></geometry></visual>
  </link>
  <!-- colon: space -->
  <link name="last"><!-- another: one --></link>
</robot>
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    path = tmp_path / "small.xacro"
    path.write_text(SMALL)
    return path


@pytest.fixture(scope="module")
def urdf() -> str:
    return describe()


def test_every_argument_is_documented_with_unit_and_range_and_its_default_is_allowed() -> None:
    text = XACRO.read_text()
    found = arguments()
    lowest = {"any": -1e99, ">= 0": 0.0, ">= 0 or inf": 0.0, "> 0": 1e-99, "a whole number >= 1": 1}
    assert list(found) == re.findall(r'<xacro:arg name="(\w+)"', text)
    for name, argument in found.items():
        assert argument.allowed in lowest, name
        assert argument.unit or "whole number" in argument.allowed, name
        assert len(argument.meaning) > 10, name
        low = lowest[argument.allowed]
        other = re.fullmatch(r"\$\(arg (\w+)\)", argument.default)  # the same as another
        assert float(found[other[1]].default if other else argument.default) >= low, name


def test_every_argument_is_used() -> None:
    text = "".join(path.read_text() for path in XACRO.parent.glob("*.xacro"))
    assert [name for name in arguments() if f"$(arg {name})" not in text] == []


def test_the_arguments_of_the_article_are_there_with_its_numbers() -> None:
    published = {
        "payload_mass": 1000,
        "payload_inertia": 400,
        "dummy_mass": 50,
        "dummy_inertia": 50,
        "trolley_mass": 500,
        "slewing_inertia": 1e6,
        "upper_mass": 3000,
        "damp_swing": 1,
        "trolley_min": 2,
        "trolley_max": 22,
        "hoist_min": 3.4,
        "hoist_max": 26.4,
        "swing_limit": 1.5708,
        "mast_height": 25.99,
        "total_height": 33.45,
    }
    assert {name: float(arguments()[name].default) for name in published} == published
    assert "hoist_init" in arguments()


def test_the_urdf_is_plain(urdf: str) -> None:
    assert "<!--" not in urdf
    assert "xacro:" not in urdf
    assert "$" not in urdf
    assert ET.fromstring(urdf).tag == "robot"


@pytest.mark.slow
def test_a_file_of_ours_is_expanded_once_and_again_when_it_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in XACRO.parent.glob("*.xacro"):
        shutil.copy(path, tmp_path)
    own = tmp_path / XACRO.name
    # Another process of this run may have expanded it.
    monkeypatch.setenv(kept_files.VARIABLE, kept_files.OFF)
    expansions = []
    monkeypatch.setattr(description, "XACRO", own)
    honest = description._expand
    monkeypatch.setattr(
        description, "_expand", lambda *given: expansions.append(given) or honest(*given)
    )
    one = describe(own)
    two = describe(own)
    assert one == two
    assert len(expansions) == 1
    old, new = (f'name="payload_mass" default="{mass}"' for mass in (1000.0, 1001.0))
    own.write_text(turned(old, new, own.read_text()))
    assert '<mass value="1000.0"/>' in one
    assert '<mass value="1001.0"/>' in describe(own)


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which files are kept, which is not there yet."""
    folder = tmp_path / "kept"
    monkeypatch.setenv(kept_files.VARIABLE, str(folder))
    return folder


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the file of the tower crane, in the place of that of this project."""
    folder = tmp_path / "urdf"
    folder.mkdir()
    for path in XACRO.parent.glob("*.xacro"):
        shutil.copy(path, folder)
    monkeypatch.setattr(description, "XACRO", folder / XACRO.name)
    return folder / XACRO.name


def without_memory(path: Path, **values: float) -> str:
    """The expansion of a file without visuals, by a process that has expanded nothing yet."""
    description._expand_cached.cache_clear()
    return describe(path, values, visuals=False)


def digests(folder: Path) -> int:
    """Number of the expansions that are kept in a folder."""
    return len([path for path in folder.glob("*") if path.name != "tidied"])


@pytest.mark.slow
def test_an_expansion_is_kept_for_later_processes_wherever_the_files_are(
    own: Path, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = description._expand(str(XACRO), (("visuals", "false"),))
    assert digests(kept) == 0  # it is not that of this project, for this test
    light = without_memory(own, payload_mass=1234.0)
    first = without_memory(own)
    assert light != first == elsewhere
    assert digests(kept) == 2
    monkeypatch.setattr(description, "_expand", None)
    assert without_memory(own) == first
    assert without_memory(own, payload_mass=1234.0) == light


@pytest.mark.slow
def test_another_file_and_another_xacro_are_another_expansion(
    own: Path, kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_memory(own)
    included = own.with_name("heavy_rope.xacro")
    included.write_text(included.read_text() + "\n")
    without_memory(own)
    assert digests(kept) == 2
    parts = description._expander()
    assert any("def process_file" in part for part in parts)
    for i in range(len(parts)):
        other = (*parts[:i], "other", *parts[i + 1 :])
        monkeypatch.setattr(description, "_expander", lambda other=other: other)
        without_memory(own)
    assert digests(kept) == 2 + len(parts)


READS_ELSEWHERE = (
    '<xacro:property name="p" value="$(env HOME)"/>',
    '<xacro:property name="p" value="$(optenv NO_SUCH_NAME none)"/>',
    "<xacro:property name=\"p\" value=\"${xacro.load_yaml('values.yaml')['p']}\"/>",
    '<xacro:include filename="../values.xacro"/>',
    '<xacro:include filename="values.yaml"/>',
    '<xacro:include filename="*.xacro.more"/>',
    '<xacro:include ns="n" filename="heavy_rope.xacro"/>',
)
"""Lines with which a file of this project, changed by somebody, reads what is not known."""


@pytest.mark.slow
@pytest.mark.parametrize("line", READS_ELSEWHERE)
def test_an_expansion_that_depends_on_what_is_not_known_is_not_kept(
    own: Path, kept: Path, line: str
) -> None:
    (own.parent / "values.yaml").write_text("<robot/>" if "include" in line else "p: 1")
    (own.parent.parent / "values.xacro").write_text("<robot/>")
    text = own.read_text()
    own.write_text(turned("</robot>", f"{line}</robot>", text))
    assert not description._read_only_each_other(
        {path.name: path.read_text() for path in own.parent.glob("*.xacro")}
    )
    try:
        without_memory(own)
    finally:
        assert digests(kept) == 0


def test_the_files_of_this_project_read_only_each_other() -> None:
    sources = {path.name: path.read_text() for path in XACRO.parent.glob("*.xacro")}
    assert len(sources) == 6
    assert description._read_only_each_other(sources)


@pytest.mark.slow
def test_an_interruption_in_the_midst_of_an_expansion_does_no_harm_to_the_next(
    urdf: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    remove = minidom.Node.removeChild

    def interrupted(parent: minidom.Node, child: minidom.Node) -> minidom.Node:
        if child is xacro._empty_text_node:
            parent.childNodes.remove(child)
            raise KeyboardInterrupt
        return remove(parent, child)

    # Xacro expands it each time, also where another process of this run has expanded it.
    monkeypatch.setenv(kept_files.VARIABLE, kept_files.OFF)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(minidom.Node, "removeChild", interrupted)
        description._expand_cached.cache_clear()
        describe()
    assert describe() == urdf


def test_a_comment_never_reaches_the_urdf(small: Path) -> None:
    assert "colon: space" in small.read_text()
    for word in ("colon", "another", "<!--"):
        assert word not in describe(small)


def test_every_digit_of_a_value_arrives(small: Path) -> None:
    value = 0.1 + 0.2
    sphere = ET.fromstring(describe(small, {"size": value})).find(".//sphere")
    assert sphere is not None
    assert float(sphere.get("radius", "")) == value


def test_an_unknown_argument_is_refused_and_the_known_are_named() -> None:
    with pytest.raises(UnknownName, match="no argument 'payload_mas'") as caught:
        describe(values={"payload_mas": 1})
    assert caught.value.given == "payload_mas"
    assert caught.value.known == tuple(arguments())
    assert all(name in str(caught.value) for name in arguments())


@pytest.mark.parametrize(
    "value", [0, -1, "nan", float("nan"), float("inf"), "-inf", "heavy", "", None, [1.0]]
)
def test_a_mass_that_is_none_is_refused_with_its_unit_and_range(value: object) -> None:
    sentence = r"payload_mass is .*( kg; allowed is .*> 0|; allowed is a number > 0 \[kg\])"
    with pytest.raises(OutOfRange, match=sentence) as caught:
        describe(values={"payload_mass": value})
    assert (caught.value.name, caught.value.unit) == ("payload_mass", "kg")


@pytest.mark.slow
def test_zero_is_allowed_where_the_comment_says_so(small: Path) -> None:
    assert {n: a.allowed for n, a in arguments().items()}["dummy_mass"] == ">= 0"
    assert '<mass value="0.0"/>' in describe(values={"dummy_mass": 0})


def test_text_is_allowed_where_no_range_is_documented(small: Path) -> None:
    assert '<link name="arm">' in describe(small, {"word": "arm"})
    with pytest.raises(OutOfRange, match="size is 0 m; allowed is > 0"):
        describe(small, {"size": 0})


@pytest.mark.parametrize(
    ("content", "error", "sentence"),
    [
        (None, DataError, "Cannot read .*No such file"),
        ("<robot>", ModelError, "is not XML"),
        (SMALL.replace("$(arg size)", "$(arg sighs)"), ModelError, "cannot be expanded: .*sighs"),
    ],
    ids=["not there", "not XML", "undeclared argument"],
)
def test_a_file_that_is_no_xacro_is_refused(
    tmp_path: Path,
    content: str | None,
    error: type[Exception],
    sentence: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "a.xacro"
    if content is not None:
        path.write_text(content)
    with pytest.raises(error, match=sentence):
        describe(path)
    assert capfd.readouterr() == ("", "")


def test_a_word_without_mark_is_refused() -> None:
    assert parse_values(["a:=1", "b:=x:=y"]) == {"a": "1", "b": "x:=y"}
    assert parse_values(["mesh:=box.json"]) == {"mesh": "box.json"}
    with pytest.raises(DataError, match="'payload_mass=2' is not of the form name:=value"):
        parse_values(["payload_mass=2"])


def test_a_twin_with_a_rope_that_does_not_stretch_gives_its_arguments(tmp_path: Path) -> None:
    file = tmp_path / "twin.json"
    file.write_text('{"crane": {"arguments": {"rope_stiffness": "inf", "payload_mass": 700.5}}}')
    assert parse_values([str(file)]) == {"rope_stiffness": "inf", "payload_mass": "700.5"}


def test_an_argument_visuals_of_a_foreign_file_keeps_its_value(tmp_path: Path) -> None:
    file = tmp_path / "foreign.urdf.xacro"
    file.write_text(
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="crane">'
        '<xacro:arg name="visuals" default="many"/><link name="$(arg visuals)"/></robot>'
    )
    assert '<link name="many"/>' in describe(file, visuals=False)


# --- command line ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_the_joints_and_writes_the_urdf(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    crane = load_crane(payload_mass=2000)
    assert main(["describe", "payload_mass:=2000", "-o", str(tmp_path / "crane.urdf")]) == 0
    assert (tmp_path / "crane.urdf").read_text() == crane.urdf
    assert files(tmp_path) == ["crane.urdf"]
    out, err = capsys.readouterr()
    assert out.startswith(f"{crane}\nWritten to {tmp_path / 'crane.urdf'}.\nNext: ")
    assert err == ""


@pytest.mark.parametrize("name", [None, "overhead_crane"])
def test_the_command_lists_every_argument(
    name: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    file = XACRO if name is None else XACRO.with_name(f"{name}.urdf.xacro")
    chosen = [] if name is None else ["--urdf", str(file)]
    assert main(["describe", "--list", *chosen]) == 0
    shown = capsys.readouterr().out.partition("Next: ")[0]
    listed = [line.split()[0] for line in shown.splitlines()]
    assert listed == list(arguments(file))


@pytest.mark.parametrize(
    "argv",
    [
        ["payload_mas:=1", "-o", "new.urdf"],
        ["payload_mass:=0", "-o", "new.urdf"],
        ["payload_mass:=nan", "-o", "new.urdf"],
        ["payload_mass", "-o", "new.urdf"],
        ["-o", "missing/new.urdf"],
        ["-o", "."],
    ],
    ids=" ".join,
)
def test_bad_input_is_one_sentence_exit_code_2_and_no_file(
    argv: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["describe", *argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r"error: .+\.\n", err)
    assert files(tmp_path) == []
