"""Makes golden.txt: the messages of tests.rs by rosbags (0.11.9) with its own definitions.

    python3 -m venv venv && venv/bin/pip install rosbags==0.11.9 && venv/bin/python golden.py > golden.txt
"""

import numpy
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


def make(name, *fields):
    package, kind = name.split("/")
    return STORE.types[f"{package}/msg/{kind}"](*fields)


def header(frame):
    return make("std_msgs/Header", make("builtin_interfaces/Time", 1_700_000_000, 123_456_789), frame)


def vector(*numbers):
    return make("geometry_msgs/Vector3", *numbers)


def covariance(size, step):
    return numpy.array([step * index for index in range(size)])


def transform(frame, child):
    value = make("geometry_msgs/Transform", vector(1.5, -0.25, 0.0), TURNED)
    return make("geometry_msgs/TransformStamped", header(frame), child, value)


def status(level, name, message, values):
    pairs = [make("diagnostic_msgs/KeyValue", key, value) for key, value in values]
    return make("diagnostic_msgs/DiagnosticStatus", level, name, message, "", pairs)


TURNED = make("geometry_msgs/Quaternion", 0.0, 0.0, 0.6, 0.8)
LEVEL = make("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
POSE = make("geometry_msgs/Pose", make("geometry_msgs/Point", 1.5, -0.25, 0.0), TURNED)
UNCERTAIN_POSE = make("geometry_msgs/PoseWithCovariance", POSE, covariance(36, 0.5))
TWIST = make("geometry_msgs/Twist", vector(0.25, 0.0, 0.0), vector(0.0, 0.0, -0.5))
UNCERTAIN_TWIST = make("geometry_msgs/TwistWithCovariance", TWIST, covariance(36, 0.25))

MESSAGES = {
    "odometry": ("nav_msgs/Odometry", header("map"), "left/base_link", UNCERTAIN_POSE, UNCERTAIN_TWIST),
    "pose_with_covariance_stamped": ("geometry_msgs/PoseWithCovarianceStamped", header("odom"), UNCERTAIN_POSE),
    "imu": (
        "sensor_msgs/Imu", header("base_link"), LEVEL, covariance(9, 1.0), vector(0.0, 0.0, -0.5), covariance(9, 2.0),
        vector(0.0, 0.0, 9.75), covariance(9, 4.0)),
    "tf_message": ("tf2_msgs/TFMessage", [transform("map", "odom"), transform("odom", "base_link")]),
    "diagnostic_array": ("diagnostic_msgs/DiagnosticArray", header(""), [
        status(2, "posebridge: link 0", "down", [("frames_in", "12"), ("b", "")]),
        status(0, "r\u00f6bot", "", []),
    ]),
}

for label, (name, *fields) in MESSAGES.items():
    package, kind = name.split("/")
    data = bytes(STORE.serialize_cdr(make(name, *fields), f"{package}/msg/{kind}")).hex()
    print(label, len(data) // 2)
    print("\n".join(data[at:at + 128] for at in range(0, len(data), 128)))
