"""A soft PLC in 30 lines: it drives the trolley of `cranedyn serve` to a place over OPC UA.

``cranedyn serve --opcua 127.0.0.1:4840``, then ``python examples/bridges/soft_plc.py --to 14`` in
another terminal. It needs ``pip install 'cranedyn[serve]'``.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Sequence

from asyncua import Client, ua

COUNT = 1e-4
"""Worth of a count of the trolley's encoder [m], from the CSV of ``cranedyn serve --map``."""

CYCLE = 0.02
"""Time from one cycle to the next [s]."""

FULL_SPEED = 16384
"""Full speed in the word of the speed [counts]."""

SPEED_GAIN = 8000
"""Speed for each metre from the target [counts/m]."""


async def drive(url: str, target: float, seconds: float) -> float:
    """Drive the trolley to a place [m] every 20 ms, and return where it is after a time [s]."""
    async with Client(url) as client:
        names = ("heartbeat", "x.control", "x.speed", "x.encoder")
        beat, control, speed, encoder = (client.get_node(f"ns=2;s={name}") for name in names)
        for cycle in range(round(seconds / CYCLE)):
            position = COUNT * await encoder.read_value()
            wanted = round(SPEED_GAIN * (target - position))
            counts = max(-FULL_SPEED, min(FULL_SPEED, wanted))
            words = [
                ua.Variant(cycle % 65536, ua.VariantType.UInt16),
                ua.Variant(1, ua.VariantType.UInt16),
                ua.Variant(counts, ua.VariantType.Int16),
            ]
            await client.write_values([beat, control, speed], words)
            await asyncio.sleep(CYCLE)
        await control.write_value(ua.Variant(0, ua.VariantType.UInt16))
        return COUNT * float(await encoder.read_value())


def main(arguments: Sequence[str] | None = None) -> float:
    """Drive, and print where the trolley is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="opc.tcp://127.0.0.1:4840/")
    parser.add_argument("--to", type=float, default=14.0, help="place of the trolley [m]")
    parser.add_argument("--seconds", type=float, default=12.0, help="how long")
    options = parser.parse_args(arguments)
    place = asyncio.run(drive(options.url, options.to, options.seconds))
    print(f"The trolley is at {place:.3f} m.")
    return place


if __name__ == "__main__":
    main()
