"""What docs/promises.md promises is held by tests that are there."""

from __future__ import annotations

import re

import pytest

from tests.helpers import ROOT
from tests.system.fuzz.generators import GENERATORS

PAGE = (ROOT / "docs" / "promises.md").read_text(encoding="utf-8")
ROWS = [
    line
    for line in PAGE.splitlines()
    if line.startswith("| ") and not line.startswith(("| promise", "| ---"))
]
NAMED = re.compile(r"`(?P<file>tests/[\w/]+\.py)::(?P<name>test_\w+)`")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[2:50])
def test_every_promise_names_a_test(row: str) -> None:
    assert NAMED.search(row)


@pytest.mark.parametrize(
    ("file", "name"), sorted({(one["file"], one["name"]) for one in NAMED.finditer(PAGE)})
)
def test_every_test_that_is_named_is_there(file: str, name: str) -> None:
    assert re.search(rf"^def {name}\(", (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)


def test_no_promise_waits_for_its_test() -> None:
    assert "TODO" not in PAGE


def test_the_kinds_of_input_that_the_page_names_are_there() -> None:
    for name in ("line a1", "api batch", "file sweep", "signals"):
        assert name in GENERATORS and f"`{name}`" in PAGE
