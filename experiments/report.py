"""All experiments on one page: claims, tables beside the published numbers, figures, and how to
make each again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import date
from html import escape
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from string import Template
from typing import Any, get_args

from cranedyn import __version__
from cranedyn.checks import whole
from cranedyn.command import INTERRUPTED, Parser, command
from cranedyn.data.files import (
    check_writable,
    digest,
    lock_folder,
    parse_json,
    read_bytes,
    read_text,
    write_text,
)
from cranedyn.errors import DataError, UnknownName
from cranedyn.interfaces import EngineName
from cranedyn.plotting.html import IMAGE_TYPES, STYLE, image_address, mark_html, table_html
from cranedyn.verdict import Check, Verdict, overall
from experiments import harness
from experiments.catalogue import EXPERIMENTS, Entry
from experiments.harness.document import naming_result

PLAIN = "a1 a2 a3 energy gazebo mass_ratio validate".split()
"""Experiments that test Pinocchio's algorithms, and therefore run by them."""

LONGEST = "lift compare lift_benchmark sweep lift_report observer margins cranes".split()
"""Experiments that take longest, the longest first."""

FOUND = (
    "At the cranes' slew rates",
    "Flat feed-forward with LQR leaves no swing",
    "the move of least time settles before any other",
    "Where the drives alone are seen",
    "the least delay for the full-model LQR",
    "tower: Nothing that hangs",
    "trolley: a joystick that brakes",
    "Setpoints alone do not tell",
)
"""Phrases of the claims that say what was not known before."""

PICTURES = (
    "a1-budget a3-slewing energy-ledger linear_vs_full-slews compare-robustness margins-margins_map"
    " sweep-sweep_map lift-site_tower factors-needed identify-twin_1"
).split()
"""Figures of the first screen: experiment and figure."""

COMMAND = (sys.executable, "-m", "cranedyn", "run")
"""What runs an experiment."""

_PAGE = Template(Path(__file__).with_suffix(".html").read_text(encoding="utf-8"))

_LARGEST_FIGURE = 50_000_000
"""Most bytes of a figure."""


def page(folders: Sequence[Path]) -> str:
    """Return the report as one HTML document that needs nothing else.

    Args:
        folders: Folders of results, each with a ``result.json`` and figures.

    Raises:
        DataError: If a result cannot be read.
    """
    results, sections = [], []
    for folder in folders:
        with naming_result(folder / "result.json"):
            results.append(read_result(folder))
            sections.append(_section(folder, results[-1]))
    return _PAGE.substitute(_first(results), style=STYLE, sections="\n".join(sections))


def _first(results: Sequence[dict[str, Any]]) -> dict[str, object]:
    """Return the values of the first screen: what was judged, what holds, what is new, pictures."""
    today, claims = date.today(), [claim for r in results for claim in r["claims"]]
    figures = {
        f"{r['experiment']}-{Path(f).stem}": _entry(r).title for r in results for f in r["figures"]
    }

    return {
        "experiments": len(results),
        "machines": escape(", ".join(sorted({r["machine"] for r in results}))),
        "version": escape(__version__),
        "date": f"{today.day} {today:%B %Y}",
        "claims": len(claims),
        "holding": sum(claim["holds"] is True for claim in claims),
        "unknown": sum(claim["holds"] is None for claim in claims),
        "mark": mark_html(_verdict(claims)),
        "links": "".join(_link(r, _entry(r).title, r["claims"]) for r in results),
        "failing": _listed(results, lambda claim: claim["holds"] is False),
        "found": _listed(results, lambda claim: any(f in claim["sentence"] for f in FOUND)),
        "pictures": "".join(
            f'<a href="#{at}"><img alt="" data-of="{at}">{escape(figures[at])}</a>'
            for at in PICTURES
            if at in figures
        ),
    }


def _listed(results: Sequence[dict[str, Any]], chosen: Callable[[Mapping[str, Any]], bool]) -> str:
    """Return the chosen claims as items of a list, each a link to its experiment."""
    return "".join(
        f"<li>{_link(r, f'{_entry(r).title}: ' + c['sentence'], [c])}</li>"
        for r in results
        for c in filter(chosen, r["claims"])
    )


def _link(result: Mapping[str, Any], text: str, claims: Sequence[Mapping[str, Any]]) -> str:
    """Return a link to an experiment, with the sign of whether claims hold."""
    mark = mark_html(_verdict(claims))
    return f'<a href="#{escape(result["experiment"])}">{mark}{escape(text)}</a>'


def _verdict(claims: Sequence[Mapping[str, Any]]) -> Verdict:
    """Return the verdict of claims together."""
    return overall(Check(claim["sentence"], claim["holds"]) for claim in claims)


def _entry(result: Mapping[str, Any]) -> Entry:
    name = str(result["experiment"])
    return EXPERIMENTS.get(name) or Entry(name, str(result["about"]))


def read_result(folder: Path) -> dict[str, Any]:
    """Read the result in a folder.

    Raises:
        DataError: If there is none.
    """
    file = folder / "result.json"
    with naming_result(file):
        result = parse_json(read_text(file))
        _check_set(folder, result["files"])
        words = (result[name] for name in ("experiment", "about", "command", "machine"))
        sentences = (claim["sentence"] for claim in result["claims"])
        if not all(isinstance(word, str) for word in (*words, *sentences)):
            raise TypeError("a word is not text")
        if not all(claim["holds"] in (True, False, None) for claim in result["claims"]):
            raise TypeError("a claim is none")
    return dict(result)


def _made(folder: Path) -> bool:
    """Return whether a result and every file that it lists exist."""
    file = folder / "result.json"
    try:
        return os.path.isfile(file) and all(
            os.path.isfile(folder / name) for name in parse_json(read_text(file))["files"]
        )
    except (DataError, LookupError, TypeError, ValueError, RecursionError):
        return True


def _check_set(folder: Path, files: Mapping[str, str]) -> None:
    """Return if every file is the one that its run wrote."""
    for name, expected in files.items():
        if Path(name).name != name or not os.path.isfile(folder / name):
            raise ValueError(f"{name!r} is no file in its folder")
        if digest(folder / name) != expected:
            raise DataError(
                f"Cannot read {folder}: {name} there is of another run than its result.json; run "
                "it --again."
            )


def _section(folder: Path, result: dict[str, Any]) -> str:
    entry, name, claims = _entry(result), escape(result["experiment"]), result["claims"]
    command = escape(result["command"])
    listed = "".join(
        f"<li>{mark_html(_verdict([c]))}{escape(c['sentence'])} "
        f'<a href="#{name}-command" title="{command}">command</a></li>'
        for c in claims
    )
    if strange := set(result["figures"]) - set(result["files"]):
        raise ValueError(f"its figures {sorted(strange)} are not among its files")
    figures = "".join(
        f'<figure id="{name}-{escape(stem)}">'
        f"{figure_html(folder, f'{stem}.svg' if f'{stem}.svg' in result['files'] else file)}"
        f"<figcaption>{escape(entry.caption(stem))}</figcaption></figure>"
        for file in result["figures"]
        for stem in [Path(file).stem]
    )
    versions = ", ".join(
        f"{package} {version}" for package, version in result["versions"].items() if version
    )
    holding, verdict = sum(c["holds"] is True for c in claims), _verdict(claims)
    return (
        f'<section id="{name}"><details><summary><h2>{escape(entry.title)}</h2>'
        f"<span>{escape(entry.line)}</span><span>{mark_html(verdict)}{holding} of "
        f"{len(claims)}</span></summary>"
        f'<p class="lead">{escape(result["about"][:1].upper() + result["about"][1:])}</p>'
        f'<p id="{name}-command"><code>{command}</code></p><ul class="claims">{listed}</ul>'
        f"{figures}{''.join(map(_table, result['tables']))}"
        "<details><summary>Parameters and versions</summary>"
        f"<pre>{escape(json.dumps(result['parameters'], indent=1, ensure_ascii=False))}</pre>"
        f'<p class="note">{escape(versions)}; {escape(result["machine"])}</p></details>'
        "</details></section>"
    )


def _table(entry: dict[str, Any]) -> str:
    """Return a table of a ``result.json`` as HTML."""
    table = harness.ResultTable.of(entry)
    columns = [(header, not form) for header, form in table.columns]
    return table_html(table.title, columns, table.shown(), table.note)


def figure_html(folder: Path, name: str) -> str:
    """Return a figure of a folder of results as HTML with the image embedded."""
    if Path(name).name != name or Path(name).suffix not in IMAGE_TYPES:
        raise ValueError(f"{name!r} is no figure in its folder")
    content = read_bytes(folder / name, _LARGEST_FIGURE)
    return (
        f'<img alt="{escape(Path(name).stem)}" src="{image_address(content, Path(name).suffix)}">'
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is missing, write the page; 0, or the first code of an experiment that is not 0."""
    parser = Parser(
        prog="cranedyn report",
        description="All experiments on one page, report.html.",
        example="cranedyn report --quick --only a1 a3",
    )
    text = "folder of all results, one folder inside for each experiment (default out)"
    parser.add_argument("--out", metavar="DIR", default="out", help=text)
    text = "which experiments (default all)"
    parser.add_argument("--only", nargs="+", metavar="NAME", default=list(EXPERIMENTS), help=text)
    parser.add_argument(
        "--again", action="store_true", help="run experiments whose results are there already, too"
    )
    text = "run the least of what is missing, to see the page; claims need not hold"
    parser.add_argument("--quick", action="store_true", help=text)
    text = "how many experiments run side by side (default 2)"
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help=text)
    text = "what computes steps, default compiled code, for these Pinocchio: " + ", ".join(PLAIN)
    parser.add_argument("--engine", choices=get_args(EngineName), help=text)
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    folder = Path(options.out)
    for name in options.only:
        if name not in EXPERIMENTS:
            raise UnknownName("experiment", name, EXPERIMENTS)
    whole("jobs", options.jobs, 1)
    missing = [name for name in options.only if options.again or not _made(folder / name)]
    for file in (folder / "report.html", *(folder / name / "result.json" for name in missing)):
        check_writable(file)
    with lock_folder(folder):  # it is there for them, and gone again if they leave nothing
        codes = _run(missing, options)
        finished = [name for name in options.only if os.path.isfile(folder / name / "result.json")]
        for name in set(options.only) - set(finished):
            print(
                f"{EXPERIMENTS[name].title} ({name}) could not be made and is not on the page.",
                file=sys.stderr,
            )
        if finished:
            write_text(folder / "report.html", page([folder / name for name in finished]))
    if finished:
        print(f"Written to {folder / 'report.html'}.")
    return max(map(abs, codes), default=0)  # of one killed by a signal the code is negative


def _run(names: Sequence[str], options: argparse.Namespace) -> list[int]:
    """Run experiments side by side, the longest first; return their exit codes."""
    started: list[subprocess.Popen[str]] = []

    def run(number: int, name: str) -> int:
        print(f"Experiment {number} of {len(names)}: {name}", flush=True)
        command = [*COMMAND, name, *_arguments(name, options)]
        pipes: Any = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(command, text=True, errors="replace", **pipes)
        started.append(process)
        lines = process.communicate()[0].splitlines()
        for line in lines if process.returncode else [s for s in lines if " claims hold, " in s]:
            print(f"{name}: {line}", flush=True)
        if process.returncode == INTERRUPTED:
            raise KeyboardInterrupt
        return process.returncode

    ordered = sorted(names, key=lambda name: (*LONGEST, name).index(name))
    with ThreadPoolExecutor(options.jobs) as pool:
        try:
            return list(pool.map(run, count(1), ordered))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in started:
                process.terminate()
            raise


def _arguments(name: str, options: argparse.Namespace) -> list[str]:
    entry, plain = EXPERIMENTS[name], name in PLAIN or find_spec("llvmlite") is None
    engine = options.engine or ("pinocchio" if plain else "compiled")
    return [
        *(entry.quick if options.quick else entry.arguments),
        *(["--engine", "compiled"] if engine == "compiled" else []),
        f"--out={Path(options.out) / name}",
    ]


if __name__ == "__main__":
    sys.exit(main())
