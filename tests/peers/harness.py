"""The program as a process, station or simulated brick, and a peer that speaks with pymavlink's codec over a socket.

Nothing here sleeps: every wait is for bytes or for a line, with a deadline after which the test fails.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import posebridge_dialect as pb
from pymavlink.dialects.v20 import common

DEADLINE_S = 20.0
FIRST_OF_OURS = 42100
SIGNATURE_BYTES = 13


def stamp_of_now():
    """The time in units of 10 us since 2015-01-01 UTC."""
    return int((time.time() - 1420070400) * 1e5)


def listening(scheme, *keys):
    """A link of a configuration that waits at a free port of this computer."""
    return "\n".join((f'[[link]]\nurl = "{scheme}://127.0.0.1:0"\nlisten = true', *keys, ""))


def output_of(*command, folder=None, environment=None):
    """What a program prints that has to end well; what it says on stderr is shown if it does not."""
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **(environment or {})}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, timeout=120)
    if done.returncode != 0:
        raise AssertionError(f"{' '.join(map(str, command))} ended with {done.returncode}: {done.stdout[-2000:]}{done.stderr[-4000:]}")
    return done.stdout


def posebridge(folder, *arguments):
    """What our program prints."""
    return output_of(os.environ["POSEBRIDGE"], *arguments, folder=folder)


def json_of(folder, *arguments):
    """The JSON object that our program prints."""
    return json.loads(posebridge(folder, *arguments))


class Process:
    """A program as a process, in a folder of its own; what it says is kept."""

    def __init__(self, folder, command, stdin=subprocess.DEVNULL, **streams):
        self.folder = folder
        self.process = subprocess.Popen(command, cwd=folder, stdin=stdin, text=True, **streams)
        self.voice = self.process.stderr or self.process.stdout
        self.said, self.news = [], threading.Condition()
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _read(self):
        for line in self.voice:
            with self.news:
                self.said.append(line)
                self.news.notify_all()
        with self.news:
            self.said.append(None)
            self.news.notify_all()

    def wait_for(self, text, times=1):
        """The first line that holds the text, or the last one of that many."""
        deadline = time.monotonic() + DEADLINE_S
        seen = 0
        with self.news:
            while True:
                for line in self.said[seen:]:
                    if line is None:
                        raise AssertionError(f"the program ended before it said {text!r}: {self.talk()}")
                    times -= text in line
                    if times == 0:
                        return line
                seen = len(self.said)
                if not self.news.wait(deadline - time.monotonic()):
                    raise AssertionError(f"the program did not say {text!r}: {self.talk()}")

    def talk(self):
        return "".join(line for line in self.said if line)

    def kill(self):
        """Ends it as kill -9 does."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(DEADLINE_S)
        self.reader.join(DEADLINE_S)
        self.voice.close()

    def belongs_to(self, test):
        """It ends with the test, and what it said is shown if that fails."""

        def end():
            self.kill()
            result = test._outcome.result
            if any(failed is test for failed, _ in result.failures + result.errors):
                print(f"\n-- {' '.join(self.process.args)}\n{self.talk()}", file=sys.stderr)

        test.addCleanup(end)
        return self

    def end(self, deadline_s=DEADLINE_S):
        """Waits until it has ended well."""
        code = self.process.wait(deadline_s)
        self.reader.join(DEADLINE_S)
        if code != 0:
            raise AssertionError(f"the program ended with {code}: {self.talk()}")


class Program(Process):
    """Our program; what it says on stderr is kept."""

    def __init__(self, folder, *arguments):
        super().__init__(
            folder, [os.environ["POSEBRIDGE"], *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def address_of(self, line):
        """Host and port at the end of a line."""
        host, port = line.strip().rsplit(" ", 1)[1].rsplit(":", 1)
        return host, int(port)


class RunningStation(Program):
    """`posebridge run` with a configuration, which may say where it listens any number of times."""

    def __init__(self, folder, name, config, *arguments):
        self.name = name
        with open(os.path.join(folder, f"{name}.toml"), "w") as file:
            file.write(config)
        super().__init__(
            folder, "run", "--config", f"{name}.toml", "--out", name, "--events", f"{name}.txt", *arguments)
        times = range(1, config.count("listen = true") + 1)
        try:
            self.addresses = [self.address_of(self.wait_for("listening on ", time)) for time in times]
        except AssertionError:
            self.kill()
            raise

    def stop(self):
        """Ends it as Ctrl-C does and returns its events, one per line."""
        self.process.send_signal(signal.SIGINT)
        self.end()
        return self.events()

    def events(self):
        """What it has told so far, one event per line."""
        with open(os.path.join(self.folder, f"{self.name}.txt")) as file:
            return file.read().splitlines()


class Station(RunningStation):
    """`posebridge run` with one listening link."""

    def __init__(self, folder, name, scheme="udp", signing=None):
        super().__init__(folder, name, listening(scheme, f"signing = {signing}" if signing else ""))
        self.address = self.addresses[0]


class SimulatedBrick(Program):
    """`posebridge sim` with a scenario of its own and a brick that is no robot's but a LEGO one's."""

    def __init__(self, folder, kind, listen, scenario, *arguments):
        with open(os.path.join(folder, "scenario.toml"), "w") as file:
            file.write(scenario)
        super().__init__(folder, "sim", "scenario.toml", "--brick", kind, "--listen", listen, *arguments)
        self.line = self.wait_for("brick up")


class Peer:
    """A robot that speaks with pymavlink; counts what it hears."""

    def __init__(self, station, scheme="udp", key=None, link_id=0, timestamp=None):
        kind = socket.SOCK_DGRAM if scheme == "udp" else socket.SOCK_STREAM
        self.socket = socket.socket(socket.AF_INET, kind)
        self.socket.settimeout(DEADLINE_S)
        self.socket.connect(station.address)
        self.std = common.MAVLink(self, srcSystem=1, srcComponent=1)
        self.own = pb.MAVLink(self, srcSystem=1, srcComponent=1)
        # One sender: both dialects count and sign together.
        self.own.signing = self.std.signing
        self.waiting = b""
        self.sent = []
        self.heard = []
        self.failures = []
        self.pings = 0
        if key is not None:
            self.sign(key, link_id, stamp_of_now() if timestamp is None else timestamp)

    def sign(self, key, link_id, timestamp):
        signing = self.std.signing
        signing.secret_key, signing.sign_outgoing = key, True
        signing.link_id, signing.timestamp = link_id, timestamp

    def write(self, data):
        """What pymavlink calls to send."""
        self.sent.append(bytes(data))
        self.socket.sendall(data)

    def heartbeat(self):
        self.std.heartbeat_send(10, 0, 0, 0, 4)
        self.own.seq = self.std.seq
        return self.sent[-1]

    def wheel_ticks(self, time_us, left, right):
        self.own.seq = self.std.seq
        self.own.pb_wheel_ticks_send(time_us, left, right, 3)
        self.std.seq = self.own.seq
        return self.sent[-1]

    def ping(self):
        """Asks for the time and waits for the answer: all that was sent before has then been handled."""
        self.pings += 1
        asked = 1_000_000_000 + self.pings
        self.std.timesync_send(0, asked)
        self.own.seq = self.std.seq
        self.hear(lambda message: message.get_type() == "TIMESYNC" and message.tc1 != 0 and message.ts1 == asked)

    def hear(self, is_wanted):
        """Reads until a message that is wanted has come, and returns it."""
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            for message in self._messages(self.socket.recv(65536)):
                if is_wanted(message):
                    return message
        raise AssertionError(f"not heard among {[message.get_type() for _, message in self.heard]}")

    def hear_seconds(self, count):
        """Waits for that many heartbeats of the station, which come once per second."""
        for _ in range(count):
            self.hear(lambda message: message.get_type() == "HEARTBEAT")

    def _messages(self, data):
        if not data:
            raise AssertionError("the station has closed the link")
        self.waiting += data
        messages = []
        while len(self.waiting) >= 12:
            if self.waiting[0] != 0xFD:
                raise AssertionError(f"no frame: {self.waiting[:12].hex()}")
            total = 12 + self.waiting[1] + (SIGNATURE_BYTES if self.waiting[2] & 1 else 0)
            if len(self.waiting) < total:
                break
            frame, self.waiting = self.waiting[:total], self.waiting[total:]
            codec = self.own if int.from_bytes(frame[7:10], "little") >= FIRST_OF_OURS else self.std
            try:
                message = codec.decode(bytearray(frame))
            except (common.MAVError, pb.MAVError) as error:
                self.failures.append((str(error), frame.hex()))
                continue
            self.heard.append((frame, message))
            messages.append(message)
        return messages

    def close(self):
        self.socket.close()


def stamp_of(frame):
    """The timestamp in a signed frame."""
    return int.from_bytes(frame[-12:-6], "little")


def events_named(lines, name):
    """The events of this name, in their order."""
    return [event for event in map(json.loads, lines) if event["event"] == name]


def refusals(events):
    """The reasons of the events about refused frames, in their order."""
    found = (event for event in events_named(events, "receive_error") if event["error"] == "signature_rejected")
    return [event["reason"] for event in found]


def last_health(events, count):
    """One count of the last event about the link's health."""
    health = events_named(events, "link_health")
    if not health:
        raise AssertionError("no event about health")
    return health[-1][count]
