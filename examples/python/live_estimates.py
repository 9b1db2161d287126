#!/usr/bin/env python3
"""Reads the estimates of a running station with pymavlink, as they come.

    posebridge run --gcs udp://127.0.0.1:14550           in one terminal
    python3 live_estimates.py udpin:127.0.0.1:14550      in another; a second argument says after how many to stop

In a notebook: `from live_estimates import estimates`, then `for estimate in estimates("udpin:127.0.0.1:14550"): ...`
"""
import itertools
import math
import os
import sys

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402

ESTIMATOR = 197


def estimates(address):
    """Time of the station's clock (s), x, y (m) and heading (rad) in the arena, sigma of x (m)."""
    link = mavutil.mavlink_connection(address, source_system=255, source_component=190)
    every_second = mavutil.periodic_event(1.0)
    while True:
        # A station that waits at a UDP port learns from this where we are.
        if every_second.trigger():
            link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        message = link.recv_match(type="ODOMETRY", blocking=True, timeout=1.0)
        if message is None or message.get_srcComponent() != ESTIMATOR:
            continue
        w, _, _, z = message.q
        # LOCAL_FRD has y to the right and yaw clockwise; the arena has both the other way round.
        yield {
            "t_s": 1e-6 * message.time_usec,
            "x_m": message.x,
            "y_m": -message.y,
            "heading_rad": -math.atan2(2.0 * w * z, 1.0 - 2.0 * z * z),
            "x_sigma_m": math.sqrt(message.pose_covariance[0]),
        }


def main(address, count=None):
    for estimate in itertools.islice(estimates(address), int(count) if count else None):
        print("  ".join(f"{name} {value:.4f}" for name, value in estimate.items()), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
