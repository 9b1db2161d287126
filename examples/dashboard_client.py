"""Prints what the station believes, five times a second; with further words it gives a command first. Standard library only.

python3 examples/dashboard_client.py http://127.0.0.1:4680 reset-pose
"""
import json, sys, time, urllib.request


def ask(address, path, command=None):
    body = json.dumps(command).encode() if command else None
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(address.rstrip("/") + path, body, headers)
    return json.load(urllib.request.urlopen(request, timeout=5))


address = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:4680"
if len(sys.argv) > 2:
    print(ask(address, "/v1/commands", {"command": sys.argv[2]}))
while True:
    for robot in ask(address, "/v1/state")["robots"]:
        if pose := robot["estimate"]:
            print(robot["id"], f"x {pose['x_m']:.3f} m, y {pose['y_m']:.3f} m, heading {pose['heading_rad']:.3f} rad", flush=True)
    time.sleep(0.2)
