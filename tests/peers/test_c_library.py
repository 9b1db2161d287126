"""The stock MAVLink C library as a ground station: c_ground_station.c around the headers that mavgen makes from common.xml, compiled by gcc.

It counts what it misses of each sender and what it cannot verify; the station counts what it misses of it.
"""

import functools
import os
import subprocess
import sys
import tempfile
import unittest

from drives import SQUARE, for_ground_stations, inspected, kept_folder, nxt_station, simulated
from ground import ESTIMATOR, VEHICLE
from harness import DEADLINE_S, Process, RunningStation, output_of

CAMERA = (1, 100)
SECONDS = 60 if os.environ.get("PEERS_LONG") else 10
# The links, and who looks there: two programs of one address would look like one that is heard twice.
SCHEMES = {"udp": (255, 190), "tcp": (255, 191)}


@functools.lru_cache(maxsize=None)
def compiled():
    """The program."""
    program = os.path.join(kept_folder(), "c_ground_station")
    source = os.path.join(os.path.dirname(__file__), "c_ground_station.c")
    # Our own program without a warning; the library has some.
    output_of(
        "gcc", "-O1", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-isystem", os.environ["PEERS_C_LIBRARY"], source, "-o", program)
    return program


class Watch:
    """The program while it looks at one link."""

    def __init__(self, test, address, scheme, seconds):
        self.seconds = seconds
        host, port = address
        command = [compiled(), scheme, host, str(port), str(SCHEMES[scheme][1]), str(seconds)]
        self.process = Process(test.folder, command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT).belongs_to(test)

    def end(self):
        """What it has counted: frames and gaps of each sender, and what the library says."""
        self.process.end(self.seconds + 2 * DEADLINE_S)
        self.frames, self.gaps = {}, {}
        for line in self.process.talk().splitlines():
            kind, *counts = line.split()
            counts = [int(count) for count in counts]
            if kind == "source":
                self.frames[counts[0], counts[1]], self.gaps[counts[0], counts[1]] = counts[2:]
            else:
                self.dropped, self.bad_crc, self.sent, self.answers, self.values = counts
        return self


class GroundStation(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def watched(self, station, seconds=SECONDS):
        """What the program counts on each link of a station, UDP and TCP at the same time, and the station's count of the program on each link."""
        watches = [Watch(self, address, scheme, seconds) for address, scheme in zip(station.addresses, SCHEMES, strict=True)]
        watches = [watch.end() for watch in watches]
        station.stop()
        sources = inspected(self.folder, "run/recording.mcap")["sources"]
        by_address = {(source["system"], source["component"]): source for source in sources}
        return watches, [by_address[own] for own in SCHEMES.values()]

    def nothing_is_lost(self, station):
        watches, own = self.watched(station)
        for scheme, watch, source in zip(SCHEMES, watches, own, strict=True):
            theirs = f"{watch.frames} frames, gaps {watch.gaps}, dropped {watch.dropped}, wrong checksum {watch.bad_crc}"
            print(f"\n  {scheme}, {SECONDS} s: {theirs}; of its {watch.sent} frames lost {source['lost']}", file=sys.stderr)
            # Our own messages must not be here: it could not verify them.
            self.assertEqual((watch.dropped, watch.bad_crc), (0, 0))
            # They also hear each other.
            others = [own for other, own in SCHEMES.items() if other != scheme]
            self.assertEqual(watch.gaps, dict.fromkeys((VEHICLE, ESTIMATOR, CAMERA, *others), 0))
            self.assertTrue(all(count > SECONDS / 2 for count in watch.frames.values()), watch.frames)
            self.assertTrue(all(watch.frames[one] > 10 * SECONDS for one in (VEHICLE, ESTIMATOR)), watch.frames)
            # Each question and each request is answered.
            self.assertEqual((watch.answers, watch.values), (10 * SECONDS + 1, SECONDS))
            frames = sum(message["frames"] for message in source["messages"])
            self.assertEqual((frames, source["lost"]), (watch.sent, 0))

    def of_a_simulated_robot(self, *keys):
        links = [for_ground_stations(scheme, *keys) for scheme in SCHEMES]
        return RunningStation(self.folder, "run", simulated(self.folder, SQUARE) + "\n".join(links)).belongs_to(self)

    def test_loses_nothing_of_a_robot_with_messages_of_ours(self):
        self.nothing_is_lost(self.of_a_simulated_robot())

    def test_loses_nothing_of_an_nxt(self):
        station = nxt_station(self, self.folder, *(for_ground_stations(scheme) for scheme in SCHEMES))
        self.nothing_is_lost(station)

    def test_would_count_messages_of_ours_as_wrong(self):
        watches, _ = self.watched(self.of_a_simulated_robot('dialects = "all"'), seconds=2)
        for watch in watches:
            self.assertGreater(watch.bad_crc, 10)
            # It adds the last one with the next byte.
            self.assertGreaterEqual(watch.dropped, watch.bad_crc - 1)
            self.assertGreater(watch.gaps[VEHICLE], 10)


if __name__ == "__main__":
    unittest.main()
