"""Makes the files beside it: packed texts by zstandard and lz4, and bags by rosbags and mcap.

    python3 -m venv venv && venv/bin/pip install rosbags==0.11.9 mcap==1.6.0 zstandard==0.25.0 lz4==4.4.5 && venv/bin/python make_bags.py
"""

import math
import pathlib
import shutil

import lz4.frame
import numpy
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

HERE = pathlib.Path(__file__).parent
STORE = get_typestore(Stores.ROS2_JAZZY)
START = 1_700_000_000_000_000_000


def make(name, *fields):
    package, kind = name.split("/")
    return STORE.types[f"{package}/msg/{kind}"](*fields)


def header(nanos, frame):
    return make("std_msgs/Header", make("builtin_interfaces/Time", nanos // 10**9, nanos % 10**9), frame)


def vector(*numbers):
    return make("geometry_msgs/Vector3", *numbers)


def pose(x, y, heading):
    turn = make("geometry_msgs/Quaternion", 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
    return make("geometry_msgs/Pose", make("geometry_msgs/Point", x, y, 0.0), turn)


def diagonal(size, values):
    matrix = numpy.zeros((size, size))
    for place, value in values.items():
        matrix[place, place] = value
    return matrix.reshape(-1)


def messages():
    """Topic, log time, message: a robot that drives 0.5 m/s and turns 0.1 rad/s, sampled at 10 Hz."""
    for step in range(4):
        at, log = START + step * 100_000_000, START + step * 100_000_000 + 5_000_000
        way, turn = 0.05 * step, 0.01 * step
        covariance = diagonal(6, {0: 0.25, 1: 0.25, 5: 0.0625})
        yield "/odom", log, make(
            "nav_msgs/Odometry", header(at, "odom"), "base_link",
            make("geometry_msgs/PoseWithCovariance", pose(way, 0.0, turn), covariance),
            make("geometry_msgs/TwistWithCovariance", make("geometry_msgs/Twist", vector(0.5, 0.0, 0.0), vector(0.0, 0.0, 0.1)), covariance))
        # Lies on its side: y is up.
        yield "/imu/data", log, make(
            "sensor_msgs/Imu", header(at, "imu_link"), make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0), numpy.zeros(9),
            vector(0.001 * step, 0.1 + 0.001 * step, 0.0), numpy.zeros(9), vector(0.1, 9.8, -0.2), numpy.zeros(9))
        yield "/joint_states", log, make(
            "sensor_msgs/JointState", header(at, ""), ["arm", "wheel_right_joint", "wheel_left_joint"],
            numpy.array([9.0, 1.25 * step, 1.0 * step]), numpy.array([]), numpy.array([]))
        # Stamp zero: the log time counts.
        yield "/marker", log, make("geometry_msgs/PoseStamped", header(0, "map"), pose(1.0 + way, 2.0, math.pi / 2))
        yield "/amcl_pose", log, make(
            "geometry_msgs/PoseWithCovarianceStamped", header(at, "map"), make("geometry_msgs/PoseWithCovariance", pose(way, 0.5, turn), covariance))
        ranges = numpy.array([3.0, 2.0, 1.0 + way if step else math.inf, 2.5, 3.5], dtype=numpy.float32)
        yield "/scan", log, make(
            "sensor_msgs/LaserScan", header(at, "laser"), -1.0, 1.0, 0.5, 0.0, 0.1, 0.1, 10.0, ranges, numpy.array([], dtype=numpy.float32))
        yield "/goal_pose", log, make("geometry_msgs/PoseStamped", header(at, "map"), pose(9.0, 9.0, 0.0))
    yield "/chatter", START, make("std_msgs/String", "hello")


def by_rosbags(name):
    folder = HERE / "bag"
    shutil.rmtree(folder, ignore_errors=True)
    writer = BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, log, message in messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], log, STORE.serialize_cdr(message, kind))
    (written,) = folder.glob("*.mcap")
    written.rename(HERE / name)
    shutil.rmtree(folder)


def by_mcap(name, compression, little):
    with open(HERE / name, "wb") as file:
        writer = Writer(file, compression=compression, chunk_size=2_000)
        writer.start("ros2", "make_bags.py")
        channels = {}
        for topic, log, message in messages():
            kind = message.__msgtype__
            if topic not in channels:
                definition, _ = STORE.generate_msgdef(kind, ros_version=2)
                channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", definition.encode()))
            data = bytes(STORE.serialize_cdr(message, kind, little_endian=little))
            writer.add_message(channels[topic], log, data, log)
        writer.finish()


def compressed(name):
    """The chunks of a recording of posebridge, packed."""
    from mcap.records import Channel, Chunk, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader
    for kind in (CompressionType.ZSTD, CompressionType.LZ4):
        with open(HERE / f"{name}.mcap", "rb") as source, open(HERE / f"{name}-{kind.name.lower()}.mcap", "wb") as file:
            writer = Writer(file, compression=kind, chunk_size=2_000)
            writer.start("", "make_bags.py")
            schemas, channels = {0: 0}, {}
            for record in StreamReader(source).records:
                if isinstance(record, Metadata):
                    writer.add_metadata(record.name, record.metadata)
                elif isinstance(record, Schema) and record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                elif isinstance(record, Channel) and record.id not in channels:
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schemas[record.schema_id], record.metadata)
                elif isinstance(record, Message):
                    writer.add_message(channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence)
            writer.finish()


if __name__ == "__main__":
    text = b"".join(b"record %d of a chunk, " % (number % 7) for number in range(40))
    (HERE / "text.txt").write_bytes(text)
    (HERE / "text.zst").write_bytes(zstandard.ZstdCompressor(level=3, write_checksum=True).compress(text))
    (HERE / "text.lz4").write_bytes(lz4.frame.compress(text, content_checksum=True))
    by_rosbags("rosbags-zstd.mcap")
    by_mcap("big-endian-lz4.mcap", CompressionType.LZ4, False)
    if (HERE / "own.mcap").exists():
        compressed("own")
