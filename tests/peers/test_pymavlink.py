"""pymavlink as a ground station and as a robot, with a dialect that mavgen makes from our definition."""

import collections
import os
import re
import struct
import sys
import tempfile
import unittest

from drives import SQUARE, counted, finished_drive, for_ground_stations, inspected, logged, nxt_station, simulated
from ground import ACCEPTED, ESTIMATOR, VEHICLE, Ground, every_message, sender
from harness import RunningStation, Station, output_of, posebridge, refusals

SET_MESSAGE_INTERVAL, GET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 511, 510, 512
PREFLIGHT_STORAGE = 245
UNSUPPORTED, DENIED = 3, 2
# What is sent only when somebody asks: by number, and how often in microseconds.
ON_REQUEST = {251: "NAMED_VALUE_FLOAT", 350: "DEBUG_FLOAT_ARRAY", 42102: "PB_PLANAR_POSE", 42103: "PB_FUSION_HEALTH"}
ONCE = {148: "AUTOPILOT_VERSION", 300: "PROTOCOL_VERSION", 396: "COMPONENT_INFORMATION_BASIC"}
OF_ESTIMATOR = {
    "HEARTBEAT", "ODOMETRY", "LOCAL_POSITION_NED", "ESTIMATOR_STATUS", "STATUSTEXT", "TIMESYNC", "COMMAND_ACK", "MESSAGE_INTERVAL",
    "PARAM_VALUE", *ON_REQUEST.values(), *ONCE.values(),
}
OF_VEHICLE = {"HEARTBEAT", "ATTITUDE", "DISTANCE_SENSOR", "SYS_STATUS", "EXTENDED_SYS_STATE", "BATTERY_STATUS", "VFR_HUD"}
OF_ROBOT = {"HEARTBEAT", "ATTITUDE", "PB_WHEEL_TICKS", "PB_INERTIAL", "PB_ROBOT_DESCRIPTION"}
CAMERA = (1, 100)
EVERYBODY = (VEHICLE, ESTIMATOR, CAMERA)


class Common(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def station(self, *links, scenario=SQUARE):
        """A station with a robot that drives, and with links for ground stations."""
        return RunningStation(self.folder, "run", simulated(self.folder, scenario) + "\n".join(links)).belongs_to(self)

    def ground(self, *arguments, **options):
        ground = Ground(*arguments, **options)
        self.addCleanup(ground.close)
        return ground

    def lost_nothing(self, ground, of=(VEHICLE, ESTIMATOR)):
        """None of these has lost anything, and everything made sense; how many frames of each that says something about."""
        self.assertEqual(ground.undecoded(), [])
        self.assertEqual(ground.mav.total_receive_errors, 0)
        self.assertEqual({one: ground.lost[one] for one in of}, {one: 0 for one in of})
        return {one: sum(sender(message) == one for message in ground.heard) for one in of}


class GroundStation(Common):
    def test_decodes_every_message_that_we_send(self):
        station = nxt_station(self, self.folder, for_ground_stations("udp"))
        ground = self.ground(station.addresses[0])
        ground.hear_from(VEHICLE, "HEARTBEAT")
        for number in ON_REQUEST:
            self.assertEqual(ground.command(SET_MESSAGE_INTERVAL, number, 100_000), ACCEPTED)
        self.assertEqual(ground.command(GET_MESSAGE_INTERVAL, 251), ACCEPTED)
        self.assertEqual(ground.hear_from(ESTIMATOR, "MESSAGE_INTERVAL").interval_us, 100_000)
        for number, name in ONCE.items():
            self.assertEqual(ground.command(REQUEST_MESSAGE, number), ACCEPTED)
            ground.hear_from(ESTIMATOR, name)
        ground.parameters()
        # Out of its range: a text says so. The station says one line in five seconds, and has said one when it found the robot.
        ground.hear_beats(6, of=(ESTIMATOR,))
        ground.mav.param_set_send(*ESTIMATOR, b"SLIP_NIS", -1.0, 9)
        ground.hear_from(ESTIMATOR, "STATUSTEXT", lambda said: "slip_nis" in said.text.lower())
        for of, names in ((ESTIMATOR, OF_ESTIMATOR), (VEHICLE, OF_VEHICLE)):
            heard = {message.get_type() for message in ground.heard if sender(message) == of}
            for name in sorted(names - heard):
                ground.hear_from(of, name)
        self.lost_nothing(ground)
        said = {(*of, name) for of, names in ((ESTIMATOR, OF_ESTIMATOR), (VEHICLE, OF_VEHICLE | {"STATUSTEXT"})) for name in names}
        # All that there is, so that nobody adds a message without this test; the camera's own are passed on.
        self.assertEqual({kind for kind in ground.kinds() if kind[:2] != CAMERA} - said, set())

    def test_every_unknown_command_is_refused_with_its_own_number(self):
        station = self.station(for_ground_stations("udp"))
        ground = self.ground(station.addresses[0])
        ground.hear_beats(1)
        for number in (16, 400, 521, 12_345, 65_000):
            self.assertEqual(ground.command(number), UNSUPPORTED, number)
        ground.mav.command_int_send(*ESTIMATOR, 0, 31_999, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        self.assertEqual(ground.hear_from(ESTIMATOR, "COMMAND_ACK", lambda answer: answer.command == 31_999).result, UNSUPPORTED)

    def test_no_loss_with_three_component_ids_on_each_link(self):
        # The camera answers the station's requests for its time; these answers are not for others, and must not look like losses.
        station = self.station(*(for_ground_stations(scheme, 'dialects = "all"') for scheme in ("udp", "tcp")))
        grounds = [self.ground(address, scheme) for address, scheme in zip(station.addresses, ("udp", "tcp"))]
        # The sockets hold what comes meanwhile on the other link.
        for _ in range(5):
            for ground in grounds:
                ground.hear_beats(1, of=EVERYBODY)
        for ground in grounds:
            ground.hear_from(VEHICLE, "PB_ROBOT_DESCRIPTION")
            frames = self.lost_nothing(ground, of=EVERYBODY)
            self.assertEqual(ground.link.packet_loss(), 0.0)
            print(f"\n  frames, lost 0: {frames}", file=sys.stderr)
            self.assertTrue(all(count > 10 for count in frames.values()), frames)
            self.assertTrue(all(frames[one] > 100 for one in (VEHICLE, ESTIMATOR)), frames)
            # The robot's own frames and what the station says in its name have one count.
            self.assertLessEqual(OF_ROBOT, {message.get_type() for message in ground.heard if sender(message) == VEHICLE})

    def test_sets_every_parameter_and_sees_it_back(self):
        station = self.station(for_ground_stations("udp"))
        ground = self.ground(station.addresses[0])
        self.sets_every_parameter(ground)
        self.lost_nothing(ground)

    def sets_every_parameter(self, ground):
        ranges = self.ranges()
        before = ground.parameters()
        self.assertEqual({name.lower() for name in before}, set(ranges))
        wanted = {}
        for name, value in before.items():
            low, high = ranges[name.lower()]
            # Half-way to an end of the range, as the wire can say it.
            other = (value + (low if value - low > high - value else high)) / 2.0
            wanted[name] = struct.unpack("f", struct.pack("f", other))[0]
            self.assertNotEqual(wanted[name], value, name)
            ground.mav.param_set_send(*ESTIMATOR, name.encode(), wanted[name], 9)
            answer = ground.hear_from(ESTIMATOR, "PARAM_VALUE", lambda answer: answer.param_id == name)
            self.assertEqual(answer.param_value, wanted[name], name)
        self.assertEqual(ground.parameters(), wanted)
        for name in before:
            ground.mav.param_request_read_send(*ESTIMATOR, name.encode(), -1)
            answer = ground.hear_from(ESTIMATOR, "PARAM_VALUE", lambda answer: answer.param_id == name)
            self.assertEqual(answer.param_value, wanted[name], name)
        # And one out of range is not taken.
        low, high = ranges["slip_nis"]
        ground.mav.param_set_send(*ESTIMATOR, b"SLIP_NIS", 2.0 * high, 9)
        name = next(name for name in wanted if name.upper() == "SLIP_NIS")
        answer = ground.hear_from(ESTIMATOR, "PARAM_VALUE", lambda answer: answer.param_id == name)
        self.assertEqual(answer.param_value, wanted[name])

    def ranges(self):
        """Of each parameter its range, as people are told."""
        lines = posebridge(self.folder, "config", "params").splitlines()
        # What each is for stands in the indented lines below it.
        lines = (line for line in lines if not line.startswith(" "))
        found = (re.match(r"(\w+) +\S+ +(\S+) to (\S+)", line) for line in lines)
        return {match[1]: (float(match[2]), float(match[3])) for match in found}

    def test_all_of_it_on_a_signed_link(self):
        posebridge(self.folder, "key", "new", "station.key")
        with open(os.path.join(self.folder, "station.key")) as file:
            key = bytes.fromhex(file.read().strip())
        station = self.station(for_ground_stations("udp", 'signing = { key_file = "station.key", link_id = 3 }'))
        ground = self.ground(station.addresses[0], key=key)
        ground.hear_beats(3, of=EVERYBODY)
        self.sets_every_parameter(ground)
        ground.hear_beats(6, of=EVERYBODY)
        # Robot and camera do not sign; their frames are numbered all the same, because some of them were for the station alone.
        frames = self.lost_nothing(ground, of=EVERYBODY)
        self.assertTrue(all(count > 10 for count in frames.values()), frames)
        self.assertEqual(ground.command(REQUEST_MESSAGE, 148), ACCEPTED)
        ours = [message for message in ground.heard if sender(message) == ESTIMATOR]
        self.assertTrue(all(message.get_signed() for message in ours))
        # The vehicle's attitude comes from the estimator, because nobody may sign as the robot.
        self.assertIn("ATTITUDE", {message.get_type() for message in ours})
        self.assertEqual(refusals(station.stop()), [])


class Robot(Common):
    def test_every_message_of_both_dialects_is_decoded(self):
        station = Station(self.folder, "run").belongs_to(self)
        robot = self.ground(station.address, own=(42, 1))
        said = every_message()
        for message in said:
            robot.mav.send(message)
        # An answer means that all before it was read.
        robot.mav.timesync_send(0, 77)
        robot.hear(lambda message: message.get_type() == "TIMESYNC" and message.ts1 == 77, "the answer")
        station.stop()
        found = inspected(self.folder, "run/recording.mcap")
        counted = {message["name"]: message["frames"] for message in found["messages"]}
        expected = collections.Counter(message.get_type() for message in said)
        expected["HEARTBEAT"] = counted["HEARTBEAT"]
        expected["TIMESYNC"] = counted["TIMESYNC"]
        self.assertEqual(counted, dict(expected))
        self.assertEqual((found["unknown_frames"], found["bytes_outside"]), (0, 0))
        self.assertEqual([source["lost"] for source in found["sources"]], [0])


class TelemetryLog(Common):
    def test_mavlogdump_reads_ours_without_bad_data(self):
        folder = finished_drive()
        theirs = logged(folder, "run/recording.tlog")
        self.assertEqual(theirs, counted(folder, "run/recording.tlog"))
        # Both directions: the robot's own, and what it was told.
        self.assertGreater(theirs[1, 1, "PB_WHEEL_TICKS"], 100)
        self.assertGreater(theirs[1, 197, "PB_PLANAR_POSE"], 100)

    def test_stock_readers_see_no_losses_in_ours(self):
        """mavutil with the dialect that it has by itself; a process of its own, because mavutil keeps one dialect for all.

        In the order of the file: what `mavlink_connection` gives reads the first message of each kind before all others, and so counts up to
        255 losses for each sender in any log."""
        script = (
            "import sys\n"
            "from pymavlink import mavutil\n"
            "mavutil.set_dialect('ardupilotmega')\n"
            "log = mavutil.mavlogfile(sys.argv[1])\n"
            "kinds = []\n"
            "while (message := log.recv_msg()) is not None:\n"
            "    kinds.append(message.get_type())\n"
            "print(log.mav_count, log.mav_loss, log.packet_loss(), kinds.count('BAD_DATA'))\n")
        count, *losses = output_of(sys.executable, "-c", script, "run/recording.tlog", folder=finished_drive()).split()
        self.assertGreater(int(count), 300)
        self.assertEqual([float(number) for number in losses], [0, 0, 0])


if __name__ == "__main__":
    unittest.main()
