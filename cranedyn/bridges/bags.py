"""Recordings of ROS read back: the columns of a trajectory from messages of joint states in .mcap
and .bag files.
"""

from __future__ import annotations

import bz2
import math
import struct
from array import array
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.bridges.mcap import check_installed
from cranedyn.data.files import open_file
from cranedyn.data.tables import LARGEST
from cranedyn.errors import CraneError, DataError, UnknownName, quoted
from cranedyn.model.layout import ROLES

ENDINGS = (".mcap", ".bag")
"""Of files that are read here."""

TYPE = "sensor_msgs/msg/JointState"
TOPIC = "/joint_states"

NAMES = {role.symbol: role.joint for role in ROLES.values()}
"""Names of the joints by the symbols of their coordinates, unless others are given."""

_KINDS = {
    column: (kind, role.symbol)
    for role in ROLES.values()
    for kind, column in (
        ("position", f"{role.symbol}_{'m' if role.kind == 'prismatic' else 'rad'}"),
        ("velocity", f"{role.symbol}_dot_{'m' if role.kind == 'prismatic' else 'rad'}_s"),
        ("effort", f"F_{role.symbol}_N" if role.kind == "prismatic" else f"T_{role.symbol}_Nm"),
    )
}
"""What joint states say of a joint, and of which coordinate, by the name of the column."""

_MOST = 100_000_000
"""Most bytes of one compressed piece of a file, unpacked."""

_PART = 1_000_000
"""Bytes of a piece that are unpacked at a time."""

_MOST_STATES, _ALL_STATES, _LARGEST_STATE = 1_000_000, 300_000_000, 100_000
"""Most joint states in a file, some 17 minutes at 1 kHz; most bytes of all and of one."""

_RECORD, _CHANNEL = struct.Struct("<BQ"), struct.Struct("<H")
"""What each record of MCAP begins with, its kind and length; and a message, its channel."""

Raw = tuple[str, int, bytes]
"""Topic, time of logging [ns], message."""


def read_columns(
    path: str | Path, columns: Sequence[str], names: Mapping[str, str] | None = None
) -> dict[str, np.ndarray]:
    """Columns of a trajectory from the joint states in a recording of ROS 2 (.mcap) or ROS 1
    (.bag).

    Messages are taken from ``/joint_states``, or from the only topic of that type. Times are those
    of their headers, or of logging where headers have none, and count from the first message. What
    a file says of its own message types is not looked at: JointState is known.

    Args:
        path: The file.
        columns: Coordinates, rates and efforts by their names in a trajectory, and ``t_s``.
        names: Names of joints there by the symbols of coordinates, where they differ from `NAMES`.

    Returns:
        The columns by name, shape (n,) each.

    Raises:
        DataError: If the extra is not installed, the file cannot be read, or it has no joint
            states, or others than needed.
        UnknownName: If a name is given for no coordinate.
    """
    with _parsing(Path(path), names):
        return _columns(Path(path), columns, {**NAMES, **(names or {})})


def columns(path: str | Path, names: Mapping[str, str] | None = None) -> list[str]:
    """Names of the columns that a recording has, by its first message of joint states.

    Args:
        path: The file.
        names: As for `read_columns`.

    Raises:
        DataError: As `read_columns`.
        UnknownName: If a name is given for no coordinate.
    """
    with _parsing(Path(path), names):
        _, first = next(_states(Path(path)))
    named = {**NAMES, **(names or {})}
    return [
        column
        for column, (kind, symbol) in _KINDS.items()
        if named[symbol] in first.name
        and first.name.index(named[symbol]) < len(getattr(first, kind))
    ]


@contextmanager
def _parsing(path: Path, names: Mapping[str, str] | None) -> Iterator[None]:
    """Where a file of a stranger is parsed: what goes wrong is a sentence.

    Raises:
        DataError: If the extra is not installed, the file is too large, or a parser fails.
        UnknownName: If a name is given for no coordinate.
    """
    check_installed()
    for symbol in names or {}:
        if symbol not in NAMES:
            raise UnknownName("coordinate", symbol, NAMES)
    with open_file(path) as file:
        if file.seek(0, 2) > LARGEST:
            raise DataError(f"Cannot read {path}: it is larger than {LARGEST / 1e6:g} MB.")
    try:
        yield
    except CraneError:
        raise
    except Exception as error:  # whatever a parser raises over the bytes of a stranger
        raise DataError(
            f"Cannot read {path}: {type(error).__name__}: {str(error) or 'it is damaged'}."
        ) from error


def _columns(path: Path, columns: Sequence[str], names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Columns in the order of their times, which count from the first [s]."""
    wanted = [column for column in columns if column != "t_s"]
    stamps, logged, values = array("q"), array("q"), array("d")
    for time, message in _states(path):
        logged.append(time)
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        for column in wanted:
            values.append(_value(path, message, len(logged), column, names))
    times = np.array(stamps if any(stamps) else logged)
    order = np.argsort(times, kind="stable")
    times = times[order]
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise DataError(
            f"{path} has joint states at {len(times)} times, some of them the same; allowed are "
            "two or more that increase."
        )
    rows = np.array(values).reshape(len(times), -1)[order]
    found = dict(zip(wanted, rows.T, strict=True)) | {"t_s": (times - times[0]) / 1e9}
    return {column: found[column] for column in columns}


def _states(path: Path) -> Iterator[tuple[int, Any]]:
    """Joint states as they follow in the file, each with its time of logging [ns]."""
    source = partial(_of_mcap if path.suffix == ".mcap" else _of_bag, path)
    topics, decode = sorted({topic for topic, *_ in source()}), _decoder(path)
    if TOPIC not in topics and len(topics) != 1:
        there = ", ".join(map(quoted, topics)) or "none"
        raise DataError(
            f"{path} has joint states on {there}; allowed are messages on {TOPIC}, or on one topic."
        )
    count = size = 0
    for topic, time, raw in source():
        if topic == (TOPIC if TOPIC in topics else topics[0]):
            count, size = count + 1, size + len(raw)
            if count > _MOST_STATES or size > _ALL_STATES or len(raw) > _LARGEST_STATE:
                raise DataError(
                    f"{path} has too many or too large joint states; allowed are {_MOST_STATES} of "
                    f"{_LARGEST_STATE / 1e3:g} kB, {_ALL_STATES / 1e6:g} MB in all."
                )
            yield time, decode(raw)


def _value(path: Path, message: Any, k: int, column: str, names: Mapping[str, str]) -> float:
    """One coordinate, rate or effort of the message number k."""
    if column not in _KINDS:
        raise DataError(
            f"{path} cannot have a column {column}: joint states have positions, velocities and "
            "efforts."
        )
    kind, symbol = _KINDS[column]
    joint, numbers = names[symbol], getattr(message, kind)
    if joint not in message.name:
        there = ", ".join(map(quoted, message.name[:20])) or "none"
        raise DataError(
            f"{path} has no joint {joint}, but {there}; say which is {symbol} by --joints "
            f"{symbol}=NAME."
        )
    if (i := message.name.index(joint)) >= len(numbers):
        raise DataError(f"{path} has no {kind} of {joint} in its message {k}; {column} needs one.")
    if not math.isfinite(value := float(numbers[i])):
        raise DataError(f"{path}: {kind} of {joint} is not finite in its message {k}.")
    return value


def _decoder(path: Path) -> Callable[[bytes], Any]:
    """What makes a message of bytes, by a definition of ours."""
    from rosbags.typesys import Stores, get_typestore

    if path.suffix == ".mcap":
        two = get_typestore(Stores.ROS2_HUMBLE)
        return lambda raw: two.deserialize_cdr(raw, TYPE)
    one = get_typestore(Stores.ROS1_NOETIC)
    return lambda raw: one.deserialize_ros1(raw, TYPE)


def _of_mcap(path: Path) -> Iterator[Raw]:
    """Messages of joint states in an MCAP file."""
    from mcap.records import Channel, Chunk, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    unpack = _Unpacker()
    with open_file(path) as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=_MOST).records:
            if isinstance(record, Chunk):
                parts = _parts(unpack(record.compression, record.data), topics)
            else:
                parts = iter([record])
            for part in parts:
                if isinstance(part, Schema):
                    schemas[part.id] = part.name
                elif (
                    isinstance(part, Channel)
                    and schemas.get(part.schema_id) == TYPE
                    and part.message_encoding == "cdr"
                ):
                    topics[part.id] = part.topic
                elif isinstance(part, Message) and part.channel_id in topics:
                    yield topics[part.channel_id], part.log_time, part.data


def _parts(data: bytes, channels: Container[int]) -> Iterator[Any]:
    """Schemas and channels in a chunk, and its messages in some channels, one at a time."""
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, Schema

    first = 0
    while first < len(data):
        kind, length = _RECORD.unpack_from(data, first)
        first += _RECORD.size
        if kind == Opcode.MESSAGE:
            (channel,) = _CHANNEL.unpack_from(data, first)
            if channel in channels:
                stream = ReadDataStream(BytesIO(data[first : first + length]))
                yield Message.read(stream, length)
        elif kind in (Opcode.SCHEMA, Opcode.CHANNEL):
            stream = ReadDataStream(BytesIO(data[first : first + length]))
            yield (Schema if kind == Opcode.SCHEMA else Channel).read(stream)
        first += length


def _of_bag(path: Path) -> Iterator[Raw]:
    """Messages of joint states in a ROS 1 bag."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import decompressors

    unpack = _Unpacker()
    with Reader(path) as reader:
        for place, chunk in reader.chunks.items():
            name = next(
                name for name, known in decompressors.items() if known is chunk.decompressor
            )
            reader.chunks[place] = chunk._replace(decompressor=partial(unpack, name))
        connections = [one for one in reader.connections if one.msgtype == TYPE]
        if connections:
            for connection, time, raw in reader.messages(connections=connections):
                yield connection.topic, time, raw


class _Unpacker:
    """Unpacks the pieces of one recording, up to `LARGEST` bytes in all."""

    def __init__(self) -> None:
        self._done = 0

    def __call__(self, compression: str, data: bytes) -> bytes:
        """Unpack a piece.

        Raises:
            DataError: As `_unpacked`, or if all together are larger than `LARGEST`.
        """
        content = _unpacked(compression, data)
        self._done += len(content)
        if self._done > LARGEST:
            raise DataError(f"The recording holds more than {LARGEST / 1e6:g} MB.")
        return content


def _unpacked(compression: str, data: bytes) -> bytes:
    """The content of a compressed piece, as long as it is not endless.

    Raises:
        DataError: If it is larger than 100 MB, or of an unknown compression.
    """
    if compression == "bz2":
        content = bz2.BZ2Decompressor().decompress(data, _MOST + 1)
    elif compression == "lz4":
        import lz4.frame

        content = lz4.frame.LZ4FrameDecompressor().decompress(data, _MOST + 1)
    elif compression == "zstd":
        import zstandard

        reader, unpacked = zstandard.ZstdDecompressor().stream_reader(data), bytearray()
        # It makes a buffer of all that it is asked for.
        while len(unpacked) <= _MOST and (part := reader.read(_PART)):
            unpacked += part
        content = bytes(unpacked)
    elif compression in ("", "none"):
        content = data
    else:
        raise DataError(
            f"A piece of the recording is compressed by {quoted(compression)}; allowed are zstd, "
            "lz4 and bz2."
        )
    if len(content) > _MOST:
        raise DataError(f"A piece of the recording holds more than {_MOST / 1e6:g} MB.")
    return content
