"""Whatever is done to a description, a table or a number: it works with finite values, or it is refused in one sentence."""

from __future__ import annotations

import io
import json
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cranedyn.controllers import hold_controller
from cranedyn.crane import load_crane
from cranedyn.description import XACRO, arguments, describe
from cranedyn.dynamics import acceleration, energy
from cranedyn.errors import CraneError
from cranedyn.recording import Run, record
from cranedyn.simulate import simulate
from cranedyn.trajectory import COLUMNS, read, read_columns
from experiments import a1, a2, a3, common
from tests.helpers import files

TRIED: Counter[str] = Counter()
"""How many inputs were tried, by what they were and how they ended; printed at the end of the session."""

many = settings(max_examples=250, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
few = settings(many, max_examples=40)


def ended(what: str, try_it: Callable[[], object]) -> None:
    """Count how it ends; anything but a result or a sentence is for pytest to see."""
    try:
        try_it()
    except CraneError as error:
        assert str(error).isprintable() and str(error).endswith("."), str(error)
        TRIED[f"{what} refused"] += 1
    else:
        TRIED[f"{what} good"] += 1


# --- what is done to them ----------------------------------------------------------------------------------------------------------

WORDS = "0 -1 1e308 -1e308 5e-324 1e-400 1e400 nan inf -inf 1e29 1e-20 x 1_0 0x10 1,5 --1 1e ${1} $(arg a) ١ 1. .5 fixed world".split()
numbers = st.one_of(st.floats(), st.sampled_from([0.0, 1e-300, 1e-9, 1e9, 1e29, 1e300, -1.0]), st.floats(0.1, 10.0))


@st.composite
def edited(draw: st.DrawFn, content: bytes) -> bytes:
    """Bytes with some of them turned, dropped, doubled, moved or written over."""
    new = bytearray(content)
    for _ in range(draw(st.integers(1, 3))):
        at, size = draw(st.integers(0, len(new))), draw(st.integers(1, 60))
        match draw(st.sampled_from(["digit", "digit", "digit", "turn", "drop", "double", "cut", "over"])):
            case "digit" if digit := re.compile(rb"\d").search(new, at):
                new[digit.start() : digit.end()] = draw(st.sampled_from([b"0", b"9", b".", b"e1", b"-1"]))
            case "turn":
                new[at : at + 1] = bytes([draw(st.integers(0, 255))])
            case "drop":
                del new[at : at + size]
            case "double":
                new[at:at] = new[at : at + size]
            case "cut" if draw(st.booleans()):
                del new[at:]
            case _:
                new[at : at + 4] = draw(st.sampled_from([b"\xff" * 4, b"\x00" * 4, b"\x80" * 4, b"nan,", b"1e99"]))
    return bytes(new)


@st.composite
def rewritten(draw: st.DrawFn, text: str) -> str:
    """A description with a number replaced, the attributes of two elements swapped, or an element moved, doubled, dropped or renamed."""
    robot = ET.fromstring(text)
    elements = list(robot.iter())
    for _ in range(draw(st.integers(1, 2))):
        one, two = draw(st.sampled_from(elements[1:])), draw(st.sampled_from(elements))
        match draw(st.sampled_from(["number", "number", "number", "swap", "add", "drop", "lose", "rename"])):
            case "number" if one.attrib:
                name = draw(st.sampled_from(sorted(one.attrib)))
                words = one.attrib[name].split() or [""]
                words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(WORDS))
                one.attrib[name] = " ".join(words)
            case "swap":
                one.attrib, two.attrib = dict(two.attrib), dict(one.attrib)
            case "add" if not any(two is part for part in one.iter()):
                two.append(one)
            case "drop":
                next(parent for parent in elements if one in parent).remove(one) if any(one in parent for parent in elements) else None
            case "lose" if one.attrib:
                del one.attrib[draw(st.sampled_from(sorted(one.attrib)))]
            case _:
                one.tag = draw(st.sampled_from(["link", "joint", "inertial", "mass", "visual", "robot", "gazebo"]))
    return ET.tostring(robot, encoding="unicode")


def _slim() -> str:
    """The crane with two shapes to a link, so that most of the text counts."""
    robot = ET.fromstring(describe())
    for link in robot.iterfind("link"):
        for shape in link.findall("visual")[2:]:
            link.remove(shape)
    return ET.tostring(robot, encoding="unicode")


SLIM = _slim()

# --- descriptions ------------------------------------------------------------------------------------------------------------------


def _load(content: bytes, folder: Path, *, whole: bool = False) -> None:
    path = folder / "crane.urdf"
    path.write_bytes(content)
    crane = load_crane(path)
    assert np.isfinite(acceleration(crane, crane.start, np.array([0.0, 0.0, -crane.payload_mass * crane.gravity]))).all()
    assert np.isfinite(energy(crane, crane.start))
    if whole:
        run = simulate(crane, hold_controller(crane), duration=0.02, watch="mark")
        assert all(np.isfinite(getattr(run, name)).all() for name in COLUMNS)
        record(folder / "a.rrd", [Run("r", crane, run)], title="t")


@many
@given(content=edited(SLIM.encode()))
def test_a_urdf_with_bytes_changed(content: bytes, tmp_path: Path) -> None:
    ended("URDF, bytes", lambda: _load(content, tmp_path))


@many
@given(text=rewritten(SLIM))
def test_a_urdf_with_elements_changed(text: str, tmp_path: Path) -> None:
    ended("URDF, elements", lambda: _load(text.encode(), tmp_path))


@few
@given(text=rewritten(SLIM))
def test_a_urdf_with_elements_changed_is_simulated_and_recorded(text: str, tmp_path: Path) -> None:
    ended("URDF, recorded", lambda: _load(text.encode(), tmp_path, whole=True))


SMALL = f"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="1000.0"/>  <!-- [kg] > 0: payload -->
  <xacro:property name="half" value="${{float('$(arg mass)') / 2}}"/>
  <xacro:macro name="weight" params="mass"><mass value="${{mass}}"/></xacro:macro>
  {SLIM[SLIM.index("<link") : -8].replace('<mass value="1000.0" />', '<xacro:weight mass="$(arg mass)"/>')}
</robot>"""


@few
@given(content=edited(SMALL.encode()), value=st.sampled_from([1e-9, 500.0, 1e9, 0.0, np.nan, 1e300]))
def test_a_xacro_with_bytes_changed(content: bytes, value: float, tmp_path: Path) -> None:
    path = tmp_path / "a.xacro"
    path.write_bytes(content)
    ended("xacro, bytes", lambda: load_crane(path, mass=value))


# --- tables ------------------------------------------------------------------------------------------------------------------------


def _tables() -> dict[str, list[bytes]]:
    crane = load_crane()
    table = simulate(crane, hold_controller(crane), duration=0.2).table()
    made: dict[str, list[bytes]] = {".csv": [], ".parquet": []}
    writers: list[tuple[str, Callable, dict[str, object]]] = [
        (".csv", pyarrow.csv.write_csv, {}),
        *((".parquet", pyarrow.parquet.write_table, {"compression": kind}) for kind in ("snappy", "none", "gzip", "zstd")),
        (".parquet", pyarrow.parquet.write_table, {"data_page_version": "2.0", "use_dictionary": False}),
    ]
    for ending, write, more in writers:
        sink = io.BytesIO()
        write(table, sink, **more)
        made[ending].append(sink.getvalue())
    return made


TABLES = _tables()
MEANT = st.sampled_from([".csv", ".parquet"])


@settings(many, max_examples=500)
@given(data=st.data(), ending=MEANT)
def test_a_table_with_bytes_changed(data: st.DataObject, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(data.draw(edited(data.draw(st.sampled_from(TABLES[ending])))))

    def try_it() -> None:
        found = read_columns(path, ("t_s", "phi_rad", "l_m"))
        assert all(np.isfinite(values).all() for values in found.values())
        whole = read(path)
        assert (np.diff(whole.t) > 0).all() and np.isfinite(whole.q).all()

    ended(f"{ending[1:].upper()}, bytes", try_it)


# --- numbers -----------------------------------------------------------------------------------------------------------------------


def _conducted(words: list[str], folder: Path) -> tuple[int, str]:
    """A run of 0.05 s with arguments of the world."""

    def experiment(options: object, world: common.World) -> common.Outcome:
        run = world.simulate(world.crane, hold_controller(world.crane), None, start=world.crane.start, duration=0.05, label="")
        last = run.state(-1)
        return common.Outcome([common.Table("End", [("q", "g"), ("v", "g")], list(zip(*last, strict=True)))], [], {}, {"run": run})

    made = common.parser("trial", "A trial.")
    common.add_world(made)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
        code = common.conduct(made, experiment, ["--out", str(folder), *words])
    return code, err.getvalue()


flags = st.sampled_from(["gravity", "dt", "control-period"])
settings_of_the_crane = st.sampled_from(sorted(arguments()))


@pytest.fixture
def plain_looks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The crane of this project without its looks, which take most of the time of loading it."""
    lines = [line for line in XACRO.read_text().splitlines() if "appearance.xacro" not in line and "_visual/>" not in line]
    (tmp_path / XACRO.name).write_text("\n".join(lines))
    monkeypatch.setattr("cranedyn.crane.XACRO", tmp_path / XACRO.name)


@settings(many, max_examples=60)
@given(
    of_crane=st.dictionaries(settings_of_the_crane, numbers, max_size=3),
    of_world=st.dictionaries(flags, numbers, max_size=1),
)
def test_a_run_with_any_numbers(of_crane: dict[str, float], of_world: dict[str, float], tmp_path: Path, plain_looks: None) -> None:
    words = [f"--{name}={value!r}" for name, value in of_world.items()]
    words += ["--set", *(f"{name}:={value!r}" for name, value in of_crane.items())] if of_crane else []
    out = tmp_path / "out"
    code, err = _conducted(words, out)
    TRIED[f"numbers, exit code {code}"] += 1
    assert code in (0, 1, 2)
    assert (err == "") is (code == 0)
    assert err.startswith("error: ") or code == 0
    for name in files(out) if out.exists() else []:
        if name.endswith(".parquet"):
            kept = read(out / name)  # refuses what is not finite
            assert len(kept) >= 1
        (out / name).unlink()


@settings(many, max_examples=30)
@given(data=st.data(), module=st.sampled_from([a1, a2, a3]))
def test_a_file_of_any_signals(data: st.DataObject, module: object, tmp_path: Path) -> None:
    rows, step = data.draw(st.sampled_from([(1600, 0.04), (1600, 0.04), (400, 0.4), (12, 0.1), (2, 1.0)]))
    t = np.arange(rows) * step
    hoisting = np.interp(t, [30.0, 54.0], [20.0, 8.0])
    swing = 0.1 * np.cos(np.cumsum(np.sqrt(9.81 / hoisting)) * step)
    columns = {"t_s": t, "phi_rad": swing, "l_m": hoisting, "gamma_dot_rad_s": 0.01 * np.sin(t), "x_m": 20 + 0 * t, "theta_rad": swing}
    columns["theta_dot_rad_s"] = np.gradient(swing, t)
    shapes = (np.cos(0.8 * t), np.ones(rows), np.linspace(20.0, 8.0, rows), np.sign(np.cos(t)), np.exp(0.2 * t).clip(max=1e6))
    scales = st.sampled_from([0.0, 1e-300, 1e-9, 0.1, 1.0, 1e5, -1.0])
    for name in data.draw(st.sets(st.sampled_from(sorted(columns)), max_size=2)):
        columns[name] = data.draw(st.sampled_from(shapes)) * data.draw(scales) if name != "t_s" else t + data.draw(scales)
    path = tmp_path / "a.csv"
    pyarrow.csv.write_csv(pyarrow.table(columns), path)
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()) as err:
        code = module.main(["--from", str(path), "--out", str(tmp_path / "out")])  # type: ignore[attr-defined]
    TRIED[f"signals, exit code {code}"] += 1
    assert code in (0, 2)
    if code == 0:
        json.loads((tmp_path / "out" / "result.json").read_text(), parse_constant=lambda word: pytest.fail(f"{word} in result.json"))
    else:
        assert re.fullmatch(r"error: [^\n]+\.\n", err.getvalue())


def test_enough_was_tried_of_each_and_both_ends_were_met(record_property: Callable[[str, object], None]) -> None:
    if sum(TRIED.values()) < 1000:
        pytest.skip("the tests above were not run in this process")
    for name, count in sorted(TRIED.items()):
        record_property(name, count)
    for what in ("URDF, bytes", "URDF, elements", "URDF, recorded", "CSV, bytes", "PARQUET, bytes"):
        assert TRIED[f"{what} good"] > 0 and TRIED[f"{what} refused"] > 0, what
    assert TRIED["numbers, exit code 0"] > 0 and TRIED["numbers, exit code 2"] > 0
