"""Four cranes of other people go from their file to everything by the commands of a page."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from cranedyn.__main__ import main
from tests.helpers import ROOT

for module in ("mujoco", "toppra"):
    pytest.importorskip(module, reason=f"{module}, which the page needs, is not installed")

pytestmark = [pytest.mark.slow, pytest.mark.long]

PAGE = ROOT / "docs" / "howto" / "foreign_cranes.md"


def blocks(language: str) -> str:
    """Return the text of all blocks of the page in a language; "" is that of commands."""
    found = re.findall(r"^```(\w*)\n(.*?)^```", PAGE.read_text("utf-8"), re.S | re.M)
    return "".join(text for of_block, text in found if of_block == language)


def commands() -> list[str]:
    """Return the commands of the page in their order; those that open a window are left out."""
    lines = blocks("").splitlines()
    return [line for line in lines if not line.startswith("cranedyn view")]


def test_every_command_of_the_page_works_and_every_lift_is_certified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A lift that is not certified, or a command that refuses, has another exit code than 0."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    # tests/export/test_page.py plans exercises
    monkeypatch.setattr("cranedyn.export.driving_page.exercises", lambda *_: [])
    lines = commands()
    assert lines.pop(0) == "mkdir -p out"
    (tmp_path / "out").mkdir()
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "cranedyn"
        assert main(words) == 0, line
    assert len([line for line in lines if " run lift " in line]) == 4
    for name in ("gantry", "knuckle_boom", "portal", "jib_crane"):
        assert (tmp_path / "out" / name / "lift.rrd").is_file()


def test_the_sites_of_the_page_enter_what_the_page_quotes() -> None:
    site = (ROOT / "examples/cranes/gantry.toml").read_text("utf-8")
    for line in blocks("toml").splitlines():
        assert line.partition("#")[0].strip() in site
