"""The words of a plant as Modbus registers over TCP, by pymodbus."""

from __future__ import annotations

from cranedyn.bridges.commissioning.words import ProcessImage
from cranedyn.errors import CraneError

try:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice
except ModuleNotFoundError as error:
    raise CraneError(
        "Modbus needs pymodbus, which is not installed: pip install 'cranedyn[serve]'."
    ) from error


async def serve_modbus(image: ProcessImage, host: str, port: int) -> ModbusTcpServer:
    """Return a server of commands as holding registers and readings as input registers, which runs
    until its `shutdown`.

    Raises:
        CraneError: If it cannot listen at this address.
    """
    tables = [[word for word in image.words if word.command is kind] for kind in (True, False)]

    async def access(
        code: int, first: int, address: int, count: int, registers: list[int], values: object
    ) -> None:
        """Take what is written; fill the registers before they are read."""
        if isinstance(values, list):
            words = tables[0][address : address + count]
            half = {word.name: 0x8000 * (word.kind == "INT16") for word in words}
            pairs = zip(half.items(), values, strict=True)
            image.commands.update({name: (v + h) % 0x10000 - h for (name, h), v in pairs})
            return
        numbers = image.readings if code == 4 else image.commands.copy()
        registers[:] = [
            numbers[word.name] >> 16 * high & 0xFFFF
            for word in tables[code == 4]
            for high in reversed(range(word.size))
        ]

    holding, inputs = (
        [SimData(0, count=sum(word.size for word in words), datatype=DataType.REGISTERS)]
        for words in tables
    )
    bits = [SimData(0, values=False, datatype=DataType.BITS)]
    device = SimDevice(0, simdata=(bits, bits, holding, inputs), action=access)
    server = ModbusTcpServer(device, address=(host, port))
    try:
        await server.serve_forever(background=True)
    except (RuntimeError, OSError) as error:
        raise CraneError(f"Modbus cannot listen at {host}:{port}; is the port taken?") from error
    return server
