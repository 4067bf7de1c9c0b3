"""All experiments on one page: claims, tables beside the published numbers, figures, and how to
make each again.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date
from html import escape
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from time import sleep
from typing import IO, Any, get_args

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
from experiments import harness
from experiments.catalogue import EXPERIMENTS, Entry
from experiments.harness.arguments import command_name
from experiments.harness.outcome import summary

PLAIN = ("a1", "a2", "a3", "energy", "gazebo", "mass_ratio", "validate")
"""Experiments that test Pinocchio's algorithms, and therefore run by them."""

LONGEST = ("compare", "observer", "margins", "identify", "lift_report", "lift", "sweep")
"""Experiments that take longest, the longest first."""

FOUND = (
    ("a2", "the Bessel envelope's"),
    ("linear_vs_full", "At the cranes' slew rates"),
    ("compare", "Under the same limits the move of least time"),
    ("compare", "Where the drives alone are seen"),
    ("margins", "simulation is stable with"),
    ("lift", "tower: Nothing that hangs"),
    ("factors", "trolley: a joystick"),
    ("identify", "Setpoints alone do not tell"),
)
"""What was not known before: experiments, and a phrase of the claim."""

PICTURES = (
    ("a1", "budget"),
    ("a3", "slewing"),
    ("energy", "ledger"),
    ("linear_vs_full", "slews"),
    ("compare", "robustness"),
    ("margins", "margins_map"),
    ("sweep", "sweep_map"),
    ("lift", "site_tower"),
    ("factors", "needed"),
    ("identify", "twin_1"),
)
"""Figures of the first screen, by experiment."""

COMMAND = (sys.executable, "-m", "cranedyn", "run")
"""What runs an experiment."""

_SCRIPT = Path(__file__).with_name("report.js")

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
        with _naming(folder / "result.json"):
            results.append(read_result(folder))
            sections.append(_section(folder, results[-1]))
    links = "".join(
        f'<a href="#{escape(r["experiment"])}">{mark_html(_verdict(r["claims"]))}'
        f"{escape(_entry(r).title)}</a>"
        for r in results
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>cranedyn: experiments</title><style>{STYLE}</style></head><body>"
        '<nav><a class="brand" href="#top">cranedyn</a><input type="search" placeholder="Search" '
        'aria-label="Search claims, tables and figures"><span role="status"></span>'
        f'{links}</nav>\n<main id="top">{_first(results)}\n'
        + "\n".join(sections)
        + f"\n</main><script>{_SCRIPT.read_text(encoding='utf-8')}</script></body></html>\n"
    )


@contextmanager
def _naming(file: Path) -> Iterator[None]:
    """Name the file in errors about what it holds.

    Raises:
        DataError: If it cannot be read, or is not the result of an experiment.
    """
    try:
        yield
    except json.JSONDecodeError as error:
        raise DataError(f"Cannot read {file}: it is not JSON.") from error
    except OSError as error:
        raise DataError(f"Cannot read {error.filename}: {error.strerror}.") from error
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise DataError(
            f"Cannot read {file}: it is not the result of an experiment ({type(error).__name__}: "
            f"{error})."
        ) from error


def _first(results: Sequence[dict[str, Any]]) -> str:
    """Return the first screen: what was judged, what holds, what is new, and pictures of it."""
    today, of = date.today(), {r["experiment"]: r for r in results}
    claims = [claim for r in results for claim in r["claims"]]
    judged = [harness.Claim(claim["sentence"], claim["holds"]) for claim in claims]
    holding, counts = sum(claim.holds is True for claim in judged), summary(judged)
    kind = {True: "held", False: "fails", None: "open"}[_verdict(claims)]
    failing = "".join(_linked(r, c) for r in results for c in r["claims"] if c["holds"] is False)
    found = "".join(
        _linked(of[name], claim)
        for name, start in FOUND
        for claim in of.get(name, {"claims": ()})["claims"]
        if start in claim["sentence"]
    )
    pictures = "".join(
        f'<a href="#{name}-{figure}"><img alt="" data-of="{name}-{figure}">'
        f"{escape(EXPERIMENTS[name].title)}</a>"
        for name, figure in PICTURES
        if f"{figure}.png" in of.get(name, {"figures": ()})["figures"]
    )
    machines = ", ".join(sorted({r["machine"] for r in results}))
    return (
        '<header><div class="first"><div><h1>What cranedyn claims</h1><p class="lead">'
        f"{len(results)} experiments, judged on {escape(machines)} with cranedyn "
        f"{escape(__version__)}; {today.day} {today:%B %Y}.</p>"
        f'<p class="count {kind}">{holding} of {len(claims)}</p><p>'
        f"{escape(counts.partition(f'of {len(claims)} ')[2])} Each experiment is folded below, "
        f'and each claim leads to its command.</p><ul class="claims">{failing}</ul></div>'
        f'<div><h2>Newly found</h2><ul class="claims">{found}</ul></div></div>'
        f'<div class="pictures">{pictures}</div></header>'
    )


def _linked(result: Mapping[str, Any], claim: Mapping[str, Any]) -> str:
    """Return a claim that leads to its experiment."""
    return (
        f'<li>{mark_html(claim["holds"])}<a href="#{escape(result["experiment"])}">'
        f"{escape(claim['sentence'])}</a></li>"
    )


def _verdict(claims: Sequence[Mapping[str, Any]]) -> bool | None:
    """Return whether all claims hold, None if none fails and some are not judged."""
    kinds = {claim["holds"] for claim in claims}
    return False if False in kinds else None if None in kinds else True


def _entry(result: Mapping[str, Any]) -> Entry:
    name = str(result["experiment"])
    return EXPERIMENTS.get(name) or Entry(name, str(result["about"]))


def read_result(folder: Path) -> dict[str, Any]:
    """Read the result in a folder.

    Raises:
        DataError: If there is none.
    """
    file = folder / "result.json"
    with _naming(file):
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
        f"<li>{mark_html(c['holds'])}{escape(c['sentence'])} "
        f'<a href="#{name}-command" title="{command}">command</a></li>'
        for c in claims
    )
    if strange := set(result["figures"]) - set(result["files"]):
        raise ValueError(f"its figures {sorted(strange)} are not among its files")
    figures = "".join(
        f'<figure id="{name}-{escape(Path(file).stem)}">'
        f"{figure_html(folder, best_figure(file, result['files']))}"
        f"<figcaption>{escape(entry.caption(Path(file).stem))}</figcaption></figure>"
        for file in result["figures"]
    )
    versions = ", ".join(
        f"{package} {version}" for package, version in result["versions"].items() if version
    )
    holding = sum(c["holds"] is True for c in claims)
    return (
        f'<section id="{name}"><details><summary><h2>{escape(entry.title)}</h2>'
        f"<span>{escape(entry.line)}</span><span>{mark_html(_verdict(claims))}{holding} of "
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


def best_figure(name: str, files: Mapping[str, str]) -> str:
    """Return the vector file of a figure if there is one."""
    drawing = f"{Path(name).stem}.svg"
    return drawing if drawing in files else name


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
        prog=command_name("report"), description="All experiments on one page, report.html."
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
        if INTERRUPTED in codes:
            return INTERRUPTED
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
    return max(codes, default=0)


def _run(names: Sequence[str], options: argparse.Namespace) -> list[int]:
    """Run experiments side by side, the longest first; return their exit codes.

    One that is interrupted ends the others, and so does an error here.
    """
    waiting = sorted(names, key=lambda name: (*LONGEST, name).index(name))
    running: dict[str, tuple[subprocess.Popen[bytes], IO[bytes]]] = {}
    output: IO[bytes]
    codes: list[int] = []
    try:
        while (waiting or running) and INTERRUPTED not in codes:
            while waiting and len(running) < options.jobs:
                name, output = waiting.pop(0), TemporaryFile()
                print(f"Experiment {len(names) - len(waiting)} of {len(names)}: {name}", flush=True)
                command = [*COMMAND, name, *_arguments(name, options)]
                process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
                running[name] = process, output
            sleep(0.05)
            for name in [name for name in running if running[name][0].poll() is not None]:
                code, output = running[name][0].returncode, running.pop(name)[1]
                codes.append(code)
                with output:
                    output.seek(0)
                    lines = output.read().decode(errors="replace").splitlines()
                for line in lines if code else [s for s in lines if " claims hold, " in s]:
                    print(f"{name}: {line}", flush=True)
    finally:
        for process, output in running.values():
            process.terminate()
            process.wait()
            output.close()
    return codes


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
