"""All experiments on one page: claims, tables beside the published numbers, figures, and how to
make each again.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import date
from html import escape
from pathlib import Path
from typing import Any

from cranedyn import __version__
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
from cranedyn.model.load import load_crane
from cranedyn.plotting.html import (
    IMAGE_TYPES,
    STYLE,
    image_address,
    mark_html,
    svg_address,
    table_html,
)
from cranedyn.recording.sketch import sketch
from experiments import harness
from experiments.catalogue import EXPERIMENTS, Entry
from experiments.harness.arguments import add_engine
from experiments.harness.outcome import summary

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
        f'<a href="#{escape(r["experiment"])}">{escape(_entry(r).title)}</a>' for r in results
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" '
        'content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>cranedyn: experiments</title><style>{STYLE}</style></head><body>"
        f'<nav><a href="#top">Summary</a>{links}</nav>\n<main id="top">{_first(results)}\n'
        + "\n".join(sections)
        + "\n</main></body></html>\n"
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
    """Return the first screen: date, crane, claims that hold, a line for each experiment."""
    today = date.today()
    claims = [
        harness.Claim(c["sentence"], c["holds"]) for result in results for c in result["claims"]
    ]
    holding, failed = (sum(claim.holds is kind for claim in claims) for kind in (True, False))
    rows = "".join(
        f'<tr><td><a href="#{escape(r["experiment"])}">{escape(_entry(r).title)}</a></td>'
        f"<td>{escape(_entry(r).line)}</td><td>{_of_total(r['claims'])}</td></tr>"
        for r in results
    )
    counts = summary(claims).partition(f"of {len(claims)} ")[2]
    verdict = "held" if holding == len(claims) else "fails" if failed else "open"
    crane = load_crane()
    picture = sketch(crane, crane.state(phi=0.06))
    return (
        '<div class="first"><div><h1>cranedyn: what it claims, and what was found</h1>'
        f'<p class="lead">{today.day} {today:%B %Y} · cranedyn {escape(__version__)}</p>'
        f'<p class="count {verdict}">{holding} of {len(claims)}</p><p>{escape(counts)}</p></div>'
        f'<figure><img alt="The crane from the side" src="{svg_address(picture)}">'
        "<figcaption>The crane of the experiments, from the side.</figcaption></figure></div>"
        '<div class="table"><table class="summary"><thead><tr><th>experiment</th><th>what it '
        "shows</th>"
        f"<th>claims that hold</th></tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _of_total(claims: Sequence[Mapping[str, Any]]) -> str:
    holding, failed = (sum(c["holds"] is kind for c in claims) for kind in (True, False))
    kind = "fails" if failed else "held" if holding == len(claims) else "open"
    unknown = len(claims) - holding - failed
    return f'<span class="{kind}">{holding} of {len(claims)}</span>' + (
        f", {unknown} not judged" if unknown else ""
    )


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
    entry = _entry(result)
    claims = "".join(
        f"<li>{mark_html(c['holds'])}{escape(c['sentence'])}</li>" for c in result["claims"]
    )
    if strange := set(result["figures"]) - set(result["files"]):
        raise ValueError(f"its figures {sorted(strange)} are not among its files")
    figures = "".join(
        f"<figure>{figure_html(folder, best_figure(name, result['files']))}"
        f"<figcaption>{escape(entry.caption(Path(name).stem))}</figcaption></figure>"
        for name in result["figures"]
    )
    versions = ", ".join(
        f"{name} {version}" for name, version in result["versions"].items() if version
    )
    return (
        f'<section id="{escape(result["experiment"])}"><h2>{escape(entry.title)}</h2>'
        f'<p class="lead">{escape(result["about"][:1].upper() + result["about"][1:])}</p><ul '
        f'class="claims">{claims}</ul>'
        f"{''.join(map(_table, result['tables']))}{figures}"
        f"<p>Again: <code>{escape(result['command'])}</code></p>"
        "<details><summary>Parameters and "
        "versions</summary>"
        f"<pre>{escape(json.dumps(result['parameters'], indent=1, ensure_ascii=False))}</pre>"
        f'<p class="note">{escape(versions)}; {escape(result["machine"])}</p></details></section>'
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
    add_engine(parser)
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    folder, codes = Path(options.out), [0]
    for name in options.only:
        if name not in EXPERIMENTS:
            raise UnknownName("experiment", name, EXPERIMENTS)
    missing = [name for name in options.only if options.again or not _made(folder / name)]
    for file in (folder / "report.html", *(folder / name / "result.json" for name in missing)):
        check_writable(file)
    with lock_folder(folder):  # it is there for them, and gone again if they leave nothing
        for name in missing:
            print(
                f"Experiment {options.only.index(name) + 1} of {len(options.only)}: "
                f"{EXPERIMENTS[name].title} ({name})",
                flush=True,
            )
            code = importlib.import_module(f"experiments.{name}").main(
                _words(name, options, folder)
            )
            if code == INTERRUPTED:
                return code
            codes.append(code)
        finished = [name for name in options.only if os.path.isfile(folder / name / "result.json")]
        for name in set(options.only) - set(finished):
            print(
                f"{EXPERIMENTS[name].title} ({name}) could not be made and is not on the page.",
                file=sys.stderr,
            )
        if not finished:
            return max(codes)
        write_text(folder / "report.html", page([folder / name for name in finished]))
    print(f"Written to {folder / 'report.html'}.")
    return max(codes)


def _words(name: str, options: argparse.Namespace, folder: Path) -> list[str]:
    entry = EXPERIMENTS[name]
    engine = [] if options.engine == "pinocchio" else ["--engine", options.engine]
    return [*(entry.quick if options.quick else entry.arguments), *engine, f"--out={folder / name}"]


if __name__ == "__main__":
    sys.exit(main())
