"""nxt-python as it is against the simulated NXT, behind a pseudo-terminal and behind a socket."""

import os
import struct
import tempfile
import time
import unittest

import nxt.error
import nxt.locator
import nxt.motor
import nxt.sensor
import nxt.sensor.digital
import nxt.sensor.generic
import nxt.sensor.hitechnic
from nxt.motor import Mode, RegulationMode, RunState
from nxt.telegram import Opcode, Telegram

from harness import DEADLINE_S, SimulatedBrick

# No program runs; a short turn-around, for dozens of questions. The wall stands 80 cm ahead.
SCENARIO = """
seed = 3
[camera]
is_present = false
[brick]
program = "none"
turn_around_ms = 10.0
wall_x_m = 0.8
sensors = ["gyro", "accelerometer", "compass", "ultrasonic"]
"""
OUTPUT, INPUT, LOW_SPEED, COMMAND = 0x20001, 0x30001, 0xB0001, 0x10001


class Common:
    """What must hold over either link; `brick` is nxt-python's."""

    scenario = SCENARIO

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = folder.name
        self.brick = self.found(self.scenario)

    def found(self, scenario):
        """A simulated brick, found by nxt-python."""
        program = SimulatedBrick(self.folder, "nxt", self.listen(), scenario)
        self.addCleanup(program.kill)
        brick = nxt.locator.find(config=None, **self.where(program))
        self.addCleanup(brick.close)
        return brick

    def wait_until(self, is_so, what):
        deadline = time.monotonic() + DEADLINE_S
        while not is_so():
            if time.monotonic() > deadline:
                self.fail(f"not so: {what}")

    def tick_ms(self):
        return struct.unpack("<I", self.brick.read_io_map(COMMAND, 20, 4)[1])[0]

    def tachos(self):
        """All three motors in one telegram."""
        _, data = self.brick.read_io_map(OUTPUT, 0, 96)
        return [struct.unpack_from("<i", data, 32 * port)[0] for port in range(3)]

    def status_of(self, opcode, *body):
        """The status of a command that nxt-python would not send."""
        telegram = Telegram(opcode)
        telegram.add_bytes(bytes(body))
        try:
            self.brick._cmd(telegram)
        except nxt.error.ProtocolError as error:
            return error
        return None

    def test_it_is_found_by_its_name_and_tells_who_it_is(self):
        name, host, signals, flash = self.brick.get_device_info()
        self.assertEqual((name, host[:8], signals), ("NXT", "00:16:53", (0, 0, 0, 0)))
        self.assertGreater(flash, 0)
        self.assertEqual(self.brick.get_firmware_version(), ((1, 124), (1, 31)))
        self.brick.set_brick_name("rover")
        self.assertEqual(self.brick.get_device_info()[0], "rover")

    def test_battery_sound_and_keep_alive(self):
        self.assertTrue(7_900 <= self.brick.get_battery_level() <= 8_000)
        self.brick.play_tone(440, 10)
        self.brick.stop_sound_playback()
        self.assertEqual(self.brick.keep_alive(), 600_000)

    def test_a_motor_turns_as_far_as_it_is_told(self):
        motor = self.brick.get_motor(nxt.motor.Port.B)
        motor.turn(70, 360)
        turned = motor.get_tacho().tacho_count
        # nxt-python stops early by 70 or 80 degrees, and the motor runs on.
        self.assertTrue(270 <= turned <= 560, turned)
        self.assertEqual(self.brick.get_motor(nxt.motor.Port.C).get_tacho().tacho_count, 0)
        motor.reset_position(relative=False)
        self.assertLess(abs(motor.get_tacho().rotation_count), 30)
        motor.idle()

    def test_encoders_by_single_commands_and_by_io_map_agree(self):
        # Opposite ways, so that the robot turns on the spot.
        for port, power in ((nxt.motor.Port.B, 60), (nxt.motor.Port.C, -60)):
            self.brick.set_output_state(port, power, Mode.ON, RegulationMode.IDLE, 0, RunState.RUNNING, 0)
        self.wait_until(lambda: self.tachos()[1] > 200, "motor B turned by 200 degrees")
        self.brick.get_motor(nxt.motor.Port.B).idle()
        self.brick.get_motor(nxt.motor.Port.C).idle()
        self.wait_until(lambda: len({tuple(self.tachos()) for _ in range(10)}) == 1, "the motors rest")
        a, b, c = self.tachos()
        states = [self.brick.get_output_state(port) for port in nxt.motor.Port]
        self.assertEqual([state[7] for state in states], [a, b, c])
        self.assertTrue(a == 0 and b > 200 and c < -200, (a, b, c))

    def test_the_gyro_feels_a_turn(self):
        gyro = self.brick.get_sensor(nxt.sensor.Port.S1, nxt.sensor.hitechnic.Gyro)
        rest = gyro.get_rotation_speed()
        self.assertTrue(570 <= rest <= 635, rest)
        for port, power in ((nxt.motor.Port.B, -50), (nxt.motor.Port.C, 50)):
            self.brick.set_output_state(port, power, Mode.ON, RegulationMode.IDLE, 0, RunState.RUNNING, 0)
        # 28 mm wheels at 7.5 rad/s on a track of 112 mm: 215 degrees per second to the left.
        self.wait_until(lambda: gyro.get_rotation_speed() - rest > 190, "a left turn is felt")
        _, data = self.brick.read_io_map(INPUT, 0, 80)
        raw, sensor_type, invalid = struct.unpack_from("<2xH4xB7xB", data)
        self.assertTrue(raw - rest > 150 and (sensor_type, invalid) == (nxt.sensor.Type.ANGLE.value, 0))

    def test_the_accelerometer_and_the_compass_tell_their_names_and_their_readings(self):
        accelerometer = self.brick.get_sensor(nxt.sensor.Port.S2)
        self.assertIsInstance(accelerometer, nxt.sensor.hitechnic.Accelerometer)
        felt = accelerometer.get_acceleration()
        self.assertTrue(abs(felt.x) < 20 and abs(felt.y) < 20 and 180 < felt.z < 220, vars(felt))
        compass = self.brick.get_sensor(nxt.sensor.Port.S3, nxt.sensor.hitechnic.Compass)
        # The robot points east.
        self.assertTrue(80 <= compass.get_heading() <= 100)

    def test_the_ultrasonic_sensor_sees_the_wall(self):
        sensor = self.brick.get_sensor(nxt.sensor.Port.S4, nxt.sensor.generic.Ultrasonic)
        self.assertEqual(sensor.get_sensor_info().product_id, "LEGO")
        self.assertEqual(sensor.get_measurement_units(), "10E-2m")
        self.assertTrue(78 <= sensor.get_distance() <= 82)

    def test_the_thermometer_shows_a_room(self):
        brick = self.found(SCENARIO.replace('"ultrasonic"', '"temperature"'))
        sensor = brick.get_sensor(nxt.sensor.Port.S4, nxt.sensor.generic.Temperature)
        self.assertEqual(sensor.get_deg_c(), 21.0)

    def test_the_bus_is_pending_and_then_its_buffer_holds_the_answer(self):
        self.brick.set_input_mode(nxt.sensor.Port.S4, nxt.sensor.Type.LOW_SPEED_9V, nxt.sensor.Mode.RAW)
        with self.assertRaises(nxt.error.I2CError):
            self.brick.ls_write(nxt.sensor.Port.S4, bytes((2, 0x42)), 1)
        self.wait_until(lambda: self.brick.get_input_values(nxt.sensor.Port.S4)[1], "the port is valid")
        self.brick.ls_write(nxt.sensor.Port.S4, bytes((2, 0x42)), 1)
        self.wait_until(lambda: self.is_answered(nxt.sensor.Port.S4), "the sensor has answered")
        _, data = self.brick.read_io_map(LOW_SPEED, 0, 76)
        buffer, in_at, out_at, missing = struct.unpack_from("<16sBBB", data, 19 * 3)
        self.assertEqual((in_at, out_at, missing), (1, 0, 0))
        self.assertTrue(78 <= buffer[in_at - 1] <= 82)
        self.assertEqual(self.brick.ls_read(nxt.sensor.Port.S4), buffer[:1])

    def is_answered(self, port):
        try:
            return self.brick.ls_get_status(port) == 1
        except nxt.error.I2CPendingError:
            return False

    def test_the_tick_counts_milliseconds(self):
        host, brick = time.monotonic(), self.tick_ms()
        self.wait_until(lambda: time.monotonic() - host > 0.5, "half a second is over")
        passed = (time.monotonic() - host) * 1e3
        # Two round trips of some 12 ms lie between the readings of both clocks.
        self.assertLess(abs(self.tick_ms() - brick - passed), 40)

    def test_an_io_map_that_is_written_moves_a_motor(self):
        # Flags, mode, speed of motor B; then its run state, and the flags again.
        self.brick.write_io_map(OUTPUT, 32 + 25, bytes((0x20,)))
        self.brick.write_io_map(OUTPUT, 32 + 18, bytes((0x03, 0x01, 40)))
        self.wait_until(lambda: self.tachos()[1] > 30, "motor B turns")

    def test_wrong_ports_unknown_commands_and_maps_have_their_documented_status(self):
        for opcode in (Opcode.DIRECT_GET_OUT_STATE, Opcode.DIRECT_GET_IN_VALS):
            self.assertIn("out-of-range", str(self.status_of(opcode, 7)))
        self.assertIn("unknown command opcode", str(self.status_of(Opcode.DIRECT_DATALOG_READ)))
        self.assertIsInstance(self.status_of(Opcode.DIRECT_LS_READ, 1), nxt.error.I2CError)
        with self.assertRaises(nxt.error.ModuleNotFoundError):
            self.brick.read_io_map(0x990001, 0, 4)
        with self.assertRaisesRegex(nxt.error.SystemProtocolError, "out of bounds"):
            self.brick.read_io_map(OUTPUT, 90, 8)

    def test_without_a_program_there_are_no_mailboxes(self):
        for call in (
            lambda: self.brick.message_write(0, b"hello"),
            lambda: self.brick.message_read(10, 0, True),
            self.brick.get_current_program_name,
            self.brick.stop_program,
        ):
            with self.assertRaises(nxt.error.NoActiveProgramError):
                call()

    def test_a_program_starts_zeroes_the_counters_and_has_mailboxes(self):
        motor = self.brick.get_motor(nxt.motor.Port.B)
        motor.run(60)
        self.wait_until(lambda: self.tachos()[1] > 100, "motor B turns")
        motor.brake()
        with self.assertRaisesRegex(nxt.error.DirectProtocolError, "request failed"):
            self.brick.start_program("nobody.rxe")
        self.brick.start_program("path.rxe")
        self.assertEqual(self.brick.get_current_program_name(), "path.rxe")
        self.assertLess(self.tachos()[1], 60)
        self.brick.message_write(5, b"hello")
        self.assertEqual(self.brick.message_read(5, 1, True), (1, b"hello\0"))
        with self.assertRaises(nxt.error.EmptyMailboxError):
            self.brick.message_read(5, 1, True)
        self.brick.stop_program()


class BehindAPseudoTerminal(Common, unittest.TestCase):
    def listen(self):
        self.count = getattr(self, "count", 0) + 1
        return f"pty:brick{self.count}.tty"

    def where(self, program):
        return {"backends": ["devfile"], "filename": os.path.join(program.folder, f"brick{self.count}.tty")}


class BehindASocket(Common, unittest.TestCase):
    def listen(self):
        return "tcp://127.0.0.1:0"

    def where(self, program):
        host, port = program.address_of(program.line)
        return {"backends": ["socket"], "server_host": host, "server_port": port}

    def test_the_next_client_is_greeted_too(self):
        self.brick.close()
        brick = self.found(SCENARIO)
        sock = brick._sock
        again = nxt.locator.find(
            config=None, backends=["socket"], server_host=sock._host, server_port=sock._port)
        self.addCleanup(again.close)
        self.assertEqual(again._sock.type, "ipbluetooth")
        self.assertEqual(again.get_device_info()[0], "NXT")


if __name__ == "__main__":
    unittest.main()
