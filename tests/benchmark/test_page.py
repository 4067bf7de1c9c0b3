"""The page of the benchmark: its controller does what the page says."""

from __future__ import annotations

from cranedyn.benchmark.baselines import NAMES
from cranedyn.benchmark.evaluate import run_instance
from cranedyn.benchmark.task import KINDS, all_tasks
from tests.benchmark.toys import PAGE, InThisProcess, page_controller, toy_instance


def test_the_controller_of_the_page_passes_and_damps_the_swing() -> None:
    process = InThisProcess(page_controller())
    for kind in ("move", "path", "wind", "operator"):
        result = run_instance(toy_instance(kind), process)  # type: ignore[arg-type]
        # Three seconds are too short for the load to settle behind a path or an operator.
        assert result.metrics, result.reason
        assert "swung" not in result.reason
    assert run_instance(toy_instance("move"), process).status == "passed"  # type: ignore[arg-type]


def test_the_page_counts_and_names_what_there_is() -> None:
    assert f"lists {len(all_tasks())} tasks and {len(NAMES)} baselines" in PAGE
    for kind in KINDS:
        assert f"| `{kind}` |" in PAGE
    for crane in {task.crane_name for task in all_tasks()}:
        assert f"`{crane}`" in PAGE
    for name in NAMES:
        assert f"`{name}`" in PAGE
