"""The stock MAVLink library on a simulated Uno as a robot of the real program, by a pseudo-terminal.

    python check.py <posebridge> <run_uno> <program.bin> <folder for what is made>

Ends with 1 where the station lost a frame, did not use wheels and gyro, or does not see the circle that stock_mavlink.ino says it drives.
"""

import collections
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import tty
from pathlib import Path

SECONDS = 10
DEADLINE_S = 120
# As in stock_mavlink.ino.
LEFT_M_PER_S, RIGHT_M_PER_S, TRACK_M = 0.20, 0.22, 0.15
SENSORS = {0: "wheels", 1: "gyro"}


def drive(posebridge, run_uno, program, folder):
    """Runs both and returns the events and what `inspect` says."""
    uno_end, port = os.openpty()
    tty.setraw(port)
    link = f"serial://{os.ttyname(port)}?baud=115200"
    command = [posebridge, "run", "--link", link, "--set", f"robot.track_width_m={TRACK_M}", "--no-dashboard", "--out", "run", "--events", "run.txt"]
    with open(folder / "run.log", "w") as log:
        uno = subprocess.Popen([run_uno, program, str(SECONDS)], stdin=uno_end, stdout=uno_end)
        station = subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)
        try:
            if code := uno.wait(DEADLINE_S):
                sys.exit(f"brick SDK: the simulated Uno ended with {code}")
            station.send_signal(signal.SIGINT)
            if code := station.wait(DEADLINE_S):
                sys.exit(f"brick SDK: posebridge ended with {code}: {(folder / 'run.log').read_text()}")
        finally:
            for process in (uno, station):
                process.kill()
                process.wait()
    events = [json.loads(line) for line in (folder / "run.txt").read_text().splitlines()]
    command = [posebridge, "inspect", "run/recording.mcap", "--json"]
    return events, json.loads(subprocess.run(command, cwd=folder, capture_output=True, check=True).stdout)


def differences(events, found):
    """What is not as it must be."""
    outcomes = collections.Counter((event["sensor"], event["outcome"]) for event in events if event["event"] == "fused")
    for sensor, name in SENSORS.items():
        if outcomes[sensor, "accepted"] < 15 * SECONDS:
            yield f"{outcomes[sensor, 'accepted']} observations of {name} used, of {20 * SECONDS}"
    if others := {key: count for key, count in outcomes.items() if key[0] not in SENSORS or key[1] != "accepted"}:
        yield f"others: {others}"
    sources = {(source["system"], source["component"]): source for source in found["sources"]}
    lost = {address: source["lost"] for address, source in sources.items()}
    health = [event for event in events if event["event"] == "link_health"][-1]
    counts = {count: health[count] for count in ("frames_lost", "checksum_errors", "garbage_bytes", "unknown_ids")}
    if lost != {(1, 1): 0} or any(counts.values()):
        yield f"lost frames of {lost}, {counts}"
    answers = sum(message["frames"] for message in found["messages"] if message["name"] == "TIMESYNC")
    if answers < 5 * SECONDS or not any(event["event"] == "robot_clock_aligned" for event in events):
        yield f"{answers} answers to TIMESYNC"
    last = [event for event in events if event["event"] == "estimated"][-1]
    heading = (RIGHT_M_PER_S - LEFT_M_PER_S) / TRACK_M * last["robot_ns"] * 1e-9
    radius = TRACK_M / 2 * (RIGHT_M_PER_S + LEFT_M_PER_S) / (RIGHT_M_PER_S - LEFT_M_PER_S)
    x, y = radius * math.sin(heading), radius * (1 - math.cos(heading))
    off = math.hypot(last["x_m"] - x, last["y_m"] - y)
    print(
        f"stock MAVLink: on a simulated Uno {SECONDS} s, {found['frames']} frames, 0 lost, {outcomes[0, 'accepted']} of wheels and "
        f"{outcomes[1, 'accepted']} of the gyro used, {answers} answers to TIMESYNC; {off * 1000:.0f} mm off after {radius * heading:.2f} m")
    if not off < 0.02 * radius * heading:
        yield f"the pose is {off:.3f} m off"


def main():
    posebridge, run_uno, program, folder = (Path(argument).resolve() for argument in sys.argv[1:5])
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if wrong := list(differences(*drive(posebridge, run_uno, program, folder))):
        sys.exit(f"brick SDK: the stock MAVLink library as a robot: {'; '.join(wrong)}")


if __name__ == "__main__":
    main()
