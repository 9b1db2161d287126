"""Tries an installed program: its version, the recording that comes with it, its page. try.sh runs it."""

import json
import re
import signal
import subprocess
import sys
import threading
import tomllib
import urllib.request
from pathlib import Path

# Of a step; each takes less than a second on an idle computer.
LIMIT_S = 60

# Mean over six runs with nominal geometry: tests/data/optiodom/README.md.
DEAD_RECKONING_RMS_M = 0.0291


def check_version(program: str, manifest: str) -> None:
    version = tomllib.loads(Path(manifest).read_text())["workspace"]["package"]["version"]
    printed = subprocess.check_output([program, "--version"], text=True, timeout=LIMIT_S).strip()
    if printed != f"posebridge {version}":
        sys.exit(f"--version prints {printed!r}, Cargo.toml says {version}")
    print(printed)


def check_replay(program: str, descriptor: str, data: str) -> None:
    command = [program, "replay", descriptor, "--data", data, "--json"]
    replayed = json.loads(subprocess.check_output(command, timeout=LIMIT_S))
    odometry = next(estimator for estimator in replayed["estimators"] if estimator["name"] == "odometry")
    error_m = odometry["position_rms_m"]
    if round(error_m, 4) != DEAD_RECKONING_RMS_M:
        sys.exit(f"replay: dead reckoning is off by {error_m} m, published: {DEAD_RECKONING_RMS_M}")
    print(f"replay: {replayed['observations']} observations, dead reckoning off by {error_m:.4f} m")


def check_page(program: str) -> None:
    command = [program, "run", "--dashboard", "127.0.0.1:0", "--out", "run"]
    run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    # A program that is silent for too long ends, and so does the reading of its output.
    limit = threading.Timer(LIMIT_S, run.kill)
    limit.start()
    try:
        printed = ""
        while not (address := re.search(r"dashboard: (http://\S+)", printed)):
            line = run.stdout.readline()
            if not line:
                sys.exit(f"run prints no address of its page:\n{printed}")
            printed += line
        # Loopback, whatever proxy the environment names.
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(address[1], timeout=LIMIT_S) as answer:
            page = answer.read()
        if b"<html" not in page:
            sys.exit(f"{address[1]} answers {answer.status} without a page")
        run.send_signal(signal.SIGINT)
        printed, _ = run.communicate()
    finally:
        limit.cancel()
        run.kill()
    if run.returncode != 0:
        sys.exit(f"run ends with {run.returncode} after SIGINT:\n{printed}")
    print(f"page: {answer.status}, {len(page)} bytes; SIGINT: exit code 0")


def main() -> None:
    manifest, program, descriptor, data = sys.argv[1:]
    check_version(program, manifest)
    check_replay(program, descriptor, data)
    check_page(program)


main()
