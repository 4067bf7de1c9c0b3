"""Words of the drives and sensors of a crane: one table, from which OPC UA nodes, Modbus registers
and the companion CSV follow.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from cranedyn.bridges.target import new_file
from cranedyn.dynamics.converters import STEPS, Converters
from cranedyn.model.crane import Crane

COUNT, ANGLE, WIND = {"rad": 1e-5, "m": 1e-4}, 1e-4, 1e-2
"""Resolution of encoders [rad or m], of rope angles [rad] and of wind speeds [m/s]."""

TIMEOUT, INVALID = 0.5, -32768
"""Time without a new heartbeat after which an enabled crane stops [s]; reading of a lost sensor."""

ENABLE, RESET = 1, 2
ROPE_SENSOR_LOST, MESSAGES_LOST = 1, 2
ENCODER_JUMP, BRAKE_SLIP = 1, 2
"""Bits of a control word, of the inject word of the crane, and of that of a drive."""

STATUS = ("ready", "running", "fault", "at speed", "brake closed", "lower end", "upper end")
FAULTS = (
    "no fault",
    f"watchdog: no new heartbeat for {TIMEOUT:g} s",
    "encoder: its counts do not fit the speed of the drive",
    "rope sensor: its reading is not valid",
    "brake: the drive moves with its brake closed",
)
WATCHDOG, ENCODER, ROPE_SENSOR, BRAKE = range(1, len(FAULTS))
"""Bits of a status word, and faults by code."""

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
        return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


_RANGES = {"UINT16": (0, 2**16 - 1), "INT16": (-(2**15), 2**15 - 1), "INT32": (-(2**31), 2**31 - 1)}
"""Smallest and largest number of a word, by its type."""


def word_map(crane: Crane, converters: Converters) -> tuple[Word, ...]:
    """Return the words of a crane; 16384 counts are the largest rate of a drive."""
    layout, words, free = crane.layout, list[Word](), {True: 0, False: 0}
    rates = dict(zip(layout.drives.tolist(), (converters.rates / STEPS).tolist(), strict=True))
    owners = {"crane": [-1], "drive": [*rates], "swing": crane.swings.tolist()}
    owners["hoist"] = [-1] if layout.drive_of("hoist") is not None else []
    rows = [row.split(None, 6) for row in TABLE.strip().splitlines()]
    for owner, group in groupby(rows, key=lambda row: row[0]):
        entries = list(group)
        for joint in owners[owner]:
            symbol = "" if joint < 0 else f"{layout.symbols[joint]}."
            unit_of = layout.units[joint]
            scales = {"rate": rates.get(joint), "count": COUNT[unit_of]}
            units = {"rate": f"{unit_of}/s", "unit": unit_of, "-": ""}
            for _, name, direction, kind, scale, unit, meaning in entries:
                command, value = direction == "command", float(scales.get(scale) or scale)
                about = value, units.get(unit, unit), meaning
                words.append(Word(symbol + name, command, kind, free[command], *about))
                free[command] += words[-1].size
    return tuple(words)


def write_map(file: Path, words: Sequence[Word]) -> Path:
    """Write words as a CSV file, which must not exist yet, and return its path.

    Raises:
        DataError: If it exists or cannot be written.
    """
    heading = "name direction type opc_ua_node modbus_table modbus_address scale unit meaning"
    with new_file(file) as draft, draft.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(heading.split())
        for word in words:
            direction, table = ("command", "holding") if word.command else ("reading", "input")
            node = (word.name, direction, word.kind, f"ns=2;s={word.name}", table, word.address)
            writer.writerow([*node, f"{word.scale:g}", word.unit, word.meaning])
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
        impossible = [
            word.name
            for word in self.words
            if word.command and not word.holds(commands.get(word.name))
        ]
        commands.update((name, last[name]) for name in impossible)
        return commands, impossible
