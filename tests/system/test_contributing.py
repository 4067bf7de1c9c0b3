"""What CONTRIBUTING.md tells a newcomer to write runs as it stands there."""

from __future__ import annotations

import re

import pytest

from tests.helpers import ROOT


@pytest.mark.slow
def test_the_code_of_the_page_runs_from_its_first_line_to_its_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(ROOT)
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.S)
    scope: dict[str, object] = {"__name__": "contributing"}
    for block in blocks:
        exec(compile(block, "CONTRIBUTING.md", "exec", dont_inherit=True), scope)
    assert len(blocks) == 9
