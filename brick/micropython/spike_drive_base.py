# A SPIKE Prime hub with two driven wheels: reports 20 times per second over Bluetooth, hears where it is.
#
# On the computer:  python3 brick/micropython/pybricks_bridge.py spike_drive_base.py     (docs/protocols/boards.md tells the rest)
#
# Nothing may be printed beside the frames: they share the hub's output.

from pybricks.hubs import PrimeHub
from pybricks.parameters import Axis, Direction, Port
from pybricks.pupdevices import Motor
from pybricks.tools import StopWatch, wait
from uselect import poll
from usys import stdin, stdout
from micropython import kbd_intr

import posebridge_brick as brick

# How the robot is built: change these. Both motors must count upwards when the robot is pushed forwards.
LEFT = Motor(Port.A, Direction.COUNTERCLOCKWISE)
RIGHT = Motor(Port.B)
RADII_M = (0.028, 0.028)
TRACK_M = 0.112

PERIOD_MS = 50
URAD_PER_DEG = 17453


def main():
    hub = PrimeHub()
    kbd_intr(-1)  # a byte 3 in a frame is no Ctrl-C
    watch = StopWatch()
    link = brick.Link(stdout.buffer.write)
    receiver = brick.Receiver(link)
    gyro = brick.Gyro()
    keyboard = poll()
    keyboard.register(stdin)
    beat_ms = described_ms = -10000
    sent_ms = 0
    while True:
        now_ms = watch.time()
        # About the axis that points up, counter-clockwise positive; whole microradians per second.
        gyro.sample(now_ms * 1000, int(hub.imu.angular_velocity(Axis.Z) * URAD_PER_DEG))
        while keyboard.poll(0):
            for pose in receiver.feed(stdin.buffer.read(1), watch.time() * 1000):
                steer(hub, pose)
        if now_ms - sent_ms >= PERIOD_MS:
            sent_ms = now_ms
            link.wheel_ticks(watch.time() * 1000, LEFT.angle(), RIGHT.angle())
            link.inertial(*gyro.take())
        if now_ms - beat_ms >= 1000:
            beat_ms = now_ms
            link.heartbeat()
        if now_ms - described_ms >= 5000:
            described_ms = now_ms
            link.description(RADII_M, TRACK_M, 360, (0.0008, 0), b"pybricks-spike")
        wait(2)


def steer(hub, pose):
    """Your robot steers here; pose.time_us says for which instant it holds."""
    if pose.position_is_valid():
        hub.display.number(int(pose.x_m * 100) % 100)
    else:
        hub.display.char("?")  # until the first fix, or a start that somebody gave


main()
