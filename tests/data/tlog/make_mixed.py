"""Writes mixed.tlog and mixed.expected.json with pymavlink 2.4.50 (see README.md): python3 make_mixed.py"""
import json
import os
import struct

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v10 import ardupilotmega as v1
from pymavlink.dialects.v20 import ardupilotmega as v2

START = 1_700_000_000_000_000  # microseconds since 1970
robot = v2.MAVLink(None, srcSystem=1, srcComponent=1)
station = v2.MAVLink(None, srcSystem=255, srcComponent=190)
radio = v1.MAVLink(None, srcSystem=51, srcComponent=68)

out, by_message, by_source, by_version, frames, outside, last = b"", {}, {}, {}, 0, 0, None


def record(micros, link, message):
    global out, frames, last
    raw = message.pack(link)
    link.seq = (link.seq + 1) % 256
    last = START + micros
    out += struct.pack(">Q", last) + raw
    frames += 1
    version = "2" if raw[0] == 0xFD else "1"
    name = message.get_type() if hasattr(message, "get_type") else message.name
    for counts, key in ((by_message, name), (by_source, f"{link.srcSystem}/{link.srcComponent}"), (by_version, version)):
        counts[key] = counts.get(key, 0) + 1


def outside_bytes(data):
    global out, outside
    out += data
    outside += len(data)


for step in range(40):
    micros = step * 100_000
    record(micros, robot, robot.attitude_encode(step * 100, 0.01 * step, 0.0, 0.5, 0.0, 0.0, 0.1))
    record(micros + 200, robot, robot.ahrs_encode(0.001, 0.0, 0.0, 1.0, 0.0, 0.1, 0.2))  # of ardupilotmega
    if step % 10 == 0:
        record(micros + 400, robot, robot.heartbeat_encode(10, 3, 0, 0, 4))
        record(micros + 500, station, station.heartbeat_encode(6, 8, 0, 0, 4))
        record(micros + 600, radio, radio.radio_encode(180, 170, 100, 50, 60, 0, 0))  # MAVLink 1, of ardupilotmega
    if step == 12:
        robot.seq = (robot.seq + 3) % 256  # three frames were lost
    if step == 20:  # a record whose frame was torn
        torn = struct.pack(">Q", START + micros + 700) + robot.attitude_encode(9, 1, 2, 3, 4, 5, 6).pack(robot)
        outside_bytes(torn[:21])
    if step == 25:  # noise with start bytes in it
        outside_bytes(bytes([0xFD, 0x09, 0x00, 0xFE, 0x07, 0x33, 0xFD, 0xFD, 0x00, 0x12, 0xFE]))
outside_bytes(struct.pack(">Q", START + 5_000_000) + b"\xfd\x1c\x00\x00")

here = os.path.dirname(os.path.abspath(__file__))
with open(os.path.join(here, "mixed.tlog"), "wb") as file:
    file.write(out)
expected = {
    "file": "mixed.tlog",
    "bytes": len(out),
    "valid_frames": frames,
    "bytes_outside_valid_frames": outside,
    "by_version": by_version,
    "by_source": by_source,
    "seq_missing_by_source": {"1/1": 3, "255/190": 0, "51/68": 0},
    "first_ts_us": START,
    "last_ts_us": last,
    "non_monotonic_ts": 0,
    "by_message": by_message,
}
with open(os.path.join(here, "mixed.tlog.expected.json"), "w") as file:
    json.dump(expected, file, indent=1)
    file.write("\n")
