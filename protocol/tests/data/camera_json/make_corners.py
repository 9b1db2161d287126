#!/usr/bin/env python3
"""Writes corners.jsonl and corner_poses.json: lines of a camera that says where the corners of tags are in its picture, and where
these tags are. The projection is computed here, by the formulae of docs/protocols/camera-json.md and by nothing of ours.

    python3 make_corners.py
"""
import json
import math
import pathlib

SIDE, HEIGHT = 0.08, 0.085
FOCAL, CENTRE, RADIAL = (900.0, 905.0), (639.5, 359.5), (-0.2, 0.05)
POSITION, TILT, AZIMUTH = (0.4, -0.3, 2.5), math.radians(30), math.radians(70)


def axes():
    """Of the camera in the arena: right, down, ahead."""
    ahead = (math.sin(TILT) * math.cos(AZIMUTH), math.sin(TILT) * math.sin(AZIMUTH), -math.cos(TILT))
    right = (math.sin(AZIMUTH), -math.cos(AZIMUTH), 0.0)
    down = tuple(ahead[(k + 1) % 3] * right[(k + 2) % 3] - ahead[(k + 2) % 3] * right[(k + 1) % 3] for k in range(3))
    return right, down, ahead


def quaternion(right, down, ahead):
    """Of the matrix with these columns, w first; its trace may be negative, so by the largest part."""
    m = [[right[k], down[k], ahead[k]] for k in range(3)]
    squares = [1 + m[0][0] + m[1][1] + m[2][2], 1 + m[0][0] - m[1][1] - m[2][2],
               1 - m[0][0] + m[1][1] - m[2][2], 1 - m[0][0] - m[1][1] + m[2][2]]
    w, x, y, z = (math.sqrt(max(0, square)) / 2 for square in squares)
    x, y, z = (math.copysign(part, sign) for part, sign in
               ((x, m[2][1] - m[1][2]), (y, m[0][2] - m[2][0]), (z, m[1][0] - m[0][1])))
    return [w, x, y, z]


def pixel(point):
    seen = [sum(axis[k] * (point[k] - POSITION[k]) for k in range(3)) for axis in axes()]
    x, y = seen[0] / seen[2], seen[1] / seen[2]
    square = x * x + y * y
    stretch = 1 + RADIAL[0] * square + RADIAL[1] * square * square
    return [FOCAL[0] * x * stretch + CENTRE[0], FOCAL[1] * y * stretch + CENTRE[1]]


def corners(x, y, heading):
    """Upper left first, clockwise; the tag's way up is the robot's ahead."""
    cosine, sine = math.cos(heading), math.sin(heading)
    places = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    return [pixel((x + SIDE / 2 * (cosine * ahead - sine * left), y + SIDE / 2 * (sine * ahead + cosine * left), HEIGHT))
            for ahead, left in places]


POSES = [(0.9, 0.9, 0.3), (0.2, 1.4, -2.9), (1.1, 0.2, 1.6), (0.6, 1.9, -1.2)]
here = pathlib.Path(__file__).parent
with open(here / "corners.jsonl", "w") as lines:
    for x, y, heading in POSES:
        seen = [[round(value, 5) for value in corner] for corner in corners(x, y, heading)]
        lines.write(json.dumps({"tag": 7, "picture_px": [1280, 720], "corners_px": seen, "exposed_ago_us": [0, 2000]}) + "\n")
camera = {"focal_px": FOCAL, "centre_px": CENTRE, "radial": RADIAL, "position_m": POSITION, "rotation": quaternion(*axes())}
with open(here / "corner_poses.json", "w") as poses:
    json.dump({"camera": camera, "poses": POSES}, poses, indent=1)
    poses.write("\n")
