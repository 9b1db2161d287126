"""rosbags on the ROS 2 bag that we export: it knows the messages by its own definitions, and its figures are those of our tables."""

import collections
import csv
import math
import os
import pathlib
import tempfile
import unittest

from mcap.reader import SeekingReader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from drives import finished_drive
from harness import posebridge

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
        cls.path = pathlib.Path(folder.name) / "recording-ros2.mcap"
        with open(os.path.join(folder.name, "estimates.csv"), newline="") as file:
            rows = list(csv.DictReader(file))
        # A position without a heading is no pose.
        cls.estimates = [row for row in rows if row["position_valid"] == "0" or row["heading_valid"] == "1"]
        cls.store = get_typestore(Stores.ROS2_JAZZY)
        cls.messages = collections.defaultdict(list)
        # Not AnyReader, which would take the definitions in the bag.
        with Reader(cls.path) as reader:
            cls.connections = {one.topic: one for one in reader.connections}
            for connection, time, data in reader.messages():
                cls.messages[connection.topic].append((time, cls.store.deserialize_cdr(data, connection.msgtype)))

    def near(self, ours, theirs, scale=1.0):
        self.worst = max(getattr(self, "worst", 0.0), abs(float(ours) - theirs))
        self.assertAlmostEqual(float(ours), theirs, delta=TOLERANCE * max(1.0, scale))

    def test_every_topic_has_its_type_with_the_hash_of_rosbags_and_a_definition_that_gives_it(self):
        self.assertEqual({topic: one.msgtype for topic, one in self.connections.items()}, TOPICS)
        # rosbags does not look at those of a bag without its metadata.yaml.
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

    def test_the_bag_explains_itself(self):
        with AnyReader([self.path]) as reader:
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


if __name__ == "__main__":
    unittest.main()
