"""rosbags on the ROS 2 bags that we write: it knows the messages by its own definitions, and its figures are those of our tables. And the other way
round: a bag that rosbags has written is fused, and the result held against the truth."""

import collections
import csv
import math
import os
import pathlib
import tempfile
import unittest

import numpy
from mcap.reader import SeekingReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drives import finished_drive
from harness import json_of, posebridge

TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/imu": "sensor_msgs/msg/Imu",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
TOLERANCE = 1e-12
# Where the covariance of x, y and yaw is in 6 x 6 numbers, by our columns.
POSE_COVARIANCE = {
    "var_x_m2": 0, "cov_x_y_m2": 1, "cov_x_heading_m_rad": 5, "var_y_m2": 7, "cov_y_heading_m_rad": 11, "var_heading_rad2": 35}
TWIST_COVARIANCE = {"var_forward_m2_per_s2": 0, "cov_forward_turn_m_rad_per_s2": 5, "var_turn_rad2_per_s2": 35}
UNMEASURED = 1e6


def yaw(quaternion):
    return 2.0 * math.atan2(quaternion.z, quaternion.w)


def plane(transform):
    """A transform as x, y and yaw."""
    return transform.translation.x, transform.translation.y, yaw(transform.rotation)


def chained(outer, inner):
    """The first transform after the second one."""
    (x, y, turn), (dx, dy, more) = outer, inner
    return x + math.cos(turn) * dx - math.sin(turn) * dy, y + math.sin(turn) * dx + math.cos(turn) * dy, turn + more


def nanoseconds(header):
    return 1_000_000_000 * header.stamp.sec + header.stamp.nanosec


class Bag(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        posebridge(finished_drive(), "export", "run/recording.mcap", "--format", "ros2,csv", "--out", folder.name)
        # As a folder, which is what players of bags are given.
        cls.bag = pathlib.Path(folder.name) / "recording-ros2"
        cls.path = cls.bag / "recording-ros2_0.mcap"
        with open(os.path.join(folder.name, "estimates.csv"), newline="") as file:
            rows = list(csv.DictReader(file))
        # A position without a heading is no pose.
        cls.estimates = [row for row in rows if row["position_valid"] == "0" or row["heading_valid"] == "1"]
        cls.store = get_typestore(Stores.ROS2_JAZZY)
        cls.messages = collections.defaultdict(list)
        # Not AnyReader, which would take the definitions in the bag.
        with Reader(cls.bag) as reader:
            cls.described = (reader.message_count, reader.start_time, reader.duration, reader.compression_mode)
            cls.connections = {one.topic: one for one in reader.connections}
            for connection, time, data in reader.messages():
                cls.messages[connection.topic].append((time, cls.store.deserialize_cdr(data, connection.msgtype)))

    def near(self, ours, theirs, scale=1.0):
        self.worst = max(getattr(self, "worst", 0.0), abs(float(ours) - theirs))
        self.assertAlmostEqual(float(ours), theirs, delta=TOLERANCE * max(1.0, scale))

    def test_every_topic_has_its_type_with_the_hash_of_rosbags_and_a_definition_that_gives_it(self):
        self.assertEqual({topic: one.msgtype for topic, one in self.connections.items()}, TOPICS)
        # The metadata.yaml has none of these: its version is that of ROS 2 Humble.
        with open(self.path, "rb") as file:
            channels = SeekingReader(file, validate_crcs=True).get_summary().channels.values()
        hashes = {channel.topic: channel.metadata["topic_type_hash"] for channel in channels}
        for topic, connection in self.connections.items():
            expected = self.store.hash_rihs01(connection.msgtype)
            self.assertEqual(hashes[topic], expected, topic)
            embedded = get_typestore(Stores.EMPTY)
            embedded.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            self.assertEqual(embedded.hash_rihs01(connection.msgtype), expected, topic)
            (offered,) = connection.ext.offered_qos_profiles
            self.assertEqual((offered.reliability.name, offered.durability.name, offered.depth), ("RELIABLE", "VOLATILE", 10))
            self.assertTrue(self.messages[topic], topic)

    def test_the_metadata_describes_the_messages(self):
        times = [time for messages in self.messages.values() for time, _ in messages]
        message_count, start, duration, compression = self.described
        self.assertEqual((message_count, start, compression), (len(times), min(times), ""))
        # rosbags counts the nanosecond of the last message.
        self.assertIn(duration - (max(times) - min(times)), (0, 1))
        for topic, connection in self.connections.items():
            self.assertEqual(connection.msgcount, len(self.messages[topic]))
        # Our own reader takes the folder: it says what it leaves, as of any bag.
        again = json_of(self.bag.parent, "replay", "recording-ros2", "--filter", "pose", "--json")
        self.assertGreater(again["observations"], 100)

    def test_the_bag_explains_itself(self):
        with AnyReader([self.bag]) as reader:
            read = [reader.deserialize(data, connection.msgtype) for connection, _, data in reader.messages()]
        self.assertEqual(len(read), sum(map(len, self.messages.values())))

    def test_odometry_is_the_estimate(self):
        odometry = self.messages["/odom"]
        self.assertGreater(len(odometry), 100)
        self.assertEqual(len(odometry), len(self.estimates))
        start = {time - round(1e9 * float(row["host_s"])) for (time, _), row in zip(odometry, self.estimates)}
        self.assertLessEqual(max(start) - min(start), 1)
        for (time, message), row in zip(odometry, self.estimates):
            is_located = row["position_valid"] == "1"
            self.assertEqual((message.header.frame_id, message.child_frame_id), ("map" if is_located else "odom", "base_link"))
            # Behind the arrival by the delay of the link, and by what is wrong with the clock.
            self.assertLess(abs(time - nanoseconds(message.header)), 1_000_000_000)
            pose, twist = message.pose.pose, message.twist.twist
            self.near(row["x_m"], pose.position.x)
            self.near(row["y_m"], pose.position.y)
            self.near(0.0, math.remainder(float(row["heading_rad"]) - yaw(pose.orientation), math.tau))
            self.near(row["forward_m_per_s"], twist.linear.x)
            self.near(row["turn_rad_per_s"], twist.angular.z)
            for places, matrix in ((POSE_COVARIANCE, message.pose.covariance), (TWIST_COVARIANCE, message.twist.covariance)):
                for column, place in places.items():
                    self.near(row[column], matrix[place], abs(float(row[column])))
                self.assertTrue((matrix.reshape(6, 6) == matrix.reshape(6, 6).T).all())
                measured = {place // 6 for place in places.values()} | {place % 6 for place in places.values()}
                self.assertEqual({matrix[7 * axis] for axis in set(range(6)) - measured}, {UNMEASURED})
        print(f"\n  {len(odometry)} odometry messages, largest difference from estimates.csv {self.worst:.1e}")

    def test_the_pose_is_that_of_the_map_only(self):
        located = [(time, message) for time, message in self.messages["/odom"] if message.header.frame_id == "map"]
        self.assertEqual([time for time, _ in self.messages["/pose"]], [time for time, _ in located])
        for (_, pose), (_, odometry) in zip(self.messages["/pose"], located):
            self.assertEqual(pose.header, odometry.header)
            self.assertEqual(pose.pose.pose, odometry.pose.pose)
            self.assertTrue((pose.pose.covariance == odometry.pose.covariance).all())

    def test_transforms_lead_from_the_map_to_the_robot_and_odom_is_continuous(self):
        poses = {(message.header.stamp.sec, message.header.stamp.nanosec): [] for _, message in self.messages["/pose"]}
        for _, message in self.messages["/pose"]:
            poses[message.header.stamp.sec, message.header.stamp.nanosec].append(message.pose.pose)
        before, jump_m, stamps, located = None, 0.0, [], 0
        for _, message in self.messages["/tf"]:
            stamps.append(nanoseconds(message.transforms[0].header))
            frames = [(one.header.frame_id, one.child_frame_id) for one in message.transforms]
            self.assertIn(frames, ([("odom", "base_link")], [("map", "odom"), ("odom", "base_link")]))
            odometry = plane(message.transforms[-1].transform)
            if len(frames) == 2:
                stamp = message.transforms[0].header.stamp
                x, y, turn = chained(plane(message.transforms[0].transform), odometry)
                differences = [
                    (abs(x - pose.position.x), abs(y - pose.position.y), abs(math.remainder(turn - yaw(pose.orientation), math.tau)))
                    for pose in poses[stamp.sec, stamp.nanosec]]
                self.assertLess(min(map(max, differences)), TOLERANCE)
                located += 1
                if before is not None:
                    jump_m = max(jump_m, math.dist(before[:2], odometry[:2]))
            before = odometry
        self.assertGreater(located, 50)
        self.assertEqual(stamps, sorted(set(stamps)))
        # At 0.2 m/s, a few times per second.
        self.assertLess(jump_m, 0.1)

    def test_the_gyro_says_what_it_does_not_measure(self):
        for _, message in self.messages["/imu"]:
            self.assertEqual(message.header.frame_id, "base_link")
            self.assertEqual((message.orientation_covariance[0], message.linear_acceleration_covariance[0]), (-1.0, -1.0))
        self.assertGreater(max(abs(message.angular_velocity.z) for _, message in self.messages["/imu"]), 0.1)

    def test_diagnostics_count_frames(self):
        links = [status for _, message in self.messages["/diagnostics"] for status in message.status if status.values]
        counts = [int({pair.key: pair.value for pair in status.values}["frames_in"]) for status in links]
        self.assertEqual(counts, sorted(counts))
        self.assertGreater(counts[-1], 100)
        self.assertEqual({status.name for status in links}, {"posebridge: link 0"})

    def test_the_bag_beside_a_run_is_that_of_its_recording(self):
        with Reader(pathlib.Path(finished_drive()) / "run" / "recording-ros2.mcap") as live, Reader(self.path) as exported:
            pairs = zip(live.messages(), exported.messages(), strict=True)
            for (ours, at, data), (theirs, then, again) in pairs:
                self.assertEqual((ours.topic, at, bytes(data)), (theirs.topic, then, bytes(again)))


# The robot's clock as a date, and what a message takes to the recorder.
START_S = 1_700_000_000
DELAY_NS = 4_000_000
RADIUS_M, TRACK_M = 0.028, 0.112
NOISE = ("--set", "noise.fix_position_m=0.005", "--set", "noise.fix_heading_rad=0.0175")


class ForeignBag(unittest.TestCase):
    """The wheels, the gyro and the fixes of a drive as a driver of ROS would have recorded them: its own odometry, in zstd."""

    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = folder.name
        posebridge(finished_drive(), "export", "run/recording.mcap", "--format", "csv,tum", "--out", cls.folder)
        cls.store = get_typestore(Stores.ROS2_JAZZY)
        truth = map(str.split, (pathlib.Path(cls.folder) / "truth.tum").read_text().splitlines())
        cls.truth = [(float(t), float(x), float(y), 2.0 * math.atan2(float(qz), float(qw))) for t, x, y, _, _, _, qz, qw in truth]
        cls.fixes = [tuple(float(row[key]) for key in ("t_s", "x_m", "y_m", "heading_rad")) for row in cls.rows("fix")]
        cls.odometry, cls.messages = [], []
        cls.add_odometry()
        for row in cls.rows("turn_rate"):
            cls.add("/imu/data", "sensor_msgs/msg/Imu", float(row["t_s"]), "imu_link", cls.rotation(0.0), numpy.zeros(9), cls.vector(
                0.0, 0.0, float(row["turn_rad_per_s"])), numpy.zeros(9), cls.vector(0.0, 0.0, 9.81), numpy.zeros(9))
        for t, x, y, heading in cls.fixes:
            cls.add("/camera/pose", "geometry_msgs/msg/PoseStamped", t, "map", cls.pose(x, y, heading))
        for t, x, y, heading in cls.truth:
            cls.add("/ground_truth/pose", "geometry_msgs/msg/PoseStamped", t, "map", cls.pose(x, y, heading))
        cls.write("drive", CompressionMode.STORAGE)
        cls.write("plain", None)

    @classmethod
    def rows(cls, name):
        with open(os.path.join(cls.folder, f"{name}.csv"), newline="") as file:
            return list(csv.DictReader(file))

    @classmethod
    def make(cls, name, *fields):
        return cls.store.types[name](*fields)

    @classmethod
    def vector(cls, *numbers):
        return cls.make("geometry_msgs/msg/Vector3", *numbers)

    @classmethod
    def rotation(cls, heading):
        return cls.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))

    @classmethod
    def pose(cls, x, y, heading):
        return cls.make("geometry_msgs/msg/Pose", cls.make("geometry_msgs/msg/Point", x, y, 0.0), cls.rotation(heading))

    @classmethod
    def add(cls, topic, kind, t, frame, *fields):
        stamp = round(t * 1e9) + START_S * 1_000_000_000
        time = cls.make("builtin_interfaces/msg/Time", stamp // 1_000_000_000, stamp % 1_000_000_000)
        message = cls.make(kind, cls.make("std_msgs/msg/Header", time, frame), *fields)
        cls.messages.append((stamp + DELAY_NS, topic, kind, message))

    @classmethod
    def add_odometry(cls):
        x = y = heading = 0.0
        last = None
        for row in cls.rows("wheel_angles"):
            t, left, right = (float(row[key]) for key in ("t_s", "left_rad", "right_rad"))
            way = turn = speed = rate = 0.0
            if last is not None and t > last[0]:
                way = RADIUS_M * (left - last[1] + right - last[2]) / 2
                turn = RADIUS_M * (right - last[2] - left + last[1]) / TRACK_M
                speed, rate = way / (t - last[0]), turn / (t - last[0])
            x, y, heading = x + way * math.cos(heading + turn / 2), y + way * math.sin(heading + turn / 2), heading + turn
            last = (t, left, right)
            cls.odometry.append((t, x, y, heading))
            cls.add(
                "/odom", "nav_msgs/msg/Odometry", t, "odom", "base_link",
                cls.make("geometry_msgs/msg/PoseWithCovariance", cls.pose(x, y, heading), numpy.zeros(36)),
                cls.make("geometry_msgs/msg/TwistWithCovariance", cls.make(
                    "geometry_msgs/msg/Twist", cls.vector(speed, 0.0, 0.0), cls.vector(0.0, 0.0, rate)), numpy.zeros(36)))

    @classmethod
    def write(cls, name, compression):
        writer = Writer(pathlib.Path(cls.folder) / name, version=9, storage_plugin=StoragePlugin.MCAP)
        if compression:
            writer.set_compression(compression, CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for log, topic, kind, message in sorted(cls.messages, key=lambda one: one[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=cls.store)
                writer.write(connections[topic], log, cls.store.serialize_cdr(message, kind))

    def rms_to_truth(self, path):
        """Of a path without a gap, at the times of the truth."""
        times, xs, ys = (numpy.array(column) for column in list(zip(*path))[:3])
        squares = [
            (numpy.interp(t, times, xs) - x) ** 2 + (numpy.interp(t, times, ys) - y) ** 2
            for t, x, y, _ in self.truth if times[0] <= t <= times[-1]]
        return math.sqrt(sum(squares) / len(squares))

    def test_a_bag_of_rosbags_is_fused_and_better_than_its_odometry_and_its_fixes(self):
        odometry = self.rms_to_truth(self.odometry)
        self.assertGreater(odometry, 0.01)
        replayed = json_of(self.folder, "replay", "drive", "--filter", "pose", *NOISE, "--json")
        fused = replayed["estimators"][0]["position_rms_m"]
        print(f"\n  odometry {1000 * odometry:.1f} mm rms, fused {1000 * fused:.1f} mm")
        self.assertLess(fused, odometry / 3)
        self.assertLess(fused, 0.012)

    def test_an_imported_bag_has_every_message_once_and_replays(self):
        counts = collections.Counter(topic for _, topic, _, _ in self.messages)
        posebridge(self.folder, "import", "drive", "--out", "imported.mcap", *NOISE)
        found = json_of(self.folder, "inspect", "imported.mcap", "--json")["recording"]
        # Of the truth there is none in a recording.
        self.assertEqual(found["inputs"], counts["/odom"] + counts["/imu/data"] + counts["/camera/pose"])
        self.assertEqual(found["utc_start_micros"] // 1_000_000, START_S + int(min(self.fixes[0][0], self.odometry[0][0])))
        posebridge(self.folder, "export", "imported.mcap", "--format", "tum", "--out", "out")
        lines = (pathlib.Path(self.folder) / "out" / "estimate.tum").read_text().splitlines()
        estimates = [tuple(map(float, line.split()[:3])) for line in lines]
        offset = START_S - found["utc_start_micros"] / 1e6
        rms = self.rms_to_truth([(t - offset, x, y) for t, x, y in estimates])
        print(f"\n  imported and fused: {1000 * rms:.1f} mm rms")
        self.assertLess(rms, 0.015)

    def test_compression_folder_and_file_change_nothing(self):
        (file,) = (pathlib.Path(self.folder) / "plain").glob("*.mcap")
        results = []
        for name in ("drive", "plain", str(file)):
            (one,) = json_of(self.folder, "replay", name, "--filter", "pose", *NOISE, "--json")["estimators"]
            # It is told by the name of the bag.
            results.append({**one, "calibration": None})
        self.assertEqual(results[0], results[1])
        self.assertEqual(results[1], results[2])


if __name__ == "__main__":
    unittest.main()
