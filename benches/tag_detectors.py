"""Our tag detector beside AprilTag 3, the C library, on the same drawn pictures, one after the other.

    python3 -m venv target/tag-bench && target/tag-bench/bin/pip install numpy opencv-python-headless pupil-apriltags
    POSEBRIDGE_DATA=... target/tag-bench/bin/python benches/tag_detectors.py [--seeds 7 8 9] [--frames 30]
        [--distortion -0.3] [--rolling-shutter 10 5]

For each seed: recall, false detections, errors of corners and centres (score.py of the data folder), and CPU milliseconds of a frame; then
the ratio of the times, and the time of a window of 192 x 192 pixels around one tag. With `--distortion` the same once more through a lens with
this k1, with `--rolling-shutter` for a camera that moves by so many pixels to the right and down while it reads one picture, and in
the end what each of them costs. About two minutes and 190 MB for each seed and kind of camera.
"""

import argparse
import functools
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import cv2
import numpy
from pupil_apriltags import Detector

ROOT = pathlib.Path(__file__).resolve().parent.parent
SETS = ["easy", "small", "tiny", "oblique", "motion", "dark", "mjpeg"]
SHAPE = (720, 1280)
# Of the lens, px: that of a usual webcam, 64 degrees wide.
FOCAL = 0.8 * SHAPE[1]


class Lens:
    """Moves what is at x to x (1 + k1 r²), both measured from the middle of the picture in focal lengths."""

    def __init__(self, k1):
        self.k1 = k1

    def move(self, points):
        middle = numpy.array([SHAPE[1] - 1, SHAPE[0] - 1]) / 2
        rays = (points - middle) / FOCAL
        return middle + FOCAL * rays * (1 + self.k1 * (rays**2).sum(-1, keepdims=True))


class RollingShutter:
    """Moves each row by its share of the way that the picture moves while all rows are read; the middle row stays."""

    def __init__(self, right, down):
        self.way = numpy.array([right, down])

    def move(self, points):
        # What is at y when the middle row is read is at y + down (row - middle) / height when its row is.
        height, middle = SHAPE[0], (SHAPE[0] - 1) / 2
        rows = (points[..., 1:] - middle) / (1 - self.way[1] / height)
        return points + self.way * rows / height


def origins(camera):
    """For each pixel, where the camera took it from: the inverse of its `move`, by Newton's method."""
    pixels = numpy.stack(numpy.meshgrid(numpy.arange(SHAPE[1]), numpy.arange(SHAPE[0])), -1).astype(float)
    points = pixels.copy()
    for _ in range(30):
        step = 1e-3
        columns = [(camera.move(points + offset) - camera.move(points - offset)) / (2 * step) for offset in step * numpy.eye(2)]
        jacobian = numpy.stack(columns, -1)
        determinant = numpy.linalg.det(jacobian)
        # Beyond the edge of what the lens shows there is no origin.
        jacobian[determinant < 0.05] = numpy.eye(2)
        points += numpy.linalg.solve(jacobian, (pixels - camera.move(points))[..., None])[..., 0]
    return points.astype(numpy.float32)


def take_pictures(camera, drawn, folder):
    """Writes the drawn pictures and their corners as the camera shows them."""
    maps = origins(camera)
    for name in SETS:
        pictures = numpy.fromfile(drawn / f"{name}.raw", numpy.uint8).reshape(-1, *SHAPE)
        with (folder / f"{name}.raw").open("wb") as file:
            for picture in pictures:
                taken = cv2.remap(picture, maps, None, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
                file.write(taken.tobytes())
    truth = json.loads((drawn / "truth.json").read_text())
    for tag in (tag for frame in truth for tag in frame["tags"]):
        tag["c"] = camera.move(numpy.array(tag["c"])).tolist()
    (folder / "truth.json").write_text(json.dumps(truth))


def ours(folder):
    command = ["cargo", "run", "--quiet", "--release", "--package", "posebridge-vision", "--example", "detect_tags", "--"]
    return json.loads(subprocess.run([*command, folder, *SETS], cwd=ROOT, check=True, capture_output=True).stdout)


@functools.cache
def april_tag_detector():
    # One for all: pupil-apriltags 1.0.4 crashes now and then after a detector was dropped.
    return Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)


def april_tag(folder):
    frames = []
    for name in SETS:
        pictures = numpy.fromfile(folder / f"{name}.raw", numpy.uint8).reshape(-1, *SHAPE)
        for number, picture in enumerate(pictures):
            begun = time.process_time()
            tags = april_tag_detector().detect(picture)
            ms = 1e3 * (time.process_time() - begun)
            frames.append({"set": name, "n": number, "ms": ms, "d": [[tag.tag_id, tag.corners.tolist()] for tag in tags]})
    return frames


def compare(folder, data):
    """Prints scores and times of both detectors; for each detector and set, its recall and the error of its corners, px."""
    results = {"posebridge": ours(folder), "AprilTag 3, decimate 1": april_tag(folder)}
    scores = {}
    for name, frames in results.items():
        (folder / "detections.json").write_text(json.dumps(frames))
        score = [sys.executable, data / "score.py", name, folder / "truth.json", folder / "detections.json"]
        table = subprocess.run(score, check=True, capture_output=True, text=True).stdout
        print(table, end="", flush=True)
        rows = [line.split() for line in table.splitlines()]
        scores[name] = {row[0]: (float(row[1]), float(row[3])) for row in rows if row[0] in SETS}
    own, other = results.values()
    for name in SETS:
        median = lambda frames, key: statistics.median(frame[key] for frame in frames if frame["set"] == name and frame[key] is not None)
        ratio = median(other, "ms") / median(own, "ms")
        print(f"{name:8s} {ratio:5.1f} times as fast; a window takes {median(own, 'window_ms'):.2f} ms", flush=True)
    return scores


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("--seeds", type=int, nargs="+", default=[7, 8, 9])
    arguments.add_argument("--frames", type=int, default=30)
    arguments.add_argument("--distortion", type=float, metavar="K1")
    arguments.add_argument("--rolling-shutter", type=float, nargs=2, metavar=("RIGHT", "DOWN"))
    arguments = arguments.parse_args()
    cameras = {}
    if arguments.distortion is not None:
        cameras[f"distortion {arguments.distortion}"] = Lens(arguments.distortion)
    if arguments.rolling_shutter is not None:
        right, down = arguments.rolling_shutter
        cameras[f"rolling shutter {right:g} {down:g}"] = RollingShutter(right, down)
    data = pathlib.Path(os.environ["POSEBRIDGE_DATA"]) / "tag-images"
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as folder:
            drawn = pathlib.Path(folder) / "drawn"
            make = [sys.executable, data / "make.py", drawn, "--seed", str(seed), "--frames", str(arguments.frames)]
            subprocess.run(make, check=True, stdout=subprocess.DEVNULL)
            print(f"\nseed {seed}", flush=True)
            plain = compare(drawn, data)
            for kind, camera in cameras.items():
                taken = pathlib.Path(folder) / "taken"
                taken.mkdir(exist_ok=True)
                take_pictures(camera, drawn, taken)
                print(f"\nseed {seed}, {kind}", flush=True)
                for detector, scores in compare(taken, data).items():
                    print(f"{detector}: recall and corners, px, without and with it")
                    for name, (recall, rms) in scores.items():
                        before = plain[detector][name]
                        print(f"{name:8s} {before[0]:.3f} {recall:.3f}   {before[1]:.3f} {rms:.3f}", flush=True)


if __name__ == "__main__":
    main()
