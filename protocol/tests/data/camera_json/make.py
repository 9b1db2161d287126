#!/usr/bin/env python3
"""Writes lines.jsonl and meanings.json: lines of cameras as Python's json module writes them, and what they mean by
docs/protocols/camera-json.md. The meanings are computed here and by nothing of ours.

    python3 make.py
"""
import json
import math
import pathlib

CAMERAS = {"camera": "1/100", "north": "1/101"}


def meaning(said):
    who = CAMERAS[said.get("camera", "camera")]
    if "time_answer" in said:
        nanos = round(said["time_s"] * 1e9) if "time_s" in said else said["time_us"] * 1000
        return f"{who}: answer {said['time_answer']} {nanos}"
    micros = round(said["exposed_s"] * 1e6) if "exposed_s" in said else said["exposed_us"]
    x, y, heading = said["x_m"], said["y_m"], said.get("heading_rad")
    if "heading_deg" in said:
        heading = math.radians(said["heading_deg"])
    if said.get("space") == "ned":
        x, y = y, x
        heading = None if heading is None else math.pi / 2 - heading
    if heading is not None:
        heading = math.atan2(math.sin(heading), math.cos(heading))
    sigmas = "-"
    if "sigma_m" in said:
        turn = said.get("sigma_heading_rad")
        if "sigma_heading_deg" in said:
            turn = math.radians(said["sigma_heading_deg"])
        sigmas = f"{said['sigma_m']:.6f} " + ("inf" if turn is None else f"{turn:.6f}")
    shown = "-" if heading is None else f"{heading:.6f}"
    return f"{who}: {micros} us {x:.6f} {y:.6f} {shown} {sigmas} {said.get('reset_counter', 0)}"


SAID = [
    {"exposed_s": 1234.567891, "x_m": 1.25, "y_m": -0.5},
    {"camera": "north", "exposed_us": 1767225600123456, "x_m": 1e-3, "y_m": 2, "heading_rad": 3.5},
    {"exposed_s": 0, "x_m": -0.0, "y_m": 7, "heading_deg": -190.25, "sigma_m": 0.004, "sigma_heading_deg": 0.5},
    {"camera": "north", "exposed_s": 1767225600.25, "x_m": 3.5, "y_m": 4.5, "heading_rad": 0.25, "space": "ned",
     "reset_counter": 255, "quality": 99.5, "id": {"family": "tag36h11", "numbers": [1, 2, None]}},
    {"exposed_us": 5, "x_m": 1.0, "y_m": 1.0, "sigma_m": 2.5e-3, "n\u00f6m.": "\u2603 \"quoted\" \n"},
    {"time_answer": 123456789012, "time_s": 1234.5},
    {"camera": "north", "time_answer": -1, "time_us": 1767225600123456},
]

here = pathlib.Path(__file__).parent
with open(here / "lines.jsonl", "w") as lines:
    for said in SAID:
        lines.write(json.dumps(said) + "\n")
with open(here / "meanings.json", "w") as meanings:
    json.dump([meaning(said) for said in SAID], meanings, indent=1)
    meanings.write("\n")
