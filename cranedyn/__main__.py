"""The command ``cranedyn``: run, list and report experiments, view a recording, describe or export
a crane, verify and sign a lift plan.

`COMMANDS` has one function for each command, which adds its arguments and sets the function that
runs it. What a command needs is imported in these functions only, so that each starts fast.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import webbrowser
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cranedyn import __version__, plugins
from cranedyn.command import (
    FAILED,
    REFUSED,
    Parser,
    command,
    command_line,
    next_lines,
    open_line,
)

if TYPE_CHECKING:
    from cranedyn.recording import Run


class _Parser(Parser):
    """A parser that gets its arguments when it parses, so that no command imports what another one
    needs.

    Attributes:
        configure: Function that adds the arguments and sets `run`, a function of the options that
            returns the exit code; None once it has been called.
    """

    configure: Callable[[_Parser], None] | None = None

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Add the arguments, and parse as argparse does."""
        configure = self.configure
        self.configure = None
        if configure is not None:
            configure(self)
        return super().parse_known_args(args, namespace)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, 2 for bad arguments."""
    parser = _Parser(
        prog="cranedyn", description="A crane dynamics laboratory.", example="cranedyn run a1"
    )
    parser.add_argument("--version", action="version", version=f"cranedyn {__version__}")
    commands = parser.add_subparsers(required=True, dest="command", metavar="COMMAND")
    for name, configure in COMMANDS.items():
        # The docstring of the function is the help: a sentence, and an example after a blank line.
        text, _, example = (configure.__doc__ or "").strip().partition("\n\n")
        example = example.strip().removeprefix("Example: ")
        subparser = commands.add_parser(name, help=text, description=text, example=example)
        subparser.configure = configure
    arguments = sys.argv[1:] if argv is None else argv

    def run() -> int:
        """Run the command that the arguments name."""
        options = parser.parse_args(arguments or ["--help"])
        return int(options.run(options))

    return command(run)


def _experiment(parser: _Parser) -> None:
    """Run an experiment; list names them.

    Example: cranedyn run a1 --gravity 9.8
    """
    parser.add_argument("name", metavar="NAME", help="of the experiment")
    parser.add_argument(
        "arguments",
        nargs=argparse.REMAINDER,
        metavar="...",
        help="its arguments; run NAME --help lists them",
    )

    def run(options: argparse.Namespace) -> int:
        """Run the experiment, which returns the exit code."""
        return int(plugins.load("experiment", options.name).main(options.arguments))

    parser.set_defaults(run=run)


def _list(parser: _Parser) -> None:
    """List the experiments by subject, with duration and content.

    Example: cranedyn list
    """
    _delegate(parser, "list")


def _report(parser: _Parser) -> None:
    """Put all experiments on one page, report.html.

    Example: cranedyn report --quick
    """
    _delegate(parser, "report")


def _snapshot(parser: _Parser) -> None:
    """Take pictures or a GIF of a recording.

    Example: cranedyn snapshot out/a1/a1.rrd -t 10
    """
    _delegate(parser, "snapshot")


def _delegate(parser: _Parser, name: str) -> None:
    """Hand all arguments, options among them, to the module of a command, which parses them."""
    parser.prefix_chars = ""  # no argument is an option of this parser
    parser.add_argument("arguments", nargs=argparse.REMAINDER)

    def run(options: argparse.Namespace) -> int:
        """Run the command, which returns the exit code."""
        return int(plugins.load("command", name).main(options.arguments))

    parser.set_defaults(run=run)


def _view(parser: _Parser) -> None:
    """View a recording or a run, in a window or a browser of this machine, or as a film.

    Example: cranedyn view out/a1/a1.rrd --serve
    """
    from cranedyn.model.options import add_crane_options, add_values

    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="recording (.rrd), or run (.parquet or .csv)")
    add("--film", metavar="FILE.mp4", type=Path, help="write a film of the run")
    add("--serve", action="store_true", help="in a browser on this machine, until Ctrl-C")
    add(
        "--port",
        type=int,
        metavar="P",
        help="of the page, default 9090; the data is at the next port",
    )
    # A .csv does not say of which crane it is.
    add_crane_options(parser.common)
    add_values(parser.common, "numbers of the crane of a .csv")
    parser.set_defaults(run=partial(_run_view, parser))


def _run_view(parser: _Parser, options: argparse.Namespace) -> int:
    """Write the film that the options ask for, or show the recording, and return the exit code."""
    from cranedyn import recording

    if options.port is not None and not options.serve:
        parser.error("--port has no effect without --serve; leave it out")
    if options.film and options.serve:
        parser.error("--serve has no effect beside --film; leave it out")
    is_run = options.file.suffix in (".csv", ".parquet")
    if options.film:
        if not is_run:
            parser.error(f"a film needs a run, .parquet or .csv, which {options.file} is not")
        _write_film(options)
        return 0
    file = options.file
    # The times of a recording that is there already are not known here.
    picture = "cranedyn snapshot --help"
    if is_run:
        run = _read_run(options)
        file = _write_recording(run)
        print(f"Written to {file}.")
        t = run.trajectory.t
        middle = f"{(t[0] + t[-1]) / 2.0:.6g}"
        picture = command_line("cranedyn", "snapshot", file, "-t", middle)
    if not options.serve:
        recording.open_viewer(file)
        other_view = command_line("cranedyn", "view", file, "--serve")
    else:
        port = 9090 if options.port is None else options.port
        with recording.serve(file, port=port) as served, contextlib.suppress(KeyboardInterrupt):
            print(served.message, flush=True)
            served.wait()
        other_view = command_line("cranedyn", "view", file)
    print(next_lines(other_view, picture))
    return 0


def _read_run(options: argparse.Namespace) -> Run:
    """Read a run from its file, with the crane that the options name."""
    from cranedyn import recording
    from cranedyn.data.trajectory import read
    from cranedyn.model.options import crane_of_run

    trajectory = read(options.file)
    crane = crane_of_run(options, trajectory, options.file)
    return recording.Run(options.file.stem, crane, trajectory)


def _write_film(options: argparse.Namespace) -> None:
    """Write the film of a run, and print its file."""
    from cranedyn.model.options import crane_words
    from cranedyn.progress import bar
    from cranedyn.recording.film import check_film, film

    # Before the run is read, which may take long.
    check_film(options.film)
    run = _read_run(options)
    t = run.trajectory.t
    with bar("film", float(t[-1] - t[0])) as show_time:
        film(options.film, [run], progress=show_time)
    print(f"Written to {options.film}.")
    words = crane_words(options, gravity=False)
    print(
        next_lines(open_line(options.film), command_line("cranedyn", "view", options.file, *words))
    )


def _write_recording(run: Run) -> Path:
    """Write the recording of a run into ``out/view``, and return its file."""
    from cranedyn import recording
    from cranedyn.data.files import lock_folder
    from cranedyn.progress import bar

    file = Path("out/view", f"{run.name}.rrd")
    with lock_folder(file.parent), bar("recording"):
        return recording.record(file, [run], title=run.name)


def _describe(parser: _Parser) -> None:
    """Print the joints of a crane, and write its plain URDF.

    Example: cranedyn describe payload_mass:=2000 -o crane.urdf
    """
    from cranedyn.model.options import add_crane_options, add_gravity

    add = parser.add_argument
    text = "arguments of the xacro file"
    add("values", nargs="*", metavar="name:=value", help=text)
    add("-o", "--output", metavar="FILE", help="write the URDF to this file")
    text = "list the arguments with default, unit, range and meaning"
    add("--list", action="store_true", help=text)
    add("--machines", action="store_true", help="list the real cranes of the library")
    add_crane_options(parser)
    add_gravity(parser)
    parser.set_defaults(run=_run_describe)


def _run_describe(options: argparse.Namespace) -> int:
    """Print what the options ask for, a list or a crane, and return the exit code."""
    from cranedyn.errors import DataError

    for flag in ("list", "machines"):
        if getattr(options, flag) and (options.values or options.output):
            raise DataError(f"--{flag} takes no values and no output; leave them out.")
    if options.list:
        _print_arguments(options)
    elif options.machines:
        _print_machines()
    else:
        _print_crane(options)
    return 0


def _print_arguments(options: argparse.Namespace) -> None:
    """Print the arguments of the xacro file of a crane."""
    from cranedyn.model.description import arguments
    from cranedyn.model.machines import read_machine
    from cranedyn.model.options import crane_words

    file = options.urdf
    if options.machine is not None:
        file = read_machine(options.machine).urdf
    listed = arguments() if file is None else arguments(file)
    for name, argument in listed.items():
        print(
            f"{name:17} {argument.default:>9} {argument.unit:11} {argument.allowed:5} "
            f"{argument.meaning}"
        )
    words = crane_words(options)
    for name, argument in listed.items():
        if argument.default:
            # The next commands show how a value is given, with the first argument that has one.
            words += ["--set", f"{name}:={argument.default}"]
            break
    print(_next_of_crane(words))


def _print_machines() -> None:
    """Print the real cranes of the library."""
    from cranedyn.model.machines import machine_names, read_machine

    names = machine_names()
    for name in names:
        machine = read_machine(name)
        print(f"{machine.name:19} {machine.title} ({machine.source})")
    print(_next_of_crane(["--machine", names[0]]))


def _print_crane(options: argparse.Namespace) -> None:
    """Print the joints of a crane, and write its plain URDF where the options ask for it."""
    from cranedyn.data.files import write_text
    from cranedyn.model.options import crane_from_options, crane_words

    crane = crane_from_options(options)
    if options.output:
        # Before anything is printed, as an output that cannot be written is refused in one line.
        write_text(options.output, crane.urdf)
    print(crane)
    if options.output:
        print(f"Written to {options.output}.")
    print(_next_of_crane(crane_words(options)))


def _next_of_crane(words: list[str]) -> str:
    """Return the lines that name the next commands for a crane.

    Args:
        words: Words of a command line that name the crane.
    """
    return next_lines(
        command_line("cranedyn", "drive", *words),
        command_line("cranedyn", "export", "mjcf", "crane.xml", *words),
    )


def _record_template(parser: _Parser) -> None:
    """Print what to measure with a phone and a tape, or make a record of it.

    Example: cranedyn record-template swing_1.csv --gyroscope phone_1.csv 12.4
    """
    add = parser.add_argument
    text = "a template to fill in, or the record of a gyroscope"
    add("file", nargs="?", metavar="FILE.csv", help=text)
    text = "file of the app phyphox or Sensor Logger, and the cable length of its swing [m]"
    add("--gyroscope", nargs=2, metavar=("PHONE.csv", "L"), help=text)

    def run(options: argparse.Namespace) -> int:
        from cranedyn.identification.phone import RECIPE, write_gyroscope_record, write_template

        if options.gyroscope is None:
            print(RECIPE, end="")
            if options.file is None:
                template = command_line("cranedyn", "record-template", "swing_1.csv")
                print(next_lines(template, "cranedyn record-template --help"))
                return 0
            write_template(options.file)
            remark = "  # once it is filled in"
        elif options.file is None:
            parser.error("--gyroscope needs FILE.csv")
        else:
            write_gyroscope_record(options.file, *options.gyroscope)
            remark = ""
        print(f"Written to {options.file}.")
        identify = command_line("cranedyn", "run", "identify", options.file)
        analyse = command_line("cranedyn", "run", "a1", "--from", options.file)
        print(next_lines(identify + remark, analyse + remark))
        return 0

    parser.set_defaults(run=run)


def _template(parser: _Parser) -> None:
    """Write a commented file to begin with: a site, a load chart, or the lifts of several cranes.

    Example: cranedyn template site yard.toml
    """
    from cranedyn.lifts.planning.file_templates import CRANE_KINDS, TEMPLATES
    from cranedyn.lifts.planning.site_file import CHART_EXAMPLES

    kinds = "; ".join(f"{name}: {meaning}" for name, meaning in TEMPLATES.items())
    add = parser.add_argument
    add("template", choices=tuple(TEMPLATES), metavar="TEMPLATE", help=kinds)
    text = "where to write; it must not be there yet, by default TEMPLATE.toml"
    add("file", nargs="?", type=Path, metavar="FILE.toml", help=text)
    crane_kinds = CRANE_KINDS["site"]
    listed = ", ".join(crane_kinds)
    text = f"with site or chart: kind of the crane, {listed}; by default {crane_kinds[0]}"
    add("--kind", choices=crane_kinds, metavar="CRANE", help=text)
    text = f"with chart: instead a chart that comes with the package: {', '.join(CHART_EXAMPLES)}"
    add("--of", choices=CHART_EXAMPLES, metavar="CHART", help=text)
    parser.set_defaults(run=_run_template)


def _run_template(options: argparse.Namespace) -> int:
    """Write the template, say how to go on, and return the exit code."""
    from cranedyn.lifts.planning.file_templates import write_file_template, write_new_file

    file = options.file or Path(f"{options.template}.toml")
    if options.of is None:
        write_file_template(options.template, file, options.kind)
        print(f"Written to {file}. All values in it are examples: enter yours.")
    elif options.template == "chart":
        from cranedyn.data.files import read_text
        from cranedyn.lifts.judging.chart import CHARTS

        write_new_file(file, read_text(CHARTS / f"{options.of}.toml"))
        print(f"Written to {file}. Compare every number with the chart of your machine.")
    else:
        from cranedyn.errors import CraneError

        raise CraneError(f"--of is for a chart; a template of {options.template} has none.")
    remark = "  # once it is filled in"
    if options.template == "site":
        judge = command_line("cranedyn", "run", "lift_report", "--site", file)
        print(next_lines(command_line("cranedyn", "drive", "--site", file), judge + remark))
    elif options.template == "chart":
        # The chart counts for the crane of a site; without one an example yard would be judged.
        judge_words = ("--site", "site.toml", "--chart", file)
        judge = command_line("cranedyn", "run", "lift_report", *judge_words)
        kind = () if options.kind is None else ("--kind", options.kind)
        site = command_line("cranedyn", "template", "site", *kind)
        print(next_lines(site, judge + remark))
    elif options.template == "chain":
        words = ("--site", "open_yard", "--chain", file, "--set", "hoist_max:=30")
        chain = command_line("cranedyn", "run", "lift", *words)
        print(next_lines(chain + remark, "cranedyn template site"))
    else:
        experiment = "tandem" if options.template == "tandem" else "site"
        plan = command_line("cranedyn", "run", experiment, "--site", file)
        print(next_lines(plan + remark, "cranedyn template chart"))
    return 0


def _export(parser: _Parser) -> None:
    """Write a crane, or a run, for another program.

    Example: cranedyn export mjcf crane.xml
    """
    exporters = parser.add_subparsers(required=True, dest="exporter", metavar="EXPORTER")
    for name in plugins.names("exporter"):
        # A percent sign begins a format of argparse.
        text = plugins.description("exporter", name).replace("%", "%%")
        exporter = exporters.add_parser(name, help=text, description=text)
        exporter.configure = partial(_configure_exporter, name)


def _configure_exporter(name: str, parser: _Parser) -> None:
    """Add the arguments of an exporter, which are those of its module beside target and crane."""
    from cranedyn.export.target import check_free
    from cranedyn.progress import bar

    exporter = plugins.load("exporter", name)
    parser.example += f" {getattr(exporter, 'EXAMPLE', exporter.TARGET)}"
    parser.add_argument(
        "target",
        type=Path,
        metavar=exporter.TARGET,
        help="where to write; it must not be there yet",
    )
    _add_crane(parser)
    exporter.add_arguments(parser)

    def run(options: argparse.Namespace) -> int:
        # Before anything is computed, which may take long.
        check_free(options.target)
        _open_own_controller(options)
        with bar(f"export {name}"):
            written = exporter.run(options)
        print(f"Written to {written}.")
        # Exporters of other packages need not name any.
        if hasattr(exporter, "next_commands"):
            print(next_lines(*exporter.next_commands(options)))
        return 0

    parser.set_defaults(run=run)


def _open_own_controller(options: argparse.Namespace) -> None:
    """Put a controller of one's own, which the options of an exporter name by its file, in the
    place of this name.

    Raises:
        CraneError: If the file cannot be opened.
    """
    named = getattr(options, "controller", None)
    if not isinstance(named, str):
        return
    from cranedyn.interop.controller_file import is_controller_file, open_controller

    if is_controller_file(named):
        options.controller = open_controller(named)


def _drive(parser: _Parser) -> None:
    """Drive a crane by keyboard, gamepad or mouse, in the browser.

    Example: cranedyn drive --set payload_mass:=2000
    """
    from cranedyn.data.files import lock_folder
    from cranedyn.export import driving_page
    from cranedyn.progress import bar

    _add_crane(parser)
    driving_page.add_arguments(parser)

    def run(options: argparse.Namespace) -> int:
        options.target = file = Path("out/drive/crane.html")
        with lock_folder(file.parent):
            file.unlink(missing_ok=True)
            with bar("page"):
                driving_page.run(options)
        print(f"Written to {file}. It needs no network; copy it where you like.")
        print(next_lines(*driving_page.next_commands(options)))
        webbrowser.open(file.absolute().as_uri())
        return 0

    parser.set_defaults(run=run)


def _serve(parser: _Parser) -> None:
    """Serve a crane with drive words by OPC UA and Modbus, for virtual commissioning.

    Example: cranedyn serve --opcua 127.0.0.1:4840 --map words.csv
    """
    from cranedyn.interop.commissioning import serve

    _add_crane(parser)
    serve.add_arguments(parser)
    parser.set_defaults(run=serve.run)


def _verify(parser: _Parser) -> None:
    """Say whether a lift plan is still what it was: documents, inputs, result.

    Example: cranedyn verify out/lift_report/lift.pdf --quick
    """
    add = parser.add_argument
    text = "a document of the plan, or its record: lift.pdf, lift.html or lift.json"
    add("file", metavar="FILE", type=Path, help=text)
    text = "the site file as it is now; the one beside the plan, or the example"
    add("--site", metavar="FILE", type=Path, help=text)
    add("--chart", metavar="FILE", type=Path, help="the chart of the option --chart, likewise")
    text = "the crane of the option --crane; a .xacro file runs code, so trust it before"
    add("--crane", metavar="FILE", type=Path, help=text)
    text = "judge what the plan records, and leave the files on the disk alone"
    add("--recorded", action="store_true", help=text)
    text = "do not judge the lift again; compare documents and inputs only"
    add("--quick", action="store_true", help=text)
    parser.set_defaults(run=partial(_run_verify, parser))


def _run_verify(parser: _Parser, options: argparse.Namespace) -> int:
    """Verify a plan, print the checks, and return 0 if it is the same, 1 if not, 2 if that cannot
    be judged.
    """
    from cranedyn.lifts.judging.verify_plan import NamedFiles, verify
    from cranedyn.progress import bar
    from cranedyn.verdict import Verdict, overall

    # A lift is judged in three stages: plan, perturbed lifts, wind.
    with bar("verify", 3.0) as show_stages:
        judge_plan = plugins.load("experiment", "lift_report").judge_plan
        checks = verify(
            options.file,
            partial(judge_plan, progress=show_stages),
            NamedFiles(options.site, options.chart, options.crane),
            compare_disk=not options.recorded,
            recompute=not options.quick,
        )
    for check in checks:
        print(f"{check.verdict.word:11}{check.sentence}")
    if options.recorded:
        print("Left out: whether the inputs on the disk are those that were judged.")
    if options.quick:
        print("Left out: whether the lift, judged again, gives the same result.")
    verdict = overall(checks)
    print({Verdict.HOLDS: "Same.", Verdict.FAILS: "Different."}.get(verdict, "Not judged."))
    record = options.file.with_suffix(".json")
    sign = command_line("cranedyn", "sign", record, "--by", "NAME")
    judge = command_line("cranedyn", "run", "lift_report", "--help")
    print(next_lines(sign if verdict is Verdict.HOLDS else judge, "cranedyn verify --help"))
    return {Verdict.HOLDS: 0, Verdict.FAILS: FAILED}.get(verdict, REFUSED)


def _sign(parser: _Parser) -> None:
    """Note that somebody accepts a lift plan, so that it is never written over.

    Example: cranedyn sign out/lift_report/lift.json --by "A. Planner"
    """
    from cranedyn.lifts.judging.plan_record import ROLES

    add = parser.add_argument
    add("file", metavar="FILE", type=Path, help="the record of the plan, lift.json")
    add("--by", metavar="NAME", required=True, help="who accepts it")
    add("--role", choices=ROLES, default=ROLES[0], help="as what")
    parser.set_defaults(run=_run_sign)


def _run_sign(options: argparse.Namespace) -> int:
    """Note a signature in the record of a plan."""
    from cranedyn.lifts.judging.plan_folder import sign_plan
    from cranedyn.lifts.planning.site_file import SITE_EXAMPLES

    record = sign_plan(options.file, options.by, options.role)
    signature = record.signatures[-1]
    print(
        f"{signature.name} ({signature.role}) accepts revision {record.revision} on "
        f"{signature.date}. Digest: {record.digest}."
    )
    print(
        "This is a note of who accepted which digest, and no cryptographic signature: whoever can "
        "change the file can change the note. Write the digest on the paper that you sign."
    )
    words = ["cranedyn", "verify", options.file.with_suffix(".json")]
    site = record.inputs.options.site
    # A site file of one's own is looked for beside the plan, and most often lies elsewhere.
    if site not in SITE_EXAMPLES and not (options.file.parent / site).is_file():
        words += ["--site", site]
    print(next_lines(command_line(*words), "cranedyn run lift_report --help"))
    return 0


def _benchmark(parser: _Parser) -> None:
    """Run a controller in the tasks of the open benchmark, and compare and verify results.

    Example: cranedyn benchmark run full_lqr --tasks inteco
    """
    from cranedyn.benchmark.benchmark_command import add_commands

    add_commands(parser)


def _add_crane(parser: _Parser) -> None:
    """Add the common options that name a crane, its gravity and its numbers."""
    from cranedyn.model.options import add_crane_options, add_gravity, add_values

    add_crane_options(parser.common)
    add_gravity(parser.common)
    add_values(parser.common, "numbers of the crane")


COMMANDS: dict[str, Callable[[_Parser], None]] = {
    "run": _experiment,
    "list": _list,
    "report": _report,
    "view": _view,
    "snapshot": _snapshot,
    "describe": _describe,
    "record-template": _record_template,
    "template": _template,
    "export": _export,
    "drive": _drive,
    "benchmark": _benchmark,
    "serve": _serve,
    "verify": _verify,
    "sign": _sign,
}
"""Functions that configure the parsers of the commands, by the names of these; their docstrings are
the help and an example."""


if __name__ == "__main__":
    sys.exit(main())
