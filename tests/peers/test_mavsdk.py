"""MAVSDK as it is against a running station: what its plugins show of the robot, our own messages by our definition, and a fix from it."""

import asyncio
import contextlib
import json
import math
import os
import tempfile
import unittest

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.mocap import MocapAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.logging import log_subscribe
from mavsdk.plugins.mavlink_direct import MavlinkMessage
from mavsdk.plugins.mission import MissionError, MissionItem, MissionPlan, MissionResult
from mavsdk.plugins.mocap import AngleBody, Covariance, PositionBody, VisionPositionEstimate

from drives import for_ground_stations, nxt_station, simulated
from harness import DEADLINE_S, RunningStation, posebridge

# A robot that stands where nobody sees it.
AT_REST = """
seed = 3
steering = "odometry"

[drive]
rest_s = 10000.0

[camera]
is_present = false
"""
# Where MAVSDK says that it sees the robot: north, east in metres, yaw in radians.
SEEN_FIRST, SEEN_THEN = (0.3, 0.5, 0.2), (0.4, 0.3, -0.4)
SIGMA_M, SIGMA_RAD = 0.005, 0.01
# Height, roll and pitch: nobody knows them.
UNKNOWN = 1e4
PLANAR_POSE = 42102

LATITUDE, LONGITUDE = 52.0115, 4.3571
ORIGIN = f"""
[station.origin]
latitude = {LATITUDE}
longitude = {LONGITUDE}
"""
# North and east of the origin in metres: a square around the path that the robot drives without a plan.
WAY_POINTS = ((-0.2, -0.2), (-0.2, 0.5), (0.5, 0.5), (0.5, -0.2))
RADIUS_M = 0.08
# Where MAVSDK sends the robot after it.
GOAL = (0.15, -0.35)
DRIVE_S = 90.0
# A degree of latitude, and one of longitude there.
NORTH_M, EAST_M = 111_267.6, 68_660.4
# Within which everything that MAVSDK asks by default is there.
CONNECT_S = 5.0

# What MAVSDK says of itself would stand between the tests' names.
log_subscribe(lambda level, text, file, line: True)

class Mavsdk41(unittest.IsolatedAsyncioTestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    async def connected(self, station):
        """MAVSDK as a ground station, and the system that it finds."""
        host, port = station.addresses[0]
        mavsdk = await self.enterAsyncContext(Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)))
        await mavsdk.add_any_connection(f"udpout://{host}:{port}")
        system = await mavsdk.first_autopilot(timeout_s=DEADLINE_S)
        self.assertIsNotNone(system, station.talk())
        return system

    async def first(self, stream, is_wanted=lambda value: True):
        """The first value of a subscription that is wanted."""
        async with contextlib.aclosing(stream), asyncio.timeout(DEADLINE_S):
            async for value in stream:
                if is_wanted(value):
                    return value

    async def collected(self, stream, count):
        """The first values of a subscription."""
        values = []
        await self.first(stream, lambda value: values.append(value) or len(values) == count)
        return values

    def at_rest(self, *keys):
        """A station with a robot that stands still, and has not been told where; keys for the link of ground stations."""
        return RunningStation(self.folder, "run", simulated(self.folder, AT_REST) + for_ground_stations("udp", *keys)).belongs_to(self)

    async def test_connects_and_odometry_attitude_position_distance_and_status_text_arrive(self):
        station = nxt_station(self, self.folder, for_ground_stations("udp"))
        system = await self.connected(station)
        self.assertEqual(await system.get_system_id(), 1)
        self.assertTrue(await system.is_connected())
        self.assertIn(197, await system.component_ids())
        telemetry, direct = TelemetryAsync(system), MavlinkDirectAsync(system)
        frames = asyncio.create_task(self.collected(direct.subscribe_message("ODOMETRY"), 30))
        seen = await self.collected(telemetry.subscribe_odometry(), 20)
        by_time = {fields["time_usec"]: fields for fields in map(fields_of, await frames)}
        compared = [(odometry, by_time[odometry.time_usec]) for odometry in seen if odometry.time_usec in by_time]
        self.assertGreater(len(compared), 10)
        for odometry, fields in compared:
            self.assertEqual((odometry.position_body.x_m, odometry.position_body.y_m), (fields["x"], fields["y"]))
            self.assertEqual((odometry.q.w, odometry.q.z), (fields["q"][0], fields["q"][3]))
        # The square and its surroundings, and the wall in front of it.
        attitude = await self.first(telemetry.subscribe_attitude_euler())
        self.assertTrue(-180.0 <= attitude.yaw_deg <= 180.0 and attitude.roll_deg == attitude.pitch_deg == 0.0)
        position = (await self.first(telemetry.subscribe_position_velocity_ned())).position
        self.assertTrue(-0.1 < position.north_m < 0.4 and -0.1 < position.east_m < 0.4, position)
        distance = await self.first(telemetry.subscribe_distance_sensor())
        self.assertTrue(0.2 < distance.current_distance_m < 2.6, distance)
        text = asyncio.create_task(self.first(telemetry.subscribe_status_text(), lambda text: "slip_nis" in text.text.lower()))
        # Again until it is heard: the subscription may begin after the first answer.
        while not text.done():
            await direct.send_message(message("PARAM_SET", param_id="SLIP_NIS", param_value=-1.0, param_type=9))
            await asyncio.wait({text}, timeout=1.0)
        self.assertIn("not in", text.result().text)

    async def test_parameters_and_plans_come_at_once_with_default_arguments(self):
        names = {line.split()[0].upper() for line in posebridge(self.folder, "config", "params").splitlines() if not line.startswith(" ")}
        for name, make in (("nxt", lambda: nxt_station(self, self.folder, for_ground_stations("udp"))), ("dialect", self.at_rest)):
            folder = tempfile.TemporaryDirectory()
            self.addCleanup(folder.cleanup)
            self.folder = folder.name
            station = make()
            system = await self.connected(station)
            async with asyncio.timeout(CONNECT_S):
                parameters = await ParamAsync(system).get_all_params()
            found = {parameter.name: parameter.value for parameter in parameters.float_params}
            self.assertEqual(({*found}, len(parameters.int_params)), (names, 0), name)
            async with asyncio.timeout(CONNECT_S):
                self.assertEqual((await MissionAsync(system).download_mission()).mission_items, [], name)
                self.assertEqual(await MissionRawAsync(system).download_mission(), [], name)
                self.assertEqual(await ParamAsync(system).get_param_float("SLIP_NIS"), found["SLIP_NIS"], name)
            async with asyncio.timeout(CONNECT_S):
                await ParamAsync(system).set_param_float("SLIP_NIS", 20.0)
            station.kill()

    async def test_map_battery_and_health_are_there_within_seconds(self):
        configuration = simulated(self.folder) + ORIGIN + for_ground_stations("udp")
        station = RunningStation(self.folder, "run", configuration).belongs_to(self)
        telemetry = TelemetryAsync(await self.connected(station))
        async with asyncio.timeout(CONNECT_S):
            home = await self.first(telemetry.subscribe_home())
            position = await self.first(telemetry.subscribe_position())
            health = await self.first(telemetry.subscribe_health())
            battery = await self.first(telemetry.subscribe_battery())
        self.assertAlmostEqual(home.latitude_deg, LATITUDE, 6)
        self.assertAlmostEqual(home.longitude_deg, LONGITUDE, 6)
        # A square of 0.3 m; a degree of latitude has 111 km.
        self.assertLess(abs(position.latitude_deg - LATITUDE) * 111e3, 0.6)
        self.assertTrue(5.0 < battery.voltage_v < 9.0, battery)
        self.assertTrue(health.is_gyrometer_calibration_ok, health)

    async def test_a_mission_is_uploaded_driven_to_its_end_and_downloaded_and_a_goal_is_driven_to(self):
        station = RunningStation(self.folder, "run", simulated(self.folder) + ORIGIN + for_ground_stations("udp")).belongs_to(self)
        system = await self.connected(station)
        mission, telemetry = MissionAsync(system), TelemetryAsync(system)
        # Once it has a place in the arena.
        await self.first(telemetry.subscribe_position())
        items = [
            MissionItem(latitude_deg=latitude, longitude_deg=longitude, relative_altitude_m=0.0, acceptance_radius_m=RADIUS_M)
            for latitude, longitude in map(place_on_earth, WAY_POINTS)
        ]
        async with asyncio.timeout(CONNECT_S):
            await mission.upload_mission(MissionPlan(items))
            back = (await mission.download_mission()).mission_items
        self.assertEqual(len(back), len(items))
        for sent, got in zip(items, back):
            # To the last digit of the integers that are sent.
            self.assertEqual(round(sent.latitude_deg * 1e7), round(got.latitude_deg * 1e7))
            self.assertEqual(round(sent.longitude_deg * 1e7), round(got.longitude_deg * 1e7))
            self.assertAlmostEqual(got.acceptance_radius_m, RADIUS_M, 6)
        progress, nearest = [], [math.inf] * len(WAY_POINTS)
        async with contextlib.aclosing(mission.subscribe_mission_progress()) as reports, asyncio.timeout(DRIVE_S):
            watch = asyncio.create_task(self.watch(telemetry, nearest))
            await mission.start_mission()
            async for report in reports:
                progress.append((report.current, report.total))
                if report.current == len(items):
                    break
            watch.cancel()
        self.assertTrue(await mission.is_mission_finished())
        self.assertEqual([current for current, _ in progress], sorted({current for current, _ in progress}), progress)
        for distance_m in nearest:
            self.assertLess(distance_m, RADIUS_M + 0.02, nearest)
        latitude, longitude = place_on_earth(GOAL)
        async with asyncio.timeout(DRIVE_S):
            await ActionAsync(system).goto_location(latitude, longitude, 0.0, 0.0)
            await self.first(telemetry.subscribe_position_velocity_ned(), lambda seen: distance_m_to(seen.position, GOAL) < RADIUS_M)

    async def test_a_plan_that_no_robot_can_drive_is_refused_with_a_text(self):
        station = RunningStation(self.folder, "run", simulated(self.folder) + for_ground_stations("udp")).belongs_to(self)
        system = await self.connected(station)
        telemetry = TelemetryAsync(system)
        text = asyncio.create_task(self.first(telemetry.subscribe_status_text(), lambda text: "plan refused" in text.text))
        latitude, longitude = place_on_earth(GOAL)
        nowhere = MissionItem(latitude_deg=latitude, longitude_deg=longitude, relative_altitude_m=0.0)
        while not text.done():
            with self.assertRaises(MissionError) as refused:
                await MissionAsync(system).upload_mission(MissionPlan([nowhere]))
            self.assertNotEqual(refused.exception.result, MissionResult.TIMEOUT)
            await asyncio.wait({text}, timeout=1.0)
        self.assertIn("item 0: set the arena's origin", text.result().text)

    async def watch(self, telemetry, nearest):
        """Keeps how near the robot has come to each way-point."""
        async for seen in telemetry.subscribe_position_velocity_ned():
            for index, goal in enumerate(WAY_POINTS):
                nearest[index] = min(nearest[index], distance_m_to(seen.position, goal))

    async def test_custom_xml_decodes(self):
        station = self.at_rest('dialects = "all"')
        direct = MavlinkDirectAsync(await self.connected(station))
        with open(os.path.join(os.environ["PEERS_DIALECT"], "posebridge.xml")) as file:
            await direct.load_custom_xml(file.read())
        ticks = fields_of(await self.first(direct.subscribe_message("PB_WHEEL_TICKS")))
        self.assertEqual((ticks["left"], ticks["right"], ticks["flags"]), (0, 0, 3))
        pose = asyncio.create_task(self.first(direct.subscribe_message("PB_PLANAR_POSE")))
        await direct.send_message(message(
            "COMMAND_LONG", command=511, confirmation=0, param1=PLANAR_POSE, param2=100_000,
            param3=0, param4=0, param5=0, param6=0, param7=0))
        pose = fields_of(await pose)
        self.assertEqual(len(pose["covariance"]), 6)
        self.assertEqual(pose["fix_age_ms"], 65_535)

    async def test_a_vision_fix_through_the_mocap_api_and_the_pose_follows_it(self):
        system = await self.connected(self.at_rest())
        for place in (SEEN_FIRST, SEEN_THEN):
            await self.see(system, place)

    async def see(self, system, place):
        """Tells where the robot is seen until it is believed to be there."""
        north_m, east_m, yaw_rad = place
        covariance = [0.0] * 21
        # The upper triangle over x, y, z, roll, pitch, yaw.
        for index, variance in ((0, SIGMA_M**2), (6, SIGMA_M**2), (11, UNKNOWN), (15, UNKNOWN), (18, UNKNOWN), (20, SIGMA_RAD**2)):
            covariance[index] = variance
        fix = VisionPositionEstimate(0, PositionBody(north_m, east_m, 0.0), AngleBody(0.0, 0.0, yaw_rad), Covariance(covariance))
        mocap, telemetry = MocapAsync(system), TelemetryAsync(system)
        positions, attitudes = telemetry.subscribe_position_velocity_ned(), telemetry.subscribe_attitude_euler()
        async with contextlib.aclosing(positions), contextlib.aclosing(attitudes), asyncio.timeout(DEADLINE_S):
            while True:
                await mocap.set_vision_position_estimate(fix)
                position, attitude = (await anext(positions)).position, await anext(attitudes)
                off_m = math.hypot(position.north_m - north_m, position.east_m - east_m)
                if off_m < SIGMA_M and abs(attitude.yaw_deg - math.degrees(yaw_rad)) < 1.0:
                    return


def message(name, **fields):
    """A message for the estimator, as MAVSDK takes any."""
    whom = {"target_system": 1, "target_component": 197}
    return MavlinkMessage(name, 0, 0, 1, 197, json.dumps({**whom, **fields}))


def place_on_earth(north_east):
    """Latitude and longitude of a point of the arena."""
    north_m, east_m = north_east
    return LATITUDE + north_m / NORTH_M, LONGITUDE + east_m / EAST_M


def distance_m_to(position, north_east):
    return math.hypot(position.north_m - north_east[0], position.east_m - north_east[1])


def fields_of(heard):
    return json.loads(heard.fields_json)


if __name__ == "__main__":
    unittest.main()
