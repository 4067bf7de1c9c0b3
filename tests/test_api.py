"""The face: what ``import cranedyn`` and the command ``cranedyn`` give."""

from __future__ import annotations

import ast
import importlib
import tomllib
from pathlib import Path

import pytest

import cranedyn as cd
from cranedyn import __main__ as face
from cranedyn import plugins
from experiments import a1
from tests.helpers import ROOT, python

NAMES = {
    "load_crane",
    "simulate",
    "simulate_batch",
    "Crane",
    "State",
    "Setpoint",
    "Trajectory",
    "CraneError",
    "__version__",
}


def test_the_face_gives_its_names_and_they_are_those_of_their_modules() -> None:
    assert NAMES <= set(cd.__all__)
    assert NAMES <= set(dir(cd))
    for name in set(cd.__all__) - {"__version__"}:
        assert getattr(cd, name) is getattr(importlib.import_module(cd._HOMES[name]), name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        cd.nothing  # noqa: B018


def test_type_checkers_see_every_name_of_the_face_where_it_is_imported_from() -> None:
    tree = ast.parse(Path(cd.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == cd._HOMES
    assert (Path(cd.__file__).parent / "py.typed").exists()


@pytest.mark.slow
def test_the_face_imports_what_is_heavy_only_when_it_is_used() -> None:
    heavy = "print(sorted({'numpy', 'pinocchio', 'experiments', 'unittest.mock'} & {*sys.modules}))"
    script = f"import sys, cranedyn; {heavy}; cranedyn.load_crane(); {heavy}"
    assert python(script).stdout == "[]\n['numpy', 'pinocchio']\n"


@pytest.mark.slow
def test_a_first_compiled_step_imports_little() -> None:
    script = (
        "import sys, cranedyn; from cranedyn.controllers import hold_controller\n"
        "crane = cranedyn.load_crane(); controller = hold_controller(crane)\n"
        "cranedyn.simulate(crane, controller, duration=5e-3, engine='compiled')\n"
        "unused = 'numpy.ma numpy.polynomial numpy.random secrets html scipy.linalg'\n"
        "print({*unused.split()} & {*sys.modules})"
    )
    assert python(script).stdout == "set()\n"


def test_every_module_of_the_experiments_with_a_command_line_is_an_entry_point() -> None:
    commands = {
        path.stem
        for path in (ROOT / "experiments").glob("*.py")
        if "\ndef main(" in path.read_text(encoding="utf-8")
    } | {path.parent.name for path in (ROOT / "experiments").glob("*/__main__.py")}
    assert commands - {"catalogue", "report", "snapshot"} == {*plugins.names("experiment")}
    assert {*plugins.names("command")} <= {*face.COMMANDS}


def test_run_hands_all_arguments_to_the_experiment_and_its_code_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = []
    monkeypatch.setattr(a1, "main", lambda argv: given.append(argv) or 1)
    assert face.main(["run", "a1", "--gravity", "9.8", "--out", "there"]) == 1
    assert given == [["--gravity", "9.8", "--out", "there"]]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run a9", "There is no experiment 'a9'"),
        ("run site --minutes nan", "minutes is nan min; allowed is > 0"),
        ("view nothing.rrd --serve", "Cannot read nothing.rrd"),
        ("view nothing.rrd --port 9999", "--port has no effect without --serve"),
        ("fly", "There is no command 'fly'"),
        ("list all", "unrecognized arguments: all"),
    ],
)
def test_what_the_command_refuses_is_a_sentence_and_exit_code_2(
    words: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = face.main(words.split())
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    assert sentence in capsys.readouterr().err.splitlines()[-1]


def test_the_wheel_brings_one_top_level_package_and_a_command() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["packages"] == ["cranedyn"]
    assert wheel["force-include"]["experiments"] == "cranedyn/_bundled/experiments"
    assert project["project"]["scripts"] == {"cranedyn": "cranedyn.__main__:main"}
