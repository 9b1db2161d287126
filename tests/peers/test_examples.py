"""The scripts in `examples/python`, each run as its own description says."""

import csv
import itertools
import math
import os
import re
import tempfile
import unittest

from drives import finished_drive, for_ground_stations, scored_drive, simulated
from harness import RunningStation, json_of, output_of, posebridge

SCRIPTS = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", "examples", "python"))
STEPS = list(itertools.product((-1, 0, 1), repeat=3))


def run(folder, script, *arguments):
    """What a script prints, by the Python that has what examples/python/requirements.txt says."""
    python = os.path.join(os.environ["PEERS_EXAMPLES"], "python")
    # Neither our own modules nor anybody's settings.
    alone = {"PYTHONPATH": "", "HOME": folder, "MPLCONFIGDIR": folder}
    return output_of(python, os.path.join(SCRIPTS, script), *arguments, folder=folder, environment=alone)


class Examples(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def test_read_recording_shows_the_topics_and_writes_parquet(self):
        recording = os.path.join(finished_drive(), "run", "recording.mcap")
        printed = run(self.folder, "read_recording.py", recording, "estimates.parquet")
        for topic in ("/posebridge/odometry", "posebridge/fusion", "posebridge/input"):
            self.assertRegex(printed, rf"(?m)^{topic} +\S+ +[1-9]\d*$")
        rows = int(re.search(r"(\d+) estimates to estimates.parquet", printed)[1])
        self.assertGreater(rows, 50)
        # Whoever reads it next finds the same; in a notebook the functions are imported.
        lines = [
            "import pandas, sys", f"sys.path.insert(0, {SCRIPTS!r})", "import read_recording",
            "stored = pandas.read_parquet('estimates.parquet')", f"estimates = read_recording.table({recording!r}, 'posebridge/estimate')",
            "pandas.testing.assert_frame_equal(stored, estimates)", f"poses = read_recording.odometry({recording!r})",
            "pandas.testing.assert_frame_equal(poses, estimates[['x_m', 'y_m']])",
            "print(len(stored), stored.index.dtype)",
        ]
        output = output_of(
            os.path.join(os.environ["PEERS_EXAMPLES"], "python"), "-c", "\n".join(lines), folder=self.folder, environment={"PYTHONPATH": ""})
        self.assertRegex(output, rf"^{rows} datetime64\[ns, UTC\]$")

    def test_read_tables_judges_the_sensors_and_draws_the_path(self):
        drive = finished_drive()
        posebridge(drive, "export", "run/recording.mcap", "--format", "csv", "--out", os.path.join(self.folder, "tables"))
        printed = run(self.folder, "read_tables.py", "tables", "path.png")
        table = {line.split()[0]: line.split()[1:] for line in printed.splitlines()[2:] if len(line.split()) == 4}
        ours = {source["name"]: source for source in json_of(drive, "replay", "run/recording.mcap", "--json")["estimators"][0]["sources"]}
        for name in ("wheels", "camera"):
            observations, used, nis = table[name]
            self.assertEqual(round(int(observations) * float(used)), ours[name]["used"], name)
            self.assertAlmostEqual(float(nis), ours[name]["mean_nis_per_dof"], delta=2e-3, msg=name)
        with open(os.path.join(self.folder, "path.png"), "rb") as file:
            self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")

    def test_messages_to_parquet_keeps_every_value(self):
        posebridge(finished_drive(), "export", "run/recording.tlog", "--messages", "--format", "csv", "--out", self.folder)
        folder = os.path.join(self.folder, "recording-messages")
        # What no drive has: numbers at the limits of 64 bits, texts that look like something else, a column that is whole at first.
        with open(os.path.join(folder, "LIMITS.csv"), "w") as file:
            rows = [f"{count},0,NaN,NA" for count in range(20_000)] + ["18446744073709551615,0.1,-inf,", "2,1e-45,1,NULL"]
            file.write("\n".join(["a [us],b,c [m],d", *rows, ""]))
        printed = run(self.folder, "messages_to_parquet.py", "recording-messages")
        self.assertIn("PB_WHEEL_TICKS.parquet", printed)
        lines = [
            "import csv, math, pathlib", "import pyarrow.parquet",
            "def same(text, value):",
            "    if isinstance(value, str): return text == value",
            "    if value is None: return text == 'NaN'",
            "    return type(value)(text) == value or text == 'NaN' and math.isnan(value)",
            "for path in pathlib.Path('recording-messages').glob('*.csv'):",
            "    with open(path, newline='') as file: rows = list(csv.DictReader(file))",
            "    stored = pyarrow.parquet.read_table(path.with_suffix('.parquet')).to_pylist()",
            "    assert len(rows) == len(stored) and list(rows[0]) == list(stored[0]), path",
            "    wrong = [(row, one) for row, one in zip(rows, stored) if not all(same(row[name], one[name]) for name in row)]",
            "    assert not wrong, (path, wrong[0])",
            "    print(path.name, len(rows))",
        ]
        output = output_of(
            os.path.join(os.environ["PEERS_EXAMPLES"], "python"), "-c", "\n".join(lines), folder=self.folder, environment={"PYTHONPATH": ""})
        self.assertGreater(len(output.splitlines()), 6)
        self.assertIn("LIMITS.csv 20002", output)

    def test_score_says_what_replay_says(self):
        drive = scored_drive()
        tables = os.path.join(self.folder, "tables")
        posebridge(drive, "export", "run/recording.mcap", "--truth", "truth.csv", "--format", "tum", "--out", tables)
        printed = run(self.folder, "score.py", "tables/truth.tum", "tables/estimate.tum")
        figures = {line.split()[0]: (float(line.split()[2]), float(line.split()[4])) for line in printed.splitlines()}
        ours = json_of(drive, "replay", "run/recording.mcap", "--truth", "truth.csv", "--json")["estimators"][0]
        self.assertAlmostEqual(figures["position_m"][0] / ours["position_rms_m"], 1.0, delta=1e-3)
        self.assertAlmostEqual(figures["position_m"][1] / ours["position_max_m"], 1.0, delta=1e-3)
        truth, estimate = (self.headings(name) for name in ("truth", "estimate"))
        errors = [math.remainder(one - other, math.tau) for one, other in zip(truth, estimate, strict=True)]
        self.assertAlmostEqual(figures["heading_rad"][0], math.sqrt(sum(error * error for error in errors) / len(errors)), delta=2e-6)

    def headings(self, name):
        """The headings of a trajectory, by its quaternions."""
        with open(os.path.join(self.folder, "tables", f"{name}.tum")) as file:
            rows = [[float(field) for field in line.split()] for line in file]
        return [2.0 * math.atan2(qz, qw) for *_, qz, qw in rows]

    def test_live_estimates_are_those_of_the_station(self):
        station = RunningStation(self.folder, "run", simulated(self.folder) + for_ground_stations("udp")).belongs_to(self)
        host, port = station.addresses[0]
        # Ten a second; the robot rests for two seconds before it drives.
        printed = run(self.folder, "live_estimates.py", f"udpout:{host}:{port}", "60")
        station.stop()
        rows = [{name: float(value) for name, value in (pair.split(" ") for pair in line.split("  "))} for line in printed.splitlines()]
        self.assertEqual(len(rows), 60)
        times = [row["t_s"] for row in rows]
        self.assertEqual(times, sorted(set(times)))
        posebridge(self.folder, "export", "run/recording.mcap", "--format", "csv", "--out", "tables")
        with open(os.path.join(self.folder, "tables", "estimates.csv"), newline="") as file:
            ours = {tuple(round(float(row[name]), 4) for name in ("x_m", "y_m", "heading_rad")) for row in csv.DictReader(file)}
        known = [(row["x_m"], row["y_m"], row["heading_rad"]) for row in rows if row["x_sigma_m"] < 1.0]
        self.assertGreater(len(known), 50)
        # A 32-bit float may fall on the other side of the last digit.
        near = {tuple(round(value + step * 1e-4, 4) for value, step in zip(place, steps)) for place in ours for steps in STEPS}
        self.assertEqual(set(known) - near, set())

    def test_all_scripts_are_tried_here(self):
        with open(__file__) as file:
            tried = file.read()
        for script in os.listdir(SCRIPTS):
            if script.endswith(".py"):
                self.assertIn(f'"{script}"', tried)


if __name__ == "__main__":
    unittest.main()
