"""Words of the drives and sensors of a crane: one table, from which OPC UA nodes, Modbus registers
and the companion CSV follow.

A *word* is a whole number of 16 or 32 bits that a program and a plant exchange. Commands are
written by the program, readings by the plant. A *count* is one unit of such a number.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from cranedyn.dynamics.converters import STEPS, Converters
from cranedyn.export.target import new_file
from cranedyn.model.crane import Crane

ENCODER_RESOLUTION = {"rad": 1e-5, "m": 1e-4}
"""Value of a count of an encoder [rad or m], by the unit of the drive."""

ANGLE_RESOLUTION = 1e-4
"""Value of a count of a rope angle [rad]."""

WIND_RESOLUTION = 1e-2
"""Value of a count of a wind speed [m/s]."""

HEARTBEAT_TIMEOUT = 0.5
"""Time without a new heartbeat after which an enabled crane stops [s]."""

LOST_READING = -32768
"""Reading of a lost sensor."""

NAMESPACE = 2
"""Index of the namespace of the OPC UA nodes: 0 is that of OPC UA itself, 1 that of the server."""

ENABLE_BIT = 1
"""Bit of the control word of a drive that enables it."""

RESET_BIT = 2
"""Bit of the control word of a drive that resets a fault."""

ROPE_SENSOR_LOST_BIT = 1
"""Bit of the inject word of the crane that makes load cell and rope angles fail."""

MESSAGES_LOST_BIT = 2
"""Bit of the inject word of the crane that keeps all other commands from arriving."""

ENCODER_JUMP_BIT = 1
"""Bit of the inject word of a drive that makes its encoder jump."""

BRAKE_SLIP_BIT = 2
"""Bit of the inject word of a drive that makes its closed brake slip."""

STATUS_BITS = ("ready", "running", "fault", "at speed", "brake closed", "lower end", "upper end")
"""Bits of the status word of a drive, from bit 0."""

FAULTS = (
    "no fault",
    f"watchdog: no new heartbeat for {HEARTBEAT_TIMEOUT:g} s",
    "encoder: its counts do not fit the speed of the drive",
    "rope sensor: its reading is not valid",
    "brake: the drive moves with its brake closed",
)
"""Faults of the crane, by their code."""

WATCHDOG_FAULT = 1
"""Code of the fault of a crane without heartbeat."""

ENCODER_FAULT = 2
"""Code of the fault of an encoder."""

ROPE_SENSOR_FAULT = 3
"""Code of the fault of load cell and rope angles."""

BRAKE_FAULT = 4
"""Code of the fault of a brake."""


class _Row(NamedTuple):
    """Row of the table of words, which may stand for several words.

    Attributes:
        owner: Whose word it is: the "crane" has one, each "drive" and each joint that swings
            ("swing") has one of its own, and the "hoist" has one if there is a hoist.
        name: Name of the word.
        direction: "command" or "reading".
        kind: Type of the word, see `Word`.
        scale: Value of a count; "rate" for the largest rate of the drive over 16384 counts,
            "resolution" for `ENCODER_RESOLUTION`.
        unit: Unit; "rate" and "position" for those of the drive, empty for none.
        meaning: Meaning of the word.
    """

    owner: str
    name: str
    direction: str
    kind: str
    scale: float | str
    unit: str
    meaning: str


_HEARTBEAT_MEANING = f"changes every {HEARTBEAT_TIMEOUT:g} s if a drive is enabled"
_FAULT_MEANING = "; ".join(f"{code} {fault}" for code, fault in enumerate(FAULTS))
_LOAD_MEANING = f"load cell in the rope; {LOST_READING} if lost"
_ANGLE_MEANING = f"angle of the rope; {LOST_READING} if lost"
_STATUS_MEANING = f"bits from 0: {', '.join(STATUS_BITS)}"
_CRANE_INJECT_MEANING = "bit 0 rope sensor lost, bit 1 messages lost"
_DRIVE_INJECT_MEANING = "bit 0 encoder jump, bit 1 brake slip"
_RAMP_MEANING = "time to full speed; 0 for the converter's own"

_TABLE = (
    _Row("crane", "heartbeat", "command", "UINT16", 1.0, "", _HEARTBEAT_MEANING),
    _Row(
        "crane",
        "wind",
        "command",
        "UINT16",
        WIND_RESOLUTION,
        "m/s",
        "wind to blow along +X of the world",
    ),
    _Row("crane", "inject", "command", "UINT16", 1.0, "", _CRANE_INJECT_MEANING),
    _Row("drive", "control", "command", "UINT16", 1.0, "", "bit 0 enable, bit 1 reset of faults"),
    _Row("drive", "speed", "command", "INT16", "rate", "rate", "speed command"),
    _Row("drive", "ramp", "command", "UINT16", 0.001, "s", _RAMP_MEANING),
    _Row("drive", "inject", "command", "UINT16", 1.0, "", _DRIVE_INJECT_MEANING),
    _Row("crane", "cycle", "reading", "UINT16", 1.0, "", "cycles of the plant, modulo 65536"),
    _Row("crane", "fault", "reading", "UINT16", 1.0, "", _FAULT_MEANING),
    _Row("crane", "wind_speed", "reading", "UINT16", WIND_RESOLUTION, "m/s", "anemometer"),
    _Row("hoist", "load", "reading", "INT32", 1.0, "kg", _LOAD_MEANING),
    _Row("swing", "angle", "reading", "INT16", ANGLE_RESOLUTION, "rad", _ANGLE_MEANING),
    _Row("drive", "status", "reading", "UINT16", 1.0, "", _STATUS_MEANING),
    _Row("drive", "actual_speed", "reading", "INT16", "rate", "rate", "speed"),
    _Row("drive", "encoder", "reading", "INT32", "resolution", "position", "position"),
)
"""Words of any crane, in the order of their addresses; `word_map` reads them for a crane."""

_HEADING = (
    "name",
    "direction",
    "type",
    "opc_ua_node",
    "modbus_table",
    "modbus_address",
    "scale",
    "unit",
    "meaning",
)
"""Columns of the file of `write_map`."""

_RANGES = {"UINT16": (0, 2**16 - 1), "INT16": (-(2**15), 2**15 - 1), "INT32": (-(2**31), 2**31 - 1)}
"""Smallest and largest number of a word, by its type."""


class Word(NamedTuple):
    """A whole number that both protocols carry.

    Attributes:
        name: Name, also of the OPC UA node.
        command: Whether clients write it; otherwise it is a reading.
        kind: "UINT16", "INT16" or "INT32", which takes two registers, the high one first.
        address: Modbus address from 0, of a holding register for a command, else of an input one.
        scale: Value of a count, in the unit.
        unit: Unit; empty for bits, codes and counters.
        meaning: Meaning.
    """

    name: str
    command: bool
    kind: str
    address: int
    scale: float
    unit: str
    meaning: str

    @property
    def node(self) -> str:
        """Id of the OPC UA node."""
        return f"ns={NAMESPACE};s={self.name}"

    @property
    def size(self) -> int:
        """Number of Modbus registers."""
        return 2 if self.kind == "INT32" else 1

    def holds(self, value: object) -> bool:
        """Return whether a value is a whole number that this word can carry."""
        low, high = _RANGES[self.kind]
        # True and False are integers for Python.
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def word_map(crane: Crane, converters: Converters) -> tuple[Word, ...]:
    """Return the words of a crane.

    Rows of the table that follow each other and have one owner repeat for each such owner, such as
    all words of the first drive, then all of the second. Addresses count up in this order, those of
    commands and those of readings each from 0.

    Args:
        crane: The crane.
        converters: Frequency converters of its drives, whose largest rates are 16384 counts.
    """
    layout = crane.layout
    drives = layout.drives.tolist()
    whole_crane: list[int | None] = [None]
    # The joints of each owner; None stands for the crane itself.
    joints_of: dict[str, list[int | None]] = {
        "crane": whole_crane,
        "drive": drives,
        "swing": crane.swings.tolist(),
        "hoist": whole_crane if layout.drive_of("hoist") is not None else [],
    }
    rate_counts = (converters.rates / STEPS).tolist()
    words: list[Word] = []
    next_address = {"command": 0, "reading": 0}
    for owner, group in groupby(_TABLE, key=lambda row: row.owner):
        rows = list(group)
        for joint in joints_of[owner]:
            prefix = ""
            scales: dict[str | float, float] = {}
            units: dict[str, str] = {}
            if joint is not None:
                prefix = f"{layout.symbols[joint]}."
                unit = layout.units[joint]
                scales["resolution"] = ENCODER_RESOLUTION[unit]
                units = {"position": unit, "rate": f"{unit}/s"}
            if owner == "drive":
                scales["rate"] = rate_counts[drives.index(joint)]
            for row in rows:
                word = Word(
                    name=prefix + row.name,
                    command=row.direction == "command",
                    kind=row.kind,
                    address=next_address[row.direction],
                    scale=float(scales.get(row.scale, row.scale)),
                    unit=units.get(row.unit, row.unit),
                    meaning=row.meaning,
                )
                words.append(word)
                next_address[row.direction] += word.size
    return tuple(words)


def write_map(file: Path, words: Sequence[Word]) -> Path:
    """Write words as a CSV file and return its path.

    Args:
        file: The file, which must not exist yet.
        words: The words.

    Raises:
        DataError: If it exists or cannot be written.
    """
    with new_file(file) as draft, draft.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(_HEADING)
        for word in words:
            writer.writerow(
                [
                    word.name,
                    "command" if word.command else "reading",
                    word.kind,
                    word.node,
                    "holding" if word.command else "input",
                    word.address,
                    f"{word.scale:g}",
                    word.unit,
                    word.meaning,
                ]
            )
    return file


class ProcessImage:
    """Latest numbers of all words, exchanged between the threads of the plant and of the servers.

    Attributes:
        words: The words.
        commands: Commands by name; one `update` writes several at once.
        readings: Readings by name, those of one cycle; each cycle replaces the dictionary.
    """

    def __init__(self, words: Sequence[Word]) -> None:
        self.words = tuple(words)
        self.commands = {word.name: 0 for word in words if word.command}
        self.readings = {word.name: 0 for word in words if not word.command}

    def valid_commands(self, last: Mapping[str, int]) -> tuple[dict[str, int], list[str]]:
        """Return the commands, and the names of those that are no number of their type.

        In place of such a command its last valid one is returned. Clients cannot write any: OPC UA
        refuses it, and a Modbus register has no room for it. A program that writes into `commands`
        itself can.

        Args:
            last: Commands of the last cycle.
        """
        commands = self.commands.copy()
        impossible = []
        for word in self.words:
            if word.command and not word.holds(commands.get(word.name)):
                impossible.append(word.name)
                commands[word.name] = last[word.name]
        return commands, impossible
