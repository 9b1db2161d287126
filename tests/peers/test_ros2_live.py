"""A station's topics for ROS 2 while it runs. ROBOTIS' zenoh-ros2-sdk, which knows rmw_zenoh's keys and attachments by itself, finds the topics;
rosbags knows the types and their hashes by its own definitions and decodes the messages. The session between them is Zenoh's own for Python."""

import collections
import json
import math
import socket
import tempfile
import threading
import time
import unittest

import numpy
import zenoh
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import attachment, discovery, keyexpr

from drives import simulated
from harness import DEADLINE_S, RunningStation, events_named
from test_ros2 import TOLERANCE, TOPICS, yaw

DOMAIN = 7
ENOUGH = 100


def free_port():
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        return bound.getsockname()[1]


def node_at(endpoint):
    """A session as a node of ROS 2 has it: it knows the router's address only."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/timeout_ms", str(int(1000 * DEADLINE_S)))
    return zenoh.open(config)


class Listener:
    """Keeps all messages by their keys."""

    def __init__(self, session, keys):
        self.samples, self.news = collections.defaultdict(list), threading.Condition()
        self.subscriber = session.declare_subscriber(keys, self._take)

    def _take(self, sample):
        with self.news:
            self.samples[str(sample.key_expr)].append((sample.payload.to_bytes(), sample.attachment.to_bytes()))
            self.news.notify_all()

    def wait_for(self, is_enough):
        deadline = time.monotonic() + DEADLINE_S
        with self.news:
            while not is_enough(self.samples):
                if not self.news.wait(deadline - time.monotonic()):
                    raise AssertionError({key: len(samples) for key, samples in self.samples.items()})
            return {key: list(samples) for key, samples in self.samples.items()}


def station_for_nodes(folder, *arguments):
    """A station with a simulated robot, and where nodes connect to it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    station = RunningStation(
        folder, "station", simulated(folder), f"--ros2={DOMAIN}", "--set", f"ros2.endpoint={endpoint}", "--no-dashboard", *arguments)
    station.wait_for("detected")
    return station, endpoint


class LiveTopics(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = cls.enterClassContext(tempfile.TemporaryDirectory())
        station, endpoint = station_for_nodes(folder)
        cls.addClassCleanup(station.kill)
        with node_at(endpoint) as session:
            listener = Listener(session, f"{DOMAIN}/**")
            cls.samples = listener.wait_for(
                lambda samples: len(samples) == len(TOPICS) and max(map(len, samples.values())) >= ENOUGH)
            replies = session.liveliness().get("@ros2_lv/**", timeout=DEADLINE_S)
            cls.tokens = [str(reply.ok.key_expr) for reply in replies]
        cls.events = station.stop()
        cls.store = get_typestore(Stores.ROS2_JAZZY)

    def messages_of(self, topic):
        (found,) = [samples for key, samples in self.samples.items() if key.split("/")[1] == topic]
        return found

    def test_a_foreign_reader_lists_the_topics_with_types_and_hashes(self):
        endpoints = [discovery._parse_liveliness_keyexpr(token) for token in self.tokens]
        endpoints = [endpoint for endpoint in endpoints if endpoint]
        self.assertEqual({endpoint["domain_id"] for endpoint in endpoints}, {DOMAIN})
        published = {one["qualified_name"]: one for one in endpoints if one["kind"] == "MP"}
        self.assertEqual(set(published), set(TOPICS))
        for topic, kind in TOPICS.items():
            endpoint, expected = published[topic], self.store.hash_rihs01(kind)
            self.assertEqual(discovery.dds_to_ros_type(endpoint["dds_type"]), kind)
            self.assertEqual(endpoint["type_hash"], expected)
            # The key of the messages as that program builds it.
            key = keyexpr.topic_keyexpr(DOMAIN, topic, endpoint["dds_type"], expected)
            self.assertIn(key, self.samples)
        nodes = [token for token in self.tokens if "/NN/" in token]
        self.assertEqual([token.rsplit("/", 1)[1] for token in nodes], ["posebridge"])

    def test_every_message_has_the_next_number_and_its_time(self):
        publishers = set()
        for topic in TOPICS:
            read = [attachment.Attachment.from_bytes(bytes_) for _, bytes_ in self.messages_of(topic[1:])]
            numbers = [one.sequence_id for one in read]
            self.assertEqual(numbers, list(range(numbers[0], numbers[0] + len(numbers))), topic)
            self.assertLess(abs(read[-1].timestamp_ns - time.time_ns()), 600e9)
            publishers.add(read[0].gid)
            self.assertEqual(len({one.gid for one in read}), 1)
        self.assertEqual(len(publishers), len(TOPICS))

    def test_odometry_is_the_estimate(self):
        estimates = events_named(self.events, "estimated")
        odometry = [self.store.deserialize_cdr(bytes_, TOPICS["/odom"]) for bytes_, _ in self.messages_of("odom")]
        self.assertGreaterEqual(len(odometry), ENOUGH)
        # By the last, because at first the robot stands, and its estimates are alike.
        last = odometry[-1].pose.pose.position
        (end,) = [number for number, one in enumerate(estimates) if (one["x_m"], one["y_m"]) == (last.x, last.y)]
        worst = 0.0
        for ours, theirs in zip(estimates[end::-1], odometry[::-1]):
            pose, twist = theirs.pose.pose, theirs.twist.twist
            worst = max(
                worst, abs(ours["x_m"] - pose.position.x), abs(ours["y_m"] - pose.position.y),
                abs(math.remainder(ours["heading_rad"] - yaw(pose.orientation), math.tau)),
                abs(ours["forward_m_per_s"] - twist.linear.x), abs(ours["turn_rad_per_s"] - twist.angular.z))
        self.assertLessEqual(worst, TOLERANCE)
        print(f"\n  {len(odometry)} live odometry messages, largest difference from the events {worst:.1e}")

    def test_transforms_lead_from_the_map_to_the_robot(self):
        for bytes_, _ in self.messages_of("tf"):
            frames = [(one.header.frame_id, one.child_frame_id) for one in self.store.deserialize_cdr(bytes_, TOPICS["/tf"]).transforms]
            self.assertIn(frames, ([("odom", "base_link")], [("map", "odom"), ("odom", "base_link")]))


class Requests(unittest.TestCase):
    def setUp(self):
        folder = self.enterContext(tempfile.TemporaryDirectory())
        self.station, endpoint = station_for_nodes(folder, "--set", "robot.accepts_goals=true")
        self.station.belongs_to(self)
        self.session = self.enterContext(node_at(endpoint))
        self.store = get_typestore(Stores.ROS2_JAZZY)

    def publisher(self, topic, kind):
        """Publishes as a node does, once the station has subscribed."""
        dds = kind.replace("/", "::").replace("::msg::", "::msg::dds_::") + "_"
        key = keyexpr.topic_keyexpr(DOMAIN, topic, dds, self.store.hash_rihs01(kind))
        publisher = self.session.declare_publisher(key)
        deadline = time.monotonic() + DEADLINE_S
        while not publisher.matching_status.matching:
            self.assertLess(time.monotonic(), deadline, f"nobody subscribes to {key}")
        note = attachment.Attachment(sequence_id=1, timestamp_ns=time.time_ns(), gid=bytes(range(16)))
        return lambda message: publisher.put(bytes(self.store.serialize_cdr(message, kind)), attachment=note.to_bytes())

    def make(self, kind, *fields):
        return self.store.types[kind](*fields)

    def vector(self, *numbers):
        return self.make("geometry_msgs/msg/Vector3", *numbers)

    def test_speeds_drive_the_robot(self):
        twist = self.make("geometry_msgs/msg/Twist", self.vector(0.125, 0.0, 0.0), self.vector(0.0, 0.0, -0.25))
        self.publisher("/cmd_vel", "geometry_msgs/msg/Twist")(twist)
        self.station.wait_for("driven by a program: 0.125 m/s, -0.25 rad/s")

    def pose(self, stamp_ns):
        stamp = self.make("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        pose = self.make(
            "geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", 5.0, -0.5, 0.0),
            self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.6, 0.8))
        covariance = numpy.diag([1e-4, 1e-4, 0.0, 0.0, 0.0, 1e-3]).flatten()
        return self.make(
            "geometry_msgs/msg/PoseWithCovarianceStamped", self.make("std_msgs/msg/Header", stamp, "map"),
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance))

    def test_a_pose_is_a_fix_at_its_time(self):
        publish = self.publisher("/pose_fix", "geometry_msgs/msg/PoseWithCovarianceStamped")
        # So far from where the station's own camera sees the robot that this is said after some: then they have arrived. Each fix is a
        # tenth of a second old, and comes after news of the robot.
        started_ns = time.time_ns()
        for count in range(3, 40):
            publish(self.pose(time.time_ns() - 10**8))
            self.station.wait_for("odometry", times=count)
            if "camera 255/191 outside sees it" in self.station.talk():
                break
        sent_s = (time.time_ns() - started_ns) / 1e9
        source = {"system": 255, "component": 191}
        observed = [one for one in events_named(self.station.stop(), "observed") if one["source"] == source]
        self.assertGreaterEqual(len(observed), 5)
        for one in observed:
            self.assertEqual((one["x_m"], one["y_m"]), (5.0, -0.5))
            self.assertAlmostEqual(one["heading_rad"], 2 * math.atan2(0.6, 0.8), delta=TOLERANCE)
        first, last = (one["robot_ns"] for one in (observed[0], observed[-1]))
        self.assertTrue(0.0 < (last - first) / 1e9 < sent_s)


if __name__ == "__main__":
    unittest.main()
