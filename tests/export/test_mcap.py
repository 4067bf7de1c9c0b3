"""Runs as ROS messages: written as MCAP, read back by rosbags, and recordings of ROS analysed by
the experiments.
"""

from __future__ import annotations

import bz2
import io
import json
import sqlite3
import tracemalloc
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

rosbags = pytest.importorskip(
    "rosbags", reason="rosbags is not installed: pip install 'cranedyn[mcap]'"
)
pytest.importorskip(
    "mcap_ros2", reason="mcap-ros2-support is not installed: pip install 'cranedyn[mcap]'"
)

from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.rosbag1 import Writer as BagWriter  # noqa: E402
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as FolderWriter  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from cranedyn.__main__ import main  # noqa: E402
from cranedyn.controllers import hold_controller  # noqa: E402
from cranedyn.data.trajectory import Trajectory  # noqa: E402
from cranedyn.dynamics.equations_of_motion import payload_position  # noqa: E402
from cranedyn.errors import CraneError, DataError, OutOfRange, UnknownName  # noqa: E402
from cranedyn.export import mcap  # noqa: E402
from cranedyn.identification.checked_record import load_record  # noqa: E402
from cranedyn.interop import bags  # noqa: E402
from cranedyn.model.load import load_crane  # noqa: E402
from cranedyn.simulation.simulate import simulate  # noqa: E402
from experiments import a1, a3, harness  # noqa: E402
from tests.gantry import GANTRY  # noqa: E402
from tests.helpers import FAST  # noqa: E402
from tests.model.test_foreign import RIGID  # noqa: E402

SETUP = harness.Setup(9.8, engine=FAST)


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return a3.run(SETUP)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory, run: Trajectory) -> Path:
    """The run from its start, with what the article's analysis needs."""
    return mcap.export(tmp_path_factory.mktemp("mcap") / "a3.mcap", SETUP.crane, run)


@pytest.fixture(scope="module")
def messages(file: Path) -> dict[str, list[tuple[int, Any]]]:
    found: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([file]) as reader:
        for connection, time, raw in reader.messages():
            if time <= 10 * 10**9:
                found.setdefault(connection.topic, []).append(
                    (time, reader.deserialize(raw, connection.msgtype))
                )
    return found


# --- written, and read by rosbags -----------------------------------------------------------------


@pytest.mark.slow
def test_rosbags_reads_every_joint_state_to_the_bit(messages: Any, run: Trajectory) -> None:
    states = messages["/joint_states"]
    early = run.before(10.0 + 1e-9)
    assert len(states) == len(early)
    assert states[0][1].name == [joint.name for joint in SETUP.crane.layout.joints]
    for k, (time, message) in enumerate(states):
        stamp = message.header.stamp
        assert time == stamp.sec * 10**9 + stamp.nanosec == round(1e9 * early.t[k])
        assert message.position.tolist() == early.q[k].tolist()
        assert message.velocity.tolist() == early.v[k].tolist()
        assert message.effort[[0, 1, 4]].tolist() == early.effort[k].tolist()
        assert message.effort[[2, 3]].tolist() == [0.0, 0.0]  # the swing has no drive


def test_messages_are_published_when_they_are_logged(file: Path) -> None:
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        for k, (_, _, message) in enumerate(make_reader(stream).iter_messages()):
            assert message.publish_time == message.log_time
            if k == 1000:
                break
    assert message.log_time > 0


def test_setpoints_and_commands_are_those_of_the_drives(messages: Any, run: Trajectory) -> None:
    _, message = messages["/joint_setpoints"][1100]
    assert message.name == ["yaw_joint", "trolley_joint", "hoist_joint"]
    assert (message.position.tolist(), message.effort.tolist()) == (
        run.setpoint[1100].tolist(),
        run.command[1100].tolist(),
    )


@pytest.mark.slow
def test_a_command_that_a_drive_cuts_is_told_as_it_was_given(tmp_path: Path) -> None:
    weak = load_crane(trolley_effort=800.0)
    start = weak.state(phi=0.1)
    cut = simulate(weak, hold_controller(weak), start=start, duration=0.1, engine=FAST)
    assert (cut.command != cut.effort).any()
    told: dict[str, list[list[float]]] = {"/joint_setpoints": [], "/joint_states": []}
    with AnyReader([mcap.export(tmp_path / "cut.mcap", weak, cut)]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic in told:
                message = reader.deserialize(raw, connection.msgtype)
                told[connection.topic].append(message.effort.tolist())
    assert told["/joint_setpoints"] == cut.command.tolist()
    # States tell the effort that acted: the trolley's is at its limit of 800 N.
    acted = np.array(told["/joint_states"])[:, [0, 1, 4]]
    assert np.array_equal(acted, cut.effort)
    assert np.abs(acted[:, 1]).max() == 800.0 < np.abs(cut.command[:, 1]).max()


def test_frames_come_fifty_times_a_second(messages: Any) -> None:
    times = [time for time, _ in messages["/tf"]]
    assert set(np.diff(times).tolist()) == {20_000_000}


def test_every_frame_is_that_of_a_link_in_the_frame_of_its_parent(messages: Any) -> None:
    told = set()
    for topic in ("/tf_static", "/tf"):
        _, message = messages[topic][0]
        told |= {(one.header.frame_id, one.child_frame_id) for one in message.transforms}
    joints = ET.fromstring(messages["/robot_description"][0][1].data).iterfind("joint")
    ends = [[joint.find(end) for end in ("parent", "child")] for joint in joints]
    assert told == {tuple(end.get("link", "") for end in pair) for pair in ends}


def test_the_frames_put_the_load_where_the_model_does(messages: Any, run: Trajectory) -> None:
    (_, static), *_ = messages["/tf_static"]
    for time, message in messages["/tf"][:: len(messages["/tf"]) // 5]:
        frames = {one.child_frame_id: one for one in [*static.transforms, *message.transforms]}
        links = "foot_link base_link upper_link trolley_link swing_r_link swing_t_link hook_link"
        assert list(frames) == links.split()
        point = np.zeros(3)
        frame = "hook_link"
        while frame != "world":
            moved = frames[frame].transform.translation
            turned = frames[frame].transform.rotation
            axis = np.array([turned.x, turned.y, turned.z])
            w = turned.w
            point = (
                point
                + 2.0 * np.cross(axis, np.cross(axis, point) + w * point)
                + [moved.x, moved.y, moved.z]
            )
            frame = frames[frame].header.frame_id
        row = int(np.searchsorted(run.t, time / 1e9 - 1e-6))
        assert_allclose(point, payload_position(SETUP.crane, run.q[row]), atol=1e-12)  # rounding


def test_the_description_of_the_robot_is_in_it(messages: Any) -> None:
    ((_, message),) = messages["/robot_description"]
    assert message.data == SETUP.crane.urdf


def test_what_is_published_once_plays_back_to_who_comes_late(file: Path) -> None:
    with AnyReader([file]) as reader:
        profiles = {one.topic: one.ext.offered_qos_profiles for one in reader.connections}  # type: ignore[union-attr]
    assert profiles.keys() == mcap.TYPES.keys()
    for topic, offered in profiles.items():
        kept = [(p.reliability.name, p.durability.name, p.history.name, p.depth) for p in offered]
        once = topic in ("/tf_static", "/robot_description")
        assert kept == [("RELIABLE", "TRANSIENT_LOCAL", "KEEP_LAST", 1)] * once


def test_the_command_writes_a_run_with_the_crane_that_its_record_names(tmp_path: Path) -> None:
    crane = load_crane(machine="gantry_cosys")
    file = tmp_path / "run.mcap"
    run = simulate(crane, hold_controller(crane), duration=0.02)
    trajectory = str(run.write(tmp_path / "run.parquet"))
    assert main(["export", "mcap", str(file), "--trajectory", trajectory]) == 0
    with AnyReader([file]) as reader:
        last = {one.topic: raw for one, _, raw in reader.messages()}
    assert b'robot name="overhead_crane"' in last["/robot_description"]
    assert bags.read_joint_states(file, ["l_m"])["l_m"].tolist() == run["l_m"].tolist()


def test_a_run_of_another_crane_is_refused_with_the_coordinates_of_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rigid = tmp_path / "rigid.urdf"
    rigid.write_text(RIGID)
    crane = load_crane(rigid, swing=True)
    run = simulate(crane, hold_controller(crane), duration=0.02)
    trajectory = str(run.write(tmp_path / "swing.parquet"))
    words = ["export", "mcap", str(tmp_path / "run.mcap"), "--trajectory", trajectory]
    assert main([*words, "--urdf", str(rigid), "--driven", "azimuth", "cart", "lift"]) == 2
    sentence = capsys.readouterr().err
    assert "a run of a crane with the coordinates gamma_rad, x_m, phi_rad" in sentence
    assert "leave out --urdf" in sentence and "or give --swing as for the run" in sentence
    assert not (tmp_path / "run.mcap").exists()
    with pytest.raises(OutOfRange, match="run is of joints gamma, x, phi, theta, l; allowed is a"):
        mcap.export(tmp_path / "run.mcap", load_crane(hook_mass=9.0), run)
    assert main([*words, "--urdf", str(rigid), "--swing"]) == 0


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(GANTRY)
    return path


def test_a_recording_of_another_crane_is_read_by_the_names_of_its_joints(
    gantry: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    crane = load_crane(gantry, swing={"mass": 1500.0})
    start = crane.state(theta=0.1)
    run = simulate(crane, hold_controller(crane), start=start, duration=30.0, engine=FAST)
    trajectory = str(run.write(tmp_path / "run.parquet"))
    file = tmp_path / "run.mcap"
    options = ["--urdf", str(gantry), "--swing", "mass:=1500"]
    assert main(["export", "mcap", str(file), "--trajectory", trajectory, *options]) == 0
    assert f"cranedyn run identify {file} {' '.join(options)}\n" in capsys.readouterr().out
    columns = ["portal_m", "cross_m", "theta_rad", "l_m", "l_dot_m_s", "F_portal_N", "F_l_N"]
    assert {*columns} <= {*bags.joint_state_columns(file, layout=crane.layout)}
    found = bags.read_joint_states(file, columns, layout=crane.layout)
    for column in columns:
        assert found[column].tolist() == run[column].tolist()
    record = load_record(file, crane)
    assert {"portal_m", "cross_m", "l_m", "theta_rad"} <= record.columns.keys()


@pytest.mark.parametrize(
    ("formula", "zero", "sign"),
    [
        ("hook", 0.0, 1.0),
        ("-hook", 0.0, -1.0),
        ("8 m - hook", 8.0, -1.0),
        ("8-hook", 8.0, -1.0),
        ("-1.5e1 + hook", -15.0, 1.0),
    ],
)
def test_a_formula_moves_the_zero_of_a_recorded_joint_and_turns_its_sign(
    formula: str, zero: float, sign: float, gantry: Path, tmp_path: Path
) -> None:
    crane = load_crane(gantry, swing=True)
    run = simulate(crane, hold_controller(crane), start=crane.state(l_dot=0.3), duration=0.5)
    path = mcap.export(tmp_path / "run.mcap", crane, run)
    columns = ["l_m", "l_dot_m_s", "F_l_N", "cross_m"]
    recorded = bags.read_joint_states(path, columns, layout=crane.layout)
    names = {"l": formula.replace("hook", "lift_joint")}
    found = bags.read_joint_states(path, columns, names, layout=crane.layout)
    assert found["l_m"].tolist() == (zero + sign * recorded["l_m"]).tolist()
    assert found["l_dot_m_s"].tolist() == (sign * recorded["l_dot_m_s"]).tolist()
    assert found["F_l_N"].tolist() == (sign * recorded["F_l_N"]).tolist()
    assert found["cross_m"].tolist() == recorded["cross_m"].tolist()


def test_the_formula_that_describe_prints_gives_the_coordinates_of_a_bag(
    gantry: Path, tmp_path: Path
) -> None:
    """The bag has the joints as the URDF counts them: the hook 2 m above its lowest place."""
    crane = load_crane(gantry, swing=True)
    (note,) = [text for text in crane.assumptions if text.startswith("l = ")]
    symbol, _, formula = note.partition(", ")[0].partition(" = ")
    assert formula == "8 m - lift_joint"
    path = bag(tmp_path / "a.bag", ["lift_joint", "cross_joint"], rows=3, phi=2.0)
    found = bags.read_joint_states(path, ["l_m"], {symbol: formula}, layout=crane.layout)
    assert found["l_m"].tolist() == [6.0, 6.0, 6.0]


def test_a_joint_that_a_recording_does_not_have_is_a_sentence(gantry: Path, tmp_path: Path) -> None:
    layout = load_crane(gantry, swing=True).layout
    path = bag(tmp_path / "a.bag", ["cross_joint", "lift_joint"], rows=3)
    with pytest.raises(DataError, match=r"has no joint cart, but cross_joint, .*--joints cross="):
        bags.joint_state_columns(path, {"cross": "cart"}, layout=layout)
    with pytest.raises(UnknownName, match="no coordinate 'x'; there are portal, cross, phi, theta"):
        bags.joint_state_columns(path, {"x": "cross_joint"}, layout=layout)


# --- recordings of ROS analysed -------------------------------------------------------------------


@pytest.mark.slow
def test_a_recording_is_analysed_as_the_run_itself(
    file: Path, run: Trajectory, tmp_path: Path
) -> None:
    files = [str(file), str(run.write(tmp_path / "a3.parquet"))]
    out = tmp_path / "out"
    with redirect_stdout(io.StringIO()):
        assert a3.main(["--from", *files, "--out", str(out)]) == 0
    ours, same, _ = json.loads((out / "result.json").read_text())["tables"][0]["rows"]
    # A time that rounds to 4 s or just below is a row more or less of all.
    assert_allclose(ours[2:], same[2:], rtol=1.0 / len(run))


def joint_states(
    store: Any, names: list[str], rows: int, position: Any, *, start: int = 0, interval: int = 10**9
) -> Iterator[tuple[int, Any]]:
    """Times [ns] and joint states of a store of types, of positions by row."""
    kinds = ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    state, header, stamp = (store.types[name] for name in kinds)
    for k in range(rows):
        time = start + k * interval
        seq = {"seq": k} if "seq" in header.__dataclass_fields__ else {}
        at = header(stamp=stamp(sec=time // 10**9, nanosec=time % 10**9), frame_id="", **seq)
        yield time, state(at, names, np.array(position(k)), np.zeros(0), np.zeros(0))


def bag(path: Path, names: list[str], *, rows: int = 1401, **parts: Any) -> Path:
    """A ROS 1 bag of a free swing on 15 m, 20 rows a second, as a real robot would record it: from
    an epoch on, other names.
    """
    store = get_typestore(Stores.ROS1_NOETIC)
    unopened = BagWriter(path)
    if parts.get("packed"):
        unopened.set_compression(parts["packed"])

    def position(k: int) -> list[float]:
        phi = parts.get("phi", 0.1 * np.cos(2.0 * np.pi / 7.8 * 0.05 * k))
        return [phi, 15.0] + [0.0] * (len(names) - 2)

    interval = 0 if parts.get("stopped") else 50_000_000
    epoch = 1_700_000_000 * 10**9
    with unopened as writer:
        connection = writer.add_connection("/crane/state", bags.TYPE, typestore=store)
        for time, one in joint_states(store, names, rows, position, start=epoch, interval=interval):
            writer.write(connection, time, store.serialize_ros1(one, bags.TYPE))
    return path


def folder_of_ros2(path: Path, names: list[str], *, rows: int = 1401, **options: Any) -> Path:
    """A folder as ``ros2 bag record`` makes it, with a free swing on 15 m, 20 rows a second.

    Options are those of `rosbags.rosbag2.Writer.set_compression`, and the storage.
    """
    store = get_typestore(Stores.ROS2_HUMBLE)
    storage = options.pop("storage", StoragePlugin.SQLITE3)
    unopened = FolderWriter(path, version=9, storage_plugin=storage)
    if options:
        unopened.set_compression(**options)

    def position(k: int) -> list[float]:
        return [0.1 * np.cos(2.0 * np.pi / 7.8 * 0.05 * k), 15.0] + [0.0] * (len(names) - 2)

    epoch = 1_700_000_000 * 10**9
    with unopened as writer:
        words = writer.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        states = writer.add_connection("/crane/state", bags.TYPE, typestore=store)
        said = store.types["std_msgs/msg/String"](data="hello")
        for time, one in joint_states(
            store, names, rows, position, start=epoch, interval=50_000_000
        ):
            writer.write(words, time, store.serialize_cdr(said, "std_msgs/msg/String"))
            writer.write(states, time, store.serialize_cdr(one, bags.TYPE))
    return path


def database(path: Path, names: list[str], *, rows: int) -> Path:
    """The SQLite file of such a folder."""
    made = folder_of_ros2(path.with_name(f"{path.stem}_folder"), names, rows=rows)
    (file,) = made.glob("*.db3")
    return file.rename(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"storage": StoragePlugin.MCAP},
        {"mode": CompressionMode.MESSAGE, "fmt": CompressionFormat.ZSTD},
    ],
)
def test_a_folder_of_ros_2_is_analysed_and_its_metadata_are_not_read(
    options: Any, tmp_path: Path
) -> None:
    folder = folder_of_ros2(tmp_path / "bag", ["pendulum", "rope"], **options)
    (folder / "metadata.yaml").write_text("!!python/object/apply:os.system ['false']")
    words = ["--joints", "phi=pendulum", "l=rope", "--out", str(tmp_path / "out")]
    with redirect_stdout(io.StringIO()):
        assert a1.main(["--from", str(folder), *words]) == 0
    (row,) = json.loads((tmp_path / "out" / "result.json").read_text())["tables"][0]["rows"]
    assert row[1:3] == [15.0, pytest.approx(7.8, abs=1e-6)]


@pytest.mark.slow
def test_a_database_of_ros_2_is_read_like_its_folder(tmp_path: Path) -> None:
    file = database(tmp_path / "a.db3", ["swing_radial_joint", "hoist_joint"], rows=30)
    found = bags.read_joint_states(file, ["t_s", "phi_rad", "l_m"])
    np.testing.assert_allclose(found["t_s"], 0.05 * np.arange(30), rtol=1e-12)
    assert set(found["l_m"]) == {15.0}


def test_a_folder_that_is_no_recording_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="it is a folder without a recording of ROS 2"):
        bags.read_joint_states(tmp_path, ["l_m"])
    (tmp_path / "a.db3").symlink_to("/etc/passwd")  # out of the folder: not followed
    with pytest.raises(DataError, match="it is a folder without a recording of ROS 2"):
        bags.read_joint_states(tmp_path, ["l_m"])
    (tmp_path / "b.db3.zstd").write_bytes(b"")
    with pytest.raises(DataError, match=r"b\.db3\.zstd is packed; unpack it"):
        bags.read_joint_states(tmp_path, ["l_m"])


def test_a_database_whose_tables_are_views_is_refused(tmp_path: Path) -> None:
    """A view may call functions; a recording has none."""
    database_ = sqlite3.connect(tmp_path / "a.db3")
    database_.execute("CREATE VIEW topics AS SELECT 1 AS id")
    database_.execute("CREATE TABLE messages (id)")
    database_.commit()
    database_.close()
    with pytest.raises(DataError, match="it is no recording of ROS 2"):
        bags.read_joint_states(tmp_path / "a.db3", ["l_m"])


def test_messages_before_since_are_not_judged(tmp_path: Path) -> None:
    """A sensor that starts with NaN."""
    path = bag(tmp_path / "a.bag", ["swing_radial_joint", "hoist_joint"], rows=3, phi=float("nan"))
    with pytest.raises(DataError, match="not finite in its message 1"):
        bags.read_joint_states(path, ["t_s", "phi_rad"])
    with pytest.raises(DataError, match="not finite in its message 2"):
        bags.read_joint_states(path, ["t_s", "phi_rad"], since=0.04)
    found = bags.read_joint_states(path, ["t_s", "l_m"], since=0.04)
    assert found["t_s"].tolist() == [0.05, 0.1]


@pytest.mark.parametrize(
    "packed", [None, BagWriter.CompressionFormat.BZ2, BagWriter.CompressionFormat.LZ4]
)
def test_a_bag_of_ros_1_with_names_of_its_own_is_analysed(packed: Any, tmp_path: Path) -> None:
    path = bag(tmp_path / "real.bag", ["pendulum", "rope"], packed=packed)
    words = ["--joints", "phi=pendulum", "l=rope", "--out", str(tmp_path / "out")]
    with redirect_stdout(io.StringIO()):
        assert a1.main(["--from", str(path), *words]) == 0
    (row,) = json.loads((tmp_path / "out" / "result.json").read_text())["tables"][0]["rows"]
    assert row[1:3] == [15.0, pytest.approx(7.8, abs=1e-6)]


@pytest.mark.parametrize(
    ("made", "words", "sentence"),
    [
        ({}, "", "has no joint swing_radial_joint, but shoulder, elbow; say which is phi by "),
        ({}, "--joints phi=shoulder", "has no joint hoist_joint, but shoulder, elbow; say which"),
        ({}, "--joints phi", "phi of --joints is not of the form NAME=VALUE, each name once."),
        ({}, "--joints psi=elbow", "There is no coordinate 'psi'; there are gamma, x, phi, theta"),
        ({"stopped": True}, "--joints phi=shoulder l=elbow", "some of them the same; allowed are"),
        (
            {"phi": float("nan")},
            "--joints phi=shoulder l=elbow",
            "position of shoulder is not finite in its message 1.",
        ),
        ({"rows": 0}, "", "has joint states on none; allowed are messages on /joint_states, or on"),
    ],
)
def test_a_bag_of_another_robot_is_a_sentence(
    made: dict[str, Any],
    words: str,
    sentence: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = bag(tmp_path / "other.bag", ["shoulder", "elbow"], **{"rows": 3, **made})
    assert a1.main(["--from", str(path), *words.split(), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and sentence in error
    assert not (tmp_path / "out").exists()


def recorded(
    path: Path, count: int, *, padding: int = 0, definition: bytes = b"", backwards: bool = False
) -> Path:
    """An MCAP file of joint states, and as many messages of some bytes on another topic."""
    from mcap.writer import CompressionType, Writer

    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start("ros2")
        schemas = [writer.register_schema(n, "ros2msg", definition) for n in (bags.TYPE, "image")]
        states, others = (
            writer.register_channel(topic, "cdr", schema)
            for topic, schema in zip(("/joint_states", "/image"), schemas, strict=True)
        )
        messages = [*joint_states(store, ["hoist_joint"], count, lambda k: [15.0 + k])]
        for time, one in reversed(messages) if backwards else messages:
            writer.add_message(states, time, bytes(store.serialize_cdr(one, bags.TYPE)), time)
            if padding:
                writer.add_message(others, time, bytes(padding), time)
        writer.finish()
    return path


def test_what_a_file_says_of_its_own_messages_is_not_looked_at(tmp_path: Path) -> None:
    """Parsers of definitions make Python of them and run it; recorders may write out of order."""
    definition = b"float64[] position\nint32 __import__('os').abort()\n\xff"
    path = recorded(tmp_path / "odd.mcap", 2, definition=definition, backwards=True)
    found = bags.read_joint_states(path, ["t_s", "l_m"])
    assert (found["t_s"].tolist(), found["l_m"].tolist()) == ([0.0, 1.0], [15.0, 16.0])


def test_rates_that_a_recording_lacks_are_a_sentence(tmp_path: Path) -> None:
    path = bag(tmp_path / "one.bag", ["yaw_joint", "hoist_joint"], rows=3)
    with pytest.raises(
        CraneError,
        match=r"has no velocity of yaw_joint in its message 1; gamma_dot_rad_s needs one\.",
    ):
        bags.read_joint_states(path, ["gamma_dot_rad_s"])
    with pytest.raises(CraneError, match="cannot have a column energy_J"):
        bags.read_joint_states(path, ["energy_J"])


@pytest.mark.slow
def test_a_damaged_file_is_a_sentence_wherever_it_is_damaged(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    broken = tmp_path / "broken.mcap"
    for cut in (0, 3, 8, 60, len(whole) // 3, len(whole) - 20):
        broken.write_bytes(whole[:cut])
        with pytest.raises(CraneError, match=r"^Cannot read .*broken\.mcap"):
            bags.read_joint_states(broken, ["l_m"])
    for seed in range(20):
        changed = bytearray(whole[:200_000])
        for place in np.random.default_rng(seed).integers(9, len(changed), 30):
            changed[place] ^= 0xFF
        broken.write_bytes(changed)
        with pytest.raises(CraneError):
            bags.read_joint_states(broken, ["l_m"])
    (tmp_path / "text.bag").write_text("#ROSBAG V2.0\nnothing")
    with pytest.raises(CraneError, match=r"^Cannot read .*text\.bag"):
        bags.read_joint_states(tmp_path / "text.bag", ["l_m"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("compression", "sentence"),
    [
        ("zstd", "more than 100 MB"),
        ("lz4", "more than 100 MB"),
        ("bz2", "more than 100 MB"),
        ("rar", "compressed by rar; allowed are zstd"),
    ],
)
def test_a_small_piece_that_unpacks_without_end_is_refused(compression: str, sentence: str) -> None:
    import lz4.frame
    import zstandard

    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "bz2": bz2.compress}
    packed = pack.get(compression, zlib.compress)(bytes(101_000_000))
    assert len(packed) < 1_000_000
    with pytest.raises(CraneError, match=sentence):
        bags._decompressed(compression, packed)


def test_pieces_that_unpack_to_more_than_a_file_may_hold_together_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = recorded(tmp_path / "large.mcap", 6, padding=1_000_000)
    assert path.stat().st_size < 100_000
    assert bags.read_joint_states(path, ["l_m"])["l_m"].tolist() == [15.0 + k for k in range(6)]
    monkeypatch.setattr(bags, "LARGEST", 5_000_000)
    with pytest.raises(CraneError, match=r"The recording holds more than 5 MB\."):
        bags.read_joint_states(path, ["l_m"])


@pytest.mark.slow
def test_a_recording_of_many_joint_states_takes_the_memory_of_its_columns(tmp_path: Path) -> None:
    count = 5000
    path = recorded(tmp_path / "many.mcap", count)
    bags.read_joint_states(path, ["l_m"])  # so that all is imported
    tracemalloc.start()
    found = bags.read_joint_states(path, ["t_s", "l_m"])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found["l_m"].tolist() == [15.0 + k for k in range(count)]
    # A chunk of 0.75 MB twice, a part of it, and five arrays of eight bytes a message.
    assert peak < 2 * 0.75e6 + bags._BLOCK_SIZE + 40 * count


def test_what_cannot_be_written_is_a_sentence(
    tmp_path: Path, run: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "b.mcap"
    with pytest.raises(CraneError, match=r"the ending must be \.mcap"):
        mcap.export(tmp_path / "a.bag", SETUP.crane, run)
    with pytest.raises(
        CraneError, match=r"MCAP is that of no row; allowed is 0 or later .s.: times"
    ):
        mcap.export(file, SETUP.crane, run.before(-1.0))
    monkeypatch.setattr(mcap, "find_spec", lambda name: None)
    with pytest.raises(CraneError, match=r"^mcap-ros2-support is not installed: pip install 'cra"):
        mcap.export(file, SETUP.crane, run)
    with pytest.raises(CraneError, match="is not installed"):
        bags.read_joint_states(file, ["l_m"])
    assert [*tmp_path.iterdir()] == []
