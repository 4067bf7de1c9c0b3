"""The command ``cranedyn``: run and list experiments, view a recording, describe or export a
crane.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cranedyn import __version__, plugins
from cranedyn.command import Parser, command


class _Parser(Parser):
    """A parser that gets its arguments when it parses: no command imports what another one needs.

    Attributes:
        configure: Function that adds the arguments and sets `run`, a function of the options.
    """

    configure: Callable[[_Parser], None] | None = None

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Add the arguments, and parse as argparse does."""
        configure, self.configure = self.configure, None
        if configure is not None:
            configure(self)
        return super().parse_known_args(args, namespace)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, 2 for bad arguments."""
    parser = _Parser(prog="cranedyn", description="A crane dynamics laboratory.")
    parser.add_argument("--version", action="version", version=f"cranedyn {__version__}")
    commands = parser.add_subparsers(required=True, dest="command", metavar="COMMAND")
    for name, configure in COMMANDS.items():
        text = (configure.__doc__ or "").strip()
        commands.add_parser(name, help=text, description=text).configure = configure
    return command(lambda: _run(parser.parse_args(argv)))


def _run(options: argparse.Namespace) -> int:
    return int(options.run(options))


def _experiment(parser: _Parser) -> None:
    """Run an experiment, as: run a1 --gravity 9.8; list names them."""
    parser.add_argument("name", metavar="NAME", help="of the experiment")
    parser.add_argument(
        "arguments",
        nargs=argparse.REMAINDER,
        metavar="...",
        help="its arguments; run NAME --help lists them",
    )
    parser.set_defaults(
        run=lambda options: plugins.load("experiment", options.name).main(options.arguments)
    )


def _list(parser: _Parser) -> None:
    """List the experiments."""

    def run(options: argparse.Namespace) -> int:
        for name in plugins.names("experiment"):
            text = f"{name:15} {plugins.description('experiment', name)}"
            print(textwrap.fill(text, 80, subsequent_indent=" " * 16))
        return 0

    parser.set_defaults(run=run)


def _view(parser: _Parser) -> None:
    """View a recording, in a window or in a browser of this machine, or write a run as a film."""
    parser.add_argument("file", metavar="FILE", type=Path, help="recording, or .parquet of a run")
    parser.add_argument(
        "--film", metavar="FILE.mp4", type=Path, help="film of the run in a .parquet"
    )
    parser.add_argument(
        "--serve", action="store_true", help="in a browser on this machine, until Ctrl-C"
    )
    parser.add_argument(
        "--port",
        type=int,
        default=None,
        metavar="P",
        help="of the page, default 9090; the data is at the next port",
    )

    def run(options: argparse.Namespace) -> int:
        from cranedyn import recording
        from cranedyn.data.trajectory import read
        from cranedyn.model.load import load_crane

        if options.film:
            if options.file.suffix != ".parquet":
                parser.error(f"a film needs the .parquet of a run, as {options.file} is not")
            if options.serve:
                parser.error("--serve has no effect beside --film; leave it out")
            recording.check_film(options.film)
            run = read(options.file)
            crane = load_crane(from_record=run.record)
            recording.film(options.film, [recording.Run(options.file.stem, crane, run)])
            print(f"Written to {options.film}.")
            return 0
        if options.port is not None and not options.serve:
            parser.error("--port has no effect without --serve; leave it out")
        if not options.serve:
            recording.open_viewer(options.file)
            return 0
        with (
            recording.serve(
                options.file, port=9090 if options.port is None else options.port
            ) as served,
            contextlib.suppress(KeyboardInterrupt),
        ):
            print(served.message, flush=True)
            served.wait()
        return 0

    parser.set_defaults(run=run)


def _describe(parser: _Parser) -> None:
    """Describe a crane: its joints, or with -o FILE its plain URDF.

    The crane is that of this project, as: describe payload_mass:=2000 -o crane.urdf; or another
    one, as: describe --urdf crane.xacro --swing.
    """
    from cranedyn.model import description
    from cranedyn.model.options import add_crane_options, load_options

    description.add_arguments(parser)
    add_crane_options(parser)

    def run(options: argparse.Namespace) -> int:
        arguments = load_options(options)
        if not arguments:
            return description.write_description(options)
        from cranedyn.model.load import load_crane

        crane = load_crane(**arguments, values=description.parse_values(options.values))
        print(crane)
        if options.output:
            description.write_urdf(crane.urdf, options.output)
        return 0

    parser.set_defaults(run=run)


def _export(parser: _Parser) -> None:
    """Write a crane, or a run, for another program."""
    exporters = parser.add_subparsers(required=True, dest="exporter", metavar="EXPORTER")
    for name in plugins.names("exporter"):
        text = plugins.description("exporter", name)
        exporter = exporters.add_parser(
            name,
            help=text,
            description=text,
            formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        )
        exporter.configure = lambda parser, name=name: _exporter(parser, name)


def _exporter(parser: _Parser, name: str) -> None:
    from cranedyn.model.crane import STANDARD_GRAVITY
    from cranedyn.model.description import add_values
    from cranedyn.model.options import add_crane_options

    exporter = plugins.load("exporter", name)
    parser.add_argument(
        "target",
        type=Path,
        metavar=exporter.TARGET,
        help="where to write; it must not be there yet",
    )
    add_crane_options(parser)
    parser.add_argument(
        "--gravity",
        type=float,
        default=STANDARD_GRAVITY,
        metavar="G",
        help="gravity of the world [m/s²]",
    )
    add_values(parser, "numbers of the crane")
    exporter.add_arguments(parser)

    def run(options: argparse.Namespace) -> int:
        print(f"Written to {exporter.run(options)}.")
        return 0

    parser.set_defaults(run=run)


COMMANDS: dict[str, Callable[[_Parser], None]] = {
    "run": _experiment,
    "list": _list,
    "view": _view,
    "describe": _describe,
    "export": _export,
}
"""Function by the name of its command; it adds the arguments and sets what runs it, and its
docstring is the help."""


if __name__ == "__main__":
    sys.exit(main())
