"""Import of ROS recordings: columns of a trajectory from joint states in .mcap, .db3 and .bag files
and in folders of ROS 2.
"""

from __future__ import annotations

import bz2
import math
import os
import re
import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from cranedyn.data.bounded import read_bounded
from cranedyn.data.files import open_file
from cranedyn.data.tables import LARGEST
from cranedyn.errors import CraneError, DataError, UnknownName, quoted
from cranedyn.export.mcap import check_installed
from cranedyn.model.layout import ROLES, Joint, Layout

ENDINGS = (".mcap", ".bag", ".db3")
"""Endings of files that can be read: MCAP and SQLite of ROS 2, bags of ROS 1."""

FOLDER_ENDINGS = (".mcap", ".db3")
"""Endings of the files in a folder that ``ros2 bag record`` made."""

_ZSTANDARD = b"\x28\xb5\x2f\xfd"
"""First bytes of a compressed message; one that is not compressed begins with a zero."""

TYPE = "sensor_msgs/msg/JointState"
"""Type of the messages that are read."""

TOPIC = "/joint_states"
"""Topic from which they are taken where there are several."""

_TOWER_JOINTS = tuple(
    Joint(
        name=role.joint,
        symbol=role.symbol,
        unit="m" if role.kind == "prismatic" else "rad",
        kind=role.kind,
        axis=role.axis,
        driven=not name.endswith("swing"),
        role=name,
    )
    for name, role in ROLES.items()
)
"""Joints of the tower crane of this project, for recordings that are read without a crane."""


class _Source(NamedTuple):
    """Where the numbers of a column are in a message.

    Attributes:
        field: Field of the message: "position", "velocity" or "effort".
        symbol: Symbol of the coordinate.
    """

    field: str
    symbol: str


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
"""Decimal number in a formula."""

_FORMULA = re.compile(
    rf"(?:(?P<zero>{_NUMBER})\s*(?:rad|m)?\s*(?P<sign>[-+])|(?P<minus>-))\s*(?P<joint>[^\s\d].*)"
)
"""A formula of a coordinate such as ``8 m - lift_joint``, ``1.5708+slew`` or ``-pendulum``."""


class _RecordedJoint(NamedTuple):
    """Joint in a recording, from which a coordinate follows as `zero` + `sign` · position.

    Attributes:
        name: Name in the messages.
        zero: Coordinate where the recorded position is zero [rad or m].
        sign: Coordinate per position, +1 or -1; rates and efforts have the same sign.
    """

    name: str
    zero: float = 0.0
    sign: float = 1.0

    @classmethod
    def of(cls, text: str) -> _RecordedJoint:
        """Return the joint of a name, or of a formula as `describe` prints it."""
        match = _FORMULA.fullmatch(text.strip())
        if match is None:
            return cls(text)
        sign = match["minus"] or match["sign"]
        return cls(match["joint"], float(match["zero"] or 0.0), -1.0 if sign == "-" else 1.0)


class _Sources:
    """Where the numbers of columns are in the messages of one crane.

    Attributes:
        recorded: Joints in the messages by the symbols of their coordinates.
        by_column: Field and symbol by the name of the column, of all columns that messages can
            have.
    """

    def __init__(self, layout: Layout | None, names: Mapping[str, str] | None) -> None:
        """Use the names of the joints of a crane, those of the tower crane without one, except
        where `names` has others.

        Raises:
            UnknownName: If `names` has an unknown coordinate.
        """
        joints = _TOWER_JOINTS if layout is None else layout.joints
        self.recorded = {joint.symbol: _RecordedJoint(joint.name) for joint in joints}
        for symbol, text in (names or {}).items():
            if symbol not in self.recorded:
                raise UnknownName("coordinate", symbol, self.recorded)
            self.recorded[symbol] = _RecordedJoint.of(text)
        self.by_column: dict[str, _Source] = {}
        for joint in joints:
            coordinate, rate = joint.columns
            self.by_column[coordinate] = _Source("position", joint.symbol)
            self.by_column[rate] = _Source("velocity", joint.symbol)
            self.by_column[joint.effort_column] = _Source("effort", joint.symbol)


_MAX_CHUNK_SIZE = 100_000_000
"""Largest size of a compressed chunk of a file, decompressed [bytes]."""

_BLOCK_SIZE = 1_000_000
"""Size of the pieces in which a chunk is decompressed [bytes]."""

_ROUND_OFF = 1e-9
"""Round-off of a time at which a record begins or ends [s]."""

_MCAP_END = struct.pack("<BQ20x8B", 2, 20, *b"\x89MCAP0\r\n")
"""Footer of an MCAP file, at which its reader ends."""

Raw = tuple[str, int, bytes]
"""Topic, time of logging [ns], message."""


def read_joint_states(
    path: str | Path,
    columns: Sequence[str],
    names: Mapping[str, str] | None = None,
    *,
    layout: Layout | None = None,
    since: float = -math.inf,
    until: float = math.inf,
) -> dict[str, np.ndarray]:
    """Read columns of a trajectory from the joint states in a recording of ROS 2 (.mcap, .db3, or
    the folder of them) or ROS 1 (.bag).

    Messages are taken from ``/joint_states``, or from the only topic of that type. Times are those
    of their headers, or of logging where headers have none, and count from the first message.
    Message definitions in the file are ignored: JointState is standard.

    Args:
        path: File or folder to read.
        columns: Coordinates, rates and efforts by their names in a trajectory, and ``t_s``.
        names: Names of joints in the recording by the symbols of coordinates, where they are not
            those of the crane. A formula such as ``8 m - lift_joint`` gives the coordinate of a
            joint that was recorded with another zero or sign.
        layout: Joints of the recorded crane; by default those of the tower crane of this project.
        since: Time of the first row [s] from the first message on. Numbers of earlier messages need
            not be finite, but they must have the joints, too.
        until: Time of the last row [s].

    Returns:
        The columns by name, shape (n,) each.

    Raises:
        DataError: If the extra is not installed, the file cannot be read, or it has no joint
            states, or others than needed.
        UnknownName: If `names` has an unknown coordinate.
    """
    sources = _Sources(layout, names)
    with _parsing(Path(path)):
        return _columns(Path(path), columns, sources, since, until)


def joint_state_columns(
    path: str | Path, names: Mapping[str, str] | None = None, *, layout: Layout | None = None
) -> list[str]:
    """Return the names of the columns that a recording has, by its first message of joint states.

    Args:
        path: File to read.
        names: As for `read_joint_states`.
        layout: As for `read_joint_states`.

    Raises:
        DataError: As `read_joint_states`; or if a joint of `names` is not in the recording.
        UnknownName: If `names` has an unknown coordinate.
    """
    sources = _Sources(layout, names)
    with _parsing(Path(path)):
        _, first = next(_states(Path(path)))
    indices = {name: i for i, name in enumerate(first.name)}
    for symbol in names or {}:
        if sources.recorded[symbol].name not in indices:
            raise _missing_joint(Path(path), first, symbol, sources.recorded[symbol].name)
    columns = []
    for column, source in sources.by_column.items():
        # A field may be empty, or shorter than the names.
        index = indices.get(sources.recorded[source.symbol].name, math.inf)
        if index < len(getattr(first, source.field)):
            columns.append(column)
    return columns


def is_recording(path: str | Path) -> bool:
    """Return whether a path is taken for a recording of ROS: by the ending of a file, or since it
    is a folder.
    """
    return Path(path).suffix.lower() in ENDINGS or os.path.isdir(path)


def recorded_files(path: Path) -> list[Path]:
    """Return the files of a recording: the path itself, or those of a folder of ROS 2 in the order
    of their names. Its metadata.yaml is not read, and links, which may lead out of the folder, are
    not followed.

    Raises:
        DataError: If a folder has no such files, or packed ones.
    """
    if not os.path.isdir(path):
        return [path]
    try:
        entries = sorted(path.iterdir())
    except OSError as error:
        raise DataError(f"Cannot read {path}: {error.strerror}.") from error
    packed = [entry for entry in entries if entry.name.endswith((".db3.zstd", ".mcap.zstd"))]
    if packed:
        raise DataError(
            f"Cannot read {path}: {quoted(packed[0].name)} is packed; unpack it by zstd -d."
        )
    files = [
        entry
        for entry in entries
        if entry.suffix.lower() in FOLDER_ENDINGS and entry.is_file() and not entry.is_symlink()
    ]
    if not files:
        raise DataError(
            f"Cannot read {path}: it is a folder without a recording of ROS 2; allowed is one with "
            f"{' or '.join(FOLDER_ENDINGS)} files."
        )
    return files


@contextmanager
def _parsing(path: Path) -> Iterator[None]:
    """Convert any error of a parser of a recording to a `DataError`.

    Raises:
        DataError: If the extra is not installed, the file is too large, or a parser fails.
    """
    check_installed()
    size = 0
    for part in recorded_files(path):
        with open_file(part) as file:
            size += file.seek(0, os.SEEK_END)
    if size > LARGEST:
        raise DataError(f"Cannot read {path}: it is larger than {LARGEST / 1e6:g} MB.")
    try:
        yield
    except CraneError:
        raise
    except Exception as error:  # whatever a parser raises over the bytes of a stranger
        raise DataError(
            f"Cannot read {path}: {type(error).__name__}: {str(error) or 'it is damaged'}."
        ) from error


def _columns(
    path: Path, columns: Sequence[str], sources: _Sources, since: float, until: float
) -> dict[str, np.ndarray]:
    """Return columns in the order of their times, which count from the first message [s].

    Args:
        path: File or folder to read.
        columns: Names of the columns.
        sources: Where their numbers are in a message.
        since: Time of the first row [s].
        until: Time of the last row [s].

    Raises:
        DataError: If a number is not finite, or times are not two or more that increase.
    """
    requested = [column for column in columns if column != "t_s"]
    # Arrays of the standard library grow by single numbers, and take eight bytes for each.
    stamps = array("q")
    logged = array("q")
    values = array("d")
    for time, message in _states(path):
        logged.append(time)
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for column in requested:
            values.append(_value(path, message, len(logged), column, sources))
    times = np.array(stamps if any(stamps) else logged)
    order = np.argsort(times, kind="stable")
    times = times[order]
    t = (times - times[:1]) / 1e9
    rows = np.array(values).reshape(len(times), -1)[order]
    within = (t >= since - _ROUND_OFF) & (t <= until + _ROUND_OFF)
    times = times[within]
    t = t[within]
    rows = rows[within]
    for column, numbers in zip(requested, rows.T, strict=True):
        if not np.isfinite(numbers).all():
            message = order[within][np.argmin(np.isfinite(numbers))] + 1
            source = sources.by_column[column]
            joint = sources.recorded[source.symbol].name
            raise DataError(
                f"{path}: {source.field} of {joint} is not finite in its message {message}."
            )
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise DataError(
            f"{path} has joint states at {len(times)} times, some of them the same; allowed are "
            "two or more that increase."
        )
    data = dict(zip(requested, rows.T, strict=True)) | {"t_s": t}
    return {column: data[column] for column in columns}


def _states(path: Path) -> Iterator[tuple[int, Any]]:
    """Yield the joint states of a file in their order, each with its time of logging [ns]."""
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = path.suffix.lower() == ".bag" and not os.path.isdir(path)
    typestore = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    decode = typestore.deserialize_ros1 if is_ros1 else typestore.deserialize_cdr
    source = partial(_messages, recorded_files(path))
    topics = sorted({topic for topic, *_ in source()})
    if TOPIC not in topics and len(topics) != 1:
        names = ", ".join(map(quoted, topics)) or "none"
        raise DataError(
            f"{path} has joint states on {names}; allowed are messages on {TOPIC}, or on one topic."
        )
    chosen_topic = TOPIC if TOPIC in topics else topics[0]
    for topic, time, raw in source():
        if topic == chosen_topic:
            yield time, decode(raw, TYPE)  # by the standard definition of JointState


def _value(path: Path, message: Any, k: int, column: str, sources: _Sources) -> float:
    """Return the number of a column in message k, counted from 1.

    Raises:
        DataError: If the message has none.
    """
    if column not in sources.by_column:
        raise DataError(
            f"{path} cannot have a column {column}: joint states have positions, velocities and "
            "efforts."
        )
    field, symbol = sources.by_column[column]
    joint = sources.recorded[symbol]
    numbers = getattr(message, field)
    if joint.name not in message.name:
        raise _missing_joint(path, message, symbol, joint.name)
    i = message.name.index(joint.name)
    if i >= len(numbers):
        raise DataError(
            f"{path} has no {field} of {joint.name} in its message {k}; {column} needs one."
        )
    number = joint.sign * float(numbers[i])
    return joint.zero + number if field == "position" else number


def _missing_joint(path: Path, message: Any, symbol: str, joint: str) -> DataError:
    """Return the error of a recording without the joint of a coordinate, by one of its messages."""
    present = ", ".join(map(quoted, message.name[:20])) or "none"
    return DataError(
        f"{path} has no joint {joint}, but {present}; say which is {symbol} by --joints "
        f"{symbol}=NAME."
    )


def _messages(files: Sequence[Path]) -> Iterator[Raw]:
    """Yield the messages of joint states in the files of a recording."""
    readers = {".mcap": _mcap_messages, ".bag": _bag_messages, ".db3": _database_messages}
    for file in files:
        yield from readers[file.suffix.lower()](file)


def _database_messages(path: Path) -> Iterator[Raw]:
    """Yield the messages of joint states in an SQLite file of ROS 2."""
    result = read_bounded(path, "rosbag2")
    count = int(result.header["messages"])
    unpack = _Unpacker()
    # Three whole numbers for each message, topic, time and size, and then the messages.
    begin = 3 * 8 * count
    table = result.content[:begin].view("<i8").reshape(count, 3)
    for topic, time, size in table.tolist():
        data = result.content[begin : begin + size].tobytes()
        begin += size
        if data.startswith(_ZSTANDARD):  # recorded with --compression-mode message
            data = unpack("zstd", data)
        yield str(result.header["topics"][topic]), time, data


def _mcap_messages(path: Path) -> Iterator[Raw]:
    """Yield the messages of joint states in an MCAP file."""
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    with open_file(path) as file:
        for record in _mcap_records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                if (schemas.get(record.schema_id), record.message_encoding) == (TYPE, "cdr"):
                    topics[record.id] = record.topic
            elif isinstance(record, Message) and record.channel_id in topics:
                yield topics[record.channel_id], record.log_time, record.data


def _mcap_records(file: BinaryIO) -> Iterator[Any]:
    """Yield the records of an MCAP file, those of its chunks in their places."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    unpack = _Unpacker()
    for record in StreamReader(file, emit_chunks=True, record_size_limit=_MAX_CHUNK_SIZE).records:
        if isinstance(record, Chunk):
            content = BytesIO(unpack(record.compression, record.data) + _MCAP_END)
            yield from StreamReader(content, skip_magic=True, emit_chunks=True).records
        else:
            yield record


def _bag_messages(path: Path) -> Iterator[Raw]:
    """Yield the messages of joint states in a ROS 1 bag."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import decompressors

    unpack = _Unpacker()
    with Reader(path) as reader:
        # In place of its own decompressors the reader takes one with a limit.
        names = {function: name for name, function in decompressors.items()}
        for key, chunk in reader.chunks.items():
            limited = partial(unpack, names[chunk.decompressor])
            reader.chunks[key] = chunk._replace(decompressor=limited)
        connections = [c for c in reader.connections if c.msgtype == TYPE]
        if connections:
            for connection, time, raw in reader.messages(connections=connections):
                yield connection.topic, time, raw


class _Unpacker:
    """Decompressor of the chunks of a recording, up to `LARGEST` bytes in all."""

    def __init__(self) -> None:
        self._done = 0

    def __call__(self, compression: str, data: bytes) -> bytes:
        """Decompress a chunk.

        Raises:
            DataError: As `_decompressed`, or if all together are larger than `LARGEST`.
        """
        content = _decompressed(compression, data)
        self._done += len(content)
        if self._done > LARGEST:
            raise DataError(f"The recording holds more than {LARGEST / 1e6:g} MB.")
        return content


def _decompressed(compression: str, data: bytes) -> bytes:
    """Return the content of a compressed chunk of limited size.

    Raises:
        DataError: If it is larger than 100 MB, or of an unknown compression.
    """
    if compression == "bz2":
        content = bz2.BZ2Decompressor().decompress(data, _MAX_CHUNK_SIZE + 1)
    elif compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(data, _MAX_CHUNK_SIZE + 1)
    elif compression == "zstd":
        import zstandard

        reader = zstandard.ZstdDecompressor().stream_reader(data)
        unpacked = bytearray()
        # Its buffer is as large as the requested size.
        while len(unpacked) <= _MAX_CHUNK_SIZE:
            block = reader.read(_BLOCK_SIZE)
            if not block:
                break
            unpacked += block
        content = bytes(unpacked)
    elif compression in ("", "none"):
        content = data
    else:
        raise DataError(
            f"A piece of the recording is compressed by {quoted(compression)}; allowed are zstd, "
            "lz4 and bz2."
        )
    if len(content) > _MAX_CHUNK_SIZE:
        raise DataError(f"A piece of the recording holds more than {_MAX_CHUNK_SIZE / 1e6:g} MB.")
    return content
