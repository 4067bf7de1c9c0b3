"""Results of an entry as one file: run all instances, write, read and verify them.

A result has what is needed to compute it again: the digests of the tasks and of the entry's files,
the name of the seeds, and versions. Whoever has the files of the entry can verify it.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import platform
import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Future,
    ProcessPoolExecutor,
    as_completed,
    wait,
)
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version as installed_version
from multiprocessing.util import Finalize
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cranedyn.benchmark.entry_files import add_digests, changed_files
from cranedyn.benchmark.entry_kinds import kind_of
from cranedyn.benchmark.entry_process import EntryLimits
from cranedyn.benchmark.entry_source import EntrySource, find_entry
from cranedyn.benchmark.evaluate import USUAL, Evaluator, InstanceResult, TaskEvaluation, Variant
from cranedyn.benchmark.task import VERSION, CraneTask, check_seeds
from cranedyn.checks import number, worker_count
from cranedyn.data.files import parse_json, read_text, write_text
from cranedyn.errors import CraneError, DataError, quoted
from cranedyn.sweep.cluster import Cluster
from cranedyn.sweep.workers import end_with_parent, ignore_sigint
from cranedyn.version import __version__

if TYPE_CHECKING:
    from distributed.security import Security

FORMAT = "cranedyn benchmark result 2"
"""First entry of a file of results."""

RELATIVE_TOLERANCE = 1e-3
"""Largest relative difference of a verified metric. On the same processor with the same packages
there is none. Elsewhere the last bit of a gain may differ; then a reading or a command may be
rounded to the next step of its resolution, which is about a thousandth of a motion."""

SETTLING_TOLERANCE_PERIODS = 2
"""Largest difference of a verified settling time, in control periods: it is counted in whole ones,
and such a rounding may move the crossing of the tolerance by one to either side."""

_CLUSTER_CHECK_INTERVAL = 1.0
"""Time after which a cluster on which nothing is done is asked whether it has workers [s]."""

_PACKAGES = ("numpy", "scipy", "pin", "llvmlite")
"""Packages whose versions a result names, whatever the kind of the entry."""


@dataclass(frozen=True)
class Result:
    """Results of an entry.

    Attributes:
        entry: Name of the entry in tables.
        source: How it was named on the command line.
        files: SHA-256 of its files by their paths in its folder, that of the entry itself first,
            see `cranedyn.benchmark.entry_files`; empty for a program that the user started.
        benchmark: Version of the tasks.
        seeds: Name of the seeds.
        tasks: Digest of each task that was run, by name.
        variant: How the runs were computed.
        limits: What the entry might use.
        versions: Versions of cranedyn, Python and packages, and the processor.
        instances: Results of the instances.
    """

    entry: str
    source: str
    files: Mapping[str, str]
    benchmark: str
    seeds: str
    tasks: Mapping[str, str]
    variant: Variant
    limits: EntryLimits
    versions: Mapping[str, str]
    instances: Sequence[InstanceResult]

    def of_task(self, name: str) -> list[InstanceResult]:
        """Return the results of the instances of a task."""
        return [result for result in self.instances if result.task == name]

    def write(self, file: Path) -> None:
        """Write the result as JSON, whole or not at all."""
        content = {"format": FORMAT, **asdict(self)}
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        write_text(file, text)


def run_benchmark(
    tasks: Sequence[CraneTask],
    source: EntrySource,
    text: str,
    *,
    seeds: str,
    limits: EntryLimits | None = None,
    variant: Variant = USUAL,
    jobs: int | None = 1,
    scheduler: str | None = None,
    security: Security | None = None,
    indices: Mapping[str, Sequence[int]] | None = None,
    progress: Callable[[int], object] | None = None,
) -> Result:
    """Run an entry in all instances of tasks.

    Args:
        tasks: The tasks.
        source: The entry.
        text: How the entry was named.
        seeds: Name of the seeds.
        limits: What the entry may use in an instance; None for the usual limits.
        variant: How the runs are computed.
        jobs: Processes that share the tasks; None for one for each processor. A scheduler is
            instead of them.
        scheduler: Address of a Dask scheduler whose workers share the tasks instead. They have this
            version of cranedyn and the files of the entry, both at the same paths as this machine.
            The scheduler, and every worker behind it, can run code in this program.
        security: Certificates for a scheduler whose address begins with ``tls://``, see
            `cranedyn.sweep.cluster.tls`.
        indices: Indices of the instances to run by the name of the task; None for all.
        progress: Function that is told how many tasks are done.

    Raises:
        OutOfRange: If the seeds are no name of seeds, or the number of jobs is out of range.
        CraneError: If a file of the entry changed meanwhile, the scheduler does not answer or has
            no worker, or a worker has another version of cranedyn or of the entry.
    """
    check_seeds(seeds)
    limits = EntryLimits() if limits is None else limits
    count = min(worker_count("jobs", jobs), max(len(tasks), 1))
    if source.max_jobs is not None:
        count = min(count, source.max_jobs)
    files = source.files
    by_task = {}
    arguments = _arguments_by_task(tasks, seeds, variant, indices)
    if scheduler is None:
        evaluations = _evaluations(tasks, source, limits, count, arguments)
    else:
        sent = source.absolute()
        cluster = Cluster(scheduler, security)
        evaluations = _evaluations_on_cluster(tasks, sent, limits, cluster, arguments)
    for done, (task, evaluation) in enumerate(evaluations, 1):
        by_task[task.name] = evaluation
        if progress is not None:
            progress(done)
    instances: list[InstanceResult] = []
    for task in tasks:
        instances += by_task[task.name].results
    _add_files(files, list(by_task.values()))
    return Result(
        entry=source.name,
        source=text,
        files=files,
        benchmark=VERSION,
        seeds=seeds,
        tasks={task.name: task.digest for task in tasks},
        variant=variant,
        limits=limits,
        versions=_versions(source),
        instances=instances,
    )


def _arguments_by_task(
    tasks: Sequence[CraneTask],
    seeds: str,
    variant: Variant,
    indices: Mapping[str, Sequence[int]] | None,
) -> dict[str, dict[str, Any]]:
    """Return the arguments of `Evaluator.evaluate` by the name of the task, see `run_benchmark`."""
    by_name = {}
    for task in tasks:
        chosen = None if indices is None else indices[task.name]
        by_name[task.name] = {"seeds": seeds, "indices": chosen, "variant": variant}
    return by_name


def _evaluations(
    tasks: Sequence[CraneTask],
    source: EntrySource,
    limits: EntryLimits,
    count: int,
    arguments: Mapping[str, Mapping[str, Any]],
) -> Iterator[tuple[CraneTask, TaskEvaluation]]:
    """Yield what came of each task as soon as it is done, by so many processes, see
    `run_benchmark`.
    """
    if count == 1:
        with closing(Evaluator(source, limits)) as evaluator:
            for task in tasks:
                yield task, evaluator.evaluate(task, **arguments[task.name])
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, _start_worker, (source, limits)) as pool:
        futures: dict[Future[TaskEvaluation], CraneTask] = {}
        # Submitting starts processes, which must not end at an interruption by themselves.
        with ignore_sigint():
            for task in tasks:
                futures[pool.submit(_evaluate, task, **arguments[task.name])] = task
        for future in as_completed(futures):
            yield futures[future], future.result()


def _evaluations_on_cluster(
    tasks: Sequence[CraneTask],
    source: EntrySource,
    limits: EntryLimits,
    cluster: Cluster,
    arguments: Mapping[str, Mapping[str, Any]],
) -> Iterator[tuple[CraneTask, TaskEvaluation]]:
    """Yield what came of each task as soon as it is done, by the workers of a cluster.

    Each task has a process of the entry of its own: a worker does not know which task is its last,
    after which such a process had to end.

    Raises:
        CraneError: If the scheduler has no worker or is gone, or a worker is not like this machine.
    """
    here = _Alike(__version__, source.files)
    try:
        send = partial(cluster.submit, _evaluate_on_worker, here, source, limits)
        futures = {send(task, arguments[task.name]): task for task in tasks}
        waiting = set(futures)
        while waiting:
            done, waiting = wait(waiting, _CLUSTER_CHECK_INTERVAL, FIRST_COMPLETED)
            for future in done:
                yield futures[future], future.result()
            if not done:
                cluster.check_workers()
    except CraneError:
        raise
    except Exception as error:
        raise cluster.failure(error) from error
    finally:
        cluster.close()


class _Alike(NamedTuple):
    """In what a worker of a cluster must be like the machine that asks.

    Attributes:
        version: Version of cranedyn.
        files: SHA-256 of the file of the entry by its name, see `EntrySource.files`.
    """

    version: str
    files: Mapping[str, str]


def _evaluate_on_worker(
    here: _Alike,
    source: EntrySource,
    limits: EntryLimits,
    task: CraneTask,
    arguments: Mapping[str, Any],
) -> TaskEvaluation:
    """Return the results in a task, with a process of the entry for this task alone.

    Raises:
        CraneError: If this worker has another version of cranedyn, or not the same entry. Without
            this check the entry would fail where nothing but the worker is wrong.
    """
    node = platform.node()
    if here.version != __version__:
        raise CraneError(
            f"The worker on {node} has cranedyn {__version__}; needed is {here.version}."
        )
    if source.file is not None and not (source.file.is_file() and source.files == here.files):
        raise CraneError(
            f"The worker on {node} has no {source.file}, or another one than the machine that asks."
        )
    with closing(Evaluator(source, limits)) as evaluator:
        return evaluator.evaluate(task, **arguments)


def _add_files(files: dict[str, str], evaluations: Sequence[TaskEvaluation]) -> None:
    """Add the files that an entry has used to that of the entry itself.

    Raises:
        CraneError: If one of them changed meanwhile.
    """
    changed = set[str]()
    for evaluation in evaluations:
        changed |= evaluation.changed | add_digests(files, evaluation.files)
    if changed:
        raise CraneError(
            f"{', '.join(sorted(changed))} of the entry changed while it ran; run it again."
        )


_evaluators: list[Evaluator] = []
"""In a process of `run_benchmark` that shares the tasks with others: what runs the entry there."""


def _start_worker(source: EntrySource, limits: EntryLimits) -> None:
    """Prepare a process for the tasks that it will get: it loads the entry once for all of them."""
    end_with_parent()
    evaluator = Evaluator(source, limits)
    _evaluators.append(evaluator)
    Finalize(evaluator, evaluator.close, exitpriority=0)


def _evaluate(task: CraneTask, **arguments: Any) -> TaskEvaluation:
    """Return the results in a task, in a process of `run_benchmark`."""
    return _evaluators[0].evaluate(task, **arguments)


def _versions(source: EntrySource) -> dict[str, str]:
    """Return the versions that the result of an entry names."""
    versions = {"cranedyn": __version__, "python": platform.python_version()}
    kind = kind_of(source.source)
    for package in (*_PACKAGES, *(() if kind is None else kind.packages)):
        versions[package] = installed_version(package)
    versions["processor"] = f"{platform.system()} {platform.machine()}"
    return versions


# --- reading --------------------------------------------------------------------------------------


def read_benchmark_result(file: str | Path) -> Result:
    """Read a result from its file.

    Raises:
        DataError: If it cannot be read, or is no file of results.
    """
    try:
        content = parse_json(read_text(file))
    except (ValueError, RecursionError) as error:
        raise DataError(f"Cannot read {file}: it is no JSON ({error}).") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise DataError(
            f"{file} is no result of this benchmark, whose files begin with the format {FORMAT!r}; "
            "cranedyn benchmark run writes one."
        )
    try:
        return _parsed(content)
    except (KeyError, TypeError, ValueError, AttributeError, CraneError) as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error)
        raise DataError(f"{file} is no result of this benchmark: {reason}.") from error


def _parsed(content: dict[str, Any]) -> Result:
    """Return a result from what its file holds, or raise one of Python's errors, or a CraneError,
    where something is missing or of another type.
    """
    instances = []
    for entry in content["instances"]:
        status = entry["status"]
        if status not in ("passed", "failed", "declined"):
            raise DataError(f"an instance has the status {quoted(status)}")
        instances.append(
            InstanceResult(
                task=_text(entry["task"]),
                index=int(number("index", entry["index"], allowed=">= 0")),
                status=status,
                reason=_text(entry["reason"]),
                metrics=_metrics(entry["metrics"]),
                command_us=tuple(number("command_us", us) for us in entry["command_us"]),
            )
        )
    variant = content["variant"]
    limits = content["limits"]
    return Result(
        entry=_text(content["entry"]),
        source=_text(content["source"]),
        files={_text(name): _text(digest) for name, digest in content["files"].items()},
        benchmark=_text(content["benchmark"]),
        seeds=_text(content["seeds"]),
        tasks={_text(name): _text(digest) for name, digest in content["tasks"].items()},
        variant=Variant(_text(variant["engine"]), int(variant["substeps"])),
        limits=EntryLimits(float(limits["seconds"]), float(limits["megabytes"])),
        versions={_text(name): _text(value) for name, value in content["versions"].items()},
        instances=instances,
    )


def _metrics(values: Mapping[str, Any]) -> dict[str, float]:
    """Return the metrics of an instance."""
    return {_text(name): number(name, value) for name, value in values.items()}


def _text(value: Any) -> str:
    """Return a text.

    Raises:
        TypeError: If it is none.
    """
    if not isinstance(value, str):
        raise TypeError(f"{quoted(value)} is no text")
    return value


# --- verification ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Verification:
    """A result beside what was computed again.

    Attributes:
        compared: Number of instances that were computed again.
        differences: What differs, a sentence each; empty if nothing does.
        largest: Largest relative difference of a metric.
    """

    compared: int
    differences: Sequence[str]
    largest: float


def verify_result(
    result: Result,
    tasks: Sequence[CraneTask],
    *,
    text: str | None = None,
    trusted: bool = False,
    sample: int | None = None,
    jobs: int | None = 1,
    scheduler: str | None = None,
    security: Security | None = None,
    progress: Callable[[int], object] | None = None,
) -> Verification:
    """Compute instances of a result again and compare them.

    Args:
        result: The result.
        tasks: All tasks of this version.
        text: How the entry is named here; None for how the result names it.
        trusted: Whether a file of the entry may be unpickled, see
            `cranedyn.benchmark.entry_source.find_entry`.
        sample: Number of instances to compute again, drawn by the digest of the result; None for
            all.
        jobs: Processes that share the tasks.
        scheduler: Address of a Dask scheduler, see `run_benchmark`.
        security: Certificates for it.
        progress: Function that is told how many tasks are done.

    Raises:
        CraneError: If the tasks or the entry are not those of the result, so that nothing can be
            compared.
    """
    text = result.source if text is None else text
    source = find_entry(text, trusted=trusted)
    if source.file is not None:
        different = changed_files(result.files, source.file)
        if different:
            raise CraneError(" ".join(different))
    known = {task.name: task for task in tasks}
    for name, digest in result.tasks.items():
        if name not in known or known[name].digest != digest:
            raise CraneError(
                f"The task {quoted(name)} of the result is not one of this version of cranedyn, "
                f"{__version__}; the result is of {result.versions.get('cranedyn', 'no version')}."
            )
    chosen = _sample(result, sample)
    again = run_benchmark(
        [known[name] for name in result.tasks if name in chosen],
        source,
        text,
        seeds=result.seeds,
        limits=result.limits,
        variant=result.variant,
        jobs=jobs,
        scheduler=scheduler,
        security=security,
        indices=chosen,
        progress=progress,
    )
    claimed = {(instance.task, instance.index): instance for instance in result.instances}
    differences = _missing_instances(result, [known[name] for name in result.tasks])
    # Files beside the entry that were not there, or not needed, when the result was made.
    main = "" if source.file is None else source.file.name
    for name in sorted(again.files.keys() - result.files.keys() - {main}):
        differences.append(f"The entry uses {name} here, which the result does not name.")
    largest = 0.0
    for computed in again.instances:
        stated = claimed[computed.task, computed.index]
        period = known[computed.task].period
        found, difference = _differences(stated, computed, period)
        differences += found
        largest = max(largest, difference)
    return Verification(len(again.instances), differences, largest)


def _missing_instances(result: Result, tasks: Sequence[CraneTask]) -> list[str]:
    """Return a sentence for each task whose instances in a result are not all of its own, each
    once. A result without the instances that failed would look better than it is.
    """
    found = []
    for task in tasks:
        indices = sorted(instance.index for instance in result.of_task(task.name))
        if indices != list(range(task.count + 1)):
            found.append(
                f"{task.name} has the instances 0 to {task.count}; the result has "
                f"{', '.join(map(str, indices)) or 'none'}."
            )
    return found


def _sample(result: Result, count: int | None) -> dict[str, list[int]]:
    """Return the indices of instances to compute again by the name of their task."""
    pairs = [(instance.task, instance.index) for instance in result.instances]
    if count is not None and count < len(pairs):
        pairs = random.Random(json.dumps(dict(result.files))).sample(pairs, count)
    indices: dict[str, list[int]] = {}
    for name, index in pairs:
        if name in result.tasks:
            indices.setdefault(name, []).append(index)
    return indices


def _differences(
    stated: InstanceResult, computed: InstanceResult, period: float
) -> tuple[list[str], float]:
    """Return in which numbers an instance differs, a sentence each, and the largest relative
    difference of its metrics.
    """
    name = f"{computed.task} {computed.index}"
    if stated.status != computed.status:
        return [f"{name} {computed.status}; the result says that it {stated.status}."], math.inf
    found = []
    largest = 0.0
    for metric in sorted({*stated.metrics, *computed.metrics}):
        if metric not in stated.metrics or metric not in computed.metrics:
            here = "there is a" if metric in computed.metrics else "there is no"
            found.append(f"{name}: {here} {metric}, other than in the result.")
            largest = math.inf
            continue
        was = stated.metrics[metric]
        now = computed.metrics[metric]
        if was == now:
            continue
        difference = abs(now - was) / max(abs(now), abs(was))
        largest = max(largest, difference)
        allowed = RELATIVE_TOLERANCE * max(abs(now), abs(was))
        if metric == "settled_s":
            allowed = max(allowed, SETTLING_TOLERANCE_PERIODS * period)
        if not abs(now - was) <= allowed:
            found.append(f"{name}: {metric} is {now:.6g}; the result says {was:.6g}.")
    return found, largest
