"""All experiments on one page: claims, tables beside the published numbers, figures, and how to make each again."""

from __future__ import annotations

import argparse
import base64
import importlib
import json
import os
import sys
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from cranedyn.command import INTERRUPTED, REFUSED, Parser, command
from cranedyn.data.files import check_writable, digest, parse_json, read_bytes, read_text, reserved, write_text
from cranedyn.errors import DataError, UnknownName
from experiments import harness
from experiments.harness.arguments import add_engine

EXPERIMENTS = {
    "a1": ["--gravity", "9.8"],
    "a2": ["--gravity", "9.8"],
    "a3": ["--gravity", "9.8"],
    "energy": [],
    "gazebo": [],
    "mass_ratio": [],
    "validate": [],
    "linear_vs_full": [],
    "b1": [],
    "cranes": [],
    "compare": [],
    "sweep": [],
    "lift": [],
    "demo": ["--cycles", "1", "--control", "flat"],
}
"""What the report is made of, in its order, and the arguments with which missing results are made."""

_LARGEST_FIGURE = 50_000_000
"""Most bytes of a figure."""

_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 3rem; border-top: 1px solid #8888; padding-top: 1rem; }
nav a { margin-right: 1rem; }
.table { overflow-x: auto; margin: 1rem 0; } table { border-collapse: collapse; font-size: 0.9rem; }
caption { text-align: left; font-weight: 600; padding: 0.3rem 0; }
th, td { border-bottom: 1px solid #8885; padding: 0.25rem 0.6rem; text-align: right; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
.note { font-size: 0.85rem; opacity: 0.8; }
li::marker { content: attr(data-mark) "  "; }
img { max-width: 100%; height: auto; background: white; border-radius: 4px; margin: 0.5rem 0; }
code, pre { background: #8882; border-radius: 4px; padding: 0.1rem 0.3rem; overflow-x: auto; }
"""


def page(folders: Sequence[Path]) -> str:
    """The report as one HTML document that needs nothing else.

    Args:
        folders: Folders of results, each with a ``result.json`` and figures.

    Raises:
        DataError: If a result cannot be read.
    """
    sections = [_result(folder) for folder in folders]
    links = " ".join(f'<a href="#{name}">{name}</a>' for name, _ in sections)
    texts = "\n".join(text for _, text in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>cranedyn: experiments</title><style>{_STYLE}</style></head><body>"
        f"<h1>cranedyn: experiments</h1><nav>{links}</nav>\n{texts}\n</body></html>\n"
    )


def _result(folder: Path) -> tuple[str, str]:
    """The name of an experiment and its section of the page."""
    file = folder / "result.json"
    try:
        result = parse_json(read_text(file))
        _check_set(folder, result["files"])
        return escape(result["experiment"]), _section(folder, result)
    except json.JSONDecodeError as error:
        raise DataError(f"Cannot read {file}: it is not JSON.") from error
    except OSError as error:
        raise DataError(f"Cannot read {error.filename}: {error.strerror}.") from error
    except (LookupError, TypeError, AttributeError, ValueError, RecursionError) as error:
        raise DataError(f"Cannot read {file}: it is not the result of an experiment ({type(error).__name__}: {error}).") from error


def _made(folder: Path) -> bool:
    """Whether a result is there, and every file that it lists; what is wrong with it otherwise is said when it is read."""
    file = folder / "result.json"
    try:
        return os.path.isfile(file) and all(os.path.isfile(folder / name) for name in parse_json(read_text(file))["files"])
    except (DataError, LookupError, TypeError, ValueError, RecursionError):
        return True


def _check_set(folder: Path, files: Mapping[str, str]) -> None:
    """Return if every file is the one that its run wrote."""
    for name, expected in files.items():
        if Path(name).name != name or not os.path.isfile(folder / name):
            raise ValueError(f"{name!r} is no file in its folder")
        if digest(folder / name) != expected:
            raise DataError(f"Cannot read {folder}: {name} there is of another run than its result.json; run it --again.")


def _section(folder: Path, result: dict[str, Any]) -> str:
    marks = {True: "✔", False: "✘", None: "–"}
    claims = "".join(f'<li data-mark="{marks[c["holds"]]}">{escape(c["sentence"])}</li>' for c in result["claims"])
    if strange := set(result["figures"]) - set(result["files"]):
        raise ValueError(f"its figures {sorted(strange)} are not among its files")
    figures = "".join(_figure(folder, name) for name in result["figures"])
    versions = ", ".join(f"{name} {version}" for name, version in result["versions"].items() if version)
    name = escape(result["experiment"])
    return (
        f'<section id="{name}"><h2>{name}</h2><p>{escape(result["about"])}</p><ul>{claims}</ul>'
        f"{''.join(map(_table, result['tables']))}{figures}"
        f"<p>Again: <code>{escape(result['command'])}</code></p>"
        "<details><summary>Parameters and "
        f"versions</summary><pre>{escape(json.dumps(result['parameters'], indent=1, ensure_ascii=False))}</pre>"
        f'<p class="note">{escape(versions)}; {escape(result["machine"])}</p></details></section>'
    )


def _table(table: dict[str, Any]) -> str:
    made = harness.Table.of(table)
    head = "".join(f"<th>{escape(header)}</th>" for header in table["columns"])
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in made.shown())
    note = f'<p class="note">{escape(made.note)}</p>' if made.note else ""
    rows = f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody>"
    return f'<div class="table"><table><caption>{escape(made.title)}</caption>{rows}</table></div>{note}'


def _figure(folder: Path, name: str) -> str:
    if Path(name).name != name or Path(name).suffix != ".png":
        raise ValueError(f"{name!r} is no figure in its folder")
    data = base64.b64encode(read_bytes(folder / name, _LARGEST_FIGURE)).decode("ascii")
    return f'<img alt="{escape(Path(name).stem)}" src="data:image/png;base64,{data}">'


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is missing, write the page; 0, or the first code of an experiment that is not 0."""
    parser = Parser(prog="python -m experiments.report", description="All experiments on one page, report.html.")
    parser.add_argument(
        "--out", metavar="DIR", default="out", help="folder of all results, one folder inside for each experiment (default out)"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", default=list(EXPERIMENTS), help="which experiments (default all)")
    parser.add_argument("--again", action="store_true", help="run experiments whose results are there already, too")
    add_engine(parser)
    return command(lambda: _main(parser.parse_args(argv)))


def _main(options: argparse.Namespace) -> int:
    folder, codes = Path(options.out), [0]
    engine = [] if options.engine == "pinocchio" else ["--engine", options.engine]
    for name in options.only:
        if name not in EXPERIMENTS:
            raise UnknownName("experiment", name, EXPERIMENTS)
    missing = [name for name in options.only if options.again or not _made(folder / name)]
    for file in (folder / "report.html", *(folder / name / "result.json" for name in missing)):
        check_writable(file)
    with reserved(folder):  # it is there for them, and gone again if they leave nothing
        for name in missing:
            code = importlib.import_module(f"experiments.{name}").main([*EXPERIMENTS[name], *engine, f"--out={folder / name}"])
            if code in (INTERRUPTED, REFUSED):
                return code
            codes.append(code)
        write_text(folder / "report.html", page([folder / name for name in options.only]))
    print(f"Written to {folder / 'report.html'}.")
    return max(codes)


if __name__ == "__main__":
    sys.exit(main())
