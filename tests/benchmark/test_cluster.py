"""The benchmark on the workers of a Dask cluster."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from cranedyn.__main__ import main
from cranedyn.benchmark.entry_process import EntryLimits
from cranedyn.benchmark.entry_source import find_entry
from cranedyn.benchmark.evaluate import InstanceResult
from cranedyn.benchmark.result import (
    Result,
    _Alike,
    _evaluate_on_worker,
    read_benchmark_result,
    run_benchmark,
)
from cranedyn.errors import CraneError
from cranedyn.sweep import cluster
from cranedyn.version import __version__
from tests.benchmark.toys import toy
from tests.sweep.test_sweep_dask import dask_cluster, kill_group

pytestmark = [pytest.mark.usefixtures("limited"), pytest.mark.slow]
pytest.importorskip("distributed", reason="the extra dask is not installed")

ENTRY = """
from gains import GAIN


def towards(briefing):
    if briefing.goal is None:
        return lambda reading: reading.operator
    goal = briefing.goal.q[briefing.crane.layout.drives]
    return lambda reading: GAIN * (goal - reading.position)
"""


def without_times(result: Result) -> list[InstanceResult]:
    """What came of the instances, without the processor times of the commands."""
    return [replace(instance, command_us=()) for instance in result.instances]


def test_workers_of_a_cluster_compute_what_this_machine_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.py").write_text(ENTRY, encoding="utf-8")
    (tmp_path / "gains.py").write_text("GAIN = 2.0\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    text = "mine.py:towards"
    tasks = [toy("move"), toy("operator")]
    here = run_benchmark(tasks, find_entry(text), text, seeds="public")
    with dask_cluster(tmp_path) as (address, (_, *workers)):
        # The workers run in another folder: the file of the entry is sent as a whole path.
        there = run_benchmark(tasks, find_entry(text), text, seeds="public", scheduler=address)
        assert without_times(there) == without_times(here)
        assert (there.source, there.files) == (text, here.files)
        assert [*there.files] == ["mine.py", "gains.py"]

        words = ["benchmark", "run", text, "--tasks", "inteco/operator", "--output", "far.json"]
        assert main([*words, "--scheduler", address]) == 0
        verify = ["benchmark", "verify", "far.json", "--sample", "2"]
        assert main([*verify, "--scheduler", address]) == 0
        assert "same: 2 of 5 instances computed again" in capsys.readouterr().out
        assert read_benchmark_result("far.json").source == text

        for worker in workers:
            kill_group(worker)
        monkeypatch.setattr(cluster, "WORKER_TIMEOUT", 1)
        with pytest.raises(CraneError, match=f"{address} has no worker; start some with: dask wor"):
            run_benchmark(tasks, find_entry(text), text, seeds="public", scheduler=address)


def test_what_a_cluster_cannot_do_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["benchmark", "run", "full_lqr", "--tasks", "inteco/move", "--scheduler"]
    assert main([*words, "tcp://127.0.0.1:1", "--jobs", "2"]) == 2
    assert "--jobs has no effect beside --scheduler; give one only." in capsys.readouterr().err
    assert main([*words[:-1], "--tls", "a", "b", "c"]) == 2
    assert "--tls has no effect without --scheduler; give its" in capsys.readouterr().err
    assert main([*words, "tls://127.0.0.1:1", "--tls", "a.pem", "b.pem", "c.pem"]) == 2
    assert "Cannot read a.pem: there is no such file." in capsys.readouterr().err
    assert main([*words, "tcp://127.0.0.1:1"]) == 2
    assert "No Dask scheduler answers at tcp://127.0.0.1:1" in capsys.readouterr().err
    with pytest.raises(CraneError, match="is reached from this machine only; leave out --sched"):
        find_entry("opc.tcp://127.0.0.1:4840").absolute()


@pytest.mark.parametrize(
    ("named", "whole"),
    [
        ("a/mine.py:towards", "{}/a/mine.py:towards"),
        ("opcua:a/mine.py", "opcua:{}/a/mine.py"),
        ("./a/mine.onnx", "{}/a/mine.onnx"),
    ],
)
def test_a_file_is_sent_with_its_whole_path(
    named: str, whole: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a").mkdir()
    for name in ("mine.py", "mine.onnx"):
        (tmp_path / "a" / name).touch()
    monkeypatch.chdir(tmp_path)
    sent = find_entry(named).absolute()
    assert sent.source == whole.format(tmp_path)
    assert sent.file is not None and sent.file.is_absolute() and sent.name == find_entry(named).name


@pytest.mark.parametrize(
    ("here", "sentence"),
    [
        (_Alike("9.9", {}), f"has cranedyn {re.escape(__version__)}; needed is 9.9"),
        (_Alike(__version__, {"mine.py": "0"}), "or another one than the machine that asks"),
    ],
    ids=["version", "entry"],
)
def test_a_worker_that_is_not_like_this_machine_fails_no_entry(
    here: _Alike, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(ENTRY, encoding="utf-8")
    source = find_entry(f"{tmp_path / 'mine.py'}:towards")
    with pytest.raises(CraneError, match=sentence):
        _evaluate_on_worker(here, source, EntryLimits(), toy("move"), {"seeds": "public"})
    (tmp_path / "mine.py").unlink()
    with pytest.raises(CraneError, match=r"has no|needed is"):
        _evaluate_on_worker(here, source, EntryLimits(), toy("move"), {"seeds": "public"})
