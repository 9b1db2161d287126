#!/usr/bin/env python3
"""The same as camera_fixes.py with a real camera: an AprilTag on the robot, found by OpenCV 4.7 or later (docs/protocols/camera-json.md).

    pip install opencv-python
    python3 camera_fixes_opencv.py STATION_HOST:PORT [CAMERA]

The floor is measured once: FLOOR has four points of the image and where they are in the arena.
"""
import math, sys

import cv2
import numpy

from camera_fixes import Station, address, clock

# Tag 0 of the family 36h11, glued on with its upper side to the front of the robot.
TAG, FAMILY = 0, cv2.aruco.DICT_APRILTAG_36h11
# Pixels, then metres in the arena, in the same order: four marks on the floor at the height of the tag, as far apart as can be.
FLOOR = ([[70, 440], [570, 440], [570, 40], [70, 40]], [[0.0, 0.0], [2.0, 0.0], [2.0, 1.6], [0.0, 1.6]])
# One standard deviation each; stand the robot still and look how much they scatter.
SIGMAS = {"sigma_m": 0.003, "sigma_heading_deg": 0.5}

DETECTOR = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(FAMILY))
ARENA_FROM_PIXELS = cv2.getPerspectiveTransform(*(numpy.float32(points) for points in FLOOR))

def fix(image):
    """Pose of the tag in the arena, or nothing."""
    corners_px, numbers, _ = DETECTOR.detectMarkers(image)
    for corners, number in zip(corners_px, [] if numbers is None else numbers.ravel()):
        if number == TAG:
            # Clockwise in the image from the tag's upper left: front left, front right, rear right, rear left.
            front_left, front_right, rear_right, rear_left = cv2.perspectiveTransform(corners, ARENA_FROM_PIXELS)[0].tolist()
            middle = [sum(values) / 4.0 for values in zip(front_left, front_right, rear_right, rear_left)]
            forward = [fl + fr - rr - rl for fl, fr, rr, rl in zip(front_left, front_right, rear_right, rear_left)]
            return {"x_m": middle[0], "y_m": middle[1], "heading_rad": math.atan2(forward[1], forward[0])}
    return None

def main():
    station = Station(address(sys.argv[1]), "overhead")
    camera = cv2.VideoCapture(int(sys.argv[2]) if len(sys.argv) > 2 else 0)
    # Near the exposure, before the image is fetched and searched.
    while camera.grab():
        exposed_s = clock()
        pose = fix(camera.retrieve()[1])
        if pose is not None:
            station.send(exposed_s=exposed_s, **SIGMAS, **pose)

if __name__ == "__main__":
    main()
