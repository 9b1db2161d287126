"""The files of `posebridge dialect` in the programs that they are for: each must read and write what mavgen's module of our definition does.

The frames are those of a drive, from the telemetry log that we wrote, and some of mavgen's module: every message, with fields at their limits and
with zeros at the end, which MAVLink 2 leaves out.
"""

import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import unittest

import posebridge_dialect as pb
from drives import finished_drive
from harness import output_of, posebridge

EDGES = [
    pb.MAVLink_pb_wheel_ticks_message(4294967295, -2147483648, 2147483647, 3),
    pb.MAVLink_pb_wheel_ticks_message(5, 0, 0, 0),
    pb.MAVLink_pb_inertial_message(1, -2147483648, -32768, 32767, -2, 7),
    pb.MAVLink_pb_planar_pose_message(7, 1.5, -2.25, 3.125, 0.1, -0.2, [0.5, 0.25, -0.125, 1e-9, 1e9, 2.0], 65535, 255, 31, 4000000001),
    pb.MAVLink_pb_planar_pose_message(8, 0.0, 0.0, 0.0, 0.0, 0.0, [0.0] * 6, 0, 0, 0),
    pb.MAVLink_pb_fusion_health_message(9, [0.5, -0.25, 0.125], 1.75, 65535, 1, 65534, 9, 6),
    pb.MAVLink_pb_robot_description_message(0.028, 0.0281, 0.112, 360.0, 0.01, 0.001, b"sixteen letters!"),
    pb.MAVLink_pb_robot_description_message(0.028, 0.0281, 0.112, 360.0, 0.0, 0.0, b"r"),
]
ATTRIBUTES = (
    "id", "msgname", "fieldnames", "ordered_fieldnames", "fieldtypes", "fieldunits_by_name", "native_format", "orders", "lengths",
    "array_lengths", "crc_extra", "instance_field", "instance_offset",
)
IN_PYMAVLINK = f"""
import json
import sys

from pymavlink import mavutil
import posebridge_mavlink

classes = posebridge_mavlink.register()
assert posebridge_mavlink.register() == classes
log = mavutil.mavlink_connection("frames.tlog")
attributes = {{name: {{key: str(getattr(made, key)) for key in {ATTRIBUTES}}} for name, made in classes.items()}}
print(json.dumps({{name: {{**of, "unpacker": classes[name].unpacker.format}} for name, of in attributes.items()}}))
while (message := log.recv_match()) is not None:
    if message.get_type() == "BAD_DATA" or message.get_type().startswith("UNKNOWN"):
        sys.exit(f"not understood: {{message}}")
    if message.get_type() in classes:
        writer = mavutil.mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
        writer.seq = message.get_seq()
        print(json.dumps([message.get_msgbuf().hex(), message.to_dict(), message.pack(writer).hex()]))
"""
# The linktype of packets that begin with their IP header.
RAW_IP = 101
# tshark prints six digits of a 32-bit float.
TSHARK_PRECISION = 5e-6


def ipv4(payload, port=14550):
    """A datagram."""
    udp = struct.pack(">HHHH", 40000, port, 8 + len(payload), 0)
    return struct.pack(">BBHHHBBHII", 0x45, 0, 28 + len(payload), 0, 0, 64, 17, 0, 0x7F000001, 0x7F000001) + udp + payload


class Dialect(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.folder = folder.name
        for tool in ("python", "wireshark", "c", "xml"):
            posebridge(cls.folder, "dialect", "--for", tool, "--out", ".")
        with open(os.path.join(finished_drive(), "run", "recording.tlog"), "rb") as file:
            log = file.read()
        mav = pb.MAVLink(None, srcSystem=1, srcComponent=1)
        edges = []
        for mav.seq, message in enumerate(EDGES):
            edges.append(bytes(message.pack(mav)))
        last = struct.unpack_from(">Q", log)[0] + 10**9
        log += b"".join(struct.pack(">Q", last) + frame for frame in edges)
        with open(os.path.join(cls.folder, "frames.tlog"), "wb") as file:
            file.write(log)
        cls.frames, at = [], 0
        while at < len(log):
            length = 12 + log[at + 9]
            cls.frames.append(log[at + 8:at + 8 + length])
            at += 8 + length
        is_ours = [int.from_bytes(frame[7:10], "little") in pb.mavlink_map for frame in cls.frames]
        cls.own = [frame for frame, own in zip(cls.frames, is_ours) if own]
        cls.expected = [mav.decode(bytearray(frame)) for frame in cls.own]
        assert len(cls.own) > 500 and not all(is_ours), len(cls.own)

    def same(self, theirs, expected, precision=0.0):
        """The values of a message's fields, arrays flat, as texts."""
        ours = []
        for name in expected.fieldnames:
            value = getattr(expected, name)
            ours.extend(value if isinstance(value, list) else [value])
        self.assertEqual(len(theirs), len(ours))
        for text, value in zip(theirs, ours):
            if isinstance(value, float):
                self.assertTrue(math.isclose(float(text), value, rel_tol=precision), f"{expected}: {text} is not {value}")
            else:
                self.assertEqual(text, str(value), expected)

    def test_pymavlink_knows_our_messages_beside_a_stock_dialect(self):
        # As a user starts it, and with MAVLink 2 from the start; PYTHONPATH would offer mavgen's module.
        for environment in ({}, {"MAVLINK20": "1"}):
            variables = {key: value for key, value in os.environ.items() if key not in ("MAVLINK20", "PYTHONPATH")}
            done = subprocess.run(
                [sys.executable, "-c", IN_PYMAVLINK], cwd=self.folder, env={**variables, **environment}, capture_output=True, text=True,
                timeout=120)
            self.assertEqual(done.returncode, 0, done.stderr[-3000:])
            attributes, *messages = map(json.loads, done.stdout.splitlines())
            for made in pb.mavlink_map.values():
                expected = {key: str(getattr(made, key)) for key in ATTRIBUTES}
                self.assertEqual(attributes[made.msgname], {**expected, "unpacker": made.unpacker.format})
            self.assertEqual([message[0] for message in messages], [frame.hex() for frame in self.own])
            for (frame, values, packed), expected in zip(messages, self.expected):
                self.assertEqual((values, packed), (expected.to_dict(), frame))

    def test_the_c_library_reads_and_writes_our_messages(self):
        program = os.path.join(self.folder, "c_dialect")
        source = os.path.join(os.path.dirname(os.path.abspath(__file__)), "c_dialect.c")
        output_of(
            "gcc", "-O1", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-I", self.folder, "-isystem", os.environ["PEERS_C_LIBRARY"], source,
            "-o", program)
        # A user's program in C++ includes it, too.
        output_of(
            "g++", "-std=gnu++17", "-Wall", "-fsyntax-only", "-isystem", self.folder, "-isystem", os.environ["PEERS_C_LIBRARY"], "-x", "c++",
            os.path.join(self.folder, "posebridge_mavlink.h"))
        done = subprocess.run([program], input=b"".join(self.frames), capture_output=True, timeout=60)
        self.assertEqual(done.returncode, 0)
        *lines, dropped = done.stdout.decode().splitlines()
        self.assertEqual((dropped, len(lines)), ("dropped 0", len(self.frames)))
        read = [line.split(" ", 1)[1].rsplit(" ", 1) for line in lines if " " in line]
        self.assertEqual([frame for _, frame in read], [frame.hex() for frame in self.own])
        for (values, _), expected in zip(read, self.expected):
            # A name may hold a blank.
            self.same(values.split(" ", len(expected.fieldnames) - 1 if "name" in expected.fieldnames else -1), expected)

    def shown(self, packets, *columns, scripts=("posebridge_mavlink.lua",)):
        """What tshark prints of these packets: a list of the columns for each."""
        with open(os.path.join(self.folder, "frames.pcap"), "wb") as file:
            file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, RAW_IP))
            for second, packet in enumerate(packets):
                file.write(struct.pack("<IIII", second, 0, len(packet), len(packet)) + packet)
        options = [part for script in scripts for part in ("-X", f"lua_script:{script}")]
        options += [part for column in columns for part in ("-e", column)]
        printed = output_of(
            os.environ["PEERS_TSHARK"], "-r", "frames.pcap", *options, "-T", "fields", "-E", "occurrence=a", folder=self.folder,
            environment={"HOME": self.folder})
        return [line.split("\t") for line in printed.split("\n")[:-1]]

    def test_tshark_shows_our_messages(self):
        names = [(made.msgname, made.fieldnames) for made in pb.mavlink_map.values()]
        columns = [f"posebridge.{name.lower()}.{field}" for name, fields in names for field in fields]
        own, expected = self.own[-200:], self.expected[-200:]
        shown = self.shown([ipv4(frame) for frame in own], "posebridge.system", "posebridge.sequence", "posebridge.message", *columns)
        self.assertEqual(len(shown), len(own))
        for (system, sequence, message, *values), of in zip(shown, expected):
            self.assertEqual((int(system), int(sequence), int(message)), (of.get_srcSystem(), of.get_seq(), of.id))
            found = [value for value in values if value]
            self.same([part for value in found for part in value.split(",")], of, TSHARK_PRECISION)

    def test_tshark_finds_our_messages_anywhere_in_a_packet_and_beside_mavgens_dissector(self):
        frames = self.frames[-40:]
        damaged = bytearray(self.own[-4])
        damaged[11] ^= 1
        # The first one comes behind a start byte that begins no frame.
        frames.insert(0, self.own[-1])
        expected = ",".join(str(int.from_bytes(frame[7:10], "little")) for frame in frames if frame in self.own)
        mavgen = os.path.join(os.environ["PEERS_DIALECT"], "posebridge_all.lua")
        for scripts in (("posebridge_mavlink.lua",), ("posebridge_mavlink.lua", mavgen)):
            packets = [ipv4(b"\xfd" + b"".join(frames)), ipv4(bytes(damaged)), ipv4(self.own[-1][:-1]), ipv4(b"\xfd")]
            self.assertEqual(self.shown(packets, "posebridge.message", scripts=scripts), [[expected], [""], [""], [""]])

    def test_the_definition_is_that_of_the_repository(self):
        with open(os.path.join(self.folder, "posebridge.xml")) as file:
            printed = file.read()
        with open(os.path.join(os.environ["PEERS_DIALECT"], "posebridge.xml")) as file:
            self.assertEqual(printed, file.read())


if __name__ == "__main__":
    unittest.main()
