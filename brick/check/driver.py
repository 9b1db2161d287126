"""Answers the commands of brick/vectors by the MicroPython module: a line in, a line out. brick/rust/tests runs it.

python3 brick/check/driver.py brick/micropython < commands          (the argument is where the module lies)

It runs under CPython and, its lines given by run_micropython.mjs, under MicroPython.
"""

import struct
import sys

if len(sys.argv) > 1:
    sys.path.insert(0, sys.argv[1])
import posebridge_brick as brick  # noqa: E402


def hexed(data):
    return "".join(["%02x" % byte for byte in data])


def unhexed(text):
    return bytes([int(text[place : place + 2], 16) for place in range(0, len(text), 2)])


def of_bits(text):
    return struct.unpack("<f", struct.pack("<I", int(text, 16)))[0]


def bits(number):
    return "%08x" % struct.unpack("<I", struct.pack("<f", number))[0]


def pose_text(pose):
    numbers = [pose.x_m, pose.y_m, pose.heading_rad, pose.forward_speed_m_per_s, pose.turn_rate_rad_per_s]
    numbers = " ".join([bits(number) for number in numbers + list(pose.covariance)])
    return "pose %d %s %d %d %d %d" % (
        pose.time_us, numbers, pose.fix_age_ms, pose.reset_counter, pose.flags, pose.epoch)


def receive(words, chunk):
    found = []
    link = brick.Link(lambda frame: found.append("answer " + hexed(frame)), int(words[1]), int(words[2]))
    receiver = brick.Receiver(link)
    data = unhexed(words[3])
    for place in range(0, len(data), chunk):
        found += [pose_text(pose) for pose in receiver.feed(data[place : place + chunk], int(words[0]))]
    return " ".join(found) or "nothing"


def description(link, words):
    numbers = [of_bits(word) for word in words[:6]]
    name = b"" if words[6] == "-" else unhexed(words[6])
    link.description(numbers[:2], numbers[2], numbers[3], numbers[4:6], name)


def gyro(link, numbers):
    now_us = numbers[0]
    summed = brick.Gyro()
    for place in range(1, len(numbers), 2):
        now_us += numbers[place]
        summed.sample(now_us, numbers[place + 1])
    link.inertial(*summed.take())


def answer(line):
    words = line.split()
    if words[0] == "receive":
        return receive(words[1:], 1)
    if words[0] == "chunks":
        return receive(words[2:], int(words[1]))
    sent = []
    link = brick.Link(lambda frame: sent.append(hexed(frame)), int(words[2]), int(words[3]))
    link.sequence = int(words[1])
    if words[0] == "description":
        description(link, words[4:])
        return "".join(sent)
    numbers = [int(word) for word in words[4:]]
    if words[0] == "heartbeat":
        link.heartbeat()
    elif words[0] == "wheel_ticks":
        link.wheel_ticks(*numbers)
    elif words[0] == "inertial":
        link.inertial(numbers[0], numbers[1], numbers[2], numbers[5], numbers[3:5])
    elif words[0] == "battery":
        link.battery(*numbers)
    elif words[0] == "gyro":
        gyro(link, numbers)
    return "".join(sent)


def main():
    for line in sys.stdin:
        if line.strip():
            print(answer(line))


if __name__ == "__main__":
    main()
