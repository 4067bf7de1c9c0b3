"""Files of strangers and of tired disks, each with a few bytes or words changed: they are read as
finite numbers, or refused in a sentence.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import tempfile
import warnings
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import Any
from unittest.mock import patch

import numpy as np
import pinocchio as pin
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
import trimesh

from cranedyn.controllers import hold_controller
from cranedyn.data.external import Source, load_external
from cranedyn.data.files import parse_json
from cranedyn.data.logs import open_log
from cranedyn.data.trajectory import Trajectory, read, read_columns
from cranedyn.dynamics.equations_of_motion import acceleration, energy
from cranedyn.errors import CraneError
from cranedyn.identification import read_twin, twin_of
from cranedyn.lifts.judging.chart import CHARTS, read_chart
from cranedyn.lifts.planning.bim import read_ifc
from cranedyn.lifts.planning.clearance_of import clearance_of
from cranedyn.lifts.planning.lift import crane_of
from cranedyn.lifts.planning.site_file import SITES, read_site
from cranedyn.lifts.planning.solids import read_mesh
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.recording import Run, record
from cranedyn.recording.viewer import check_recording
from cranedyn.simulation.simulate import simulate
from cranedyn.sweep import grid, results, sweep
from experiments import a1, a2, a3, harness, report
from experiments.harness.document import read_document
from tests.helpers import RESULT
from tests.model.mjcf_models import random_model
from tests.model.test_sdf import BRIDGE
from tests.studies import squares
from tests.system.fuzz.api import namespace
from tests.system.fuzz.core import NUMBERS, Broken, Generator, check_line, outcome

# --- what is done to a file -----------------------------------------------------------------------

_WORD = re.compile(
    rb"""[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?|"[^"]*"|'[^']*'|[A-Za-z_]\w*|<[^>]*>|^.*\n""", re.M
)
"""Numbers, strings, names, tags and lines."""

Edit = tuple[str, float, float, str]
"""What is done, to what and with what as shares of the length, and a number."""


def draw(contents: Callable[[], dict[str, bytes]], rng: Random) -> tuple[str, list[Edit]]:
    """Return the name of one of some contents, and what is done to it."""
    words = ("odd", "odd", "odd", "swap", "lose", "twice")
    kinds = (*words, "turn", "flip", "drop", "double", "cut", "over")
    edits = [
        (rng.choice(kinds), rng.random(), rng.random(), rng.choice(NUMBERS))
        for _ in range(rng.choice([1, 1, 2, 3]))
    ]
    return rng.choice(list(contents())), edits


def edited(content: bytes, edits: list[Edit]) -> bytes:
    """Return bytes after some edits."""
    changed = bytearray(content)
    for kind, share, other, number in edits:
        i, j = (int(part * len(changed)) for part in (share, other))
        words = list(_WORD.finditer(changed)) if kind in ("odd", "swap", "lose", "twice") else []
        if words:
            word, donor = (words[int(part * len(words))] for part in (share, other))
            new = {"odd": number.encode(), "swap": donor[0], "lose": b"", "twice": word[0] * 2}
            changed[word.start() : word.end()] = new[kind]
        match kind:
            case "turn":
                changed[i : i + 1] = bytes([int(256 * other)])
            case "flip" if changed:
                changed[i] ^= 1 << int(8 * other)
            case "drop":
                del changed[min(i, j) : max(i, j)][:1000]
            case "double":
                changed[i:i] = changed[i : i + 60]
            case "cut":
                del changed[i:]
            case "over":
                changed[i : i + 8] = b"\xff\x00\x80\x7f"[int(4 * other) :][:1] * 8
    return bytes(changed)


def edits_of(
    name: str,
    contents: Callable[[], dict[str, bytes]],
    use: Callable[[Path], object],
    furnish: Callable[[Path], object] = lambda folder: None,
) -> Generator:
    """Return the generator of files of some contents, by file name, for what uses a file."""

    def attempt(case: tuple[str, list[Edit]], folder: Path) -> str:
        file, edits = case
        furnish(folder)
        path = folder / file
        path.write_bytes(edited(contents()[file], edits))
        return outcome(lambda: use(path))

    return Generator(f"file {name}", partial(draw, contents), attempt)


def check_finite(what: str, *numbers: Any) -> None:
    """Return if all numbers are finite; else raise `Broken`."""
    if not all(np.isfinite(values).all() for values in numbers):
        raise Broken(f"{what} was read with a number that is not finite", numbers)


# --- cranes ---------------------------------------------------------------------------------------


@cache
def _cranes() -> dict[str, bytes]:
    """The crane with two shapes to a link, so that most of the text counts; a xacro of it; and an
    overhead crane in SDF.
    """
    robot = ET.fromstring(describe())
    for link in robot.iterfind("link"):
        for shape in link.findall("visual")[2:]:
            link.remove(shape)
    text = ET.tostring(robot, encoding="unicode")
    xacro = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ', 1)
    argument = '<xacro:arg name="mass" default="1000.0"/><link'
    xacro = xacro.replace("<link", argument, 1).replace('"1000.0" />', '"$(arg mass)"/>')
    return {
        "crane.urdf": text.encode(),
        "crane.xacro": xacro.encode(),
        "crane.sdf": BRIDGE.encode(),
    }


def _use_crane(path: Path) -> None:
    crane = load_crane(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        rates = acceleration(crane, crane.start, np.zeros(crane.layout.m))
        check_finite("a crane", rates, energy(crane, crane.start))


@cache
def _mujoco_models() -> dict[str, bytes]:
    pytest.importorskip("mujoco", reason="extra mujoco is not installed")
    return {f"model{seed}.xml": random_model(seed).encode() for seed in range(10)}


def _mujoco_joint(model: Any, name: str) -> int:
    """Return the index of a joint; one that has lost its name is called by its number here."""
    try:
        return int(model.joint(name).id)
    except KeyError:
        return int(name.strip("_").rpartition("_")[2])


def _use_mujoco_model(path: Path) -> None:
    """Load a model, and compare its mass matrix and ranges with those of MuJoCo."""
    import mujoco

    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        crane = load_crane(path)
        check_finite("a crane", acceleration(crane, crane.start, np.zeros(crane.layout.m)))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    theirs = np.zeros((model.nv, model.nv))
    at = [_mujoco_joint(model, joint.name) for joint in crane.layout.joints]
    data.qpos[at] = crane.start.q
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, theirs)
    theirs = theirs[np.ix_(at, at)]
    ours = pin.crba(crane.model, crane.data, crane.start.q)
    ours = np.triu(ours) + np.triu(ours, 1).T
    if len(at) != model.nv or np.abs(ours - theirs).max() > 1e-7 * np.abs(theirs).max():
        raise Broken("a model was read whose mass is not that of MuJoCo", (ours, theirs))
    limited = model.jnt_limited[at].astype(bool)
    ranges = np.array([crane.lower, crane.upper]).T
    if not np.array_equal(ranges[limited], model.jnt_range[at][limited]):
        raise Broken("a model was read whose ranges are not those of MuJoCo", ranges)


# --- tables ---------------------------------------------------------------------------------------


@cache
def _run() -> Trajectory:
    return simulate(load_crane(), hold_controller(load_crane()), duration=0.2)


def _written(write: Callable[..., object], **how: Any) -> bytes:
    sink = io.BytesIO()
    write(_run().table(), sink, **how)
    return sink.getvalue()


@cache
def _csv() -> dict[str, bytes]:
    return {"a.csv": _written(pyarrow.csv.write_csv)}


@cache
def _parquet() -> dict[str, bytes]:
    kinds = ("snappy", "none", "gzip", "zstd")
    return {f"{k}.parquet": _written(pyarrow.parquet.write_table, compression=k) for k in kinds}


def _use_table(path: Path) -> None:
    columns = read_columns(path, ("t_s", "phi_rad", "l_m"))
    run = read(path)
    check_finite("a table", run.q, *columns.values())
    if not (np.diff(run.t) > 0.0).all():
        raise Broken("a table was read whose time does not increase", run.t)


@cache
def _signals() -> dict[str, bytes]:
    """What the experiments that analyse recordings need, by experiment."""
    t = np.arange(1600) * 0.04
    columns = {name: 0.1 * np.cos(0.8 * t) for name in ("phi_rad", "theta_rad")}
    columns |= {"theta_dot_rad_s": -0.08 * np.sin(0.8 * t), "gamma_dot_rad_s": 0.01 * np.sin(t)}
    columns |= {"t_s": t, "x_m": 20.0 + 0.0 * t, "l_m": np.interp(t, [30.0, 54.0], [20.0, 8.0])}
    sink = io.BytesIO()
    pyarrow.csv.write_csv(pa.table(columns), sink)
    return {f"{name}.csv": sink.getvalue() for name in ("a1", "a2", "a3")}


def _analyse(path: Path) -> None:
    experiment = {"a1": a1, "a2": a2, "a3": a3}[path.stem]
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
        code = experiment.main(["--from", str(path), "--out", str(path.parent / "out")])
    check_line(code, err.getvalue())
    if code == 2:
        raise CraneError("Refused.")
    if code:
        raise Broken("a file was neither analysed nor refused", f"{code} {err.getvalue()}")
    parse_json((path.parent / "out" / "result.json").read_text())


# --- sweeps, results, recordings, documents -------------------------------------------------------


@cache
def _swept() -> dict[str, bytes]:
    """The files of a finished sweep."""
    with tempfile.TemporaryDirectory() as folder:
        sweep(squares, grid(x=[float(x) for x in range(6)]), folder, chunk=2, workers=1)
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def _furnish_sweep(folder: Path) -> None:
    for name, content in _swept().items():
        (folder / name).write_bytes(content)


def _use_sweep(path: Path) -> None:
    table = results(path.parent).to_pydict()
    x = np.arange(6.0)
    if (table["x"], table["y"]) != (x.tolist(), (x**2).tolist()):
        raise Broken("a damaged sweep was read as if it were whole", table)


_PICTURE = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082"
)

_RESULT: dict[str, Any] = RESULT | {
    "about": "What <b>it</b> is.",
    "claims": [{"sentence": "It holds.", "holds": True}, {"sentence": "Unknown.", "holds": None}],
    "parameters": {"dt_s": 5e-4, "values": [1.0, "a"]},
    "figures": ["a.png"],
    "files": {"a.png": hashlib.sha256(_PICTURE).hexdigest()},
}


def _use_result(path: Path) -> None:
    place = path.parent / "a1"
    place.mkdir()
    (place / "a.png").write_bytes(_PICTURE)
    path.rename(place / "result.json")
    with (
        # Where a file that it lists is missing, its experiment would run again.
        patch.object(report, "_run", lambda names, options: [1] * len(names)),
        redirect_stdout(io.StringIO()),
        redirect_stderr(io.StringIO()) as err,
    ):
        code = report.main(["--out", str(path.parent), "--only", "a1"])
    check_line(code, err.getvalue())
    page = path.parent / "report.html"
    if code == 2 and not page.exists():
        raise CraneError("Refused.")
    text = page.read_text().split("</style>")[1]
    if code or text.count("<script") != 1 or re.search(r"<(b>|iframe)|NaN", text):
        raise Broken("a report holds what a result put in as HTML, or no number", err.getvalue())


@cache
def _recordings() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        run = Run("r", load_crane(), _run().before(0.05))
        return {"a.rrd": record(Path(folder) / "a.rrd", [run], title="t").read_bytes()}


_DOCUMENT = (
    b"# Ours\n\ntext\n<!-- a1: Some -->\nold\n<!-- end -->\nmore\n<!-- a2: -->\ntheirs\n"
    b"<!-- end -->\nend\n"
)


def _use_document(path: Path) -> None:
    before = path.read_bytes()
    try:
        table = harness.ResultTable("Some table", [("a", ".1f")], [(1.0,)])
        read_document(path, "a1").write([table])
    except CraneError:
        if path.read_bytes() != before:
            raise Broken("a document was refused and changed") from None
        raise
    text = path.read_bytes()
    if b"<!-- a2: -->\ntheirs" in before and b"theirs" not in text:
        raise Broken("a document lost what is not ours", text)


# --- charts, twins, sites, meshes, building models ------------------------------------------------


def _use_chart(path: Path) -> None:
    for falls in read_chart(path).reevings:
        radii = np.linspace(falls.least, falls.radii[-1], 9).clip(falls.least, falls.radii[-1])
        loads = falls.at(radii)
        if not ((loads > 0.0) & (loads <= falls.rated[0] * (1.0 + 1e-12))).all():
            raise Broken("a chart rates what is no load, or more than its first", loads)


@cache
def _twin() -> dict[str, bytes]:
    with tempfile.TemporaryDirectory() as folder:
        twin = twin_of(eval("identify(model)", dict(namespace())))
        return {"twin.json": twin.write(Path(folder) / "twin.json").read_bytes()}


def _use_twin(path: Path) -> None:
    twin = read_twin(path)
    check_finite("a twin", *(entry["value"] for entry in twin.identified.values()))
    if read_twin(twin.write(path.with_name("again.json"))).text != twin.text:
        raise Broken("a twin that is written again is another")
    load_crane(from_record=path)


@cache
def _meshes() -> dict[str, bytes]:
    """Good meshes in every format that is read."""
    angle = trimesh.util.concatenate([trimesh.creation.box(), trimesh.creation.icosphere(1, 0.4)])
    contents = {
        f"box.{kind}": angle.export(file_type=kind) for kind in ("stl", "ply", "off", "obj")
    }
    return {n: text.encode() if isinstance(text, str) else text for n, text in contents.items()}


def _furnish_site(folder: Path) -> None:
    for name, content in _meshes().items():
        (folder / name).write_bytes(content)


@cache
def _sites() -> dict[str, bytes]:
    """The examples, and one with a mesh."""
    mesh = (
        b'[ground]\nheight = 0.0\n[load]\nfile = "box.stl"\nmass = 900.0\n[lift]\nfrom = [5.0, '
        b'-9.0, 3.0]\nto = [-5.0, -12.0, 4.0]\n[[mesh]]\nname = "m"\nfile = "box.off"\n'
        b"position = [12.0, 3.0, 0.0]\nyaw = 30.0\nscale = 2.0\nhull = false\n"
    )
    return {path.name: path.read_bytes() for path in SITES.glob("*.toml")} | {"mesh.toml": mesh}


def _use_site(path: Path) -> None:
    site = read_site(path)
    crane = crane_of(site)
    distances = clearance_of(crane, site).distances(crane.start.q).values()
    check_finite("a site", [one.distance for one in distances])


def _use_mesh(path: Path) -> None:
    check_finite("a mesh", read_mesh(path)[0])


@cache
def _buildings() -> dict[str, bytes]:
    from tests.lifts.planning.test_site import model

    with tempfile.TemporaryDirectory() as folder:
        return {"a.ifc": model(Path(folder) / "a.ifc").read_bytes()}


def _use_building(path: Path) -> None:
    check_finite("a building model", *(solid.vertices for solid in read_ifc(path)))


# --- tables of other programs ---------------------------------------------------------------------


@cache
def _logs() -> dict[str, bytes]:
    """Text tables as programs of many kinds write them."""
    rows = [(0.02 * k, 0.1 * np.cos(0.016 * k), 15.0) for k in range(60)]
    points = [f"{t:.2f},{phi:.5f},{length:g}" for t, phi, length in rows]
    commas = [row.replace(",", ";").replace(".", ",") for row in points]
    clock = [f"2024-05-01T10:15:{t:09.6f}Z,{phi:.5f},{length:g}" for t, phi, length in rows]
    topics = [f"{t:.2f},{phi:.5f}," if k % 2 else f"{t:.2f},,15" for k, (t, phi, _) in
              enumerate(rows)]  # fmt: skip
    blanks = [row.replace(",", "   ") for row in points]
    tables = {
        "plain.csv": ["time, angle, rope", *points],
        "units.csv": ["Recorder 3;;", "", "time;angle;rope", "s;rad;m", *commas],
        "clock.csv": ["time,angle,rope", *clock],
        "topics.csv": ["__time,/swing/angle,/hoist/length", *topics],
        "blanks.txt": ["# time angle rope", *blanks],
        "none.csv": points,
    }
    contents = {name: "\n".join([*lines, ""]).encode() for name, lines in tables.items()}
    return contents | {"wide.csv": contents["units.csv"].decode().encode("utf-16")}


@cache
def _arrays() -> dict[str, bytes]:
    """Files of MATLAB, plain and compressed, with a structure."""
    from scipy.io import savemat

    t = np.arange(60) * 0.02
    variables = {"t": t, "phi": 0.1 * np.cos(t), "rope": np.full(60, 15.0)}
    contents: dict[str, bytes] = {}
    for name, packed in (("plain.mat", False), ("packed.mat", True)):
        sink = io.BytesIO()
        savemat(sink, {**variables, "log": {"t": t, "y": np.ones((60, 2))}}, do_compression=packed)
        contents[name] = sink.getvalue()
    return contents


@cache
def _workbook() -> bytes:
    from tests.experiments.test_measured import workbook

    rows: list[list[object]] = [["time", "angle", "rope"]]
    rows += [[0.02 * k, 0.1, 15.0] for k in range(20)]
    with tempfile.TemporaryDirectory() as folder:
        return workbook(Path(folder) / "a.xlsx", [rows]).read_bytes()


@cache
def _sheets() -> dict[str, bytes]:
    """The parts of a workbook, which are packed again: a wrong byte of an archive ends it soon."""
    with zipfile.ZipFile(io.BytesIO(_workbook())) as archive:
        contents = {name.replace("/", "+"): archive.read(name) for name in archive.namelist()}
    return contents | {"a.xlsx": _workbook()}


def _use_sheet(path: Path) -> None:
    if path.suffix == ".xlsx":
        _use_log(path)
        return
    whole = path.with_name("whole.xlsx")
    with (
        zipfile.ZipFile(io.BytesIO(_workbook())) as archive,
        zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as changed,
    ):
        for name in archive.namelist():
            is_changed = name.replace("/", "+") == path.name
            changed.writestr(name, path.read_bytes() if is_changed else archive.read(name))
    _use_log(whole)


@cache
def _hierarchies() -> dict[str, bytes]:
    import h5py

    with tempfile.TemporaryDirectory() as folder:
        with h5py.File(Path(folder) / "packed.h5", "w") as file:
            for name in ("t", "phi", "rope"):
                values = 0.02 * np.arange(60.0)
                file.create_dataset(name, data=values, chunks=(20,), compression="gzip")
        with h5py.File(Path(folder) / "plain.h5", "w") as file:
            for name in ("t", "phi", "rope"):
                file.create_dataset(name, data=0.02 * np.arange(60.0))
        return {path.name: path.read_bytes() for path in sorted(Path(folder).iterdir())}


def _use_log(path: Path) -> None:
    log = open_log(path)
    for names in ("t", "phi", "rope"), ("time", "angle", "rope"), ("#1", "#2", "#3"):
        if all(log.index(name) is not None for name in names):
            columns = dict(zip(("t_s", "phi_rad", "l_m"), map(Source, names), strict=True))
            break
    else:
        raise CraneError("Refused.")
    for filling in ("hold", "interpolate"):
        table = load_external(log, list(columns), columns, filling=filling)
        check_finite("a table", *table.columns.values())
        if not (np.diff(table.columns["t_s"]) > 0.0).all():
            raise Broken("a table was read whose time does not increase", table.columns["t_s"])


@cache
def _databases() -> dict[str, bytes]:
    from tests.export.test_mcap import database

    with tempfile.TemporaryDirectory() as folder:
        database(Path(folder) / "a.db3", ["hoist_joint", "swing_radial_joint"], rows=20)
        return {"a.db3": (Path(folder) / "a.db3").read_bytes()}


# --- recordings of ROS ----------------------------------------------------------------------------


@cache
def _bags() -> dict[str, bytes]:
    from cranedyn.export import mcap
    from tests.export.test_mcap import bag

    names = ["hoist_joint", "swing_radial_joint"]
    with tempfile.TemporaryDirectory() as folder:
        bag(Path(folder) / "a.bag", names, rows=9, topic="/joint_states")
        mcap.export(Path(folder) / "a.mcap", load_crane(), _run())
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def _use_bag(path: Path) -> None:
    from cranedyn.interop import bags

    columns = bags.read_joint_states(path, ("t_s", "l_m", "phi_rad"))
    check_finite("a recording", *columns.values())


def _named(name: str, content: bytes) -> Callable[[], dict[str, bytes]]:
    return lambda: {name: content}


GENERATORS = [
    edits_of("crane", _cranes, _use_crane),
    edits_of("MJCF", _mujoco_models, _use_mujoco_model),
    edits_of("CSV", _csv, _use_table),
    edits_of("Parquet", _parquet, _use_table),
    edits_of("signals", _signals, _analyse),
    edits_of("sweep", _swept, _use_sweep, _furnish_sweep),
    edits_of("result", _named("result.json", json.dumps(_RESULT, indent=1).encode()), _use_result),
    edits_of("recording", _recordings, check_recording),
    edits_of("document", _named("page.md", _DOCUMENT), _use_document),
    edits_of("chart", lambda: {p.name: p.read_bytes() for p in CHARTS.glob("*.toml")}, _use_chart),
    edits_of("twin", _twin, _use_twin),
    edits_of("site", _sites, _use_site, _furnish_site),
    edits_of("mesh", _meshes, _use_mesh),
    edits_of("building model", _buildings, _use_building),
    edits_of("bag", _bags, _use_bag),
    edits_of("log", _logs, _use_log),
    edits_of("MATLAB", _arrays, _use_log),
    edits_of("workbook", _sheets, _use_sheet),
    edits_of("HDF5", _hierarchies, _use_log),
    edits_of("database", _databases, _use_bag),
]
