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

from cranedyn.checks import number
from cranedyn.command import Parser, command, command_line, next_lines
from cranedyn.data.files import atomic_write_set, lock_folder
from cranedyn.recording.snapshot import animate, snapshot
from experiments.harness.progress import reporting


def main(arguments: list[str] | None = None) -> int:
    """Write pictures from the command line.

    Returns:
        0; 2 for bad arguments, a file that is no recording, or where there is nothing to draw with.
    """
    parser = Parser(
        prog="cranedyn snapshot",
        description="Pictures of a recording, without a display.",
        example="cranedyn snapshot out/a1/a1.rrd -t 10 -o out",
    )
    add = parser.add_argument
    add("recording", metavar="RECORDING", type=Path, help="the .rrd file")
    text = "when to take a picture [s]"
    add("-t", "--times", metavar="T", type=float, nargs="+", default=[], help=text)
    text = "where to put the pictures (default: %(default)s)"
    add("-o", "--out", metavar="DIR", type=Path, default=Path("out/snapshot"), help=text)
    text = "write a moving picture of a span [s]"
    add("--gif", metavar=("START", "END", "FILE"), nargs=3, help=text)
    text = "pictures per second of the moving one (default: %(default)g)"
    add("--fps", type=float, default=10.0, help=text)
    text = "what to show (default: %(default)s)"
    add("--view", choices=("dashboard", "3d"), default="dashboard", help=text)
    text = "in pixels (default: 1280 720)"
    pixels = ("WIDTH", "HEIGHT")
    add("--size", metavar=pixels, type=int, nargs=2, default=(1280, 720), help=text)

    def run() -> int:
        options = parser.parse_args(arguments)
        if not options.times and not options.gif:
            parser.error("nothing to do: give times with -t or a span with --gif")
        # All pictures are written, or none.
        with lock_folder(options.out) if options.times else nullcontext(), atomic_write_set():
            paths = _write(options)
        for path in paths:
            print(f"Written to {path}.")
        view = command_line("cranedyn", "view", options.recording)
        print(next_lines(view, f"{view} --serve"))
        return 0

    return command(run)


def _write(options: argparse.Namespace) -> list[Path]:
    """Write the pictures and the moving picture; return their files, the pictures first."""
    size = tuple(options.size)
    has_dashboard = options.view == "dashboard"
    moving: list[Path] = []
    pictures: list[Path] = []
    with reporting() as reporter:
        if options.gif:
            start_text, end_text, file = options.gif
            start = number("START", start_text, "s")
            end = number("END", end_text, "s")
            count = round((end - start) * options.fps)
            path = animate(
                options.recording,
                (start, end),
                file,
                fps=options.fps,
                size=size,
                dashboard=has_dashboard,
                progress=reporter.count("moving picture", count),
            )
            moving.append(path)
        if options.times:
            pictures += snapshot(
                options.recording,
                options.times,
                options.out,
                size=size,
                dashboard=has_dashboard,
                progress=reporter.count("pictures", len(options.times)),
            )
    return [*pictures, *moving]


if __name__ == "__main__":
    sys.exit(main())
