"""The command line of a benchmark: how often to measure, and where tables and figure go."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from cranedyn.command import command
from cranedyn.data.files import make_folder
from cranedyn.plotting.figures import save
from experiments.harness.document import read_document
from experiments.harness.outcome import Outcome, ResultTable, show

Results = tuple[Sequence[ResultTable], Callable[[], Figure]]
"""Tables of a benchmark, and the function that measures and draws its figure."""

Benchmark = Callable[[int, bool], Results]
"""From the number of rounds and whether to be quick to the tables, and to what measures and draws
the figure if one is asked for."""


def conduct(
    name: str,
    about: str | None,
    benchmark: Benchmark,
    argv: Sequence[str] | None = None,
    *,
    rounds: int = 7,
) -> int:
    """Measure, print, and write what the command line asks for.

    Returns:
        0, 2 for bad arguments or files, 130 if interrupted.
    """
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=about)
    parser.add_argument(
        "--rounds",
        type=_rounds,
        default=rounds,
        metavar="N",
        help=f"how often each is measured (default {rounds})",
    )
    parser.add_argument(
        "--quick", action="store_true", help="measure less of each, and less precisely"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help=f"write the figure {name}.png there"
    )
    _add_document(parser, name)
    options = parser.parse_args(argv)
    return command(lambda: _conducted(name, benchmark, options))


def print_tables(
    name: str,
    about: str | None,
    measure: Callable[[argparse.Namespace], Sequence[ResultTable]],
    argv: Sequence[str] | None,
    **arguments: dict[str, Any],
) -> int:
    """Measure, print tables, and write them to the page that the command line names.

    Args:
        name: Name of the benchmark.
        about: Its documentation.
        measure: Function from the options to the tables.
        argv: Arguments of the command line.
        arguments: Further options and what `add_argument` takes for them.

    Returns:
        0, 2 for bad arguments or files, 130 if interrupted.
    """
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{name}", description=about)
    for option, settings in arguments.items():
        parser.add_argument(f"--{option}", **settings)
    _add_document(parser, name)
    options = parser.parse_args(argv)

    def run() -> int:
        tell = _teller(name, options)
        tell(measure(options))
        return 0

    return command(run)


def _add_document(parser: argparse.ArgumentParser, name: str) -> None:
    parser.add_argument(
        "--document",
        metavar="FILE.md",
        help=f"put the tables between their marks <!-- {name}: title --> there",
    )


def _teller(name: str, options: argparse.Namespace) -> Callable[[Sequence[ResultTable]], None]:
    """Return a function that prints tables and writes them to the page named on the command line.

    Raises:
        DataError: At once if that is no such page, before anything is measured.
    """
    document = read_document(options.document, name) if options.document else None

    def tell(tables: Sequence[ResultTable]) -> None:
        show(Outcome(tables, ()))
        if document is not None:
            document.write(tables)

    return tell


def _conducted(name: str, benchmark: Benchmark, options: argparse.Namespace) -> int:
    tell = _teller(name, options)
    folder = make_folder(options.out) if options.out else None
    tables, figure = benchmark(options.rounds, options.quick)
    tell(tables)
    if folder is not None:
        print(f"Written to {save(figure(), folder / f'{name}.png')}.")
    return 0


def _rounds(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is no number of rounds; it must be 1 or more")
    return int(text)
