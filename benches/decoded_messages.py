"""Every field of a telemetry log decoded by posebridge and by pymavlink: value by value the same, and how long each takes.

    python3 -m venv target/logs-bench && target/logs-bench/bin/pip install pymavlink
    target/logs-bench/bin/python benches/decoded_messages.py PROGRAM LOG.tlog[.gz] [--rounds 5]

pymavlink reads with its stock dialect `ardupilotmega` and turns each message into a dictionary; posebridge writes one CSV file for each kind of
message. Both times are CPU seconds of a whole process, user and system, the least of some rounds.
"""

import argparse
import collections
import csv
import gzip
import math
import os
import pathlib
import resource
import shutil
import struct
import subprocess
import sys
import tempfile

os.environ["MAVLINK20"] = "1"
DECODE = (
    "import sys\n"
    "from pymavlink import mavutil\n"
    "log = mavutil.mavlink_connection(sys.argv[1], dialect='ardupilotmega')\n"
    "count = 0\n"
    "while (message := log.recv_msg()) is not None:\n"
    "    message.to_dict()\n"
    "    count += 1\n"
)


def cpu_s(rounds, command):
    times = []
    for _ in range(rounds):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command(), check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def agrees(kind, ours, theirs):
    if kind == "char":
        text = theirs.decode("utf-8", "replace").rstrip("\0") if isinstance(theirs, bytes) else theirs
        return ours == "".join(one if one.isprintable() else "?" for one in text)
    if kind in ("float", "double"):
        number = float(ours)
        if kind == "float":
            number = struct.unpack("<f", struct.pack("<f", number))[0]
        return number == theirs or math.isnan(number) and math.isnan(theirs)
    return int(ours) == theirs


def compare(log, folder):
    """How many fields were compared, and which differ."""
    from pymavlink import mavutil

    reader = mavutil.mavlink_connection(str(log), dialect="ardupilotmega")
    tables, compared, differing, extra = {}, 0, collections.Counter(), collections.Counter()
    while (message := reader.recv_msg()) is not None:
        name = message.get_type()
        if message.get_msgId() < 0:
            continue
        if name not in tables:
            tables[name] = csv.DictReader(open(folder / f"{name}.csv", newline=""))
        row = {key.split(" ")[0]: value for key, value in next(tables[name]).items()}
        # A float of seconds since 1970 has not all microseconds.
        heads = ((int(row["_time"]) * 1e-6, message._timestamp), (int(row["_system"]), message.get_srcSystem()),
                 (int(row["_component"]), message.get_srcComponent()), (int(row["_sequence"]), message.get_seq()))
        for ours, theirs in heads:
            compared += 1
            if abs(ours - theirs) > 1e-6:
                differing[name, "head"] += 1
        for field, kind in zip(message.fieldnames, message.fieldtypes):
            value = getattr(message, field)
            elements = value if isinstance(value, (list, tuple)) else [value]
            for index, element in enumerate(elements):
                key = f"{field}[{index}]" if isinstance(value, (list, tuple)) else field
                compared += 1
                if not agrees(kind.removesuffix("_mavlink_version"), row[key], element):
                    differing[name, key, row[key], repr(element)] += 1
    for name, table in tables.items():
        extra[name] = sum(1 for _ in table)
    return compared, differing, {name: count for name, count in extra.items() if count}


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("program")
    arguments.add_argument("log")
    arguments.add_argument("--rounds", type=int, default=5)
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        source, log = pathlib.Path(given.log), folder / "log.tlog"
        with (gzip.open if source.suffix == ".gz" else open)(source, "rb") as packed, open(log, "wb") as out:
            shutil.copyfileobj(packed, out)
        exports = iter(range(given.rounds))
        # Each into a folder of its own, as a first export: pymavlink writes nothing, and removes nothing that it wrote before.
        to = lambda: folder / f"round-{next(exports)}"
        ours_s = cpu_s(given.rounds, lambda: [given.program, "export", str(log), "--messages", "--format", "csv", "--out", str(to())])
        theirs_s = cpu_s(given.rounds, lambda: [sys.executable, "-c", DECODE, str(log)])
        compared, differing, extra = compare(log, folder / "round-0" / "log-messages")
        print(f"{source.name}: {compared} values compared, {sum(differing.values())} differ, {extra or 'no'} rows beyond pymavlink's")
        for what, count in differing.most_common(10):
            print("  ", count, what)
        print(f"posebridge {ours_s:.3f} s of CPU, pymavlink {theirs_s:.3f} s: {theirs_s / ours_s:.0f} times")
        if differing or extra:
            sys.exit("the values are not the same")


main()
