"""Every promise of docs/promises.md names a test that exists."""

from __future__ import annotations

import re

import pytest

from tests.helpers import ROOT

PAGE = (ROOT / "docs" / "promises.md").read_text(encoding="utf-8")
ROWS = [line for line in PAGE.splitlines() if re.match(r"\| (?!promise|---)", line)]
NAMED = re.compile(r"`(?P<file>tests/[\w/]+\.py)::(?P<name>test_\w+)`")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[2:50])
def test_every_promise_names_tests_that_exist(row: str) -> None:
    tests = list(NAMED.finditer(row))
    assert tests
    for test in tests:
        source = (ROOT / test["file"]).read_text(encoding="utf-8")
        assert re.search(rf"^def {test['name']}\(", source, re.MULTILINE), test[0]


def test_the_page_has_promises() -> None:
    assert len(ROWS) > 10
