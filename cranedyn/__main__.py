"""The command ``cranedyn``: run an experiment, list them, look at a recording, describe or export a
crane.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType

from cranedyn import __version__
from cranedyn.command import Parser, command
from cranedyn.errors import CraneError, UnknownName

_PACKAGE = Path(__file__).resolve().parent

_HELP = """
  run NAME ...       an experiment with its arguments, as: run a1 --gravity 9.8
  list               the experiments, a line each
  view FILE.rrd      a recording in a window; with --serve in a browser of this machine
  describe ...       the crane as a plain URDF, as: describe payload_mass:=2000 -o crane.urdf
  export ...         the crane for other tools
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; its exit code, 2 for bad arguments."""
    parser = Parser(
        prog="cranedyn",
        description="A crane dynamics laboratory.",
        epilog="commands:" + _HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"cranedyn {__version__}")
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="one of the below")
    parser.add_argument(
        "rest", nargs=argparse.REMAINDER, metavar="...", help="its arguments; --help tells them"
    )
    options = parser.parse_args(argv)
    return COMMANDS[options.command](options.rest)


def _run(argv: Sequence[str]) -> int:
    parser = Parser(prog="cranedyn run", description="Run an experiment; cranedyn list names them.")
    parser.add_argument("name", metavar="NAME", help="of the experiment")
    parser.add_argument(
        "rest",
        nargs=argparse.REMAINDER,
        metavar="...",
        help="its arguments; run NAME --help tells them",
    )
    options = parser.parse_args(argv)
    names: list[str] = []

    def find() -> int:
        catalogue = _catalogue()
        known = [*catalogue.EXPERIMENTS, *catalogue.TOOLS]
        if options.name not in known:
            raise UnknownName("experiment", options.name, known)
        names.append(options.name)
        return 0

    return command(find) or int(
        importlib.import_module(f"experiments.{names[0]}").main(options.rest)
    )


def _list(argv: Sequence[str]) -> int:
    Parser(prog="cranedyn list", description="List the experiments.").parse_args(argv)

    def show() -> int:
        catalogue = _catalogue()
        for name, entry in catalogue.EXPERIMENTS.items():
            print(f"{name:15} {entry.line}")
        print()
        for name, line in catalogue.TOOLS.items():
            print(f"{name:15} {line}")
        return 0

    return command(show)


def _catalogue() -> ModuleType:
    """The experiments: inside the package once installed, beside it in a checkout; never those of
    somebody else.
    """
    folder = next(
        (one for one in (_PACKAGE / "_bundled", _PACKAGE.parent) if (one / "experiments").is_dir()),
        None,
    )
    if folder is None:
        raise CraneError(f"There are no experiments in {_PACKAGE}; install cranedyn again.")
    if str(folder) not in sys.path[:1]:
        sys.path.insert(0, str(folder))
    return importlib.import_module("experiments.catalogue")


def _view(argv: Sequence[str]) -> int:
    parser = Parser(prog="cranedyn view", description="Look at a recording.")
    parser.add_argument("file", metavar="FILE.rrd", type=Path, help="the recording")
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
    options = parser.parse_args(argv)
    if options.port is not None and not options.serve:
        parser.error("--port has no effect without --serve; leave it out")

    def look() -> int:
        from cranedyn import recording

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

    return command(look)


def _describe(argv: Sequence[str]) -> int:
    from cranedyn.model.description import main

    return main([*argv])


def _export(argv: Sequence[str]) -> int:
    home = "cranedyn.bridges.command"

    def find() -> int:
        if (
            importlib.util.find_spec("cranedyn.bridges") is None
            or importlib.util.find_spec(home) is None
        ):
            raise CraneError(
                "This cranedyn has no bridges to other tools; install one that has "
                "cranedyn.bridges."
            )
        return 0

    return command(find) or int(importlib.import_module(home).main([*argv]))


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "run": _run,
    "list": _list,
    "view": _view,
    "describe": _describe,
    "export": _export,
}
"""What stands behind each word; takes the words after it and gives the exit code."""


if __name__ == "__main__":
    sys.exit(main())
