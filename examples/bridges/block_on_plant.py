"""An exported controller at work on `cranedyn serve`, over OPC UA or Modbus.

The program is what stands around a controller on a PLC: it reads the words of the crane, calls the
block once a cycle, and writes the speeds. The block is the C code of ``cranedyn export c``, which
is compiled here.

    cranedyn export c block --controller lqr --drive velocity --period 0.02
    cranedyn serve --opcua 127.0.0.1:4840 --modbus 127.0.0.1:5020 --map words.csv
    python examples/bridges/block_on_plant.py block words.csv --modbus 127.0.0.1:5020 --to x=14

The last command runs in another terminal. It needs ``pip install 'cranedyn[serve]'`` and a C
compiler.
"""

from __future__ import annotations

import argparse
import csv
import ctypes
import re
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

CYCLE = 0.02
"""Time from one call of the block to the next [s]: the ``--period`` with which it was exported."""

SETPOINT_TIME = 10.0
"""Time in which the setpoints go to the target [s]."""

FILTER_TIME = 0.1
"""Time constant with which the rate of the swing is made of rope angles [s], a sixtieth of the
period of a swing on 10 m. The angles come in steps of 1e-4 rad."""

FULL_SPEED = 16384
"""Word of a speed that commands the largest rate."""

DRIVES = ("gamma", "x", "l")
SWINGS = ("phi", "theta")
LOST = -32768
"""Word of a rope angle whose sensor is lost."""


class Word(NamedTuple):
    """A row of the file of ``cranedyn serve --map``.

    Attributes:
        node: Its node of OPC UA.
        address: Its first register of Modbus.
        kind: UINT16, INT16 or INT32.
        scale: Value of one count.
        is_command: Whether the program writes it.
    """

    node: str
    address: int
    kind: str
    scale: float
    is_command: bool


def read_map(file: Path) -> dict[str, Word]:
    """Return the words by their names."""
    words = {}
    with file.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            words[row["name"]] = Word(
                node=row["opc_ua_node"],
                address=int(row["modbus_address"]),
                kind=row["type"],
                scale=float(row["scale"]),
                is_command=row["direction"] == "command",
            )
    return words


class Link(ABC):
    """A connection to the plant."""

    @abstractmethod
    def read(self) -> dict[str, int]:
        """Return all readings by name [counts]."""

    @abstractmethod
    def write(self, commands: Mapping[str, int]) -> None:
        """Write commands by name [counts]."""

    @abstractmethod
    def close(self) -> None:
        """End the connection."""


class OpcUaLink(Link):
    """OPC UA: one request reads all nodes, and one writes those of the commands."""

    def __init__(self, url: str, words: Mapping[str, Word]) -> None:
        from asyncua import ua
        from asyncua.sync import Client

        self._ua = ua
        self._client = Client(url)
        try:
            self._client.connect()
        except OSError as error:
            self._client.tloop.stop()
            raise SystemExit(f"No OPC UA server at {url}; start cranedyn serve first.") from error
        self._words = words
        self._nodes = {name: self._client.get_node(word.node) for name, word in words.items()}
        self._readings = [name for name, word in words.items() if not word.is_command]

    def read(self) -> dict[str, int]:
        values = self._client.read_values([self._nodes[name] for name in self._readings])
        return dict(zip(self._readings, values, strict=True))

    def write(self, commands: Mapping[str, int]) -> None:
        kinds = {"UINT16": self._ua.VariantType.UInt16, "INT16": self._ua.VariantType.Int16}
        values = []
        for name, value in commands.items():
            values.append(self._ua.Variant(value, kinds[self._words[name].kind]))
        self._client.write_values([self._nodes[name] for name in commands], values)

    def close(self) -> None:
        self._client.disconnect()


class ModbusLink(Link):
    """Modbus TCP: function 4 reads all input registers, and 16 writes all holding registers."""

    def __init__(self, host: str, port: int, words: Mapping[str, Word]) -> None:
        from pymodbus.client import ModbusTcpClient

        self._client = ModbusTcpClient(host, port=port)
        if not self._client.connect():
            raise SystemExit(f"No Modbus server at {host}:{port}; start cranedyn serve first.")
        self._readings = {name: word for name, word in words.items() if not word.is_command}
        self._commands = {name: word for name, word in words.items() if word.is_command}
        self._registers = 0
        for word in self._readings.values():
            end = word.address + (2 if word.kind == "INT32" else 1)
            self._registers = max(self._registers, end)

    def read(self) -> dict[str, int]:
        answer = self._client.read_input_registers(0, count=self._registers)
        if answer.isError():
            raise SystemExit(f"The Modbus server refuses to be read: {answer}")
        readings = {}
        for name, word in self._readings.items():
            kind = self._client.DATATYPE[word.kind]
            end = word.address + kind.value[1]
            registers = answer.registers[word.address : end]
            readings[name] = self._client.convert_from_registers(registers, kind)
        return readings

    def write(self, commands: Mapping[str, int]) -> None:
        # What the program does not command, such as the ramps, stays 0.
        registers = [0] * len(self._commands)
        for name, value in commands.items():
            registers[self._commands[name].address] = value & 0xFFFF
        answer = self._client.write_registers(0, registers)
        if answer.isError():
            raise SystemExit(f"The Modbus server refuses the commands: {answer}")

    def close(self) -> None:
        self._client.close()


class Block:
    """The controller of a folder of ``cranedyn export c``, compiled for this machine.

    Its inputs and outputs are the fields of `values`.
    """

    def __init__(self, folder: Path, compiler: str = "cc") -> None:
        library = folder.resolve() / "controller.so"
        source = str(folder / "controller.c")
        subprocess.run(
            [compiler, "-std=c99", "-O1", "-shared", "-fPIC", source, "-lm", "-o", str(library)],
            check=True,
        )
        header = (folder / "controller.h").read_text(encoding="utf-8")
        if f"every {CYCLE:g} s" not in header:
            raise SystemExit(
                f"The block in {folder} is not made for cycles of {CYCLE:g} s; export it with "
                f"--period {CYCLE:g}."
            )
        types = {"double": ctypes.c_double, "int32_t": ctypes.c_int32, "bool": ctypes.c_bool}
        self.names = []
        fields = []
        for kind, name in re.findall(r"^  (double|int32_t|bool) (\w+);", header, re.M):
            self.names.append(name)
            fields.append((name, types[kind]))
        if "x_dot_command" not in self.names:
            raise SystemExit(
                f"The block in {folder} does not command rates; export it with --drive velocity."
            )
        structure = type("Values", (ctypes.Structure,), {"_fields_": fields})
        self.values = structure()
        self._library = ctypes.CDLL(str(library))
        self._library.controller_step.restype = ctypes.c_bool
        self._library.controller_reset(ctypes.byref(self.values))

    def step(self, inputs: Mapping[str, float]) -> bool:
        """Call the block with the inputs that it has among these, and return whether it found no
        fault.
        """
        for name, value in inputs.items():
            if name in self.names:
                setattr(self.values, name, value)
        return bool(self._library.controller_step(ctypes.byref(self.values)))


class SwingRates:
    """Rates of the swing [rad/s] from its angles, by a filtered difference."""

    def __init__(self) -> None:
        self._filtered: dict[str, float] = {}

    def update(self, angles: Mapping[str, float]) -> dict[str, float]:
        """Take the angles of a cycle [rad], and return their rates by name."""
        rates = {}
        for name, angle in angles.items():
            filtered = self._filtered.get(name, angle)
            # The filter follows the angle by the rate (angle - filtered) / FILTER_TIME.
            rates[f"{name}_dot"] = (angle - filtered) / (FILTER_TIME + CYCLE)
            self._filtered[name] = filtered + CYCLE * rates[f"{name}_dot"]
        return rates


class Move(NamedTuple):
    """What a move came to.

    Attributes:
        positions: Positions of the drives at the end [rad or m], by name.
        peak_swing: Largest swing on the way [rad].
        last_swing: Largest swing in the last five seconds [rad].
        fault: Code of the fault of the crane at the end; 0 for none.
    """

    positions: dict[str, float]
    peak_swing: float
    last_swing: float
    fault: int


def move(
    link: Link,
    words: Mapping[str, Word],
    block: Block,
    targets: Mapping[str, float],
    seconds: float,
    wait: Callable[[], None],
) -> Move:
    """Move the drives to their targets and hold them there.

    Args:
        link: Connection to the plant.
        words: Its words.
        block: The controller.
        targets: Positions of drives [rad or m]; the others stay where they are.
        seconds: How long it is driven [s].
        wait: Function that waits for the next cycle.
    """
    swing_rates = SwingRates()
    start: dict[str, float] = {}
    swings = []
    cycles = round(seconds / CYCLE)
    for cycle in range(cycles):
        readings = link.read()

        # What the block measures, in SI units.
        inputs = {}
        for drive in DRIVES:
            inputs[drive] = readings[f"{drive}.encoder"] * words[f"{drive}.encoder"].scale
            speed = readings[f"{drive}.actual_speed"] * words[f"{drive}.actual_speed"].scale
            inputs[f"{drive}_dot"] = speed
        angles = {}
        for swing in SWINGS:
            angles[swing] = readings[f"{swing}.angle"] * words[f"{swing}.angle"].scale
        inputs |= angles
        inputs |= swing_rates.update(angles)
        swings.append(max(abs(angle) for angle in angles.values()))

        # Setpoints on straight lines to the targets.
        start = start or {drive: inputs[drive] for drive in DRIVES}
        share = min(cycle * CYCLE / SETPOINT_TIME, 1.0)
        for drive in DRIVES:
            way = targets.get(drive, start[drive]) - start[drive]
            inputs[f"{drive}_set"] = start[drive] + share * way
            inputs[f"{drive}_dot_set"] = way / SETPOINT_TIME if share < 1.0 else 0.0

        is_lost = any(readings[f"{swing}.angle"] == LOST for swing in SWINGS)
        is_enabled = block.step(inputs) and readings["fault"] == 0 and not is_lost
        commands = {"heartbeat": cycle % 65536}
        for drive in DRIVES:
            rate = getattr(block.values, f"{drive}_dot_command")
            counts = round(rate / words[f"{drive}.speed"].scale)
            commands[f"{drive}.control"] = int(is_enabled)
            commands[f"{drive}.speed"] = max(-FULL_SPEED, min(FULL_SPEED, counts))
        link.write(commands)
        if not is_enabled:
            break
        wait()

    link.write({f"{drive}.control": 0 for drive in DRIVES})
    readings = link.read()
    positions = {}
    for drive in DRIVES:
        positions[drive] = readings[f"{drive}.encoder"] * words[f"{drive}.encoder"].scale
    last_cycles = round(5.0 / CYCLE)
    return Move(positions, max(swings), max(swings[-last_cycles:]), readings["fault"])


def _clock() -> Callable[[], None]:
    """Return a function that waits for the next cycle of this machine's clock."""
    due = time.monotonic()

    def wait() -> None:
        nonlocal due
        due += CYCLE
        time.sleep(max(due - time.monotonic(), 0.0))

    return wait


def _target(text: str) -> tuple[str, float]:
    """Return a drive and its target from DRIVE=POSITION."""
    drive, _, position = text.partition("=")
    if drive not in DRIVES:
        raise argparse.ArgumentTypeError(f"{drive} is none of {', '.join(DRIVES)}")
    return drive, float(position)


def main(arguments: Sequence[str] | None = None, wait: Callable[[], None] | None = None) -> Move:
    """Move the crane, and print where it is and how far the load swung.

    Args:
        arguments: Words of the command line.
        wait: Function that waits for the next cycle; None for the clock of this machine.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("block", type=Path, help="folder of cranedyn export c")
    parser.add_argument("map", type=Path, help="file of cranedyn serve --map")
    protocol = parser.add_mutually_exclusive_group(required=True)
    protocol.add_argument("--opcua", metavar="URL", help="such as opc.tcp://127.0.0.1:4840/")
    protocol.add_argument("--modbus", metavar="HOST:PORT", help="such as 127.0.0.1:5020")
    parser.add_argument(
        "--to",
        nargs="+",
        type=_target,
        default=[("x", 14.0)],
        metavar="DRIVE=POSITION",
        help="targets, such as gamma=0.2 x=14",
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="how long")
    options = parser.parse_args(arguments)

    words = read_map(options.map)
    block = Block(options.block)
    link: Link
    if options.opcua:
        link = OpcUaLink(options.opcua, words)
    else:
        host, _, port = options.modbus.rpartition(":")
        link = ModbusLink(host, int(port), words)
    try:
        done = move(link, words, block, dict(options.to), options.seconds, wait or _clock())
    finally:
        link.close()

    for drive, position in done.positions.items():
        print(f"{drive} is at {position:.3f}.")
    print(
        f"The load swung by {done.peak_swing:.4f} rad at most, and by {done.last_swing:.4f} rad in "
        "the last five seconds."
    )
    if done.fault:
        print(f"The crane has the fault {done.fault}.", file=sys.stderr)
    return done


if __name__ == "__main__":
    main()
