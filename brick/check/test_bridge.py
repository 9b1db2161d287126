"""The bridge between a Pybricks hub and the station, with no hub: a queue stands for it, a server on loopback for the station.

python3 brick/check/test_bridge.py
"""

import asyncio
import sys
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "micropython"))
import pybricks_bridge as bridge  # noqa: E402
import posebridge_brick as brick  # noqa: E402

# Bytes in a notification of a hub, without its type.
NOTIFICATION = 19


class Carry(unittest.IsolatedAsyncioTestCase):
    async def asyncSetUp(self):
        self.station = asyncio.Queue()
        self.server = await asyncio.start_server(self.accept, "127.0.0.1", 0)
        reader, writer = await asyncio.open_connection(*self.server.sockets[0].getsockname())
        self.notifications, self.written = asyncio.Queue(), []
        self.carrying = asyncio.create_task(bridge.carry(self.notifications, self.write, reader, writer))
        self.from_brick, self.to_brick = await self.station.get()

    async def asyncTearDown(self):
        self.to_brick.close()
        self.server.close()

    async def accept(self, reader, writer):
        await self.station.put((reader, writer))

    async def write(self, data):
        self.written.append(bytes(data))

    async def test_frames_reach_the_station_whole_however_they_were_cut(self):
        frames = []
        link = brick.Link(frames.append)
        for count in range(50):
            link.wheel_ticks(count, count, -count)
        sent = b"".join(frames)
        for place in range(0, len(sent), NOTIFICATION):
            self.notifications.put_nowait(sent[place : place + NOTIFICATION])
        self.notifications.put_nowait(None)
        self.assertEqual(await self.from_brick.read(), sent)
        await self.carrying

    async def test_what_the_station_sends_reaches_the_hub_in_pieces_that_it_takes(self):
        sent = bytes(range(256)) * 4
        self.to_brick.write(sent)
        self.to_brick.close()
        await self.carrying
        self.assertEqual(b"".join(self.written), sent)
        self.assertLessEqual(max(map(len, self.written)), bridge.LONGEST_WRITE)

    async def test_a_hub_that_refuses_ends_the_bridge_with_its_reason(self):
        async def refuse(_):
            raise RuntimeError("disconnected")

        self.carrying.cancel()
        reader, writer = await asyncio.open_connection(*self.server.sockets[0].getsockname())
        carrying = asyncio.create_task(bridge.carry(asyncio.Queue(), refuse, reader, writer))
        _, to_brick = await self.station.get()
        to_brick.write(b"x")
        with self.assertRaisesRegex(RuntimeError, "disconnected"):
            await carrying
        to_brick.close()


if __name__ == "__main__":
    unittest.main()
