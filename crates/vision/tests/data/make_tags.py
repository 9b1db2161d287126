"""Draws the pictures of this folder with OpenCV, whose tags are another implementation's: python3 make_tags.py

Each NAME.pgm has one tag36h11 tag in perspective on clutter, blurred and noisy; plain.jpg is one of them in colour. corners.txt has its name, id and corners (x and y of the
upper left one in OpenCV's way up, then clockwise; the centre of the first pixel is 0, 0).
"""

import cv2
import numpy as np

SIZE = (160, 120)
OVERSAMPLING = 16
QUIET = 1
# Name, id, corners of the black rim, black, white, blur, noise, all in pixels and grey levels.
PICTURES = [
    ("plain", 0, [(41.3, 22.6), (118.9, 31.2), (109.4, 102.8), (36.7, 92.1)], 15, 220, 0.7, 3),
    ("small", 586, [(70.2, 50.4), (92.1, 47.7), (95.3, 69.8), (72.6, 73.1)], 20, 200, 0.6, 3),
    ("oblique", 123, [(30.2, 60.4), (75.8, 35.6), (128.4, 48.2), (84.3, 78.9)], 15, 220, 0.6, 3),
    ("dark", 300, [(45.6, 25.3), (101.8, 20.9), (108.2, 80.1), (50.4, 85.7)], 25, 75, 0.8, 7),
]


def draw(generator, number, corners, black, white, blur, noise):
    width, height = (OVERSAMPLING * side for side in SIZE)
    picture = np.full((height, width), (black + 2 * white) / 3, np.float32)
    for _ in range(6):
        first, second = (tuple(int(value) for value in generator.integers(0, [width, height])) for _ in range(2))
        cv2.line(picture, first, second, float(generator.uniform(black, white)), int(generator.integers(8, 60)))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    modules = np.pad(cv2.aruco.generateImageMarker(dictionary, number, 8, borderBits=1), QUIET, constant_values=255)
    # A pixel of the large picture is a sixteenth of one; centres are at whole numbers in both.
    to_large = lambda value: OVERSAMPLING * (value + 0.5) - 0.5
    source = np.float32([(QUIET + u - 0.5, QUIET + v - 0.5) for u, v in [(0, 0), (8, 0), (8, 8), (0, 8)]])
    target = np.float32([[to_large(value) for value in corner] for corner in corners])
    perspective = cv2.getPerspectiveTransform(source, target)
    tag = cv2.warpPerspective(np.float32(modules), perspective, (width, height), flags=cv2.INTER_NEAREST)
    whole = cv2.warpPerspective(np.ones_like(modules), perspective, (width, height), flags=cv2.INTER_NEAREST)
    picture = np.where(whole > 0, black + (white - black) * tag / 255, picture)
    picture = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)
    picture = cv2.GaussianBlur(picture, (0, 0), blur) + generator.normal(0, noise, picture.shape)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


def main():
    generator = np.random.default_rng(1)
    with open("corners.txt", "w") as listing:
        for name, number, corners, *look in PICTURES:
            picture = draw(generator, number, corners, *look)
            cv2.imwrite(f"{name}.pgm", picture)
            if name == "plain":
                cv2.imwrite(f"{name}.jpg", cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])
            print(name, number, *(value for corner in corners for value in corner), file=listing)


if __name__ == "__main__":
    main()
