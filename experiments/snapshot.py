"""Pictures of a recording.

``python -m experiments.snapshot RECORDING -t 0 8 -o DIR`` writes one PNG for each time [s],
``python -m experiments.snapshot RECORDING --gif START END FILE`` a moving one. No display is
needed.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress

from cranedyn.checks import number
from cranedyn.command import Parser, command
from cranedyn.data.files import atomic_write_set, lock_folder
from cranedyn.recording.snapshot import animate, snapshot
from experiments.harness.arguments import command_name


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0, or 2 for bad arguments, a file that is no recording, or where there is nothing
    to draw with.
    """
    parser = Parser(
        prog=command_name("snapshot"), description="Pictures of a recording, without a display."
    )
    parser.add_argument("recording", metavar="RECORDING", type=Path, help="the .rrd file")
    parser.add_argument(
        "-t",
        "--times",
        metavar="T",
        type=float,
        nargs="+",
        default=[],
        help="when to take a picture [s]",
    )
    parser.add_argument(
        "-o",
        "--out",
        metavar="DIR",
        type=Path,
        default=Path("out/snapshot"),
        help="where to put the pictures (default: %(default)s)",
    )
    parser.add_argument(
        "--gif",
        metavar=("START", "END", "FILE"),
        nargs=3,
        help="write a moving picture of a span [s]",
    )
    parser.add_argument(
        "--fps",
        type=float,
        default=10.0,
        help="pictures per second of the moving one (default: %(default)g)",
    )
    parser.add_argument(
        "--view",
        choices=("dashboard", "3d"),
        default="dashboard",
        help="what to show (default: %(default)s)",
    )
    parser.add_argument(
        "--size",
        metavar=("WIDTH", "HEIGHT"),
        type=int,
        nargs=2,
        default=(1280, 720),
        help="in pixels (default: 1280 720)",
    )

    def run() -> int:
        options = parser.parse_args(arguments)
        if not options.times and not options.gif:
            parser.error("nothing to do: give times with -t or a span with --gif")
        # All pictures are written, or none.
        with lock_folder(options.out) if options.times else nullcontext(), atomic_write_set():
            paths = _write(options)
        print(*paths, sep="\n")
        return 0

    return command(run)


def _write(options: argparse.Namespace) -> list[Path]:
    paths: list[Path] = []
    arguments: Any = {"size": tuple(options.size), "dashboard": options.view == "dashboard"}
    with Progress(
        console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()
    ) as bar:
        task = bar.add_task("pictures", total=None)

        def progress(count: int) -> None:
            bar.update(task, completed=count, description=f"{count} pictures")

        if options.gif:
            start, end, file = options.gif
            span = number("START", start, "s"), number("END", end, "s")
            gif = animate(
                options.recording, span, file, fps=options.fps, progress=progress, **arguments
            )
            paths.append(gif)
        if options.times:
            paths[:0] = snapshot(
                options.recording, options.times, options.out, progress=progress, **arguments
            )
    return paths


if __name__ == "__main__":
    sys.exit(main())
