"""Results as a file, their verification, scores and comparisons."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cranedyn.__main__ import main
from cranedyn.benchmark import evaluate
from cranedyn.benchmark import task as task_module
from cranedyn.benchmark.comparison import benchmark_table, compare, shared_places
from cranedyn.benchmark.entry_process import EntryLimits
from cranedyn.benchmark.entry_source import find_entry
from cranedyn.benchmark.evaluate import USUAL, InstanceResult
from cranedyn.benchmark.result import Result, read_benchmark_result, run_benchmark, verify_result
from cranedyn.benchmark.score import mean_places, score_table, scores, task_score
from cranedyn.benchmark.task import VERSION, CraneTask
from cranedyn.benchmark.validity import VARIANTS, order_table, orders
from cranedyn.errors import CraneError, DataError, OutOfRange
from tests.benchmark.toys import TOY, opened_here, result_of, toy
from tests.next_commands import check_next_commands

ENTRY = """
def towards(briefing):
    if briefing.goal is None:
        return lambda reading: reading.operator
    goal = briefing.goal.q[briefing.crane.layout.drives]
    return lambda reading: 2.0 * (goal - reading.position)

def slowly(briefing):
    make = towards(briefing)
    return lambda reading: 0.7 * make(reading)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with entries."""
    folder = tmp_path_factory.mktemp("benchmark")
    (folder / "mine.py").write_text(ENTRY, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def tasks() -> list[CraneTask]:
    """Two short tasks."""
    return [toy("move"), toy("operator")]


@pytest.fixture(scope="module")
def result(folder: Path, tasks: list[CraneTask]) -> Result:
    """The result of an entry in them."""
    text = f"{folder / 'mine.py'}:towards"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "EntryProcess", opened_here)
        return run_benchmark(tasks, find_entry(text), text, seeds="2026-11-28")


def made(entry: str, instances: list[InstanceResult]) -> Result:
    """A result by hand."""
    names = {instance.task for instance in instances}
    return Result(
        entry=entry,
        source=f"{entry}.py:{entry}",
        files={},
        benchmark=VERSION,
        seeds="public",
        tasks=dict.fromkeys(sorted(names), "digest"),
        variant=USUAL,
        limits=EntryLimits(),
        versions={},
        instances=instances,
    )


# --- files and verification -----------------------------------------------------------------------


def test_a_result_is_read_as_it_was_written(result: Result, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    result.write(file)
    assert read_benchmark_result(file) == result
    content = json.loads(file.read_text(encoding="utf-8"))
    assert content["format"] == "cranedyn benchmark result 2"
    assert {*content["versions"]} >= {"cranedyn", "numpy", "pin", "processor"}


@pytest.mark.parametrize(
    ("key", "value", "sentence"),
    [
        ("format", "other", "is no result of this benchmark"),
        ("instances", None, "no result of this benchmark"),
        ("seeds", 5, "5 is no text"),
        ("tasks", [], "no result of this benchmark"),
    ],
)
def test_a_file_that_is_no_result_is_refused(
    result: Result, tmp_path: Path, key: str, value: object, sentence: str
) -> None:
    file = tmp_path / "result.json"
    result.write(file)
    content = json.loads(file.read_text(encoding="utf-8"))
    file.write_text(json.dumps({**content, key: value}), encoding="utf-8")
    with pytest.raises(DataError, match=sentence):
        read_benchmark_result(file)


def test_a_result_is_verified_and_a_number_that_was_changed_is_found(
    result: Result, tasks: list[CraneTask], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate, "EntryProcess", opened_here)
    same = verify_result(result, tasks)
    assert same.differences == []
    assert same.compared == 6
    assert same.largest == 0.0

    instances = list(result.instances)
    better = {**instances[1].metrics, "settled_s": instances[1].metrics["settled_s"] - 0.1}
    instances[1] = replace(instances[1], metrics=better)
    instances[4] = replace(instances[4], status="declined")
    different = verify_result(replace(result, instances=instances), tasks)
    assert len(different.differences) == 2
    assert different.differences[0].startswith("toy/move 1: settled_s is ")
    assert different.differences[1].startswith("toy/operator 1 failed; the result says")

    # A number that is left out, and an instance that is: as of one that failed.
    without = {name: x for name, x in result.instances[1].metrics.items() if name != "settled_s"}
    fewer = [*result.instances[:1], replace(result.instances[1], metrics=without)]
    fewer += result.instances[2:4]
    assert verify_result(replace(result, instances=fewer), tasks).differences == [
        "toy/operator has the instances 0 to 2; the result has 0.",
        "toy/move 1: there is a settled_s, other than in the result.",
    ]


def test_a_result_of_another_entry_or_other_tasks_is_not_compared(
    result: Result, tasks: list[CraneTask], folder: Path
) -> None:
    changed = folder / "changed.py"
    changed.write_text(ENTRY + "\n", encoding="utf-8")
    with pytest.raises(CraneError, match="is not the file of the result"):
        verify_result(result, tasks, text=f"{changed}:towards")
    with pytest.raises(CraneError, match="toy/operator of the result is not one of this version"):
        verify_result(result, tasks[:1])
    other = replace(result, tasks={**result.tasks, "toy/move": "0"})
    with pytest.raises(CraneError, match="toy/move"):
        verify_result(other, tasks)


# --- scores ---------------------------------------------------------------------------------------


def test_a_score_has_medians_of_what_passed_and_the_worst_of_all() -> None:
    task = replace(toy("move"), least_time=1.0)
    results = [
        result_of(task.name, 0, settled_s=2.0, swing_rad=0.1),
        result_of(task.name, 1, settled_s=4.0, swing_rad=0.2),
        result_of(task.name, 2, status="failed", reason="It swung.", swing_rad=0.5),
    ]
    score = task_score(task, results)
    assert (score.instances, score.failed, score.declined) == (3, 1, False)
    assert score.settled == 3.0
    assert score.share == pytest.approx(1.0 / 3.0)
    assert score.swing == 0.5
    assert math.isinf(score.slowest)
    assert task_score(task, results[:2]).slowest == 4.0


def test_places_are_by_failures_then_by_the_median_and_equal_ones_share_theirs() -> None:
    task = toy("move")

    def scored(*settled: float, failures: int = 0) -> list:
        results = [result_of(task.name, i, settled_s=value) for i, value in enumerate(settled)]
        for i in range(failures):
            results[i] = replace(results[i], status="failed")
        return [task_score(task, results)]

    declined = [task_score(task, [InstanceResult(task.name, 0, "declined", "No.")])]
    places = mean_places(
        {
            "slow": scored(5.0, 5.0),
            "fast": scored(1.0, 3.0),
            "as fast": scored(2.0, 2.0),
            "fails": scored(9.0, 0.1, failures=1),
            "absent": declined,
        }
    )
    assert places == {"fast": 1.5, "as fast": 1.5, "slow": 3.0, "fails": 4.0, "absent": 5.0}


# --- comparison -----------------------------------------------------------------------------------


def test_a_comparison_is_pair_by_pair() -> None:
    """The second is faster by a tenth in each of eight pairs that differ much from each other: the
    interval is a point, and Wilcoxon's exact p-value is 2/2⁸.
    """
    first = [result_of("toy/move", i, settled_s=1.0 + i) for i in range(10)]
    second = [result_of("toy/move", i, settled_s=0.9 * (1.0 + i)) for i in range(10)]
    first[8] = replace(first[8], status="failed")
    second[9] = replace(second[9], status="declined")
    (found,) = compare(made("a", first), made("b", second), [toy("move")])
    assert (found.both, found.only_first, found.only_second, found.neither) == (8, 0, 1, 0)
    assert found.ratio == found.passed_ratio == pytest.approx(0.9)
    # The ninth pair, of which only the second passed, is a ratio of 0 and ranks last.
    assert found.interval == pytest.approx((0.9, 0.9))
    assert found.p == pytest.approx(2.0 / 2.0**9)


def test_an_entry_that_fails_the_hard_instances_does_not_look_better_by_the_easy_ones() -> None:
    """The second is twice as fast in four of ten instances, and fails the other six."""
    first = [result_of("toy/move", i, settled_s=1.0 + i) for i in range(10)]
    second = [result_of("toy/move", i, settled_s=0.5 * (1.0 + i)) for i in range(4)]
    second += [result_of("toy/move", i, status="failed") for i in range(4, 10)]
    (found,) = compare(made("a", first), made("b", second), [toy("move")])
    assert found.passed_ratio == pytest.approx(0.5)
    assert found.ratio == math.inf
    (other,) = compare(made("b", second), made("a", first), [toy("move")])
    assert other.ratio == 0.0
    # With all ten failed, p is that of ten equal signs; which half fails is no matter of chance.
    none = [replace(one, status="failed") for one in second]
    (worst,) = compare(made("a", first), made("b", none), [toy("move")])
    assert (worst.ratio, worst.interval) == (math.inf, (math.inf, math.inf))
    assert worst.p is not None and worst.p < 0.01
    table = benchmark_table([found, worst])
    assert "∞" in table and max(map(len, table.splitlines())) <= 80


def test_loads_that_are_settled_at_once_are_compared_by_a_control_period() -> None:
    first = [result_of("toy/move", i, settled_s=0.0) for i in range(6)]
    second = [result_of("toy/move", i, settled_s=2.0) for i in range(6)]
    (found,) = compare(made("a", first), made("b", second), [toy("move")])
    assert found.ratio == pytest.approx(2.0 / toy("move").period)


def test_entries_share_a_place_unless_the_instances_tell_them_apart() -> None:
    """Of twelve instances, "close" is faster in half of them and slower in the other half."""
    signs = np.resize([1.0, -1.0], 12)
    best = [result_of("toy/move", i, settled_s=1.0 + i) for i in range(12)]
    close = [
        result_of("toy/move", i, settled_s=(1.0 + i) * (1.001 + 0.01 * signs[i])) for i in range(12)
    ]
    slow = [result_of("toy/move", i, settled_s=1.5 * (1.0 + i)) for i in range(12)]
    absent = [InstanceResult("toy/move", i, "declined", "No.") for i in range(12)]
    entries = {
        "absent": made("absent", absent),
        "slow": made("slow", slow),
        "close": made("close", close),
        "best": made("best", best),
    }
    task = replace(toy("move"), count=11)
    assert shared_places(entries, [task]) == {"best": 1, "close": 1, "slow": 3, "absent": 4}
    # Of five instances nothing is told for certain.
    few = {name: replace(one, instances=one.instances[:5]) for name, one in entries.items()}
    assert set(shared_places(few, [task]).values()) == {1}


def test_of_few_pairs_there_is_no_interval_and_of_equal_results_no_difference() -> None:
    few = [result_of("toy/move", i, settled_s=1.0 + i) for i in range(5)]
    (found,) = compare(made("a", few), made("b", few), [toy("move")])
    assert found.ratio == 1.0
    assert found.interval is None
    assert found.p is None
    many = [result_of("toy/move", i, settled_s=1.0 + i) for i in range(6)]
    (found,) = compare(made("a", many), made("b", many), [toy("move")])
    assert (found.interval, found.p) == ((1.0, 1.0), 1.0)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"seeds": "2026-11-28"}, "seeds"),
        ({"benchmark": "v2"}, "version"),
        ({"tasks": {"toy/move": "other"}}, "toy/move differs"),
        ({"tasks": {}}, "no task in common"),
    ],
)
def test_results_of_other_instances_are_not_compared(change: dict, sentence: str) -> None:
    result = made("a", [result_of("toy/move", 0)])
    with pytest.raises(CraneError, match=sentence):
        compare(result, replace(result, **change), [toy("move")])


@pytest.mark.slow
def test_the_order_of_entries_is_computed_under_each_variant(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluate, "EntryProcess", opened_here)
    entries = {name: find_entry(f"{folder / 'mine.py'}:{name}") for name in ("towards", "slowly")}
    found = orders([toy("move")], entries)
    assert [order.variant for order in found] == [*VARIANTS]
    for order in found:
        assert order.tau == pytest.approx(1.0)
        assert order.places == {"towards": 1.0, "slowly": 2.0}
        # Three instances are too few to tell them apart.
        assert order.shared == {"towards": 1, "slowly": 1}
        assert order.reversed_pairs == 0
    assert order_table(found).splitlines()[1].startswith("towards ")
    with pytest.raises(OutOfRange, match="2 or more"):
        orders([toy("move")], {"one": entries["towards"]})


# --- command line ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_entry_is_run_compared_and_verified_from_the_command_line(
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(task_module, "FOLDER", TOY.parent)
    monkeypatch.chdir(tmp_path)

    def printed(*words: str, code: int = 0) -> str:
        assert main(["benchmark", *words]) == code
        text = capsys.readouterr().out
        check_next_commands(text, monkeypatch)
        return text

    assert "toy/path" in printed("list")
    for name in ("towards", "slowly"):
        words = ["--tasks", "move", "--jobs", "1", "-o", f"{name}.json"]
        text = printed("run", f"{folder / 'mine.py'}:{name}", *words)
        assert "3 of 3 instances passed, all of 1 of 1 tasks." in text
    text = printed("compare", "towards.json", "slowly.json", "--figure", "both.png")
    assert "settled" in text
    assert (tmp_path / "both.png").read_bytes().startswith(b"\x89PNG")
    assert "same: 2 of 3 instances" in printed(
        "verify", "slowly.json", "--sample", "2", "--jobs", "1"
    )

    content = json.loads((tmp_path / "slowly.json").read_text(encoding="utf-8"))
    content["instances"][1]["metrics"]["swing_rad"] *= 0.5
    (tmp_path / "slowly.json").write_text(json.dumps(content), encoding="utf-8")
    assert "toy/move 1: swing_rad" in printed("verify", "slowly.json", "--jobs", "1", code=1)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run mpc_goal --seeds tomorrow", "seeds is tomorrow"),
        ("run mpc_goal --tasks towr", "the nearest is tower"),
        ("run mpc_goal --seconds 0", "--seconds is 0"),
        ("compare a.json", "2 or more"),
        ("verify none.json", "Cannot read none.json"),
        ("validity mpc_goal --tasks inteco/move", "2 or more, which have an order"),
    ],
)
def test_wrong_arguments_are_refused_in_a_sentence(
    words: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", *words.split()]) == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_every_score_of_a_result_is_in_its_table(result: Result, tasks: list[CraneTask]) -> None:
    found = scores(result, tasks)
    assert [score.task for score in found] == ["toy/move", "toy/operator"]
    table = score_table(found).splitlines()
    assert [line.split()[0] for line in table[2:]] == ["toy/move", "toy/operator"]
    assert max(map(len, table)) <= 80
