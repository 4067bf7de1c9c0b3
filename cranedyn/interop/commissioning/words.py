"""Words of the drives and sensors of a crane: one table, from which OPC UA nodes, Modbus registers
and the companion CSV follow.
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

COUNT = {"rad": 1e-5, "m": 1e-4}
"""Resolution of encoders, by the unit of the drive [rad or m]."""

ANGLE = 1e-4
"""Resolution of rope angles [rad]."""

WIND = 1e-2
"""Resolution of wind speeds [m/s]."""

TIMEOUT = 0.5
"""Time without a new heartbeat after which an enabled crane stops [s]."""

INVALID = -32768
"""Reading of a lost sensor."""

ENABLE = 1
"""Bit of the control word of a drive that enables it."""

RESET = 2
"""Bit of the control word of a drive that resets a fault."""

ROPE_SENSOR_LOST = 1
"""Bit of the inject word of the crane that makes load cell and rope angles fail."""

MESSAGES_LOST = 2
"""Bit of the inject word of the crane that keeps all other commands from arriving."""

ENCODER_JUMP = 1
"""Bit of the inject word of a drive that makes its encoder jump."""

BRAKE_SLIP = 2
"""Bit of the inject word of a drive that makes its closed brake slip."""

STATUS = ("ready", "running", "fault", "at speed", "brake closed", "lower end", "upper end")
"""Bits of the status word of a drive, from bit 0."""

FAULTS = (
    "no fault",
    f"watchdog: no new heartbeat for {TIMEOUT:g} s",
    "encoder: its counts do not fit the speed of the drive",
    "rope sensor: its reading is not valid",
    "brake: the drive moves with its brake closed",
)
"""Faults of the crane, by their code."""

WATCHDOG = 1
"""Code of the fault of a crane without heartbeat."""

ENCODER = 2
"""Code of the fault of an encoder."""

ROPE_SENSOR = 3
"""Code of the fault of load cell and rope angles."""

BRAKE = 4
"""Code of the fault of a brake."""

TABLE = f"""
crane heartbeat    command UINT16 1      -    changes every {TIMEOUT:g} s if a drive is enabled
crane wind         command UINT16 {WIND} m/s  wind to blow along +X of the world
crane inject       command UINT16 1      -    bit 0 rope sensor lost, bit 1 messages lost
drive control      command UINT16 1      -    bit 0 enable, bit 1 reset of faults
drive speed        command INT16  rate   rate speed command
drive ramp         command UINT16 0.001  s    time to full speed; 0 for the converter's own
drive inject       command UINT16 1      -    bit 0 encoder jump, bit 1 brake slip
crane cycle        reading UINT16 1      -    cycles of the plant, modulo 65536
crane fault        reading UINT16 1      -    {"; ".join(f"{i} {f}" for i, f in enumerate(FAULTS))}
crane wind_speed   reading UINT16 {WIND} m/s  anemometer
hoist load         reading INT32  1      kg   load cell in the rope; {INVALID} if lost
swing angle        reading INT16  {ANGLE} rad angle of the rope; {INVALID} if lost
drive status       reading UINT16 1      -    bits from 0: {", ".join(STATUS)}
drive actual_speed reading INT16  rate   rate speed
drive encoder      reading INT32  count  unit position
"""
"""Owner, name, direction, type, scale, unit and meaning; `word_map` reads it for a crane."""

NO_JOINT = -1
"""Index that stands for the crane itself among those of its joints."""

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
    """A number that both protocols carry.

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
    def size(self) -> int:
        """Number of registers."""
        return 2 if self.kind == "INT32" else 1

    def holds(self, value: object) -> bool:
        """Return whether a value is a whole number that this word can carry. NaN is none."""
        low, high = _RANGES[self.kind]
        # True and False are integers for Python.
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def word_map(crane: Crane, converters: Converters) -> tuple[Word, ...]:
    """Return the words of a crane.

    Rows of `TABLE` that follow each other and have one owner repeat for each joint that is such an
    owner: for each drive, or for each joint that swings. Addresses count up in this order, commands
    and readings each from 0. 16384 counts are the largest rate of a drive.
    """
    layout = crane.layout
    drives = layout.drives.tolist()
    rate_counts = (converters.rates / STEPS).tolist()
    rate_count_of = dict(zip(drives, rate_counts, strict=True))
    the_crane = [NO_JOINT]
    joints_of = {
        "crane": the_crane,
        "drive": drives,
        "swing": crane.swings.tolist(),
        "hoist": the_crane if layout.drive_of("hoist") is not None else [],
    }
    # The meaning is the seventh entry of a row, with all its words.
    rows = [row.split(None, 6) for row in TABLE.strip().splitlines()]
    words: list[Word] = []
    next_address = {"command": 0, "reading": 0}
    for owner, group in groupby(rows, key=lambda row: row[0]):
        entries = list(group)
        for joint in joints_of[owner]:
            prefix = "" if joint == NO_JOINT else f"{layout.symbols[joint]}."
            # Scales and units of a drive stand in the table by these names.
            unit_of_joint = layout.units[joint]
            # A joint that swings has no rate, and no row with one.
            scales = {"rate": rate_count_of.get(joint), "count": COUNT[unit_of_joint]}
            units = {"rate": f"{unit_of_joint}/s", "unit": unit_of_joint, "-": ""}
            for _, name, direction, kind, scale, unit, meaning in entries:
                word = Word(
                    name=prefix + name,
                    command=direction == "command",
                    kind=kind,
                    address=next_address[direction],
                    scale=float(scales.get(scale) or scale),
                    unit=units.get(unit, unit),
                    meaning=meaning,
                )
                words.append(word)
                next_address[direction] += word.size
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
                    f"ns=2;s={word.name}",
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

    def accepted(self, last: Mapping[str, int]) -> tuple[dict[str, int], list[str]]:
        """Return the commands, and the names of those that are no number of their type.

        Of these, the last command holds. No client writes any: OPC UA refuses them, and Modbus has
        no place for them. A program that holds the image itself may.

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
