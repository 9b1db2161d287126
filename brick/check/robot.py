"""A robot's program around the MicroPython module, its board replaced by lines as in robot.c: tests/bricks/sdk.rs drives it.

python3 brick/check/robot.py brick/micropython
"""

import sys

sys.path.insert(0, sys.argv[1])
import posebridge_brick as brick  # noqa: E402


def main():
    sent = bytearray()
    link = brick.Link(sent.extend)
    receiver, gyro, shown = brick.Receiver(link), brick.Gyro(), (0, 0, 0, 0)
    for count, line in enumerate(sys.stdin):
        now_us, left, right, rate, digits = line.split()
        now_us = int(now_us)
        for pose in receiver.feed(bytes.fromhex(digits.strip("-")), now_us):
            milli = [int(number * 1000) for number in (pose.x_m, pose.y_m, pose.heading_rad)]
            shown = (*milli, pose.flags)
        gyro.sample(now_us, int(rate))
        if count % 250 == 0:
            link.description((0.0325, 0.0325), 0.15, 1440, (0.0009, 0), b"robot in Python")
        if count % 50 == 0:
            link.heartbeat()
        link.wheel_ticks(now_us, int(left), int(right))
        link.inertial(*gyro.take())
        print(sent.hex(), *shown, flush=True)
        sent[:] = b""


if __name__ == "__main__":
    main()
