# What a weak robot says to posebridge and hears from it, for MicroPython and Pybricks. Needs struct and nothing else.
#
#     link = Link(write)                          write takes the bytes of one frame
#     link.heartbeat()                            once per second
#     link.battery(millivolts, percent)           once per second or more rarely, if you measure it
#     link.wheel_ticks(time_us, left, right)      10 to 50 times per second: totals, never increments
#     receiver = Receiver(link)
#     for pose in receiver.feed(data, now_us): ...
#     receiver.values.get("end_1")                 (value, time_ms): what the station last predicted for the thermometer temp1,
#                                                 and when, by the robot's clock; it sends none while it cannot tell
#
# A time is the robot's own counter of microseconds, taken when the sensor was read; a clock of milliseconds is multiplied by
# 1000. Left is counter-clockwise. A count or a time may grow beyond 32 bits: it is wrapped here.
#
# MAVLink 2 frames: FD length flags 0 sequence system component id[3] payload[length] crc[2], little-endian; zeros at the end
# of a payload are not sent, one byte always is; CRC-16/MCRF4XX over everything behind FD and then the message's CRC_EXTRA.
# Sources: MAVLink guide, "Packet Serialization"; protocol/definitions/posebridge.xml. brick/vectors holds the bytes that a
# foreign implementation makes of the same numbers.

try:
    import ustruct as struct
except ImportError:
    import struct

# Flags of wheel_ticks. The station drops a message without both.
LEFT, RIGHT, BOTH = 1, 2, 3
# Bits of inertial's valid.
RATE, TURN, ACCELERATIONS = 1, 2, 4

_START = 0xFD
_HEADER = 10
_U32 = 0xFFFFFFFF
# Ids with the hash of each definition that ends its checksum (computed by mavgen).
_HEARTBEAT = (0, 50)
_TIMESYNC = (111, 34)
_BATTERY = (147, 154)
_WHEEL_TICKS = (42100, 170)
_INERTIAL = (42101, 94)
_NAMED_VALUE_FLOAT = (251, 170)
_PLANAR_POSE = (42102, 53)
_ROBOT_DESCRIPTION = (42104, 5)
# What a robot listens to: CRC_EXTRA and the length of the whole payload.
_HEARD = {
    _TIMESYNC[0]: (_TIMESYNC[1], 18),
    _NAMED_VALUE_FLOAT[0]: (_NAMED_VALUE_FLOAT[1], 18),
    _PLANAR_POSE[0]: (_PLANAR_POSE[1], 56),
}
_LONGEST = 56
# A sender that invents names cannot fill the memory.
_MOST_VALUES = 16


def _crc(data, extra):
    crc = 0xFFFF
    for byte in data:
        byte ^= crc & 0xFF
        byte ^= (byte << 4) & 0xFF
        crc = (crc >> 8) ^ (byte << 8) ^ (byte << 3) ^ (byte >> 4)
    byte = extra ^ (crc & 0xFF)
    byte ^= (byte << 4) & 0xFF
    return (crc >> 8) ^ (byte << 8) ^ (byte << 3) ^ (byte >> 4)


def _i32(value):
    value &= _U32
    return value - 0x100000000 if value & 0x80000000 else value


def _clamp(value, low, high):
    return low if value < low else high if value > high else value


class Link:
    """One participant on one link. A robot is component 1 of a system from 1 to 254."""

    def __init__(self, write, system=1, component=1):
        self.write = write
        self.system = system
        self.component = component
        self.sequence = 0

    def heartbeat(self):
        """Says that the robot is there: a ground rover, generic autopilot, active, MAVLink version 3."""
        self._send(_HEARTBEAT, bytes((0, 0, 0, 0, 10, 0, 0, 4, 3)))

    def wheel_ticks(self, time_us, left, right, flags=BOTH):
        """Total counts since power-up, forward positive, read at time_us."""
        self._send(_WHEEL_TICKS, struct.pack("<IiiB", time_us & _U32, _i32(left), _i32(right), flags))

    def inertial(self, time_us, turn_urad, turn_rate, valid=RATE | TURN, accelerations=(0, 0)):
        """Total turn in microradians, mean rate in units of 0.5 mrad/s; forward accelerations at both wheels in mm/s^2."""
        rates = [_clamp(rate, -32768, 32767) for rate in (turn_rate, accelerations[0], accelerations[1])]
        self._send(_INERTIAL, struct.pack("<IihhhB", time_us & _U32, _i32(turn_urad), *rates, valid))

    def description(self, radii_m, track_m, ticks_per_turn, gyro=(0, 0), name=b""):
        """How the robot is built: left and right radius; noise and resolution of the gyro in rad/s; up to 16 bytes of name."""
        numbers = (radii_m[0], radii_m[1], track_m, ticks_per_turn, gyro[0], gyro[1])
        self._send(_ROBOT_DESCRIPTION, struct.pack("<ffffff16s", *numbers, name[:16]))

    def battery(self, millivolts, percent=-1):
        """How full the battery is, once a second or more rarely: all cells together, below 65535; 0 to 100, -1 if unknown."""
        unknown = b"\xff" * 8 + b"\xff\x7f"
        told = struct.pack("<H", millivolts) + b"\xff" * 20 + struct.pack("<BBBb", 0, 1, 0, percent)
        self._send(_BATTERY, unknown + told)

    def answer_time(self, payload, asker, now_us):
        """Answers a question for the time, if it is one and for us."""
        asked = (payload[16] in (0, self.system)) and (payload[17] in (0, self.component))
        if not asked or payload[:8] != bytes(8):
            return
        # Nanoseconds; an answer of 0 would be a question.
        nanos = max(1, (now_us & _U32) * 1000)
        self._send(_TIMESYNC, struct.pack("<II", nanos & _U32, nanos >> 32) + payload[8:16] + asker)

    def _send(self, kind, payload):
        length = len(payload)
        while length > 1 and payload[length - 1] == 0:
            length -= 1
        head = (length, 0, 0, self.sequence, self.system, self.component, kind[0] & 0xFF, kind[0] >> 8, 0)
        self.sequence = (self.sequence + 1) & 0xFF
        summed = bytes(head) + payload[:length]
        self.write(bytes((_START,)) + summed + struct.pack("<H", _crc(summed, kind[1])))


class Gyro:
    """Sums a gyro's samples: total turn, kept exactly, and mean rate since the last message."""

    def __init__(self):
        self.turn_urad = 0
        self.rest = 0  # what is above turn_urad, in millionths of a microradian
        self.sampled_us = None
        self.sum_urad_per_s = 0
        self.samples = 0

    def sample(self, now_us, rate_urad_per_s):
        """The rate at now_us, counter-clockwise positive, in whole microradians per second (a degree per second is 17453).
        Each rate holds since the sample before it; what is turned in a gap of more than a second is unknown and left out."""
        rate = _clamp(rate_urad_per_s, -16383500, 16383500)
        if self.sampled_us is not None:
            interval_us = (now_us - self.sampled_us) & _U32
            if interval_us <= 1000000:
                total = self.rest + rate * interval_us
                self.turn_urad = _i32(self.turn_urad + total // 1000000)
                self.rest = total % 1000000
        self.sampled_us = now_us & _U32
        if self.samples == 100:  # the mean begins anew, as in C, where the sum has 32 bits
            self.sum_urad_per_s = 0
            self.samples = 0
        self.sum_urad_per_s += rate
        self.samples += 1

    def take(self):
        """What inertial() wants: time_us, turn_urad, turn_rate; None if there was no sample since the last call."""
        if self.samples == 0:
            return None
        mean = (self.sum_urad_per_s + 250 * self.samples) // (500 * self.samples)
        self.sum_urad_per_s = 0
        self.samples = 0
        return self.sampled_us, self.turn_urad, mean


class Pose:
    """The station's estimate in the arena: metres, radians and seconds, x east, y north, counter-clockwise positive."""

    def __init__(self, payload):
        self.time_us = struct.unpack("<I", payload[:4])[0]  # the instant for which it holds, on the robot's own clock
        numbers = struct.unpack("<fffffffffff", payload[4:48])
        self.x_m, self.y_m, self.heading_rad, self.forward_speed_m_per_s, self.turn_rate_rad_per_s = numbers[:5]
        self.covariance = numbers[5:]  # of x, y, heading: upper triangle row by row
        self.fix_age_ms, self.reset_counter, self.flags, self.epoch = struct.unpack("<HBBI", payload[48:56])
        # Without their own difference being 0, numbers are infinite or none at all.
        self.is_finite = all(number - number == 0 for number in numbers)

    def position_is_valid(self):
        return self.flags & 1 != 0

    def heading_is_valid(self):
        return self.flags & 2 != 0


class Receiver:
    """Finds estimates and questions for the time in whatever a link delivers. A torn or damaged frame is dropped alone."""

    def __init__(self, link):
        self.link = link
        self.window = b""
        self.values = {}  # by the name of each NAMED_VALUE_FLOAT its newest number and the time of that in milliseconds

    def feed(self, data, now_us):
        """Takes bytes; answers questions for the time by now_us, and returns the estimates that came."""
        poses = []
        for byte in data:
            if byte != _START and not self.window:
                continue
            self.window += bytes((byte,))
            length = self._judge()
            while length is not None:
                self._take(length, now_us, poses)
                start = self.window.find(b"\xfd", max(1, length))
                self.window = self.window[start:] if start >= 0 else b""
                length = self._judge() if self.window else None
        return poses

    def _judge(self):
        """The length of the whole frame that the window begins with, 0 if it is none, None if more bytes are needed."""
        window = self.window
        count = len(window)
        if count > 1 and not 1 <= window[1] <= _LONGEST:
            return 0
        if count > 2 and window[2] > 1:  # the flag of a signature does not stand in the way
            return 0
        if count < _HEADER:
            return None
        heard = _HEARD.get(window[7] | window[8] << 8 | window[9] << 16)
        if heard is None or window[1] > heard[1]:
            return 0
        end = _HEADER + window[1]
        if count < end + 2:
            return None
        is_whole = _crc(window[1:end], heard[0]) == window[end] | window[end + 1] << 8
        return end + 2 if is_whole else 0

    def _take(self, length, now_us, poses):
        if length == 0:
            return
        payload = self.window[_HEADER:length - 2]
        payload += bytes(_LONGEST - len(payload))
        if self.window[7] == _TIMESYNC[0]:
            self.link.answer_time(payload, self.window[5:7], now_us)
            return
        if self.window[7] == _NAMED_VALUE_FLOAT[0]:
            self._take_value(payload)
            return
        pose = Pose(payload)
        if pose.is_finite:
            poses.append(pose)

    def _take_value(self, payload):
        time_ms, value = struct.unpack("<If", payload[:8])
        name = payload[8:18].split(b"\0")[0]
        is_text = all(32 < byte < 127 for byte in name)
        if value - value != 0 or not name or not is_text:
            return
        name = name.decode()
        if name in self.values or len(self.values) < _MOST_VALUES:
            self.values[name] = (value, time_ms)
