#!/usr/bin/env python3
"""Records the drives of the golden net with a real program over real links; see README.md. Standard library only.

record.py POSEBRIDGE OUT [NAME ...]    writes OUT/NAME.mcap.gz; without names all that stand at the end of this file
"""

import gzip
import hashlib
import json
import os
import random
import re
import select
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request

HERE = os.path.dirname(os.path.abspath(__file__))
KEY = os.path.join(HERE, "recordings", "signed.key")

# A robot that drives a small square quickly, so that a short recording holds turns as well.
SQUARE = """
seed = {seed}
steering = "estimate"
[path.square]
side_m = 0.4
[start]
x_m = {x_m}
[drive]
laps = 1000
rest_s = {rest_s}
[errors]
radius_error = 0.005
radius_error_sigma = 0.0
radius_mismatch = 0.005
radius_mismatch_sigma = 0.0
track_error = -0.02
track_error_sigma = 0.0
"""

THERMOMETER = """
[thermometer]
channel = "temp1"
rate_hz = 10.0
lags_s = [2.0, 8.0]
shares = [0.3, 0.7]
before_c = 20.0
after_c = 48.7
dipped_at_s = 3.0
"""


def scenario(seed=11, x_m=0.0, rest_s=1.0):
    return SQUARE.format(seed=seed, x_m=x_m, rest_s=rest_s)


# Processes


class Program:
    """The program as a process; what it says is kept."""

    def __init__(self, folder, *arguments):
        self.said, self.news = [], threading.Condition()
        self.process = subprocess.Popen(
            [BINARY, *arguments], cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            with self.news:
                self.said.append(line)
                self.news.notify_all()

    def find(self, pattern, count=1):
        """The first so many matches in what it says."""
        deadline = time.monotonic() + 20
        with self.news:
            while len(found := re.findall(pattern, "".join(self.said))) < count:
                if not self.news.wait(deadline - time.monotonic()):
                    raise RuntimeError(f"it did not say {pattern}: {''.join(self.said)}")
        return found[:count]

    def addresses(self, count=1):
        """Where it listens, as (host, port)."""
        found = self.find(r"listening on ([\d.]+:\d+)", count)
        return [(host, int(port)) for host, port in (one.split(":") for one in found)]

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        self.process.wait(30)
        time.sleep(0.1)

    def kill(self):
        self.process.kill()
        self.process.wait(30)


def sim(folder, text, *arguments, listen="tcp://127.0.0.1:0", name="scenario.toml"):
    write(folder, name, text)
    return Program(folder, "sim", name, "--listen", listen, *arguments)


def station(folder, config, *arguments):
    write(folder, "station.toml", config)
    return Program(folder, "run", "--config", "station.toml", "--out", "run", "--no-dashboard", *arguments)


def write(folder, name, text):
    with open(os.path.join(folder, name), "w") as file:
        file.write(text)


# MAVLink 2, as far as it is needed

HEARTBEAT, RADIO_STATUS, TIMESYNC, PARAM_REQUEST_READ, PARAM_REQUEST_LIST, PARAM_SET = 0, 109, 111, 20, 21, 23
COMMAND_LONG, NAMED_VALUE_FLOAT = 76, 251
WHEEL_TICKS = 42100
EXTRA = {HEARTBEAT: 50, RADIO_STATUS: 185, TIMESYNC: 34, 20: 214, 21: 159, 23: 168, COMMAND_LONG: 152, NAMED_VALUE_FLOAT: 170}


def crc(data, value=0xFFFF):
    for byte in data:
        byte ^= value & 0xFF
        byte = (byte ^ (byte << 4)) & 0xFF
        value = (value >> 8) ^ (byte << 8) ^ (byte << 3) ^ (byte >> 4)
    return value


class Frame:
    def __init__(self, system, component, message, payload, extra=None):
        self.system, self.component, self.message = system, component, message
        self.payload = payload.rstrip(b"\0") or b"\0"
        self.extra = EXTRA[message] if extra is None else extra

    @staticmethod
    def split(data):
        """Whole frames of a healthy stream, and what is left of it."""
        frames = []
        while len(data) >= 12 and data[0] == 0xFD:
            size = 12 + data[1] + (13 if data[2] & 1 else 0)
            if len(data) < size:
                break
            payload_end = 10 + data[1]
            checksum = struct.unpack_from("<H", data, payload_end)[0]
            before = crc(data[1:payload_end])
            extra = next(one for one in range(256) if crc(bytes([one]), before) == checksum)
            message = int.from_bytes(data[7:10], "little")
            frames.append(Frame(data[5], data[6], message, data[10:payload_end], extra))
            data = data[size:]
        return frames, data

    def bytes(self, sequence, signed=False):
        head = bytes([len(self.payload), int(signed), 0, sequence & 0xFF, self.system, self.component])
        body = head + self.message.to_bytes(3, "little") + self.payload
        return b"\xFD" + body + struct.pack("<H", crc(body + bytes([self.extra])))

    def sealed(self, sequence, key, link_id, stamp):
        body = self.bytes(sequence, signed=True) + bytes([link_id]) + stamp.to_bytes(6, "little")
        return body + hashlib.sha256(key + body).digest()[:6]


class Voice:
    """The count of each sender on one link."""

    def __init__(self):
        self.counts = {}

    def next(self, frame):
        sender = frame.system, frame.component
        self.counts[sender] = self.counts.get(sender, -1) + 1
        return self.counts[sender]


class Link:
    """A socket that speaks and hears frames."""

    def __init__(self, address, kind="tcp"):
        if kind == "tcp":
            self.socket = socket.create_connection(address)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.connect(address)
        self.voice, self.rest = Voice(), b""

    def fileno(self):
        return self.socket.fileno()

    def say(self, frame):
        self.socket.send(frame.bytes(self.voice.next(frame)))

    def hear(self):
        frames, self.rest = Frame.split(self.rest + self.socket.recv(65536))
        return frames


def until(seconds, links, take, act=lambda elapsed: None):
    """Gives every frame that comes to `take(link, frame)`, for so long."""
    begun = time.monotonic()
    while (elapsed := time.monotonic() - begun) < seconds:
        act(elapsed)
        for link in select.select(links, [], [], 0.005)[0]:
            for frame in link.hear():
                take(link, frame)


class Plan:
    """Deeds at their seconds."""

    def __init__(self, *deeds):
        self.deeds = sorted(deeds, key=lambda deed: deed[0])

    def __call__(self, elapsed):
        while self.deeds and self.deeds[0][0] <= elapsed:
            self.deeds.pop(0)[1]()


# The drives


def kidnap(folder):
    """What people can do to a simulated brick, each once."""
    write(folder, "square.toml", scenario())
    running = Program(folder, "run", "--link", "sim://square.toml", "--out", "run", "--dashboard", "127.0.0.1:0", "--seed", "11")
    page = running.find(r"dashboard: (http://\S+)")[0]

    def command(name, **fields):
        request = urllib.request.Request(
            page + "v1/commands", json.dumps({"command": name, **fields}).encode(), {"Content-Type": "application/json"})
        urllib.request.urlopen(request, timeout=5).read()

    at = lambda secs, name, **fields: (secs, lambda: command(name, **fields))
    until(25, [], None, Plan(
        at(3.0, "kidnap", forward_m=0.3, left_m=-0.4, turn_rad=1.0),
        at(6.0, "slip", wheel="left", factor=1.0, seconds=1.0),
        at(8.0, "camera-delay", delay_ms=4500),
        at(14.0, "camera-delay", delay_ms=80),
        at(15.0, "camera", on=False),
        at(16.0, "camera", on=True),
        at(16.5, "gyro-bias-step", rad_per_s=0.05),
        at(17.0, "pull-cable", seconds=0.8),
        at(18.5, "switch-source", sensor=3, on=False),
        at(19.5, "switch-source", sensor=3, on=True),
        at(20.0, "steering", by="odometry"),
        at(20.5, "steering", by="estimate"),
        at(21.0, "drive", forward_m_per_s=-0.2, turn_rad_per_s=0.0),
        at(22.0, "path"),
        at(22.2, "link-profile", profile="harsh"),
        at(24.0, "link-profile", profile=None)))
    running.stop()


def restart(folder):
    """The brick is switched off and on twice: elsewhere and at once, then where it is, late, and with standard messages."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    running = None
    for number, (x_m, seconds, pause) in enumerate([(0.0, 6.0, 0.3), (0.7, 6.0, 6.0), (0.7, 4.0, 0.0)]):
        wire = '[brick]\nwire = "standard"\n' if number == 2 else ""
        brick = sim(folder, scenario(11 + number, x_m, 0.5) + wire, listen=f"tcp://127.0.0.1:{port}")
        brick.addresses()
        running = running or station(folder, f'[[link]]\nurl = "tcp://127.0.0.1:{port}"\n')
        time.sleep(seconds)
        brick.kill()
        time.sleep(pause)
    running.stop()


def signed(folder):
    """A robot with the right key; others without one, with a wrong one, and with what was said before."""
    shutil.copy(KEY, os.path.join(folder, "signed.key"))
    os.chmod(os.path.join(folder, "signed.key"), 0o600)
    key, wrong = bytes.fromhex(open(KEY).read()), bytes(range(1, 33))
    brick = sim(folder, scenario())
    running = station(folder, '[[link]]\nurl = "udp://127.0.0.1:0"\nlisten = true\nsigning = { key_file = "signed.key", link_id = 3 }\n')
    own, other = Link(running.addresses()[0], "udp"), Link(running.addresses()[0], "udp")
    robot = Link(brick.addresses()[0])
    begun = int((time.time() - 1420070400) * 1e5)
    clock, count, older = [begun], [0], []
    strange = Voice()

    def stamp():
        clock[0] += 1
        return clock[0]

    def of_robot(frame):
        said = frame.sealed(own.voice.next(frame), key, 9, stamp())
        own.socket.send(said)
        older.append(said)
        count[0] += 1
        if count[0] % 25 == 0:
            other.socket.send(frame.sealed(count[0], wrong, 8, stamp()))
        if count[0] % 60 == 0:
            other.socket.send(frame.bytes(count[0]))
        if count[0] % 80 == 0:
            other.socket.send(older[-40])
        if count[0] % 90 == 0:
            other.socket.send(frame.sealed(count[0], key, 20 + count[0] // 90, begun - 12_000_000))
        if count[0] % 100 == 0:
            radio = Frame(51, 68, RADIO_STATUS, struct.pack("<HHBBBBB", 1, 2, 100, 90, 80, 10, 11))
            other.socket.send(radio.bytes(strange.next(radio)))
        # The same reading told twice, in a frame of its own.
        if frame.message == WHEEL_TICKS and count[0] % 7 == 0:
            own.socket.send(frame.sealed(own.voice.next(frame), key, 9, stamp()))

    def take(link, frame):
        if link is robot:
            of_robot(frame)
        elif link is own:
            robot.say(frame)

    until(14, [robot, own, other], take)
    running.stop()
    brick.kill()


def redundant(folder):
    """Two ways to one robot: both lose frames, hold some back, and fall silent once; in the end the wheels' counts leap."""
    brick = sim(folder, scenario())
    way = '[[link]]\nurl = "{}://127.0.0.1:0"\nlisten = true\ngroup = "brick"\n'
    running = station(folder, way.format("udp") + way.format("tcp") + "[filter]\nhistory_s = 0.4\n")
    quick_at, late_at = running.addresses(2)
    quick, late, robot = Link(quick_at, "udp"), Link(late_at), Link(brick.addresses()[0])
    chance, waiting, asked, now = random.Random(5), [], {}, [0.0]

    def passes(link):
        silent = (5.0, 7.5) if link is quick else (9.0, 11.0)
        return not silent[0] <= now[0] < silent[1]

    def say(link, frame):
        data = frame.bytes(link.voice.next(frame))
        if passes(link) and chance.random() > 0.08:
            link.socket.send(data)

    def leap(frame):
        if frame.message == WHEEL_TICKS and now[0] > 12.0:
            stamp, left, right, flags = struct.unpack("<IiiB", frame.payload.ljust(13, b"\0"))
            frame.payload = struct.pack("<IiiB", stamp, left + 50_000, right - 50_000, flags)

    def take(link, frame):
        if link is not robot:
            if frame.message == TIMESYNC:
                asked[frame.payload.ljust(16, b"\0")[8:16]] = link
            if passes(link):
                robot.say(frame)
            return
        leap(frame)
        # An answer goes the way of its question, everything else both ways; some of it takes too long on both.
        to = asked.get(frame.payload.ljust(16, b"\0")[8:16]) if frame.message == TIMESYNC else None
        held_s = 0.8 if to is None and chance.random() < 0.02 else 0.0
        for way, delay_s in ((quick, 0.0), (late, 0.03)):
            if to in (None, way):
                waiting.append((now[0] + held_s + delay_s, way, frame))

    def act(elapsed):
        now[0] = elapsed
        waiting.sort(key=lambda one: one[0])
        while waiting and waiting[0][0] <= elapsed:
            say(*waiting.pop(0)[1:])

    until(15, [robot, quick, late], take, act)
    running.stop()
    brick.kill()


def ev3(folder):
    """An EV3 with its camera, and a brick beside it that has a thermometer."""
    brick = sim(folder, scenario() + "[brick]\nwall_x_m = 0.9\n", "--brick", "ev3", "--camera-listen", "tcp://127.0.0.1:0")
    bath = sim(folder, scenario(12) + "[camera]\nis_present = false\n" + THERMOMETER, name="bath.toml")
    (own, camera), (beside,) = brick.addresses(2), bath.addresses()
    url = lambda address: f'[[link]]\nurl = "tcp://{address[0]}:{address[1]}"\n'
    running = station(
        folder, url(own) + 'brick = "ev3"\n' + url(camera) + url(beside) + 'filter_in = { allow_messages = ["NAMED_VALUE_FLOAT", "HEARTBEAT"] }\n'
        "[robot]\nadopt_description = false\n[robot.ev3]\ndistance_port = 4\n")
    time.sleep(14)
    running.stop()
    brick.kill()
    bath.kill()


def thermometer(folder):
    """An NXT with a thermometer of its own, dipped after three seconds."""
    brick = sim(
        folder,
        scenario() + '[brick]\nsensors = ["gyro", "none", "ultrasonic", "temperature"]\nwall_x_m = 0.9\nprogram_restart_s = 5.0\n' + THERMOMETER,
        "--brick", "nxt", "--camera-listen", "tcp://127.0.0.1:0")
    own, camera = brick.addresses(2)
    running = station(
        folder, f'[[link]]\nurl = "tcp://{own[0]}:{own[1]}"\nbrick = "nxt"\n[[link]]\nurl = "tcp://{camera[0]}:{camera[1]}"\n'
        "[robot]\nadopt_description = false\n[robot.nxt]\n"
        'sensor = [{ port = 1, kind = "ht-gyro" }, { port = 3, kind = "ultrasonic" }, { port = 4, kind = "temperature" }]\n')
    time.sleep(12)
    running.stop()
    brick.kill()


def gcs(folder):
    """A ground station asks, sets and commands; beside it somebody sends what is broken."""
    write(folder, "square.toml", scenario())
    running = station(folder, '[[link]]\nurl = "sim://square.toml"\n[[link]]\nurl = "tcp://127.0.0.1:0"\nlisten = true\nground_station = true\n')
    address = running.addresses()[0]
    ground, broken = Link(address), Link(address)
    heartbeat = Frame(254, 190, HEARTBEAT, struct.pack("<IBBBBB", 0, 6, 8, 0, 4, 3))

    def ask(message, payload):
        return lambda: ground.say(Frame(254, 190, message, payload))

    def set_parameter(name, value, kind=9):
        return ask(PARAM_SET, struct.pack("<fBB16sB", value, 1, 197, name, kind))

    def command(number, *params, to=197):
        params = (*params, *[0.0] * (7 - len(params)))
        return ask(COMMAND_LONG, struct.pack("<7fHBBB", *params, number, 1, to, 0))

    def send(data):
        return lambda: broken.socket.send(data)

    of_other = lambda name, value: Frame(2, 1, NAMED_VALUE_FLOAT, struct.pack("<If10s", 5000, value, name)).bytes(1)
    damaged = bytearray(heartbeat.bytes(7))
    damaged[12] ^= 0x55
    plan = Plan(
        *[(0.5 + i, lambda: ground.say(heartbeat)) for i in range(17)],
        (1.0, ask(PARAM_REQUEST_LIST, struct.pack("<BB", 1, 197))),
        (3.0, ask(PARAM_REQUEST_READ, struct.pack("<hBB16s", -1, 1, 197, b"SLIP_NIS"))),
        (3.2, set_parameter(b"SLIP_NIS", 20.0)),
        (3.4, set_parameter(b"SLIP_NIS", 1.0)),
        (3.6, set_parameter(b"SLIP_NIS", 20.0, 10)),
        (3.8, set_parameter(b"NO_SUCH", 1.0)),
        (4.0, set_parameter(b"gate_prob", 0.99)),
        (4.5, command(511, 331.0, 200000.0)),
        (4.7, command(510, 331.0)),
        (4.9, command(512, 148.0)),
        (5.1, command(512, 0.0, to=1)),
        (5.3, command(511, 251.0, 500000.0)),
        (5.5, command(511, 350.0, 1000000.0)),
        (5.7, command(511, 42103.0, 1000000.0)),
        (6.0, command(31012, 0.0)),
        (7.0, command(31012, 1.0)),
        (7.5, command(31013, 1.0, 0.0)),
        (8.5, command(31013, 1.0, 1.0)),
        (9.0, command(31013, 99.0, 0.0)),
        (9.5, command(31010, 1.0, 1.5, 90.0, 0.01, 1.0)),
        (11.5, command(31011)),
        (12.5, command(31012, 2.0)),
        (13.0, command(245, 1.0)),
        (13.5, command(245, 0.0)),
        (14.0, command(245, 2.0)),
        (14.5, command(400, 1.0)),
        (2.0, send(b"not a frame")),
        (2.5, send(bytes(damaged))),
        (5.0, send(b"\xFD\xFF\x40\0\1\1\1\x4C\0\0" + bytes(30))),
        (6.5, send(of_other(b"temp1", 20.0))),
        (6.6, send(of_other(b"temp1", float("nan")))),
        (8.0, send(Frame(1, 197, HEARTBEAT, heartbeat.payload).bytes(3))),
        (10.0, send(heartbeat.bytes(9)[:11])))
    until(17, [ground, broken], lambda link, frame: None, plan)
    running.stop()


DRIVES = [kidnap, restart, signed, redundant, ev3, thermometer, gcs]

if __name__ == "__main__":
    BINARY, out = os.path.realpath(sys.argv[1]), sys.argv[2]
    os.makedirs(out, exist_ok=True)
    for drive in DRIVES:
        if len(sys.argv) > 3 and drive.__name__ not in sys.argv[3:]:
            continue
        with tempfile.TemporaryDirectory() as folder:
            drive(folder)
            with open(os.path.join(folder, "run", "recording.mcap"), "rb") as recording:
                packed = gzip.compress(recording.read(), 9, mtime=0)
        with open(os.path.join(out, f"{drive.__name__}.mcap.gz"), "wb") as file:
            file.write(packed)
        print(f"{drive.__name__}: {len(packed)} bytes")
