"""Files of strangers and of tired disks: descriptions, tables, sweeps, results, recordings,
documents, each with something changed.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import QUANTITIES, read, read_columns
from cranedyn.dynamics.pinocchio import acceleration, energy
from cranedyn.errors import CraneError
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.viewer import check_recording
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import grid, results, sweep
from experiments import a1, a2, a3, harness, report
from experiments.harness.document import read_document
from tests.studies import squares
from tests.system.fuzz.core import Broken, Case, Generator
from tests.system.fuzz.lines import inline_sweeps

WORDS = (
    "0 -1 1e308 -1e308 5e-324 1e-400 1e400 nan inf -inf 1e29 1e-20 x 1_0 0x10 1,5 --1 1e ${1} "
    "$(arg a) ١ 1. .5 fixed world"
).split()


def check_read(what: str, t: np.ndarray, *columns: np.ndarray) -> None:
    """Return if what was read has finite numbers and a time that increases.

    Raises:
        Broken: If it has not.
    """
    if not all(np.isfinite(values).all() for values in columns):
        raise Broken(f"{what} was read with a number that is not finite", columns)
    if not (np.diff(t) > 0.0).all():
        raise Broken(f"{what} was read whose time does not increase", t)


def ended(what: Callable[[], object]) -> str:
    """How it ends, good or refused; whatever is refused is so in one printable sentence."""
    try:
        what()
    except CraneError as error:
        if not (str(error).isprintable() and str(error).endswith(".")):
            raise Broken("an error that is no printable sentence", repr(str(error))) from None
        return "refused"
    return "good"


# --- what is done to bytes ------------------------------------------------------------------------

Edit = tuple[str, float, int, bytes]
"""What is done, where as a share of the length, over how many bytes, and with what."""


def edit(rng: Random) -> Edit:
    """Something to do to bytes."""
    kind = rng.choice(
        [
            "digit",
            "digit",
            "digit",
            "turn",
            "turn",
            "flip",
            "drop",
            "double",
            "cut",
            "over",
            "splice",
            "huge",
        ]
    )
    new = {
        "digit": rng.choice([b"0", b"9", b".", b"e1", b"-1"]),
        "turn": bytes([rng.randrange(256)]),
        "flip": bytes([1 << rng.randrange(8)]),
        "over": rng.choice(
            [
                b"\xff" * 4,
                b"\x00" * 4,
                b"\x80" * 4,
                b"nan,",
                b"1e99",
                b"\xff" * 8,
                b"\x7f\xff\xff\xff\xff\xff\xff\xff",
            ]
        ),
        "huge": rng.choice([b"9" * 400, b"1e300", b"\x7f" * 10, b"-1", b"99999999999999999999"]),
    }.get(kind, b"")
    return kind, rng.random(), rng.choice([1, 4, 8, 60, 1000]), new


def edited(content: bytes, edits: list[Edit]) -> bytes:
    """Bytes with some of them turned, flipped, dropped, doubled, written over, put elsewhere, cut
    off, or numbers made huge.
    """
    made = bytearray(content)
    for kind, share, size, new in edits:
        at = int(share * (len(made) + 1))
        match kind:
            case "digit" | "huge" if digit := re.compile(rb"\d").search(made, at):
                made[digit.start() : digit.end()] = new
            case "turn":
                made[at : at + 1] = new
            case "flip" if at < len(made):
                made[at] ^= new[0]
            case "drop":
                del made[at : at + size]
            case "double":
                made[at:at] = made[at : at + size]
            case "splice":
                made[at : at + size] = made[: size * 3 % (len(made) + 1)][-size:]
            case "cut" if size == 1:
                del made[at:]
            case _:
                made[at : at + len(new)] = new
    return bytes(made)


def edits(rng: Random) -> list[Any]:
    """A few of them."""
    return [edit(rng) for _ in range(rng.choice([1, 1, 2, 3]))]


@dataclass(frozen=True)
class Edited:
    """Content of some kind with a few bytes changed, given to whatever reads it.

    Attributes:
        name: Of the kind.
        weight: How many.
        contents: The good ones.
        give: Gives one to its reader, by the number of the content it was made from; says how it
            ended.
        interruptible: Always false: reading takes no time.
    """

    name: str
    weight: float
    contents: Callable[[], list[bytes]]
    give: Callable[[bytes, int, Path], str]
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """One of the contents and what is done to it."""
        return Case(rng.randrange(len(self.contents())), edits(rng))

    def attempt(self, case: Case, folder: Path) -> str:
        """Give it to its reader."""
        return self.give(edited(self.contents()[case.head], case.parts), case.head, folder)

    def shown(self, case: Case) -> str:
        """What was done to it."""
        parts = (
            f"{kind} at {share:.4f} ({size}, {new!r})" for kind, share, size, new in case.parts
        )
        return f"{self.name} {case.head}: {', '.join(parts)}"


# --- descriptions ---------------------------------------------------------------------------------


@cache
def slim() -> str:
    """The crane with two shapes to a link, so that most of the text counts."""
    robot = ET.fromstring(describe())
    for link in robot.iterfind("link"):
        for shape in link.findall("visual")[2:]:
            link.remove(shape)
    return ET.tostring(robot, encoding="unicode")


@cache
def small_xacro() -> bytes:
    """A xacro file with an argument, a property and a macro."""
    body = slim()
    body = body[body.index("<link") : -8]
    body = body.replace('<mass value="1000.0" />', '<xacro:weight mass="$(arg mass)"/>')
    return f"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="1000.0"/>  <!-- [kg] > 0: payload -->
  <xacro:property name="half" value="${{float('$(arg mass)') / 2}}"/>
  <xacro:macro name="weight" params="mass"><mass value="${{mass}}"/></xacro:macro>
  {body}
</robot>""".encode()


def load(content: bytes, folder: Path, *, whole: bool = False) -> None:
    """Load a description; what it says must make finite numbers, and a run and a recording if the
    whole is asked for.
    """
    path = folder / "crane.urdf"
    path.write_bytes(content)
    crane = load_crane(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        _finite("acceleration", acceleration(crane, crane.start, np.zeros(crane.layout.m)))
        _finite("energy", np.array(energy(crane, crane.start)))
        if whole:
            run = simulate(crane, hold_controller(crane), duration=0.02, validity="mark")
            for name in QUANTITIES:
                _finite(name, getattr(run, name))
            record(folder / "a.rrd", [Run("r", crane, run)], title="t")


def _finite(name: str, values: np.ndarray) -> None:
    if not np.isfinite(values).all():
        raise Broken(f"a crane was accepted whose {name} is not finite", values)


def _urdf(content: bytes, which: int, folder: Path) -> str:
    return ended(lambda: load(content, folder))


def _xacro(content: bytes, which: int, folder: Path) -> str:
    path = folder / "a.xacro"
    path.write_bytes(content)
    return ended(lambda: load_crane(path, mass=(1e-9, 500.0, 1e9, 0.0, np.nan, 1e300)[which]))


@dataclass(frozen=True)
class Rewritten:
    """The crane with numbers replaced, attributes of two elements swapped, or elements moved,
    doubled, dropped or renamed.
    """

    name: str
    weight: float
    whole: bool
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """One or two changes."""
        kinds = ["number", "number", "number", "swap", "add", "drop", "lose", "rename"]
        return Case(
            None,
            [
                (rng.choice(kinds), rng.random(), rng.random(), rng.random(), rng.choice(WORDS))
                for _ in range(rng.choice([1, 2]))
            ],
        )

    def attempt(self, case: Case, folder: Path) -> str:
        """Load it; simulate and record it, too, if that is asked for."""
        return ended(lambda: load(self.text(case).encode(), folder, whole=self.whole))

    def shown(self, case: Case) -> str:
        """What is done."""
        return f"{self.name}: {case.parts}"

    def text(self, case: Case) -> str:
        """The description."""
        robot = ET.fromstring(slim())
        elements = list(robot.iter())
        for kind, first, second, third, word in case.parts:
            one, two = (
                elements[1:][int(first * (len(elements) - 1))],
                elements[int(second * len(elements))],
            )
            match kind:
                case "number" if one.attrib:
                    name = sorted(one.attrib)[int(third * len(one.attrib))]
                    words = one.attrib[name].split() or [""]
                    words[int(second * len(words))] = word
                    one.attrib[name] = " ".join(words)
                case "swap":
                    one.attrib, two.attrib = dict(two.attrib), dict(one.attrib)
                case "add" if not any(two is part for part in one.iter()):
                    two.append(one)
                case "drop":
                    next((parent for parent in elements if one in parent), robot).remove(
                        one
                    ) if any(one in p for p in elements) else None
                case "lose" if one.attrib:
                    del one.attrib[sorted(one.attrib)[int(third * len(one.attrib))]]
                case _:
                    one.tag = ["link", "joint", "inertial", "mass", "visual", "robot", "gazebo"][
                        int(third * 7)
                    ]
        return ET.tostring(robot, encoding="unicode")


# --- tables ---------------------------------------------------------------------------------------


@cache
def tables(ending: str) -> list[bytes]:
    """A trajectory in every way in which a table of an ending is written."""
    crane = load_crane()
    table = simulate(crane, hold_controller(crane), duration=0.2).table()
    if ending == ".csv":
        return [_written(pyarrow.csv.write_csv, table)]
    strategies: list[dict[str, Any]] = [
        {"compression": kind} for kind in ("snappy", "none", "gzip", "zstd")
    ]
    return [
        _written(pyarrow.parquet.write_table, table, **way)
        for way in (*strategies, {"data_page_version": "2.0", "use_dictionary": False})
    ]


def _written(write: Callable[..., object], table: pa.Table, **more: Any) -> bytes:
    sink = io.BytesIO()
    write(table, sink, **more)
    return sink.getvalue()


def _table(ending: str) -> Callable[[bytes, int, Path], str]:
    def give(content: bytes, which: int, folder: Path) -> str:
        path = folder / f"a{ending}"
        path.write_bytes(content)

        def both() -> None:
            found = read_columns(path, ("t_s", "phi_rad", "l_m"))
            whole = read(path)
            check_read("a table", whole.t, whole.q, *found.values())

        return ended(both)

    return give


@dataclass(frozen=True)
class Signals:
    """Files of any signals for the experiments that analyse what was recorded elsewhere."""

    name: str = "file --from"
    weight: float = 0.5
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """An experiment, a length and a step; up to two columns that hold something else."""
        shapes, scales = (
            ("cosine", "one", "line", "square", "growth", "zero", "noise"),
            (0.0, 1e-300, 1e-9, 0.1, 1.0, 1e5, -1.0, 1e300),
        )
        names = ("t_s", "phi_rad", "l_m", "gamma_dot_rad_s", "x_m", "theta_rad", "theta_dot_rad_s")
        parts = [
            (name, rng.choice(shapes), rng.choice(scales))
            for name in rng.sample(names, rng.choice([0, 1, 1, 2]))
        ]
        return Case(
            (
                rng.randrange(3),
                *rng.choice([(1600, 0.04), (1600, 0.04), (400, 0.4), (12, 0.1), (2, 1.0)]),
            ),
            parts,
        )

    def attempt(self, case: Case, folder: Path) -> str:
        """Analyse it: 0 with finite results, or 2 with a sentence."""
        path = folder / "a.csv"
        pyarrow.csv.write_csv(pa.table(self._columns(case)), path)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
            code = (a1, a2, a3)[case.head[0]].main(
                ["--from", str(path), "--out", str(folder / "out")]
            )
        if code == 0:
            json.loads((folder / "out" / "result.json").read_text(), parse_constant=_not_finite)
        elif code != 2 or not re.fullmatch(r"error: [^\n]+\.\n", err.getvalue()):
            raise Broken(
                "a file was neither analysed nor refused in a sentence", f"{code} {err.getvalue()}"
            )
        return f"code {code}"

    def shown(self, case: Case) -> str:
        """Which experiment, what is replaced."""
        return (
            f"experiments.a{case.head[0] + 1} --from, {case.head[1]} rows of {case.head[2]} s, "
            f"{case.parts}"
        )

    def _columns(self, case: Case) -> dict[str, np.ndarray]:
        _, rows, step = case.head
        t = np.arange(rows) * step
        hoisting = np.interp(t, [30.0, 54.0], [20.0, 8.0])
        swing = 0.1 * np.cos(np.cumsum(np.sqrt(9.81 / hoisting)) * step)
        columns = {
            "t_s": t,
            "phi_rad": swing,
            "l_m": hoisting,
            "gamma_dot_rad_s": 0.01 * np.sin(t),
            "x_m": 20 + 0 * t,
            "theta_rad": swing,
        }
        columns["theta_dot_rad_s"] = np.gradient(swing, t)
        shapes = {
            "cosine": np.cos(0.8 * t),
            "one": np.ones(rows),
            "line": np.linspace(20.0, 8.0, rows),
            "square": np.sign(np.cos(t)),
        }
        shapes |= {
            "growth": np.exp(0.2 * t).clip(max=1e6),
            "zero": np.zeros(rows),
            "noise": np.random.default_rng(rows).normal(size=rows),
        }
        for name, shape, scale in case.parts:
            columns[name] = t + scale if name == "t_s" else shapes[shape] * scale
        return columns


def _not_finite(word: str) -> None:
    raise Broken(f"{word} in result.json")


# --- sweeps, results, recordings, documents -------------------------------------------------------

_DESIGN = grid(x=[float(x) for x in range(6)])


@cache
def _swept() -> dict[str, bytes]:
    """The files of a finished sweep."""
    with tempfile.TemporaryDirectory() as folder:
        sweep(squares, _DESIGN, folder, chunk=2, workers=1)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


@dataclass(frozen=True)
class SweepFolder:
    """The folder of a sweep with a file changed, cut, taken away or put in the place of another;
    then read, and swept again.
    """

    name: str = "file sweep"
    weight: float = 1.0
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """Which file, and what is done to it."""
        names = list(_swept())
        other = rng.choice(["copy", "gone", "empty", "edit", "edit", "edit", "edit"])
        return Case(
            (rng.choice(names), other, rng.choice(names)), edits(rng) if other == "edit" else []
        )

    def attempt(self, case: Case, folder: Path) -> str:
        """The table is as it was, or refused; so it is when the sweep goes on."""
        name, what, other = case.head
        for file, content in _swept().items():
            (folder / file).write_bytes(content)
        match what:
            case "copy":
                (folder / name).write_bytes(_swept()[other])
            case "gone":
                (folder / name).unlink()
            case "empty":
                (folder / name).write_bytes(b"")
            case _:
                (folder / name).write_bytes(edited(_swept()[name], case.parts))
        right = ended(lambda: self._same(results(folder)))
        return f"{right}, again {ended(lambda: self._again(folder))}"

    def shown(self, case: Case) -> str:
        """What was done to which file."""
        name, what, other = case.head
        return f"{other} over {name}" if what == "copy" else f"{name} {what} {case.parts}"

    def _again(self, folder: Path) -> None:
        with inline_sweeps():
            sweep(squares, _DESIGN, folder, chunk=2, workers=1)
        self._same(results(folder))

    def _same(self, table: pa.Table) -> None:
        x = np.arange(6.0)
        good = {"case": list(range(6)), "x": x.tolist(), "y": (x**2).tolist(), "error": [None] * 6}
        if table.to_pydict() != good:
            raise Broken("a damaged sweep was read as if it were whole", table.to_pydict())


_PICTURE = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082"
)

_RESULT: dict[str, Any] = {
    "experiment": "a1",
    "about": "What <b>it</b> is.",
    "command": "python -m experiments.a1",
    "claims": [
        {"sentence": "It holds.", "holds": True},
        {"sentence": "It was not judged.", "holds": None},
    ],
    "parameters": {"dt_s": 5e-4, "values": [1.0, "a"]},
    "figures": ["a.png"],
    "files": {"a.png": hashlib.sha256(_PICTURE).hexdigest()},
    "tables": [
        {
            "title": "t",
            "columns": ["a", "b"],
            "formats": ["", ".3f"],
            "rows": [["x", 1.0], ["y", None]],
            "note": "n",
        }
    ],
    "versions": {"python": "3.11", "numpy": None},
    "machine": "m",
}


def _result(content: bytes, which: int, folder: Path) -> str:
    place = folder / "a1"
    place.mkdir()
    (place / "a.png").write_bytes(_PICTURE)
    (place / "result.json").write_bytes(content)
    with (
        # Where a file that it lists is missing, it is made again.
        patch.object(a1, "main", lambda argv: 1),
        redirect_stdout(io.StringIO()),
        redirect_stderr(io.StringIO()) as err,
    ):
        code = report.main(["--out", str(folder), "--only", "a1"])
    page = folder / "report.html"
    if code == 2 and (page.exists() or not re.fullmatch(r"error: [^\n]+\.\n", err.getvalue())):
        raise Broken("a result was refused without a sentence, or leaves a page", err.getvalue())
    if code not in (0, 2):
        raise Broken(
            "a report of a result that is there ends neither 0 nor 2", f"{code} {err.getvalue()}"
        )
    if code == 0 and re.search(
        r"<(script|b>|iframe)|NaN|Infinity", page.read_text().split("</style>")[1]
    ):
        raise Broken(
            "a page holds what is no number or what a result put in as HTML",
            page.read_text()[-500:],
        )
    return f"code {code}"


@cache
def _recording() -> bytes:
    crane = load_crane()
    with tempfile.TemporaryDirectory() as folder:
        return record(
            Path(folder) / "a.rrd",
            [Run("r", crane, simulate(crane, hold_controller(crane), duration=0.05))],
            title="t",
        ).read_bytes()


def _recorded(content: bytes, which: int, folder: Path) -> str:
    path = folder / "a.rrd"
    path.write_bytes(content)
    return ended(lambda: check_recording(path))


_DOCUMENT = (
    "# Ours\n\ntext\n<!-- a1: Some -->\nold\n<!-- end -->\nmore\n<!-- a2: -->\ntheirs\n"
    "<!-- end -->\nend\n"
)


def _document(content: bytes, which: int, folder: Path) -> str:
    path = folder / "doc.md"
    path.write_bytes(content)
    table = harness.ResultTable("Some table", [("a", ".1f")], [(1.0,)])

    def both() -> None:
        read_document(path, "a1").write([table])
        text = path.read_text(encoding="utf-8")
        if "**Some table**" not in text or (
            "<!-- a2: -->\ntheirs" in content.decode() and "theirs" not in text
        ):
            raise Broken("a document lost what is not ours, or lacks what is", text)

    word = ended(both)
    if word == "refused" and path.read_bytes() != content:
        raise Broken("a document was refused and changed")
    return word


GENERATORS: list[Generator] = [
    Edited("file URDF, bytes", 2.0, lambda: [slim().encode()], _urdf),
    Rewritten("file URDF, elements", 2.0, whole=False),
    Rewritten("file URDF, recorded", 0.3, whole=True),
    Edited("file xacro, bytes", 0.4, lambda: [small_xacro()] * 6, _xacro),
    Edited("file CSV, bytes", 2.0, lambda: tables(".csv"), _table(".csv")),
    Edited("file Parquet, bytes", 3.0, lambda: tables(".parquet"), _table(".parquet")),
    Signals(),
    SweepFolder(),
    Edited("file result.json", 2.0, lambda: [json.dumps(_RESULT, indent=1).encode()], _result),
    Edited("file recording", 1.0, lambda: [_recording()], _recorded),
    Edited("file document", 1.0, lambda: [_DOCUMENT.encode()], _document),
]
