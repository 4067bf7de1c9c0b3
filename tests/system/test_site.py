"""The documentation site: built by one command, without a link that leads nowhere, every page of
docs/ in it.
"""

from __future__ import annotations

import json
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


SEARCHED = {
    "howto/install": "installation, python",
    "howto/linearize": "linearize, matlab, python-control, margins",
    "howto/fmi": "simulink, fmi, fmu",
    "howto/controller_code": "plc, structured text, microcontroller",
    "howto/gazebo": "gazebo",
    "howto/ros2": "ros 2, ros2_control, gz sim, humble, rviz, colcon",
    "howto/mujoco": "mujoco",
    "howto/mcap": "rosbag, foxglove, joint_states",
    "howto/crane": "xacro, double pendulum",
    "howto/urdf": "urdf, xacro, outriggers, rep 103, armature",
    "howto/my_tower_crane": "data sheet, potain, ballast, reeving",
    "howto/plan_lift": "ifc, dwg, keep-out zone, building site",
    "howto/several_cranes": "anti-collision, anemometer",
    "tutorial/own_crane": "urdf",
    "howto/reference": "input shaping, anti-sway, joystick",
    "howto/wind": "wind, gust",
    "howto/judge_lift": "load chart, capacity chart, wind limit, outriggers, method statement",
    "howto/compare_lifts": "compare lifts, places of the crane",
    "howto/compare_controllers": "anti-sway, swing damping",
    "howto/commission": "plc, opc ua",
    "howto/view": "rerun",
    "howto/read_csv": "csv",
    "howto/sweep": "cluster, dask",
    "howto/train_policy": "reinforcement learning, stable-baselines3",
    "api/columns": "parquet",
    "concepts/model": "pendulum, damping, trolley, hoist, slewing, payload, energy",
    "concepts/control": "lqr, mpc, kalman filter, pid",
    "concepts/planning": "certificate",
    "concepts/engine": "gpu",
}
"""Words that people search for, by the page that answers."""


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


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site, built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    done = built(folder)
    assert done.returncode == 0, done.stderr[-2000:]
    return folder


def test_the_site_has_every_page_and_function(site: Path) -> None:
    for page in (ROOT / "docs").glob("**/*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix("")
        assert (site / ("index.html" if name.name == "index" else f"{name}/index.html")).exists()
    api = (site / "api" / "api" / "index.html").read_text(encoding="utf-8")
    for name in ("load_crane", "simulate", "simulate_batch", "Trajectory", "State", "CraneError"):
        assert re.search(rf'id="cranedyn\.[\w.]*{name}"', api), name


@pytest.mark.parametrize(
    ("page", "word"),
    [(page, word) for page, words in SEARCHED.items() for word in words.split(", ")],
)
def test_search_finds_what_people_look_for(page: str, word: str, site: Path) -> None:
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    sections = [
        f"{entry['title']} {entry['text']}".lower()
        for entry in index["docs"]
        if entry["location"].startswith(f"{page}/")
    ]
    assert any(re.search(rf"\b{re.escape(word)}", section) for section in sections)


def test_pages_for_readers_stand_before_the_reference_in_a_search(site: Path) -> None:
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    for entry in index["docs"]:
        is_reference = entry["location"].startswith(("api/", "README.ja"))
        assert (entry.get("boost", 1.0) < 1.0) == is_reference, entry["location"]
    # The name of a topic is found inside of "/joint_states".
    assert re.split(index["config"]["separator"], "/joint_states")[-1] == "joint_states"


def test_a_link_that_leads_nowhere_fails(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[lost](nowhere.md)\n", encoding="utf-8")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = text[: text.index("nav:")].replace("docs_dir: docs", f"docs_dir: {tmp_path / 'docs'}")
    text = text.replace("docs/search_rank.py", str(ROOT / "docs" / "search_rank.py"))
    shutil.copy(ROOT / "mkdocs.yml", tmp_path / "mkdocs.yml")
    (tmp_path / "mkdocs.yml").write_text(text, encoding="utf-8")
    done = built(tmp_path / "site", "--config-file", str(tmp_path / "mkdocs.yml"))
    assert done.returncode != 0
    assert "nowhere.md" in done.stderr
