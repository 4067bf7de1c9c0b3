"""The command line as somebody meets it: help that fits a screen and begins with an example, and
the nearest known name for a name that there is not.
"""

from __future__ import annotations

import importlib
import shlex
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from cranedyn import __main__ as front
from cranedyn import plugins
from cranedyn.command import Parser
from experiments.harness import document

Main = Callable[[Sequence[str]], int]

COMMANDS: dict[str, Main] = {
    "cranedyn": front.main,
    **{f"cranedyn {name}": front.main for name in front.COMMANDS},
    **{f"cranedyn export {name}": front.main for name in plugins.names("exporter")},
    **{
        f"cranedyn run {name}": importlib.import_module(f"experiments.{name}").main
        for name in plugins.names("experiment")
    },
    "python -m experiments.harness.document": document.main,
}
"""Function by how its command line begins."""

each = pytest.mark.parametrize("command", COMMANDS)


class Parsed(BaseException):
    """Arguments were parsed without an error."""


def arguments(line: str, command: str) -> list[str]:
    """Return what the function of a command gets of a command line."""
    return shlex.split(line)[1 if COMMANDS[command] is front.main else 3 :]


def ended(command: str, words: Sequence[str]) -> int:
    """Return the exit code of a command, which may be raised or returned."""
    try:
        return COMMANDS[command](words)
    except SystemExit as end:
        return int(end.code or 0)


def help_of(command: str, capsys: pytest.CaptureFixture[str], option: str = "--help") -> str:
    """Return the help of a command."""
    assert ended(command, [*arguments(command, command), option]) == 0
    return capsys.readouterr().out


@each
def test_help_is_a_screen_that_begins_with_an_example_which_parses(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = help_of(command, capsys).splitlines()
    assert len(lines) < 40
    example = lines[0].removeprefix("example: ")
    assert example != lines[0]
    assert max(map(len, lines)) <= 80
    parse = Parser.parse_args

    def stop(parser: Parser, words: Any = None, space: Any = None) -> None:
        parse(parser, words, space)
        raise Parsed

    monkeypatch.setattr(Parser, "parse_args", stop)
    with pytest.raises(Parsed):
        COMMANDS[command](arguments(example, command))


@each
def test_an_unknown_option_is_answered_with_the_nearest_on_one_line(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    example = help_of(command, capsys).partition("\n")[0].removeprefix("example: ")
    assert ended(command, [*arguments(example, command), "--hepl"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1
    assert "nearest is --help" in error


@pytest.mark.parametrize(
    ("line", "nearest"),
    [
        ("rnu a1", "run"),
        ("run sweeep", "sweep"),
        ("run a1 --gravty 9.8", "--gravity"),
        ("run a1 --engine compild", "compiled"),
        ("run compare --only operater", "operator"),
        ("export mjfc crane.xml", "mjcf"),
        ("export mjcf crane.xml --set payload_mas:=1", "payload_mass"),
        ("describe payload_mas:=1", "payload_mass"),
        ("report --only a11", "a1"),
        ("report --qick", "--quick"),
    ],
)
def test_what_is_not_known_is_answered_with_the_nearest_on_one_line(
    line: str, nearest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended("cranedyn", shlex.split(line)) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: There is no ")
    assert error.count("\n") == 1
    assert f"; the nearest is {nearest}" in error


@pytest.mark.parametrize("line", ["--list foo", "--machines -o crane.urdf"])
def test_describe_refuses_what_its_lists_would_ignore(
    line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended("cranedyn", ["describe", *line.split()]) == 2
    error = f"error: {line.split()[0]} takes no values and no output; leave them out.\n"
    assert capsys.readouterr().err == error


def test_common_options_are_shown_where_all_are_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = "cranedyn run a1"
    assert "--gravity" not in help_of(command, capsys).partition("\n")[2]
    assert {"--gravity", "--out", "--engine"} <= set(help_of(command, capsys, "--help-all").split())


@pytest.mark.slow
def test_the_list_has_every_experiment_once_by_subject(capsys: pytest.CaptureFixture[str]) -> None:
    assert front.main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    named = [line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "]
    assert sorted(named) == sorted(plugins.names("experiment"))
    assert "The article" in lines
    assert max(map(len, lines)) <= 80
