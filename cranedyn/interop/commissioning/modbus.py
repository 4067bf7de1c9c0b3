"""The words of a plant as Modbus registers over TCP, by pymodbus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cranedyn.errors import CraneError
from cranedyn.interop.commissioning.words import ProcessImage, Word

try:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice
except ModuleNotFoundError as error:
    raise CraneError(
        "Modbus needs pymodbus, which is not installed: pip install 'cranedyn[serve]'."
    ) from error


READ_INPUT_REGISTERS = 4
"""Code of the function by which Modbus reads input registers."""

_REGISTER_VALUES = 0x10000
"""Number of values of a register of 16 bits."""


async def serve_modbus(image: ProcessImage, host: str, port: int) -> ModbusTcpServer:
    """Return a server of commands as holding registers and readings as input registers, which runs
    until its `shutdown`.

    Raises:
        CraneError: If it cannot listen at this address.
    """
    commands = [word for word in image.words if word.command]
    readings = [word for word in image.words if not word.command]

    async def access(
        code: int, first: int, address: int, count: int, registers: list[int], values: object
    ) -> None:
        """Take what is written; fill the registers before they are read.

        pymodbus calls it before it answers a client, with the values of a write, or without any for
        a read.
        """
        if isinstance(values, list):
            _write_commands(image, commands[address : address + count], values)
        elif code == READ_INPUT_REGISTERS:
            registers[:] = _registers(readings, image.readings)
        else:
            registers[:] = _registers(commands, image.commands.copy())

    # pymodbus asks for blocks of coils and discrete inputs, too, of which a crane has none.
    bits = [SimData(0, values=False, datatype=DataType.BITS)]
    device = SimDevice(0, simdata=(bits, bits, _block(commands), _block(readings)), action=access)
    server = ModbusTcpServer(device, address=(host, port))
    try:
        await server.serve_forever(background=True)
    except (RuntimeError, OSError) as error:
        raise CraneError(f"Modbus cannot listen at {host}:{port}; is the port taken?") from error
    return server


def _block(words: Sequence[Word]) -> list[SimData]:
    """Return a block of as many registers as words take."""
    count = sum(word.size for word in words)
    return [SimData(0, count=count, datatype=DataType.REGISTERS)]


def _write_commands(image: ProcessImage, words: Sequence[Word], values: Sequence[int]) -> None:
    """Write the values of registers, 0 to 65535, into commands of an image, all at once.

    Each command takes one register. A signed one has its negative numbers in the upper half.
    """
    commands = {}
    for word, value in zip(words, values, strict=True):
        # Two's complement: with the range shifted by its half, the remainder makes the values of
        # the upper half negative.
        half = _REGISTER_VALUES // 2 if word.kind == "INT16" else 0
        commands[word.name] = (value + half) % _REGISTER_VALUES - half
    image.commands.update(commands)


def _registers(words: Sequence[Word], numbers: Mapping[str, int]) -> list[int]:
    """Return the registers of words, the high one of a word of 32 bits first.

    Args:
        words: The words.
        numbers: Their numbers by name.
    """
    registers = []
    for word in words:
        number = numbers[word.name]
        # The lowest 16 bits of a negative number are its two's complement.
        if word.size == 2:
            registers.append(number >> 16 & 0xFFFF)
        registers.append(number & 0xFFFF)
    return registers
