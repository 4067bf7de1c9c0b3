"""Interfaces to other programs: recordings of ROS that are read, and cranes of any numbers and
names that are exported anywhere; what is written can be read back.
"""

from __future__ import annotations

import io
import math
import os
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any
from xml.sax.saxutils import quoteattr

import fmpy
import mujoco
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from cranedyn.bridges import bags, fmi, gazebo, mcap, mjcf, ros2
from cranedyn.bridges.programs import Program
from cranedyn.controllers import hold_controller
from cranedyn.data.trajectory import Trajectory
from cranedyn.model.crane import Crane
from cranedyn.model.description import describe
from cranedyn.model.load import load_crane
from cranedyn.simulation.simulate import simulate
from tests.system.fuzz.core import Broken, Case, Generator
from tests.system.fuzz.files import Edited, Rewritten, check_read, ended, slim
from tests.system.fuzz.lines import FILES, settings
from tests.system.fuzz.odd import NUMBERS

# --- recordings that are read ---------------------------------------------------------------------

_COLUMNS = ("t_s", "l_m", "phi_rad")
_JOINTS = ["hoist_joint", "swing_radial_joint", "yaw_joint"]
_PACKED = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]

Message = tuple[str, int, int, int, list[str], list[float], list[float]]
"""Topic, time of logging [ns], seconds and nanoseconds of the header, names, positions, rates."""


def _messages(count: int = 4) -> list[Message]:
    """As a robot sends them."""
    return [
        ("/joint_states", 10**9 + k * 10**7, 1, k * 10**7, list(_JOINTS), [9.0, 0.1, k / 7], [])
        for k in range(count)
    ]


def _recorded(messages: list[Message], packed: CompressionType, *, chunked: bool = True) -> bytes:
    """Messages in an MCAP file."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    state, header, stamp = (
        store.types[name]
        for name in (bags.TYPE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    file = io.BytesIO()
    writer = Writer(file, compression=packed, use_chunking=chunked, chunk_size=300)
    writer.start("ros2")
    schema = writer.register_schema(bags.TYPE, "ros2msg", b"")
    channels: dict[str, int] = {}
    for topic, time, seconds, nanoseconds, names, positions, rates in messages:
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        at = header(stamp=stamp(sec=seconds, nanosec=nanoseconds), frame_id="")
        numbers = (np.array(some, dtype=float) for some in (positions, rates, []))
        one = state(at, names, *numbers)
        data = bytes(store.serialize_cdr(one, bags.TYPE))
        writer.add_message(channels[topic], log_time=time, data=data, publish_time=time)
    writer.finish()
    return file.getvalue()


def _bag(packed: BagWriter.CompressionFormat | None) -> bytes:
    """The usual messages in a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    state, header, stamp = (
        store.types[name]
        for name in (bags.TYPE, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        unopened = BagWriter(path)
        if packed is not None:
            unopened.set_compression(packed)
        with unopened as writer:
            connection = writer.add_connection("/joint_states", bags.TYPE, typestore=store)
            for k, (_, time, seconds, nanoseconds, names, positions, _) in enumerate(_messages()):
                at = header(seq=k, stamp=stamp(sec=seconds, nanosec=nanoseconds), frame_id="")
                one = state(at, names, np.array(positions), np.zeros(0), np.zeros(0))
                writer.write(connection, time, store.serialize_ros1(one, bags.TYPE))
        return path.read_bytes()


@cache
def _recordings(ending: str) -> list[bytes]:
    """The usual messages, packed in every way."""
    if ending == "bag":
        return [_bag(packed) for packed in (None, *BagWriter.CompressionFormat)]
    return [
        *(_recorded(_messages(), packed) for packed in _PACKED),
        _recorded(_messages(), CompressionType.NONE, chunked=False),
    ]


def _read(ending: str) -> Callable[[bytes, int, Path], str]:
    def give(content: bytes, which: int, folder: Path) -> str:
        path = folder / f"a.{ending}"
        path.write_bytes(content)

        def all_of_it() -> None:
            found = bags.read_joint_states(path, _COLUMNS)
            check_read("a recording", found["t_s"], *found.values())

        ended(lambda: bags.joint_state_columns(path))
        return ended(all_of_it)

    return give


@dataclass(frozen=True)
class Messages:
    """Recordings of joint states whose times, names or numbers are odd."""

    name: str = "file MCAP, messages"
    weight: float = 1.0
    interruptible: bool = False

    def draw(self, rng: Random) -> Case:
        """How they are packed, and what is odd: which message, which part, and what instead."""
        odd: list[tuple[int, Any]] = [
            *((0, topic) for topic in ("/a", "", "/joint_states ", "\u2028", "x" * 300)),
            *((1, time) for time in (0, 2**63 - 1, 2**63, 2**64 - 1, 10**9 + 10**7)),
            *((2, seconds) for seconds in (0, -1, 2**31 - 1, -(2**31))),
            *((3, nanoseconds) for nanoseconds in (0, 2**32 - 1, 10**7)),
            *((4, names) for names in ([], ["a"], _JOINTS[::-1], _JOINTS * 2, [""] * 3, ["\n"])),
            *((5, [value, 0.1, 0.2]) for value in (math.nan, math.inf, 1e300, -0.0, 5e-324)),
            *((5, positions) for positions in ([], [9.0], [1.0] * 50)),
            *((6, rates) for rates in ([1.0], [math.nan] * 3)),
        ]
        count = rng.choice([1, 2, 4, 4, 4])
        parts = [(rng.randrange(count), *rng.choice(odd)) for _ in range(rng.choice([0, 1, 1, 2]))]
        return Case((count, rng.randrange(len(_PACKED))), parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Read it."""
        count, packed = case.head
        messages: list[Any] = [list(message) for message in _messages(count)]
        for which, part, new in case.parts:
            messages[which][part] = new
        return _read("mcap")(_recorded(messages, _PACKED[packed]), 0, folder)

    def shown(self, case: Case) -> str:
        """What is odd."""
        return f"{self.name}: {case}"


# --- exports --------------------------------------------------------------------------------------

_NAMES = ["ä", "a b", 'a"b', "<a>", "a&b", "a/b", "a\\b", "世界", "x" * 300, "1", "world", "start"]
_NAMES += [
    "%s",
    "a\u202eb",
    "a:b",
    "- a",
    "*",
    "a]]>b",
    "\u0085",
    "🏗",
    "yaw_joint ",
    "hold",
    "time",
]

_ENDINGS = {"mjcf": ".xml", "mcap": ".mcap", "fmu": ".fmu"}
"""Endings of the exporters that write a file."""


@dataclass(frozen=True)
class Exports:
    """Cranes with some odd numbers or names, exported to some place: it is refused and leaves
    nothing, or what was written is read back as that crane.
    """

    exporter: str
    weight: float = 0.5
    interruptible: bool = False

    @property
    def name(self) -> str:
        """Of the kind."""
        return f"export {self.exporter}"

    def draw(self, rng: Random) -> Case:
        """Where it goes, its step and gravity, and what is odd about the crane."""
        good = f"new{_ENDINGS.get(self.exporter, '')}"
        place = good if rng.random() < 0.8 else rng.choice(FILES) + rng.choice(["", good])
        step = 5e-4 if rng.random() < 0.9 else rng.choice(_numbers())
        gravity = rng.choice([9.80665, 9.80665, 1.62, 1e-3, 1e3])
        parts: list[Any] = []
        for _ in range(rng.choice([0, 1, 1, 2])):
            kind = rng.choice(["value", "value", "name", "element"])
            if kind == "value":
                name = rng.choice(sorted(settings()))
                scale = 10.0 ** rng.choice([0.01, 0.3, rng.uniform(-12.0, 12.0)])
                parts.append((kind, name, scale if rng.random() < 0.8 else rng.choice(_numbers())))
            elif kind == "name":
                parts.append((kind, rng.random(), rng.choice(_NAMES)))
            else:
                parts.append((kind, Rewritten("", 0.0, whole=False).draw(rng).parts))
        return Case((place, step, gravity), parts)

    def attempt(self, case: Case, folder: Path) -> str:
        """Export it, and read it back."""
        os.chdir(folder)
        (folder / "folder").mkdir()
        place, step, gravity = case.head

        made: list[Crane] = []
        if ended(lambda: made.append(self._crane(case, gravity))) == "refused":
            return "no crane"
        (crane,) = made
        before = sorted(os.listdir(folder))
        write, read = _EXPORTERS[self.exporter]
        if ended(lambda: write(Path(place), crane, step)) == "refused":
            if sorted(os.listdir(folder)) != before:
                raise Broken(f"a {self.exporter} export was refused and left something", place)
            return "refused"
        read(Path(place), crane)
        return "good"

    def shown(self, case: Case) -> str:
        """What is odd."""
        return f"{self.name}: {case}"

    def _crane(self, case: Case, gravity: float) -> Crane:
        values = {}
        for kind, name, *new in case.parts:
            if kind == "value":
                with suppress(ValueError):  # the default is another number's
                    values[name] = float(settings()[name].default) * new[0]
        text = describe(values=values, visuals=False) if values else slim()
        for kind, first, *rest in case.parts:
            if kind == "element":
                text = Rewritten("", 0.0, whole=False).text(Case(None, first))
            if kind != "name":
                continue
            names = sorted(set(re.findall(r'name="([^"]*)"', text)))
            old = names[int(first * len(names))]
            text = text.replace(f'"{old}"', quoteattr(rest[0]))
        Path("crane.urdf").write_text(text)
        return load_crane("crane.urdf", gravity=gravity)


def _numbers() -> list[float]:
    found = []
    for word in NUMBERS:
        try:
            found.append(float(word))
        except ValueError:
            continue
    return found


def _same(one: Crane, other: Crane, *, starts: bool = True) -> None:
    for what in ("damping", "lower", "upper", "effort_limit"):
        if not np.array_equal(getattr(one, what), getattr(other, what)):
            raise Broken(f"an exported crane is read back with another {what}")
    if one.payload_mass != other.payload_mass:
        raise Broken("an exported crane is read back with another load")
    if starts and not np.array_equal(one.start.q, other.start.q):
        raise Broken("an exported crane is read back with another start")


def _read_mjcf(path: Path, crane: Crane) -> None:
    model = mujoco.MjModel.from_xml_string(path.read_text())
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    if not np.isfinite(data.qacc).all():
        raise Broken("MuJoCo moves an exported crane by what is not finite", data.qacc)
    if not np.array_equal(data.qpos, crane.start.q):
        raise Broken("an exported crane starts elsewhere in MuJoCo", data.qpos)
    if not np.array_equal(model.dof_damping, crane.damping):
        raise Broken("an exported crane is damped otherwise in MuJoCo", model.dof_damping)


def _read_ros2(path: Path, crane: Crane) -> None:
    _same(crane, load_crane(path / "urdf" / "crane.urdf", gravity=crane.gravity))
    for file in path.rglob("*"):
        if file.suffix in (".xml", ".sdf", ".urdf"):
            ET.parse(file)
    told = YAML(typ="safe").load((path / "config" / "controllers.yaml").read_text())
    drives = [joint.name for joint in crane.layout.driven]
    if told["drives"]["ros__parameters"]["joints"] != drives:
        raise Broken("controllers of ROS are told of other drives", told)


def _read_gazebo(path: Path, crane: Crane) -> None:
    model, driven = path / "models" / "crane" / "model.urdf", [j.name for j in crane.layout.driven]
    _same(crane, load_crane(model, gravity=crane.gravity, driven=driven), starts=False)
    ET.parse(path / "world.sdf")
    for file in path.glob("*.csv"):
        if not np.isfinite(np.loadtxt(file, delimiter=",")).all():
            raise Broken("a table for Gazebo holds what is not finite", file.name)


def _ran(crane: Crane) -> Trajectory:
    return simulate(crane, hold_controller(crane), duration=0.02, validity="mark")


def _read_mcap(path: Path, crane: Crane) -> None:
    roles = {joint.symbol: joint.name for joint in crane.layout.joints}
    names = {symbol: name for symbol, name in roles.items() if symbol in bags.NAMES}
    columns = [column for column in ("l_m", "phi_rad") if column in _ran(crane).columns]
    found = bags.read_joint_states(path, columns, names)
    if not all(np.array_equal(found[column], _ran(crane)[column]) for column in columns):
        raise Broken("a run is read back from MCAP with other numbers", found)


def _read_fmu(path: Path, crane: Crane) -> None:
    description = fmpy.read_model_description(str(path))
    for variable in description.modelVariables:
        if variable.start is not None and not math.isfinite(float(variable.start)):
            raise Broken("a unit starts with what is not finite", variable.name)


def _write_gazebo(path: Path, crane: Crane, dt: float) -> object:
    law = hold_controller(crane)
    return gazebo.export(path, Program(crane, law, None, crane.start, 0.1, dt=dt))


_EXPORTERS: dict[
    str, tuple[Callable[[Path, Crane, float], object], Callable[[Path, Crane], None]]
] = {
    "mjcf": (lambda path, crane, dt: mjcf.export(path, crane, dt=dt), _read_mjcf),
    "ros2": (lambda path, crane, dt: ros2.export(path, crane, dt=dt), _read_ros2),
    "gazebo": (_write_gazebo, _read_gazebo),
    "mcap": (lambda path, crane, dt: mcap.export(path, crane, _ran(crane)), _read_mcap),
    "fmu": (lambda path, crane, dt: fmi.export(crane, path, dt=dt), _read_fmu),
}

GENERATORS: list[Generator] = [
    Edited("file MCAP, bytes", 1.0, lambda: _recordings("mcap"), _read("mcap")),
    Edited("file bag, bytes", 1.0, lambda: _recordings("bag"), _read("bag")),
    Messages(),
    *(Exports(exporter, 0.05 if exporter == "fmu" else 0.5) for exporter in _EXPORTERS),
]
