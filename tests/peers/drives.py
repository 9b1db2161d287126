"""Robots that drive: stations with a simulated brick that somebody looks at, and one drive that is over, for whoever reads its files."""

import atexit
import collections
import functools
import os
import re
import sys
import tempfile

from harness import RunningStation, SimulatedBrick, json_of, listening, output_of

# A small square, driven for as long as anybody looks.
SQUARE = """
seed = 11
steering = "estimate"

[path.square]
side_m = 0.3

[drive]
laps = {laps}
speed_m_per_s = 0.2

[errors]
radius_error = 0.005
radius_error_sigma = 0.0
radius_mismatch = 0.005
radius_mismatch_sigma = 0.0
track_error = -0.02
track_error_sigma = 0.0
"""

# The same with an NXT as it comes out of the box, with a wall ahead: it speaks no MAVLink, and it sees a range.
NXT = SQUARE + """
[brick]
turn_around_ms = 10.0
wall_x_m = 0.8
sensors = ["gyro", "accelerometer", "compass", "ultrasonic"]
"""

NXT_ROBOT = """
[robot]
adopt_description = false

[robot.nxt]
sensor = [{ port = 1, kind = "ht-gyro" }, { port = 4, kind = "ultrasonic" }]
"""

# One lap takes less than half a minute.
LAP_S = 90.0


def for_ground_stations(scheme, *keys):
    """A link of a configuration on which ground stations look on."""
    return listening(scheme, "ground_station = true", *keys)


def simulated(folder, scenario=SQUARE, laps=1000):
    """The first link of a configuration: a simulated brick inside the station."""
    with open(os.path.join(folder, "scenario.toml"), "w") as file:
        file.write(scenario.format(laps=laps))
    return '[[link]]\nurl = "sim://scenario.toml"\n'


def nxt_station(test, folder, *links):
    """A station that asks a simulated NXT, and hears its camera; both end with the test."""
    brick = SimulatedBrick(folder, "nxt", "tcp://127.0.0.1:0", NXT.format(laps=1000), "--camera-listen", "tcp://127.0.0.1:0")
    brick.belongs_to(test)
    own, camera = addresses_in(brick.line)
    config = f'[[link]]\nurl = "tcp://{own}"\nbrick = "nxt"\n\n[[link]]\nurl = "tcp://{camera}"\n\n' + "\n".join(links) + NXT_ROBOT
    return RunningStation(folder, "run", config).belongs_to(test)


def addresses_in(line):
    """Everything that somebody says to listen on."""
    return re.findall(r"listening on ([\d.]+:\d+)", line)


def kept_folder():
    """A folder for as long as tests run."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    return folder.name


@functools.lru_cache(maxsize=None)
def finished_drive():
    """A folder with one lap that is over: `run/recording.mcap` with its truth, `run/recording.tlog` and `run/recording-ros2.mcap`."""
    folder = kept_folder()
    station = RunningStation(folder, "run", simulated(folder), "--tlog", "--mcap", "ros2", "--laps", "1")
    try:
        station.end(LAP_S)
    finally:
        station.kill()
    return folder


@functools.lru_cache(maxsize=None)
def scored_drive():
    """The same with a simulated brick that is a program of its own: `run/recording.mcap`, and `truth.csv` beside it."""
    folder = kept_folder()
    brick = SimulatedBrick(folder, "mavlink", "tcp://127.0.0.1:0", SQUARE.format(laps=1), "--truth", "truth.csv")
    try:
        station = RunningStation(folder, "run", f'[[link]]\nurl = "tcp://{addresses_in(brick.line)[0]}"\n')
        try:
            brick.end(LAP_S)
            station.stop()
        finally:
            station.kill()
    finally:
        brick.kill()
    return folder


def inspected(folder, name):
    """What `posebridge inspect` says about a file."""
    return json_of(folder, "inspect", name, "--json")


def counted(folder, name):
    """By `posebridge inspect`: how many frames of which message came from whom."""
    found = collections.Counter()
    for source in inspected(folder, name)["sources"]:
        for message in source["messages"]:
            found[source["system"], source["component"], message["name"]] += message["frames"]
    return found


def logged(folder, name):
    """The same by pymavlink's mavlogdump, which must find nothing that it does not know."""
    dump = output_of(
        sys.executable, os.path.join(os.path.dirname(sys.executable), "mavlogdump.py"), "--dialect", "posebridge_all", "--show-source",
        name, folder=folder)
    for bad in ("BAD_DATA", "UNKNOWN"):
        if bad in dump:
            raise AssertionError(f"mavlogdump finds {dump.count(bad)} {bad} in {name}")
    # 2026-01-01 12:00:00.00: NAME {field : value, ..} srcSystem=1 srcComponent=1
    lines = re.findall(r"^\d{4}-\d\d-\d\d \S+: (\w+) .* srcSystem=(\d+) srcComponent=(\d+)", dump, re.MULTILINE)
    return collections.Counter((int(system), int(component), name) for name, system, component in lines)
