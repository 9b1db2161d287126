#!/usr/bin/env python3
"""Tells a station where an overhead camera sees the robot (docs/protocols/camera-json.md). Needs nothing but Python.

    python3 camera_fixes.py STATION_HOST:PORT IMAGES_HOST:PORT [SECONDS_LATE]

The images are the tag's corners as `posebridge sim --images-listen` gives them; camera_fixes_opencv.py has a real camera instead.
"""
import json, math, socket, sys, threading, time

def address(text):
    host, port = text.rsplit(":", 1)
    return host, int(port)

def clock():
    """The camera's own clock, in seconds: any that runs forward. This one begins somewhere and is 200 ppm fast."""
    return 1000.0 + 1.0002 * time.monotonic()

def fix(corners_px):
    """Pose from the corners left rear, right rear, right front, left front: 4 mm a pixel, the arena's origin at (320, 240)."""
    corners = [(0.004 * (u - 320.0), 0.004 * (240.0 - v)) for u, v in corners_px]
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners
    heading = math.atan2(y2 + y3 - y0 - y1, x2 + x3 - x0 - x1)
    return {"x_m": sum(x for x, _ in corners) / 4.0, "y_m": sum(y for _, y in corners) / 4.0, "heading_rad": heading}

class Station:
    """The link: fixes and answers go there, questions for the time and complaints come back."""

    def __init__(self, place, camera):
        self.place, self.camera = place, camera
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.send(takes_requests=False)
        threading.Thread(target=self.listen, daemon=True).start()

    def send(self, **said):
        self.socket.sendto(json.dumps({"camera": self.camera, **said}).encode() + b"\n", self.place)

    def listen(self):
        while True:
            for line in self.socket.recv(2048).splitlines():
                said = json.loads(line)
                if "time_request" in said:
                    self.send(time_answer=said["time_request"], time_s=clock())
                elif "error" in said:
                    print(said, file=sys.stderr)

def main():
    station = Station(address(sys.argv[1]), "overhead")
    seconds_late = float(sys.argv[3]) if len(sys.argv) > 3 else 0.0
    for line in socket.create_connection(address(sys.argv[2])).makefile():
        said = {"exposed_s": clock(), "sigma_m": 0.003, "sigma_heading_deg": 0.5, **fix(json.loads(line)["corners_px"])}
        # What a detector needs for an image; meanwhile the next ones come.
        threading.Timer(seconds_late, station.send, kwargs=said).start()

if __name__ == "__main__":
    main()
