#!/usr/bin/env python3
"""Carries bytes between a Pybricks hub, over Bluetooth Low Energy, and posebridge, over TCP on this computer.

    pip install pybricksdev==2.3.2
    posebridge run --listen tcp://127.0.0.1:5760 --robot config/robots/pybricks-spike.toml          in one terminal
    python3 brick/micropython/pybricks_bridge.py brick/micropython/spike_drive_base.py     in another

It sends the program with posebridge_brick.py to the first hub that advertises itself (--name chooses one), starts it, and then moves
bytes both ways until one side ends. posebridge has no Bluetooth Low Energy of its own.

What the hub prints comes in notifications of 20 bytes, which cut frames anywhere: the station puts them together again. To
the hub go at most 100 bytes per write. `carry` does all that and knows nothing of Bluetooth; tests run it without a hub.
"""

import argparse
import asyncio
import sys
from pathlib import Path

# The hub takes writes of up to its own limit, never less than this; a frame is 64 bytes at most.
LONGEST_WRITE = 100


async def carry(from_hub, write_to_hub, reader, writer):
    """Moves bytes until a side ends. from_hub: a queue of bytes, None at the end; write_to_hub: a coroutine that takes bytes."""

    async def to_station():
        while (chunk := await from_hub.get()) is not None:
            writer.write(chunk)
            await writer.drain()

    async def to_hub():
        while chunk := await reader.read(LONGEST_WRITE):
            await write_to_hub(chunk)

    ways = {asyncio.create_task(to_station()), asyncio.create_task(to_hub())}
    done, pending = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    for way in pending:
        way.cancel()
    await asyncio.gather(*pending, return_exceptions=True)
    writer.close()
    for way in done:
        way.result()


async def run(arguments):
    try:
        from pybricksdev.ble import find_device
        from pybricksdev.connections.pybricks import PybricksHubBLE
    except ImportError:
        sys.exit("pybricksdev is missing: pip install pybricksdev==2.3.2")
    host, _, port = arguments.station.rpartition(":")
    try:
        reader, writer = await asyncio.open_connection(host, int(port))
    except OSError as error:
        sys.exit(f"no station at {arguments.station} ({error}): start posebridge run --listen tcp://{arguments.station} first")
    hub = PybricksHubBLE(await find_device(arguments.name))
    await hub.connect()
    chunks = asyncio.Queue()
    hub.stdout_observable.subscribe(chunks.put_nowait)
    hub.connection_state_observable.subscribe(lambda state: chunks.put_nowait(None) if state.name == "DISCONNECTED" else None)
    try:
        await hub.run(str(arguments.program), wait=False, print_output=False, line_handler=False)
        await carry(chunks, hub.write, reader, writer)
    finally:
        await hub.disconnect()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=Path, help="what the hub runs; posebridge_brick.py must lie beside it")
    parser.add_argument("--station", default="127.0.0.1:5760", help="where posebridge listens (%(default)s)")
    parser.add_argument("--name", help="name of the hub; without it the first that is found")
    asyncio.run(run(parser.parse_args()))


if __name__ == "__main__":
    main()
