"""Our tag detector beside AprilTag 3, the C library, on the same drawn pictures, one after the other.

    python3 -m venv target/tag-bench && target/tag-bench/bin/pip install numpy opencv-python-headless pupil-apriltags
    POSEBRIDGE_DATA=... target/tag-bench/bin/python benches/tag_detectors.py [--seeds 7 8 9] [--frames 30]

For each seed: recall, false detections, errors of corners and centres (score.py of the data folder), and CPU milliseconds of a frame; then
the ratio of the times, and the time of a window of 192 x 192 pixels with one tag. About two minutes and 190 MB for each seed.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy
from pupil_apriltags import Detector

ROOT = pathlib.Path(__file__).resolve().parent.parent
SETS = ["easy", "small", "tiny", "oblique", "motion", "dark", "mjpeg"]
SHAPE = (720, 1280)


def ours(folder):
    command = ["cargo", "run", "--quiet", "--release", "--package", "posebridge-vision", "--example", "detect_tags", "--"]
    return json.loads(subprocess.run([*command, folder, *SETS], cwd=ROOT, check=True, capture_output=True).stdout)


def april_tag(folder):
    frames = []
    for name in SETS:
        detector = Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)
        pictures = numpy.fromfile(folder / f"{name}.raw", numpy.uint8).reshape(-1, *SHAPE)
        for number, picture in enumerate(pictures):
            begun = time.process_time()
            tags = detector.detect(picture)
            ms = 1e3 * (time.process_time() - begun)
            frames.append({"set": name, "n": number, "ms": ms, "d": [[tag.tag_id, tag.corners.tolist()] for tag in tags]})
    return frames


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seeds", type=int, nargs="+", default=[7, 8, 9])
    arguments.add_argument("--frames", type=int, default=30)
    arguments = arguments.parse_args()
    data = pathlib.Path(os.environ["POSEBRIDGE_DATA"]) / "tag-images"
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as folder:
            folder = pathlib.Path(folder)
            make = [sys.executable, data / "make.py", folder, "--seed", str(seed), "--frames", str(arguments.frames)]
            subprocess.run(make, check=True, stdout=subprocess.DEVNULL)
            results = {"posebridge": ours(folder), "AprilTag 3, decimate 1": april_tag(folder)}
            print(f"\nseed {seed}", flush=True)
            for name, frames in results.items():
                (folder / "detections.json").write_text(json.dumps(frames))
                score = [sys.executable, data / "score.py", name, folder / "truth.json", folder / "detections.json"]
                subprocess.run(score, check=True)
            own, other = results.values()
            for name in SETS:
                median = lambda frames, key: statistics.median(frame[key] for frame in frames if frame["set"] == name)
                ratio = median(other, "ms") / median(own, "ms")
                print(f"{name:8s} {ratio:5.1f} times as fast; a window takes {median(own, 'window_ms'):.2f} ms", flush=True)


if __name__ == "__main__":
    main()
