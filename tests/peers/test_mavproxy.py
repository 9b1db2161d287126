"""MAVProxy as it is, without a window, beside a running station: what it lists, fetches and sets, and what its log is to us."""

import os
import subprocess
import sys
import tempfile
import time
import unittest

from drives import counted, for_ground_stations, inspected, logged, simulated
from harness import DEADLINE_S, Process, RunningStation, json_of, posebridge

# The modules that need no window, and none that the standard installation does not have.
MODULES = "link,param,misc,log,cmdlong"
LOG_BYTES = 60_000


class MavProxy(Process):
    """The program in a folder of its own; commands go to its standard input."""

    def __init__(self, folder, address):
        host, port = address
        super().__init__(
            folder,
            [
                sys.executable, "-u", os.path.join(os.path.dirname(sys.executable), "mavproxy.py"), f"--master=udpout:{host}:{port}",
                f"--state-basedir={folder}", "--dialect=posebridge_all", f"--default-modules={MODULES}",
            ],
            # It would read somebody's own settings.
            env={**os.environ, "HOME": folder, "TERM": "dumb"},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)

    def say(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def stop(self):
        """The end of its standard input ends it; it writes its log to the end."""
        self.process.stdin.close()
        self.process.wait(DEADLINE_S)


class Headless(unittest.TestCase):
    def test_lists_both_components_fetches_all_parameters_and_sets_one_and_its_log_replays_in_ours(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        folder = folder.name
        station = RunningStation(folder, "run", simulated(folder) + for_ground_stations("udp", 'dialects = "all"')).belongs_to(self)
        proxy = MavProxy(folder, station.addresses[0]).belongs_to(self)
        proxy.wait_for("Detected vehicle 1:1 on link 0")
        proxy.wait_for("Detected vehicle 1:197 on link 0")

        proxy.say("vehicle 1:197")
        proxy.wait_for("Set vehicle 1:197")
        proxy.say("param fetch")
        lines = posebridge(folder, "config", "params").splitlines()
        names = [line.split()[0].upper() for line in lines if not line.startswith(" ")]
        saved = proxy.wait_for(f"Saved {len(names)} parameters to ").strip().split(" parameters to ")[1]
        with open(saved) as file:
            self.assertEqual(sorted(line.split()[0] for line in file), sorted(names))
        proxy.say("param set SLIP_NIS 20")
        self.until(lambda: any("slip_nis set to 20" in event for event in station.events()), station)
        proxy.say("param show SLIP_NIS")
        proxy.wait_for("SLIP_NIS         20.0")

        # Some seconds of a drive.
        self.until(lambda: os.path.getsize(os.path.join(folder, "mav.tlog")) > LOG_BYTES, station)
        proxy.stop()
        station.stop()
        self.its_log_is_a_recording(folder)

    def until(self, is_so, station):
        deadline = time.monotonic() + DEADLINE_S
        while not is_so():
            self.assertLess(time.monotonic(), deadline, station.talk())

    def its_log_is_a_recording(self, folder):
        found = inspected(folder, "mav.tlog")
        self.assertEqual((found["kind"], found["bytes_outside"], found["unknown_frames"]), ("tlog", 0, 0))
        self.assertEqual(counted(folder, "mav.tlog"), logged(folder, "mav.tlog"))
        replayed = json_of(folder, "replay", "mav.tlog", "--json")
        used = {source["name"]: source["used"] for source in replayed["estimators"][0]["sources"]}
        self.assertGreater(used["wheels"], 20)
        self.assertGreater(used["camera"], 10)


if __name__ == "__main__":
    unittest.main()
