"""The first conversation of QGroundControl with a vehicle: a client of our station with its requests, their order and its time-outs.

From its documentation and its published source.

Each state asks as QGroundControl asks, of the component that it asks, waits as long as that waits, and repeats as often. A state that
gets no answer in its own time, or one that QGroundControl would report to its user as a failure, fails the test. QGroundControl itself needs a display
and is not run here.
"""

import json
import struct
import tempfile
import time
import unittest
import zlib

from pymavlink import mavutil

from drives import for_ground_stations, nxt_station, simulated
from ground import ACCEPTED, ESTIMATOR, GCS, VEHICLE, Ground, sender
from harness import RunningStation, events_named, posebridge

AUTOPILOT = 1
ALL_COMPONENTS = 0
REQUEST_MESSAGE, REQUEST_PROTOCOL_VERSION, REQUEST_CAPABILITIES = 512, 519, 520
AUTOPILOT_VERSION, COMPONENT_INFORMATION, COMPONENT_METADATA, AVAILABLE_MODES = 148, 395, 397, 435
MISSION_INT, COMMAND_INT, FTP, MAVLINK2 = 4, 8, 32, 8192
UNSUPPORTED = 3
# Seconds: what QGroundControl allows for the acknowledgement of a command and for the message that it asked for, for an answer of the
# file transfer, for the first parameter and between two, for an answer about a plan.
ACK_S, MESSAGE_S, FTP_S, FIRST_PARAMETER_S, PARAMETER_S, PLAN_S = 3.0, 1.0, 1.0, 5.0, 3.0, 1.5
PLANS = {"mission": 0, "fence": 1, "rally points": 2}
OPEN, READ, BURST, RESET, FILE_CRC, LIST = 4, 5, 15, 2, 14, 3
FTP_ACK, FTP_NAK, END_OF_FILE = 128, 129, 6


def flight_stack_crc(crc, data):
    """CRC-32 without inversion, as the flight stacks compute it."""
    return zlib.crc32(data, crc ^ 0xFFFFFFFF) ^ 0xFFFFFFFF


class Connection(Ground):
    """A ground station that takes the time of each state."""

    def __init__(self, *arguments, own=GCS, **options):
        super().__init__(*arguments, own=own, **options)
        self.own = own
        self.took = {}
        self.transfers = 0

    def within(self, seconds, is_wanted, what):
        """The message that is wanted, in its time."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            self.beat()
            message = self.link.recv_match(blocking=True, timeout=left)
            if message is not None:
                self._take(message)
                if is_wanted(message):
                    return message
        raise AssertionError(f"{what} does not come within {seconds} s; heard {dict(self.kinds())}")

    def of(self, who, kind, seconds, is_wanted=lambda message: True):
        return self.within(seconds, lambda found: found.get_type() == kind and sender(found) == who and is_wanted(found), f"{kind} of {who}")

    def state(self, name, act):
        begin = time.monotonic()
        result = act()
        self.took[name] = time.monotonic() - begin
        return result

    def acknowledged(self, number, *parameters, component=AUTOPILOT):
        """The result of a command to a component of the robot's system, by the vehicle."""
        self.mav.command_long_send(1, component, number, 0, *parameters, *(0.0,) * (7 - len(parameters)))
        return self.of(VEHICLE, "COMMAND_ACK", ACK_S, lambda ack: ack.command == number and ack.target_system in (0, self.own[0])).result

    def requested(self, number, kind, *parameters):
        """A message on request, or none if the vehicle says that it has none."""
        if self.acknowledged(REQUEST_MESSAGE, number, *parameters) != ACCEPTED:
            return None
        return self.of(VEHICLE, kind, MESSAGE_S)

    def transfer(self, opcode, session=0, offset=0, size=0, data=b""):
        """One request of the file transfer; its answer, or for a burst all of them."""
        self.transfers += 1
        number = self.transfers * 20 % 65536
        header = struct.pack("<HBBBBBBI", number, session, opcode, size or len(data), 0, 0, 0, offset)
        self.mav.file_transfer_protocol_send(0, *VEHICLE, (header + data).ljust(251, b"\0"))
        answers = []
        while True:
            answer = self.of(VEHICLE, "FILE_TRANSFER_PROTOCOL", FTP_S, lambda answer: (answer.target_system, answer.target_component) == self.own)
            payload = bytes(answer.payload)
            sequence, session, kind, size, asked, complete, _, offset = struct.unpack("<HBBBBBBI", payload[:12])
            if asked != opcode or sequence != number + 1 + len(answers):
                continue
            answers.append((kind, offset, payload[12:12 + size]))
            if opcode != BURST or complete or kind == FTP_NAK:
                return answers

    def file(self, path):
        """A file as QGroundControl gets it: open, bursts until the end, then an end of all sessions."""
        [(kind, _, length)] = self.transfer(OPEN, data=path.encode())
        if kind != FTP_ACK:
            return None
        length, content = struct.unpack("<I", length)[0], b""
        while len(content) < length:
            for kind, offset, part in self.transfer(BURST, offset=len(content), size=239):
                if (kind, offset) != (FTP_ACK, len(content)) or not part:
                    raise AssertionError(f"{path}: at {len(content)} comes {kind} {offset} {part}")
                content += part
        if self.transfer(BURST, offset=length, size=239)[0][::2] != (FTP_NAK, bytes([END_OF_FILE])):
            raise AssertionError(f"{path} does not end")
        self.transfer(RESET)
        return content

    def file_at(self, uri):
        if not uri.startswith("mftp://"):
            raise AssertionError(f"{uri} is not on the vehicle")
        return self.file(uri.removeprefix("mftp://"))

    def all_parameters(self):
        """Values by component and name. Those that are missing are asked for once more by their index."""
        self.mav.param_request_list_send(1, ALL_COMPONENTS)
        found, counts, wait = {}, {}, FIRST_PARAMETER_S
        while sum(counts.values()) > len(found) or AUTOPILOT not in counts or ESTIMATOR[1] not in counts:
            value = self.within(wait, lambda message: message.get_type() == "PARAM_VALUE", "a parameter")
            wait = PARAMETER_S
            component = value.get_srcComponent()
            counts[component] = value.param_count
            if value.param_index < value.param_count:
                found[component, value.param_id] = value
        return found

    def plan(self, kind, times=1):
        """The number of items of a plan, which is asked for that many times at most."""
        for left in reversed(range(times)):
            self.mav.mission_request_list_send(*VEHICLE, kind)
            try:
                count = self.of(VEHICLE, "MISSION_COUNT", PLAN_S, lambda count: count.mission_type == kind)
                break
            except AssertionError:
                if left == 0:
                    raise
        self.mav.mission_ack_send(*VEHICLE, 0, kind)
        return count.count


class InitialConnect(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def connection(self, address, scheme):
        # Under one number the same requests on a second link would be copies of those on the first.
        connection = Connection(address, scheme, own={"udp": GCS, "tcp": (254, 190)}[scheme])
        self.addCleanup(connection.close)
        return connection

    def connects(self, address, scheme):
        """Goes through all states; what each of them took."""
        ground = self.connection(address, scheme)
        beat = ground.state("heartbeat", lambda: ground.of(VEHICLE, "HEARTBEAT", 10.0))
        self.assertEqual((beat.type, beat.autopilot), (mavutil.mavlink.MAV_TYPE_GROUND_ROVER, mavutil.mavlink.MAV_AUTOPILOT_GENERIC))
        version = ground.state("AUTOPILOT_VERSION", lambda: ground.requested(AUTOPILOT_VERSION, "AUTOPILOT_VERSION"))
        self.assertEqual(version.capabilities & (MISSION_INT | COMMAND_INT | FTP | MAVLINK2), MISSION_INT | COMMAND_INT | FTP | MAVLINK2)
        self.assertNotEqual(version.flight_sw_version, 0)
        mode = ground.state("standard modes", lambda: ground.requested(AVAILABLE_MODES, "AVAILABLE_MODES", 1))
        self.assertEqual((mode.number_modes, mode.mode_index, mode.custom_mode), (1, 1, beat.custom_mode))
        metadata = ground.state("component metadata", lambda: self.metadata(ground))
        parameters = ground.state("parameters", ground.all_parameters)
        names = {component: {name for of, name in parameters if of == component} for component, _ in parameters}
        self.assertEqual(names[AUTOPILOT], set(metadata))
        self.assertEqual(names[AUTOPILOT], names[ESTIMATOR[1]])
        for name, described in metadata.items():
            value = parameters[AUTOPILOT, name].param_value
            self.assertTrue(described["min"] <= round(value, 9) <= described["max"], described)
        for name, kind in PLANS.items():
            self.assertEqual(ground.state(name, lambda: ground.plan(kind)), 0, name)
        self.assertEqual(ground.undecoded(), [])
        self.assertEqual((ground.lost[VEHICLE], ground.lost[ESTIMATOR]), (0, 0))
        print(f"{scheme}: " + ", ".join(f"{state} {took * 1e3:.0f} ms" for state, took in ground.took.items()))
        return ground, parameters

    def metadata(self, ground):
        """The description of each parameter, by the files that the vehicle names."""
        found = ground.requested(COMPONENT_METADATA, "COMPONENT_METADATA")
        general = ground.file_at(found.uri)
        self.assertEqual(flight_stack_crc(0, general), found.file_crc)
        [kind] = json.loads(general)["metadataTypes"]
        self.assertEqual((json.loads(general)["version"], kind["type"]), (1, 1))
        described = ground.file_at(kind["uri"])
        self.assertEqual(flight_stack_crc(0, described), kind["fileCrc"])
        described = json.loads(described)
        self.assertEqual(described["version"], 1)
        names = {line.split()[0].upper() for line in posebridge(self.folder, "config", "params").splitlines() if not line.startswith(" ")}
        rows = {row["name"]: row for row in described["parameters"]}
        for row in rows.values():
            self.assertTrue(row["min"] <= row["default"] <= row["max"] and row["shortDesc"] and row["type"] == "Float", row)
        self.assertEqual(set(rows), names)
        return rows

    def keeps_parameters(self, ground, parameters):
        """The checksum by which a ground station knows that what it keeps is right, as it computes it itself."""
        kept = sorted((name, value.param_value) for (component, name), value in parameters.items() if component == AUTOPILOT)
        crc = 0
        for name, value in kept:
            crc = flight_stack_crc(crc, name.encode() + struct.pack("<f", value))
        ground.mav.param_request_read_send(*VEHICLE, b"_HASH_CHECK", -1)
        told = ground.of(VEHICLE, "PARAM_VALUE", PARAMETER_S, lambda value: value.param_id == "_HASH_CHECK")
        self.assertEqual((told.param_type, told.param_index, told.param_count), (mavutil.mavlink.MAV_PARAM_TYPE_UINT32, 65535, len(kept)))
        self.assertEqual(struct.unpack("<I", struct.pack("<f", told.param_value))[0], crc)

    def test_every_state_passes_in_its_time_over_udp_and_tcp_with_a_robot_without_mavlink(self):
        station = nxt_station(self, self.folder, for_ground_stations("udp"), for_ground_stations("tcp"))
        for scheme, address in zip(("udp", "tcp"), station.addresses):
            ground, parameters = self.connects(address, scheme)
            self.keeps_parameters(ground, parameters)
        self.is_never_silent(ground)
        self.sets_a_parameter(ground)

    def test_every_state_passes_with_a_brick_that_speaks_our_dialect(self):
        station = RunningStation(self.folder, "run", simulated(self.folder) + for_ground_stations("udp")).belongs_to(self)
        ground, parameters = self.connects(station.addresses[0], "udp")
        self.keeps_parameters(ground, parameters)

    def is_never_silent(self, ground):
        """What QGroundControl and others ask later, of the vehicle alone or of all components of its system."""
        for component in (AUTOPILOT, ALL_COMPONENTS):
            self.assertEqual(ground.acknowledged(REQUEST_CAPABILITIES, 1, component=component), ACCEPTED)
            ground.of(VEHICLE, "AUTOPILOT_VERSION", MESSAGE_S)
            self.assertEqual(ground.acknowledged(REQUEST_PROTOCOL_VERSION, 1, component=component), ACCEPTED)
            ground.of(VEHICLE, "PROTOCOL_VERSION", MESSAGE_S)
            for number in (400, 176, 21, 520 + 1, 65000):
                self.assertEqual(ground.acknowledged(number, component=component), UNSUPPORTED)
            ground.mav.mission_request_list_send(1, component, 0)
            ground.of(VEHICLE, "MISSION_COUNT", PLAN_S)
            ground.mav.log_request_list_send(1, component, 0, 65535)
            self.assertEqual(ground.of(VEHICLE, "LOG_ENTRY", MESSAGE_S).num_logs, 0)
            ground.mav.param_request_read_send(1, component, b"SLIP_NIS", -1)
            ground.of(VEHICLE, "PARAM_VALUE", PARAMETER_S, lambda value: value.param_id == "SLIP_NIS")
        old = ground.requested(COMPONENT_INFORMATION, "COMPONENT_INFORMATION")
        self.assertEqual(old.general_metadata_uri, "mftp:///general.json")
        self.assertIsNone(ground.file("/etc/passwd"))
        [(kind, _, listed)] = ground.transfer(LIST, data=b"/")
        self.assertEqual(kind, FTP_ACK)
        self.assertRegex(listed.decode(), r"^Fgeneral\.json\t\d+\0Fparameter\.json\t\d+\0$")
        [(kind, _, crc)] = ground.transfer(FILE_CRC, data=b"/general.json")
        self.assertEqual((kind, struct.unpack("<I", crc)[0]), (FTP_ACK, flight_stack_crc(0, ground.file("/general.json"))))
        for kind in PLANS.values():
            ground.mav.mission_count_send(*VEHICLE, 3, kind)
            self.assertEqual(self.plan_result(ground, kind), mavutil.mavlink.MAV_MISSION_UNSUPPORTED)
            ground.mav.mission_clear_all_send(*VEHICLE, kind)
            self.assertEqual(self.plan_result(ground, kind), mavutil.mavlink.MAV_MISSION_ACCEPTED)
        ground.mav.mission_set_current_send(*VEHICLE, 0)
        self.assertEqual(ground.of(VEHICLE, "MISSION_CURRENT", PLAN_S).total, 65535)

    def plan_result(self, ground, kind):
        return ground.of(VEHICLE, "MISSION_ACK", PLAN_S, lambda ack: ack.mission_type == kind).type

    def sets_a_parameter(self, ground):
        """A set is answered by the component to which it goes, and stands at both."""
        ground.mav.param_set_send(*VEHICLE, b"SLIP_NIS", 20.0, mavutil.mavlink.MAV_PARAM_TYPE_REAL32)
        set_to = ground.of(VEHICLE, "PARAM_VALUE", PARAMETER_S, lambda value: value.param_id == "SLIP_NIS")
        self.assertEqual(set_to.param_value, 20.0)
        ground.mav.param_request_read_send(*ESTIMATOR, b"SLIP_NIS", -1)
        self.assertEqual(ground.of(ESTIMATOR, "PARAM_VALUE", PARAMETER_S, lambda value: value.param_id == "SLIP_NIS").param_value, 20.0)


class FirstHeartbeat(unittest.TestCase):
    def test_is_the_vehicles_whenever_somebody_begins_to_listen(self):
        for name, make in (("mavlink", self.with_mavlink), ("nxt", self.with_nxt)):
            folder = tempfile.TemporaryDirectory()
            self.addCleanup(folder.cleanup)
            station = make(folder.name)
            # Nobody's heartbeat waits for a vehicle that is not known yet.
            station.wait_for("robot 0/1/1 detected")
            host, port = station.addresses[-1]
            for attempt in range(6):
                link = mavutil.mavlink_connection(f"tcp:{host}:{port}", source_system=255, source_component=attempt + 1)
                try:
                    first = link.wait_heartbeat(timeout=10.0)
                    self.assertEqual((name, sender(first)), (name, VEHICLE))
                    # pymavlink 2.4.50 takes the system of the first heartbeat of a vehicle, and never its component: whoever
                    # does not set it sends to component 0.
                    self.assertEqual((link.target_system, link.target_component), (1, 0))
                    link.mav.param_request_list_send(link.target_system, link.target_component)
                    value = link.recv_match(type="PARAM_VALUE", blocking=True, timeout=PARAMETER_S)
                    self.assertIsNotNone(value)
                    # Not in step with the heartbeats.
                    link.recv_match(type="NONE", blocking=True, timeout=0.17 * attempt)
                finally:
                    link.close()
            station.kill()

    def with_mavlink(self, folder):
        return RunningStation(folder, "run", simulated(folder) + for_ground_stations("tcp")).belongs_to(self)

    def with_nxt(self, folder):
        return nxt_station(self, folder, for_ground_stations("tcp"))


class Flood(unittest.TestCase):
    def test_is_limited_and_counted_and_delays_nobody_else(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        station = nxt_station(self, folder.name, for_ground_stations("udp"))
        flooder, other = Ground(station.addresses[0], own=(250, 190)), Connection(station.addresses[0])
        for ground in (flooder, other):
            self.addCleanup(ground.close)
        other.of(VEHICLE, "HEARTBEAT", 10.0)
        begin = time.monotonic()
        for _ in range(3_000):
            flooder.mav.command_long_send(*VEHICLE, REQUEST_MESSAGE, 0, AUTOPILOT_VERSION, 0, 0, 0, 0, 0, 0)
        for kind in PLANS.values():
            # What the system drops of a flood may be anybody's: QGroundControl asks five times more.
            self.assertEqual(other.plan(kind, times=6), 0)
        other.all_parameters()
        other.hear_beats(3)
        took = time.monotonic() - begin
        answers = sum(message.get_type() == "COMMAND_ACK" for message in other.heard)
        # Two tokens each: 200 at once and 100 a second.
        self.assertLessEqual(answers, 200 + 100 * took + 1)
        health = events_named(station.stop(), "link_health")
        excess = max(event["excess_requests"] for event in health)
        self.assertGreater(excess, 500)
        print(f"{answers} of 3000 requests answered in {took:.1f} s, {excess} above the budget")


if __name__ == "__main__":
    unittest.main()
