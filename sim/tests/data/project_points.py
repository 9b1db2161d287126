#!/usr/bin/env python3
"""Writes projected_points.json: pixels of points in the arena, by OpenCV's projectPoints, for rendered cameras.

The camera is turned by rotations one after the other, and not by the directions of its axes as in the renderer.
Made with opencv-python-headless 5.0 and numpy 2: python3 project_points.py > projected_points.json
"""

import json

import cv2
import numpy as np

CAMERAS = [
    {"tilt_deg": 30.0, "azimuth_deg": 90.0, "radial": [-0.08, 0.02]},
    {"tilt_deg": 0.0, "azimuth_deg": 0.0, "radial": [0.0, 0.0]},
    {"tilt_deg": 47.0, "azimuth_deg": -160.0, "radial": [0.11, -0.07], "x_m": 1.5, "y_m": 0.7, "height_m": 1.9},
    {"tilt_deg": 12.0, "azimuth_deg": 23.0, "radial": [-0.25, 0.09], "x_m": -0.2, "y_m": 0.1, "height_m": 2.1,
     "width_px": 1280, "height_px": 720, "focal_px": 950.0, "axis_offset_px": [7.5, -12.25]},
]
DEFAULTS = {"x_m": 0.5, "y_m": -0.95, "height_m": 2.5, "width_px": 640, "height_px": 480, "focal_px": 600.0,
            "axis_offset_px": [0.0, 0.0]}


def turn(axis, degrees):
    vector = np.zeros(3)
    vector[axis] = np.radians(degrees)
    return cv2.Rodrigues(vector)[0]


def main():
    random = np.random.default_rng(4)
    cases = []
    for change in CAMERAS:
        camera = DEFAULTS | change
        # Straight down, the picture's upper edge to the north: right is east, down is south, ahead is down.
        to_arena = np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
        # About its own right axis, then about the vertical of the arena.
        to_arena = turn(2, camera["azimuth_deg"] - 90) @ to_arena @ turn(0, camera["tilt_deg"])
        position = np.array([camera["x_m"], camera["y_m"], camera["height_m"]])
        right, down = camera["axis_offset_px"]
        matrix = np.array([[camera["focal_px"], 0, (camera["width_px"] - 1) / 2 + right],
                           [0, camera["focal_px"], (camera["height_px"] - 1) / 2 + down], [0, 0, 1]])
        lens = np.array([*camera["radial"], 0.0, 0.0])
        # Points in the cone that the camera sees.
        ahead = to_arena @ np.array([0, 0, 1.0])
        foot = position - ahead * position[2] / ahead[2]
        points = foot + random.uniform(-0.6, 0.6, (12, 3)) * np.array([1, 1, 0]) + np.array([0, 0, 1]) * random.choice(
            [0.0, 0.085, 0.3], (12, 1))
        from_arena = to_arena.T
        pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(from_arena)[0], -from_arena @ position, matrix, lens)
        cases.append({"camera": camera, "points_m": points.round(9).tolist(),
                      "pixels": pixels.reshape(-1, 2).round(6).tolist()})
    print(json.dumps(cases, indent=None, separators=(",", ":")).replace('{"camera"', '\n{"camera"'))


main()
