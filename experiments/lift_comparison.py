"""Lifts compared by ``cranedyn run lift_report --cranes`` and ``--positions``: which crane, which
place, which lift of a list.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cranedyn.command import Parser
from cranedyn.errors import DataError
from cranedyn.lifts.judging.plan_inputs import collect_files
from cranedyn.lifts.judging.plan_record import PlanOptions
from experiments import harness
from experiments.harness.arguments import add_condition, command_name
from experiments.lift_judging import GUSTS, LIFTS, comparison_asked_for, judge_plan

if TYPE_CHECKING:
    from cranedyn.lifts.judging.comparison import Case, ComparedCase
    from cranedyn.lifts.judging.lift_figures import LiftFigure

_NUMBERS = ("share", "clearance", "time", "wind")
"""Columns of numbers that a study returns, by the attributes of a compared case."""


def add_comparison(parser: Parser) -> None:
    """Add the options of a comparison."""
    add = parser.add_argument
    add("--cranes", nargs="+", metavar="FILE", help="compare cranes: a site file each")
    text = "compare places: x0:x1:n,y0:y1:n [m], or a .csv or .toml file"
    add("--positions", metavar="WHERE", help=text)
    add("--list", metavar="FILE", help="compare lifts: a .toml file with [[lift]]")
    common = parser.common.add_argument
    text = "sort a comparison by share of capacity, clearance, time or wind limit"
    common("--sort", choices=_NUMBERS, default="share", help=text)
    common("--colour", choices=("share", "time"), default="share", help="colour of its map")
    common("--workers", type=int, metavar="N", help="processes of a comparison; one per core")
    needed = "--cranes, --positions or --list"
    add_condition(parser, needed, comparison_asked_for, "sort", "colour", "workers")


def compare_lifts(
    options: argparse.Namespace, plan: PlanOptions, setup: harness.Setup
) -> harness.Outcome:
    """Judge all cases of a comparison, and return its table, map and page.

    Raises:
        DataError: If options contradict each other, or a file cannot be read.
    """
    from cranedyn.lifts.judging.comparison import cases_of, in_order, lifts_from, places_from

    _check_options(options)
    sites = options.cranes or [options.site or "open_yard"]
    places = [] if options.positions is None else places_from(options.positions)
    lifts = [] if options.list is None else lifts_from(Path(options.list))
    if options.load is not None and any(lift.load is not None for lift in lifts):
        raise DataError("--load is given, and --list enters loads of lifts, too; leave one out.")
    cases = cases_of(sites, places, lifts)
    rows = in_order(_judged(cases, plan, options, setup), options.sort)
    return _outcome(rows, plan, options)


def _check_options(options: argparse.Namespace) -> None:
    """Refuse options that contradict a comparison.

    Raises:
        DataError: With the option.
    """
    if options.cranes and options.site is not None:
        raise DataError("--site has no effect beside --cranes, which names site files; leave it.")
    if options.film or options.view or options.serve:
        raise DataError("A comparison has no recording; leave out --film, --view and --serve.")


def _judged(
    cases: Sequence[Case], plan: PlanOptions, options: argparse.Namespace, setup: harness.Setup
) -> list[ComparedCase]:
    """Return the rows of all cases, judged on the cores of this machine. What is done is kept in
    the folder of the results, so that the same comparison goes on after an interruption.
    """
    from cranedyn.lifts.judging.comparison import ComparedCase, refused
    from cranedyn.sweep import Design, results, sweep
    from cranedyn.sweep.study import code_digest, source_digests, study_name

    # With the digests of their files, so that cases of a changed file are judged again.
    digests = {}
    for site in {case.site for case in cases}:
        files = collect_files(site, options.chart, options.crane)
        digests[site] = [[file.path, file.sha256] for file in files]
    tasks = []
    for case in cases:
        task = {
            "case": case.stored(),
            "options": asdict(plan),
            "chart": options.chart,
            "crane": options.crane,
            "files": digests[case.site],
        }
        tasks.append(json.dumps(task, sort_keys=True))
    # With the code, since a sweep does not go on with what other code has computed.
    code = code_digest(source_digests(study_name(judge_cases)))
    name = hashlib.sha256("\n".join([code, *tasks]).encode()).hexdigest()[:12]
    folder = options.folder / f"cases-{name}"
    report = setup.reporter.sweep("cases")
    sweep(
        judge_cases,
        Design({"task": np.array(tasks)}),
        folder,
        chunk=1,
        workers=options.workers,
        progress=report,
    )
    rows = []
    for case, row in zip(cases, results(folder).to_pylist(), strict=True):
        if row["error"] is not None:
            rows.append(refused(case, row["error"]))
            continue
        numbers = {column: row[column] for column in _NUMBERS}
        rows.append(ComparedCase(case, row["word"], reason=row["reason"], **numbers))
    return rows


def judge_cases(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Judge cases of a comparison: the study of its sweep.

    Args:
        columns: "task" has each case with its options as JSON, shape (n,).

    Returns:
        Word, numbers and reason of each case, shape (n,); numbers that were not judged are masked.

    Raises:
        CraneError: If a case is refused, such as for lack of a way.
    """
    from cranedyn.lifts.judging.comparison import Case, compared

    rows = []
    for text in columns["task"]:
        task = json.loads(str(text))
        case = Case.of(task["case"])
        judgement = judge_plan(
            PlanOptions(**task["options"]),
            site=case.site,
            chart=task["chart"],
            crane=task["crane"],
            change=case.change,
        )
        rows.append(compared(case, judgement))
    result: dict[str, np.ndarray] = {
        "word": np.array([row.word for row in rows]),
        "reason": np.array([row.reason for row in rows]),
    }
    for name in _NUMBERS:
        values = [getattr(row, name) for row in rows]
        masked = np.ma.masked_invalid([np.nan if value is None else value for value in values])
        result[name] = masked
    return result


def _outcome(
    rows: Sequence[ComparedCase], plan: PlanOptions, options: argparse.Namespace
) -> harness.Outcome:
    """Return table, map, page and CSV file of a comparison."""
    from cranedyn.lifts.judging.comparison_page import (
        comparison_csv,
        comparison_html,
        comparison_table,
        without_empty_columns,
    )

    command_line = " ".join([command_name("lift_report"), *options.argv])
    table = comparison_table(rows, _note(plan, options.sort))
    maps = _maps(rows, options.colour)
    html = comparison_html(table, list(maps.values()), rows, command_line)
    words = [row.word for row in rows]
    found: bool | None = "GO" in words
    if not found and "NOT COMPLETE" in words:
        found = None  # it might be one, if all were judged
    return harness.Outcome(
        tables=[harness.ResultTable(*without_empty_columns(table))],
        claims=[harness.Claim(f"Of {len(rows)} cases {words.count('GO')} are a GO.", found)],
        parameters={
            "lifts": plan.lifts,
            "gusts": plan.gusts,
            "sorted_by": options.sort,
        },
        figures={name: figure for name, (figure, _) in maps.items()},
        texts={"comparison.csv": comparison_csv(table), "comparison.html": html},
    )


def _note(plan: PlanOptions, key: str) -> str:
    """Return what to know about the table of a comparison: its order, and how coarse it is."""
    sentences = [f"Sorted by verdict, then by {'share of capacity' if key == 'share' else key}."]
    if plan.lifts == 0:
        sentences.append("No perturbed lifts were simulated, so that no case is a GO.")
    elif plan.lifts < LIFTS:
        sentences.append(
            f"Coarse: {plan.lifts} perturbed lifts, where a lift plan has {LIFTS}; fewer lifts "
            "show a larger probability of coming too near."
        )
    if plan.gusts == 0:
        sentences.append("No gusts were tried, so that no case is a GO.")
    elif plan.gusts < GUSTS:
        sentences.append(
            f"Coarse: {plan.gusts} gusts are drawn at each wind limit, where a lift plan has "
            f"{GUSTS}; the limit rests on those that are always tried."
        )
    return " ".join(sentences)


def _maps(rows: Sequence[ComparedCase], coloured_by: str) -> dict[str, LiftFigure]:
    """Return a map of each crane that was tried in several places, by the name of its figure."""
    from cranedyn.lifts.judging.comparison_page import COLOURED_BY, places_map
    from cranedyn.lifts.judging.lift_figures import LiftFigure
    from cranedyn.lifts.planning.site_file import read_site

    sites: dict[str, str] = {}
    for row in rows:
        if row.case.place is not None:
            sites[row.case.crane] = row.case.site
    maps = {}
    for i, (crane, file) in enumerate(sites.items(), start=1):
        name = "places" if len(sites) == 1 else f"places_{i}"
        own = [row for row in rows if row.case.crane == crane]
        figure = places_map(read_site(file), own, coloured_by=coloured_by, title=crane)
        caption = (
            f"Places of {crane}, coloured by {COLOURED_BY[coloured_by]}. Those that are no GO have "
            "the number of the row of the table that tells the reason. The dotted line joins the "
            "ends of the lift, and is not its way."
        )
        maps[name] = LiftFigure(figure, caption)
    return maps
