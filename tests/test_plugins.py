"""Engines, exporters and experiments of another package are found as ours are."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from cranedyn import plugins
from cranedyn.errors import CraneError, UnknownName
from tests.helpers import ROOT, python

PAGE = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PACKAGE = {
    "lab_export.py": PAGE.partition("## An exporter")[2].split("```")[1].removeprefix("python\n"),
    "lab_sway.py": '''
"""Sway of a lab crane."""


def main(argv):
    print("sways", argv)
    return 1
''',
    "lab_engine.py": PAGE.partition("## An engine")[2].split("```")[1].removeprefix("python\n"),
    "lab-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n",
    "lab-1.0.dist-info/entry_points.txt": """
[cranedyn.exporters]
table = lab_export
mjcf = lab_export
[cranedyn.experiments]
sway = lab_sway
gone = lab_gone
[cranedyn.engines]
counted = lab_engine
""",
}


@pytest.fixture
def lab(tmp_path: Path) -> dict[str, str]:
    """The environment of a Python in which another package is installed."""
    for name, text in PACKAGE.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    paths = [str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def cranedyn(lab: dict[str, str], *words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "cranedyn", *map(str, words)]
    return subprocess.run(command, env=lab, capture_output=True, text=True, check=False)


def test_our_plugins_are_those_that_the_metadata_declare(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in ("engine", "exporter", "experiment", "command"):
        declared = plugins._own.__wrapped__(kind)
        assert plugins._own_declarations() is not None
        with monkeypatch.context() as patched:
            patched.setattr(plugins, "_own_declarations", lambda: None)
            assert list(plugins._own.__wrapped__(kind).items()) == list(declared.items())
    assert set(plugins._own.__wrapped__("engine")) == {"compiled", "pinocchio"}


def test_without_metadata_in_a_folder_python_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [str(tmp_path), str(tmp_path / "archive.zip"), *sys.path])
    find = plugins._own_declarations.__wrapped__
    usual = find()
    (tmp_path / "cranedyn-extras-1.0.dist-info").mkdir()  # another package
    assert find() == usual
    (tmp_path / "cranedyn-0.1.dist-info").mkdir()
    assert find() is None
    text = "# ours\n[cranedyn.engines]\nodd =  a.module : thing \n\n[other]\nname=value\n"
    (tmp_path / "cranedyn-0.1.dist-info" / "entry_points.txt").write_text(text)
    assert find() == {"cranedyn.engines": {"odd": "a.module:thing"}, "other": {"name": "value"}}


@pytest.mark.slow
def test_an_experiment_of_another_package_is_listed_and_run(lab: dict[str, str]) -> None:
    lines = cranedyn(lab, "list").stdout.partition("Next: ")[0].splitlines()
    assert [line.split() for line in lines[-3:]] == [
        ["Other", "packages"],
        ["gone", "cannot", "be", "loaded"],
        ["sway", "Sway", "of", "a", "lab", "crane."],
    ]
    run = cranedyn(lab, "run", "sway", "--length", "3")
    assert (run.returncode, run.stdout) == (1, "sways ['--length', '3']\n")
    gone = cranedyn(lab, "run", "gone")
    assert gone.returncode == 2
    assert gone.stderr.startswith("error: The experiment gone (lab_gone) cannot be loaded: No mod")


@pytest.mark.slow
def test_an_exporter_of_another_package_writes_what_it_says_and_replaces_none_of_ours(
    lab: dict[str, str], tmp_path: Path
) -> None:
    help_text = " ".join(cranedyn(lab, "export", "--help").stdout.split())
    assert "table Joint table: a CSV file with a row for each joint." in help_text
    words = ("--delimiter", ";", "--set", "payload_mass:=700")
    written = cranedyn(lab, "export", "table", tmp_path / "joints.csv", *words)
    assert (written.returncode, written.stderr) == (0, "")
    rows = (tmp_path / "joints.csv").read_text().splitlines()
    assert len(rows) == 6
    assert rows[-1].startswith("hoist_joint;")
    assert cranedyn(lab, "export", "mjcf", tmp_path / "crane.xml").returncode == 0
    assert "<mujoco" in (tmp_path / "crane.xml").read_text()


BROKEN = {
    "syntax": ("def (:", "SyntaxError"),
    "nul": ("a = 1\0", "SyntaxError: source code"),
    "raises": ('raise ValueError("no")', "ValueError: no"),
    "exits": ("import sys; sys.exit(7)", "SystemExit: 7"),
    "without_target": ("def run(options): ...\ndef add_arguments(parser): ...", "module 'broken"),
    "other_signature": (
        "TARGET = 'FILE'\ndef run(options): ...\ndef add_arguments(): ...",
        "its add_arguments is no function of (parser)",
    ),
    "other_next_commands": (
        "TARGET = 'FILE'\ndef run(options): ...\ndef add_arguments(parser): ...\n"
        "def next_commands(): ...",
        "its next_commands is no function of (options)",
    ),
    "percent": ('"""Takes 100 %(s) of it."""\nraise OSError', "OSError"),
}
"""Modules of exporters that cannot be used, and why they are refused."""


@pytest.mark.slow
def test_a_broken_exporter_of_another_package_takes_no_other_with_it(
    lab: dict[str, str], tmp_path: Path
) -> None:
    entries = ["[cranedyn.exporters]", "deep = broken_package.module", "odd = no module at all"]
    for name, (text, _) in BROKEN.items():
        (tmp_path / f"broken_{name}.py").write_text(text)
        entries.append(f"{name} = broken_{name}")
    (tmp_path / "broken_package").mkdir()
    (tmp_path / "broken_package" / "__init__.py").write_text("1 / 0")
    (tmp_path / "broken_package" / "module.py").write_text('"""A module."""')
    (tmp_path / "lab-1.0.dist-info" / "entry_points.txt").write_text("\n".join(entries))
    listed = cranedyn(lab, "export", "--help")
    assert listed.returncode == 0
    assert "Takes 100 %(s) of it." in listed.stdout
    assert " ".join(listed.stdout.split()).count("cannot be loaded") == 4
    assert cranedyn(lab, "export", "mjcf", tmp_path / "crane.xml").returncode == 0
    reasons = {name: reason for name, (_, reason) in BROKEN.items()}
    for name, reason in {**reasons, "deep": "ZeroDivisionError", "odd": ""}.items():
        refused = cranedyn(lab, "export", name, tmp_path / "x")
        assert refused.returncode == 2, name
        assert refused.stderr.startswith(f"error: The exporter {name} (")
        assert f") cannot be loaded: {reason}" in refused.stderr
        assert refused.stderr.count("\n") == 1


@pytest.mark.slow
def test_an_engine_of_another_package_carries_out_a_run(lab: dict[str, str]) -> None:
    script = (
        "import cranedyn as cd; from cranedyn.controllers import hold_controller; "
        "c = cd.load_crane(); cd.simulate(c, hold_controller(c), duration=0.01, engine='counted')"
    )
    run = subprocess.run(
        [sys.executable, "-c", script], env=lab, capture_output=True, text=True, check=True
    )
    assert run.stdout == "3 calls in 2 periods\n"


@pytest.mark.slow
def test_entry_points_are_read_only_where_a_plugin_is_asked_for() -> None:
    script = (
        "import importlib.metadata as m; m.entry_points = None\n"
        "import cranedyn as cd; from cranedyn.controllers import hold_controller\n"
        "c = cd.load_crane(); cd.simulate(c, hold_controller(c), duration=0.01)"
    )
    assert python(script).returncode == 0


@pytest.mark.slow
def test_every_plugin_of_ours_can_be_loaded_and_has_a_description() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    kinds: tuple[plugins.Kind, ...] = ("engine", "exporter", "experiment")
    for kind in kinds:
        declared = project["entry-points"][f"cranedyn.{kind}s"]
        assert plugins.names(kind)[: len(declared)] == sorted(declared)
        assert all(plugins.description(kind, name).endswith(".") for name in declared)
    assert all(plugins.load("exporter", name).TARGET for name in plugins.names("exporter"))
    assert all(callable(plugins.load("experiment", name).main) for name in declared)


def test_a_plugin_that_does_not_exist_is_refused_by_name() -> None:
    with pytest.raises(UnknownName, match="There is no exporter 'unity'; there are c, fmu, gazebo"):
        plugins.load("exporter", "unity")
    with pytest.raises(
        UnknownName, match=r"new in pyproject.toml is found after .* pip install -e"
    ):
        plugins.load("experiment", "mine")
    assert issubclass(UnknownName, CraneError)
