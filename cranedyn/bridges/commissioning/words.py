"""Words of the drives and sensors of a crane: one table, from which OPC UA nodes, Modbus registers
and the companion CSV follow.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from cranedyn.bridges.target import new_file
from cranedyn.dynamics.converters import STEPS, Converters
from cranedyn.model.crane import Crane

COUNT = {"rad": 1e-5, "m": 1e-4}
"""Resolution of encoders by the unit of the joint: 10 µrad or 0.1 mm a count."""

ANGLE, WIND = 1e-4, 1e-2
"""Resolution of rope angles [rad] and of wind speeds [m/s]."""

TIMEOUT = 0.5
"""Time without a new heartbeat after which an enabled crane stops [s]."""

INVALID = -32768
"""Reading of a sensor that is lost."""

ENABLE, RESET = 1, 2
ROPE_SENSOR_LOST, MESSAGES_LOST = 1, 2
ENCODER_JUMP, BRAKE_SLIP = 1, 2
"""Bits of a control word, of the inject word of the crane, and of that of a drive."""

STATUS = ("ready", "running", "fault", "at speed", "brake closed", "lower end", "upper end")
"""Bits of a status word."""

FAULTS = (
    "no fault",
    "watchdog: no new heartbeat for 0.5 s",
    "encoder: its counts do not fit the speed of the drive",
    "rope sensor: its reading is not valid",
    "brake: the drive moves with its brake closed",
)
WATCHDOG, ENCODER, ROPE_SENSOR, BRAKE = range(1, len(FAULTS))
"""Faults by code."""


class Word(NamedTuple):
    """A number that both protocols carry.

    Attributes:
        name: Name, also of the OPC UA node.
        command: Whether clients write it; otherwise it is a reading.
        kind: "UINT16", "INT16" or "INT32".
        address: Modbus address from 0, of a holding register for a command, else of an input
            register. An INT32 takes two registers, the high one first.
        scale: Value of a count.
        unit: Its unit; empty for bits, codes and counters.
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


def word_map(crane: Crane, converters: Converters) -> tuple[Word, ...]:
    """Return the words of a crane, commands first; 16384 counts are the largest rate of a drive."""
    words, addresses = list[Word](), {True: 0, False: 0}
    for command, name, kind, scale, unit, meaning in _entries(crane, converters):
        words.append(Word(name, command, kind, addresses[command], scale, unit, meaning))
        addresses[command] += words[-1].size
    return tuple(words)


def _entries(
    crane: Crane, converters: Converters
) -> Iterator[tuple[bool, str, str, float, str, str]]:
    """Yield all of a word but its address."""
    text = f"must change every {TIMEOUT:g} s while a drive is enabled"
    yield True, "heartbeat", "UINT16", 1.0, "", text
    yield True, "wind", "UINT16", WIND, "m/s", "wind to blow along +X of the world"
    text = "faults: bit 0 rope sensor lost, bit 1 messages lost"
    yield True, "inject", "UINT16", 1.0, "", text
    drives = list(zip(crane.layout.driven, (converters.rates / STEPS).tolist(), strict=True))
    for joint, scale in drives:
        symbol, text = joint.symbol, "time to full speed; 0 for the converter's own"
        yield True, f"{symbol}.control", "UINT16", 1.0, "", "bit 0 enable, bit 1 reset of faults"
        yield True, f"{symbol}.speed", "INT16", scale, f"{joint.unit}/s", "speed command"
        yield True, f"{symbol}.ramp", "UINT16", 1e-3, "s", text
        text = "faults: bit 0 encoder jump, bit 1 brake slip"
        yield True, f"{symbol}.inject", "UINT16", 1.0, "", text
    yield False, "cycle", "UINT16", 1.0, "", "cycles of the plant, modulo 65536"
    text = "; ".join(f"{code} {fault}" for code, fault in enumerate(FAULTS))
    yield False, "fault", "UINT16", 1.0, "", text
    yield False, "wind_speed", "UINT16", WIND, "m/s", "anemometer"
    if crane.layout.drive_of("hoist") is not None:
        yield False, "load", "INT32", 1.0, "kg", f"load cell in the rope; {INVALID} if lost"
    for i in crane.swings.tolist():
        symbol, text = crane.layout.symbols[i], f"angle of the rope; {INVALID} if lost"
        yield False, f"{symbol}.angle", "INT16", ANGLE, "rad", text
    for joint, scale in drives:
        symbol, text = joint.symbol, f"bits from 0: {', '.join(STATUS)}"
        yield False, f"{symbol}.status", "UINT16", 1.0, "", text
        yield False, f"{symbol}.actual_speed", "INT16", scale, f"{joint.unit}/s", "speed"
        yield False, f"{symbol}.encoder", "INT32", COUNT[joint.unit], joint.unit, "position"


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
