"""Recordings of ROS read back: the columns of a trajectory from messages of joint states in .mcap
and .bag files.
"""

from __future__ import annotations

import bz2
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cranedyn.arguments import checked
from cranedyn.bridges.mcap import check_installed
from cranedyn.data.files import opened
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

Raw = tuple[str, int, bytes]
"""Topic, time of logging [ns], message."""


@checked
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


@checked
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
        messages, _ = _messages(Path(path))
    first, named = messages[0], {**NAMES, **(names or {})}
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
    with opened(path) as file:
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
    messages, times = _messages(path)
    return {
        name: times if name == "t_s" else _column(path, messages, name, names) for name in columns
    }


def _messages(path: Path) -> tuple[list[Any], np.ndarray]:
    """Joint states in the order of their times, and these from the first on [s]."""
    decode = _decoder(path)
    found = [
        (topic, time, decode(raw))
        for topic, time, raw in (_of_mcap if path.suffix == ".mcap" else _of_bag)(path)
    ]
    topics = sorted({topic for topic, *_ in found})
    if TOPIC not in topics and len(topics) != 1:
        there = ", ".join(map(quoted, topics)) or "none"
        raise DataError(
            f"{path} has joint states on {there}; allowed are messages on {TOPIC}, or on one topic."
        )
    chosen = [
        (time, message)
        for topic, time, message in found
        if topic == (TOPIC if TOPIC in topics else topics[0])
    ]
    stamps = [
        message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for _, message in chosen
    ]
    times = np.array(stamps if any(stamps) else [time for time, _ in chosen])
    order = np.argsort(times, kind="stable")
    times = times[order]
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise DataError(
            f"{path} has joint states at {len(times)} times, some of them the same; allowed are "
            "two or more that increase."
        )
    return [chosen[i][1] for i in order.tolist()], (times - times[0]) / 1e9


def _column(
    path: Path, messages: Sequence[Any], column: str, names: Mapping[str, str]
) -> np.ndarray:
    """One coordinate, rate or effort, shape (n,)."""
    if column not in _KINDS:
        raise DataError(
            f"{path} cannot have a column {column}: joint states have positions, velocities and "
            "efforts."
        )
    kind, symbol = _KINDS[column]
    joint, values = names[symbol], np.empty(len(messages))
    for k, message in enumerate(messages):
        if joint not in message.name:
            there = ", ".join(map(quoted, message.name[:20])) or "none"
            raise DataError(
                f"{path} has no joint {joint}, but {there}; say which is {symbol} by --joints "
                f"{symbol}=NAME."
            )
        i, numbers = message.name.index(joint), getattr(message, kind)
        if i >= len(numbers):
            raise DataError(
                f"{path} has no {kind} of {joint} in its message {k + 1}; {column} needs one."
            )
        values[k] = numbers[i]
    if not (finite := np.isfinite(values)).all():
        raise DataError(
            f"{path}: {kind} of {joint} is not finite in its message {int(np.argmin(finite)) + 1}."
        )
    return values


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
    from mcap.stream_reader import StreamReader, breakup_chunk

    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    with opened(path) as file:
        for record in StreamReader(file, emit_chunks=True, record_size_limit=_MOST).records:
            if isinstance(record, Chunk):
                data = _unpacked(record.compression, record.data)
                parts = breakup_chunk(
                    Chunk(
                        "", data, record.message_end_time, record.message_start_time, 0, len(data)
                    )
                )
            else:
                parts = [record]
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


def _of_bag(path: Path) -> Iterator[Raw]:
    """Messages of joint states in a ROS 1 bag."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag1.reader import decompressors

    with Reader(path) as reader:
        for place, chunk in reader.chunks.items():
            name = next(
                name for name, unpack in decompressors.items() if unpack is chunk.decompressor
            )
            reader.chunks[place] = chunk._replace(decompressor=partial(_unpacked, name))
        connections = [one for one in reader.connections if one.msgtype == TYPE]
        if connections:
            for connection, time, raw in reader.messages(connections=connections):
                yield connection.topic, time, raw


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

        content = zstandard.ZstdDecompressor().stream_reader(data).read(_MOST + 1)
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
