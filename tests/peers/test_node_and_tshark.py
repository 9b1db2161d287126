"""The ODOMETRY that we send as node-mavlink and as Wireshark's tshark read it: the fields are those of pymavlink and of our own tables."""

import csv
import json
import math
import os
import struct
import subprocess
import tempfile
import unittest

from drives import for_ground_stations, simulated
from ground import ESTIMATOR, VEHICLE, Ground, sender
from harness import RunningStation, output_of, posebridge

HERE = os.path.dirname(os.path.abspath(__file__))
FIELDS = (
    "time_usec", "frame_id", "child_frame_id", "x", "y", "z", "q", "vx", "vy", "vz", "rollspeed", "pitchspeed", "yawspeed",
    "pose_covariance", "velocity_covariance", "reset_counter", "estimator_type", "quality",
)
ARRAYS = {"q": 4, "pose_covariance": 21, "velocity_covariance": 21}
LOCAL_FRD, BODY_FRD = 20, 12
# The first linktype that is everybody's own; mavgen's dissector takes it for MAVLink.
DLT_USER0 = 147
# It prints six digits of a 32-bit float.
TSHARK_PRECISION = 5e-6


class Odometry(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        """Some seconds of a drive, as they came over the wire, with our own table of the estimates."""
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = folder.name
        station = RunningStation(cls.folder, "run", simulated(cls.folder) + for_ground_stations("udp", 'dialects = "all"'))
        cls.addClassCleanup(station.kill)
        ground = Ground(station.addresses[0])
        cls.addClassCleanup(ground.close)
        # The robot rests for two seconds before it drives.
        ground.hear_beats(8)
        station.stop()
        cls.frames = [bytes(message.get_msgbuf()) for message in ground.heard if sender(message) in (VEHICLE, ESTIMATOR)]
        odometry = [message for message in ground.heard if message.get_type() == "ODOMETRY"]
        cls.expected = [{name: getattr(message, name) for name in FIELDS} for message in odometry]

    def same(self, theirs, ours, precision=0.0):
        """Two readings of one message."""
        for name in FIELDS:
            for one, other in zip(as_list(theirs[name]), as_list(ours[name]), strict=True):
                is_unknown = math.isnan(other) and (one is None or math.isnan(one))
                self.assertTrue(is_unknown or math.isclose(one, other, rel_tol=precision), f"{name}: {one} is not {other}")

    def test_node_mavlink_reads_what_pymavlink_reads(self):
        done = subprocess.run(
            ["node", os.path.join(HERE, "node", "odometry.mjs")], input=b"".join(self.frames), capture_output=True, timeout=60)
        self.assertEqual(done.returncode, 0, done.stderr.decode())
        read = [json.loads(line) for line in done.stdout.splitlines()]
        self.assertEqual(len(read), len(self.expected))
        for theirs, ours in zip(read, self.expected):
            self.assertEqual((theirs["sysid"], theirs["compid"]), ESTIMATOR)
            self.same(theirs, ours)

    def test_tshark_reads_what_pymavlink_reads(self):
        capture = os.path.join(self.folder, "frames.pcap")
        with open(capture, "wb") as file:
            file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, DLT_USER0))
            for second, frame in enumerate(self.frames):
                file.write(struct.pack("<IIII", second, 0, len(frame), len(frame)) + frame)
        columns = ["sysid", "compid", *(f"ODOMETRY_{name}" for name in names_of_scalars())]
        printed = output_of(
            os.environ["PEERS_TSHARK"], "-r", capture, "-X", f"lua_script:{os.environ['PEERS_DIALECT']}/posebridge_all.lua",
            "-Y", "mavlink_proto.msgid == 331", "-T", "fields", *(part for name in columns for part in ("-e", f"mavlink_proto.{name}")),
            folder=self.folder, environment={"HOME": self.folder})
        read = [line.split("\t") for line in printed.splitlines()]
        self.assertEqual(len(read), len(self.expected))
        for row, ours in zip(read, self.expected):
            self.assertEqual((int(row[0]), int(row[1])), ESTIMATOR)
            values = iter(map(float, row[2:]))
            theirs = {name: [next(values) for _ in range(ARRAYS[name])] if name in ARRAYS else next(values) for name in FIELDS}
            self.same(theirs, ours, TSHARK_PRECISION)

    def test_the_fields_are_those_of_our_own_tables(self):
        posebridge(self.folder, "export", "run/recording.mcap", "--format", "csv", "--out", "tables")
        with open(os.path.join(self.folder, "tables", "estimates.csv"), newline="") as file:
            rows = [{name: float(value) for name, value in row.items() if value and name != "robot"} for row in csv.DictReader(file)]
        known = [odometry for odometry in self.expected if odometry["quality"] >= 0]
        self.assertGreater(len(known), 50)
        for odometry in known:
            self.assertEqual((odometry["frame_id"], odometry["child_frame_id"]), (LOCAL_FRD, BODY_FRD))
            wanted = {
                "x_m": odometry["x"], "y_m": -odometry["y"], "forward_m_per_s": odometry["vx"], "turn_rad_per_s": -odometry["yawspeed"],
                "heading_rad": -2.0 * math.atan2(odometry["q"][3], odometry["q"][0]),
                "var_x_m2": odometry["pose_covariance"][0], "cov_x_y_m2": -odometry["pose_covariance"][1],
                "var_y_m2": odometry["pose_covariance"][6], "cov_x_heading_m_rad": -odometry["pose_covariance"][5],
                "cov_y_heading_m_rad": odometry["pose_covariance"][10], "var_heading_rad2": odometry["pose_covariance"][20],
            }
            self.assertTrue(any(is_row(row, wanted) for row in rows), wanted)


def is_row(row, wanted):
    """Whether a line of our table has these values, to the precision of a 32-bit float."""
    return all(
        abs(math.remainder(row[name] - value, math.tau) if name == "heading_rad" else row[name] - value) < 1e-6 + 1e-6 * abs(value)
        for name, value in wanted.items())


def names_of_scalars():
    for name in FIELDS:
        yield from (f"{name}_{index}" for index in range(ARRAYS[name])) if name in ARRAYS else (name,)


def as_list(value):
    return value if isinstance(value, (list, tuple)) else [value]


if __name__ == "__main__":
    unittest.main()
