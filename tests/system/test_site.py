"""The documentation site: built by one command, without a link that leads nowhere, every page of
docs/ in it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import ROOT

pytestmark = pytest.mark.slow
pytest.importorskip(
    "mkdocstrings_handlers.python",
    reason="the extra docs is not installed: pip install 'cranedyn[docs]'",
)


def built(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The site made into a folder."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    return subprocess.run(
        [*command, *words],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        check=False,
        timeout=300,
    )


def test_the_site_is_built_without_a_warning_and_has_every_page_and_function(
    tmp_path: Path,
) -> None:
    done = built(tmp_path / "site")
    assert done.returncode == 0, done.stderr[-2000:]
    for page in (ROOT / "docs").glob("**/*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix("")
        there = tmp_path / "site" / ("index.html" if name.name == "index" else f"{name}/index.html")
        assert there.exists()
    api = (tmp_path / "site" / "api" / "api" / "index.html").read_text(encoding="utf-8")
    for name in ("load_crane", "simulate", "simulate_batch", "Trajectory", "State", "CraneError"):
        assert re.search(rf'id="cranedyn\.[\w.]*{name}"', api), name


def test_a_link_that_leads_nowhere_fails(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[lost](nowhere.md)\n", encoding="utf-8")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = text[: text.index("nav:")].replace("docs_dir: docs", f"docs_dir: {tmp_path / 'docs'}")
    shutil.copy(ROOT / "mkdocs.yml", tmp_path / "mkdocs.yml")
    (tmp_path / "mkdocs.yml").write_text(text, encoding="utf-8")
    done = built(tmp_path / "site", "--config-file", str(tmp_path / "mkdocs.yml"))
    assert done.returncode != 0
    assert "nowhere.md" in done.stderr
