#!/usr/bin/env python3
"""Makes vectors.txt: the bytes that every brick SDK must make and understand.

They come from a foreign implementation: the Python that pymavlink's generator (mavgen) makes of
protocol/definitions/posebridge.xml, and for HEARTBEAT and BATTERY_STATUS the common dialect that pymavlink ships. The
TIMESYNC there has no address of the one who is asked yet, so its definition with that address stands below and goes through mavgen, too.
Nothing of this project encodes a byte here. Sums over gyro samples are exact fractions.

    python3 -m venv venv && venv/bin/pip install -r brick/vectors/requirements.txt
    venv/bin/python brick/vectors/make.py > brick/vectors/vectors.txt

README.md beside this file says how a line is read.
"""

import importlib.util
import math
import os
import struct
import sys
import tempfile
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path

os.environ["MAVLINK20"] = "1"
from pymavlink.dialects.v20 import common  # noqa: E402
from pymavlink.generator import mavgen  # noqa: E402

DEFINITION = Path(__file__).resolve().parents[2] / "protocol/definitions/posebridge.xml"
U32 = 0xFFFF_FFFF
I32_MAX, I32_MIN = 2**31 - 1, -(2**31)
# A gyro's rates are cut off there, in microradians per second: the largest that PB_INERTIAL.turn_rate has.
LARGEST_RATE = 16_383_500
# Flags of the incompatible kind: 1 says that a signature follows.
SIGNED = 1


# TIMESYNC of MAVLink's common.xml with its extension fields.
TIMESYNC = """<?xml version="1.0"?>
<mavlink>
  <messages>
    <message id="111" name="TIMESYNC">
      <description>Time synchronization.</description>
      <field type="int64_t" name="tc1">0 in a question, the answerer's time otherwise.</field>
      <field type="int64_t" name="ts1">The questioner's time.</field>
      <extensions/>
      <field type="uint8_t" name="target_system">Who is asked; 0 for all.</field>
      <field type="uint8_t" name="target_component">Who is asked; 0 for all.</field>
    </message>
  </messages>
</mavlink>
"""


def generated(definition):
    """A dialect as mavgen's Python."""
    with tempfile.TemporaryDirectory() as folder:
        name = Path(definition).stem
        target = Path(folder) / name
        options = mavgen.Opts(str(target), wire_protocol="2.0", language="Python3", validate=False)
        stdout, sys.stdout = sys.stdout, sys.stderr
        try:
            mavgen.mavgen(options, [str(definition)])
        finally:
            sys.stdout = stdout
        spec = importlib.util.spec_from_file_location(name, f"{target}.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module


def generated_timesync():
    """The TIMESYNC above; its CRC_EXTRA, which leaves extensions out, must be that of pymavlink's own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "timesync.xml"
        path.write_text(TIMESYNC)
        module = generated(path)
    assert module.MAVLink_timesync_message.crc_extra == common.MAVLink_timesync_message.crc_extra
    return module


own = generated(DEFINITION)
clock = generated_timesync()


def bits(value):
    """A single precision number by its bits."""
    return f"{struct.unpack('<I', struct.pack('<f', value))[0]:08x}"


def from_bits(text):
    return struct.unpack("<f", struct.pack("<I", int(text, 16)))[0]


class Sender:
    """One participant: mavgen's encoder with its sequence number."""

    def __init__(self, module, system, component):
        self.mavlink = module.MAVLink(None, srcSystem=system, srcComponent=component)

    def frame(self, message, sequence=0):
        self.mavlink.seq = sequence
        return bytes(message.pack(self.mavlink))


def line(command, arguments, result):
    print(" ".join([command, *map(str, arguments)]), "=", *result)


def sent(sender, command, arguments, result):
    """What a brick sends: sequence, system, component, then the arguments."""
    sequence, system, component = sender
    line(command, [sequence, system, component, *arguments], [result.hex()])


def packed(module, sender, message):
    sequence, system, component = sender
    return Sender(module, system, component).frame(message, sequence)


def heartbeats():
    print("\n# heartbeat <sequence> <system> <component>: a ground rover, generic autopilot, active")
    for sender in [(0, 1, 1), (1, 1, 1), (255, 254, 200), (253, 42, 7)]:
        message = common.MAVLink_heartbeat_message(10, 0, 0, 0, 4, 3)
        sent(sender, "heartbeat", [], packed(common, sender, message))


def batteries():
    print("\n# battery <..> <millivolts> <percent, -1: unknown>")
    unknown = 65535
    for index, (millivolts, percent) in enumerate([(7910, 80), (6200, 0), (65534, 100), (0, -1)]):
        sender = (index, 1, 1)
        message = common.MAVLink_battery_status_message(
            0, 1, 0, 32767, [millivolts] + [unknown] * 9, -1, -1, -1, percent)
        sent(sender, "battery", [millivolts, percent], packed(common, sender, message))


def wheel_ticks():
    print("\n# wheel_ticks <..> <time_us> <left> <right> <flags>")
    cases = [
        (0, 0, 0, 0),
        (0, 0, 0, 3),
        (1_000_000, 360, -360, 3),
        (U32, I32_MAX, I32_MIN, 3),
        (0x8000_0000, -1, -1, 3),
        (20_000, 256, 0, 0),
        (20_000, 1, 0, 0),
        (0xFD, 0xFD, 0xFD, 1),
        (123_456_789, -123_456, 654_321, 2),
    ]
    for index, case in enumerate(cases):
        sender = ((250 + index) % 256, 1, 1)
        message = own.MAVLink_pb_wheel_ticks_message(*case)
        sent(sender, "wheel_ticks", case, packed(own, sender, message))


def inertials():
    print("\n# inertial <..> <time_us> <turn_urad> <turn_rate> <accel_left> <accel_right> <valid>")
    cases = [
        (0, 0, 0, 0, 0, 0),
        (20_000, 3_141_593, 200, 0, 0, 3),
        (40_000, -3_141_593, -200, 981, -981, 7),
        (U32, I32_MAX, 32_767, 32_767, 32_767, 7),
        (U32, I32_MIN, -32_768, -32_768, -32_768, 7),
        (60_000, 17, 0, 0, 0, 0),
        (60_000, 0, 0, 0, -1, 4),
    ]
    for index, case in enumerate(cases):
        sender = ((7 + index) % 256, 1, 1)
        message = own.MAVLink_pb_inertial_message(*case)
        sent(sender, "inertial", case, packed(own, sender, message))


def descriptions():
    print("\n# description <..> <left radius> <right radius> <track> <ticks per turn> <gyro sigma> <gyro resolution>: bits of")
    print("# single precision numbers; then <name> as hexadecimal bytes, a minus for an empty one")
    cases = [
        ((0.028, 0.028, 0.112, 360.0, 0.0175, 0.0175), b"NXT"),
        ((0.0325, 0.0325, 0.15, 1440.0, 0.005, 0.0), b""),
        ((0.028, 0.028, 0.112, 360.0, 0.0, 0.0), "sechzehn bytes!!".encode()),
        ((0.021600000560283661, 0.0216, 0.105, 360.0, 0.01, 0.001), "Käthe".encode()),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), b""),
    ]
    for index, (numbers, name) in enumerate(cases):
        sender = (100 + index, 1, 1)
        message = own.MAVLink_pb_robot_description_message(*numbers, name)
        arguments = [*map(bits, numbers), name.hex() or "-"]
        sent(sender, "description", arguments, packed(own, sender, message))


def pose_frame(numbers, rest, sequence=0, peer=(1, 197)):
    """An estimate from the station: numbers are x, y, heading, both speeds; rest is what comes around them."""
    time_us, covariance, fix_age_ms, reset_counter, flags, *epoch = rest
    message = own.MAVLink_pb_planar_pose_message(
        time_us, *numbers, covariance, fix_age_ms, reset_counter, flags, *epoch
    )
    return Sender(own, *peer).frame(message, sequence)


def pose_result(numbers, rest):
    time_us, covariance, fix_age_ms, reset_counter, flags, *epoch = rest
    floats = [bits(number) for number in [*numbers, *covariance]]
    return ["pose", time_us, *floats, fix_age_ms, reset_counter, flags, *(epoch or [0])]


USUAL = ((1.25, -0.5, 1.5707963, 0.2, -0.1), (5_000_000, [1e-4, 1e-6, -2e-5, 1e-4, 3e-5, 4e-4], 40, 0, 7))


def received(now_us, address, frame, result):
    line("receive", [now_us, *address, frame.hex()], result)


def poses():
    print("\n# receive <now_us> <system> <component> <bytes>: what the receiver of that address makes of them")
    cases = [
        USUAL,
        ((0.0,) * 5, (0, [0.0] * 6, 0, 0, 0)),
        ((-3.5, 1e-3, -math.pi, 3.4e38, -3.4e38), (U32, [3.4e38] * 6, 65_535, 255, 255)),
        ((0.001, 0.0, 0.0, 0.0, 0.0), (1, [0.0] * 6, 0, 0, 0)),
        ((1.0, 2.0, 3.0, -0.0, 1e-40), (253, [1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 65_534, 1, 31)),
        ((1.0, 2.0, 3.0, 4.0, 5.0), (9, [1.0] * 6, 7, 2, 7, 1)),
        ((1.0, 2.0, 3.0, 4.0, 5.0), (9, [1.0] * 6, 7, 2, 7, U32)),
    ]
    for index, (numbers, rest) in enumerate(cases):
        received(0, (1, 1), pose_frame(numbers, rest, index * 63 % 256), pose_result(numbers, rest))


def time_request(peer, tc1, ts1, target, sequence=0):
    message = clock.MAVLink_timesync_message(tc1, ts1, *target)
    return Sender(clock, *peer).frame(message, sequence)


def time_answer(own_address, now_us, ts1, peer):
    """The brick's clock in nanoseconds; never 0, which would be a question."""
    message = clock.MAVLink_timesync_message(max(1, now_us * 1000), ts1, *peer)
    return Sender(clock, *own_address).frame(message)


def time_requests():
    print("\n# questions for the time, and the answer as the brick's first frame")
    cases = [
        (1_000_000, 123_456_789_012, (0, 0), (1, 197)),
        (0, 1, (0, 0), (1, 197)),
        (U32, 2**63 - 1, (1, 1), (255, 190)),
        (65_535, -(2**63), (1, 0), (1, 197)),
        (65_536, 0, (0, 1), (1, 197)),
        (4_000_000_000, 0xFD_FD_FD_FD, (0, 0), (254, 253)),
    ]
    for now_us, ts1, target, peer in cases:
        answer = time_answer((1, 1), now_us, ts1, peer)
        received(now_us, (1, 1), time_request(peer, 0, ts1, target), ["answer", answer.hex()])
    print("# an answer to somebody, a question for another system, one for another component of ours")
    received(5, (1, 1), time_request((1, 197), 77, 5, (1, 1)), ["nothing"])
    received(5, (1, 1), time_request((1, 197), 0, 5, (2, 1)), ["nothing"])
    received(5, (1, 1), time_request((1, 197), 0, 5, (1, 2)), ["nothing"])


def changed(frame, place, mask):
    bytes_ = bytearray(frame)
    bytes_[place] ^= mask
    return bytes(bytes_)


def nan_pose(place):
    numbers = list(USUAL[0])
    numbers[place] = (float("nan"), float("inf"), -float("inf"))[place % 3]
    return pose_frame(numbers, USUAL[1])


def signed_pose():
    """The usual estimate with a signature that mavgen's code made of the key 0, 1, 2 .. 31."""
    sender = own.MAVLink(None, srcSystem=1, srcComponent=197)
    sender.signing.sign_outgoing = True
    sender.signing.secret_key = bytes(range(32))
    sender.signing.link_id = 1
    sender.signing.timestamp = 1_000_000
    numbers, (time_us, covariance, age, reset, flags) = USUAL
    message = own.MAVLink_pb_planar_pose_message(time_us, *numbers, covariance, age, reset, flags)
    frame = bytes(message.pack(sender))
    assert frame[2] == SIGNED and len(frame) == 52 + 12 + 13, "this is no signed frame"
    return frame


def damaged_and_foreign():
    usual, good = pose_frame(*USUAL), pose_result(*USUAL)
    ticks = Sender(own, 1, 1).frame(own.MAVLink_pb_wheel_ticks_message(1, 2, 3, 3))
    heartbeat = Sender(common, 1, 197).frame(common.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    print("# other messages, noise, torn and damaged frames before a whole one; a signature behind it")
    received(0, (1, 1), heartbeat + ticks + usual, good)
    received(0, (1, 1), bytes([0xFD] * 9) + usual, good)
    received(0, (1, 1), bytes(range(256)) + usual, good)
    received(0, (1, 1), usual[:-1] + usual, good)
    received(0, (1, 1), usual[:20] + usual, good)
    received(0, (1, 1), usual[:3] + usual, good)
    received(0, (1, 1), changed(usual, 30, 0x10) + usual, good)
    received(0, (1, 1), changed(usual, 1, 0x01) + usual, good)
    received(0, (1, 1), changed(usual, -1, 0x80) + usual + heartbeat, good)
    received(0, (1, 1), signed_pose() + heartbeat, good)
    print("# a flag that nobody knows, a number that is none, a length that is none")
    received(0, (1, 1), resealed(usual, 2, 2), ["nothing"])
    for place in range(5):
        received(0, (1, 1), nan_pose(place), ["nothing"])
    received(0, (1, 1), resealed(usual[:10] + usual[-2:], 1, 0), ["nothing"])
    print("# ids that differ from ours in one byte")
    for place in (7, 8, 9):
        received(0, (1, 1), resealed(usual, place, usual[place] ^ 1), ["nothing"])
    print("# several at once: each in its turn")
    ask = time_request((1, 197), 0, 99, (0, 0), 1)
    answer = time_answer((1, 1), 10, 99, (1, 197))
    received(10, (1, 1), usual + ask, [*good, "answer", answer.hex()])
    received(10, (1, 1), changed(usual, 12, 0xFF)[:40] + ask + usual, ["answer", answer.hex(), *good])


def resealed(frame, place, value):
    """A frame with one byte of its header changed and a checksum that fits: a receiver must leave it alone."""
    frame = bytearray(frame)
    frame[place] = value
    crc = own.x25crc(frame[1:-2])
    crc.accumulate(struct.pack("B", own.MAVLink_pb_planar_pose_message.crc_extra))
    return bytes(frame[:-2]) + struct.pack("<H", crc.crc)


def wrapped(value):
    return (value + 2**31) % 2**32 - 2**31


def gyro_result(samples):
    """Turn in whole microradians, rounded down, and the mean in units of 0.5 mrad/s, halves upwards."""
    samples = [(dt, min(LARGEST_RATE, max(-LARGEST_RATE, rate))) for dt, rate in samples]
    turn = sum(Fraction(rate * dt, 1_000_000) for dt, rate in samples[1:])
    # After 100 samples the mean begins anew.
    latest = samples[(len(samples) - 1) // 100 * 100 :]
    mean = Fraction(sum(rate for _, rate in latest), len(latest) * 500)
    rate = min(32_767, max(-32_768, math.floor(mean + Fraction(1, 2))))
    return wrapped(math.floor(turn)), rate


def gyros():
    print("\n# gyro <..> <first time_us> then pairs <interval_us> <rate in urad/s>: each rate holds since the sample before it")
    cases = [
        (0, [(0, 0)]),
        (1_000, [(0, 17_453), (10_000, 17_453), (10_000, 34_907)]),
        (0, [(0, -1), (1, -1), (1, -1), (1, -1)]),
        (U32 - 15_000, [(0, 250_001), (10_000, -250_001), (10_000, 1), (10_000, 999_999)]),
        (5, [(0, 16_000_000)] + [(100_000, 16_000_000)] * 99),
        (5, [(0, -16_000_000)] + [(100_000, -16_000_000)] * 99),
        (7, [(0, 400)] * 100 + [(20_000, 1_000), (1_000_000, -2_750), (999_999, 16_383_500)]),
        (0, [(0, 249)]),
        (0, [(0, 250)]),
        (0, [(0, -250)]),
        (0, [(0, -251)]),
        (0, [(0, 0), (20_000, 20_000_000), (20_000, 20_000_000), (5, I32_MAX)]),
        (0, [(0, 0), (20_000, -20_000_000), (20_000, I32_MIN), (5, I32_MIN)]),
        (9, [(0, 0), (7_919, -123_457), (9_973, 7), (10_007, -999), (65_537, 5_000_001)]),
    ]
    for index, (start, samples) in enumerate(cases):
        sender = (index, 1, 1)
        end = (start + sum(dt for dt, _ in samples)) & U32
        turn, rate = gyro_result(samples)
        message = own.MAVLink_pb_inertial_message(end, turn, rate, 0, 0, 3)
        flat = [number for sample in samples for number in sample]
        sent(sender, "gyro", [start, *flat], packed(own, sender, message))


def main():
    print("# Bytes that every brick SDK must make and understand. Made by brick/vectors/make.py, never by hand:")
    print(f"# pymavlink {version('pymavlink')} (mavgen, wire protocol 2.0) from protocol/definitions/posebridge.xml; HEARTBEAT")
    print("# and BATTERY_STATUS from pymavlink's own common dialect; TIMESYNC as make.py says. README.md says how a line is read.")
    heartbeats()
    batteries()
    wheel_ticks()
    inertials()
    descriptions()
    poses()
    time_requests()
    damaged_and_foreign()
    gyros()


if __name__ == "__main__":
    main()
