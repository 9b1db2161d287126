"""Our tag detector beside AprilTag 3, the C library, on photographs: those of public packages, or files and folders.

    python3 -m venv target/tag-bench && target/tag-bench/bin/pip install numpy opencv-python-headless pupil-apriltags
    target/tag-bench/bin/python benches/tag_photographs.py [PICTURE or FOLDER ...]

Without arguments the pictures of PACKAGES are downloaded into a temporary folder: photographs of a telephone (94), of a webcam (10) and of
a robot contest (3), drawn rooms (36), and three drawings. A row is printed for each picture in which the two differ, or for each with
--all: the ids that ours finds, those of the C library at quad_decimate 1 that are missing in ours (its side in pixels and its decision
margin behind), ours that are extra, the largest distance of a corner, and the CPU milliseconds of ours and of the C library at 1 and 2.
Ends with failure if ids differ.

Our detector reports an id once in a picture. Where a picture has several tags of one id, ours is compared with the nearest of the C
library, and is extra if none is there.
"""

import argparse
import collections
import json
import pathlib
import statistics
import subprocess
import sys
import tarfile
import tempfile
import time

import cv2
import numpy
from pupil_apriltags import Detector

ROOT = pathlib.Path(__file__).resolve().parent.parent
PACKAGES = [("pypi", "apriltags==0.0.7"), ("pypi", "april-vision==3.1.0"), ("npm", "@monumental-works/apriltag-node@1.3.0")]
SUFFIXES = {".jpg", ".jpeg", ".png", ".pgm"}
DECIMATES = [1.0, 2.0]
# Each picture is searched so often; the least time counts.
REPEATS = 3
# Corners that are farther apart are those of two tags, in sides.
SAME_TAG = 0.3
# The C library counts from the corner of the first pixel, ours from its centre.
HALF_PIXEL = 0.5


def download(folder):
    for registry, package in PACKAGES:
        into = folder / "".join(c if c.isalnum() else "-" for c in package)
        into.mkdir()
        if registry == "pypi":
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", "--dest", into, package]
            subprocess.run(command, check=True)
        else:
            subprocess.run(["npm", "pack", "--silent", package], cwd=into, check=True, stdout=subprocess.DEVNULL)
        [archive] = into.iterdir()
        with tarfile.open(archive) as files:
            files.extractall(into, filter="data")


def pictures_in(paths):
    for path in paths:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix.lower() in SUFFIXES:
                grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
                if grey is not None:
                    yield file, grey


def ours(pictures):
    with tempfile.TemporaryDirectory() as folder:
        sets = []
        for number, (_, grey) in enumerate(pictures):
            (pathlib.Path(folder) / f"{number}.raw").write_bytes(grey.tobytes() * REPEATS)
            sets.append(f"{number}:{grey.shape[1]}x{grey.shape[0]}")
        command = ["cargo", "run", "--quiet", "--release", "--package", "posebridge-vision", "--example", "detect_tags", "--"]
        frames = json.loads(subprocess.run([*command, folder, *sets], cwd=ROOT, check=True, capture_output=True).stdout)
    results = [([], float("inf"))] * len(pictures)
    for frame in frames:
        tags = [(id, numpy.array(corners)) for id, corners in frame["d"]]
        results[int(frame["set"])] = (tags, min(frame["ms"], results[int(frame["set"])][1]))
    return results


def april_tag(pictures, decimate):
    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=decimate)
    for _, grey in pictures:
        ms = float("inf")
        for _ in range(REPEATS):
            begun = time.process_time()
            tags = detector.detect(grey)
            ms = min(ms, 1e3 * (time.process_time() - begun))
        yield tags, ms


def distance(one, other):
    """The largest distance of a corner, whichever corner comes first."""
    orders = [numpy.roll(order, turn, axis=0) for order in (other, other[::-1]) for turn in range(4)]
    return min(numpy.linalg.norm(one - order, axis=1).max() for order in orders)


def side_px(corners):
    return numpy.linalg.norm(corners - numpy.roll(corners, 1, axis=0), axis=1).mean()


def ids(tags):
    return " ".join(map(str, sorted(tags))) or "-"


def main():
    arguments = argparse.ArgumentParser()
    arguments.add_argument("paths", type=pathlib.Path, nargs="*", metavar="PICTURE or FOLDER")
    arguments.add_argument("--all", action="store_true", help="a row for each picture")
    arguments = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        if not arguments.paths:
            download(folder)
        pictures = list(pictures_in(arguments.paths or [folder]))
    if not pictures:
        sys.exit("there are no pictures")
    own = ours(pictures)
    april = [list(april_tag(pictures, decimate)) for decimate in DECIMATES]
    count, distances, differ = collections.Counter(), [], 0
    print("picture | ours | missing | extra | corner px | ms: ours, C 1, C 2")
    for (file, _), (tags, ms), (full, full_ms), (half, half_ms) in zip(pictures, own, *april):
        names = dict(tags)
        missing, nearest = {}, {}
        for tag in full:
            if tag.tag_id not in names:
                missing[tag.tag_id] = f"{tag.tag_id} ({side_px(tag.corners):.0f} px, margin {tag.decision_margin:.0f}, {tag.hamming} wrong)"
                continue
            apart = distance(names[tag.tag_id], tag.corners - HALF_PIXEL)
            if apart < SAME_TAG * side_px(tag.corners):
                nearest[tag.tag_id] = min(apart, nearest.get(tag.tag_id, apart))
        extra = names.keys() - nearest.keys()
        distances += nearest.values()
        differ += bool(missing or extra)
        count.update(ours=len(names), full=len({tag.tag_id for tag in full}), half=len({tag.tag_id for tag in half}))
        count.update(missing=len(missing), extra=len(extra))
        if arguments.all or missing or extra:
            apart = f"{max(nearest.values()):.2f}" if nearest else "-"
            lost = ", ".join(missing.values()) or "-"
            times = f"{ms:.1f}, {full_ms:.1f}, {half_ms:.1f}"
            print(f"{file.name} | {ids(names)} | {lost} | {ids(extra)} | {apart} | {times}", flush=True)
    print(f"{len(pictures)} pictures, {differ} differ; ids: ours {count['ours']}, C library {count['full']}, at decimate 2 {count['half']};"
          f" missing {count['missing']}, extra {count['extra']}")
    if distances:
        print("largest distance of a corner, px: "
              + ", ".join(f"{share} % {numpy.percentile(distances, share):.2f}" for share in (50, 90, 99, 100)))
    times = [statistics.median(ms for _, ms in results) for results in (own, *april)]
    print(f"median CPU ms: ours {times[0]:.1f}, C library {times[1]:.1f}, at decimate 2 {times[2]:.1f}")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
