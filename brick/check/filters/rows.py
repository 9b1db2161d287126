"""The rows that every filter is run over: a drive, a thermometer, an approach to a wall. All of them simulated from seeds.

Every number is one of single precision, so that all languages start from the same.
"""

import math
import random
import struct

TICK_RAD = 0.01745329252
STEP_S = 0.05


def single(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def row(*values):
    padded = list(values) + [0.0] * (7 - len(values))
    return [single(value) for value in padded]


def drive():
    """Rest, sides of 0.6 m, turns of 90 degrees: dt, rotation of the wheels, accelerations at the wheels, turn rate, sensors that are there.

    Two intervals are longer; accelerometers are silent for a second, and the gyro misses single samples.
    """
    noise = random.Random(1)
    speeds = [(0.0, 0.0)] * 20 + ([(0.3, 0.0)] * 40 + [(0.0, 0.0)] * 4 + [(0.0, 1.0)] * 31 + [(0.0, 0.0)] * 5) * 2
    angles, counts, before = [0.0, 0.0], [0, 0], [0.0, 0.0]
    rows = [row(0, 0, 0, 0.01, -0.02, 0.02, 3)]
    for index, (forward, turn) in enumerate(speeds):
        dt = STEP_S * (2.5 if index in (70, 110) else 1)
        wheels = [forward - 0.0558 * turn, forward + 0.0557 * turn]
        turned, felt = [], []
        for side in (0, 1):
            angles[side] += wheels[side] / 0.028 * dt * (1 + 0.002 * noise.gauss(0, 1))
            counted = math.floor(angles[side] / TICK_RAD)
            turned.append((counted - counts[side]) * TICK_RAD)
            counts[side] = counted
            felt.append((wheels[side] - before[side]) / dt + 0.03 + 0.05 * noise.gauss(0, 1))
        before = wheels
        sensors = (0 if 120 <= index < 140 else 1) + (0 if index % 17 == 5 else 2)
        rows.append(row(dt, *turned, *felt, turn + 0.002 + 0.01 * noise.gauss(0, 1), sensors))
    return rows


def thermometer():
    """From 21 to 3 degrees with 20 s, a sample a second, sixteen steps a kelvin: dt, what is shown."""
    noise = random.Random(2)
    shown = [3 + 18 * math.exp(-at_s / 20) + 0.03 * noise.gauss(0, 1) for at_s in range(150)]
    return [row(1, round(16 * value) / 16) for value in shown]


def wall():
    """2.5 m at PWM 80, and braking: dt, input, whether there is a reading, the reading. One reading is 3.5 sigmas off, just
    outside the gate; one step is long."""
    noise = random.Random(3)
    z, v, rows = 2.5, 0.0, []
    for index in range(260):
        dt = 0.15 if index == 200 else 0.0076 * (1 + 0.2 * noise.random())
        motor = 0.0 if index < 10 else 1.0 if index < 180 else 0.2
        for _ in range(20):
            z -= v * dt / 20
            v += (motor - 0.81633 * v) / 0.35346 * dt / 20
        seen = z + (-0.6 if index == 121 else 0.02 * noise.gauss(0, 1))
        rows.append(row(dt, motor, 1 if index % 11 == 0 else 0, seen))
    return rows
