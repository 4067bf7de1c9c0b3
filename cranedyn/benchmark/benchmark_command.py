"""The command ``cranedyn benchmark``: list the tasks, run an entry, compare and verify results."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cranedyn.benchmark.entry_process import EntryLimits, check_opens
from cranedyn.benchmark.entry_source import FORMS, find_entry
from cranedyn.benchmark.result import Result, read_benchmark_result, run_benchmark, verify_result
from cranedyn.benchmark.score import score_table, scores, totals
from cranedyn.benchmark.task import PUBLIC, VERSION, all_tasks, check_seeds, select_tasks
from cranedyn.checks import number, whole
from cranedyn.command import FAILED, Parser, command_line, next_lines
from cranedyn.data.files import check_writable
from cranedyn.errors import CraneError
from cranedyn.progress import bar
from cranedyn.sweep.cluster import tls


def add_commands(parser: Parser) -> None:
    """Add the commands of the benchmark to a parser."""
    commands = parser.add_subparsers(required=True, dest="action", metavar="ACTION")
    for name, (configure, example) in _COMMANDS.items():
        text = (configure.__doc__ or "").partition("\n")[0]
        action = commands.add_parser(name, help=text, description=text)
        action.example = example
        configure(action)


def _add_tasks(parser: Parser) -> None:
    """Add the option that selects tasks."""
    parser.add_argument(
        "--tasks",
        nargs="+",
        default=[],
        metavar="TASK",
        help="tasks such as tower/move, cranes such as tower, kinds such as wind; by default all",
    )


def _add_running(parser: Parser) -> None:
    """Add the options of how entries run."""
    usual = EntryLimits()
    _add_jobs(parser)
    text = "processor time that an entry may take for an instance [s]"
    parser.add_argument("--seconds", type=float, default=usual.seconds, metavar="S", help=text)
    text = "memory that it may take [MB]"
    parser.add_argument("--megabytes", type=float, default=usual.megabytes, metavar="M", help=text)
    _add_trust(parser)


def _add_jobs(parser: Parser) -> None:
    """Add the option of how many processes share the tasks."""
    text = "processes that share the tasks; by default one for each processor"
    parser.add_argument("--jobs", type=int, default=None, metavar="N", help=text)


def _add_scheduler(parser: Parser) -> None:
    """Add the option by which a cluster shares the tasks."""
    parser.add_argument(
        "--scheduler",
        metavar="tcp://HOST:PORT",
        help="share the tasks among the workers of this Dask scheduler instead; it and all of them "
        "can run code in this program, so trust it, and have it listen only where you want; they "
        "have the files of the entry at the same paths",
    )
    parser.add_argument(
        "--tls",
        nargs=3,
        metavar=("CA.pem", "CERT.pem", "KEY.pem"),
        help="certificates of those to trust, and certificate and key of this program, for a "
        "scheduler at tls://HOST:PORT",
    )


def _spread(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `run_benchmark` that say who shares the tasks.

    Raises:
        CraneError: If an option has no effect beside the others, or a certificate is not there.
    """
    if options.scheduler is not None and options.jobs is not None:
        raise CraneError("--jobs has no effect beside --scheduler; give one only.")
    if options.scheduler is None and options.tls is not None:
        raise CraneError("--tls has no effect without --scheduler; give its address, too.")
    security = tls(*options.tls) if options.tls else None
    return {"jobs": options.jobs, "scheduler": options.scheduler, "security": security}


def _add_trust(parser: Parser) -> None:
    """Add the option by which a user lets a file be unpickled."""
    text = "unpickle a policy of Stable-Baselines3, which can run any code in its file"
    parser.add_argument("--trust", action="store_true", help=text)


def _limits(options: argparse.Namespace) -> EntryLimits:
    """Return what an entry may use.

    Raises:
        OutOfRange: If a number is not positive.
    """
    return EntryLimits(
        number("--seconds", options.seconds, "s", "> 0"),
        number("--megabytes", options.megabytes, "MB", "> 0"),
    )


_MOST_REASONS = 8
"""Largest number of reasons that are printed; all are in the file of the result."""


# --- list -----------------------------------------------------------------------------------------


def _configure_list(parser: Parser) -> None:
    """List the tasks and the baselines."""
    _add_tasks(parser)
    parser.set_defaults(run=_list)


def _list(options: argparse.Namespace) -> int:
    """Print the tasks and the baselines."""
    from cranedyn.benchmark import baselines

    tasks = select_tasks(options.tasks)
    print(f"benchmark {VERSION}, {len(tasks)} tasks")
    print("task              instances  lasts [s]  within [m]  swing [rad]  least time [s]")
    for task in tasks:
        least = "-" if task.least_time is None else f"{task.least_time:.2f}"
        print(
            f"{task.name:<18}{task.count + 1:>9}{task.duration:>11g}{task.tolerance:>12g}"
            f"{task.swing_bound:>13g}{least:>16}"
        )
    print("\nbaselines")
    for name in baselines.NAMES:
        sentence = getattr(baselines, name).__doc__.partition("\n\n")[0]
        print(f"{name:<22}{' '.join(sentence.split())}")
    print(
        next_lines(
            "cranedyn benchmark run full_lqr --tasks inteco/move",
            "cranedyn benchmark run --help",
        )
    )
    return 0


# --- run ------------------------------------------------------------------------------------------


def _configure_run(parser: Parser) -> None:
    """Run an entry in all instances of the tasks, print its scores and write its result."""
    parser.add_argument("entry", metavar="ENTRY", help=f"{FORMS}; its code is run")
    _add_tasks(parser)
    text = f"{PUBLIC}, or a date such as 2026-11-28 for a ranking (default: %(default)s)"
    parser.add_argument("--seeds", default=PUBLIC, metavar="SEEDS", help=text)
    text = "where to write the result; by default out/benchmark/NAME.json"
    parser.add_argument("-o", "--output", type=Path, default=None, metavar="FILE.json", help=text)
    _add_running(parser)
    _add_scheduler(parser)
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace) -> int:
    """Run an entry; the exit code is 1 if it took part in no task."""
    spread = _spread(options)
    tasks = select_tasks(options.tasks)
    source = find_entry(options.entry, trusted=options.trust)
    check_seeds(options.seeds)
    limits = _limits(options)
    file = options.output or Path("out/benchmark", f"{source.name}.json")
    if options.output is None:
        file.parent.mkdir(parents=True, exist_ok=True)
    # Before anything is computed, which may take minutes.
    check_writable(file)
    check_opens(source, limits)
    with bar("benchmark", len(tasks)) as progress:
        result = run_benchmark(
            tasks,
            source,
            options.entry,
            seeds=options.seeds,
            limits=limits,
            progress=progress,
            **spread,
        )
    result.write(file)
    _print_result(result)
    print(f"Written to {file}.")
    verify_line = command_line("cranedyn", "benchmark", "verify", file, "--sample", 5)
    other = "mpc_goal" if source.name != "mpc_goal" else "full_lqr"
    words = ["cranedyn", "benchmark", "run", other]
    if options.tasks:
        words += ["--tasks", *options.tasks]
    if options.seeds != PUBLIC:
        words += ["--seeds", options.seeds]
    print(next_lines(verify_line, command_line(*words)))
    took_part = any(instance.status != "declined" for instance in result.instances)
    if not took_part:
        print(f"It takes part in none of these tasks: {result.instances[0].reason}")
    return 0 if took_part else FAILED


def _print_result(result: Result) -> None:
    """Print the scores of a result, and each reason for which instances failed once, with how often
    it is the reason.
    """
    found = scores(result, all_tasks())
    print(score_table(found))
    print(f"{result.entry}: {totals(found)} Seeds: {result.seeds}.")
    reasons: dict[str, list[str]] = {}
    for instance in result.instances:
        if instance.status == "failed":
            name = f"{instance.task}, instance {instance.index}"
            reasons.setdefault(instance.reason, []).append(name)
    often_first = sorted(reasons.items(), key=lambda item: -len(item[1]))
    for reason, names in often_first[:_MOST_REASONS]:
        more = f", and {len(names) - 1} more" if len(names) > 1 else ""
        print(f"{names[0]}{more}: {reason}")
    if len(often_first) > _MOST_REASONS:
        print(f"{len(often_first) - _MOST_REASONS} more reasons are in the file.")


# --- compare --------------------------------------------------------------------------------------


def _configure_compare(parser: Parser) -> None:
    """Compare results pair by pair with the first of them."""
    parser.add_argument("results", nargs="+", type=Path, metavar="RESULT.json", help="results")
    text = "draw every instance into a picture or a PDF"
    parser.add_argument("--figure", type=Path, metavar="FILE", help=text)
    parser.set_defaults(run=_compare)


def _compare(options: argparse.Namespace) -> int:
    """Print comparisons of results with the first one."""
    from cranedyn.benchmark.comparison import benchmark_table, check_comparable, compare
    from cranedyn.errors import OutOfRange

    if len(options.results) < 2:
        raise OutOfRange("number of results", len(options.results), "2 or more")
    first, *others = [read_benchmark_result(file) for file in options.results]
    tasks = all_tasks()
    for other in others:
        check_comparable(first, other)
    for result in (first, *others):
        print(f"{result.entry}: {totals(scores(result, tasks))}")
    for other in others:
        print(
            f"\n{other.entry} (2nd) over {first.entry} (1st); below 1 the 2nd is better, and an "
            "instance\nthat only the 1st passed counts as ∞, one that only the 2nd passed as 0"
        )
        print(benchmark_table(compare(first, other, tasks)))
    if options.figure:
        from cranedyn.benchmark.figures import write_figure

        write_figure(options.figure, [first, *others], tasks)
        print(f"Written to {options.figure}.")
    again = [command_line("cranedyn", "benchmark", "verify", file) for file in options.results[:2]]
    print(next_lines(*again))
    return 0


# --- verify ---------------------------------------------------------------------------------------


def _configure_verify(parser: Parser) -> None:
    """Compute a result again and say whether it is the same; exit code 1 if it is not."""
    parser.add_argument("result", type=Path, metavar="RESULT.json", help="the result")
    text = "the entry, where its file lies elsewhere than the result says; its code is run"
    parser.add_argument("--entry", metavar="ENTRY", help=text)
    _add_trust(parser)
    text = "compute so many instances again; all by default"
    parser.add_argument("--sample", type=int, metavar="N", help=text)
    _add_jobs(parser)
    _add_scheduler(parser)
    parser.set_defaults(run=_verify)


def _verify(options: argparse.Namespace) -> int:
    """Verify a result."""
    spread = _spread(options)
    result = read_benchmark_result(options.result)
    sample = None if options.sample is None else whole("--sample", options.sample, 1)
    with bar("verification", len(result.tasks)) as progress:
        found = verify_result(
            result,
            all_tasks(),
            text=options.entry,
            trusted=options.trust,
            sample=sample,
            progress=progress,
            **spread,
        )
    for difference in found.differences:
        print(difference)
    share = f"{found.compared} of {len(result.instances)} instances computed again"
    if found.differences:
        print(f"different: {len(found.differences)} differences in {share}.")
    else:
        print(f"same: {share}, largest relative difference of a number {found.largest:.2g}.")
    entry = options.entry or result.source
    elsewhere = ["--entry", options.entry] if options.entry else []
    print(
        next_lines(
            command_line(
                "cranedyn", "benchmark", "verify", options.result, *elsewhere, "--sample", 3
            ),
            command_line("cranedyn", "benchmark", "run", entry, "--tasks", *list(result.tasks)[:1]),
        )
    )
    return FAILED if found.differences else 0


# --- header ---------------------------------------------------------------------------------------


def _configure_header(parser: Parser) -> None:
    """Write the header crane_entry.h, by which an entry in C is made."""
    text = "new file to write"
    default = Path("crane_entry.h")
    parser.add_argument("file", nargs="?", type=Path, default=default, metavar="FILE", help=text)
    parser.set_defaults(run=_header)


def _header(options: argparse.Namespace) -> int:
    """Write the header; no file is overwritten.

    Raises:
        DataError: If the file exists or cannot be written.
    """
    from cranedyn.benchmark.entries.c_library import HEADER
    from cranedyn.lifts.planning.file_templates import write_new_file

    write_new_file(options.file, HEADER.read_text(encoding="utf-8"))
    print(f"Written to {options.file}.")
    print(
        next_lines("cc -O2 -fPIC -shared mine.c -o mine.so -lm", "cranedyn benchmark run mine.so")
    )
    return 0


# --- validity and limits --------------------------------------------------------------------------


def _configure_validity(parser: Parser) -> None:
    """Show whether the order of entries depends on seeds, engine or step."""
    parser.add_argument("entries", nargs="+", metavar="ENTRY", help=f"two or more of: {FORMS}")
    _add_tasks(parser)
    _add_running(parser)
    parser.set_defaults(run=_validity)


def _validity(options: argparse.Namespace) -> int:
    """Print the order of entries under each variant."""
    from cranedyn.benchmark.validity import VARIANTS, order_table, orders

    tasks = select_tasks(options.tasks)
    entries = {text: find_entry(text, trusted=options.trust) for text in options.entries}
    by_name = {source.name: source for source in entries.values()}
    if len(by_name) == len(entries):
        # Names fit into the table better than paths, unless two are the same.
        entries = by_name
    limits = _limits(options)
    with bar("orders", len(VARIANTS) * len(entries)) as progress:
        found = orders(tasks, entries, jobs=options.jobs, limits=limits, progress=progress)
    print(order_table(found))
    print(
        next_lines(
            command_line("cranedyn", "benchmark", "run", options.entries[0]),
            "cranedyn benchmark list",
        )
    )
    return 0


def _configure_limits(parser: Parser) -> None:
    """Compute the least times of moves beside those that the files of the tasks state."""
    _add_tasks(parser)
    parser.set_defaults(run=_least_times)


def _least_times(options: argparse.Namespace) -> int:
    """Print least times; the exit code is 1 if one differs from its file."""
    from cranedyn.benchmark.limits import AGREEMENT, least_time

    tasks = [task for task in select_tasks(options.tasks) if task.goal is not None]
    agree = True
    print("task              computed [s]  in the file [s]")
    for task in tasks:
        computed = least_time(task)
        stated = "-" if task.least_time is None else f"{task.least_time:.2f}"
        print(f"{task.name:<18}{computed:>12.2f}{stated:>17}", flush=True)
        agree = agree and task.least_time is not None
        if task.least_time is not None:
            agree = agree and abs(computed - task.least_time) <= AGREEMENT
    print(next_lines("cranedyn benchmark list", "cranedyn benchmark limits --help"))
    return 0 if agree else FAILED


def _configure_papers(parser: Parser) -> None:
    """Compute the published cases of controllers of other papers beside their numbers."""
    parser.set_defaults(run=_papers)


def _papers(options: argparse.Namespace) -> int:
    """Print published numbers beside ours."""
    from cranedyn.benchmark.papers import paper_table, reproduced

    print(paper_table(reproduced()))
    print(
        next_lines(
            "cranedyn benchmark run kaepernick_mpc --tasks gantry/move",
            "cranedyn benchmark run container_crane_lqr --tasks gantry/move",
        )
    )
    return 0


_COMMANDS: dict[str, tuple[Callable[[Parser], None], str]] = {
    "list": (_configure_list, "cranedyn benchmark list"),
    "run": (_configure_run, "cranedyn benchmark run mine.py:controller --tasks tower"),
    "compare": (_configure_compare, "cranedyn benchmark compare a.json b.json"),
    "verify": (_configure_verify, "cranedyn benchmark verify mine.json --sample 10"),
    "header": (_configure_header, "cranedyn benchmark header"),
    "validity": (_configure_validity, "cranedyn benchmark validity full_lqr mpc_goal"),
    "papers": (_configure_papers, "cranedyn benchmark papers"),
    "limits": (_configure_limits, "cranedyn benchmark limits --tasks inteco/move"),
}
"""Functions that configure the commands, whose first line is the help, and an example of each."""
