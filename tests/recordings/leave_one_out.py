#!/usr/bin/env python3
"""What each part of the pose filter's model buys on real recordings: every described run with the part switched off alone.

    tests/recordings/leave_one_out.py target/release/posebridge DATA > table.md

Prints a Markdown table: position rms with everything on, and by how much it changes without each part.
"""

import json
import subprocess
import sys
from pathlib import Path

RECORDINGS = Path(__file__).parents[2] / "config" / "recordings"

RUNS = [
    ("mrclam6", "--run", "robot1"),
    ("mrclam6", "--run", "robot2"),
    ("lego-nxt-camera", "--run", "track-155mm"),
    ("lego-nxt-camera", "--run", "track-155mm", "--use-every", "20"),
    ("neato-gyro-camera", "--run", "square_undisturbed"),
    ("neato-gyro-camera", "--run", "rotate_slip_a"),
    ("plaza1",),
    ("uwb-labyrinth",),
    ("husky-outdoor",),
    ("optiodom",),
]

# Each part with the keys that switch it off.
PARTS = {
    "gyro scale": ["calibration.gyro_scale.sigma=0"],
    "backlash": ["calibration.backlash_rad.sigma=0"],
    "odometry delay": ["calibration.odometry_delay_s.sigma=0"],
    "delays of sensors": [
        f"calibration.{name}_delay_s.sigma=0" for name in ("fix", "landmark", "beacon", "range", "compass")
    ],
    "range share": ["noise.landmark_range_share=0", "noise.beacon_range_share=0"],
    "map errors": ["noise.landmark_place_m=0"],
    "errors that fixes share": ["noise.fix_persistent_m=0"],
    "noise per time": ["noise.travel_m_per_sqrt_s=0", "noise.heading_rad_per_sqrt_s=0"],
    "learned noise": ["filter.adapt_gain=0"],
    "alternatives": ["filter.reset_after_s=600"],
}


def rms(program: str, data: str, run: tuple, settings: list) -> tuple:
    """Position rms in m and ANEES of a replay."""
    recording, *flags = run
    command = [program, "replay", str(RECORDINGS / f"{recording}.toml"), "--data", data, "--estimator", "pose", "--json"]
    command += flags + [word for setting in settings for word in ("--set", setting)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr}")
    of_pose = json.loads(done.stdout)["estimators"][0]
    return of_pose["position_rms_m"], of_pose["anees"]


def main() -> None:
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    program, data = sys.argv[1:]
    print("| run | all on | ANEES |", " | ".join(PARTS), "|")
    print("|---|---|---|" + "---|" * len(PARTS))
    for run in RUNS:
        all_on, anees = rms(program, data, run, [])
        cells = []
        for settings in PARTS.values():
            without, _ = rms(program, data, run, settings)
            change = 100 * (without / all_on - 1)
            cells.append("-" if abs(change) < 0.05 else f"{change:+.1f} %")
        shown = "-" if anees is None else f"{anees:.1f}"
        print(f"| `{' '.join(run)}` | {1e3 * all_on:.1f} mm | {shown} |", " | ".join(cells), "|", flush=True)


if __name__ == "__main__":
    main()
